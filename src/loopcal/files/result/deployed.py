"""What was made of a result, kept in its folder `deployed`: exports, corrected programs, plans, and
what was found of it on other days.

A note names the result.json that it was made from by its SHA-256, so that notes of an earlier
calibration in the same folder do not count for a later one.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from loopcal.document.plain import plain
from loopcal.errors import InputError
from loopcal.files.atomic import write_files
from loopcal.files.json_reader import read_json
from loopcal.files.tables.raw import sha256_of

FOLDER = "deployed"
EXPORT, CORRECTION, PLAN = "export", "correction", "plan"
VERIFICATION, HISTORY, FLEET = OTHER_DAYS = "verification", "history", "fleet"


@dataclass(frozen=True)
class Deployed:
    """kind: one of the above; document: what the command prints with --json."""

    kind: str
    document: Mapping[str, Any]


def result_path(result: str | Path) -> Path:
    """The result.json of a folder, or that file itself."""
    path = Path(result)
    return path / "result.json" if path.is_dir() else path


def note_deployed(result: Path, kind: str, name: str, document: Mapping[str, Any]) -> None:
    """Keep what was made of a result.json under a name; an earlier note of this name goes.

    A folder that cannot be written to is left as it is.
    """
    words = {"schema": 1, "kind": kind, "result": sha256_of(result), **document}
    text = json.dumps(plain(words), indent=1, ensure_ascii=False) + "\n"
    with suppress(InputError):
        write_files(result.parent / FOLDER, {f"{kind}-{name}.json": text})


def read_deployed(result: Path) -> tuple[Deployed, ...]:
    """What was made of this result.json, by names. Raises InputError for a note that is broken."""
    files = sorted((result.parent / FOLDER).glob("*.json"))
    if not files:
        return ()
    own = sha256_of(result)
    notes = [read_json(path, "note of deployed", 1) for path in files]
    return tuple(Deployed(str(n.get("kind")), n) for n in notes if n.get("result") == own)
