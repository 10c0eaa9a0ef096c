"""129 layouts of real files through `loopcal init`: right, refused, or silently wrong.

Robots and readings are simulated here in plain NumPy. A layout is right if the machine that its
project calibrates predicts fresh poses within 1.1 of that calibrated from a plain file of the same
readings, whose headers state everything. A refusal has a next command or it has none.

    python -m analyses.layouts --only soll --show
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import shlex
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
POSES, FRESH, RIGHT = 36, 300, 1.1
ENCODER, FOLLOWING, TRACKER = 20e-6, 4e-4, 30e-6
TARGET, SECOND = np.array([0.05, -0.03, 0.12]), np.array([-0.06, 0.04, 0.09])
R, P = "revolute", "prismatic"
_SIX = (
    (150, 450, -90, 0, R), (600, 0, 0, -90, R), (120, 0, -90, 0, R),
    (0, 640, 90, 0, R), (0, 0, -90, 0, R), (0, 100, 0, 0, R),
)  # fmt: skip
ROBOTS: dict[str, tuple[tuple[float, float, float, float, str], ...]] = {
    "six": _SIX,
    "ur": (
        (0, 127.3, 90, 0, R), (-612, 0, 0, 0, R), (-572.3, 0, 0, 0, R),
        (0, 163.9, 90, 0, R), (0, 115.7, -90, 0, R), (0, 92.2, 0, 0, R),
    ),
    "iiwa": (
        (0, 360, -90, 0, R), (0, 0, 90, 0, R), (0, 420, 90, 0, R), (0, 0, -90, 0, R),
        (0, 400, -90, 0, R), (0, 0, 90, 0, R), (0, 126, 0, 0, R),
    ),
    "scara": ((325, 400, 0, 0, R), (225, 0, 180, 0, R), (0, 50, 0, 0, P), (0, 60, 0, 0, R)),
    "rail": ((0, 0, 90, 90, P), *_SIX),
    "gantry": (
        (0, 0, -90, -90, P), (0, 300, -90, -90, P), (0, 500, 0, 0, P),
        (0, 80, 90, 0, R), (60, 0, -90, 0, R), (0, 100, 0, 0, R),
    ),
}  # fmt: skip
"""Rows a, d [mm], alpha, theta [deg] of the classical convention, and the kind of joint."""
PANDA = (
    (0, 333, 0, 0, R), (0, 0, -90, 0, R), (0, 316, 90, 0, R), (82.5, 0, 90, 0, R),
    (-82.5, 384, -90, 0, R), (0, 0, 90, 0, R), (88, 107, 90, 0, R),
)  # fmt: skip
"""Rows of the modified convention, alpha and a of the link before."""


def frames(rows: Array, slides: Sequence[bool], q: Array, *, modified: bool = False) -> Array:
    """(N, 4, 4) the flange at joints q (N, n) [rad, m]."""
    T = np.tile(np.eye(4), (len(q), 1, 1))
    for (a, d, alpha, theta), slide, value in zip(rows, slides, q.T, strict=True):
        angle = theta + (0.0 if slide else 1.0) * value
        twist = np.eye(4)
        twist[:3, :3], twist[0, 3] = Rotation.from_euler("x", alpha).as_matrix(), a
        turn = np.tile(np.eye(4), (len(q), 1, 1))
        turn[:, :3, :3] = Rotation.from_euler("z", np.reshape(angle, (-1, 1))).as_matrix()
        turn[:, 2, 3] = d + (value if slide else 0.0)
        T = T @ twist @ turn if modified else T @ turn @ twist
    return T


class World:
    """One robot, its drawing and its truth, and what was read of it."""

    def __init__(self, robot: str, seed: int, poses: int = POSES) -> None:
        rng = np.random.default_rng(seed)
        self.robot, self.modified = robot, robot == "panda"
        table = PANDA if self.modified else ROBOTS[robot]
        self.slides = [row[4] == P for row in table]
        self.drawn = np.array([row[:4] for row in table]) * [1e-3, 1e-3, np.pi / 180, np.pi / 180]
        self.true = self.drawn + rng.normal(0.0, [5e-4, 5e-4, 1e-3, 1e-3], self.drawn.shape)
        self.half = np.where(self.slides, 0.3, 1.4)
        self.q = rng.uniform(-self.half, self.half, (poses, len(table)))
        self.fresh = rng.uniform(-self.half, self.half, (FRESH, len(table)))
        slow = np.where(self.slides, 0.5, 1.0)
        self.read = self.q + rng.normal(0.0, ENCODER, self.q.shape) * slow
        self.command = self.q + rng.normal(0.0, FOLLOWING, self.q.shape) * slow
        S, t = Rotation.random(random_state=seed).as_matrix(), rng.uniform(1.0, 2.5, 3)
        S2, t2 = Rotation.random(random_state=seed + 99).as_matrix(), rng.uniform(-2.5, -1.0, 3)
        T = self.at(self.q)

        def noise() -> Array:
            return rng.normal(0.0, TRACKER, (poses, 3))

        self.points = self.target(self.q) @ S.T + t + noise()
        self.second = (T[:, :3, 3] + T[:, :3, :3] @ SECOND) @ S.T + t + noise()
        self.elsewhere = self.target(self.q) @ S2.T + t2 + noise()
        small = Rotation.from_rotvec(rng.normal(0.0, 1e-4, (poses, 3))).as_matrix()
        self.turns = S @ T[:, :3, :3] @ small
        aimed = self.q + rng.normal(0.0, 3e-5, self.q.shape) * slow
        drawn = frames(self.drawn, self.slides, aimed, modified=self.modified)
        self.commanded = drawn[:, :3, 3] + drawn[:, :3, :3] @ [0.0, 0.0, 0.15]
        computed = frames(self.drawn, self.slides, self.read, modified=self.modified)
        self.tcp = computed[:, :3, 3] + computed[:, :3, :3] @ [0.0, 0.0, 0.15]
        self.tcp_turns = computed[:, :3, :3]
        self.rng = rng

    def at(self, q: Array) -> Array:
        """(N, 4, 4) the true flange."""
        return frames(self.true, self.slides, q, modified=self.modified)

    def target(self, q: Array) -> Array:
        """(N, 3) the true target [m]."""
        T = self.at(q)
        there: Array = T[:, :3, 3] + T[:, :3, :3] @ TARGET
        return there

    def shown(self, values: Array) -> Array:
        """Joints in deg and mm."""
        return np.where(self.slides, 1e3, 180.0 / np.pi) * values


@dataclass
class Case:
    """A layout on the disk: files, options beside the robot's, and what differs of its readings.

    rows: poses that can be used; stated: columns of the instrument for the file by hand, x, y, z in
    mm where None. fresh: columns of fresh poses, and their true points, where the machine is judged
    by what `predict` makes of them; by_hand: the columns of the joints of both in a plain file;
    effect: what a project by hand has of the mechanism beside geometry.
    """

    files: list[str]
    options: list[str] = field(default_factory=list)
    rows: Any = field(default_factory=lambda: slice(None))
    stated: dict[str, Any] | None = None
    fresh: tuple[dict[str, Any], Array] | None = None
    by_hand: tuple[dict[str, Any], dict[str, Any]] | None = None
    effect: str = ""


LAYOUTS: dict[str, tuple[str, Callable[[World, Path], Case]]] = {}
_Maker = Callable[[World, Path], Case]


def layout(name: str, robot: str = "six") -> Callable[[_Maker], _Maker]:
    """Register a layout for a robot."""

    def register(maker: _Maker) -> _Maker:
        LAYOUTS[name] = (robot, maker)
        return maker

    return register


def written(
    path: Path,
    columns: dict[str, Any],
    sep: str = ",",
    decimal: str = ".",
    encoding: str = "utf-8",
    digits: int = 6,
    header: bool = True,
    mark: str = "",
) -> str:
    """A text file; returns its name."""
    lines = [mark + sep.join(columns)] if header else []
    for row in zip(*columns.values(), strict=True):
        cells = []
        for c in row:
            number = isinstance(c, float | np.floating)
            blank = number and np.isnan(c)
            cells.append(
                ("" if blank else f"{c:.{digits}f}".replace(".", decimal)) if number else str(c)
            )
        lines.append(sep.join(cells))
    path.write_bytes(("\n".join(lines) + "\n").encode(encoding))
    return path.name


def of(names: Iterable[str], values: Array) -> dict[str, Array]:
    """Columns by name."""
    return dict(zip(names, np.asarray(values, float).T, strict=True))


def joints(
    w: World, form: str = "J{}", values: Array | None = None, start: int = 1
) -> dict[str, Array]:
    """Joint columns in deg and mm."""
    n = w.q.shape[1]
    return of(
        (form.format(i) for i in range(start, n + start)),
        w.shown(w.read if values is None else values),
    )


def xyz(form: str, points: Array, letters: str = "xyz") -> dict[str, Array]:
    """Point columns in mm."""
    return of((form.format(a) for a in letters), 1e3 * points)


def ids(w: World, form: str = "P{:03d}") -> list[str]:
    return [form.format(i + 1) for i in range(len(w.q))]


def polar(points: Array, turn: float = 1.0) -> Array:
    """Range [mm], azimuth and elevation in units of which pi has `turn` times 180."""
    r = np.linalg.norm(points, axis=1)
    a = np.degrees(np.arctan2(points[:, 1], points[:, 0])) * turn
    e = np.degrees(np.arcsin(points[:, 2] / r)) * turn
    return np.column_stack([1e3 * r, a, e])


def plain(path: Path, *columns: dict[str, Any], **how: Any) -> Case:
    """One file with these columns."""
    return Case([written(path / "data.csv", {k: v for c in columns for k, v in c.items()}, **how)])


# Commanded, computed and other columns beside what was measured


@layout("J_cmd, J_act")
def _(w: World, p: Path) -> Case:
    return plain(p, joints(w, "J{}_cmd", w.command), joints(w, "J{}_act"), xyz("{}", w.points))


@layout("J_act, J_cmd")
def _(w: World, p: Path) -> Case:
    return plain(p, joints(w, "J{}_act"), joints(w, "J{}_cmd", w.command), xyz("{}", w.points))


@layout("UR log: target_q, actual_q, actual_qd, TCP", "ur")
def _(w: World, p: Path) -> Case:
    n = range(6)
    return plain(
        p,
        {"timestamp": 0.002 * np.arange(POSES)},
        of((f"target_q_{i}" for i in n), w.command),
        of((f"actual_q_{i}" for i in n), w.read),
        of((f"actual_qd_{i}" for i in n), w.rng.normal(0, 1e-3, w.q.shape)),
        of(
            (f"actual_TCP_pose_{i}" for i in n),
            np.hstack([w.tcp, Rotation.from_matrix(w.tcp_turns).as_rotvec()]),
        ),
        of(("tracker_x", "tracker_y", "tracker_z"), w.points),
        sep=" ",
        digits=8,
    )


@layout("Soll and Ist of joints", "iiwa")
def _(w: World, p: Path) -> Case:
    return plain(
        p,
        joints(w, "A{} Soll [°]", w.command),
        joints(w, "A{} Ist [°]"),
        xyz("{} [mm]", w.points, "XYZ"),
        sep=";",
        decimal=",",
    )


@layout("X_soll, X_ist")
def _(w: World, p: Path) -> Case:
    return plain(
        p, joints(w, "A{}"), xyz("{}_soll", w.commanded, "XYZ"), xyz("{}_ist", w.points, "XYZ")
    )


@layout("X_ist, X_soll")
def _(w: World, p: Path) -> Case:
    return plain(
        p, joints(w, "A{}"), xyz("{}_ist", w.points, "XYZ"), xyz("{}_soll", w.commanded, "XYZ")
    )


@layout("controller's TCP beside a tracker", "ur")
def _(w: World, p: Path) -> Case:
    return plain(p, joints(w), xyz("TCP_{}", w.tcp), xyz("{}", w.points))


@layout("controller's X Y Z A B C beside a tracker")
def _(w: World, p: Path) -> Case:
    abc = of("ABC", Rotation.from_matrix(w.tcp_turns).as_euler("ZYX", degrees=True))
    return plain(
        p,
        joints(w, "A{}"),
        xyz("{}", w.tcp, "XYZ"),
        abc,
        xyz("Tracker {}", w.points, "XYZ"),
        digits=3,
    )


@layout("nominal beside measured")
def _(w: World, p: Path) -> Case:
    return plain(p, joints(w), xyz("nominal_{}", w.commanded), xyz("measured_{}", w.points))


@layout("two unnamed triples, one computed")
def _(w: World, p: Path) -> Case:
    return plain(p, joints(w), xyz("p1{}", w.tcp), xyz("p2{}", w.points), digits=3)


@layout("PolyWorks: X Nom, X Meas, X Dev")
def _(w: World, p: Path) -> Case:
    near = w.points + w.rng.normal(0, 1e-3, w.points.shape)
    return plain(
        p,
        {"Name": ids(w)},
        joints(w),
        xyz("{} Nom", near, "XYZ"),
        xyz("{} Meas", w.points, "XYZ"),
        xyz("{} Dev", w.points - near, "XYZ"),
    )


@layout("SpatialAnalyzer: X Y Z, dX dY dZ, dMag, u")
def _(w: World, p: Path) -> Case:
    off = w.rng.normal(0, 1e-3, w.points.shape)
    return plain(
        p,
        {"Point Name": ids(w)},
        joints(w),
        xyz("{} (mm)", w.points, "XYZ"),
        xyz("d{} (mm)", off, "XYZ"),
        {"dMag (mm)": 1e3 * np.linalg.norm(off, axis=1)},
        of((f"u{a} (mm)" for a in "XYZ"), np.full((POSES, 3), 0.03)),
    )


@layout("J_vel before J_pos")
def _(w: World, p: Path) -> Case:
    return plain(
        p,
        joints(w, "J{}_vel", w.rng.normal(0, 0.1, w.q.shape)),
        joints(w, "J{}_pos"),
        xyz("{}", w.points),
    )


@layout("degrees beside radians, stated")
def _(w: World, p: Path) -> Case:
    a, b = w.shown(w.read)[:, :3], w.read[:, 3:]
    return plain(
        p,
        of((f"J{i} [deg]" for i in (1, 2, 3)), a),
        of((f"J{i} [rad]" for i in (4, 5, 6)), b),
        xyz("{} [mm]", w.points),
    )


@layout("degrees beside radians, unstated")
def _(w: World, p: Path) -> Case:
    a, b = w.shown(w.read)[:, :3], w.read[:, 3:]
    return plain(
        p,
        of((f"J{i}" for i in (1, 2, 3)), a),
        of((f"J{i}" for i in (4, 5, 6)), b),
        xyz("{}", w.points),
    )


@layout("torques and currents with their numbers", "ur")
def _(w: World, p: Path) -> Case:
    return plain(
        p,
        joints(w, "axis{}_torque", w.rng.normal(0, 0.5, w.q.shape)),
        joints(w, "axis{}_current", w.rng.normal(0, 0.5, w.q.shape)),
        joints(w, "axis{}_angle"),
        xyz("{}", w.points),
    )


@layout("joint_1.position, velocity, effort by URDF", "iiwa")
def _(w: World, p: Path) -> Case:
    n = w.q.shape[1]
    name = "joint_a{}.{}".format
    return Case(
        [
            written(
                p / "data.csv",
                {
                    **of((name(i, "position") for i in range(1, n + 1)), w.read),
                    **of(
                        (name(i, "velocity") for i in range(1, n + 1)),
                        w.rng.normal(0, 1e-3, w.q.shape),
                    ),
                    **of(
                        (name(i, "effort") for i in range(1, n + 1)),
                        w.rng.normal(0, 1.0, w.q.shape),
                    ),
                    **of(("smr.x", "smr.y", "smr.z"), w.points),
                },
                digits=8,
            )
        ],
        ["--urdf", "robot.urdf"],
    )


@layout("X Y Z of the controller and X Y Z of the tracker, two files")
def _(w: World, p: Path) -> Case:
    abc = of("ABC", Rotation.from_matrix(w.tcp_turns).as_euler("ZYX", degrees=True))
    robot = {"Point": ids(w), **joints(w, "A{}"), **xyz("{}", w.tcp, "XYZ"), **abc}
    one = written(p / "robot.csv", robot, digits=4)
    two = written(p / "tracker.csv", {"Point": ids(w), **xyz("{}", w.points, "XYZ")})
    return Case([one, two])


@layout("X Y Z beside x y z", "ur")
def _(w: World, p: Path) -> Case:
    return plain(p, joints(w), xyz("{}", w.tcp, "XYZ"), xyz("{}", w.points))


@layout("the TCP of a controller that knows its own constants", "ur")
def _(w: World, p: Path) -> Case:
    near = w.true + w.rng.normal(0.0, [2e-4, 2e-4, 3e-4, 3e-4], w.true.shape)
    T = frames(near, w.slides, w.read)
    return plain(p, joints(w), xyz("{}", T[:, :3, 3]), xyz("smr_{}", w.points))


@layout("two robots in one file")
def _(w: World, p: Path) -> Case:
    other = joints(w, "R1_J{}", w.rng.uniform(-1, 1, w.q.shape))
    return plain(p, other, joints(w, "R2_J{}"), xyz("{}", w.points))


@layout("temperatures of six motors, forces", "ur")
def _(w: World, p: Path) -> Case:
    heat = of((f"motor_temp_{i}" for i in range(6)), w.rng.uniform(30, 40, w.q.shape))
    force = of(("Fx", "Fy", "Fz"), w.rng.normal(0, 5, (POSES, 3)))
    return plain(p, heat, joints(w, "joint_{}", start=0), xyz("{}", w.points), force)


@layout("means and sds of shots", "iiwa")
def _(w: World, p: Path) -> Case:
    spread = xyz("{}_std", w.rng.uniform(1e-5, 5e-5, (POSES, 3)))
    return plain(p, joints(w), xyz("{}_mean", w.points), spread)


@layout("raw and corrected joints that differ by constants")
def _(w: World, p: Path) -> Case:
    off = w.read + np.radians([0.1, -0.2, 0.05, 0.0, 0.3, 0.1])
    return plain(p, joints(w, "raw_J{}", off), joints(w, "J{}"), xyz("{}", w.points))


@layout("joints, two trackers, three files")
def _(w: World, p: Path) -> Case:
    one = written(p / "joints.csv", {"id": ids(w), **joints(w)})
    a = written(p / "at960.csv", {"id": ids(w), **xyz("{}", w.points)})
    b = written(p / "at402.csv", {"id": ids(w), **xyz("{}", w.elsewhere)})
    case = Case([one, a, b])
    case.stated = xyz("{}1 [mm]", w.points) | xyz("{}2 [mm]", w.elsewhere)
    return case


# Instruments and conditions


@layout("Distance, Azimut, Élévation")
def _(w: World, p: Path) -> Case:
    case = plain(
        p,
        joints(w, "Axe {} (deg)"),
        of(("Distance (mm)", "Azimut (deg)", "Élévation (deg)"), polar(w.points)),
    )
    case.stated = of(("range [mm]", "azimuth [deg]", "elevation [deg]"), polar(w.points))
    return case


@layout("Strecke, Hz, V in gon from the zenith", "iiwa")
def _(w: World, p: Path) -> Case:
    r, a, e = polar(w.points, 10 / 9).T
    case = plain(
        p,
        joints(w, "A{} [°]"),
        of(("Schrägstrecke [mm]", "Hz [gon]", "V [gon]"), np.column_stack([r, -a % 400, 100 - e])),
        sep=";",
        decimal=",",
    )
    case.stated = of(("range [mm]", "azimuth [deg]", "elevation [deg]"), polar(w.points))
    return case


@layout("Range, Horizontal angle, Vertical angle", "ur")
def _(w: World, p: Path) -> Case:
    case = plain(p, joints(w), of(("Range", "Horizontal angle", "Vertical angle"), polar(w.points)))
    case.stated = of(("range [mm]", "azimuth [deg]", "elevation [deg]"), polar(w.points))
    return case


@layout("a draw-wire")
def _(w: World, p: Path) -> Case:
    length = np.linalg.norm(w.target(w.q) - [1.6, -1.2, 0.1], axis=1) + 0.02
    read = length + w.rng.normal(0, TRACKER, POSES)
    case = plain(p, joints(w), {"wire [mm]": 1e3 * read})
    case.stated = {"wire [mm]": 1e3 * read}
    return case


@layout("load, temperature, time, speed, tool")
def _(w: World, p: Path) -> Case:
    return plain(
        p,
        {"Zeit": np.arange(POSES) * 60.0},
        joints(w, "A{}"),
        xyz("{}", w.points, "XYZ"),
        {
            "Last [kg]": np.full(POSES, 5.0),
            "Temperatur": 20.0 + 0.01 * np.arange(POSES),
            "Geschwindigkeit [%]": np.full(POSES, 10.0),
            "Werkzeug": ["T1"] * POSES,
        },
    )


@layout("date, operator, rms, quality, comment")
def _(w: World, p: Path) -> Case:
    return plain(
        p,
        {"Date": ["2024-05-03"] * POSES, "Operator": ["ab"] * POSES},
        joints(w),
        xyz("{}", w.points),
        {
            "RMS": w.rng.uniform(0.01, 0.03, POSES),
            "Quality": np.full(POSES, 99.0),
            "Comment": ["ok"] * POSES,
        },
    )


@layout("x y z with u_x u_y u_z", "scara")
def _(w: World, p: Path) -> Case:
    return plain(p, joints(w), xyz("{}", w.points), xyz("u_{}", np.full((POSES, 3), TRACKER)))


@layout("two reflectors p1x, p2x")
def _(w: World, p: Path) -> Case:
    case = plain(p, joints(w), xyz("p1{}", w.points), xyz("p2{}", w.second))
    case.stated = xyz("{}1 [mm]", w.points) | xyz("{}2 [mm]", w.second)
    return case


@layout("two stations x1, x2 with blanks", "iiwa")
def _(w: World, p: Path) -> Case:
    even = (np.arange(POSES) % 2 == 0)[:, None]
    case = plain(
        p,
        joints(w),
        xyz("{}1", np.where(even, w.points, np.nan)),
        xyz("{}2", np.where(even, np.nan, w.elsewhere)),
    )
    case.stated = xyz("{}1 [mm]", np.where(even, w.points, np.nan)) | xyz(
        "{}2 [mm]", np.where(even, np.nan, w.elsewhere)
    )
    return case


@layout("a column of stations")
def _(w: World, p: Path) -> Case:
    even = np.arange(POSES) % 2 == 0
    case = plain(
        p,
        {"Station": ["S1" if e else "S2" for e in even]},
        joints(w),
        xyz("{}", np.where(even[:, None], w.points, w.elsewhere)),
    )
    case.stated = xyz("{}1 [mm]", np.where(even[:, None], w.points, np.nan)) | xyz(
        "{}2 [mm]", np.where(even[:, None], np.nan, w.elsewhere)
    )
    return case


@layout("a column of stations, each of which counts its own poses")
def _(w: World, p: Path) -> Case:
    first = np.arange(POSES) < POSES // 2
    counted = [i + 1 if e else i + 1 - POSES // 2 for i, e in enumerate(first)]
    points = np.where(first[:, None], w.points, w.elsewhere)
    case = plain(
        p,
        {"Station": [1 if e else 2 for e in first], "Pose": counted},
        joints(w),
        xyz("{}", points),
    )
    case.stated = xyz("{}1 [mm]", np.where(first[:, None], w.points, np.nan)) | xyz(
        "{}2 [mm]", np.where(first[:, None], np.nan, w.elsewhere)
    )
    return case


@layout("a camera's quaternion, w last", "ur")
def _(w: World, p: Path) -> Case:
    case = plain(
        p,
        joints(w, "q{}"),
        of(("tx", "ty", "tz"), w.points),
        of(("qx", "qy", "qz", "qw"), Rotation.from_matrix(w.turns).as_quat()),
    )
    case.stated = xyz("{} [mm]", w.points) | of(
        ("qw", "qx", "qy", "qz"), Rotation.from_matrix(w.turns).as_quat()[:, [3, 0, 1, 2]]
    )
    return case


@layout("a 4x4 matrix T11 ... T44")
def _(w: World, p: Path) -> Case:
    T = np.tile(np.eye(4), (POSES, 1, 1))
    T[:, :3, :3], T[:, :3, 3] = w.turns, 1e3 * w.points
    case = plain(
        p,
        joints(w),
        of((f"T{i}{k}" for i in range(1, 5) for k in range(1, 5)), T.reshape(-1, 16)),
        digits=8,
    )
    case.stated = xyz("{} [mm]", w.points) | of(
        ("qw", "qx", "qy", "qz"), Rotation.from_matrix(w.turns).as_quat()[:, [3, 0, 1, 2]]
    )
    return case


@layout("points in inches, unstated")
def _(w: World, p: Path) -> Case:
    return plain(p, joints(w), xyz("{}", w.points / 25.4))


@layout("0,0,0 for a lost reflector")
def _(w: World, p: Path) -> Case:
    lost = np.arange(POSES) % 9 == 4
    case = plain(p, joints(w), xyz("{}", np.where(lost[:, None], 0.0, w.points)))
    case.rows = ~lost
    return case


# Joins


@layout("two files by id, each lacks rows")
def _(w: World, p: Path) -> Case:
    a, b = np.arange(POSES) % 11 != 3, np.arange(POSES) % 7 != 5
    name = np.array(ids(w))
    one = written(p / "joints.csv", {"pose": name[a], **{k: v[a] for k, v in joints(w).items()}})
    two = written(
        p / "tracker.csv", {"Point": name[b], **{k: v[b] for k, v in xyz("{}", w.points).items()}}
    )
    return Case([one, two], rows=a & b)


@layout("two files by time, the tracker lacks rows", "ur")
def _(w: World, p: Path) -> Case:
    t = 1000.0 + 12.0 * np.arange(POSES) + w.rng.uniform(0, 2, POSES)
    b = np.arange(POSES) % 7 != 5
    one = written(p / "robot.csv", {"time": t, **joints(w)})
    two = written(
        p / "tracker.csv", {"time": t[b] + 0.3, **{k: v[b] for k, v in xyz("{}", w.points).items()}}
    )
    return Case([one, two], rows=b)


@layout("two files by date and time of day", "ur")
def _(w: World, p: Path) -> Case:
    at = np.datetime64("2024-05-03T09:00:00") + np.arange(POSES) * np.timedelta64(47, "s")
    b = np.arange(POSES) % 8 != 5
    one = written(p / "robot.csv", {"Timestamp": [str(t) for t in at], **joints(w)})
    late = at + np.timedelta64(2, "s")
    two = written(
        p / "tracker.csv",
        {
            "Timestamp": [str(t) for t in late[b]],
            **{k: v[b] for k, v in xyz("{}", w.points).items()},
        },
    )
    return Case([one, two], rows=b)


@layout("two files without ids, two rows lost")
def _(w: World, p: Path) -> Case:
    b = ~np.isin(np.arange(POSES), [9, 22])
    one = written(p / "joints.csv", joints(w))
    two = written(p / "tracker.csv", {k: v[b] for k, v in xyz("{}", w.points).items()})
    return Case([one, two], rows=b)


@layout("ids P01, and numbers ahead of points without a header, two rows lost")
def _(w: World, p: Path) -> Case:
    b = ~np.isin(np.arange(POSES), [9, 22])
    order = w.rng.permutation(POSES)
    names = {"Name": [f"P{i + 1:02d}" for i in order]}
    one = written(p / "robot.csv", {**names, **{k: v[order] for k, v in joints(w).items()}})
    points = {"": 1 + np.flatnonzero(b)} | {k: v[b] for k, v in xyz("{}", w.points).items()}
    two = written(p / "points.txt", points, sep="\t", header=False)
    return Case([one, two], rows=order[b[order]])


@layout("a file of JSON per pose")
def _(w: World, p: Path) -> Case:
    for i, (q, point) in enumerate(zip(w.read.tolist(), w.points.tolist(), strict=True)):
        seen = dict(zip("xyz", point, strict=True))
        (p / f"sample_{i:03d}.json").write_text(json.dumps({"joints": q, "measured": seen}))
    return Case([f"sample_{i:03d}.json" for i in range(POSES)])


@layout("a list of YAML")
def _(w: World, p: Path) -> Case:
    items = [
        f"- joints: {q}\n  point: {point}\n"
        for q, point in zip(w.read.tolist(), w.points.tolist(), strict=True)
    ]
    (p / "samples.yaml").write_text("samples:\n" + "".join(items))
    return Case(["samples.yaml"])


@layout("two files without ids, shuffled")
def _(w: World, p: Path) -> Case:
    order = w.rng.permutation(POSES)
    return Case(
        [
            written(p / "joints.csv", joints(w)),
            written(p / "tracker.csv", xyz("{}", w.points[order])),
        ]
    )


@layout("numeric ids, three shots each in the tracker's file", "iiwa")
def _(w: World, p: Path) -> Case:
    off = w.rng.normal(0, TRACKER, (3, POSES, 3))
    shots = np.concatenate(w.points + off - off.mean(axis=0))
    number = list(range(1, POSES + 1))
    one = written(p / "joints.csv", {"No": number, **joints(w)})
    return Case([one, written(p / "tracker.csv", {"No": number * 3, **xyz("{}", shots)})])


@layout("a few numeric ids measured twice")
def _(w: World, p: Path) -> Case:
    number = [*range(1, POSES + 1), 3, 17, 20]
    rows = np.array(number) - 1
    one = written(p / "joints.csv", {"No": number[:POSES], **joints(w)})
    return Case(
        [
            one,
            written(
                p / "tracker.csv",
                {"No": number, **{k: v[rows] for k, v in xyz("{}", w.points).items()}},
            ),
        ]
    )


@layout("three shots in a row, no ids")
def _(w: World, p: Path) -> Case:
    off = w.rng.normal(0, TRACKER, (3, POSES, 3))
    shots = (w.points + off - off.mean(axis=0)).transpose(1, 0, 2).reshape(-1, 3)
    return Case(
        [written(p / "joints.csv", joints(w)), written(p / "tracker.csv", xyz("{}", shots))]
    )


@layout("two sheets")
def _(w: World, p: Path) -> Case:
    import xlsxwriter

    book = xlsxwriter.Workbook(str(p / "data.xlsx"))
    for name, columns in (("Robot", joints(w)), ("Tracker", xyz("{} [mm]", w.points))):
        sheet = book.add_worksheet(name)
        for i, (head, values) in enumerate({"Pose": ids(w), **columns}.items()):
            cells: list[Any] = [head]
            cells.extend(np.asarray(values).tolist())
            sheet.write_column(0, i, cells)
    book.close()
    return Case(["data.xlsx"])


@layout("A1 ... A6 and E1 at rest")
def _(w: World, p: Path) -> Case:
    return plain(
        p, joints(w, "A{}"), {"E1": np.zeros(POSES), "E2": np.zeros(POSES)}, xyz("{}", w.points)
    )


@layout("E1 moves a rail", "rail")
def _(w: World, p: Path) -> Case:
    columns = [*joints(w, "{}").values()]
    return plain(
        p,
        dict(zip([f"A{i}" for i in range(1, 7)], columns[1:], strict=True)),
        {"E1": columns[0]},
        xyz("{}", w.points),
    )


@layout("J3 counts from the horizon (Fanuc)")
def _(w: World, p: Path) -> Case:
    def coupled(q: Array) -> Array:
        both: Array = q + np.eye(6)[2] * q[:, [1]]
        return both

    case = plain(p, joints(w, values=coupled(w.read)), xyz("{}", w.points))
    return case


_SCALES = (
    '[[mechanism.effect]]\ntype = "scale"\njoints = ["*"]\n\n[mechanism.parameters]\n'
    '"*_scale" = { value = 0.0, unit = "1", sd = 0.02 }\n'
)
"""The scale of each joint, learnt as `init` does it for counts."""


@layout("encoder counts")
def _(w: World, p: Path) -> Case:
    scale = np.array([9556.3, 9556.3, 8212.0, 6112.5, 6112.5, 3720.1]) * 180 / np.pi
    zeros = [1200, -40000, 900, 0, 77, 31000]
    names = [f"J{i}" for i in range(1, 7)]
    case = plain(p, of(names, np.round(w.read * scale + zeros)), xyz("{}", w.points))
    case.fresh = of(names, w.fresh * scale + zeros), w.target(w.fresh)
    stated = [f"{n} [deg]" for n in names]
    case.by_hand = of(stated, w.shown(w.read)), of(stated, w.shown(w.fresh))
    case.effect = _SCALES
    return case


@layout("a modified table under plain headers", "panda")
def _(w: World, p: Path) -> Case:
    return plain(p, joints(w, "joint{}"), xyz("{}", w.points))


@layout("sign and zero of one joint")
def _(w: World, p: Path) -> Case:
    sign = np.array([1, 1, -1, 1, 1, 1])

    def read(q: Array) -> Array:
        moved: Array = sign * q + np.array([0, 0, np.pi / 2, 0, 0, 0])
        return moved

    case = plain(p, joints(w, values=read(w.read)), xyz("{}", w.points))
    return case


@layout("one joint reversed", "ur")
def _(w: World, p: Path) -> Case:
    sign = np.array([1, 1, 1, -1, 1, 1])
    case = plain(p, joints(w, values=sign * w.read), xyz("{}", w.points))
    return case


@layout("one zero a right angle off", "iiwa")
def _(w: World, p: Path) -> Case:
    zero = np.array([0, np.pi / 2, 0, 0, 0, 0, 0])
    case = plain(p, joints(w, values=w.read + zero), xyz("{}", w.points))
    return case


# Languages, encodings and headers


@layout("German, cp1252, decimal comma")
def _(w: World, p: Path) -> Case:
    return plain(
        p,
        {"Messpunkt": ids(w)},
        joints(w, "Gelenkwinkel {} [°]"),
        xyz("{}-Koordinate [mm]", w.points, "XYZ"),
        sep=";",
        decimal=",",
        encoding="cp1252",
    )


@layout("French", "ur")
def _(w: World, p: Path) -> Case:
    return plain(
        p,
        {"Repère": ids(w)},
        joints(w, "Articulation n°{} (degrés)"),
        xyz("Coordonnée {} (mm)", w.points, "XYZ"),
        sep=";",
        decimal=",",
        encoding="utf-8-sig",
    )


@layout("Spanish", "scara")
def _(w: World, p: Path) -> Case:
    return plain(
        p,
        {"Posición": ids(w)},
        joints(w, "Ángulo eje {}"),
        xyz("Coordenada {} (milímetros)", w.points, "XYZ"),
        sep=";",
        decimal=",",
        encoding="cp1252",
    )


@layout("Chinese, GB 18030")
def _(w: World, p: Path) -> Case:
    return plain(
        p,
        {"点号": ids(w)},
        joints(w, "第{}轴角度(度)"),
        xyz("{}坐标(毫米)", w.points, "XYZ"),
        encoding="gb18030",
    )


@layout("Japanese, Shift-JIS")
def _(w: World, p: Path) -> Case:
    return plain(
        p,
        {"測定点": ids(w)},
        joints(w, "第{}軸[度]"),
        xyz("{}座標[mm]", w.points, "XYZ"),
        encoding="shift-jis",
    )


@layout("Japanese, S軸 L軸 ...", "six")
def _(w: World, p: Path) -> Case:
    names = [f"{a}軸" for a in "SLURBT"]
    return plain(
        p, of(names, w.shown(w.read)), xyz("{}座標", w.points, "XYZ"), encoding="shift-jis"
    )


@layout("a header behind %")
def _(w: World, p: Path) -> Case:
    return plain(p, joints(w, "th{}"), xyz("{}", w.points), mark="% ", sep="\t")


@layout("rostopic echo -p, two files by time", "panda")
def _(w: World, p: Path) -> Case:
    t = [1_700_000_000_000_000_000 + 3_000_000_000 * i for i in range(POSES)]
    n = range(7)
    one = {
        "%time": t,
        "field.header.seq": list(range(POSES)),
        "field.header.stamp": t,
        "field.header.frame_id": ["base"] * POSES,
    }
    one |= {f"field.name{i}": [f"panda_joint{i + 1}"] * POSES for i in n}
    one |= (
        of((f"field.position{i}" for i in n), w.read)
        | of((f"field.velocity{i}" for i in n), w.rng.normal(0, 1e-3, w.q.shape))
        | of((f"field.effort{i}" for i in n), w.rng.normal(0, 1, w.q.shape))
    )
    late = [x + 40_000_000 for x in t]
    two = {
        "%time": late,
        "field.header.seq": list(range(POSES)),
        "field.header.stamp": late,
        "field.header.frame_id": ["tracker"] * POSES,
        **of((f"field.point.{a}" for a in "xyz"), w.points),
    }
    return Case(
        [written(p / "joints.csv", one, digits=9), written(p / "points.csv", two, digits=9)],
        ["--urdf", "robot.urdf"],
    )


@layout("thousands in quotes")
def _(w: World, p: Path) -> Case:
    text = {k: [f'"{v:,.3f}"' for v in c] for k, c in xyz("{}", w.points).items()}
    return plain(p, joints(w), text)


@layout("thousands with points, decimal comma", "iiwa")
def _(w: World, p: Path) -> Case:
    text = {
        k: [f"{v:,.4f}".translate(str.maketrans(",.", ".,")) for v in c]
        for k, c in xyz("{} [mm]", w.points, "XYZ").items()
    }
    return plain(p, joints(w, "A{} [°]"), text, sep=";", decimal=",")


@layout("no header, a number and a time first")
def _(w: World, p: Path) -> Case:
    return plain(
        p,
        {"n": list(range(1, POSES + 1)), "t": 0.5 + 7.3 * np.arange(POSES)},
        joints(w),
        xyz("{}", w.points),
        header=False,
        sep=" ",
    )


@layout("Base, Shoulder, Elbow, Wrist 1 ...", "ur")
def _(w: World, p: Path) -> Case:
    names = ["Base", "Shoulder", "Elbow", "Wrist 1", "Wrist 2", "Wrist 3"]
    return plain(p, of(names, w.shown(w.read)), xyz("SMR {} [m]", w.points / 1e3, "XYZ"), digits=8)


@layout("gantry: X_axis beside x", "gantry")
def _(w: World, p: Path) -> Case:
    values = w.shown(w.read)
    return plain(
        p,
        of(("X_axis", "Y_axis", "Z_axis", "C_axis", "A_axis", "B_axis"), values),
        xyz("{}", w.points),
    )


@layout("three linear actuators of a delta")
def _(w: World, p: Path) -> Case:
    """Three spheres about the carriages meet in the platform's point, which hangs below them."""
    rng, azimuth = w.rng, np.radians([210, 330, 90])
    feet = 0.14 * np.column_stack([np.cos(azimuth), np.sin(azimuth), np.zeros(3)])
    feet[:, :2] += rng.normal(0, 5e-4, (3, 2))
    rails = np.column_stack([rng.normal(0, 1e-3, (3, 2)), np.ones(3)])
    rods = 0.3 + rng.normal(0, 5e-4, 3)

    def platform(h: Array) -> Array:
        out = []
        for C in feet + h[:, :, None] * rails / np.linalg.norm(rails, axis=1)[:, None]:
            normals = 2.0 * (C[1:] - C[0])
            equal = rods[0] ** 2 - rods[1:] ** 2 + np.square(C[1:]).sum(1) - np.square(C[0]).sum()
            line, at = np.cross(*normals), np.linalg.lstsq(normals, equal, rcond=None)[0]
            line *= -np.sign(line[2]) / np.linalg.norm(line)
            off = at - C[0]
            along = off @ line
            out.append(at + line * (np.sqrt(along**2 - off @ off + rods[0] ** 2) - along))
        return np.array(out)

    h, fresh = rng.uniform(0.3, 0.5, (POSES, 3)), rng.uniform(0.3, 0.5, (FRESH, 3))
    read = 1e3 * (h + rng.normal(0, 1e-5, h.shape))
    S = Rotation.random(random_state=7).as_matrix()
    points = platform(h) @ S.T + [1.2, -0.7, 0.4] + rng.normal(0, TRACKER, (POSES, 3))
    case = plain(p, of(("h1", "h2", "h3"), read), xyz("{}", points))
    case.options = ["--machine", "linear-delta"]
    case.stated = xyz("{} [mm]", points)
    case.fresh = of(("h1", "h2", "h3"), 1e3 * fresh), platform(fresh)
    stated = [f"h{i} [mm]" for i in (1, 2, 3)]
    case.by_hand = of(stated, read), of(stated, 1e3 * fresh)
    return case


