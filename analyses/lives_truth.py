"""Machines as they truly are over their lives, and the files that a user has of them.

Arms are those of `analyses.gauntlet_truth`, palletisers and deltas of `analyses.lives_parallel`,
all built off their drawings. Nothing here is loopcal's code. Lengths are m, angles rad, masses kg;
a pose is a row.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from analyses import gauntlet_truth as truth
from analyses.gauntlet_truth import Arm, Array, drawn, random_placement
from analyses.lives_parallel import (
    BARS,
    DELTA,
    DELTA_BOX,
    PALLETISER,
    PALLETISER_BOX,
    PALLETISER_URDF,
    Palletiser,
    RotaryDelta,
)

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
CARRIED_ALSO = 8.0
"""Mass at the flange in every second pose of a machine whose file has a column of loads [kg]."""
DRAWINGS = {"six": truth.SIX, "irb": truth.IRB, "ur": truth.UR, "palletiser": PALLETISER}
BOXES = truth.BOXES | {"palletiser": PALLETISER_BOX, "delta": DELTA_BOX}
WEAR = ("rigid", "sagging", "sagging with gears", "sagging with backlash")
ORDERS = ("random", "sorted", "raster")
JOINTS = {"six": 6, "irb": 6, "ur": 6, "palletiser": 4, "delta": 3}
FLEET = 30
"""Machines until their kinds come again: 20 arms, 5 palletisers, 5 deltas."""
PALLETISERS, DELTAS = range(20, 25), range(25, 30)
TWO_STATIONS, LOADED = range(12, 16), range(16, 20)
"""Arms that are calibrated from two places, and with two loads."""


@dataclass(eq=False)
class Conditions:
    """How machine and instrument are while a file is measured.

    target (N, 3) [m] in the last frame; drift (N, 3) [m] of the instrument; warmth (N,) [K];
    more (N,) [kg] than usual at the flange, as its user knows; arm: the machine of this day; loose:
    sd [m] by which the target lies elsewhere at each pose.
    """

    arm: Arm | RotaryDelta
    target: Array
    drift: Array
    warmth: Array
    more: Array
    loose: float = 0.0


@dataclass(frozen=True, eq=False)
class Machine:
    """A machine of the fleet: its drawing, what was built, and how it is measured.

    tracker [m], encoder [rad]: sds of the noise; described: "dh", "urdf" or "project"; stations:
    from how many places it is calibrated; loaded: whether its files have a column of loads.
    """

    number: int
    family: str
    wear: str
    order: str
    described: str
    drawing: Arm | RotaryDelta
    arm: Arm | RotaryDelta
    box: Array
    target: Array
    poses: int
    tracker: float
    encoder: float
    joints: tuple[str, ...]
    stations: int
    loaded: bool

    @property
    def sags(self) -> bool:
        return isinstance(self.arm, Arm) and self.arm.yielding > 0.0

    @property
    def turns(self) -> bool:
        """Whether the reflector turns with the machine: a delta's platform never does."""
        return isinstance(self.arm, Arm)

    def conditions(self, poses: int) -> Conditions:
        """The machine as it was calibrated, measured by an instrument that stands still."""
        more = np.zeros(poses)
        more[1::2] = (CARRIED_ALSO - CARRIED) * self.loaded
        return Conditions(
            self.arm, np.tile(self.target, (poses, 1)), np.zeros((poses, 3)), np.zeros(poses), more
        )

    def points(self, q: Array, conditions: Conditions) -> Array:
        """Where the reflector truly is in the base (N, 3), with the instrument's drift."""
        p = np.zeros((len(q), 3))
        for more in np.unique(conditions.more):
            arm = conditions.arm
            if isinstance(arm, Arm):
                arm = replace(arm, tool_mass=arm.tool_mass + more)
            R, o = arm.flange(q, conditions.warmth)
            rows = conditions.more == more
            p[rows] = (o + np.einsum("nij,nj->ni", R, conditions.target))[rows]
        moved: Array = p + conditions.drift
        return moved

    def posed(self, poses: int, rng: Rng) -> Array:
        """Joints (N, n) in the order in which this machine's user measures."""
        where = self._ordered(drawn(self.box, poses, rng))
        return self.drawing.angles(where) if isinstance(self.drawing, RotaryDelta) else where

    def _ordered(self, where: Array) -> Array:
        if self.order == "sorted":
            return where[np.argsort(where[:, 0])]
        if self.order == "raster":
            low, high = self.box[0]
            row = np.floor(5.0 * (where[:, 0] - low) / (high - low))
            to_and_fro = np.where(row % 2 == 0.0, where[:, 1], -where[:, 1])
            return where[np.lexsort((to_and_fro, row))]
        return where

    def measured(
        self, q: Array, conditions: Conditions, rng: Rng, stations: int = 1
    ) -> tuple[Array, Array]:
        """Recorded joints (N, n) and points (N, 3), from wherever the instrument stands."""
        p = self.points(q, conditions)
        for rows in np.array_split(np.arange(len(q)), stations):
            R, shift = random_placement(rng, 2.0)
            p[rows] = p[rows] @ R.T + shift
        return (
            q + self.encoder * rng.standard_normal(q.shape),
            p + self.tracker * rng.standard_normal(p.shape),
        )

    def columns(self, conditions: Conditions, stations: int = 1) -> dict[str, list[str]]:
        """Columns that this machine's files have beside joints and points."""
        parts = np.array_split(np.arange(len(conditions.more)), stations)
        named = [name for name, rows in zip("AB", parts, strict=False) for _ in rows]
        out = {"station": named} if self.stations > 1 else {}
        if self.loaded:
            out["payload [kg]"] = [f"{CARRIED + more:g}" for more in conditions.more]
        return out

    def description(self, folder: Path) -> list[str]:
        """Write what the user has of the machine; the options by which `init` reads it."""
        if self.family == "palletiser":
            (folder / "robot.urdf").write_text(PALLETISER_URDF)
            return ["--urdf", "robot.urdf"]
        assert isinstance(self.drawing, Arm)
        if self.described == "urdf":
            (folder / "robot.urdf").write_text(urdf(self.drawing, self.box, self.joints))
            return ["--urdf", "robot.urdf"]
        (folder / "dh.csv").write_text(dh_table(self.drawing))
        return ["--dh", "dh.csv"]


