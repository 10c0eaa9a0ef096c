"""residuals.csv: what became of every reading, pose by pose; written, and read back."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from loopcal.document.result_document import MechanismEntry
from loopcal.estimation.result import Result
from loopcal.files.result.pair import refuse_stale
from loopcal.files.tables.readers import read_dataset
from loopcal.files.tables.writer import Column, table_bytes

Array = NDArray[np.float64]
Named = Mapping[str, Array]


@dataclass(frozen=True, eq=False)
class PoseTable:
    """What became of every pose used, (N,) each, SI, NaN where there is none.

    residuals_before, residuals_after: of every loop, at the readings and nominal parameters, and at
    the corrected readings and calibrated parameters; differences_before, differences_after: of
    what is compared, computed from the uncorrected readings of the rest minus measured, with
    nominal and with calibrated parameters; readings: of quantities; corrections: estimated true
    value minus reading; normalised: corrections over sds, NaN also where exact; pose_constants:
    exact readings.
    """

    poses: tuple[str, ...]
    residuals_before: Named = field(default_factory=dict)
    residuals_after: Named = field(default_factory=dict)
    differences_before: Named = field(default_factory=dict)
    differences_after: Named = field(default_factory=dict)
    readings: Named = field(default_factory=dict)
    corrections: Named = field(default_factory=dict)
    normalised: Named = field(default_factory=dict)
    pose_constants: Named = field(default_factory=dict)


@dataclass(frozen=True)
class _Header:
    """A column: the field of `PoseTable` that it belongs to, the name in it, and its words."""

    part: str
    name: str
    words: str


def _headers(mechanism: MechanismEntry) -> Iterator[_Header]:
    """The columns of residuals.csv in their order."""
    units = mechanism.quantities
    for loop in mechanism.loops:
        unit = units.get(loop, "SI")
        yield _Header("residuals_before", loop, f"residual {loop} before [{unit}]")
        yield _Header("residuals_after", loop, f"residual {loop} after [{unit}]")
    for name in mechanism.compared:
        difference = f"{name} computed - measured"
        yield _Header("differences_before", name, f"{difference} before [{units[name]}]")
        yield _Header("differences_after", name, f"{difference} after [{units[name]}]")
    for name, unit in units.items():
        yield _Header("readings", name, f"{name} [{unit}]")
        yield _Header("corrections", name, f"{name} correction [{unit}]")
        yield _Header("normalised", name, f"{name} correction/sd")
    for name, unit in mechanism.known.items():
        yield _Header("pose_constants", name, f"{name} [{unit}]")


def pose_table(result: Result) -> PoseTable:
    """The poses that a result holds."""
    data, mechanism = result.dataset, result.mechanism
    nothing = np.full(len(data), np.nan)
    corrections, normalised = {}, {}
    for name, correction in result.corrections.items():
        sd = result.reading_sds[name]
        measured = (sd > 0.0) & np.isfinite(sd)
        corrections[name] = np.where(np.isfinite(sd), correction, np.nan)
        # Divisors of 0 and inf are replaced: the division would warn.
        over = correction / np.where(measured, sd, 1.0)
        normalised[name] = np.where(measured, over, np.nan)
    return PoseTable(
        data.poses,
        result.residuals_before,
        result.residuals_after,
        result.differences_before,
        result.differences_after,
        {name: data.readings.get(name, nothing) for name in mechanism.quantities},
        corrections,
        normalised,
        {name: data.readings.get(name, nothing) for name in mechanism.pose_constants},
    )


def pose_columns(result: Result) -> dict[str, Column]:
    """Header -> values of residuals.csv: one row per pose used, empty where there is no value."""
    table = pose_table(result)
    columns: dict[str, Column] = {"pose": table.poses}
    for header in _headers(MechanismEntry.of(result.mechanism)):
        columns[header.words] = getattr(table, header.part)[header.name]
    return columns


def residuals_csv(result: Result) -> bytes:
    """The bytes of residuals.csv."""
    return table_bytes(pose_columns(result))


def read_pose_table(path: str | Path, mechanism: MechanismEntry | None) -> PoseTable:
    """What residuals.csv says of the quantities, loops and outputs of a mechanism.

    Without a mechanism only the ids are known. Raises InputError where it is absent, cannot be
    read, or is of another result than the one beside it.
    """
    refuse_stale(path)
    read = read_dataset(path, pose="pose")
    parts: dict[str, dict[str, Array]] = {}
    for header in _headers(mechanism) if mechanism else ():
        if header.words in read.readings:
            parts.setdefault(header.part, {})[header.name] = read.readings[header.words]
    return PoseTable(read.poses, **parts)
