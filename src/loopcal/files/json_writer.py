"""JSON files of ours: what `files.outputs` knows them by, and the hashes of files beside them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from hashlib import sha256
from typing import Any

from loopcal.document.plain import plain
from loopcal.files.versions import version


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
