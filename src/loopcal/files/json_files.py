"""JSON files of ours as plain data, with a place for every complaint."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any, NoReturn

from loopcal.document.plain import plain
from loopcal.errors import Code, InputError
from loopcal.files.tables.raw import bytes_of
from loopcal.files.versions import version

_ESCAPED_SURROGATE = re.compile(rb"\\u[dD][89a-fA-F]")
MOST_BYTES, MOST_PARTS = 100_000_000, 500_000
"""Bytes of a file, and objects and lists in it, each of which takes much more memory than text."""


def read_json(path: str | Path, kind: str, *schemas: int) -> dict[str, Any]:
    """The object in a JSON file of a kind ("result.json", ...) and one of these schemas.

    Raises InputError, with line and column, for what is no such file.
    """
    remedy = f"name a {kind} that loopcal wrote"

    def wrong(words: str, place: str = str(path), code: Code = "invalid-syntax") -> InputError:
        return InputError(words, code=code, place=place, remedy=remedy)

    no_json = "this is not valid JSON: "
    content = json_bytes(path, remedy)
    try:
        document = json.loads(content, parse_constant=_refused, parse_int=whole_number)
    except json.JSONDecodeError as error:
        place = f"{path}, line {error.lineno}, column {error.colno}"
        raise wrong(f"{no_json}{error.msg}", place) from None
    except (UnicodeDecodeError, RecursionError, ValueError) as error:
        why = str(error) if type(error) is ValueError else "it is no text of that form"
        raise wrong(f"{no_json}{why}") from None
    # Python's json accepts half of a surrogate pair, which UTF-8 cannot hold.
    if _ESCAPED_SURROGATE.search(content):
        try:
            json.dumps(document, ensure_ascii=False).encode("utf-8")
        except UnicodeEncodeError as error:
            half = f"\\u{ord(error.object[error.start]):04x}"
            raise wrong(f"{no_json}it holds half a character ({half})") from None
    if not isinstance(document, dict) or "schema" not in document:
        raise wrong(f"this is no {kind}: it states no schema", code="wrong-file-type")
    # True == 1 in Python.
    if document["schema"] is True or document["schema"] not in schemas:
        readable = " or ".join(map(str, schemas))
        raise InputError(
            f"schema is {document['schema']!r}, and only schema {readable} can be read",
            code="wrong-schema",
            place=f"{path}: schema",
            remedy="use the loopcal version that wrote this file, or write the file again",
        )
    return document


def json_bytes(path: str | Path, remedy: str) -> bytes:
    """The bytes of a JSON file. Raises InputError where it is larger than loopcal writes any."""
    content = bytes_of(path, MOST_BYTES)
    # Brackets inside texts count too: the bound is met too early, never too late.
    parts = content.count(b"[") + content.count(b"{")
    if len(content) > MOST_BYTES or parts > MOST_PARTS:
        raise InputError(
            f"the file is larger than {MOST_BYTES // 1_000_000} MB, or holds more than "
            f"{MOST_PARTS:,} lists",
            code="too-large",
            place=str(path),
            remedy=remedy,
        )
    return content


def whole_number(digits: str) -> int:
    # A double ends at 309 digits, and int() costs the square of the digits.
    if len(digits) > 300:
        raise ValueError(f"it holds a number of {len(digits)} digits")
    return int(digits)


def _refused(constant: str) -> NoReturn:
    raise ValueError(f"it holds {constant}, which JSON does not know")


# JSON files of ours: what `files.outputs` knows them by, and the hashes of files beside them.


def marked(
    document: Mapping[str, Any], tables: Mapping[str, str | bytes] | None = None
) -> dict[str, Any]:
    """A document as loopcal writes it, with the SHA-256 of the tables that come with it."""
    head = {"schema": document.get("schema", 1), "loopcal": version()}
    listed = {} if tables is None else {"files": sums(tables)}
    return {**head, **document, **listed}


def marked_json(
    document: Mapping[str, Any],
    tables: Mapping[str, str | bytes] | None = None,
    *,
    indent: int | None = 1,
) -> str:
    """The text of `marked`."""
    content = plain(marked(document, tables))
    return json.dumps(content, indent=indent, ensure_ascii=False, allow_nan=False) + "\n"


def sums(files: Mapping[str, str | bytes]) -> dict[str, str]:
    """Name -> SHA-256 of the content."""
    return {
        name: sha256(data.encode() if isinstance(data, str) else data).hexdigest()
        for name, data in files.items()
    }
