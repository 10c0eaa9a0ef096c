"""What a tree of bodies costs: one arm as a chain and as a tree, and a humanoid in one fit."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import learning
import numpy as np

import loopcal as lc

DEMANDED = 1.02
"""How many times the processor time of a chain the same arm may take as a tree."""
DEMANDED_HUMANOID = 5.0
"""Processor time [s] that a humanoid may take."""
TURNS = 25
FITS = {200: 20, 2_000: 4}
"""Poses of the arm, and how many fits are a turn: one alone is shorter than what else runs."""
POSES = 500
"""Of the humanoid."""
ROWS = ((60, 350, 90), (420, 0, 0), (50, 0, 90), (0, 400, -90), (0, 0, 90), (0, 100, 0))
"""a [mm], d [mm], alpha [deg] of the arm; its second row is Hayati's."""
LIMBS = {
    "torso": ("pelvis", 3, "0 0 0.1", "0 0 0.12"),
    "left": ("torso3", 7, "0 0.2 0.2", "0.02 0 -0.13"),
    "right": ("torso3", 7, "0 -0.2 0.2", "0.02 0 -0.13"),
    "head": ("torso3", 2, "0 0 0.3", "0 0 0.08"),
    "left_leg": ("pelvis", 6, "0 0.1 -0.1", "0.01 0 -0.2"),
    "right_leg": ("pelvis", 6, "0 -0.1 -0.1", "0.01 0 -0.2"),
}
"""Of the humanoid: what each limb hangs on, its joints, where it begins, and each further joint."""
SEEN = {"left": "front", "right": "front", "head": "front", "left_leg": "back", "right_leg": "back"}
"""Ends of limbs, each observed from a station."""


@dataclass(frozen=True)
class Trees:
    """ratios: of the times of a tree to those of a chain, by poses; parameters, seconds: of the
    humanoid, from its readings to the covariance."""

    ratios: Mapping[int, float]
    parameters: int
    seconds: float


def measure() -> Trees:
    """The arm in turns, so that a busy machine is fair to both, and the humanoid three times."""
    with TemporaryDirectory() as folder:
        pair = {kind: arm(Path(folder), kind) for kind in ("chain", "tree")}
        ratios = {poses: _ratio(pair, poses) for poses in FITS}
        robot = humanoid(Path(folder))
    seconds = min(learning.processor(fits(robot, POSES)) for _ in range(3))
    return Trees(ratios, len(robot.parameters.free), seconds)


def arm(folder: Path, kind: str) -> lc.Mechanism:
    """The arm as a "chain" or a "tree", with the same parameters."""
    lines = ["schema = 1", f'type = "{"tree" if kind == "tree" else "serial"}"']
    for i, (a, d, alpha) in enumerate(ROWS, 1):
        row = f'name = "q{i}", form = "{"hayati" if i == 2 else "dh"}", a = {a / 1e3}, '
        row += f"alpha = {np.radians(alpha)}" + (f", d = {d / 1e3}" if i != 2 else "")
        parent = i - 1 if i > 1 else "base"
        if kind == "tree":
            lines.append(f'[[body]]\nname = "{i}"\nparent = "{parent}"\nrow = {{ {row} }}')
        else:
            lines += ["[[joint]]", *row.split(", ")]
    lines[2:2] = ["fix_redundant = true"] if kind == "chain" else []
    lines.append('[[instrument]]\ntype = "point"')
    path = folder / f"{kind}.toml"
    path.write_text("\n".join(lines), encoding="utf-8")
    return lc.read_mechanism(path)


def humanoid(folder: Path) -> lc.Mechanism:
    """Of 31 joints, seen at five ends."""
    (folder / "humanoid.urdf").write_text("\n".join(_urdf()), encoding="utf-8")
    lines = ["schema = 1", 'type = "tree"', 'file = "humanoid.urdf"']
    for limb, station in SEEN.items():
        lines += ["[[instrument]]", 'type = "point"', f'name = "{limb}"']
        lines += [f'on = "{limb}{LIMBS[limb][1]}"', f'station = "{station}"']
        lines += [f'target = "{limb}_target"', f'readings = ["{limb}_x", "{limb}_y", "{limb}_z"]']
    lines += ["[parameters]", '"*_joint?_[xyz]" = { sd = 1e-3 }', '"*_joint?_r?" = { sd = 3e-3 }']
    path = folder / "humanoid.toml"
    path.write_text("\n".join(lines), encoding="utf-8")
    return lc.read_mechanism(path)


def _urdf() -> Iterator[str]:
    yield '<robot name="humanoid"><link name="pelvis"/>'
    for turn, (limb, (parent, joints, begins, further)) in enumerate(LIMBS.items()):
        for i in range(1, joints + 1):
            axis = " ".join("1" if (i + turn) % 3 == k else "0" for k in range(3))
            yield (
                f'<link name="{limb}{i}"/><joint name="{limb}_joint{i}" type="revolute">'
                f'<parent link="{parent if i == 1 else f"{limb}{i - 1}"}"/>'
                f'<child link="{limb}{i}"/>'
                f'<origin xyz="{begins if i == 1 else further}" rpy="0.02 0.01 -0.03"/>'
                f'<axis xyz="{axis}"/><limit lower="-1.5" upper="1.5"/></joint>'
            )
    yield "</robot>"


def readings(machine: lc.Mechanism, poses: int, off: float) -> tuple[lc.Dataset, lc.Noise]:
    """Of a machine off its drawing by `off` [m, rad], and the sds of its sensors."""
    rng = np.random.default_rng(1)
    free = [p for p in machine.parameters if not p.fixed]
    truth = {p.name: p.nominal + off * rng.standard_normal() for p in free}
    driven = lc.random_poses(dict.fromkeys(machine.joints, (-1.2, 1.2)), poses, seed=1)
    sds = {**dict.fromkeys(machine.joints, 5e-5), **dict.fromkeys(machine.outputs, 3e-5)}
    noise = lc.Noise(sds)
    return lc.simulate(machine, driven, noise=noise, seed=1, truth=truth).dataset, noise


def fits(machine: lc.Mechanism, poses: int) -> Callable[[], object]:
    """A fit up to its covariance, of a machine 1 mm and 1 mrad off its drawing."""
    data, noise = readings(machine, poses, 1e-3)
    return lambda: lc.calibrate(machine, data, noise=noise, method="implicit-loop").covariance


def _ratio(pair: Mapping[str, lc.Mechanism], poses: int) -> float:
    runs = {kind: fits(machine, poses) for kind, machine in pair.items()}
    for run in runs.values():
        run()  # traces the loops

    def turn(kind: str) -> float:
        return learning.processor(lambda: [runs[kind]() for _ in range(FITS[poses])])

    ratios = []
    for number in range(TURNS):
        order = sorted(runs, reverse=bool(number % 2))
        seconds = {kind: turn(kind) for kind in order}
        ratios.append(seconds["tree"] / seconds["chain"])
    return float(np.median(ratios))