def machine(number: int) -> Machine:
    """A machine of the fleet, the same for a number every time."""
    rng = np.random.default_rng([41, number])
    kind = number % FLEET
    loaded = kind in LOADED
    family = ("six", "irb", "ur")[number % 3]
    wear = WEAR[1 + number % 2] if loaded else WEAR[number % len(WEAR)]
    described = ("dh", "urdf")[number // 3 % 2]
    if kind in PALLETISERS:
        family, described = "palletiser", "urdf"
    if kind in DELTAS:
        family, wear, described = "delta", WEAR[0], "project"
    drawing = DELTA if family == "delta" else replace(DRAWINGS[family], tool_mass=CARRIED)
    arm = built(drawing, rng)
    if isinstance(arm, Arm) and wear != "rigid":
        arm = worn(arm, wear, rng)
    return Machine(
        number,
        family,
        wear,
        ORDERS[(number // 2) % len(ORDERS)],
        described,
        drawing,
        replace(arm, expansion=1.2e-5),
        BOXES[family],
        TOOL + MOUNTED * rng.standard_normal(3),
        int(rng.integers(60, 151)),
        rng.uniform(1e-5, 3e-5),
        10.0 ** rng.uniform(-5.0, -4.3),
        tuple(f"J{j}" for j in range(1, JOINTS[family] + 1)),
        2 if kind in TWO_STATIONS else 1,
        loaded,
    )


def worn(arm: Arm, wear: str, rng: Rng) -> Arm:
    """The arm with what years of work, or its drives, have made of it."""
    soft = 10.0 ** rng.uniform(-5.7, -5.0)
    if isinstance(arm, Palletiser):
        soft *= 0.1  # its drives carry ten times the mass
    arm = replace(arm, yielding=soft, bending=0.3 * soft)
    motors = 4 if isinstance(arm, Palletiser) else len(arm.links)
    if wear.endswith("gears"):
        arm = replace(arm, gears=_gears(motors, rng))
    if wear.endswith("backlash"):
        arm = replace(arm, backlash=rng.uniform(1e-4, 3e-4))
    return arm


def built(drawing: Arm | RotaryDelta, rng: Rng) -> Arm | RotaryDelta:
    """The machine as it was built: zeros, twists and lengths each off by a size of their own."""
    zero, twist, length = (rng.uniform(*sizes) for sizes in (ZEROS, TWISTS, LENGTHS))
    if isinstance(drawing, RotaryDelta):
        return replace(
            drawing,
            shoulders=drawing.shoulders + length * rng.standard_normal((3, 3)),
            azimuth=drawing.azimuth + twist * rng.standard_normal(3),
            tilt=drawing.tilt + twist * rng.standard_normal(3),
            proximal=drawing.proximal + length * rng.standard_normal(3),
            distal=drawing.distal + length * rng.standard_normal(3),
            zeros=zero * rng.standard_normal(3),
        )
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
    arm = replace(drawing, links=tuple(links))
    if isinstance(arm, Palletiser):
        return replace(arm, linkages=arm.linkages + BARS * rng.standard_normal((3, 3)))
    return arm


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


def write_readings(
    path: Path, joints: Sequence[str], q: Array, p: Array, columns: Mapping[str, Sequence[str]]
) -> None:
    """Readings as a user keeps them: a row per pose, degrees and millimetres."""
    names = [*(f"{j} [deg]" for j in joints), *columns, *(f"{c} [mm]" for c in "xyz")]
    lines = [",".join(["pose", *names])]
    for i in range(len(q)):
        cells = [*(f"{v:.6f}" for v in q[i] / DEGREE), *(column[i] for column in columns.values())]
        lines.append(",".join([str(i + 1), *cells, *(f"{1e3 * v:.5f}" for v in p[i])]))
    path.write_text("\n".join(lines) + "\n", "utf-8")


def away(points: Array, onto: Array) -> Array:
    """Distances (N,) of points from others, once they are moved rigidly onto them."""
    a, b = points - points.mean(axis=0), onto - onto.mean(axis=0)
    U, _, Vt = np.linalg.svd(b.T @ a)
    U[:, -1] *= np.sign(np.linalg.det(U @ Vt))
    distance: Array = np.linalg.norm(a @ (U @ Vt).T - b, axis=1)
    return distance
