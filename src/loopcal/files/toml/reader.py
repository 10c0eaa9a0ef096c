"""TOML files as plain data: read whole, within bounds, and with a place for every complaint."""

from __future__ import annotations

import re
import sys
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from loopcal.errors import InputError
from loopcal.files.tables.raw import bytes_of
from loopcal.files.toml.place import Place

MOST_BYTES = 4_000_000
"""A project or mechanism is written by hand; what is larger is some other file."""
SCHEMA = 1
_AT = re.compile(r"\s*\(at (?:line (?P<line>\d+), column (?P<column>\d+)|end of document)\)$")


def read_toml(path: str | Path) -> dict[str, Any]:
    """The contents of a TOML file, "-" being standard input.

    Raises InputError, with line and column, for what is no TOML file of a reasonable size.
    """
    return toml_data(read_text(path), shown(path))


def read_text(path: str | Path) -> bytes:
    """The bytes of a TOML file, "-" being standard input; at most one more than are read of one.

    Raises InputError for a file that cannot be read.
    """
    if str(path) == "-":
        return sys.stdin.buffer.read(MOST_BYTES + 1)
    return bytes_of(path, MOST_BYTES, empty_too=True)


def shown(path: str | Path) -> str:
    """How messages call the file."""
    return "standard input" if str(path) == "-" else str(path)


def toml_data(content: bytes | str, name: str) -> dict[str, Any]:
    """TOML text as plain data; `name` is how messages call it."""
    if isinstance(content, str):
        content = content.encode("utf-8", "surrogatepass")
    if len(content) > MOST_BYTES:
        raise InputError(
            f"this file is larger than {MOST_BYTES // 1_000_000} MB, too large for a project "
            "or a mechanism",
            code="too-large",
            place=name,
            remedy="name a TOML file; keep readings in a separate file (data.file)",
        )
    text = _decoded(content, name)
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise InputError(
            "this TOML is nested too deeply",
            code="invalid-syntax",
            place=name,
            remedy="close the brackets",
        ) from None
    except ValueError as error:  # TOMLDecodeError, and numbers of too many digits
        words = str(error)
        at = _AT.search(words)
        place = name
        if at and at["line"]:
            place = f"{name}, line {at['line']}, column {at['column']}"
        elif at:
            place = f"{name}, end of the file"
        raise InputError(
            f"this is not valid TOML: {_AT.sub('', words)}",
            code="invalid-syntax",
            place=place,
            remedy="correct the line; `loopcal new` writes a project to compare with",
        ) from None


def checked_schema(data: Mapping[str, Any], place: Place) -> None:
    """Raise InputError unless the file states the schema that is read here."""
    remedy = f"write schema = {SCHEMA} in the first line"
    if "schema" not in data:
        raise InputError(
            "the file states no schema", code="wrong-schema", place=str(place), remedy=remedy
        )
    stated = data["schema"]
    if isinstance(stated, bool) or stated != SCHEMA:
        if isinstance(stated, int) and stated > SCHEMA:
            remedy = "use the loopcal version that wrote this file, or a newer one"
        raise InputError(
            f"schema is {stated!r}, and only schema {SCHEMA} can be read",
            code="wrong-schema",
            place=str(place.at("schema")),
            remedy=remedy,
        )


def _decoded(content: bytes, name: str) -> str:
    if (nul := content.find(b"\0")) >= 0:
        raise InputError(
            "this is not a TOML file: it contains a NUL byte",
            code="wrong-file-type",
            place=f"{name}, line {content.count(bytes([10]), 0, nul) + 1}",
            remedy="save the file as UTF-8 text",
        )
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(
            f"the text is not UTF-8: it contains the byte 0x{content[error.start]:02x}",
            code="invalid-syntax",
            place=f"{name}, line {content.count(bytes([10]), 0, error.start) + 1}",
            remedy="save the file as UTF-8",
        ) from None
