"""Machines as they truly are over their lives, and the files that a user has of them.

An arm is that of `analyses.gauntlet_truth`, built off its drawing. Nothing here is loopcal's code.
Lengths are m, angles rad, masses kg; a pose is a row.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from analyses import gauntlet_truth as truth
from analyses.gauntlet_truth import Arm, Array, drawn, random_placement

Rng = np.random.Generator
DEGREE = np.pi / 180.0
TOOL = np.array([0.05, 0.03, 0.12])
"""Where the drawing puts the reflector, in the last frame [m]."""
MOUNTED = 2e-3
"""sd by which the reflector is mounted off the drawing [m]."""
ZEROS, TWISTS, LENGTHS = (0.1 * DEGREE, 0.6 * DEGREE), (5e-4, 2e-3), (1e-4, 1e-3)
"""Ranges of a machine's sds off the drawing [rad, rad, m], as trust.md asks for."""
CARRIED = 3.0
"""Mass at the flange on the day of the calibration [kg]."""
ARMS = {"six": truth.SIX, "irb": truth.IRB, "ur": truth.UR}
WEAR = ("rigid", "sagging", "sagging with gears", "sagging with backlash")
ORDERS = ("random", "sorted", "raster")


@dataclass(eq=False)
class Conditions:
    """How machine and instrument are while a file is measured.

    target (N, 3) [m] in the last frame; drift (N, 3) [m] of the instrument; warmth (N,) [K];
    arm: the machine of this day; loose: sd [m] by which the target lies elsewhere at each pose.
    """

    arm: Arm
    target: Array
    drift: Array
    warmth: Array
    loose: float = 0.0


@dataclass(frozen=True, eq=False)
class Machine:
    """A machine of the fleet: its drawing, what was built, and how it is measured.

    tracker [m], encoder [rad]: sds of the noise; described: "dh" or "urdf".
    """

    number: int
    family: str
    wear: str
    order: str
    described: str
    drawing: Arm
    arm: Arm
    box: Array
    target: Array
    poses: int
    tracker: float
    encoder: float
    joints: tuple[str, ...] = field(default=())

    @property
    def sags(self) -> bool:
        return self.arm.yielding > 0.0

    def conditions(self, poses: int) -> Conditions:
        """The machine as it was calibrated, measured by an instrument that stands still."""
        return Conditions(
            self.arm, np.tile(self.target, (poses, 1)), np.zeros((poses, 3)), np.zeros(poses)
        )

    def points(self, q: Array, conditions: Conditions) -> Array:
        """Where the reflector truly is in the base (N, 3), with the instrument's drift."""
        R, o = conditions.arm.flange(q, conditions.warmth)
        p: Array = o + np.einsum("nij,nj->ni", R, conditions.target) + conditions.drift
        return p

    def posed(self, poses: int, rng: Rng) -> Array:
        """Joints (N, n) in the order in which this machine's user measures."""
        q = drawn(self.box, poses, rng)
        if self.order == "sorted":
            return q[np.argsort(q[:, 0])]
        if self.order == "raster":
            low, high = self.box[0]
            row = np.floor(5.0 * (q[:, 0] - low) / (high - low))
            to_and_fro = np.where(row % 2 == 0.0, q[:, 1], -q[:, 1])
            return q[np.lexsort((to_and_fro, row))]
        return q

    def measured(self, q: Array, conditions: Conditions, rng: Rng) -> tuple[Array, Array]:
        """Recorded joints (N, n) and points (N, 3), from wherever the instrument stands."""
        R, shift = random_placement(rng, 2.0)
        p = self.points(q, conditions) @ R.T + shift
        return (
            q + self.encoder * rng.standard_normal(q.shape),
            p + self.tracker * rng.standard_normal(p.shape),
        )

    def description(self, folder: Path) -> list[str]:
        """Write what the user has of the machine; the options by which `init` reads it."""
        if self.described == "urdf":
            (folder / "robot.urdf").write_text(urdf(self.drawing, self.box, self.joints))
            return ["--urdf", "robot.urdf"]
        (folder / "dh.csv").write_text(dh_table(self.drawing))
        return ["--dh", "dh.csv"]