# Mistakes, and what other programs write


@layout("two joints under each other's headers")
def _(w: World, p: Path) -> Case:
    return plain(p, joints(w, values=w.read[:, [0, 2, 1, 3, 4, 5]]), xyz("{}", w.points))


@layout("degrees under headers of radians", "ur")
def _(w: World, p: Path) -> Case:
    return plain(p, joints(w, "J{} [rad]"), xyz("{} [mm]", w.points))


@layout("millimetres under headers of metres, two files", "scara")
def _(w: World, p: Path) -> Case:
    axes = {"id": ids(w), **joints(w, "A{}")}
    return Case(
        [
            written(p / "axes.csv", axes),
            written(p / "points.csv", {"id": ids(w), **xyz("{} [m]", w.points)}),
        ]
    )


@layout("fingers of a gripper beside the joints of a URDF", "iiwa")
def _(w: World, p: Path) -> Case:
    text = (p / "robot.urdf").read_text()
    for side in ("left", "right"):
        text = text.replace(
            "</robot>",
            f'<link name="{side}"/><joint name="finger_{side}" type="prismatic">'
            f'<parent link="tool0"/><child link="{side}"/><axis xyz="0 1 0"/>'
            '<limit lower="0" upper="0.04" effort="1" velocity="1"/></joint></robot>',
        )
    (p / "robot.urdf").write_text(text)
    fingers = {f"finger_{side}": np.full(POSES, 0.02) for side in ("left", "right")}
    case = plain(p, of((f"joint_a{i}" for i in range(1, 8)), w.read), fingers, xyz("{}", w.points))
    case.options = ["--urdf", "robot.urdf"]
    return case


