"""Tables of a calibrated arm as CSV: zeros, tool and base, and Denavit-Hartenberg parameters.

Any chain of joints in the parameters of Denavit and Hartenberg, classical and modified.

    classical:  T_base_tip = B  Rz(theta_1) Tz(d_1) Tx(a_1) Rx(alpha_1)  Rz(theta_2) ...  T
    modified:   T_base_tip = B  Rz(theta_1) Tz(d_1)  Rx(alpha_1) Tx(a_1) Rz(theta_2) ...  T

with theta_i = offset_i + factor_i q_i (of a slide d_i = offset_i + factor_i q_i). a_i and alpha_i
follow from the common normal of the axes i and i+1; the frames of the first and the last joint
are free and put all of their place into the base B and the tool T. Modified tables (Craig 1986)
hold the same numbers, a and alpha one row lower.

Axes that are nearly parallel have their common normal far away: d_i and d_i+1 then grow, exactly
opposite, and nothing is wrong. Sources: Denavit and Hartenberg (1955); Craig (1986).
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from loopcal.arrays import Array
from loopcal.companions.robot.exports.format import ExportFiles, ExportOptions, Format
from loopcal.companions.robot.exports.urdf import decimal
from loopcal.companions.robot.programs.program import written
from loopcal.document.exported import Exported, Placed
from loopcal.errors import unknown_name
from loopcal.measurements.poses import cell_text
from loopcal.mechanisms.rest import RestChain, RestJoint, quaternion, roll_pitch_yaw


def csv_text(rows: Iterable[Sequence[str]]) -> str:
    """A table as CSV."""
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows([map(cell_text, row) for row in rows])
    return out.getvalue()


def accuracy_csv(exported: Exported) -> str:
    """What each model of the machine reaches, in mm."""
    rows = [["model", "rms [mm]", "95 % [mm]", "max [mm]", "from the full model, rms [mm]"]]
    for one in exported.accuracy:
        rows.append([one.model, *("" if v is None else f"{1e3 * v:.6g}" for v in one.figures)])
    return csv_text(rows)


def zeros(exported: Exported, options: ExportOptions) -> ExportFiles:
    """zeros.csv: what to add to each reading, and what the pendant reads at the true zero."""
    joints = [zero.joint for zero in exported.zeros]
    for name in options.counts:
        if name not in joints:
            raise unknown_name(
                f"counts are stated for {name!r}, which is not a joint", name, joints
            )
    head = ["joint", "unit", "correction", "U95", "pendant reads at the true zero"]
    head += ["counts", "determined"]
    rows = [head]
    for zero in exported.zeros:
        unit = "mm" if zero.unit == "m" else "deg"
        factor = 1e3 if zero.unit == "m" else math.degrees(1.0)
        # Adding 0.0 makes 0.0 of -0.0.
        value = factor * zero.offset + 0.0
        half = "" if zero.u95 is None else f"{factor * zero.u95:.3g}"
        counts = options.counts.get(zero.joint)
        pendant_counts = "" if counts is None else f"{round(value * counts):d}"
        # The true angle is the reading plus the offset, so the reading at the true zero is -offset.
        cells = [written(value, 6), half, written(-value, 6), pendant_counts]
        rows.append([zero.joint, unit, *cells, "yes" if zero.determined else "no"])
    return ExportFiles(
        {"zeros.csv": csv_text(rows), "accuracy.csv": accuracy_csv(exported)},
        _undetermined(exported),
    )


def _undetermined(exported: Exported) -> tuple[str, ...]:
    names = [zero.joint for zero in exported.zeros if not zero.determined]
    if not names:
        return ()
    return (
        f"The zero of {', '.join(names)} is not determined: base and tool do the same. Keep the "
        "zero and enter base and tool.",
    )


def _rpy(R: Array) -> list[str]:
    return [written(math.degrees(v), 6) for v in roll_pitch_yaw(R)]


def _zyx(R: Array) -> list[str]:
    return _rpy(R)[::-1]


def _wxyz(R: Array) -> list[str]:
    return [f"{v:.9f}" for v in quaternion(R)]


class Orientation(NamedTuple):
    """How a vendor writes an orientation: the columns, and their texts for a rotation (3, 3)."""

    label: str
    columns: tuple[str, ...]
    texts: Callable[[Array], list[str]]


_TURNS = ("roll [deg]", "pitch [deg]", "yaw [deg]")
ORIENTATIONS = {
    "": Orientation("roll, pitch, yaw", _TURNS, _rpy),
    "kuka": Orientation("KUKA", ("A [deg]", "B [deg]", "C [deg]"), _zyx),
    "fanuc": Orientation("FANUC", ("W [deg]", "P [deg]", "R [deg]"), _rpy),
    "yaskawa": Orientation("Yaskawa", ("Rx [deg]", "Ry [deg]", "Rz [deg]"), _rpy),
    "abb": Orientation("ABB", ("q1", "q2", "q3", "q4"), _wxyz),
}
"""By vendor. A, B, C turn about the moving z, y, x axes; W, P, R (Rx, Ry, Rz) about the fixed x, y,
z axes, which is the same rotation read in the other order, as are roll, pitch and yaw; q1 ... q4
are the unit quaternion, the real part first."""


def frames(exported: Exported, options: ExportOptions) -> ExportFiles:
    """tcp.csv and base.csv: tools on the flange, and where base and instruments stand."""
    tools = [placed for placed in exported.frames if placed.seen_in == "flange"]
    rest = [placed for placed in exported.frames if placed.seen_in != "flange"]
    return ExportFiles(
        {
            "tcp.csv": csv_text(_placed(tools, options.vendor)),
            "base.csv": csv_text(_placed(rest, options.vendor)),
            "accuracy.csv": accuracy_csv(exported),
        }
    )


def _placed(frames: Sequence[Placed], vendor: str | None) -> list[list[str]]:
    _, columns, turned = ORIENTATIONS[vendor or ""]
    rows = [["for the model", "frame", "in the frame", "x [mm]", "y [mm]", "z [mm]", *columns]]
    for placed in frames:
        place = [written(1e3 * v, 6) for v in placed.T[:3, 3]]
        turns = turned(placed.T[:3, :3]) if placed.turned else [""] * len(columns)
        rows.append([placed.model, placed.name, placed.seen_in, *place, *turns])
    return rows


def dh(exported: Exported, options: ExportOptions) -> ExportFiles:
    """dh.csv, and dh_frames.csv with what stands ahead of its first and behind its last row."""
    assert exported.chain is not None
    return _denavit(dh_table(exported.chain), "dh")


def mdh(exported: Exported, options: ExportOptions) -> ExportFiles:
    """mdh.csv and mdh_frames.csv, after Craig."""
    assert exported.chain is not None
    return _denavit(modified(dh_table(exported.chain)), "mdh")


def frames_csv(frames: Iterable[tuple[str, Array]]) -> str:
    """Frames (4, 4) by name, in m and rad."""
    rows = [["frame", "x [m]", "y [m]", "z [m]", "roll [rad]", "pitch [rad]", "yaw [rad]"]]
    for name, T in frames:
        rows.append([name, *map(decimal, (*T[:3, 3].tolist(), *roll_pitch_yaw(T[:3, :3])))])
    return csv_text(rows)


# d grows as 1 / sin of the angle between neighbouring axes.
FAR = 10.0
"""d [m] from which a table is warned of."""


def _denavit(table: DenavitTable, form: str) -> ExportFiles:
    head = ["joint", "type", "form", "a [m]", "alpha [rad]", "d [m]", "theta [rad]", "direction"]
    rows = [head]
    for row in table.rows:
        numbers = map(decimal, (row.a, row.alpha, row.d, row.theta, row.factor))
        rows.append([row.joint, row.kind, form, *numbers])
    far = [row.joint for row in table.rows if abs(row.d) > FAR]
    words = (
        (
            f"The axes around {', '.join(far)} are nearly parallel, so d is large there. The table "
            "is exact, but one wrong digit has a large effect: use urdf, mjcf, sdf or ur where you "
            "can.",
        )
        if far
        else ()
    )
    return ExportFiles(
        {
            f"{form}.csv": csv_text(rows),
            f"{form}_frames.csv": frames_csv((("base", table.base), ("tool", table.tool))),
        },
        words,
    )


_FIXED_MODEL = "KUKA, Fanuc, Yaskawa, ABB or another controller with a fixed model"
_USER_MODEL = "your own controller or offline program"
_TABLE = "enter the table, and the frames ahead of it and behind it"
FORMATS = (
    Format(
        "zeros",
        "joint zeros for the pendant (CSV)",
        _FIXED_MODEL,
        "type in the zeros, or correct the targets",
        zeros,
        "zeros",
        nominal=True,
        options=("counts",),
    ),
    Format(
        "frames",
        "tool and base in a vendor's convention (CSV)",
        _FIXED_MODEL,
        "type in tool and base",
        frames,
        "zeros",
        nominal=True,
        options=("vendor",),
    ),
    Format("dh", "Denavit-Hartenberg table (CSV)", _USER_MODEL, _TABLE, dh),
    Format("mdh", "modified Denavit-Hartenberg table (CSV)", _USER_MODEL, _TABLE, mdh),
)


PARALLEL = 3e-10
"""Sine [rad] between axes that count as parallel: nearer ones meet 3,000 km away per mm."""


@dataclass(frozen=True)
class DenavitRow:
    """A joint: a, d [m], alpha and theta [rad] behind it, at the reading 0.

    factor: of the reading, which moves theta, or d of a slide.
    """

    joint: str
    reads: str
    kind: str
    a: float
    alpha: float
    d: float
    theta: float
    factor: float


@dataclass(frozen=True, eq=False)
class DenavitTable:
    """rows from the base to the tip; base, tool: (4, 4) ahead of the first and behind the last."""

    rows: tuple[DenavitRow, ...]
    base: Array
    tool: Array


def dh_table(chain: RestChain) -> DenavitTable:
    """The classical table of a chain; its last row has a = alpha = 0."""
    chain = chain.along_z
    base = chain.joints[0].before
    ahead = np.eye(4)  # from the table's frame of a joint to the chain's, turned about z, along z
    rows = []
    for joint, following in zip(chain.joints, chain.joints[1:], strict=False):
        row, ahead = _row(joint, ahead @ following.before)
        rows.append(row)
    last = chain.joints[-1]
    rows.append(DenavitRow(last.name, last.reads, last.kind, 0.0, 0.0, 0.0, 0.0, last.factor))
    return DenavitTable(tuple(rows), base, ahead @ chain.tip)


def _row(joint: RestJoint, T: Array) -> tuple[DenavitRow, Array]:
    """The row of a joint whose next one stands at T, and what is left of T behind the row."""
    u, p = T[:3, 2], T[:3, 3]
    across = math.hypot(u[0], u[1])
    if across < PARALLEL:
        a = math.hypot(p[0], p[1])
        theta, a = _forward(math.atan2(p[1], p[0]) if a > 0.0 else 0.0, a)
        d = float(p[2])
        alpha = 0.0 if u[2] > 0.0 else math.pi
    else:
        # x along the common normal of both axes, turned forward: theta within a quarter turn
        theta, _ = _forward(math.atan2(u[0], -u[1]), 0.0)
        normal = np.array([math.cos(theta), math.sin(theta)])
        a = float(normal @ p[:2])
        # Rx(alpha) turns z by alpha, away from the direction z x normal.
        alpha = math.atan2(normal[1] * u[0] - normal[0] * u[1], u[2])
        # the next axis, p + s u, comes nearest to z where p + s u - a normal is along z
        s = -float(p[:2] @ u[:2]) / across**2
        d = float(p[2] + s * u[2])
    row_transform = _dh(theta, d, a, alpha)
    row = DenavitRow(joint.name, joint.reads, joint.kind, a, alpha, d, theta, joint.factor)
    # What the four numbers cannot express lies about and along the next z; the next row takes it.
    left: Array = np.linalg.inv(row_transform) @ T
    return row, left


def _forward(theta: float, a: float) -> tuple[float, float]:
    """The same normal with theta within a quarter turn, which is where drawings put it."""
    if abs(theta) <= 0.5 * math.pi:
        return theta, a
    return theta - math.copysign(math.pi, theta), -a


def _dh(theta: float, d: float, a: float, alpha: float) -> Array:
    """Rz(theta) Tz(d) Tx(a) Rx(alpha)."""
    c, s, ca, sa = math.cos(theta), math.sin(theta), math.cos(alpha), math.sin(alpha)
    return np.array(
        [
            [c, -s * ca, s * sa, a * c],
            [s, c * ca, -c * sa, a * s],
            [0.0, sa, ca, d],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def modified(table: DenavitTable) -> DenavitTable:
    """The modified table of a classical one: a and alpha stand ahead of their joint."""
    ahead = [(0.0, 0.0), *((row.a, row.alpha) for row in table.rows)]
    rows = tuple(
        DenavitRow(r.joint, r.reads, r.kind, a, alpha, r.d, r.theta, r.factor)
        for r, (a, alpha) in zip(table.rows, ahead, strict=False)
    )
    a, alpha = ahead[-1]
    return DenavitTable(rows, table.base, _dh(0.0, 0.0, a, alpha) @ table.tool)