def machine(number: int) -> Machine:
    """A machine of the fleet, the same for a number every time."""
    rng = np.random.default_rng([41, number])
    family = tuple(ARMS)[number % len(ARMS)]
    wear = WEAR[number % len(WEAR)]
    drawing = replace(ARMS[family], tool_mass=CARRIED)
    described = ("dh", "urdf")[number // 3 % 2]
    arm = built(drawing, rng)
    if wear != "rigid":
        soft = 10.0 ** rng.uniform(-5.7, -5.0)
        arm = replace(arm, yielding=soft, bending=0.3 * soft)
    if wear.endswith("gears"):
        arm = replace(arm, gears=_gears(len(arm.links), rng))
    if wear.endswith("backlash"):
        arm = replace(arm, backlash=rng.uniform(1e-4, 3e-4))
    return Machine(
        number,
        family,
        wear,
        ORDERS[(number // 2) % len(ORDERS)],
        described,
        drawing,
        replace(arm, expansion=1.2e-5),
        truth.BOXES[family],
        TOOL + MOUNTED * rng.standard_normal(3),
        int(rng.integers(60, 151)),
        rng.uniform(1e-5, 3e-5),
        10.0 ** rng.uniform(-5.0, -4.3),
        tuple(f"J{j}" for j in range(1, len(arm.links) + 1)),
    )


def built(drawing: Arm, rng: Rng) -> Arm:
    """The arm as it was built: zeros, twists and lengths each off by a size of their own."""
    zero, twist, length = (rng.uniform(*sizes) for sizes in (ZEROS, TWISTS, LENGTHS))
    links = []
    for link in drawing.links:
        a, d = length * rng.standard_normal(2)
        alpha, beta = twist * rng.standard_normal(2)
        links.append(
            replace(
                link,
                a=link.a + a,
                d=link.d + d * (link.beta is None),
                alpha=link.alpha + alpha,
                offset=link.offset + zero * rng.standard_normal(),
                beta=None if link.beta is None else link.beta + beta,
            )
        )
    return replace(drawing, links=tuple(links))


def _gears(joints: int, rng: Rng) -> Array:
    phases = rng.uniform(0.0, 2.0 * np.pi, (2, joints))
    first, second = rng.uniform(1e-4, 4e-4), rng.uniform(5e-5, 2e-4)
    return np.column_stack([np.full(joints, first), phases[0], np.full(joints, second), phases[1]])


def dh_table(drawing: Arm) -> str:
    """The drawing as a table of Denavit-Hartenberg parameters."""
    lines = ["joint,a [mm],d [mm],alpha [deg],theta [deg]"]
    for j, link in enumerate(drawing.links, 1):
        angles = link.alpha / DEGREE, link.offset / DEGREE
        lines.append(f"{j},{1e3 * link.a:g},{1e3 * link.d:g},{angles[0]:g},{angles[1]:g}")
    return "\n".join(lines) + "\n"


def urdf(drawing: Arm, box: Array, joints: Sequence[str]) -> str:
    """The drawing as a URDF with the masses of the links and limits of the joints."""
    parts = ['<robot name="arm">', '<link name="link_0"/>']
    origin = '<origin xyz="0 0 0" rpy="0 0 0"/>'
    for j, (link, name) in enumerate(zip(drawing.links, joints, strict=True), 1):
        low, high = box[j - 1]
        parts.append(
            f'<joint name="{name}" type="revolute"><parent link="link_{j - 1}"/>'
            f'<child link="link_{j}"/>{origin}<axis xyz="0 0 1"/>'
            f'<limit lower="{low:g}" upper="{high:g}" effort="100" velocity="2"/></joint>'
        )
        end = np.array(
            [link.a * np.cos(link.offset), link.a * np.sin(link.offset), link.d], dtype=float
        )
        middle = " ".join(f"{v:.9g}" for v in 0.5 * end)
        parts.append(
            f'<link name="link_{j}"><inertial><origin xyz="{middle}"/><mass value="{link.mass:g}"/>'
            '<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>'
        )
        xyz = " ".join(f"{v:.9g}" for v in end)
        origin = f'<origin xyz="{xyz}" rpy="{link.alpha:.12g} 0 {link.offset:.12g}"/>'
    parts.append('<link name="flange"/>')
    parts.append(
        f'<joint name="mount" type="fixed"><parent link="link_{len(drawing.links)}"/>'
        f'<child link="flange"/>{origin}</joint></robot>'
    )
    return "\n".join(parts) + "\n"


def write_readings(path: Path, joints: Sequence[str], q: Array, p: Array) -> None:
    """Readings as a user keeps them: a row per pose, degrees and millimetres."""
    rows = np.column_stack([np.arange(1, len(q) + 1), q / DEGREE, 1e3 * p])
    header = ",".join(["pose", *(f"{j} [deg]" for j in joints), *(f"{c} [mm]" for c in "xyz")])
    form = ["%d", *["%.6f"] * q.shape[1], *["%.5f"] * 3]
    np.savetxt(path, rows, delimiter=",", header=header, comments="", fmt=form)


def away(points: Array, onto: Array) -> Array:
    """Distances (N,) of points from others, once they are moved rigidly onto them."""
    a, b = points - points.mean(axis=0), onto - onto.mean(axis=0)
    U, _, Vt = np.linalg.svd(b.T @ a)
    U[:, -1] *= np.sign(np.linalg.det(U @ Vt))
    distance: Array = np.linalg.norm(a @ (U @ Vt).T - b, axis=1)
    return distance
