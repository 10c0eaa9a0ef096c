"""Hostile files of every kind, made at test time from small honest ones; seeded.

Each function writes one file. `REFUSED` has single faults by name, `HARMLESS` what only looks like
one. `damaged` makes any number of files with bytes changed, cut or repeated.
"""

from __future__ import annotations

import io
import re
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import numpy as np

ROWS = 40
EMPTY = '<c r="XFD1048576"/>'


def columns(seed: int = 0) -> dict[str, np.ndarray]:
    """Readings of x, y and a, (40,) each."""
    values = np.random.default_rng(seed).normal(size=(3, ROWS))
    return dict(zip(("x", "y", "a"), values, strict=True))


def csv() -> bytes:
    """An honest CSV of those readings."""
    table = columns()
    rows = zip(*(v.tolist() for v in table.values()), strict=True)
    return "\n".join([",".join(table), *(",".join(map(repr, row)) for row in rows), ""]).encode()


def xlsx() -> bytes:
    """An honest workbook of those readings."""
    import xlsxwriter

    content = io.BytesIO()
    with xlsxwriter.Workbook(content) as book:
        sheet = book.add_worksheet("readings")
        for number, (name, values) in enumerate(columns().items()):
            sheet.write_column(0, number, [name, *values.tolist()])
    return content.getvalue()


def parquet() -> bytes:
    """An honest Parquet file of those readings."""
    import polars as pl

    content = io.BytesIO()
    pl.DataFrame(columns()).write_parquet(content)
    return content.getvalue()


def matlab(*, compressed: bool = True) -> bytes:
    """An honest MATLAB file of those readings."""
    from scipy.io import savemat

    content = io.BytesIO()
    savemat(content, columns(), do_compression=compressed)
    return content.getvalue()


HONEST: dict[str, Callable[[], bytes]] = {
    ".csv": csv,
    ".xlsx": xlsx,
    ".parquet": parquet,
    ".mat": matlab,
}


def sheet_edited(pattern: str, new: str) -> bytes:
    """The workbook with the first match in its sheet's XML replaced."""
    old, content = zipfile.ZipFile(io.BytesIO(xlsx())), io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        for member in old.infolist():
            data = old.read(member)
            if member.filename.startswith("xl/worksheets/"):
                text, count = re.subn(pattern, new, data.decode(), count=1)
                assert count, pattern
                data = text.encode()
            archive.writestr(member.filename, data)
    return content.getvalue()


@cache
def workbook_bomb(size: int) -> bytes:
    """A workbook whose sheet unfolds to so many bytes of blanks."""
    old, content = zipfile.ZipFile(io.BytesIO(xlsx())), io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        for member in old.infolist():
            with archive.open(member.filename, "w", force_zip64=True) as stream:
                if member.filename.startswith("xl/worksheets/"):
                    for _ in range(size >> 20):
                        stream.write(b" " * (1 << 20))
                stream.write(old.read(member))
    return content.getvalue()


@cache
def matlab_bomb(size: int) -> bytes:
    """A MATLAB file whose only variable unfolds to so many bytes of zeros."""
    squeeze = zlib.compressobj()
    block = bytes(1 << 20)
    body = squeeze.compress(_matrix_head(size))
    body += b"".join(squeeze.compress(block) for _ in range(size >> 20)) + squeeze.flush()
    return _matlab_head() + struct.pack("<II", 15, len(body)) + body


def matlab_with_bad_tag() -> bytes:
    """A matrix whose numbers are of a type that does not exist."""
    body = bytearray(_matrix_head(64) + bytes(64))
    body[56:64] = struct.pack("<II", 0x7FFF_FFFF, 64)
    return _matlab_head() + struct.pack("<II", 14, len(body) - 8) + bytes(body[8:])


def _matlab_head() -> bytes:
    return b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H", 0x0100) + b"IM"


def _matrix_head(size: int) -> bytes:
    """Tag, flags, dimensions and name of a matrix of doubles with so many bytes."""
    flags = struct.pack("<IIII", 6, 8, 6, 0)
    dimensions = struct.pack("<IIii", 5, 8, size // 8, 1)
    name = struct.pack("<II", 1, 1) + b"x".ljust(8, b"\0")
    inner = flags + dimensions + name + struct.pack("<II", 9, size)
    return struct.pack("<II", 14, len(inner) + size) + inner


REFUSED: dict[str, tuple[str, Callable[[], bytes]]] = {
    # fault: (ending, content)
    "a cell far beyond its sheet": (".xlsx", lambda: sheet_edited('r="B3"', 'r="XFD1048576"')),
    "a cell beyond any sheet": (".xlsx", lambda: sheet_edited('r="B3"', 'r="ZZZ999999999"')),
    "a malformed cell reference": (".xlsx", lambda: sheet_edited('r="B3"', 'r="\u00b53-B"')),
    "a cell without a row": (".xlsx", lambda: sheet_edited('r="B3"', 'r="B"')),
    "a zip bomb": (".xlsx", lambda: workbook_bomb(400 << 20)),
    "a zlib bomb": (".mat", lambda: matlab_bomb(400 << 20)),
    "a bad tag": (".mat", matlab_with_bad_tag),
    "a matrix longer than its file": (
        ".mat",
        lambda: _matlab_head() + struct.pack("<II", 14, 0xFFFF_FFF0) + _matrix_head(1 << 31),
    ),
    "blank lines alone": (".csv", lambda: b"\n" * 30_000_000),
    "comments alone": (".csv", lambda: b"#\n" * 1_000_000),
    "blanks alone": (".csv", lambda: b" ,;\t\n" * 5_000_000),
}
HARMLESS: dict[str, tuple[str, Callable[[], bytes]]] = {
    "a dimension far beyond its sheet": (
        ".xlsx",
        lambda: sheet_edited('<dimension ref="[^"]*"', '<dimension ref="A1:XFD1048576"'),
    ),
    "blank lines between rows": (".csv", lambda: csv().replace(b"\n", b"\n" + b" ,\n" * 50_000)),
    "an empty cell far beyond its sheet": (
        ".xlsx",
        lambda: sheet_edited("</sheetData>", f'<row r="1048576">{EMPTY}</row></sheetData>'),
    ),
}


def damaged(content: bytes, number: int, seed: int) -> Iterator[bytes]:
    """So many variants of a file, with some of its bytes flipped, cut out, repeated or zeroed."""
    random = np.random.default_rng(seed)
    for _ in range(number):
        data = bytearray(content)
        begin = int(random.integers(len(data)))
        end = min(len(data), begin + int(random.integers(1, 1 + len(data) // 8)))
        match int(random.integers(5)):
            case 0:
                data[begin] ^= 1 << int(random.integers(8))
            case 1:
                data[begin:end] = random.bytes(end - begin)
            case 2:
                del data[begin:end]
            case 3:
                data[begin:begin] = data[begin:end]
            case 4:
                data[begin:end] = bytes(end - begin)
        yield bytes(data)


def written(folder: Path, ending: str, content: bytes) -> Path:
    """The path of a file with that content."""
    path = folder / f"readings{ending}"
    path.write_bytes(content)
    return path
