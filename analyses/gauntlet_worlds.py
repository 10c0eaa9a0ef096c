"""One data set of the gauntlet: a true machine, who measured it, and what a user then has.

The truth is `analyses.gauntlet_truth`. What a user states (drawing, sds) goes to loopcal; what
happened during the measurement, and what went wrong with the file, does not.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

import loopcal as lc
from analyses import gauntlet_truth as truth
from analyses.gauntlet_truth import Arm, Array, drawn, random_placement, turned_by
from loopcal.mechanisms.instruments.length import draw_wire
from loopcal.mechanisms.instruments.point import point
from loopcal.mechanisms.instruments.pose import pose
from loopcal.mechanisms.parallel.delta import linear_delta
from loopcal.mechanisms.parallel.five_bar import five_bar
from loopcal.mechanisms.parallel.stewart_gough import stewart_gough
from loopcal.mechanisms.serial import Joint, parameter_name, serial_machine

Readings = dict[str, Array]
Rng = np.random.Generator
TOOL = np.array([0.05, 0.03, 0.12])
"""Where the drawing puts the target, in the last frame [m]."""
MOUNTED, BUILT = 2e-3, (3e-4, 5e-4)
"""sd by which the target is mounted off the drawing [m]; by which lengths and angles are off."""
FRESH = 200
ARMS = {"six": truth.SIX, "seven": truth.SEVEN, "scara": truth.SCARA, "planar": truth.PLANAR}
ARMS |= {"ur": truth.UR, "irb": truth.IRB}


@dataclass(frozen=True, eq=False)
class Fresh:
    """Poses that nobody measured: readings as a controller has them, and true outputs (N, o).

    Machine and instrument stand as the measurement left them.
    """

    readings: Readings
    outputs: tuple[str, ...]
    true: Array


@dataclass(frozen=True, eq=False)
class Trial:
    """What a user has, and what only the gauntlet knows."""

    mechanism: lc.Mechanism
    readings: Readings
    noise: lc.Noise | None
    inside: Fresh
    outside: Fresh | None


@dataclass(eq=False)
class Run:
    """A measurement while it is made; events change it. One row per pose.

    R, o: body in the base; target (N, targets, 3) [m] in the body; station (N, 3, 3), (N, 3): base
    in the instrument's frame; zero (N,) of a wire [m]; encoders (N, n): errors of the joints;
    drift (N, 3) [m] of the instrument's coordinates; warmth (N,) [K].
    """

    target: Array
    turn: Array
    shift: Array
    zero: Array
    encoders: Array
    drift: Array
    warmth: Array


Event = Callable[[Run, Rng], None]


def nothing(run: Run, rng: Rng) -> None:
    """A measurement during which nothing happens."""


def sagging(arm: Arm, rng: Rng) -> Arm:
    return replace(arm, yielding=2e-6, bending=6e-7)


def geared(arm: Arm, rng: Rng) -> Arm:
    n = len(arm.links)
    phases = rng.uniform(0.0, 2.0 * np.pi, (2, n))
    sizes = np.full((2, n), [[4e-4], [2e-4]])
    return replace(arm, gears=np.column_stack([sizes[0], phases[0], sizes[1], phases[1]]))


def worn_all_over(arm: Arm, rng: Rng) -> Arm:
    """A light arm that bends, with gears and backlash of its own."""
    bent = replace(geared(arm, rng), yielding=2e-5, bending=6e-6)
    return replace(bent, backlash=2e-4)


def bending(arm: Arm, rng: Rng) -> Arm:
    return replace(arm, yielding=2e-5, bending=6e-6)


def _direction(rng: Rng) -> Array:
    way = rng.standard_normal(3)
    return way / np.linalg.norm(way)


def wandering(persistence: float, sd: float) -> Callable[[Run, Rng], None]:
    """An instrument that drifts by AR(1), to this sd [m] of each coordinate."""

    def event(run: Run, rng: Rng) -> None:
        value = sd * rng.standard_normal(3)
        for row in run.drift:
            row += value
            fresh = sd * np.sqrt(1.0 - persistence**2) * rng.standard_normal(3)
            value = persistence * value + fresh

    return event


def in_one_corner(run: Run, rng: Rng) -> None:
    """The first tenth of a path are neighbours."""
    run.drift[: len(run.drift) // 10] += 6e-5 * _direction(rng)


@dataclass(frozen=True, eq=False)
class World:
    """An arm, its instrument and a day.

    machine: of `ARMS`; instrument: "tracker", "three reflectors", "two trackers", "wire",
    "camera"; share: of each joint's range that is measured; sd [m], encoder [rad]: true noise;
    stated: factor of the sds that the user states, None if none are stated; worn: what the arm is
    beyond its geometry; event: what happens meanwhile; order: "random", "path" where poses follow
    one another closely, "sweep" where the first joint turns on and never back; learnt: whether the
    stated sds are only where learning begins.
    """

    machine: str = "six"
    instrument: str = "tracker"
    poses: int = 80
    share: float = 1.0
    sd: float = 1.5e-5
    encoder: float = 3e-5
    stated: float | None = 1.0
    worn: Callable[[Arm, Rng], Arm] = lambda arm, rng: arm
    event: Event = nothing
    order: str = "random"
    learnt: bool = False

    def made(self, rng: Rng, day: Rng | None = None) -> Trial:
        """One data set; day: draws all that is not the machine and what is mounted on it."""
        drawing = ARMS[self.machine]
        true = self.worn(drawing.perturbed(rng, *BUILT), rng)
        targets = 3 if self.instrument == "three reflectors" else 1
        places = np.array([TOOL, TOOL * [-1.5, 2.0, 0.8], TOOL * [0.5, -3.0, 1.2]])[:targets]
        if self.machine == "planar":
            places = places * 0.0
        mounted = places + MOUNTED * rng.standard_normal(places.shape) * (self.machine != "planar")
        rng = day or rng
        everywhere = truth.BOXES[self.machine]
        box = everywhere if self.share == 1.0 else truth.corner(everywhere, self.share, rng)
        stands = [random_placement(rng, 2.0) for _ in range(2)]
        if self.machine == "planar":
            stands = [(truth.turn(2, rng.uniform(-3.0, 3.0)), np.array([1.0, 0.5, 0.0]))] * 2
        anchor, zero = np.array([1.3, -0.4, 0.3]) + 0.02 * rng.standard_normal(3), 0.05

        def seen(q: Array, run: Run) -> Array:
            R, o = true.flange(q, run.warmth)
            p = o[:, None, :] + np.einsum("nij,nkj->nki", R, run.target)
            if self.instrument == "wire":
                lengths: Array = np.linalg.norm(p[:, :1] - anchor, axis=2) + run.zero[:, None]
                return lengths
            turned = np.einsum("nij,nkj->nki", run.turn, p)
            points: Array = turned + (run.shift + run.drift)[:, None]
            return np.reshape(points, (len(q), -1))

        def quiet(n: int) -> Run:
            R, s = stands[0]
            return Run(
                np.repeat(mounted[None], n, axis=0),
                np.repeat(R[None], n, axis=0),
                np.repeat(s[None], n, axis=0),
                np.full(n, zero),
                np.zeros((n, len(box))),
                np.zeros((n, 3)),
                np.zeros(n),
            )

        q = drawn(box, self.poses, rng)
        if self.order == "path":
            q = _along(box, self.poses, rng)
        if self.order == "sweep":
            q = q[np.argsort(q[:, 0])]
        run = quiet(self.poses)
        half = self.poses // 2
        if self.instrument == "two trackers":
            run.turn[half:], run.shift[half:] = stands[1]
        self.event(run, rng)

        def left(n: int) -> Run:
            """As the measurement left the machine: predictions hold after the last change."""
            return Run(
                np.repeat(run.target[-1:], n, axis=0),
                np.repeat(run.turn[-1:], n, axis=0),
                np.repeat(run.shift[-1:], n, axis=0),
                np.repeat(run.zero[-1:], n),
                np.repeat(run.encoders[-1:], n, axis=0),
                np.repeat(run.drift[-1:], n, axis=0),
                np.repeat(run.warmth[-1:], n),
            )

        measured = seen(q, run)
        measured = measured + self.sd * rng.standard_normal(measured.shape)
        names = self._names()
        readings = self._joints(q + run.encoders, rng)
        if self.instrument == "two trackers":
            gone = np.full((half, 3), np.nan)
            first = np.vstack([measured[:half], np.full((self.poses - half, 3), np.nan)])
            second = np.vstack([gone, measured[half:]])
            readings |= dict(zip(names, np.column_stack([first, second]).T, strict=True))
        elif self.machine == "planar":
            readings |= dict(zip(names, measured[:, :2].T, strict=True))
        else:
            readings |= dict(zip(names, measured.T, strict=True))
        if self.instrument == "camera":
            readings |= self._turned(true, q, run, mounted, rng)
        mechanism = self._mechanism(anchor + 0.03 * rng.standard_normal(3), places)

        def fresh(box: Array) -> Fresh:
            q = drawn(box, FRESH, rng)
            count = {"planar": 2}.get(self.machine, 1 if self.instrument == "wire" else 3)
            outputs = tuple(names[:count])
            now = quiet(FRESH) if self.event is nothing else left(FRESH)
            return Fresh(self._joints(q + now.encoders, rng), outputs, seen(q, now)[:, :count])

        return Trial(
            mechanism,
            readings,
            self._noise(mechanism),
            fresh(box),
            None if self.share == 1.0 else fresh(everywhere),
        )

    def _names(self) -> list[str]:
        if self.instrument == "wire":
            return ["wire"]
        if self.machine == "planar":
            return ["xP", "yP"]
        if self.instrument == "three reflectors":
            return [f"{c}{k}" for k in (1, 2, 3) for c in "xyz"]
        if self.instrument == "two trackers":
            return [f"{c}{k}" for k in (1, 2) for c in "xyz"]
        return ["x", "y", "z"]

    def _joints(self, q: Array, rng: Rng) -> Readings:
        sds = np.where([link.slides for link in ARMS[self.machine].links], 1e-5, self.encoder)
        read = q + sds * rng.standard_normal(q.shape)
        first = 2 if self.machine == "planar" else 1
        name = "phi" if self.machine == "planar" else "q"
        return {f"{name}{j + first}": read[:, j] for j in range(q.shape[1])}

    def _turned(
        self, true: Arm, q: Array, run: Run, mounted: Array, rng: Rng
    ) -> Mapping[str, Array]:
        from scipy.spatial.transform import Rotation

        R, _ = true.flange(q, run.warmth)
        seen = run.turn @ R @ turned_by(5e-4 * rng.standard_normal((len(q), 3)))
        x, y, z, w = Rotation.from_matrix(seen).as_quat().T
        return {"qw": w, "qx": x, "qy": y, "qz": z}

    def _mechanism(self, anchor: Array, places: Array) -> lc.Mechanism:
        if self.machine == "planar":
            return lc.planar_two_link({"l2": 0.8, "l3": 0.6})
        links = ARMS[self.machine].links
        joints, nominal = [], {}
        for i, link in enumerate(links, 1):
            form = "dh" if link.beta is None else "hayati"
            joints.append(Joint(f"q{i}", form, "prismatic" if link.slides else "revolute"))
            own = {"a": link.a, "d": link.d, "alpha": link.alpha, "offset": link.offset}
            if form == "hayati":
                own |= {"beta": 0.0}
                del own["d"]
            for key, value in own.items():
                nominal[parameter_name(form, key, i)] = value
        instruments = {
            "tracker": lambda: [point(readings=("x", "y", "z"))],
            "camera": lambda: [pose("camera", readings=("x", "y", "z"))],
            "wire": lambda: [draw_wire("wire", anchor="anchor")],
            "three reflectors": lambda: [
                point(f"r{k}", readings=(f"x{k}", f"y{k}", f"z{k}"), target=f"r{k}")
                for k in (1, 2, 3)
            ],
            "two trackers": lambda: [
                point(f"t{k}", readings=(f"x{k}", f"y{k}", f"z{k}"), station=f"s{k}")
                for k in (1, 2)
            ],
        }[self.instrument]()
        prefixes = ["r1", "r2", "r3"] if self.instrument == "three reflectors" else ["tool"]
        for prefix, place in zip(prefixes, places, strict=True):
            nominal |= {f"{prefix}_{c}": float(v) for c, v in zip("xyz", place, strict=True)}
        if self.instrument == "wire":
            nominal |= {f"anchor_{c}": float(v) for c, v in zip("xyz", anchor, strict=True)}
        made = lc.assemble(serial_machine(joints), instruments)
        known = {n: v for n, v in nominal.items() if n in made.parameters.names}
        return lc.fix_redundant(made.with_nominal(known))

    def _noise(self, mechanism: lc.Mechanism) -> lc.Noise | None:
        if self.stated is None:
            return None
        sds = {q: self.encoder if u == "rad" else self.sd for q, u in mechanism.quantities.items()}
        for i, link in enumerate(ARMS[self.machine].links, 1):
            if link.slides:
                sds[f"q{i}"] = 1e-5
        sds |= dict.fromkeys(mechanism.turns, 0.0005)
        stated: dict[Any, Any] = {q: self.stated * sd for q, sd in sds.items()}
        how = {}
        if self.learnt:
            joints = [q for q in sds if q[0] in "qp" and q not in mechanism.turns]
            outputs = list(mechanism.outputs)
            how = {tuple(joints): "group", tuple(outputs): "group"}
        return lc.Noise(stated, estimate=how) if how else lc.Noise(stated)


def _along(box: Array, poses: int, rng: Rng) -> Array:
    """Poses along a smooth path through a box: each joint goes to and fro at its own pace."""
    t = np.linspace(0.0, 1.0, poses)[:, None]
    pace = rng.uniform(2.0, 5.0, len(box))
    phase = rng.uniform(0.0, 2.0 * np.pi, len(box))
    middle, half = box.mean(axis=1), 0.5 * (box[:, 1] - box[:, 0])
    path: Array = middle + half * np.sin(2.0 * np.pi * pace * t + phase)
    return path


@dataclass(frozen=True)
class Parallel:
    """A parallel machine whose platform a tracker follows: "hexapod", "delta" or "five-bar"."""

    machine: str
    poses: int = 80
    sd: float = 1.5e-5
    stated: float | None = 1.0

    def made(self, rng: Rng) -> Trial:
        """One data set."""
        machine, box, solve = _PARALLEL[self.machine](rng)
        planar = self.machine == "five-bar"
        tool = np.array([0.06, 0.03, 0.0 if planar else 0.08])
        mounted = tool + MOUNTED * rng.standard_normal(3) * np.array([1, 1, 0 if planar else 1])
        if self.machine == "delta":
            mounted = tool
        turn, shift = random_placement(rng, 1.5)
        if planar:
            turn, shift = truth.turn(2, rng.uniform(-3, 3)), np.array([0.4, -0.3, 0.0])
        outputs = ("x", "y") if planar else ("x", "y", "z")
        mechanism = lc.assemble(machine, [point(readings=outputs, dimension=2 if planar else 3)])
        free = mechanism.parameters.names
        mechanism = mechanism.with_nominal(
            {f"tool_{c}": float(v) for c, v in zip("xyz", tool, strict=True) if f"tool_{c}" in free}
        )

        def world(n: int) -> Fresh:
            read, R, P = solve(drawn(box, n, rng))
            p = P + np.einsum("nij,j->ni", R, mounted)
            named = {
                q: v + (1e-5 if machine.quantities[q] == "m" else 3e-5) * rng.standard_normal(n)
                for q, v in read.items()
            }
            return Fresh(named, outputs, (p @ turn.T + shift)[:, : len(outputs)])

        measured = world(self.poses)
        noisy = measured.true + self.sd * rng.standard_normal(measured.true.shape)
        readings = measured.readings | dict(zip(outputs, noisy.T, strict=True))
        noise = None
        if self.stated is not None:
            sds: dict[Any, Any] = {
                q: self.stated * (3e-5 if u == "rad" else 1e-5)
                for q, u in mechanism.quantities.items()
            }
            sds |= dict.fromkeys(outputs, self.stated * self.sd)
            sds |= {q: np.inf for q in mechanism.quantities if q.startswith("platform_")}
            noise = lc.Noise(sds)
        return Trial(mechanism, readings, noise, world(FRESH), None)


Solved = tuple[Readings, NDArray[np.float64], NDArray[np.float64]]


def _hexapod(rng: Rng) -> tuple[lc.Machine, Array, Callable[[Array], Solved]]:
    a = truth.ring(0.50, (225, 315, 345, 75, 105, 195))
    b = truth.ring(0.30, (250, 290, 10, 50, 130, 170))
    off = BUILT[0] * rng.standard_normal((2, 6, 3))
    legs = truth.Hexapod(a + off[0], b + off[1], 0.55 + BUILT[0] * rng.standard_normal(6))
    box = np.array([[-0.1, 0.1], [-0.1, 0.1], [0.6, 0.8], [-0.4, 0.4], [-0.3, 0.3], [-0.3, 0.3]])

    def solve(c: Array) -> Solved:
        R = truth.turn(2, c[:, 3]) @ truth.turn(1, c[:, 4]) @ truth.turn(0, c[:, 5])
        read = legs.legs(R, c[:, :3])
        return {f"leg_{i + 1}": read[:, i] for i in range(6)}, R, c[:, :3]

    return stewart_gough(), box, solve


def _delta(rng: Rng) -> tuple[lc.Machine, Array, Callable[[Array], Solved]]:
    feet = truth.ring(0.14, (210, 330, 90)) + BUILT[0] * rng.standard_normal((3, 3)) * [1, 1, 0]
    rails = truth.Delta(feet, 0.30 + BUILT[0] * rng.standard_normal(3))
    box = np.array([[-0.07, 0.07], [-0.07, 0.07], [0.0, 0.2]])

    def solve(c: Array) -> Solved:
        read = rails.slides(c)
        return (
            {f"slide_{i + 1}": read[:, i] for i in range(3)},
            np.broadcast_to(np.eye(3), (len(c), 3, 3)),
            c,
        )

    return linear_delta(), box, solve


def _five_bar(rng: Rng) -> tuple[lc.Machine, Array, Callable[[Array], Solved]]:
    off = BUILT[0] * rng.standard_normal(8)
    bars = truth.FiveBar(
        np.array([[0.0, 0.0], [0.25, 0.0]]) + off[:4].reshape(2, 2),
        0.25 + off[4:6],
        0.35 + off[6:8],
    )
    box = np.array([[0.0, 0.25], [0.3, 0.5]])

    def solve(c: Array) -> Solved:
        angles, R = bars.angles(c), np.zeros((len(c), 3, 3))
        R[:, :2, :2], R[:, 2, 2] = bars.distal_frame(c), 1.0
        P = np.column_stack([c, np.zeros(len(c))])
        return {"theta_1": angles[:, 0], "theta_2": angles[:, 1]}, R, P

    return five_bar(), box, solve


_PARALLEL = {"hexapod": _hexapod, "delta": _delta, "five-bar": _five_bar}


SAGGING = World(poses=150, worn=sagging)
"""Arms that sag."""