@layout("two files without ids, a row lost in every part")
def _(w: World, p: Path) -> Case:
    rows = np.delete(np.arange(POSES), [4, 19, 31])
    points = {k: v[rows] for k, v in xyz("{}", w.points).items()}
    files = [written(p / "joints.csv", joints(w)), written(p / "points.csv", points)]
    return Case(files, rows=rows)


@layout("a list of joints in one column")
def _(w: World, p: Path) -> Case:
    lists = [f'"[{", ".join(f"{v:.8f}" for v in row)}]"' for row in w.read]
    places = [f'"[{", ".join(f"{1e3 * v:.5f}" for v in row)}]"' for row in w.points]
    return plain(p, {"id": ids(w), "q": lists, "position": places})


@layout("KRL: {A1 12.3, A2 ...} in one column")
def _(w: World, p: Path) -> Case:
    axes = np.degrees(w.read)
    cells = ["{" + ",".join(f"A{i + 1} {v:.6f}" for i, v in enumerate(row)) + "}" for row in axes]
    return plain(p, {"$AXIS_ACT": cells}, xyz("{}", w.points, "XYZ"), sep=";")


@layout("a row per channel: pose, channel, value")
def _(w: World, p: Path) -> Case:
    columns = {**joints(w, "J{} [deg]"), **xyz("{} [mm]", w.points)}
    rows = [(i, name, column[k]) for k, i in enumerate(ids(w)) for name, column in columns.items()]
    return plain(p, dict(zip(("pose", "channel", "value"), zip(*rows, strict=True), strict=True)))


