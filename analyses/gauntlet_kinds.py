"""The kinds of data set of the gauntlet: clean ones, and one for each fault of the field.

cause: what a finding must speak of to have named the fault, as a regular expression over the codes
and words of the verdict and of the warnings; empty where the fault has no name of its own. No
verdict on clean data may match it: a word that every verdict has names nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from analyses.gauntlet_truth import Arm, Array, turned_by
from analyses.gauntlet_worlds import Parallel, Readings, Rng, Run, World

DEGREE = np.pi / 180.0
MM, CM = r"\bunits?\b|millimet", r"\bunits?\b|centimet"
REVERSED, SDS = "revers|other way", "stated sds|chi-squared"
NEAR = "near-poses-only"
FEW = f"few|more poses|{NEAR}"
ALONG = "drift|pose order|over the whole run|serial"
"""What names a unit, a sign, sds, a region too small, few poses, and errors along the run."""


@dataclass(frozen=True)
class Kind:
    """A kind of data set.

    clean: nothing is wrong with it; cause: what names its fault; placed: what happened concerns
    the instrument alone, so predictions are judged once they are placed on the fresh poses.
    """

    name: str
    world: World | Parallel
    clean: bool = False
    cause: str = ""
    placed: bool = False


def _sag(arm: Arm, rng: Rng) -> Arm:
    return replace(arm, yielding=2e-6, bending=6e-7)


def _gears(arm: Arm, rng: Rng) -> Arm:
    n = len(arm.links)
    phases = rng.uniform(0.0, 2.0 * np.pi, (2, n))
    sizes = np.full((2, n), [[4e-4], [2e-4]])
    return replace(arm, gears=np.column_stack([sizes[0], phases[0], sizes[1], phases[1]]))


def _backlash(arm: Arm, rng: Rng) -> Arm:
    return replace(arm, backlash=4e-4)


def worn_all_over(arm: Arm, rng: Rng) -> Arm:
    """A light arm that bends, with gears and backlash of its own."""
    bent = replace(_gears(arm, rng), yielding=2e-5, bending=6e-6)
    return replace(bent, backlash=2e-4)


def bending(arm: Arm, rng: Rng) -> Arm:
    return replace(arm, yielding=2e-5, bending=6e-6)


def _expanding(arm: Arm, rng: Rng) -> Arm:
    return replace(arm, expansion=2.4e-5)


def _warming(run: Run, rng: Rng) -> None:
    run.warmth += np.linspace(0.0, 15.0, len(run.warmth))


def _row(run: Run, rng: Rng) -> int:
    return int(rng.uniform(0.3, 0.7) * len(run.zero))


def _direction(rng: Rng) -> Array:
    way = rng.standard_normal(3)
    return way / np.linalg.norm(way)


def _slipped(run: Run, rng: Rng) -> None:
    run.target[_row(run, rng) :, 0] += 1e-3 * _direction(rng)


def _exchanged(run: Run, rng: Rng) -> None:
    run.target[_row(run, rng) :, 0] += np.array([0.0, 0.0, 12.7e-3])


def _moved(run: Run, rng: Rng) -> None:
    k = _row(run, rng)
    turn = turned_by(5e-4 * _direction(rng)[None])[0]
    run.turn[k:] = turn @ run.turn[k:]
    run.shift[k:] += 1e-3 * _direction(rng)


def _rezeroed(run: Run, rng: Rng) -> None:
    run.zero[_row(run, rng) :] += 3e-3


def _rezeroed_twice(run: Run, rng: Rng) -> None:
    third = len(run.zero) // 3
    run.zero[third:] += 3e-3
    run.zero[2 * third :] -= 2e-3


def _creeping(run: Run, rng: Rng) -> None:
    """A drift of a third of what is predicted anyway."""
    run.drift += np.linspace(0.0, 2e-5, len(run.drift))[:, None] * _direction(rng)


def _remastered(run: Run, rng: Rng) -> None:
    run.encoders[_row(run, rng) :, 1] += 0.05 * DEGREE


def _drifting(run: Run, rng: Rng) -> None:
    run.drift += np.linspace(0.0, 3e-4, len(run.drift))[:, None] * _direction(rng)


def wandering(persistence: float, sd: float) -> Callable[[Run, Rng], None]:
    """An instrument that drifts by AR(1), to this sd [m] of each coordinate."""

    def event(run: Run, rng: Rng) -> None:
        value = sd * rng.standard_normal(3)
        for row in run.drift:
            row += value
            fresh = sd * np.sqrt(1.0 - persistence**2) * rng.standard_normal(3)
            value = persistence * value + fresh

    return event


def _bad_corner(share: float, size: float) -> Callable[[Run, Rng], None]:
    def event(run: Run, rng: Rng) -> None:
        bad = rng.permutation(len(run.drift))[: int(share * len(run.drift))]
        run.drift[np.sort(bad)] += size * _direction(rng)

    return event


def _in_one_corner(run: Run, rng: Rng) -> None:
    """The first tenth of a path are neighbours."""
    run.drift[: len(run.drift) // 10] += 6e-5 * _direction(rng)


def _scaled(names: str, factor: float) -> Callable[[Readings, Rng], Readings]:
    def tamper(readings: Readings, rng: Rng) -> Readings:
        return {n: v * factor if n in names.split() else v for n, v in readings.items()}

    return tamper


def _swapped(one: str, other: str) -> Callable[[Readings, Rng], Readings]:
    return lambda readings, rng: readings | {one: readings[other], other: readings[one]}


def _shifted(readings: Readings, rng: Rng) -> Readings:
    """Points one row later than the joints."""
    points = {n: np.roll(v, 1)[1:] for n, v in readings.items() if n[0] != "q"}
    return {n: points.get(n, v[1:]) for n, v in readings.items()}


def _shuffled(readings: Readings, rng: Rng) -> Readings:
    order = rng.permutation(len(readings["q1"]))
    return {n: v if n[0] == "q" else v[order] for n, v in readings.items()}


def _copied(readings: Readings, rng: Rng) -> Readings:
    rows = np.concatenate([np.arange(len(readings["q1"])), rng.permutation(40)])
    return {n: v[rows] for n, v in readings.items()}


def _constant(readings: Readings, rng: Rng) -> Readings:
    return readings | {"z": np.full_like(readings["z"], readings["z"][0])}


def _quaternion_last(readings: Readings, rng: Rng) -> Readings:
    w, x, y, z = (readings[f"q{c}"] for c in "wxyz")
    return readings | {"qw": x, "qx": y, "qy": z, "qz": w}


def _inverted(readings: Readings, rng: Rng) -> Readings:
    from scipy.spatial.transform import Rotation

    R = Rotation.from_quat(np.column_stack([readings[f"q{c}"] for c in "xyzw"])).inv()
    p = -R.apply(np.column_stack([readings[c] for c in "xyz"]))
    x, y, z, w = R.as_quat().T
    turned = {"qw": w, "qx": x, "qy": y, "qz": z}
    return readings | turned | dict(zip("xyz", p.T, strict=True))


def _longer(nominal: dict[str, float]) -> dict[str, float]:
    return nominal | {"a_2": nominal["a_2"] + 0.05}


def _another_robot(nominal: dict[str, float]) -> dict[str, float]:
    return nominal | {"a_1": 0.0, "a_2": 0.27, "a_3": 0.07, "d_1": 0.29, "d_4": 0.302, "d_6": 0.072}


_TRACKER = World()
_ANONYMOUS = World(stated=None)
_WIRE = World(instrument="wire", sd=1e-4, poses=150)
_CAMERA = World(instrument="camera", sd=3e-4, poses=100)
_LONG = World(poses=150)
_PATH = World(poses=150, order="path")

CLEAN = (
    Kind("six axes, 80 poses", _TRACKER, True),
    Kind("six axes, no sd stated", _ANONYMOUS, True),
    Kind("six axes, 30 poses", World(poses=30), True),
    Kind("six axes, 300 poses", World(poses=300), True),
    Kind("six axes, 300 poses, no sd stated", World(poses=300, stated=None), True),
    Kind("six axes along a path", _PATH, True),
    Kind("six axes, sds learnt", World(learnt=True, stated=3.0), True),
    Kind("six axes, 20 poses", World(poses=20), True),
    Kind("UR", World("ur", poses=60), True),
    Kind("seven axes", World("seven", poses=100), True),
    Kind("SCARA", World("scara"), True),
    Kind("planar arm, 40 poses", World("planar", poses=40), True),
    Kind("three reflectors", World(instrument="three reflectors"), True),
    Kind("two trackers", World(instrument="two trackers", poses=100), True),
    Kind("draw-wire", _WIRE, True),
    Kind("camera", _CAMERA, True),
    Kind("hexapod", Parallel("hexapod"), True),
    Kind("hexapod, no sd stated", Parallel("hexapod", stated=None), True),
    Kind("delta", Parallel("delta"), True),
    Kind("five-bar", Parallel("five-bar"), True),
)
FAULTY = (
    Kind("points in mm", replace(_TRACKER, tamper=_scaled("x y z", 1e3)), cause=MM),
    Kind("points in inches", replace(_TRACKER, tamper=_scaled("x y z", 1 / 0.0254)), cause="inch"),
    Kind("points in cm", replace(_ANONYMOUS, tamper=_scaled("x y z", 1e2)), cause=CM),
    Kind(
        "one coordinate in mm",
        replace(_TRACKER, tamper=_scaled("z", 1e3)),
        cause=MM,
    ),
    Kind("wire in mm", replace(_WIRE, tamper=_scaled("wire", 1e3)), cause=MM),
    Kind(
        "joints in degrees",
        replace(_TRACKER, tamper=_scaled("q1 q2 q3 q4 q5 q6", 1 / DEGREE)),
        cause="degree",
    ),
    Kind(
        "gon taken as degrees",
        replace(_ANONYMOUS, tamper=_scaled("q1 q2 q3 q4 q5 q6", 200 / 180)),
        cause=r"\bgon\b",
    ),
    Kind("a joint reversed", replace(_TRACKER, tamper=_scaled("q5", -1.0)), cause=REVERSED),
    Kind(
        "three joints reversed",
        replace(_ANONYMOUS, tamper=_scaled("q2 q3 q5", -1.0)),
        cause=REVERSED,
    ),
    Kind("two joints exchanged", replace(_TRACKER, tamper=_swapped("q4", "q6")), cause="exchang"),
    Kind("x and y exchanged", replace(_TRACKER, tamper=_swapped("x", "y")), cause="exchang|handed"),
    Kind("left-handed frame", replace(_TRACKER, left_handed=True), cause="handed|mirror|revers"),
    Kind(
        "quaternion, w last",
        replace(_CAMERA, tamper=_quaternion_last),
        cause="quaternion|order",
    ),
    Kind("pose inverted", replace(_CAMERA, tamper=_inverted), cause="invers|invert"),
    Kind("points one row late", replace(_TRACKER, tamper=_shifted), cause=r"\brows?\b"),
    Kind("points shuffled", replace(_TRACKER, tamper=_shuffled), cause=r"\brows?\b|belong"),
    Kind("40 rows copied", replace(_TRACKER, tamper=_copied), cause="cop(y|ies)|duplicat"),
    Kind("a constant column", replace(_TRACKER, tamper=_constant), cause="constant|same value"),
    Kind("a length 50 mm off", replace(_TRACKER, believed=_longer), cause="a_2"),
    Kind(
        "another robot",
        replace(_TRACKER, believed=_another_robot),
        cause=r"robot|off the drawing|(off|from) its nominal",
    ),
    Kind("tool 150 mm off", replace(_TRACKER, tool=(0.0, 0.1, 0.11)), cause="tool_"),
    Kind("sds three times too small", replace(_LONG, stated=1 / 3), cause=SDS),
    Kind("sds three times too large", replace(_LONG, stated=3.0), cause=SDS),
    Kind("sds 1,000 times too large", replace(_TRACKER, stated=1e3), cause=SDS),
    Kind(
        "three reflectors, no sd stated",
        World(instrument="three reflectors", poses=150, stated=None),
        cause="share errors",
    ),
    Kind("small region", replace(_LONG, share=0.15), cause=NEAR),
    Kind("small region, sag", replace(_LONG, share=0.25, worn=_sag), cause=NEAR),
    Kind(
        "small region, sag, no sd stated",
        replace(_LONG, share=0.25, worn=_sag, stated=None),
        cause=NEAR,
    ),
    Kind("12 poses", World(poses=12), cause=FEW),
    Kind("12 poses, sds learnt", World(poses=12, learnt=True), cause=FEW),
    Kind("planar arm, 8 poses, sds learnt", World("planar", poses=8, learnt=True), cause=""),
    Kind("sag", replace(_LONG, worn=_sag), cause="gravity"),
    Kind("sag, no sd stated", replace(_LONG, worn=_sag, stated=None), cause="gravity"),
    Kind(
        "sag, 350 poses, no sd stated",
        World(poses=350, worn=_sag, stated=None),
        cause="gravity",
    ),
    Kind("UR, sag", World("ur", poses=80, worn=bending), cause="gravity"),
    Kind(
        "UR, sag, gears and backlash, no sd stated",
        World("ur", poses=120, worn=worn_all_over, stated=None),
        cause="gravity|gear|unexplained",
    ),
    Kind(
        "small region, sag, three reflectors",
        World("irb", "three reflectors", poses=60, share=0.25, worn=bending),
        cause=NEAR,
    ),
    Kind("gears", replace(_LONG, worn=_gears), cause="gear|harmonic"),
    Kind(
        "backlash",
        replace(_LONG, worn=_backlash),
        cause="backlash|gear|unexplained|" + SDS,
    ),
    Kind(
        "warming",
        replace(_LONG, worn=_expanding, event=_warming),
        cause=ALONG,
    ),
    Kind("reflector slipped", replace(_LONG, event=_slipped), cause="from pose .* target"),
    Kind("reflector exchanged", replace(_LONG, event=_exchanged), cause="from pose .* target"),
    Kind(
        "tracker moved",
        replace(_LONG, event=_moved),
        cause="from pose .* (instrument|base)",
        placed=True,
    ),
    Kind("wire zero shifted", replace(_WIRE, event=_rezeroed), cause="from pose .* zero"),
    Kind(
        "wire zero shifted twice, sag",
        World("irb", "wire", poses=120, sd=2e-4, worn=bending, event=_rezeroed_twice),
        cause="from pose .* zero",
    ),
    Kind("a drift too small to matter", World(poses=300, event=_creeping), placed=True),
    Kind(
        "joint mastered anew",
        replace(_LONG, event=_remastered),
        cause="from pose .* q2",
    ),
    Kind("drift", replace(_LONG, event=_drifting), cause=ALONG, placed=True),
    Kind(
        "drift along a path, AR(1) 0.95",
        replace(_PATH, event=wandering(0.95, 6e-5)),
        cause=ALONG,
        placed=True,
    ),
    Kind(
        "drift along a path, AR(1) 0.6",
        replace(_PATH, event=wandering(0.6, 3e-5)),
        cause=ALONG,
        placed=True,
    ),
    Kind("joints rounded to 0.1 degree", World(rounded=0.1 * DEGREE), cause="coarse|in steps of"),
    Kind(
        "neighbours off by 4 sds",
        replace(_PATH, event=_in_one_corner),
        cause="not fit|from pose|" + ALONG,
    ),
    Kind(
        "a quarter of the poses bad",
        replace(_LONG, event=_bad_corner(0.25, 6e-4)),
        cause="not fit",
    ),
    Kind("5 bad poses of 150", replace(_LONG, event=_bad_corner(0.034, 1e-3)), cause="not fit"),
)
KINDS = {kind.name: kind for kind in (*CLEAN, *FAULTY)}
