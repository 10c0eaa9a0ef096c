"""A machine's history: a folder to which entries are added, one file each, and never changed.

An entry is a JSON document that needs no loopcal to read. It is named by its UTC time and its
number, and holds the SHA-256 of its content, written as JSON with sorted keys and no spaces.
It is linked to its own name, which fails where that name is taken: whatever interrupts this, an
entry is there whole or not at all, and no other is touched.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from shlex import join
from typing import Any

from loopcal.errors import InputError, short
from loopcal.files.atomic import Data, clear_up, write_all
from loopcal.files.json_files import json_bytes
from loopcal.measurements.days import Days
from loopcal.units import unit

SCHEMA = 1
LARGEST = 1e100
KINDS = ("calibration", "verification", "event")
_NAME = re.compile(r"\d{8}T\d{6}Z-(\d{4,12})\.json")


@dataclass(frozen=True)
class Entry:
    """kind: one of `KINDS`; time: UTC, when it was added; sequence: its number from 1; content: by
    kind."""

    file: str
    kind: str
    time: datetime
    sequence: int
    content: Mapping[str, Any]

    @property
    def dated(self) -> bool:
        """Whether the day of its measurement is known; an event without one was today's."""
        return self.kind == "event" or self.content.get("measured") is not None

    @property
    def day(self) -> datetime:
        """When this was measured or happened; where that is unknown, when it was added."""
        measured = self.content.get("measured")
        if measured is None:
            return self.time
        return datetime.fromisoformat(measured["first"]).replace(tzinfo=UTC)


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


def append_entries(
    folder: str | Path,
    added: Sequence[tuple[str, Mapping[str, Any]]],
    together: Callable[[Entries], Mapping[Path, Data]] = lambda _: {},
    *,
    remove: Iterable[Path] = (),
    time: datetime | None = None,
) -> Entries:
    """Add entries (kind, content), and write or remove other files with them, all or none.

    The folder is made if need be. together: files to write, of all entries as they will be; time:
    with a zone, by default now. Raises InputError where anything cannot be written.
    """
    folder = Path(folder)
    at = (time or datetime.now(UTC)).astimezone(UTC).replace(microsecond=0)
    while True:
        if folder.is_dir():
            clear_up(folder)  # before the entries are counted
        earlier = read_entries(folder) if folder.exists() or not added else Entries(folder, (), ())
        # Names alone decide: a damaged entry keeps its number.
        last = max((_number(path.name) for path in _listed(folder)), default=0)
        new = tuple(
            Entry(f"{at:%Y%m%dT%H%M%SZ}-{number:04d}.json", kind, at, number, content)
            for number, (kind, content) in enumerate(added, last + 1)
        )
        every = replace(earlier, whole=(*earlier.whole, *new))
        files: dict[Path, Data] = {folder / entry.file: _text(entry) for entry in new}
        try:
            write_all({**together(every), **files}, remove=remove, new=files)
        except FileExistsError:
            continue  # another process was faster
        return every


def refuse_no_history(folder: str | Path) -> None:
    """Raise InputError, before any work, where entries cannot be added to this path."""
    if os.path.lexists(folder) and not Path(folder).is_dir():
        raise InputError(
            "this is no folder, and a history is one",
            code="wrong-file-type",
            place=str(folder),
            remedy="name the folder of the history; a new one is made",
        )


def _listed(folder: Path) -> Iterable[Path]:
    return folder.iterdir() if folder.is_dir() else ()


def is_history(folder: str | Path) -> bool:
    """Whether the folder is there."""
    return Path(folder).is_dir()