# Exports of instruments, and files of controllers and programs that are no table


def tracker(w: World, p: Path) -> str:
    """The tracker's points in a plain file."""
    return written(p / "tracker.csv", xyz("{} [mm]", w.points))


def repeated(path: Path, form: str, values: Array, head: str = "", end: str = "") -> str:
    """A text in which one form is filled with each row, {i} with its number; returns its name."""
    rows = (form.replace("{i}", str(i)) % tuple(row) for i, row in enumerate(values, 1))
    path.write_text(head + "".join(rows) + end)
    return path.name


def posed(w: World, missing: Sequence[int]) -> Case:
    """A case of a pose, whose quaternion the file by hand has too; missing: poses not seen."""
    rows = ~np.isin(np.arange(POSES), missing)
    turns = Rotation.from_matrix(w.turns).as_quat()[:, [3, 0, 1, 2]]
    return Case(
        [], rows=rows, stated={**xyz("{} [mm]", w.points), **of(("qw", "qx", "qy", "qz"), turns)}
    )


@layout("KRL: points of a .dat")
def _(w: World, p: Path) -> Case:
    form = (
        "DECL E6AXIS XP{i}={A1 %.6f,A2 %.6f,A3 %.6f,A4 %.6f,A5 %.6f,A6 %.6f,E1 0.0,E2 0.0}\n"
        'DECL FDAT FP{i}={TOOL_NO 1,BASE_NO 0,IPO_FRAME #BASE,POINT2[] " "}\n'
    )
    head = "&ACCESS RVP\n&REL 1\nDEFDAT CALIB\nEXT BAS (BAS_COMMAND :IN,REAL :IN )\n"
    name = repeated(p / "calib.dat", form, w.shown(w.read), head, "ENDDAT\n")
    return Case([name, tracker(w, p)])


