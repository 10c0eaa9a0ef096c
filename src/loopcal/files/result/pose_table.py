"""residuals.csv: what became of every reading, pose by pose; written, and read back."""

from __future__ import annotations

import re
import secrets
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from loopcal.arrays import Array
from loopcal.document.result_document import MechanismEntry
from loopcal.errors import InputError
from loopcal.estimation.result import FitResult
from loopcal.files.atomic import write_files
from loopcal.files.result.pair import refuse_stale
from loopcal.files.tables.readers import read_dataset
from loopcal.files.tables.writer import Column, table_bytes

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


def pose_table(result: FitResult) -> PoseTable:
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


def pose_columns(result: FitResult) -> dict[str, Column]:
    """Header -> values of residuals.csv: one row per pose used, empty where there is no value."""
    table = pose_table(result)
    columns: dict[str, Column] = {"pose": table.poses}
    for header in _headers(MechanismEntry.of(result.mechanism)):
        columns[header.words] = getattr(table, header.part)[header.name]
    return columns


def residuals_csv(result: FitResult) -> bytes:
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


# What became of every pose of a stream: a folder of Parquet files, written as the poses come.

NAME = "residuals"
_PART = re.compile(r"part-\d{5,}\.parquet")


def residual_part(chunk: FitResult) -> bytes:
    """The part of one chunk, made where the chunk is worked on and written by `ResidualParts`."""
    return table_bytes(pose_columns(chunk), ".parquet")


def _name(number: int) -> str:
    return f"part-{number:05d}.parquet"


class ResidualParts:
    """residuals/part-00001.parquet and so on, with the columns of residuals.csv.

    They come into a folder of another name, which takes its own when all is done; whatever was
    there before goes then, and not earlier. Each run has a folder of its own; one that a killed run
    left is removed by the next, and should its run live, that run says so and ends.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        self._open = self.folder / f".{NAME}.{secrets.token_hex(6)}.part"
        self._count = 0

    def begin(self) -> None:
        """Remove what killed runs have left here.

        Raises InputError where a file stands in the way of the residuals.
        """
        target = self.folder / NAME
        others = target.is_dir() and any(not _PART.fullmatch(p.name) for p in target.iterdir())
        if others or target.is_file():
            raise InputError(
                "a file, or a folder with other files, has the name of the residuals folder",
                code="unwritable-file",
                place=str(self.folder / NAME),
                remedy="move it, or choose another result folder",
            )
        for end in ("part", "old"):
            for left in self.folder.glob(f".{NAME}.*.{end}"):
                if left.is_dir():
                    shutil.rmtree(left, ignore_errors=True)

    def add(self, part: bytes) -> None:
        """Write the part of the next chunk.

        Raises InputError where it cannot be written, or another run has removed those before.
        """
        self.check()
        self._count += 1
        write_files(self._open, {_name(self._count): part})

    def finish(self) -> None:
        """Give the folder its name. Raises InputError where another run has removed parts."""
        self.check()
        target = self.folder / NAME
        old = self.folder / f".{NAME}.{secrets.token_hex(6)}.old"
        if target.exists():
            # A folder cannot be renamed onto one that holds files.
            target.rename(old)
        self._open.rename(target)
        shutil.rmtree(old, ignore_errors=True)

    def check(self) -> None:
        """Raise InputError where another run has removed parts."""
        if self._count and not (self._open / _name(1)).exists():
            raise InputError(
                "another calibration writing to this folder removed these residuals",
                code="unwritable-file",
                place=str(self.folder),
                remedy="run one at a time, or use separate folders",
            )

    def undo(self) -> None:
        """Remove what has been written."""
        shutil.rmtree(self._open, ignore_errors=True)
