"""Does every instrument calibrate? Truth recovered, chi-squared, coverage and the identifiable set.

Simulated calibrations of a general six-axis arm, a planar arm and a Stewart-Gough platform, looked
at by each instrument in turn, and of arms described by joint origins and by exponentials. The fits
begin up to 1 mm and 1 mrad off, anchors up to 0.3 m, planes and centres up to 30 mm and 30 mrad.
Parameters that no data of this kind can tell apart are held, one of each set. Each setup counts how
often the 95 % interval of a parameter holds the truth, and compares chi-squared with its degrees of
freedom; `identifiable` is the rank found without holding anything, beside the number that the docs
derive.

    python -m analyses.instruments [--draws 500] [--processes 2] [--only WORD ...] [--write FILE.md]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import repeat
from math import pi
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import kstest

import loopcal as lc
from analyses.written import read_block, write_block
from loopcal.mechanisms.exponentials import ScrewJoint, exponentials
from loopcal.mechanisms.instruments.contact import ball_bar, plane, socket, sphere
from loopcal.mechanisms.instruments.length import distance, draw_wire, relative_distance
from loopcal.mechanisms.instruments.point import point
from loopcal.mechanisms.instruments.pose import pose
from loopcal.mechanisms.instruments.spherical import spherical
from loopcal.mechanisms.machine import Instrument, Machine, assemble
from loopcal.mechanisms.origins import LinkJoint, joint_chain
from loopcal.mechanisms.parallel.stewart_gough import stewart_gough
from loopcal.mechanisms.planar import planar_machine
from loopcal.mechanisms.redundancy import redundant
from loopcal.mechanisms.serial import serial_machine

Array = NDArray[np.float64]
SIGMAS = 1.959963984540054
ARM = {
    "a": (0.15, 0.61, 0.20, 0.01, 0.03, 0.01),
    "d": (0.45, 0.02, 0.01, -0.64, 0.01, 0.20),
    "alpha": (-pi / 2, 0.4, -pi / 2, pi / 2, pi / 2, 0.1),
    "offset": (0.1, -pi / 2, 0.02, 0.0, -pi / 2, 0.3),
}
"""A six-axis arm without parallel axes, whose parameters data tell apart as far as any arm's."""
TOOL = {"tool_x": 0.05, "tool_y": -0.02, "tool_z": 0.15}
JOINTS = tuple(f"q{i}" for i in range(1, 7))
STATION = {"x": 2.6, "y": -0.9, "z": 0.4, "rz": 0.7, "ry": 0.2, "rx": -0.1}
FIRST = ("d_1", "offset_1")
"""Of the arm: they move it along and about its first axis, as the base's frame does."""
LAST = ("a_6", "d_6", "alpha_6", "offset_6")
"""Of the arm: they move the last frame, as the tool in it does."""
SIZE = "a_2"
"""The length that is known where none is measured."""
TO_A_SIDE = (0.18, 0.40, 0.13, -0.70, -0.77, 0.07)
ON_A_PLANE = (0.03, 1.26, -1.00, 1.26, -0.53, -0.21)
IN_A_SOCKET = (-1.165, -0.744, 0.843, 0.231, -1.139, -0.188)
"""Joints of an arm in reach of what it touches."""
X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
SIX = (
    LinkJoint("q1", "revolute", (0, 0, 0.4), axis=Z),
    LinkJoint("q2", "revolute", (0.15, 0, 0.05), axis=Y),
    LinkJoint("q3", "revolute", (0, 0, 0.6), (0, pi / 2, 0), axis=Y),
    LinkJoint("q4", "revolute", (-0.12, 0, 0.3), axis=Z),
    LinkJoint("q5", "revolute", (0, 0, 0.34), axis=Y),
    LinkJoint("q6", "continuous", (0, 0, 0.1), axis=Z),
    LinkJoint("flange", "fixed", (0, 0, 0.02)),
)
"""Six revolute joints, the second and the third parallel, one origin pitched by 90 degrees."""
SLIDES = (
    LinkJoint("s1", "prismatic", (0.2, 0, 0.1), axis=X),
    LinkJoint("s2", "prismatic", (0, 0, 0.3), axis=(0, 0.6, 0.8)),
    LinkJoint("r1", "revolute", (0.1, 0, 0.2), (0, 0.3, 0), axis=Z),
    LinkJoint("r2", "revolute", (0.3, 0.1, 0), axis=X),
    LinkJoint("r3", "revolute", (0.3, 0, 0), axis=Y),
)
"""Two prismatic joints, one of them along no coordinate axis, and three revolute ones."""
SCREWS = (
    ScrewJoint("q1", Z, (0, 0, 0)),
    ScrewJoint("q2", Y, (0.15, 0, 0.45)),
    ScrewJoint("q3", Y, (0.15, 0, 1.05)),
    ScrewJoint("q4", X, (0, 0, 0.93)),
    ScrewJoint("q5", Y, (0.79, 0, 0.93)),
    ScrewJoint("q6", X, (0, 0, 0.93)),
)
HOME = ((0.91, 0.0, 0.93), (0.0, pi / 2, 0.0))
EXACT = lc.Noise({"*": 0.0})