@layout("Fanuc: positions of an .LS")
def _(w: World, p: Path) -> Case:
    lines = "".join(f"{i + 1:4d}:J P[{i + 1}] 20% FINE    ;\n" for i in range(POSES))
    form = (
        "P[{i}]{\n   GP1:\n\tUF : 0, UT : 1,\t\n\tJ1= %12.6f deg,\tJ2= %12.6f deg,\t"
        "J3= %12.6f deg,\n\tJ4= %12.6f deg,\tJ5= %12.6f deg,\tJ6= %12.6f deg\n};\n"
    )
    head = f"/PROG  CALIB\n/ATTR\nOWNER = MNEDITOR;\nPROG_SIZE = 1234;\n/MN\n{lines}/POS\n"
    name = repeated(p / "CALIB.LS", form, w.shown(w.read), head, "/END\n")
    return Case([name, tracker(w, p)])


_RAPID = "CONST jointtarget jPos{i}:=[[%.6f,%.6f,%.6f,%.6f,%.6f,%.6f],[9E9,9E9,9E9,9E9,9E9,9E9]];\n"


@layout("RAPID: jointtargets of a .mod")
def _(w: World, p: Path) -> Case:
    moves = "".join(f"    MoveAbsJ jPos{i + 1},v100,fine,tool0;\n" for i in range(POSES))
    head = "%%%\n  VERSION:1\n  LANGUAGE:ENGLISH\n%%%\nMODULE Calib\n  ! points\n"
    end = f"  PROC main()\n{moves}  ENDPROC\nENDMODULE\n"
    return Case([repeated(p / "Calib.mod", _RAPID, w.shown(w.read), head, end), tracker(w, p)])


@layout("RAPID beside SpatialAnalyzer: Collection::Group::Point without a header, two points lost")
def _(w: World, p: Path) -> Case:
    rows = ~np.isin(np.arange(POSES), [9, 22])
    lines = [
        f"A::Robot Points::p{i + 1}, {x:.4f}, {y:.4f}, {z:.4f}"
        for i, (x, y, z) in enumerate(1e3 * w.points)
        if rows[i]
    ]
    (p / "sa.txt").write_text("// Units: Millimeters\n" + "\n".join(lines) + "\n")
    case = Case([repeated(p / "Calib.mod", _RAPID, w.shown(w.read)), "sa.txt"], rows=rows)
    case.stated = xyz("{} [mm]", w.points)
    return case


@layout("RAPID: robtargets, which are computed")
def _(w: World, p: Path) -> Case:
    turns = Rotation.from_matrix(w.tcp_turns).as_quat()[:, [3, 0, 1, 2]]
    form = "CONST robtarget p{i}:=[[%.3f,%.3f,%.3f],[%.6f,%.6f,%.6f,%.6f],[0,0,-1,0],[9E9,9E9]];\n"
    values = np.column_stack([1e3 * w.tcp, turns])
    name = repeated(p / "Calib.mod", form, values, "MODULE Calib\n", "ENDMODULE\n")
    return Case([written(p / "joints.csv", joints(w)), name])


@layout("Yaskawa: pulses of a .JBI")
def _(w: World, p: Path) -> Case:
    ratio = np.array([1341.4, 1341.4, 1341.4, 1000.0, 1000.0, 622.0]) * 180 / np.pi
    head = f"/JOB\n//NAME CALIB\n//POS\n///NPOS {POSES},0,0,0,0,0\n///TOOL 0\n///PULSE\n"
    moves = "".join(f"MOVJ C{i + 1:05d} VJ=10.00\n" for i in range(POSES))
    form = "C000{i}=%d,%d,%d,%d,%d,%d\n"
    end = f"//INST\n///DATE 2026/01/01 10:00\nNOP\n{moves}END\n"
    name = repeated(p / "CALIB.JBI", form, np.round(w.read * ratio), head, end)
    case = Case([name, tracker(w, p)])
    case.fresh = of((f"C {i}" for i in range(1, 7)), w.fresh * ratio), w.target(w.fresh)
    stated = [f"J{i} [deg]" for i in range(1, 7)]
    case.by_hand = of(stated, w.shown(w.read)), of(stated, w.shown(w.fresh))
    case.effect = _SCALES
    return case


@layout("VAL 3: joints of a .dtx")
def _(w: World, p: Path) -> Case:
    form = '<Value key="{i}" j1="%.6f" j2="%.6f" j3="%.6f" j4="%.6f" j5="%.6f" j6="%.6f" />\n'
    head = '<?xml version="1.0"?>\n<Database>\n<Data name="jPos" type="jointRx" size="36">\n'
    name = repeated(p / "calib.dtx", form, w.shown(w.read), head, "</Data></Database>\n")
    return Case([name, tracker(w, p)])


@layout("rostopic echo: YAML")
def _(w: World, p: Path) -> Case:
    names = ", ".join(f"joint_a{i}" for i in range(1, 7))
    form = (
        "header:\n  seq: {i}\n  stamp:\n    secs: {i}\n  frame_id: ''\nname: [" + names + "]\n"
        "position: [%.9f, %.9f, %.9f, %.9f, %.9f, %.9f]\nvelocity: []\neffort: []\n---\n"
    )
    return Case([repeated(p / "joints.yaml", form, w.read), tracker(w, p)])


@layout("JSON: a list of records")
def _(w: World, p: Path) -> Case:
    rows = zip(w.read.tolist(), w.points.tolist(), strict=True)
    (p / "data.json").write_text(json.dumps([{"joints": q, "position": x} for q, x in rows]))
    return Case(["data.json"])


@layout("JSON: a record per line")
def _(w: World, p: Path) -> Case:
    rows = enumerate(zip(w.read.tolist(), w.points.tolist(), strict=True))
    lines = [json.dumps({"t": 0.5 * i, "q": q, "p": x}) for i, (q, x) in rows]
    (p / "data.jsonl").write_text("\n".join(lines))
    return Case(["data.jsonl"])


@layout("JSON: lists of all rows")
def _(w: World, p: Path) -> Case:
    (p / "data.json").write_text(json.dumps({"q": w.read.tolist(), "p": w.points.tolist()}))
    return Case(["data.json"])


@layout("NumPy: two .npy")
def _(w: World, p: Path) -> Case:
    np.save(p / "q.npy", w.read)
    np.save(p / "p.npy", w.points)
    return Case(["q.npy", "p.npy"])


@layout("NumPy: .npz, one array transposed", "ur")
def _(w: World, p: Path) -> Case:
    np.savez(p / "data.npz", q=w.read, p=w.points.T, base=np.eye(4))
    return Case(["data.npz"])


@layout("MATLAB: a struct of matrices, one transposed")
def _(w: World, p: Path) -> Case:
    from scipy.io import savemat

    savemat(p / "data.mat", {"log": {"q": w.read, "p": w.points.T, "date": "today"}})
    return Case(["data.mat"])


@layout("MATLAB: two matrices beside a calibration matrix", "iiwa")
def _(w: World, p: Path) -> Case:
    from scipy.io import savemat

    savemat(p / "data.mat", {"Q": w.read, "P": w.points, "T_base": np.eye(4)})
    return Case(["data.mat"])


