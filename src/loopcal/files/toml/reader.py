"""TOML files as plain data: read whole, within bounds, and with a place for every complaint."""

from __future__ import annotations

import re
import sys
import tomllib
from collections.abc import Mapping
from pathlib import Path
from shlex import quote
from typing import Any

from loopcal.errors import InputError
from loopcal.files.tables.raw import bytes_of
from loopcal.files.tables.registry import BY_ENDING, READERS
from loopcal.files.toml.place import Place

MOST_BYTES = 2_000_000
"""A project or mechanism is written by hand; what is larger is some other file."""
MOST_PARTS, MOST_VALUES, LONGEST_KEY, LONGEST_TEXT = 12, 100_000, 255, 10_000
"""Parts of a dotted key, values of a file, and characters of a key and of a text, at most.

A parser keeps a table for each part of each key, and a part of them for each of its beginnings.
"""
_PART = r"""(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')"""
_DEEP = re.compile(
    rf"(?:^|[\[{{,])[ \t]*+(?:{_PART}[ \t]*+\.[ \t]*+){{{MOST_PARTS}}}", re.MULTILINE
)
SCHEMA = 1
# tomllib states the place in the text of its error.
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
    refuse_other_kind(path)
    return bytes_of(path, MOST_BYTES, empty_too=True)


def shown(path: str | Path) -> str:
    """How messages call the file."""
    return "standard input" if str(path) == "-" else str(path)


def toml_data(content: bytes | str, name: str) -> dict[str, Any]:
    """TOML text as plain data; `name` is how messages call it."""
    if isinstance(content, str):
        # Half a character is then refused below, as bytes that are not UTF-8 are.
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
    if deep := _DEEP.search(text):
        raise InputError(
            f"a key has more than {MOST_PARTS} parts",
            code="too-large",
            place=f"{name}, line {text.count(chr(10), 0, deep.start()) + 1}",
            remedy="correct the line",
        )
    try:
        data = tomllib.loads(text)
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
            remedy="correct the line; `loopcal init` makes a project of a file of readings",
        ) from None
    _refuse_large(data, Place(name))
    return data


def _refuse_large(data: dict[str, Any], place: Place) -> None:
    """Raise InputError for more values, longer texts or larger whole numbers than a project has."""
    waiting: list[tuple[Any, Place]] = [(data, place)]
    for count in range(MOST_VALUES + 1):
        if not waiting:
            return
        value, where = waiting.pop()
        what = ""
        if isinstance(value, dict):
            if any(len(key) > LONGEST_KEY for key in value):
                what = f"a key has more than {LONGEST_KEY} characters"
            waiting += [(one, where.at(key)) for key, one in value.items()]
        elif isinstance(value, list):
            waiting += [(one, where) for one in value]
        elif isinstance(value, str) and len(value) > LONGEST_TEXT:
            what = f"a text has more than {LONGEST_TEXT:,} characters"
        elif isinstance(value, int) and not -(2**63) <= value < 2**63:
            what = "a whole number has more than 64 bits, which TOML does not allow"
        if len(waiting) + count > MOST_VALUES:
            what = f"this file holds more than {MOST_VALUES:,} values"
        if what:
            raise InputError(
                what, code="too-large", place=str(where), remedy="shorten or correct it"
            )


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


# Files and folders that are named where a project belongs: what they are, and where they go.

_TABLES = {*BY_ENDING, *(ending for reader in READERS for ending in reader.relatives)}
_ROBOTS = (".urdf", ".xacro")


def refuse_other_kind(path: str | Path) -> None:
    """Raise InputError for what by its name is readings, a robot, a result or a folder."""
    path, name, project = Path(path), quote(str(path)), Path(path) / "project.toml"
    ending, command = path.suffix.lower(), ""
    result = path if path.is_dir() else path.parent
    if ending in _TABLES:
        words = "this is a table of readings"
        remedy = f"make a project of it: loopcal init {name} --urdf ROBOT.urdf, or --dh TABLE.csv"
        command = f"loopcal init {name} ROBOT"
    elif ending in _ROBOTS:
        words = "this is the description of a robot"
        command = f"loopcal init READINGS --urdf {name}"
        remedy = f"make a project of it and of your readings: {command}"
    elif (path.is_dir() or ending == ".json") and (result / "result.json").is_file():
        words = "this is the result of a calibration"
        remedy = "name the project that it came from; verify, predict, export and report take it"
    elif path.is_dir() and project.is_file():
        words, remedy = "this is a folder", f"name the project in it: {project}"
    elif path.is_dir():
        words, remedy = "this is a folder", "name the project file in it"
    else:
        return
    error = InputError(
        f"{words}, not a project file", code="wrong-file-type", place=str(path), remedy=remedy
    )
    error.then(command)
    raise error.meaning(str(path), str(project)) if project.is_file() else error
