"""JSON files of ours as plain data, with a place for every complaint."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NoReturn

from loopcal.errors import InputError
from loopcal.files.tables.raw import bytes_of

MOST_BYTES = 1_000_000_000


def read_json(path: str | Path, kind: str, schema: int) -> dict[str, Any]:
    """The object in a JSON file of a kind ("result.json", ...) and schema.

    Raises InputError, with line and column, for what is no such file.
    """
    remedy = f"name a {kind} that loopcal wrote"
    content = bytes_of(path, MOST_BYTES)
    if len(content) > MOST_BYTES:
        raise InputError(
            f"the file is larger than {MOST_BYTES / 1e9:g} GB", place=str(path), remedy=remedy
        )
    try:
        document = json.loads(content, parse_constant=_refused)
    except json.JSONDecodeError as error:
        raise InputError(
            f"this is not valid JSON: {error.msg}",
            place=f"{path}, line {error.lineno}, column {error.colno}",
            remedy=remedy,
        ) from None
    except (UnicodeDecodeError, RecursionError, ValueError) as error:
        why = str(error) if type(error) is ValueError else "it is no text of that form"
        raise InputError(f"this is not valid JSON: {why}", place=str(path), remedy=remedy) from None
    if not isinstance(document, dict) or "schema" not in document:
        raise InputError(
            f"this is no {kind}: it does not say its schema", place=str(path), remedy=remedy
        )
    if document["schema"] is True or document["schema"] != schema:
        raise InputError(
            f"schema is {document['schema']!r}, and only schema {schema} can be read",
            place=f"{path}: schema",
            remedy="use the loopcal that wrote this file, or write it anew",
        )
    return document


def _refused(constant: str) -> NoReturn:
    raise ValueError(f"it holds {constant}, which JSON does not know")
