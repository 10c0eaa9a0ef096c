"""Machines as they truly are over their lives, and the files that a user has of them.

Arms are those of `analyses.gauntlet_truth`, palletisers and deltas of `analyses.lives_parallel`,
all built off their drawings. Nothing here is loopcal's code. Lengths are m, angles rad, masses kg;
a pose is a row.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analyses import gauntlet_truth as truth
from analyses.gauntlet_truth import Arm, Array, corner, drawn, random_placement
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
TARGETS = {"tracker": TOOL[None], "camera": TOOL[None]}
TARGETS |= {"three reflectors": TOOL * [[1.0, 1.0, 1.0], [-1.5, 2.0, 0.8], [0.5, -3.0, 1.2]]}
SLIDE, CAMERA_TURN = 1e-5, 1e-4
"""sds of a slide's reading [m] and of the angles of a camera's pose [rad]."""
MOUNTED = 2e-3
"""sd by which the reflector is mounted off the drawing [m]."""
ZEROS, TWISTS, LENGTHS = (0.1 * DEGREE, 0.6 * DEGREE), (5e-4, 2e-3), (1e-4, 1e-3)
"""Ranges of a machine's sds off the drawing [rad, rad, m], as trust.md asks for."""
CARRIED = 3.0
"""Mass at the flange on the day of the calibration [kg]."""
CARRIED_ALSO = 8.0
"""Mass at the flange in every second pose of a machine whose file has a column of loads [kg]."""
DRAWINGS = {"six": truth.SIX, "irb": truth.IRB, "ur": truth.UR, "palletiser": PALLETISER}
DRAWINGS |= {"seven": truth.SEVEN, "scara": truth.SCARA}
BOXES = truth.BOXES | {"palletiser": PALLETISER_BOX, "delta": DELTA_BOX}
WEAR = ("rigid", "sagging", "sagging with gears", "sagging with backlash")
ORDERS = ("random", "sorted", "raster")
JOINTS = {"six": 6, "irb": 6, "ur": 6, "palletiser": 4, "delta": 3, "seven": 7, "scara": 4}
FLEET = 30
"""Machines until their kinds come again: 20 arms, 5 palletisers, 5 deltas."""
PALLETISERS, DELTAS = range(20, 25), range(25, 30)
TWO_STATIONS, LOADED = range(12, 16), range(16, 20)
"""Arms that are calibrated from two places, and with two loads."""


@dataclass(eq=False)
class Conditions:
    """How machine and instrument are while a file is measured.

    target (N, T, 3) [m] in the last frame; drift (N, 3) [m] of the instrument; warmth (N,) [K];
    more (N,) [kg] than usual at the flange, as its user knows; arm: the machine of this day; later:
    the machine from a row on; loose: sd [m] by which the target lies elsewhere at each pose; turn
    (N, 3, 3), shift (N, 3) [m], scale (N,): the base in the frame of the instrument.
    """

    arm: Arm | RotaryDelta
    target: Array
    drift: Array
    warmth: Array
    more: Array
    turn: Array
    shift: Array
    scale: Array
    later: tuple[int, Arm | RotaryDelta] | None = None
    loose: float = 0.0

    @classmethod
    def still(cls, arm: Arm | RotaryDelta, target: Array, more: Array) -> Conditions:
        """An instrument in the base's frame, while nothing happens."""
        n = len(more)
        turn = np.broadcast_to(np.eye(3), (n, 3, 3)).copy()
        still = np.zeros((n, 3)), np.zeros(n), more
        return cls(arm, np.tile(target, (n, 1, 1)), *still, turn, np.zeros((n, 3)), np.ones(n))

    def seen(self, p: Array) -> Array:
        """Points (N, T, 3) of the base in the frame of the instrument."""
        turned = self.scale[:, None, None] * np.einsum("nij,nkj->nki", self.turn, p)
        out: Array = turned + self.shift[:, None]
        return out