@dataclass(frozen=True)
class Setup:
    """One machine with an instrument, as its truth, in poses.

    held: parameters that stay at their true values, one of each set that no data of this kind can
    tell apart; identifiable: how many parameters the docs say there are; driven: quantity -> (N,)
    true values; start: where the search for other quantities begins; rough: parameters whose
    nominal values are `far` [m, rad] off.
    """

    truth: lc.Mechanism
    held: tuple[str, ...]
    identifiable: int
    driven: Mapping[str, Array]
    start: Mapping[str, Any] = field(default_factory=dict)
    rough: tuple[str, ...] = ()
    far: float = 0.03

    @property
    def noise(self) -> lc.Noise:
        """20 um and 50 urad, whatever is read; what nobody reads is unmeasured."""
        sds = {q: {"m": 2e-5, "rad": 5e-5}[u] for q, u in self.truth.quantities.items()}
        return lc.Noise(sds | dict.fromkeys(self.unread, np.inf))

    @property
    def unread(self) -> tuple[str, ...]:
        """Where a platform stands."""
        return tuple(q for q in self.truth.quantities if q.startswith("platform_"))

    def nominal(self, seed: int) -> lc.Mechanism:
        """The machine as drawn: 1 mm and 1 mrad off, rough parameters further."""
        rng = np.random.default_rng([3, seed])
        off = {
            p.name: p.nominal + rng.uniform(-1, 1) * (self.far if p.name in self.rough else 1e-3)
            for p in self.truth.parameters
            if not p.fixed and p.name not in self.held
        }
        return self.truth.with_nominal(off)


def six_axis() -> Machine:
    return serial_machine([lc.Joint(q) for q in JOINTS], name="six-axis arm")


ARM_VALUES = {f"{k}_{i}": v for k, row in ARM.items() for i, v in enumerate(row, 1)} | TOOL
LINKS = {"l2": 0.8, "l3": 0.6, "phi20": 0.1, "phi30": -0.2}


def placed(name: str, dimension: int = 3) -> dict[str, float]:
    """Values of a station."""
    keys = tuple(STATION) if dimension == 3 else ("x", "y", "rz")
    return {f"{name}_{key}": STATION[key] for key in keys}


def at(name: str, *coordinates: float) -> dict[str, float]:
    """Values of a point."""
    return {f"{name}_{axis}": float(v) for axis, v in zip("xyz", coordinates, strict=False)}


def looked_at(
    instruments: Sequence[Instrument],
    values: Mapping[str, float],
    identifiable: int,
    *,
    held: Sequence[str] = (),
    rough: Sequence[str] = (),
) -> Setup:
    """The arm in any poses."""
    truth = assemble(six_axis(), instruments, ARM_VALUES | dict(values))
    driven = lc.random_poses(dict.fromkeys(JOINTS, (-1.6, 1.6)), 100, seed=11)
    if truth.tape.quantities[len(JOINTS)].endswith("_b"):
        driven |= {f"{q}_b": 0.9 * v[::-1] for q, v in driven.items()}
    return Setup(truth, (*LAST, *held), identifiable, driven, rough=tuple(rough), far=0.3)


