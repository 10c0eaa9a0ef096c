"""Tables of a calibrated arm as CSV: zeros, tool and base, and Denavit-Hartenberg parameters."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from loopcal.document.exported import Exported, Placed
from loopcal.errors import InputError, nearest
from loopcal.files.exports.format import ExportFiles, ExportOptions, Format
from loopcal.files.exports.urdf import decimal
from loopcal.files.programs.program import written
from loopcal.measurements.poses import cell_text
from loopcal.mechanisms.denavit import DenavitTable, dh_table, modified
from loopcal.mechanisms.rest import quaternion, roll_pitch_yaw

Array = NDArray[np.float64]


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
            raise InputError(
                f"counts are stated for {name!r}, which is not a joint",
                code="unknown-name",
                remedy=nearest(name, joints),
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
