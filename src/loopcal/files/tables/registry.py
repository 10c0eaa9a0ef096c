"""All readers of tables, and which of them a file is for."""

from __future__ import annotations

from pathlib import Path
from typing import Any, BinaryIO

from loopcal.errors import InputError
from loopcal.files.tables import arrays, bag, delimited, matlab, parquet, spreadsheet
from loopcal.files.tables.reader import Layout, Reader

TEXT = delimited.READER
READERS = (TEXT, spreadsheet.READER, parquet.READER, matlab.READER, arrays.READER, bag.READER)
BY_ENDING = {ending: reader for reader in READERS for ending in reader.endings}


def reader_of(path: Any) -> Reader:
    """The reader of a file or folder by its name; of others, and of streams, that of text.

    Raises InputError for a relative of a kind of file that is not read, and for what is neither.
    """
    if not isinstance(path, str | Path):
        if not hasattr(path, "read"):
            raise InputError(
                f"{type(path).__name__} is neither the path of a file nor an open stream",
                code="wrong-file-type",
                remedy="name a file; write a DataFrame with to_csv first",
            )
        return TEXT
    path = Path(path)
    if path.is_dir():
        inside = (one for one in READERS if one.in_folder and any(path.glob(one.in_folder)))
        return next(inside, parquet.READER)
    ending = path.suffix.lower()
    for reader in READERS:
        if ending in reader.relatives:
            raise InputError(
                f"of files of this kind only {reader.kind} is read",
                code="wrong-file-type",
                place=str(path),
                remedy=f"save it as {reader.kind} or CSV",
            )
    return BY_ENDING.get(ending, TEXT)


def refuse_other_options(reader: Reader, path: str | Path | BinaryIO, layout: Layout) -> None:
    """Raise InputError for options of other kinds of files."""
    for option in layout.keywords:
        if option not in reader.options:
            raise InputError(
                f"{option} does not apply to {reader.kind} files",
                code="conflicting-keys",
                place=str(path),
                remedy=f"remove {option}, or rename the file to its usual extension",
            )