@layout("OptiTrack: five rows of headers")
def _(w: World, p: Path) -> Case:
    case, turns = posed(w, [7]), Rotation.from_matrix(w.turns).as_quat()
    head = [
        "Format Version,1.23,Take Name,Take 1,Capture Frame Rate,120.0,Rotation Type,Quaternion",
        "",
        ",Type," + ",".join(["Rigid Body"] * 8),
        ",Name," + ",".join(["ee"] * 8),
        ",," + ",".join(["Rotation"] * 4 + ["Position"] * 3 + ["Mean Marker Error"]),
        "Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,",
    ]
    for i, row in enumerate(np.hstack([turns, w.points])):
        cells = [f"{v:.7f}" for v in row] + ["0.0003"] if i != 7 else [""] * 8
        head.append(f"{i},{i / 120:.6f}," + ",".join(cells))
    (p / "take.csv").write_text("\n".join(head) + "\n")
    case.files = [written(p / "joints.csv", joints(w)), "take.csv"]
    return case


@layout("NDI Polaris: a number for what is missing")
def _(w: World, p: Path) -> Case:
    case, lost = posed(w, [4, 17, 30]), -3.697314e28
    turns = Rotation.from_matrix(w.turns).as_quat()[:, [3, 0, 1, 2]]
    values = np.column_stack([turns, 1e3 * w.points])
    rows = ["Tools,Port 1,Frame,State,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error"]
    for i, row in enumerate(values):
        seen = bool(case.rows[i])
        cells = ",".join(f"{v:.7f}" if seen else f"{lost:.6E}" for v in (*row, 0.07))
        rows.append(f"1,Port 1,{5000 + 17 * i},{'OK' if seen else 'Missing'},{cells}")
    (p / "ndi.csv").write_text("\n".join(rows) + "\n")
    case.files = [written(p / "joints.csv", joints(w, "joint_{}")), "ndi.csv"]
    return case


@layout("SpatialAnalyzer: // above, no header")
def _(w: World, p: Path) -> Case:
    head = "// Exported from SpatialAnalyzer\n// Units: Millimeters\n"
    form = "A, Robot::Grid, p{i}, %.5f, %.5f, %.5f\n"
    name = repeated(p / "sa.txt", form, 1e3 * w.points, head)
    return Case([written(p / "joints.csv", joints(w)), name])


@layout("PolyWorks: a row per coordinate")
def _(w: World, p: Path) -> Case:
    near = w.points + w.rng.normal(0, 1e-3, w.points.shape)
    rows = ["PolyWorks Inspector;2024;;;", "Piece: 1;;;;", ";;;;"]
    rows.append("Name;Control;Nominal;Measured;Deviation")
    for i, both in enumerate(zip(1e3 * near, 1e3 * w.points, strict=True), 1):
        for axis, a, b in zip("XYZ", *both, strict=True):
            rows.append(f"pt{i};{axis};{a:.4f};{b:.4f};{b - a:.4f}")
    (p / "pw.csv").write_text("\n".join(rows) + "\n")
    labels = [f"pt{i + 1}" for i in range(POSES)]
    return Case([written(p / "joints.csv", {"Point": labels, **joints(w)}), "pw.csv"])


@layout("Verisurf: nominal, actual and delta in inches")
def _(w: World, p: Path) -> Case:
    near = w.points + w.rng.normal(0, 1e-3, w.points.shape)
    inches = [of((f"{n} {a}" for a in "XYZ"), v / 0.0254) for n, v in (("Nominal", near),)]
    inches.append(of((f"Actual {a}" for a in "XYZ"), w.points / 0.0254))
    delta = {"3D Delta": np.linalg.norm(near - w.points, axis=1) / 0.0254}
    return plain(p, {"Label": ids(w, "Pt {}")}, joints(w, "Axis {}"), *inches, delta)


@layout("API: UTF-16, six lines above the header")
def _(w: World, p: Path) -> Case:
    seen = polar(w.points)
    head = "API Radian Measurement File\r\nDate:\t2026-01-01\r\nTemp(C):\t20.3\r\n\r\n"
    head += "Index\tGroup\tTarget\tDistance(mm)\tAzimuth(deg)\tElevation(deg)\tRMS(mm)\r\n"
    rows = [f"{i}\tA\tSMR\t{d:.5f}\t{a:.7f}\t{e:.7f}\t0.004" for i, (d, a, e) in enumerate(seen, 1)]
    (p / "api.txt").write_text(head + "\r\n".join(rows) + "\r\n", encoding="utf-16")
    stated = of(("range [mm]", "azimuth [deg]", "elevation [deg]"), seen)
    return Case([written(p / "joints.csv", joints(w, "J{} (deg)")), "api.txt"], stated=stated)


@layout("FARO: X, Y, Z before each number")
def _(w: World, p: Path) -> Case:
    name = repeated(p / "faro.txt", "M_POINT{i}  X %.4f  Y %.4f  Z %.4f\n", 1e3 * w.points)
    return Case([written(p / "joints.csv", joints(w)), name])


@layout("Hz, V and D in two files", "iiwa")
def _(w: World, p: Path) -> Case:
    r, a, e = polar(w.points, 200 / 180).T
    number = {"N°": [str(i + 1) for i in range(POSES)]}
    leica = {"PointId": number["N°"], "Hz [gon]": a % 400, "V [gon]": 100 - e, "D [m]": 1e-3 * r}
    files = [
        written(p / "robot.txt", {**number, **joints(w, "q{} (deg)")}, sep="\t"),
        written(p / "leica.csv", leica, sep=";", digits=7),
    ]
    stated = {"range [mm]": r, "azimuth [deg]": 0.9 * a, "elevation [deg]": 0.9 * e}
    return Case(files, stated=stated)


@layout("a sheet with a title, merged headers and units below")
def _(w: World, p: Path) -> Case:
    import xlsxwriter

    book = xlsxwriter.Workbook(str(p / "data.xlsx"))
    sheet = book.add_worksheet("Protokoll")
    sheet.write(0, 0, "Messprotokoll Roboter 7")
    sheet.write(2, 0, "Nr.")
    sheet.merge_range(2, 1, 2, 6, "Gelenkwinkel")
    sheet.merge_range(2, 7, 2, 9, "Lasertracker")
    sheet.write_row(3, 1, [*(f"A{i}" for i in range(1, 7)), *"XYZ"])
    sheet.write_row(4, 1, ["°"] * 6 + ["mm"] * 3)
    for i, row in enumerate(np.hstack([w.shown(w.read), 1e3 * w.points]).tolist()):
        sheet.write_row(5 + i, 0, [i + 1, *row])
    book.close()
    return Case(["data.xlsx"])


@layout("pandas: index and two levels of columns", "ur")
def _(w: World, p: Path) -> Case:
    head = "," + ",".join(["joints"] * 6 + ["tracker"] * 3) + "\n"
    head += "," + ",".join([*(f"j{i}" for i in range(1, 7)), *"xyz"]) + "\n"
    form = "{i}," + ",".join(["%.9f"] * 9) + "\n"
    return Case([repeated(p / "log.csv", form, np.hstack([w.read, w.points]), head)])


@layout("pandas: an index, sorted down")
def _(w: World, p: Path) -> Case:
    head = "," + ",".join([*(f"j{i}" for i in range(1, 7)), *"xyz"]) + "\n"
    rows = [
        ",".join([str(i), *(f"{v:.9f}" for v in (*q, *x))])
        for i, (q, x) in enumerate(zip(w.read, w.points, strict=True))
    ]
    (p / "log.csv").write_text(head + "\n".join(rows[::-1]) + "\n")
    return Case(["log.csv"])


@layout("numpy.savetxt, two files")
def _(w: World, p: Path) -> Case:
    np.savetxt(p / "q.txt", w.read)
    np.savetxt(p / "p.txt", w.points)
    return Case(["q.txt", "p.txt"])


@layout("German words for the joints of a UR, decimal comma", "ur")
def _(w: World, p: Path) -> Case:
    names = ("Base", "Schulter", "Ellbogen", "Handgelenk 1", "Handgelenk 2", "Handgelenk 3")
    return plain(
        p,
        {"Zeit": 0.008 * np.arange(POSES)},
        of((f"{n} (°)" for n in names), w.shown(w.read)),
        xyz("{} / mm", w.points, "XYZ"),
        sep=";",
        decimal=",",
        encoding="utf-8-sig",
    )


# Written before any look at the readers, which were right on 16 of them and silently wrong on 2


@layout("Denso: No, J1 ... J8, Comment")
def _(w: World, p: Path) -> Case:
    zero = ["0"] * POSES
    robot = {
        "No": [str(i) for i in range(POSES)],
        **joints(w),
        "J7": zero,
        "J8": zero,
        "Comment": [""] * POSES,
    }
    points = {"No": robot["No"], **xyz("{}", w.points, "XYZ")}
    return Case([written(p / "Var_J.csv", robot), written(p / "tracker.csv", points)])


@layout("Mitsubishi: J1=(...) of a .prg")
def _(w: World, p: Path) -> Case:
    form = "J{i}=(%+.5f,%+.5f,%+.5f,%+.5f,%+.5f,%+.5f,+0.00,+0.00)\n"
    head = (
        "".join(f"{10 * (i + 1)} Mov J{i + 1}\n" for i in range(POSES))
        + f"{10 * (POSES + 1)} End\n"
    )
    return Case([repeated(p / "CAL.prg", form, w.shown(w.read), head), tracker(w, p)])


@layout("Staubli: command and feedback of each joint in turn")
def _(w: World, p: Path) -> Case:
    cmd, fbk = w.shown(w.command), w.shown(w.read)
    cols: dict[str, Any] = {"time[s]": 0.004 * np.arange(POSES)}
    for i in range(6):
        cols[f"JPOS_CMD[{i}]"] = cmd[:, i]
        cols[f"JPOS_FBK[{i}]"] = fbk[:, i]
    return plain(p, cols, xyz("M{}", w.points), sep=";")


@layout("Doosan: actual and target positions, tool position, alphabetical")
def _(w: World, p: Path) -> Case:
    abc = Rotation.from_matrix(w.tcp_turns).as_euler("ZYZ", degrees=True)
    cols = {
        **of((f"actual_joint_position[{i}]" for i in range(6)), w.shown(w.read)),
        **of((f"actual_joint_torque[{i}]" for i in range(6)), w.rng.normal(0, 20, w.q.shape)),
        **of((f"actual_tool_position[{i}]" for i in range(6)), np.hstack([1e3 * w.tcp, abc])),
        **of((f"target_joint_position[{i}]" for i in range(6)), w.shown(w.command)),
        **of((f"tracker[{i}]" for i in range(3)), 1e3 * w.points),
    }
    return plain(p, cols)