@dataclass(frozen=True, eq=False)
class Machine:
    """A machine of the fleet: its drawing, what was built, and how it is measured.

    tracker [m], encoder [rad]: sds of the noise; described: "dh", "urdf" or "project"; stations:
    from how many places it is calibrated; loaded: whether its files have a column of loads;
    thermometer: whether they have one of temperatures; instrument: of `TARGETS`; repeats: how many
    of the first poses are measured again at the end; plain: whether headers lack units; rounded:
    step [rad] of recorded joints; stated: factor of the sds that the user fixes, else learnt.
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
    stations: int = 1
    loaded: bool = False
    thermometer: bool = False
    instrument: str = "tracker"
    repeats: int = 0
    plain: bool = False
    rounded: float = 0.0
    stated: float | None = None

    @property
    def sags(self) -> bool:
        return isinstance(self.arm, Arm) and self.arm.yielding > 0.0

    @property
    def turns(self) -> bool:
        """Whether the reflector turns with the machine: a delta's platform never does."""
        return isinstance(self.arm, Arm)

    @property
    def slides(self) -> NDArray[np.bool_]:
        """Which joints are slides."""
        links = self.arm.links if self.family == "scara" and isinstance(self.arm, Arm) else ()
        return np.array([link.slides for link in links] or [False] * len(self.joints))

    def conditions(self, poses: int) -> Conditions:
        """The machine as it was calibrated, measured by an instrument that stands still."""
        more = np.zeros(poses)
        more[1::2] = (CARRIED_ALSO - CARRIED) * self.loaded
        return Conditions.still(self.arm, self.target, more)

    def placed(self, conditions: Conditions, rng: Rng, stations: int = 1) -> Conditions:
        """The conditions with the instrument set up somewhere, or here and there in turn."""
        for rows in np.array_split(np.arange(len(conditions.more)), stations):
            R, shift = random_placement(rng, 2.0)
            conditions.turn[rows], conditions.shift[rows] = R, shift
        return conditions

    def points(self, q: Array, conditions: Conditions) -> Array:
        """Where the first reflector truly is in the base (N, 3), with the instrument's drift."""
        first: Array = self.bodies(q, conditions)[1][:, 0]
        return first

    def bodies(self, q: Array, conditions: Conditions) -> tuple[Array, Array]:
        """Turn (N, 3, 3) of the last frame and the reflectors (N, T, 3), both in the base."""
        R, p = np.zeros((len(q), 3, 3)), np.zeros(conditions.target.shape)
        row, later = conditions.later or (len(q), conditions.arm)
        for rows, arm in ((slice(row), conditions.arm), (slice(row, None), later)):
            for more in np.unique(conditions.more[rows]):
                if isinstance(arm, Arm):
                    loaded: Arm | RotaryDelta = replace(arm, tool_mass=arm.tool_mass + more)
                else:
                    loaded = arm
                where = np.arange(len(q))[rows]
                where = where[conditions.more[rows] == more]
                R[where], o = loaded.flange(q[where], conditions.warmth[where])
                p[where] = o[:, None] + np.einsum(
                    "nij,nkj->nki", R[where], conditions.target[where]
                )
        return R, p + conditions.drift[:, None]

    def posed(self, poses: int, rng: Rng) -> Array:
        """Joints (N, n) in the order in which this machine's user measures."""
        where = self._ordered(drawn(self.box, poses, rng))
        if self.repeats:
            where = np.vstack([where, where[: self.repeats]])
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

    def measured(self, q: Array, conditions: Conditions, rng: Rng) -> tuple[Array, Array]:
        """Recorded joints (N, n), and points (N, 3 T) or poses (N, 7) of the instrument."""
        R, p = self.bodies(q, conditions)
        p = conditions.seen(p)
        p = p + self.tracker * rng.standard_normal(p.shape)
        seen = p.reshape(len(p), -1)
        if self.instrument == "camera":
            from scipy.spatial.transform import Rotation

            tilted = truth.turned_by(CAMERA_TURN * rng.standard_normal((len(q), 3)))
            seen = np.hstack([seen, Rotation.from_matrix(conditions.turn @ R @ tilted).as_quat()])
        return self.recorded(q, rng), seen

    def recorded(self, q: Array, rng: Rng) -> Array:
        """What the controller has of joints (N, n)."""
        read = q + np.where(self.slides, SLIDE, self.encoder) * rng.standard_normal(q.shape)
        return np.round(read / self.rounded) * self.rounded if self.rounded else read

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of what the instrument reads."""
        if self.instrument == "three reflectors":
            return tuple(f"{c}{k}" for k in (1, 2, 3) for c in "xyz")
        return tuple("xyz") + ("qx", "qy", "qz", "qw") * (self.instrument == "camera")

    def columns(self, conditions: Conditions) -> dict[str, list[str]]:
        """Columns that this machine's files have beside joints and points."""
        _, station = np.unique(conditions.shift, axis=0, return_inverse=True)
        out = {}
        if self.stations > 1:
            out["station"] = ["AB"[int(k != station[0])] for k in station]
        if self.loaded:
            out["payload [kg]"] = [f"{CARRIED + more:g}" for more in conditions.more]
        if self.thermometer:
            out["temperature [°C]"] = [f"{20.0 + warmth:.2f}" for warmth in conditions.warmth]
        return out

    def description(self, folder: Path) -> list[str]:
        """Write what the user has of the machine; the options by which `init` reads it."""
        if self.family == "palletiser":
            (folder / "robot.urdf").write_text(PALLETISER_URDF)
            return ["--urdf", "robot.urdf"]
        if self.family == "delta":
            return ["--machine", "rotary-delta"]
        assert isinstance(self.drawing, Arm)
        if self.described == "urdf":
            (folder / "robot.urdf").write_text(urdf(self.drawing, BOXES[self.family], self.joints))
            return ["--urdf", "robot.urdf"]
        (folder / "dh.csv").write_text(dh_table(self.drawing))
        return ["--dh", "dh.csv"]


