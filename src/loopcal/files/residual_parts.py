"""What became of every pose of a stream: a folder of Parquet files, written as the poses come."""

from __future__ import annotations

import secrets
import shutil
from pathlib import Path

from loopcal.estimation.result import Result
from loopcal.files.atomic import write_files
from loopcal.files.residuals_file import residual_columns
from loopcal.files.table_writer import table_bytes

NAME = "residuals"


def residual_part(chunk: Result) -> bytes:
    """The part of one chunk, made where the chunk is worked on and written by `ResidualParts`."""
    return table_bytes(residual_columns(chunk), ".parquet")


class ResidualParts:
    """residuals/part-00001.parquet and so on, with the columns of residuals.csv.

    They come into a folder of another name, which takes its own when all is done; whatever was
    there before goes then, and not earlier.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        self._open = self.folder / f".{NAME}.{secrets.token_hex(6)}.part"
        self._count = 0

    def add(self, part: bytes) -> None:
        """Write the part of the next chunk. Raises InputError where it cannot be written."""
        self._count += 1
        write_files(self._open, {f"part-{self._count:05d}.parquet": part})

    def finish(self) -> None:
        """Give the folder its name."""
        target = self.folder / NAME
        old = self.folder / f".{NAME}.{secrets.token_hex(6)}.old"
        if target.exists():
            target.rename(old)
        self._open.rename(target)
        shutil.rmtree(old, ignore_errors=True)

    def undo(self) -> None:
        """Remove what has been written."""
        shutil.rmtree(self._open, ignore_errors=True)
