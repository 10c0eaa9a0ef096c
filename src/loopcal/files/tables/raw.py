"""Bytes of an input file: opened, hashed, and bounded before anything is made of them.

A text file is read in blocks of 1 MiB. A line that does not end within one block, or a NUL
byte, stops the reading at once, so that a wrong file costs neither minutes nor memory. Devices,
pipes that no program writes into and texts of more than 1 GB are refused.
"""

from __future__ import annotations

import codecs
import hashlib
import os
import re
import select
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from loopcal.errors import InputError, closest
from loopcal.files.outputs import note_input, refuse_outside
from loopcal.measurements.source import file_name

BLOCK = 1 << 20
MOST_TEXT = 1_000_000_000
"""Bytes; ten million poses of ten readings."""
PATIENCE = 10.0
"""Seconds that a pipe may stay without a byte before another program writes into it."""
_KINDS = {
    b"PK\x03\x04": "a ZIP archive (an XLSX workbook is one)",
    b"PAR1\x15": "a Parquet file",
    b"\x1f\x8b": "a gzip archive",
    b"\x89HDF": "an HDF5 file",
    b"\xd0\xcf\x11\xe0": "an old Excel workbook (.xls)",
    b"MATLAB 5.0 MAT": "a MATLAB file (.mat)",
    b"MATLAB 7.3 MAT": "a MATLAB 7.3 file (.mat)",
    b"%PDF": "a PDF document",
    b"\x89PNG": "a PNG picture",
}
_BOMS = {
    codecs.BOM_UTF8: "utf-8-sig",
    codecs.BOM_UTF16_LE: "utf-16",
    codecs.BOM_UTF16_BE: "utf-16",
    b"\x84\x31\x95\x33": "gb18030",
}
_COMMON = range(0xA1, 0xD8)
"""First bytes of punctuation and of the common characters in GB 2312 and what extends it; two
accented letters of western text side by side mostly lie beyond."""
_KANA_AND_KANJI = range(0x81, 0x99)
"""First bytes of signs, kana and the 2,965 common kanji (level 1 of JIS X 0208) in Shift-JIS."""
_CONTROL = re.compile(rb"[\x00-\x08\x0e-\x1f\x7f]")


@dataclass(frozen=True)
class Text:
    """Text of a file as UTF-8 bytes without byte order mark, lines ended by a line feed."""

    file: str
    """Name of the file, "-" for standard input."""
    data: bytes
    sha256: str
    """Of the bytes as they lie on the disk."""

    @property
    def name(self) -> str:
        """How messages call the file."""
        return file_name(self.file)


def existing_file(
    path: str | Path, *, empty_too: bool = False, anywhere: bool = False, pipe: bool = False
) -> Path:
    """The path of a file that is there and, unless `empty_too`, not empty.

    pipe: whether it may be a pipe, which can be read only once and from its beginning. Raises
    InputError for a missing file (naming the nearest beside it), a folder, a device, no permission
    and, unless `anywhere`, outside the folder in `INSIDE`.
    """
    path = Path(path)
    note_input(path)
    try:
        if not anywhere:
            refuse_outside(path, path.name, str(path))
        if path.is_dir():
            raise InputError(
                "this is a folder",
                code="wrong-file-type",
                place=str(path),
                remedy="name a file inside it",
            )
        size = path.stat().st_size
        if not (path.is_file() or (pipe and path.is_fifo())):
            kind = "pipe" if path.is_fifo() else "device"
            raise InputError(
                f"this is a {kind}, not a file",
                code="wrong-file-type",
                place=str(path),
                remedy="name a file, or - for standard input where the command takes it",
            )
        if path.is_file():  # a pipe can be opened only once
            path.open("rb").close()
            if not (size or empty_too):
                raise empty(str(path))
    except (OSError, ValueError) as error:
        raise unreadable(path, error) from None
    return path


def bytes_of(path: str | Path, most: int, *, empty_too: bool = False) -> bytes:
    """The bytes of a file or pipe, the first `most` and one more; InputError as `opened`."""
    with opened(path, empty_too=empty_too) as stream:
        try:
            return stream.read(most + 1)
        except OSError as error:
            raise unreadable(Path(path), error) from None