def touching(
    make: Callable[[Array], tuple[Instrument, dict[str, float]]],
    identifiable: int,
    *,
    held: Sequence[str] = (SIZE,),
    about: Sequence[float] = TO_A_SIDE,
    solved: Sequence[str] = ("q2",),
) -> Setup:
    """The arm in poses in which it touches something, some of its joints solved for."""
    reach = assemble(six_axis(), [point(station=None)], ARM_VALUES)
    there = {q: np.array([v]) for q, v in zip(JOINTS, about, strict=True)}
    exact = lc.simulate(reach, there, noise=EXACT, seed=0)
    instrument, values = make(np.array([exact.quantities[axis][0] for axis in "xyz"]))
    truth = assemble(six_axis(), [instrument], ARM_VALUES | values)
    rng = np.random.default_rng(5)
    joints = {q: v + rng.uniform(-0.4, 0.4, 120) for q, v in there.items()}
    start = {q: joints.pop(q) for q in solved}
    return Setup(truth, (*LAST, *FIRST, *held), identifiable, joints, start, tuple(values))


def chain(machine: Machine, instrument: Instrument, identifiable: int) -> Setup:
    """A machine of joint origins or exponentials, redundant parameters held as files hold them."""
    truth = assemble(machine, [instrument], placed("base") | TOOL)
    first = [*instrument.placement, *instrument.parameters]
    held = tuple(r.parameter for r in redundant(truth, first=first))
    ranges = {q: (-1.6, 1.6) if u == "rad" else (-0.3, 0.3) for q, u in machine.quantities.items()}
    return Setup(truth, held, identifiable, lc.random_poses(ranges, 100, seed=11))


def in_plane(
    instrument: Instrument,
    values: Mapping[str, float],
    identifiable: int,
    held: Sequence[str] = (),
    solved: Mapping[str, float] | None = None,
) -> Setup:
    """The two links, whose last link holds the tool."""
    truth = assemble(planar_machine(), [instrument], LINKS | dict(values))
    start = dict(solved or {})
    ranges = {q: (-0.4, 0.4) if start else (-2.5, 2.5) for q in ("phi2", "phi3") if q not in start}
    driven = lc.random_poses(ranges, 60, seed=11)
    return Setup(truth, ("tool_x", "tool_y", *held), identifiable, driven, start)


def on_legs(
    instrument: Instrument, values: Mapping[str, float], identifiable: int, poses: int = 80
) -> Setup:
    """The Stewart-Gough platform, moved through its space; its own rules hold both frames."""
    truth = assemble(stewart_gough(), [instrument], values)
    far = {"platform_z": (0.6, 0.8)} | dict.fromkeys(("platform_x", "platform_y"), (-0.1, 0.1))
    turned = dict.fromkeys(("platform_rz", "platform_ry", "platform_rx"), (-0.35, 0.35))
    return Setup(truth, (), identifiable, lc.random_poses(far | turned, poses, seed=11))


def _near(p: Array) -> dict[str, float]:
    return at("centre", *(p + np.array([0.44, 0.08, -0.07])))


def _tilted(p: Array) -> tuple[Instrument, dict[str, float]]:
    normal = np.array([0.3, 0.4, 1.0]) / np.linalg.norm([0.3, 0.4, 1.0])
    return plane(normal=[0.3, 0.4, 1.0]), {"plane_distance": float(normal @ p)}