def read_entries(folder: str | Path) -> Entries:
    """The entries of a folder; damaged ones are named and skipped.

    Raises InputError where there is no such folder, and for that of a result.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(
            "there is no such folder",
            code="missing-file",
            place=str(folder),
            remedy="begin the history with: loopcal history FOLDER --add RESULT",
        ).then(join(["loopcal", "history", str(folder), "--add", "RESULT"]))
    if (folder / "result.json").is_file():
        command = ["loopcal", "history", "machine.history", "--add", str(folder)]
        raise InputError(
            "this is the folder of a result, and no history",
            code="wrong-file-type",
            place=str(folder),
            remedy="add the result to the history of its machine",
        ).then(join(command))
    whole: list[Entry] = []
    skipped: list[Skipped] = []
    for path in sorted(folder.glob("*.json")):
        try:
            whole.append(_read(path))
        except (InputError, ValueError, KeyError, TypeError, RecursionError) as error:
            skipped.append(Skipped(path.name, _reason(error)))
    whole.sort(key=lambda entry: entry.sequence)
    return Entries(folder, tuple(whole), tuple(skipped))


def _text(entry: Entry) -> str:
    body = {
        "schema": SCHEMA,
        "kind": entry.kind,
        "time": entry.time.isoformat(),
        "sequence": entry.sequence,
        "content": dict(entry.content),
    }
    return json.dumps({**body, "sha256": _sum(body)}, indent=1, allow_nan=False) + "\n"


def _read(path: Path) -> Entry:
    document = json.loads(json_bytes(path, "delete the file"))
    if not isinstance(document, dict):
        raise ValueError("it is no JSON object")
    stated = document.pop("sha256")
    if stated != _sum(document):
        raise ValueError("its SHA-256 differs from its content")
    if document["schema"] != SCHEMA or document["kind"] not in KINDS:
        raise ValueError("its kind or schema is unknown")
    time, number, content = (
        datetime.fromisoformat(document["time"]),
        document["sequence"],
        document["content"],
    )
    if time.tzinfo is None or type(number) is not int or not 0 < number < 1 << 63:
        raise ValueError("its time has no zone, or its number is none")
    _check_content(document["kind"], content)
    return Entry(path.name, document["kind"], time, number, content)


def _check_content(kind: str, content: Any) -> None:
    """Raise ValueError where the content of an entry is not what this kind has."""
    if not isinstance(content, dict):
        raise ValueError("its content is no JSON object")
    _text_of(content, "words")
    if content.get("rms") is not None:
        _number_with_unit(content, "rms")
    if (measured := content.get("measured")) is not None:
        days = f"{_text_of(measured, 'first')} to {_text_of(measured, 'last')}"
        if Days.of_text(days) is None:
            raise ValueError("its 'measured' is no day")
    if kind == "calibration":
        if not isinstance(content["parameters"], dict):
            raise ValueError("its parameters are no JSON object")
        for name, estimate in content["parameters"].items():
            if not isinstance(estimate, dict):
                raise ValueError(f"its parameter {short(name)!r} is no JSON object")
            _number_with_unit(estimate, "value")
            _number_with_unit(estimate, "sd")
        if content.get("joint") is not None:
            _check_joint(content["joint"], content["parameters"])


def _check_joint(joint: Any, parameters: Mapping[str, Any]) -> None:
    """Raise ValueError where this says nothing of the parameters together."""
    if not isinstance(joint, dict) or joint["names"] != [*parameters]:
        raise ValueError("its 'joint' is not of its parameters")
    size, every = len(parameters), range(1, len(parameters) + 1)
    for key in ("covariance", "moves"):
        if joint[key] is not None or key == "covariance":
            if [len(row) for row in joint[key]] != [*every]:
                raise ValueError(f"its {key!r} is no triangle of its parameters")
            _numbers(key, (value for row in joint[key] for value in row))
    if not all(row[-1] > 0.0 for row in joint["covariance"]):
        raise ValueError("its 'covariance' has no variance")
    for name, steps in joint["zeros"].items():
        unit(_text_of(joint["units"], name))
        if len(steps) != size:
            raise ValueError(f"the zero of {short(name)!r} is not of its parameters")
        _numbers("zeros", steps)


def _text_of(content: Mapping[str, Any], key: str) -> str:
    text = content[key]
    if not isinstance(text, str):
        raise ValueError(f"its {key!r} is no text")
    text.encode("utf-8")  # half a character is none
    return text


def _number_with_unit(content: Mapping[str, Any], key: str) -> None:
    _numbers(key, [content[key]])
    unit(_text_of(content, "unit"))


def _numbers(key: str, values: Iterable[Any]) -> None:
    for value in values:
        numeric = isinstance(value, int | float) and not isinstance(value, bool)
        if not numeric or not abs(value) < LARGEST:
            raise ValueError(f"its {key!r} is no number below {LARGEST:g}")


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
