"""Sds learnt where that is long: three reflectors on a six-axis arm, validated in ten folds.

The same readings with one joint in the wrong unit are a fit that cannot end well, and should end
soon: degrees that the caller insists are radians (refused before the fit otherwise), and gons taken
as degrees, which look like any angle.
"""

from __future__ import annotations

import resource
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

import loopcal as lc

POSES, FOLDS, REFLECTORS = 1_000, 10, 3
DEMANDED_FOLDS, DEMANDED_WRONG = 20.0, 10.0
"""Processor seconds allowed to the validation of learnt sds, and to a joint in the wrong unit."""
JOINT_SD, POINT_SD = 50e-6, 30e-6


@dataclass(frozen=True)
class Learning:
    """Processor time [s] of one case, and how often a plain fit fits into it."""

    case: str
    seconds: float
    ratio: float
    demanded: float | None


def measure() -> list[Learning]:
    """Every case once, after a plain fit of the same readings with stated sds."""
    machine = arm()
    read = readings(machine)
    columns = {name: np.array(read[name]) for name in read.quantities}
    wrongs = {"degrees": np.degrees(columns["q4"]), "gons": columns["q4"] / 0.9}
    stated = lc.Noise({"q*": JOINT_SD, **dict.fromkeys(["x?", "y?", "z?"], POINT_SD)})
    learnt, with_model = _learnt(model=False), _learnt(model=True)

    def plain() -> object:
        return lc.calibrate(machine, read, noise=stated, method="implicit-loop")

    cases: dict[str, tuple[Callable[[], object], float | None]] = {
        "sds stated": (plain, None),
        "all sds learnt": (
            lambda: str(lc.calibrate(machine, read, noise=learnt, method="implicit-loop")),
            None,
        ),
        f"all sds learnt, {FOLDS} folds": (
            lambda: lc.validate(
                machine, read, noise=learnt, folds=FOLDS, seed=1, method="implicit-loop"
            ),
            DEMANDED_FOLDS,
        ),
        f"the same and `model`, {FOLDS} folds": (
            lambda: lc.validate(
                machine, read, noise=with_model, folds=FOLDS, seed=1, method="implicit-loop"
            ),
            None,
        ),
    }
    for unit, q4 in wrongs.items():
        for words, noise in (("stated", stated), ("learnt", learnt)):
            case = f"a joint in the wrong unit ({unit}), sds {words}"
            cases[case] = (_hopeless(machine, columns | {"q4": q4}, noise), DEMANDED_WRONG)
    plain()  # traces the loops
    once = min(processor(plain) for _ in range(5))
    return [
        Learning(name, seconds, seconds / once, demanded)
        for name, (run, demanded) in cases.items()
        for seconds in [processor(run)]
    ]


def processor(run: Callable[[], object]) -> float:
    """Processor time [s] of one run, with that of its processes."""
    begin = _used()
    run()
    return _used() - begin


def _used() -> float:
    both = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in both)


def _hopeless(
    machine: lc.Mechanism, columns: dict[str, np.ndarray], noise: lc.Noise
) -> Callable[[], object]:
    """A calibration of columns whose fourth joint the caller insists is in radians."""
    return lambda: lc.calibrate(
        machine, columns, noise=noise, units={"q4": "rad"}, method="implicit-loop"
    )


def arm() -> lc.Mechanism:
    """A six-axis arm with three reflectors on its flange, seen by one tracker."""
    joints = [lc.Joint(f"q{i}", form="hayati" if i == 2 else "dh") for i in range(1, 7)]
    lengths = {"d_1": 0.4, "a_1": 0.08, "a_2": 0.45, "a_3": 0.06, "d_4": 0.42, "d_6": 0.1}
    twists = dict(zip(("alpha_1", "alpha_3", "alpha_4", "alpha_5"), (-1, -1, 1, -1), strict=True))
    nominal = lengths | {name: sign * np.pi / 2 for name, sign in twists.items()}
    places = np.array([[0.05, 0.0, 0.1], [-0.03, 0.05, 0.1], [-0.03, -0.05, 0.12]])
    for number, place in enumerate(places, 1):
        nominal |= dict(zip((f"r{number}_{a}" for a in "xyz"), place.tolist(), strict=True))
    seen = [
        lc.instruments.point(
            f"seen_{i}", readings=_coordinates(i), station="tracker", target=f"r{i}"
        )
        for i in range(1, REFLECTORS + 1)
    ]
    return lc.fix_redundant(lc.assemble(lc.machines.serial(joints), seen, nominal))


def _coordinates(number: int) -> tuple[str, str, str]:
    return (f"x{number}", f"y{number}", f"z{number}")


def readings(arm: lc.Mechanism) -> lc.Dataset:
    """Simulated readings of that arm, a millimetre and a milliradian off its drawing."""
    rng = np.random.default_rng(1)
    free = [p for p in arm.parameters if not p.fixed]
    truth = {p.name: p.nominal + 1e-3 * rng.standard_normal() for p in free}
    truth |= {"tracker_x": 1.5, "tracker_y": -0.5, "tracker_rz": 0.7}
    driven = lc.random_poses({f"q{i}": (-1.5, 1.5) for i in range(1, 7)}, POSES, seed=1)
    noise = lc.Noise({"q*": JOINT_SD, **dict.fromkeys(["x?", "y?", "z?"], POINT_SD)})
    return lc.simulate(arm, driven, noise=noise, seed=1, truth=truth).dataset


def _learnt(*, model: bool) -> lc.Noise:
    """Every encoder and reflector for itself, from sds that are off by two thirds."""
    sds = {"q*": 30e-6, **dict.fromkeys(["x?", "y?", "z?"], 50e-6)}
    estimate: dict[str | tuple[str, ...], str] = {"q*": "each"}
    estimate |= {_coordinates(i): "group" for i in range(1, REFLECTORS + 1)}
    if model:
        sds["model"], estimate["model"] = 10e-6, "group"
    return lc.Noise(sds, estimate=estimate)


if __name__ == "__main__":
    for found in measure():
        print(found)