@layout("Techman: lists in braces beside the controller's flange")
def _(w: World, p: Path) -> Case:
    def cells(values: Array) -> list[str]:
        return ['"{' + ",".join(f"{v:.5f}" for v in row) + '}"' for row in values]

    abc = Rotation.from_matrix(w.tcp_turns).as_euler("xyz", degrees=True)
    return plain(
        p,
        {
            "Time": [f"14:{i // 60:02d}:{i % 60:02d}" for i in range(POSES)],
            "Joint_Angle": cells(w.shown(w.read)),
            "Coord_Base_Flange": cells(np.hstack([1e3 * w.tcp, abc])),
            "Tracker_Point": cells(1e3 * w.points),
        },
    )


@layout("Epson: Agl(1) ... Agl(4)", "scara")
def _(w: World, p: Path) -> Case:
    return plain(
        p,
        {"PointNo": [str(i) for i in range(POSES)]},
        joints(w, "Agl({})"),
        xyz("Meas{}", w.points, "XYZ"),
        sep="\t",
    )


@layout("Epson: a .pts of computed points beside joints and a tracker", "scara")
def _(w: World, p: Path) -> Case:
    form = 'Point%d {\n\tnNumber=%d\n\tsLabel="P%d"\n\trX=%.3f\n\trY=%.3f\n\trZ=%.3f\n\trU=0.0\n}'
    lines = ["[Points]", f"NumberOfPoints={POSES}"]
    lines += [form % (i + 1, i, i, *v) for i, v in enumerate(1e3 * w.tcp)]
    (p / "robot1.pts").write_text("\n".join(lines) + "\n")
    return Case(
        [
            written(p / "joints.csv", {"Punto": [f"P{i}" for i in range(POSES)], **joints(w)}),
            written(
                p / "tracker.csv", {"Punto": [f"P{i}" for i in range(POSES)], **xyz("{}", w.points)}
            ),
            "robot1.pts",
        ]
    )


@layout("Leica AT960: std of each, environment; robot in Spanish")
def _(w: World, p: Path) -> Case:
    n = [f"Punto_{i + 1}" for i in range(POSES)]
    robot = {"Punto": n, **joints(w, "Eje {} (grados)"), "Velocidad (%)": ["20"] * POSES}
    leica = {
        "Point ID": n,
        **xyz("{} [mm]", w.points, "XYZ"),
        **{f"Std {a} [mm]": np.full(POSES, 0.03) for a in "XYZ"},
        "Std Total [mm]": np.full(POSES, 0.052),
        "Timestamp": [f"2026-11-{1 + i // 24:02d} {i % 24:02d}:00:00" for i in range(POSES)],
        "Temperature [°C]": np.full(POSES, 20.3),
        "Pressure [hPa]": np.full(POSES, 1013.2),
        "Humidity [%]": np.full(POSES, 44.0),
    }
    return Case(
        [
            written(p / "robot.csv", robot, sep=";", decimal=","),
            written(p / "AT960.csv", leica, sep=";"),
        ]
    )


@layout("Italian: Giunto, Misurato beside Teorico", "ur")
def _(w: World, p: Path) -> Case:
    return plain(
        p,
        {"Punto": ids(w)},
        joints(w, "Giunto {} [gradi]"),
        xyz("{} Teorico [mm]", w.commanded, "XYZ"),
        xyz("{} Misurato [mm]", w.points, "XYZ"),
        sep=";",
        decimal=",",
        encoding="cp1252",
    )


@layout("FARO CAM2: quoted names, no header, blanks")
def _(w: World, p: Path) -> Case:
    lines = [
        f'"Point {i + 1}"   {x:.4f}  {y:.4f}  {z:.4f}  0.012'
        for i, (x, y, z) in enumerate(1e3 * w.points)
    ]
    (p / "faro.txt").write_text("\n".join(lines) + "\n")
    return Case(
        [
            written(
                p / "robot.csv",
                {"Name": [f"Point {i + 1}" for i in range(POSES)], **joints(w, "Axis{}")},
            ),
            "faro.txt",
        ]
    )


@layout("Creaform VXtrack: Tx Ty Tz Rx Ry Rz", "ur")
def _(w: World, p: Path) -> Case:
    rot = Rotation.from_matrix(w.turns).as_euler("xyz", degrees=True)
    case = plain(
        p,
        {"Frame": [str(i) for i in range(POSES)]},
        joints(w, "J{} (deg)"),
        xyz("T{} (mm)", w.points),
        of(("Rx (deg)", "Ry (deg)", "Rz (deg)"), rot),
    )
    case.stated = xyz("{} [mm]", w.points) | of(
        ("qw", "qx", "qy", "qz"), Rotation.from_matrix(w.turns).as_quat()[:, [3, 0, 1, 2]]
    )
    return case


@layout("Vicon: Trajectories, two markers", "iiwa")
def _(w: World, p: Path) -> Case:
    lines = [
        "Trajectories",
        "100",
        ",,tool:m1,,,tool:m2,,",
        "Frame,Sub Frame,X,Y,Z,X,Y,Z",
        ",,mm,mm,mm,mm,mm,mm",
    ]
    lines += [
        f"{i + 1},0," + ",".join(f"{1e3 * v:.4f}" for v in (*a, *b))
        for i, (a, b) in enumerate(zip(w.points, w.second, strict=True))
    ]
    (p / "vicon.csv").write_text("\n".join(lines) + "\n")
    case = Case([written(p / "joints.csv", joints(w, "joint_a{}")), "vicon.csv"])
    case.stated = xyz("{}1 [mm]", w.points) | xyz("{}2 [mm]", w.second)
    return case


@layout("Portuguese: Junta, Posição medida, cp1252")
def _(w: World, p: Path) -> Case:
    return plain(
        p,
        {"Ponto": [str(i + 1) for i in range(POSES)]},
        joints(w, "Junta {} (graus)"),
        xyz("Posição medida {} (mm)", w.points, "XYZ"),
        {"Observação": ["ok"] * POSES},
        sep=";",
        decimal=",",
        encoding="cp1252",
    )


@layout("Korean: CP949, 1축 ..., 측정 X")
def _(w: World, p: Path) -> Case:
    return plain(
        p,
        {"번호": [str(i + 1) for i in range(POSES)]},
        joints(w, "{}축 각도(도)"),
        xyz("측정 {}(mm)", w.points, "XYZ"),
        encoding="cp949",
    )


@layout("Japanese: 第1軸 ..., 計測値X beside 指令値X")
def _(w: World, p: Path) -> Case:
    return plain(
        p,
        {"ポイント番号": [str(i + 1) for i in range(POSES)]},
        joints(w, "第{}軸角度[度]"),
        xyz("指令値{}[mm]", w.commanded, "XYZ"),
        xyz("計測値{}[mm]", w.points, "XYZ"),
        encoding="shift_jis",
    )


@layout("Chinese: 1轴, 理论X beside 实测X")
def _(w: World, p: Path) -> Case:
    return plain(
        p,
        {"点号": ids(w)},
        joints(w, "{}轴角度(度)"),
        xyz("理论{}(mm)", w.commanded, "XYZ"),
        xyz("实测{}(mm)", w.points, "XYZ"),
        encoding="gb18030",
    )


@layout("Polish: Oś 1 [°], X zmierzone beside X nominalne")
def _(w: World, p: Path) -> Case:
    return plain(
        p,
        {"Lp.": [str(i + 1) for i in range(POSES)]},
        joints(w, "Oś {} [°]"),
        xyz("{} nominalne [mm]", w.commanded, "XYZ"),
        xyz("{} zmierzone [mm]", w.points, "XYZ"),
        sep=";",
        decimal=",",
        encoding="cp1250",
    )


@layout("Kawasaki: .JOINTS of an .as file")
def _(w: World, p: Path) -> Case:
    form = "#p{i} %.5f %.5f %.5f %.5f %.5f %.5f\n"
    head = (
        ".PROGRAM calib()\n"
        + "".join(f"  JMOVE #p{i + 1}\n" for i in range(POSES))
        + ".END\n.JOINTS\n"
    )
    return Case([repeated(p / "calib.as", form, w.shown(w.read), head, ".END\n"), tracker(w, p)])


@layout("KUKA RSI: a line of XML per pose")
def _(w: World, p: Path) -> Case:
    abc = Rotation.from_matrix(w.tcp_turns).as_euler("ZYX", degrees=True)
    lines = []
    for i in range(POSES):
        a = " ".join(f'A{k + 1}="{v:.6f}"' for k, v in enumerate(w.shown(w.read)[i]))
        s = " ".join(f'A{k + 1}="{v:.6f}"' for k, v in enumerate(w.shown(w.command)[i]))
        r = " ".join(
            f'{n}="{v:.4f}"' for n, v in zip("XYZABC", (*1e3 * w.tcp[i], *abc[i]), strict=True)
        )
        lines.append(
            f'<Rob Type="KUKA"><RIst {r}/><AIPos {a}/><ASPos {s}/>'
            f"<IPOC>{4208163634 + 4 * i}</IPOC></Rob>"
        )
    (p / "rsi.xml").write_text("\n".join(lines) + "\n")
    return Case(["rsi.xml", tracker(w, p)])


@layout("Franka: q and O_T_EE of each line of JSON", "panda")
def _(w: World, p: Path) -> Case:
    lines = []
    for i in range(POSES):
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = w.tcp_turns[i], w.tcp[i]
        lines.append(
            json.dumps(
                {
                    "time": 0.001 * i,
                    "q": w.read[i].round(9).tolist(),
                    "q_d": w.command[i].round(9).tolist(),
                    "dq": [0.0] * 7,
                    "O_T_EE": T.T.ravel().round(9).tolist(),
                    "tau_J": w.rng.normal(0, 5, 7).round(4).tolist(),
                }
            )
        )
    (p / "states.jsonl").write_text("\n".join(lines) + "\n")
    return Case(["states.jsonl", written(p / "tracker.csv", xyz("{} [mm]", w.points))])


@layout("URScript: movej of a .script", "ur")
def _(w: World, p: Path) -> Case:
    form = "  movej([%.8f, %.8f, %.8f, %.8f, %.8f, %.8f], a=1.4, v=0.5)\n  sleep(2)\n"
    name = repeated(
        p / "calib.script",
        form,
        w.read,
        "def calib():\n  set_tcp(p[0,0,0.15,0,0,0])\n",
        "end\ncalib()\n",
    )
    return Case([name, written(p / "tracker.csv", xyz("{} [mm]", w.points))])


@layout("units within the cells: 12.345°, 1234.5 mm")
def _(w: World, p: Path) -> Case:
    cells: dict[str, Any] = {
        f"J{k + 1}": [f"{v:.5f}°" for v in w.shown(w.read)[:, k]] for k in range(6)
    }
    cells |= {a: [f"{1e3 * v:.4f} mm" for v in w.points[:, k]] for k, a in enumerate("XYZ")}
    return plain(p, {"Pose": ids(w)}, cells, sep="\t")