RADIUS = float(np.linalg.norm([0.44, 0.08, -0.07]))
WIRE = at("wire", 1.5, 0.8, -0.3)
TWO = [spherical("T1"), spherical("T2", target="other")]
SETUPS: dict[str, Callable[[], Setup]] = {
    "six-axis point": lambda: looked_at([point()], placed("base"), 27, held=FIRST),
    "six-axis spherical": lambda: looked_at([spherical("T")], placed("T"), 27, held=FIRST),
    "six-axis two trackers, two reflectors": lambda: looked_at(
        TWO, placed("T1") | placed("T2") | {"T2_y": 2.0, "other_y": 0.1}, 36, held=FIRST
    ),
    "six-axis spherical offsets": lambda: looked_at(
        [spherical("T", offsets=True)], placed("T"), 29, held=FIRST
    ),
    "six-axis pose": lambda: looked_at([pose()], placed("base"), 30, held=FIRST),
    "six-axis distance": lambda: looked_at(
        [distance("wire")], WIRE, 24, held=FIRST, rough=tuple(WIRE)
    ),
    "six-axis draw-wire": lambda: looked_at(
        [draw_wire()], WIRE, 25, held=FIRST, rough=(*WIRE, "wire_offset")
    ),
    "six-axis relative distance": lambda: looked_at([relative_distance()], {}, 21, held=FIRST),
    "six-axis ball-bar": lambda: touching(
        lambda p: (ball_bar(centre="centre"), _near(p) | {"bar_length": RADIUS}),
        24,
        held=("bar_length",),
    ),
    "six-axis sphere": lambda: touching(
        lambda p: (sphere(centre="centre"), _near(p) | {"sphere_radius": RADIUS}), 24
    ),
    "six-axis plane": lambda: touching(_tilted, 23, about=ON_A_PLANE, solved=("q3",)),
    "six-axis socket": lambda: touching(
        lambda p: (socket(), at("socket", *p)), 23, about=IN_A_SOCKET, solved=JOINTS[:3]
    ),
    "two-link point": lambda: in_plane(point(readings=("x", "y"), dimension=2), {}, 6, ["phi20"]),
    "two-link spherical": lambda: in_plane(
        spherical("T", dimension=2), placed("T", 2), 6, ["phi20"]
    ),
    "two-link pose": lambda: in_plane(pose(dimension=2), placed("base", 2), 7, ["phi20"]),
    "two-link draw-wire": lambda: in_plane(
        draw_wire(dimension=2), at("wire", 1.5, 0.8), 6, ["phi20"]
    ),
    "two-link relative distance": lambda: in_plane_twice(),
    "two-link line": lambda: in_plane(
        plane(normal=[0.0, 1.0, 0.0], dimension=2),
        {"plane_distance": 0.3},
        4,
        ["phi20", "l2"],
        {"phi3": 1.2},
    ),
    "origins point": lambda: chain(joint_chain(SIX), point(), 27),
    "origins pose": lambda: chain(joint_chain(SIX), pose(), 30),
    "origins and axes pose": lambda: chain(joint_chain(SIX, axes=True), pose(), 30),
    "origins, two prismatic, point": lambda: chain(joint_chain(SLIDES), point(), 19),
    "exponentials point": lambda: chain(exponentials(SCREWS, home=HOME), point(), 27),
    "exponentials pose": lambda: chain(exponentials(SCREWS, home=HOME), pose(), 30),
    "platform pose": lambda: on_legs(pose(), placed("base") | at("tool", 0.02, 0.01, 0.1), 42),
    "platform point": lambda: on_legs(point(), placed("base") | at("tool", 0.02, 0.01, 0.1), 39),
    "platform draw-wire": lambda: on_legs(
        draw_wire(), at("wire", 0.9, 0.5, 1.4) | at("tool", 0.02, 0.01, 0.1), 37, poses=300
    ),
}


def in_plane_twice() -> Setup:
    made = in_plane(relative_distance(dimension=2), {}, 3, ["phi20"])
    again = {f"{q}_b": 0.9 * v[::-1] for q, v in made.driven.items()}
    return replace(made, driven={**made.driven, **again})


@cache
def setup(name: str) -> Setup:
    return SETUPS[name]()


