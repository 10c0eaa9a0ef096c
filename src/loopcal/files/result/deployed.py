"""What was made of a result, kept in its folder `deployed`: exports, corrected programs, plans, and
what was found of it on other days.

A note names the result.json that it was made from by its SHA-256, so that notes of an earlier
calibration in the same folder do not count for a later one.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

from loopcal.errors import InputError
from loopcal.files.atomic import write_files
from loopcal.files.json_files import marked_json, read_json
from loopcal.files.tables.raw import sha256_of

FOLDER = "deployed"
PREVIEW = ".preview"
"""Folder of exports that are only looked at."""
EXPORT, CORRECTION, PLAN = "export", "correction", "plan"
VERIFICATION, HISTORY, FLEET = OTHER_DAYS = "verification", "history", "fleet"


@dataclass(frozen=True)
class Deployed:
    """kind: one of the above; document: what the command prints with --json."""

    kind: str
    document: Mapping[str, Any]


def project_beside(folder: Path) -> dict[str, str]:
    """The project NAME.toml beside its result NAME-result, for command lines; empty elsewhere."""
    project = folder.with_name(f"{folder.name.removesuffix('-result')}.toml")
    return {"project": str(project)} if project.is_file() else {}


def result_path(result: str | Path) -> Path:
    """The result.json of a folder, or that file itself."""
    path = Path(result)
    return path / "result.json" if path.is_dir() else path


def note_deployed(
    result: Path,
    kind: str,
    name: str,
    document: Mapping[str, Any],
    contents: Iterable[bytes] = (),
) -> None:
    """Keep what was made of a result.json under a name; an earlier note of this name goes.

    contents: of the files that were written. The note keeps their SHA-256, and those that an
    earlier note of this name has of the same result. A folder that cannot be written to is left
    as it is.
    """
    result_sha256, path = sha256_of(result), result.parent / FOLDER / f"{kind}-{name}.json"
    made = {*_made(path, result_sha256), *(sha256(content).hexdigest() for content in contents)}
    words = {"schema": 1, "kind": kind, "result": result_sha256, **document, "made": sorted(made)}
    text = marked_json(words)
    with suppress(InputError):
        write_files(path.parent, {path.name: text})


def made_of(result: Path) -> frozenset[str]:
    """SHA-256 of all files that were made of this result.json, by its notes."""
    result_sha256 = sha256_of(result)
    return frozenset(one for path in _notes(result) for one in _made(path, result_sha256))


def corrected_of(result: Path) -> frozenset[str]:
    """Names of the corrected programs that notes beside a result.json know, of whatever result."""
    names = set()
    for path in _notes(result):
        with suppress(InputError):
            content = read_json(path, "note of deployed", 1)
            if content.get("kind") == CORRECTION:
                names.add(Path(str(content.get("written"))).name)
    return frozenset(names)


def _made(note: Path, result: str) -> list[str]:
    """SHA-256 of the files of a note; none where it is of another result, or is none."""
    with suppress(InputError):
        content = read_json(note, "note of deployed", 1)
        if content.get("result") == result:
            return [str(one) for one in content.get("made", ())]
    return []


def _notes(result: Path) -> list[Path]:
    return sorted((result.parent / FOLDER).glob("*.json"))


def was_corrected(result: Path, program: Path) -> bool:
    """Whether a file is as `loopcal correct` wrote it by any result of this folder."""
    notes = (result.parent / FOLDER).glob(f"{CORRECTION}-*.json")
    if not program.is_file():
        return False
    program_sha256 = sha256_of(program)
    # Searched as text: a broken note still protects from a second correction.
    return any(program_sha256 in path.read_text("utf-8", "replace") for path in notes)


def read_deployed(result: Path) -> tuple[Deployed, ...]:
    """What was made of this result.json, by names. Raises InputError for a note that is broken."""
    files = _notes(result)
    if not files:
        return ()
    result_sha256 = sha256_of(result)
    notes = [read_json(path, "note of deployed", 1) for path in files]
    return tuple(Deployed(str(n.get("kind")), n) for n in notes if n.get("result") == result_sha256)