def opened(path: str | Path, *, empty_too: bool = False) -> BinaryIO:
    """An existing file, or a pipe that a program writes into, open for reading.

    Raises InputError as `existing_file` does, and for a pipe that stays silent.
    """
    path = existing_file(path, empty_too=empty_too, pipe=True)
    try:
        if not path.is_fifo():
            return path.open("rb")
        # Opening a pipe would wait for its writer without end; select below waits for PATIENCE.
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    except OSError as error:
        raise unreadable(path, error) from None
    if not select.select([handle], [], [], PATIENCE)[0]:
        os.close(handle)
        raise InputError(
            f"nothing was written to this pipe for {PATIENCE:g} s",
            code="unreadable-file",
            place=str(path),
            remedy="start the writing program first, or name a file",
        )
    os.set_blocking(handle, True)
    return open(handle, "rb")


def unreadable(path: Path, error: OSError | ValueError) -> InputError:
    """The reason why a file cannot be opened, in the user's words."""
    if isinstance(error, FileNotFoundError):
        try:
            beside = [entry.name for entry in path.parent.iterdir()] if path.parent.is_dir() else []
        except OSError:
            beside = []
        close = closest(path.name, beside)
        remedy = f"did you mean {close!r}?" if close else "give the path of an existing file"
        missing = InputError(
            "there is no such file", code="missing-file", place=str(path), remedy=remedy
        )
        if not close or Path(close).suffix != path.suffix:  # of another kind: no command with it
            return missing
        return missing.meaning(str(path), str(path.with_name(close)))
    if isinstance(error, PermissionError):
        return InputError(
            "no permission to read this file",
            code="unreadable-file",
            place=str(path),
            remedy="change its permissions",
        )
    return InputError(
        f"the file cannot be read ({getattr(error, 'strerror', None) or error})",
        code="unreadable-file",
        place=str(path),
        remedy="name a readable file",
    )


def empty(name: str) -> InputError:
    """The error for a file without any data."""
    return InputError(
        "the file is empty", code="no-data", place=name, remedy="name a file with one row per pose"
    )


def sha256_of(path: Path) -> str:
    """SHA-256 of the bytes of a file, as hexadecimal text."""
    note_input(path)
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def read_text(source: str | Path | BinaryIO, encoding: str | None = None) -> Text:
    """The text of a file, of standard input ("-") or of an open binary stream.

    Without an `encoding` a byte order mark decides, then UTF-16 without one, UTF-8, GB 18030 where
    its characters are common Chinese ones, cp1252.
    Raises InputError for whatever is not text, is larger than 1 GB, or has a line longer than
    1 MB.
    """
    if isinstance(source, str | Path) and str(source) != "-":
        path = Path(source)
        with opened(path) as stream:
            if path.stat().st_size > MOST_TEXT:
                raise _too_large(path.name)
            try:
                return _read(stream, path.name, encoding)
            except OSError as error:
                raise unreadable(path, error) from None
    return _read(sys.stdin.buffer if isinstance(source, str | Path) else source, "-", encoding)


def _read(stream: BinaryIO, file: str, stated: str | None) -> Text:
    name = file_name(file)
    digest = hashlib.sha256()
    blocks: list[bytes] = []
    encoding, unended, row = stated, 0, 1
    while block := stream.read(BLOCK):
        if not blocks:
            _refuse_other_kinds(block, name)
            encoding = stated or _recognised(block)
        if not (encoding or "").lower().startswith(("utf-16", "utf_16", "utf16")):
            _refuse_binary(block, name, row, first=not blocks)
        first = min(end for end in (block.find(b"\n"), block.find(b"\r"), len(block)) if end >= 0)
        if unended + first > BLOCK:
            raise InputError(
                "this line is longer than 1 MB",
                code="invalid-syntax",
                place=f"{name}, row {row}",
                remedy="check that this is a table with one row per pose",
            )
        last = max(block.rfind(b"\n"), block.rfind(b"\r"))
        unended = unended + len(block) if last < 0 else len(block) - 1 - last
        row += block.count(b"\n")
        digest.update(block)
        blocks.append(block)
        if len(blocks) * BLOCK > MOST_TEXT + BLOCK:
            raise _too_large(name)
    data = _as_utf8(b"".join(blocks), encoding, name)
    # Text and blocks together take twice the memory of the file.
    del blocks
    if b"\r" in data:
        data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    return Text(file, data, digest.hexdigest())


