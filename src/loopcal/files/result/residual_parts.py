"""What became of every pose of a stream: a folder of Parquet files, written as the poses come."""

from __future__ import annotations

import re
import secrets
import shutil
from pathlib import Path

from loopcal.errors import InputError
from loopcal.estimation.result import Result
from loopcal.files.atomic import write_files
from loopcal.files.result.pose_table import pose_columns
from loopcal.files.tables.writer import table_bytes

NAME = "residuals"
_PART = re.compile(r"part-\d{5,}\.parquet")


def residual_part(chunk: Result) -> bytes:
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