@layout("a total station: Hz and V in degrees, minutes, seconds")
def _(w: World, p: Path) -> Case:
    r, a, e = polar(w.points).T

    def dms(v: Array) -> list[str]:
        s = np.round(np.mod(v, 360.0) * 36000).astype(int)
        return [f"{x // 36000}°{x // 600 % 60:02d}'{x % 600 / 10:04.1f}\"" for x in s]

    n = [str(i + 1) for i in range(POSES)]
    files = [
        written(p / "robot.csv", {"Pt": n, **joints(w, "A{} (deg)")}, sep=";"),
        written(
            p / "ts.csv", {"Pt": n, "Hz": dms(a), "V": dms(90 - e), "Sd [m]": r / 1e3}, sep=";"
        ),
    ]
    return Case(files, stated={"range [mm]": r, "azimuth [deg]": a, "elevation [deg]": e})


@layout("a sheet with a column per pose")
def _(w: World, p: Path) -> Case:
    import xlsxwriter

    book = xlsxwriter.Workbook(str(p / "data.xlsx"))
    sheet = book.add_worksheet("Messung")
    sheet.write_row(0, 0, ["Pose", *(f"P{i + 1}" for i in range(POSES))])
    names = [*(f"J{k + 1} [°]" for k in range(6)), *(f"{a} [mm]" for a in "XYZ")]
    for k, (n, v) in enumerate(
        zip(names, np.hstack([w.shown(w.read), 1e3 * w.points]).T, strict=True)
    ):
        sheet.write_row(k + 1, 0, [n, *v.tolist()])
    book.close()
    return Case(["data.xlsx"])


# The robot's description


def roll_pitch_yaw(R: Array) -> tuple[float, float, float]:
    """Of R = Rz(yaw) Ry(pitch) Rx(roll); yaw is 0 where only its sum with roll is determined."""
    flat = float(np.hypot(R[0, 0], R[1, 0]))
    pitch = float(np.arctan2(-R[2, 0], flat))
    if flat < 1e-9:
        return float(np.arctan2(-R[1, 2], R[1, 1])), pitch, 0.0
    return float(np.arctan2(R[2, 1], R[2, 2])), pitch, float(np.arctan2(R[1, 0], R[0, 0]))


def described(w: World, folder: Path) -> None:
    """dh.csv and robot.urdf of the drawing."""
    head = ["a [mm]", "alpha [deg]", "d [mm]", "theta [deg]", "type"]
    lines = [",".join(head)]
    lines += [
        f"{a},{al},{d},{th},{kind}"
        for a, d, al, th, kind in (PANDA if w.modified else ROBOTS[w.robot])
    ]
    (folder / "dh.csv").write_text("\n".join(lines) + "\n")
    before, body = np.eye(4), []
    prefix = "panda_joint" if w.modified else "joint_a"
    for i, ((a, d, alpha, theta), slide) in enumerate(zip(w.drawn, w.slides, strict=True), 1):
        turn, twist = np.eye(4), np.eye(4)
        turn[:3, :3], turn[2, 3] = Rotation.from_euler("z", theta).as_matrix(), d
        twist[:3, :3], twist[0, 3] = Rotation.from_euler("x", alpha).as_matrix(), a
        T = before @ twist @ turn if w.modified else before @ turn
        before = np.eye(4) if w.modified else twist
        r, q, y = roll_pitch_yaw(T[:3, :3])
        where = " ".join(f"{v:.12g}" for v in T[:3, 3])
        body.append(
            f'<joint name="{prefix}{i}" type="{"prismatic" if slide else "revolute"}">'
            f'<parent link="l{i - 1}"/><child link="l{i}"/><axis xyz="0 0 1"/>'
            f'<origin xyz="{where}" rpy="{r:.12g} {q:.12g} {y:.12g}"/>'
            '<limit lower="-3" upper="3" effort="1" velocity="1"/></joint>'
        )
    n = len(w.drawn)
    r, q, y = roll_pitch_yaw(before[:3, :3])
    where = " ".join(f"{v:.12g}" for v in before[:3, 3])
    body.append(
        f'<joint name="tip" type="fixed"><parent link="l{n}"/><child link="tool0"/>'
        f'<origin xyz="{where}" rpy="{r:.12g} {q:.12g} {y:.12g}"/></joint>'
    )
    links = "".join(f'<link name="l{i}"/>' for i in range(n + 1)) + '<link name="tool0"/>'
    (folder / "robot.urdf").write_text(f'<robot name="r">{links}{"".join(body)}</robot>')


# The judgement


def error(w: World, folder: Path) -> float:
    """Rms true error [m] at fresh poses of the project's calibrated machine, placed rigidly."""
    import loopcal as lc
    from loopcal.estimation.mounted import bodies_of
    from loopcal.mechanisms.frame import ChainFrame

    project = lc.read_project(folder / "project.toml")
    machine = project.mechanism
    result = lc.calibrate(
        machine,
        lc.load_dataset(project).dataset,
        noise=project.noise.noise(),
        method="implicit-loop",
    )
    values = {p.name: p.nominal for p in machine.parameters} | dict(result.value)
    counts = {step.joint: step.direction for step in machine.chain if step.joint}
    joints = {name: s * q for (name, s), q in zip(counts.items(), w.fresh.T, strict=True)}
    bodies = bodies_of(ChainFrame(machine.chain, joints, values), FRESH)
    ends = {n[:-2] for n in values if n.endswith("_x") and n.startswith("tool")}
    return min(
        _off(bodies.at(np.array([values[f"{t}_{a}"] for a in "xyz"])), w.target(w.fresh))
        for t in ends
    )


def predicted_error(folder: Path, columns: dict[str, Any], true: Array) -> float:
    """Rms true error [m] of what `predict` makes of fresh readings, placed rigidly."""
    import loopcal as lc

    project = str(folder / "project.toml")
    options = ["--method", "implicit-loop", "--no-report"]
    failed, why = begin([project, *options], folder, "calibrate")
    assert failed in (0, 4), why  # a verdict of "no" is a result too
    written(folder / "fresh.csv", columns)
    outputs = lc.load(folder / "project-result").predict(folder / "fresh.csv").outputs
    return _off(np.stack([*outputs.values()], axis=-1), true)


def _off(p: Array, true: Array) -> float:
    a, b = p - p.mean(axis=0), true - true.mean(axis=0)
    turn = Rotation.align_vectors(b, a)[0]
    return float(np.sqrt(np.square(b - turn.apply(a)).sum(axis=1).mean()))


def begin(arguments: Sequence[str], folder: Path, command: str = "init") -> tuple[int, str]:
    """`loopcal` as a user calls it in this folder: exit code and all that it printed."""
    from loopcal.cli.run import main

    out, err = io.StringIO(), io.StringIO()
    with contextlib.chdir(folder), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = main([command, *arguments])
        except SystemExit as stop:
            code = int(stop.code or 0)
    return int(code or 0), out.getvalue() + err.getvalue()


def next_command(text: str) -> list[str] | None:
    """The arguments of the last `loopcal ...` line of a refusal."""
    lines = [line.strip() for line in text.splitlines() if line.strip().startswith("loopcal ")]
    commands = [shlex.split(line)[1:] for line in lines if "written:" not in line]
    return commands[-1] if commands else None


def judged(name: str, seed: int, folder: Path) -> tuple[str, str]:
    """The class of one layout, and the words of it."""
    robot, maker = LAYOUTS[name]
    w = World(robot, seed)
    described(w, folder)
    case = maker(w, folder)
    robot_file = [] if {"--urdf", "--machine"} & {*case.options} else ["--dh", "dh.csv"]
    arguments = [*case.files, *robot_file, *case.options]
    code, text = begin([*arguments, "--out", "mine"], folder)
    by_next = ""
    if "Traceback" in text:
        return "fault", text
    if code:
        command = next_command(text)
        if not command:
            return "refused without help", text
        if command[0] != "init" or command == ["init", *arguments, "--out", "mine"]:
            return "refused with next command", text
        code, further = begin([*command[1:]], folder)
        text += f"\n--- next: {shlex.join(command)}\n{further}"
        by_next = " by the next command"
        if code:
            return "refused with next command", text
        if not (folder / "mine" / "project.toml").exists():
            return "refused without help", text
    seen = xyz("{} [mm]", w.points) if case.stated is None else case.stated
    sane = {**(case.by_hand[0] if case.by_hand else joints(w, "J{} [deg]")), **seen}
    if any(w.slides) and not case.by_hand:
        sane = dict(
            zip(
                (
                    k.replace("deg", "mm") if s else k
                    for k, s in zip(sane, [*w.slides, *[0] * len(seen)], strict=True)
                ),
                sane.values(),
                strict=True,
            )
        )
    sane = {k: np.asarray(v)[case.rows] for k, v in sane.items()}
    hand = folder / "hand"
    hand.mkdir()
    written(hand / "data.csv", sane)
    robot_file = ["--urdf", "../robot.urdf"] if w.modified else ["--dh", "../dh.csv"]
    if w.modified:
        (hand / "data.csv").write_text((hand / "data.csv").read_text().replace("J", "panda_joint"))
    if "--machine" in case.options:
        robot_file = case.options
    failed, why = begin(["data.csv", *robot_file, "--out", "."], hand)
    assert not failed, why
    if case.effect:
        project = hand / "project.toml"
        head = "[mechanism.parameters]\n"
        project.write_text(project.read_text("utf-8").replace(head, case.effect, 1), "utf-8")
    if case.fresh and case.by_hand:
        mine = predicted_error(folder / "mine", *case.fresh)
        ratio = mine / predicted_error(hand, case.by_hand[1], case.fresh[1])
    else:
        mine = error(w, folder / "mine")
        ratio = mine / error(w, hand)
    words = f"true error {1e3 * mine:.3f} mm, {ratio:.2f} of that by hand"
    if ratio <= RIGHT:
        return f"right{by_next}", f"{words}\n{text}"
    return "silently wrong", f"{words}\n{text}"


def main() -> None:
    """Print the class of every layout, and the counts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default="")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--show", action="store_true")
    given = parser.parse_args()
    counts: Counter[str] = Counter()
    for name in LAYOUTS:
        if given.only not in name:
            continue
        with TemporaryDirectory() as folder, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                kind, text = judged(name, given.seed, Path(folder))
            except Exception as fault:
                kind, text = "fault", f"{type(fault).__name__}: {fault}"
                if given.show:
                    raise
        counts[kind] += 1
        first = text.splitlines()[0] if text else ""
        print(f"{kind:28}{name}" + (f"   {first[:110]}" if kind != "right" else ""), flush=True)
        if given.show:
            print(text)
    print(", ".join(f"{v} {k}" for k, v in counts.most_common()), f"of {sum(counts.values())}")


if __name__ == "__main__":
    main()