def _too_large(name: str) -> InputError:
    return InputError(
        f"the text is larger than {MOST_TEXT / 1e9:g} GB",
        code="too-large",
        place=name,
        remedy="save the table as Parquet, which is read in chunks",
    )


def _refuse_other_kinds(head: bytes, name: str) -> None:
    for start, kind in _KINDS.items():
        if head.startswith(start):
            raise InputError(
                f"this is not text but {kind}",
                code="wrong-file-type",
                place=name,
                remedy="rename it to its usual extension, save it as CSV, or leave it out",
            )


def _refuse_binary(block: bytes, name: str, row: int, *, first: bool) -> None:
    match = _CONTROL.search(block) if first or b"\0" in block else None
    if match:
        what = "a NUL byte" if match[0] == b"\0" else f"the control character 0x{match[0].hex()}"
        raise InputError(
            f"this is not text: it contains {what}",
            code="wrong-file-type",
            place=f"{name}, row {row + block.count(bytes([10]), 0, match.start())}",
            remedy="save the table as CSV; if this is UTF-16 text, state encoding = 'utf-16'",
        )


def _recognised(head: bytes) -> str | None:
    for mark, encoding in _BOMS.items():
        if head.startswith(mark):
            return encoding
    # Digits and delimiters are ASCII, so in UTF-16 nearly every second byte of them is zero.
    sample = head[:4096]
    even, odd = sample[0::2].count(0), sample[1::2].count(0)
    if max(even, odd) > 0.4 * len(sample[1::2]) and min(even, odd) == 0:
        return "utf-16-be" if even else "utf-16-le"
    return None


def _chinese(data: bytes) -> bool:
    """Whether bytes beyond ASCII come in pairs that are common Chinese characters for the most
    part."""
    runs = re.findall(rb"[\x80-\xff]+", data)
    pairs = [run[i] for run in runs for i in range(0, len(run), 2)]
    even = all(len(run) % 2 == 0 for run in runs)
    return even and 2 * sum(byte in _COMMON for byte in pairs) > len(pairs)


def _japanese(data: bytes) -> bool:
    """Whether characters beyond ASCII are Shift-JIS: pairs that begin as its signs, kana and common
    kanji do. Other encodings of pairs begin higher, and accented letters stand alone."""
    try:
        text = data.decode("cp932")
    except UnicodeDecodeError:
        return False
    beyond = [letter.encode("cp932") for letter in text if not letter.isascii()]
    return 2 * sum(len(b) == 2 and b[0] in _KANA_AND_KANJI for b in beyond) > len(beyond)


def _as_utf8(data: bytes, encoding: str | None, name: str) -> bytes:
    if encoding is None and data.isascii():
        return data
    try:
        if encoding is not None:
            text = data.decode(encoding)
        else:
            try:
                text = data.decode("utf-8")
            except UnicodeDecodeError:
                # GB 18030 decodes nearly any bytes, so its characters have to be common ones.
                asian = "cp932" if _japanese(data) else "gb18030" if _chinese(data) else None
                text = data.decode(asian or "cp1252")
    except LookupError:
        raise InputError(
            f"the encoding {encoding!r} is not known",
            code="unknown-name",
            place=name,
            remedy="state utf-8, utf-16, cp1252, ... or leave it out",
        ) from None
    except UnicodeError as error:
        where = f" at byte {error.start}" if isinstance(error, UnicodeDecodeError) else ""
        raise InputError(
            f"the text is not {encoding or 'UTF-8, GB 18030, Shift-JIS or cp1252'}{where}",
            code="invalid-syntax",
            place=name,
            remedy="state another encoding, or save the table as UTF-8",
        ) from None
    if "\0" in text:
        raise InputError(
            "this is not text: it contains a NUL character",
            code="wrong-file-type",
            place=f"{name}, row {text.count(chr(10), 0, text.index(chr(0))) + 1}",
            remedy="save the table as CSV",
        )
    return text.removeprefix("\ufeff").encode("utf-8")
