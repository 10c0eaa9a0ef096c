"""Pose performance from tables of measured poses, and the page of it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from loopcal.errors import UsageError
from loopcal.files.atomic import write_atomic
from loopcal.files.project.new_project import write_new_files
from loopcal.files.tables.attained import TEMPLATE, read_attained, template
from loopcal.measurements.attained import AttainedPoses
from loopcal.pose_performance.instrument import Figures, MeasuringErrors, tracker_of
from loopcal.pose_performance.performance import pose_performance

if TYPE_CHECKING:
    from loopcal.pose_performance.summary import Performance


def performance(
    data: str | Path | AttainedPoses,
    *,
    commanded: str | Path | None = None,
    units: str | None = None,
    angles: str | None = None,
    instrument_sd: str | None = None,
    frame_sd: str | None = None,
    tracker: str | None = None,
    distances: Sequence[tuple[str, str]] = (),
) -> Performance:
    """Pose accuracy, repeatability, variation, distances and drift, computed after ISO 9283.

    data: a table with a row per measurement, as `loopcal new NAME --performance` writes an example
    of; commanded: a table of the commanded poses, if they are not in it; units: "mm,deg" where the
    headers state none; angles: what columns a, b, c or rx, ry, rz mean ("rpy", "zyx", "rotvec").
    instrument_sd: sd of one reading, "5 um" or "5 um, 20 urad"; frame_sd: of the base frame;
    tracker: its name or "RANGE, TRANSVERSE" from the data sheet, measuring from the origin of the
    readings; distances: pairs of poses.

    AP = ``|mean - commanded|``, RP = mean distance from the mean + 3 sd; see
    `loopcal.pose_performance.performance` for all formulas and their sources. Raises InputError
    with file, row and column.
    """
    attained = data if isinstance(data, AttainedPoses) else read_attained(
        data, commanded=commanded, units=units, angles=angles
    )  # fmt: skip
    errors = MeasuringErrors(Figures.of(instrument_sd), tracker_of(tracker), Figures.of(frame_sd))
    return pose_performance(attained, errors, distances=distances)


def run_performance(
    attained: AttainedPoses,
    errors: MeasuringErrors,
    *,
    distances: Sequence[str] = (),
    out: str | Path | None = None,
) -> Performance:
    """The figures, and their page where a file is named for it; distances: "P2,P4"."""
    figures = pose_performance(attained, errors, distances=[_pair(text) for text in distances])
    if out is not None:
        from loopcal.report.performance_page import performance_html

        write_atomic(out, performance_html(figures, attained))
    return figures


def new_performance(name: str | Path) -> tuple[Path, ...]:
    """Write an example table of commanded poses, to be filled in; nothing is overwritten."""
    return write_new_files(Path(name), {TEMPLATE: template()})


def _pair(text: str) -> tuple[str, str]:
    parts = [part.strip() for part in text.split(",")]
    if len(parts) != 2:
        raise UsageError(f"{text!r} is not a pair of poses", remedy="write --distance P2,P4")
    return parts[0], parts[1]