def machine(number: int, fleet: int = FLEET, share: float = 1.0, **fixed: Any) -> Machine:
    """A machine of the fleet, the same for a number every time.

    fleet: how many of its kinds are drawn from; share: of each joint's range that is measured;
    fixed: what is as stated, whatever the number.
    """
    rng = np.random.default_rng([41, number])
    kind = number % fleet
    loaded = kind in LOADED
    family = ("six", "irb", "ur")[number % 3]
    wear = WEAR[1 + number % 2] if loaded else WEAR[number // 3 % len(WEAR)]
    described = ("dh", "urdf")[number // 3 % 2]
    if kind in PALLETISERS:
        family, described = "palletiser", "urdf"
    if kind in DELTAS:
        family, wear, described = "delta", WEAR[0], "project"
    family, wear = fixed.pop("family", family), fixed.pop("wear", wear)
    described = "dh" if family in ("seven", "scara") else described
    drawing = DELTA if family == "delta" else replace(DRAWINGS[family], tool_mass=CARRIED)
    arm = built(drawing, rng)
    if isinstance(arm, Arm) and wear != "rigid":
        arm = worn(arm, wear, rng)
    box = BOXES[family] if share == 1.0 else corner(BOXES[family], share, rng)
    targets = TARGETS[fixed.get("instrument", "tracker")]
    made = Machine(
        number,
        family,
        wear,
        ORDERS[(number // 2) % len(ORDERS)],
        described,
        drawing,
        replace(arm, expansion=1.2e-5),
        box,
        targets + MOUNTED * rng.standard_normal(targets.shape),
        int(rng.integers(40, 91)),
        rng.uniform(1e-5, 3e-5),
        10.0 ** rng.uniform(-5.0, -4.3),
        tuple(f"J{j}" for j in range(1, JOINTS[family] + 1)),
        2 if kind in TWO_STATIONS else 1,
        loaded,
    )
    return replace(made, **fixed)


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
    sizes = dict(zip(("zero", "twist", "length"), (ZEROS, TWISTS, LENGTHS), strict=True))
    drawn_sizes = {role: rng.uniform(*size) for role, size in sizes.items()}
    sds = np.array([drawn_sizes[role] for role in roles(drawing)])
    arm = off(drawing, sds * rng.standard_normal(len(sds)))
    if isinstance(arm, Palletiser):
        return replace(arm, linkages=arm.linkages + BARS * rng.standard_normal((3, 3)))
    return arm


def roles(drawing: Arm | RotaryDelta) -> list[str]:
    """What each parameter of a machine is: "zero", "twist" or "length"."""
    if isinstance(drawing, RotaryDelta):
        return ["length"] * 15 + ["twist"] * 6 + ["zero"] * 3
    return ["length", "length", "twist", "zero", "twist"] * len(drawing.links)


def off(drawing: Arm | RotaryDelta, by: Array) -> Arm | RotaryDelta:
    """The machine whose parameters are off its drawing by these amounts (see `roles`) [m, rad]."""
    if isinstance(drawing, RotaryDelta):
        return replace(
            drawing,
            shoulders=drawing.shoulders + by[:9].reshape(3, 3),
            proximal=drawing.proximal + by[9:12],
            distal=drawing.distal + by[12:15],
            azimuth=drawing.azimuth + by[15:18],
            tilt=drawing.tilt + by[18:21],
            zeros=drawing.zeros + by[21:],
        )
    links = tuple(
        replace(
            link,
            a=link.a + a,
            d=link.d + d * (link.beta is None),
            alpha=link.alpha + alpha,
            offset=link.offset + offset * (not link.slides),
            beta=None if link.beta is None else link.beta + beta,
        )
        for link, (a, d, alpha, offset, beta) in zip(drawing.links, by.reshape(-1, 5), strict=True)
    )
    return replace(drawing, links=links)


def _gears(joints: int, rng: Rng) -> Array:
    phases = rng.uniform(0.0, 2.0 * np.pi, (2, joints))
    first, second = rng.uniform(1e-4, 4e-4), rng.uniform(5e-5, 2e-4)
    return np.column_stack([np.full(joints, first), phases[0], np.full(joints, second), phases[1]])


def dh_table(drawing: Arm) -> str:
    """The drawing as a table of Denavit-Hartenberg parameters."""
    lines = ["joint,a [mm],d [mm],alpha [deg],theta [deg],type"]
    for j, link in enumerate(drawing.links, 1):
        angles = f"{link.alpha / DEGREE:g},{link.offset / DEGREE:g}"
        kind = "prismatic" if link.slides else "revolute"
        lines.append(f"{j},{1e3 * link.a:g},{1e3 * link.d:g},{angles},{kind}")
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
    path: Path,
    user: Machine,
    joints: Array,
    seen: Array | None,
    columns: Mapping[str, Sequence[str]],
    cell: str = ",",
) -> None:
    """Readings as a user keeps them: a row per pose, degrees and millimetres; seen: if any."""
    names = () if seen is None else user.coordinates
    units = ["mm" if s else "deg" for s in user.slides]
    heads = [*(f"{j} [{u}]" for j, u in zip(user.joints, units, strict=True)), *columns]
    heads += [f"{c} [mm]" if c[0] != "q" else c for c in names]
    if user.plain:
        heads = [head.partition(" [")[0] for head in heads]
    lines = [["pose", *heads]]
    in_file = np.where(user.slides, 1e3, 1.0 / DEGREE)
    for i in range(len(joints)):
        cells = [*(f"{v:.6f}" for v in joints[i] * in_file), *(one[i] for one in columns.values())]
        cells += [
            f"{v:.9f}" if c[0] == "q" else f"{1e3 * v:.5f}"
            for c, v in zip(names, () if seen is None else seen[i], strict=True)
        ]
        lines.append([str(i + 1), *cells])
    rows = [[v.replace(".", ",") for v in line] if cell == ";" else line for line in lines]
    path.write_text("\n".join(cell.join(row) for row in rows) + "\n", "utf-8")


def placement(points: Array, onto: Array) -> tuple[Array, Array]:
    """The turn (3, 3) and shift (3,) that bring points (N, 3) nearest to others."""
    a, b = points.mean(axis=0), onto.mean(axis=0)
    U, _, Vt = np.linalg.svd((onto - b).T @ (points - a))
    U[:, -1] *= np.sign(np.linalg.det(U @ Vt))
    return U @ Vt, b - U @ Vt @ a


def away(points: Array, onto: Array) -> Array:
    """Distances (N,) of points from others, once they are moved rigidly onto them."""
    R, shift = placement(points, onto)
    distance: Array = np.linalg.norm(points @ R.T + shift - onto, axis=1)
    return distance