def identifiable(name: str) -> int:
    """Rank at the truth in exact poses, nothing held but what the machine's own rules hold."""
    given = setup(name)
    size = [n for n in (SIZE, "l2") if n in given.held]
    size += ["bar_length"] if "bar_length" in given.held else []
    made = lc.simulate(given.truth, given.driven, noise=EXACT, seed=0, start=given.start)
    free = given.truth.with_parameters(given.truth.parameters.with_fixed(size))
    readings = {q: v for q, v in made.dataset.readings.items() if q not in given.unread}
    found = lc.calibrate(free, readings, noise=given.noise, start="nominal", method="implicit-loop")
    return found.identifiability.rank


@dataclass(frozen=True)
class Counts:
    """Of some draws: held, 1 where an interval held the truth; factors, chi-squared by freedom."""

    held: Array
    factors: Array
    p_values: Array
    iterations: Array
    freedom: int


def run(name: str, seeds: Sequence[int]) -> Counts:
    """Calibrations of a setup, one for each seed."""
    given = setup(name)
    held, factors, p_values, iterations, freedom = [], [], [], [], 0
    true = {p.name: p.nominal for p in given.truth.parameters}
    for seed in seeds:
        made = lc.simulate(
            given.truth, given.driven, noise=given.noise, seed=seed, start=given.start
        )
        start = given.nominal(seed)
        start = start.with_parameters(start.parameters.with_fixed(given.held))
        found = lc.calibrate(start, made.dataset, noise=given.noise, method="implicit-loop")
        chi = found.chi_squared
        assert found.status.converged, (name, seed, found.status)
        assert chi is not None
        assert chi.p_value is not None
        held.append(
            [
                abs(found.value[n] - true[n]) <= SIGMAS * (found.sd[n] or 0.0)
                for n in found.estimated
            ]
        )
        factors.append(chi.value / chi.degrees_of_freedom)
        p_values.append(chi.p_value)
        iterations.append(found.status.iterations)
        freedom = chi.degrees_of_freedom
    return Counts(
        1.0 * np.array(held),
        np.array(factors),
        np.array(p_values),
        np.array(iterations),
        freedom,
    )


def line(name: str, parts: Sequence[Counts]) -> str:
    held, factors, p_values, iterations = (
        np.concatenate([getattr(c, key) for c in parts])
        for key in ("held", "factors", "p_values", "iterations")
    )
    spread = held.mean(axis=1).std(ddof=1) / np.sqrt(len(held))
    mean = factors.std(ddof=1) / np.sqrt(len(factors))
    single = 100 * held.mean(axis=0)
    return (
        f"{name:38} {identifiable(name):3} {setup(name).identifiable:3}"
        f"  {factors.mean():.4f} +- {mean:.4f}  {100 * held.mean():5.2f} +- {100 * spread:.2f}"
        f"  {single.min():5.1f} {single.max():5.1f}  {kstest(p_values, 'uniform').pvalue:5.3f}"
        f"  {iterations.mean():4.1f}"
    )


HEAD = (
    f"{'machine and instrument':37} rank    chi-squared by    95 % intervals         p      steps\n"
    f"{'':37} found due  freedom          hold           least most   uniform"
)


def written(path: Path, lines: Mapping[str, str]) -> None:
    """Put the lines of some setups into the block of a document, beside those it has of others."""
    old = read_block(path, "instruments").splitlines()
    known = {name: row for name in SETUPS for row in old if row.startswith(f"{name} ".ljust(39))}
    merged = known | dict(lines)
    rows = [merged[name] for name in SETUPS if name in merged]
    write_block(path, "instruments", "\n".join([HEAD, *rows]))


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--draws", type=int, default=500)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--only", nargs="+", default=[])
    parser.add_argument("--write", type=Path)
    given = parser.parse_args()
    print(f"{given.draws} draws\n{HEAD}")
    parts = [range(i, given.draws, given.processes) for i in range(given.processes)]
    lines = {}
    with ProcessPoolExecutor(given.processes) as pool:
        for name in (n for n in SETUPS if {*given.only} <= {*n.split()}):
            lines[name] = line(name, list(pool.map(run, repeat(name), parts)))
            print(lines[name], flush=True)
    if given.write:
        written(given.write, lines)


if __name__ == "__main__":
    main()
