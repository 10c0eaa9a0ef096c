"""How much a compressed file unfolds to, found out before a reader makes room for it.

Both looks pass over the file in blocks of 1 MB, so that a bomb costs no memory.
"""

from __future__ import annotations

import re
import struct
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from loopcal.errors import InputError

BASE, PER_BYTE = 1 << 28, 100
"""Bytes that any file may unfold to, and those for each of its own: readings shrink tenfold."""
MOST_CELLS = 1 << 25
"""Cells of a sheet: a million rows of 32 columns."""
_BLOCK = 1 << 20
# Up to column ZZ and row 9999 a sheet has 7 million cells, fewer than MOST_CELLS.
_FAR = re.compile(rb"""\br=["']([A-Za-z]{3}\d{1,9}|[A-Za-z]{1,2}\d{5,9})["']([^>]{0,200}>)""")
# Of the MATLAB 5 format: bytes of the header, and the type miCOMPRESSED.
_HEADER, _COMPRESSED = 128, 15


def refuse_large_workbook(path: Path) -> None:
    """Raise InputError for a ZIP archive that unfolds too far, and for a sheet of too many cells.

    What is no archive at all is left to the reader.
    """
    most = _most(path)
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            if sum(member.file_size for member in members) > most:
                raise _bomb(path, most)
            for member in members:
                if member.filename.lower().startswith("xl/worksheets/"):
                    with archive.open(member) as stream:
                        _refuse_far_cells(_blocks(stream), path)
    except (zipfile.BadZipFile, zlib.error, OSError, RuntimeError, EOFError):
        return


def _refuse_far_cells(blocks: Iterator[bytes], path: Path) -> None:
    rows, columns, tail = 1, 1, b""
    for block in blocks:
        text = tail + block
        for name, rest in _FAR.findall(text):
            if rest.endswith(b"/>"):  # formatted, but empty
                continue
            letters = name.rstrip(b"0123456789")
            rows = max(rows, int(name[len(letters) :]))
            columns = max(columns, _number(letters))
            if rows * columns > MOST_CELLS:
                raise InputError(
                    f"cell {name.decode()} makes a sheet of {rows} rows and {columns} columns, "
                    "too large to read",
                    code="too-large",
                    place=path.name,
                    remedy="delete cells far from the table, or save the table as Parquet",
                )
        # A cell may lie across two blocks; the pattern spans less than 300 bytes.
        tail = text[-300:]


def _number(letters: bytes) -> int:
    """The number of a column: A is 1, Z is 26, AA is 27."""
    number = 0
    for letter in letters.upper():
        number = 26 * number + letter - 64
    return number


def refuse_large_matlab(path: Path) -> None:
    """Raise InputError for variables that unfold too far, or are longer than the file.

    Files of format 4 are not compressed and are left to the reader.
    """
    size, most, unfolded = path.stat().st_size, _most(path), 0
    with path.open("rb") as file:
        head = file.read(_HEADER)
        order = {b"IM": "<II", b"MI": ">II"}.get(head[126:])
        while order is not None and len(tag := file.read(8)) == 8:
            kind, length = struct.unpack(order, tag)
            end = file.tell() + length
            if end > size:
                raise InputError(
                    f"this MATLAB file cannot be read: a variable of {length} bytes extends "
                    "beyond its end",
                    code="wrong-file-type",
                    place=path.name,
                    remedy="copy the file again; it was cut off or damaged",
                )
            if kind == _COMPRESSED:
                for block in _inflated(file, length):
                    unfolded += len(block)
                    if unfolded > most:
                        raise _bomb(path, most)
            file.seek(end)


def _inflated(file: BinaryIO, length: int) -> Iterator[bytes]:
    """Blocks of what so many compressed bytes hold; none from where they are damaged."""
    inflate = zlib.decompressobj()
    try:
        while length > 0 and not inflate.eof:
            rest = inflate.unconsumed_tail or file.read(min(length, _BLOCK))
            length -= 0 if inflate.unconsumed_tail else len(rest)
            yield inflate.decompress(rest, _BLOCK)
        while inflate.unconsumed_tail and not inflate.eof:
            yield inflate.decompress(inflate.unconsumed_tail, _BLOCK)
    except zlib.error:
        return


def _blocks(stream: object) -> Iterator[bytes]:
    yield from iter(lambda: stream.read(_BLOCK), b"")  # type: ignore[attr-defined]


def _most(path: Path) -> int:
    return BASE + PER_BYTE * path.stat().st_size


def _bomb(path: Path, most: int) -> InputError:
    return InputError(
        f"the file unfolds to more than {most / 1e9:.1f} GB, {PER_BYTE} times its size",
        code="too-large",
        place=path.name,
        remedy="save the table as CSV or Parquet, if it is one",
    )
