"""A machine's history: a folder to which entries are added, one file each, and never changed.

An entry is a JSON document that needs no loopcal to read. It is named by its UTC time and its
number, and holds the SHA-256 of its own content, written as JSON with sorted keys and no spaces.
It is written under a temporary name, forced to the disk and then linked to its own name, which
fails where that name is taken: whatever interrupts this, an entry is there whole or not at all,
and no other is touched.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import secrets
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from loopcal.errors import InputError
from loopcal.files.json_reader import MOST_BYTES
from loopcal.files.tables.raw import bytes_of

SCHEMA = 1
KINDS = ("calibration", "verification", "event")
_NAME = re.compile(r"\d{8}T\d{6}Z-(\d{4,})\.json")


@dataclass(frozen=True)
class Entry:
    """kind: one of `KINDS`; time: UTC; sequence: its number from 1; content: by kind."""

    file: str
    kind: str
    time: datetime
    sequence: int
    content: Mapping[str, Any]


@dataclass(frozen=True)
class Skipped:
    """A file that is no whole entry, and why."""

    file: str
    reason: str


@dataclass(frozen=True)
class Entries:
    """All entries of a folder in their order, and the files that were skipped."""

    folder: Path
    whole: tuple[Entry, ...]
    skipped: tuple[Skipped, ...]


def append_entry(
    folder: str | Path, kind: str, content: Mapping[str, Any], *, time: datetime | None = None
) -> Entry:
    """Add an entry; the folder is made if need be.

    time: with a zone, by default now. Raises InputError where it cannot be written.
    """
    folder = Path(folder)
    at = (time or datetime.now(UTC)).astimezone(UTC).replace(microsecond=0)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        number = 1 + max((_number(path.name) for path in folder.iterdir()), default=0)
        while True:
            entry = Entry(f"{at:%Y%m%dT%H%M%SZ}-{number:04d}.json", kind, at, number, content)
            if _written(folder, entry):
                return entry
            number += 1  # another process was faster
    except OSError as error:
        raise InputError(
            f"the history cannot be written: {error.strerror or error}",
            code="unwritable-file",
            place=str(folder),
            remedy="choose a folder with write permission",
        ) from None


def is_history(folder: str | Path) -> bool:
    """Whether the folder is there."""
    return Path(folder).is_dir()


def read_entries(folder: str | Path) -> Entries:
    """The entries of a folder; damaged ones are named and skipped.

    Raises InputError where there is no such folder.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(
            "there is no such folder",
            code="missing-file",
            place=str(folder),
            remedy="begin the history with: loopcal history FOLDER --add RESULT",
        )
    whole: list[Entry] = []
    skipped: list[Skipped] = []
    for path in sorted(folder.glob("*.json")):
        try:
            whole.append(_read(path))
        except (InputError, ValueError, KeyError, TypeError, RecursionError) as error:
            skipped.append(Skipped(path.name, _reason(error)))
    whole.sort(key=lambda entry: entry.sequence)
    return Entries(folder, tuple(whole), tuple(skipped))


def _written(folder: Path, entry: Entry) -> bool:
    """Whether the entry was written; no, where its name is taken."""
    body = {
        "schema": SCHEMA,
        "kind": entry.kind,
        "time": entry.time.isoformat(),
        "sequence": entry.sequence,
        "content": dict(entry.content),
    }
    text = json.dumps({**body, "sha256": _sum(body)}, indent=1, allow_nan=False) + "\n"
    temporary = folder / f".{entry.file}.{secrets.token_hex(6)}.part"
    try:
        with temporary.open("x", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        try:
            os.link(temporary, folder / entry.file)
        except FileExistsError:
            return False
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
    finally:
        with suppress(OSError):
            temporary.unlink()
    return True


def _read(path: Path) -> Entry:
    found = json.loads(bytes_of(path, MOST_BYTES))
    if not isinstance(found, dict):
        raise ValueError("it is no JSON object")
    stated = found.pop("sha256")
    if stated != _sum(found):
        raise ValueError("its SHA-256 differs from its content")
    if found["schema"] != SCHEMA or found["kind"] not in KINDS:
        raise ValueError("its kind or schema is unknown")
    time = datetime.fromisoformat(found["time"])
    return Entry(path.name, found["kind"], time, int(found["sequence"]), found["content"])


def _sum(body: Mapping[str, Any]) -> str:
    text = json.dumps(body, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode("utf-8")).hexdigest()


def _number(name: str) -> int:
    match = _NAME.fullmatch(name)
    return int(match[1]) if match else 0


def _reason(error: Exception) -> str:
    if isinstance(error, KeyError):
        return f"it has no {error.args[0]!r}"
    if isinstance(error, json.JSONDecodeError | UnicodeDecodeError | RecursionError):
        return "it is no whole JSON document"
    return error.message if isinstance(error, InputError) else str(error)
