"""A folder with one project in it: what lies there, files taken in, and every change written down.

`loopcal-log.jsonl` has a line for each change and each run, with its time and reason; nothing in
it is ever rewritten.
"""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from stat import S_ISREG
from typing import Any, BinaryIO

from loopcal.errors import InputError, LoopcalError
from loopcal.files.atomic import unwritable, write_atomic
from loopcal.files.machines.meshes import READERS as MESHES
from loopcal.files.outputs import leads_into
from loopcal.files.result.deployed import FOLDER as NOTES
from loopcal.files.result.deployed import corrected_of, made_of
from loopcal.files.tables.raw import sha256_of
from loopcal.files.tables.registry import BY_ENDING as READERS

LOG = "loopcal-log.jsonl"
PROJECT = "project.toml"
RESULT = "result.json"
PLAN_DOCUMENT = "plan.json"
RECORD = "record.html"
TAKEN = {*READERS, *MESHES, *(".urdf", ".xml", ".toml", ".conf", ".yaml", ".yml", ".json")}
"""Endings of the files that are taken in: readings, robots, meshes, projects and what an export
patches.
Nothing else is of use, and Python beside them could be run by other programs."""
_APPENDING = threading.Lock()


@dataclass(frozen=True)
class Entry:
    """One line of the log; number: from 1; at: UTC; record: what it says, by name."""

    number: int
    at: str
    kind: str
    what: str
    record: Mapping[str, Any]


@dataclass(frozen=True)
class Log:
    """The entries that can be read; broken: numbers of the lines that cannot."""

    entries: tuple[Entry, ...]
    broken: tuple[int, ...] = ()

    def edits(self) -> list[Entry]:
        """Changes of the project that are not undone, the last one last."""
        # An undo names the edit by its line; no line is ever rewritten.
        undone = {entry.record.get("of") for entry in self.entries if entry.kind == "undo"}
        return [e for e in self.entries if e.kind == "edit" and e.number not in undone]

    def unfinished(self) -> Entry | None:
        """The run that began last, where nothing says how it ended."""
        last = next((e for e in reversed(self.entries) if e.kind in ("begun", "ended")), None)
        return last if last is not None and last.kind == "begun" else None


@dataclass(frozen=True)
class Listed:
    """A file of the folder; modified: [ns]."""

    name: str
    size: int
    modified: int


@dataclass(frozen=True)
class ProjectFolder:
    """The folder; nothing outside it is touched. also: further endings of files taken in.

    Names of files are paths from it. The project may lie in a folder inside, as `loopcal init`
    puts it beside the readings.
    """

    path: Path
    also: frozenset[str] = frozenset()

    @property
    def project(self) -> Path:
        """The project file: project.toml, or the only TOML file that states a project, in the
        folder or else in one inside it."""
        stated = self.path / PROJECT
        if os.path.lexists(stated):
            return stated
        for pattern in ("[!.-]*.toml", f"[!.-]*/{PROJECT}"):
            paths = [p for p in sorted(self.path.glob(pattern)) if self._is_project(p)]
            if paths:
                return paths[0] if len(paths) == 1 else stated
        return stated

    def _is_project(self, path: Path) -> bool:
        return "[mechanism]" in (self.content(self.named(path)) or "")

    def named(self, path: Path) -> str:
        """The name of a file or folder inside."""
        return path.relative_to(self.path).as_posix()

    @property
    def result(self) -> Path:
        """Where `loopcal calibrate` writes the result of the project."""
        return self.project.with_name(f"{self.project.stem}-result")

    @property
    def plan(self) -> Path:
        """Where `loopcal plan` writes the plan of the project."""
        return self.project.with_name(f"{self.project.stem}-plan")

    @property
    def export(self) -> Path:
        """Where `loopcal export` writes files for the robot."""
        return self.result / "export"

    @property
    def tried(self) -> list[Path]:
        """Folders of results beside that of the project."""
        beside = self.project.parent.glob(f"{self.project.stem}-*/{RESULT}")
        return sorted(path.parent for path in beside if path.parent != self.result)

    def listed(self) -> list[Listed]:
        """The files in the folder, and in those of project, results, plan and export, by name.

        Left out are hidden ones, links that leave the folder, and names that a command line or a
        page would take for something else.
        """
        files = []
        folders = (self.path, self.project.parent, self.result, self.plan, self.export)
        for folder in dict.fromkeys((*folders, *self.tried)):
            if not folder.is_dir() or not leads_into(folder, self.path):
                continue
            for path in sorted(folder.iterdir()):
                # A command line reads a leading hyphen as an option.
                shown = path.name.isprintable() and path.name[0] not in ".-"
                if shown and leads_into(path, self.path):
                    with suppress(FileNotFoundError):  # gone since
                        status = path.stat()
                        name = self.named(path)
                        if S_ISREG(status.st_mode):
                            files.append(Listed(name, status.st_size, status.st_mtime_ns))
        return files

    def deployed(self) -> dict[str, bool]:
        """Files for the robot and the record, and whether each is of the result as it stands."""
        result = self.result / RESULT
        names = [file.name for file in self.listed()]
        if self.named(result) not in names:
            return {}
        result_sha256, export = sha256_of(result), self.named(self.export)
        made, corrected = made_of(result), corrected_of(result)
        up_to_date = {
            name: sha256_of(self.path / name) in made
            for name in names
            if ".bak" not in name and (name.startswith(f"{export}/") or name in corrected)
        }
        record = self.named(self.result / RECORD)
        if record in names:  # it prints the SHA-256 of what it was made of
            up_to_date[record] = result_sha256 in (self.content(record) or "")
        return up_to_date

    def text(self) -> str | None:
        """Of the project file; None where there is none."""
        try:
            return self.inside(self.named(self.project)).read_text("utf-8")
        except (FileNotFoundError, IsADirectoryError):
            return None
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(
                f"cannot be read: {error}",
                code="unreadable-file",
                place=str(self.project),
                remedy="check the file",
            ) from None

    def noted_at(self) -> tuple[tuple[str, int], ...]:
        """The notes of what was made of the result, and when each was written [ns]."""
        notes = sorted((self.result / NOTES).glob("*.json"))
        return tuple((path.name, path.stat().st_mtime_ns) for path in notes)

    def inside(self, name: str) -> Path:
        """The path of a file of the folder. Raises InputError for any other."""
        root = Path(os.path.realpath(self.path))
        # realpath raises ValueError for a zero byte.
        path = root if "\0" in name else Path(os.path.realpath(root / name))
        if path == root or not leads_into(path, root):
            raise InputError(
                "the file is not in the project's folder",
                code="missing-file",
                place=name,
                remedy=f"name a file in {self.path}",
            )
        return path

    def file(self, name: str) -> Path:
        """The path of a file that the folder lists. Raises InputError for any other."""
        path = self.inside(name)
        if name not in {file.name for file in self.listed()}:
            raise InputError(
                "there is no such file in the project's folder",
                code="missing-file",
                place=name,
                remedy="look at the list of files",
            )
        return path

    def inside_of(self, folder: str) -> list[str]:
        """Names of the files in a folder of this one, without backups."""
        paths = sorted(self.inside(folder).glob("*"))
        files = [p for p in paths if p.is_file() and leads_into(p, self.path)]
        return [p.name for p in files if ".bak" not in p.name]

    def content(self, name: str) -> str | None:
        """The text of a file of the folder; None where it is not there or is no text."""
        try:
            return self.inside(name).read_text("utf-8")
        except (InputError, OSError, UnicodeDecodeError):
            return None

    def take(
        self,
        name: str,
        content: bytes,
        step: str = "",
        check: Callable[[Path], Any] = lambda _: None,
    ) -> Path:
        """Keep a file that was handed in at a step, under its own last name.

        Raises InputError for a name that cannot stand, where a file of other content has it, and
        what `check` raises for the file: it is not kept then.
        """
        last = name.replace("\\", "/").rsplit("/", 1)[-1].strip()
        if not last or last[0] in ".-" or not last.isprintable() or len(last) > 200:
            raise InputError(
                f"{name!r} is no name of a file",
                code="invalid-value",
                remedy="rename the file",
            )
        taken = TAKEN | self.also
        if Path(last).suffix.lower() not in taken:
            raise InputError(
                f"the ending {Path(last).suffix!r} is that of no file that loopcal reads",
                code="wrong-file-type",
                place=last,
                remedy=f"give a file that ends in {', '.join(sorted(taken))}",
            )
        path = self.inside(last)
        if path.exists() and path.read_bytes() != content:
            raise InputError(
                "another file of this name is in the folder already",
                code="unwritable-file",
                place=last,
                remedy="rename one of them",
            )
        new = not path.exists()
        write_atomic(path, content)
        try:
            check(path)
        except LoopcalError:
            if new:
                path.unlink()
            raise
        record = {"name": last, "bytes": len(content), "step": step}
        self.noted("file", f"took in {last}", record)
        return path

    def handed_in(self, step: str) -> list[str]:
        """Names of the files that were taken in at a step, the last one last."""
        last: dict[str, str] = {}
        for entry in self.log().entries:
            if entry.kind in ("file", "aside"):
                name = str(entry.record.get("name"))
                last.pop(name, None)
                last[name] = str(entry.record.get("step"))
        return [name for name, of in last.items() if of == step]

    def change(self, text: str, what: str, reason: str) -> None:
        """Write the project anew, and the change into the log."""
        before = self.text()
        write_atomic(self.project, text, anything=True)  # the log keeps the text before
        self.noted("edit", what, {"reason": reason, "before": before, "after": text})

    def remove(self, reason: str) -> None:
        """Remove the project file, and write that into the log; `undo` brings it back."""
        before = self.text()
        self.project.unlink(missing_ok=True)
        record = {"reason": reason, "before": before, "after": None}
        self.noted("edit", f"removed {self.named(self.project)}", record)

    def undo(self) -> str:
        """Take the last change of the project back, and say which. Raises InputError where there
        is none, and where the project was changed since by someone else."""
        edits = self.log().edits()
        if not edits:
            raise InputError("there is nothing to undo", code="no-data", remedy="go on")
        last = edits[-1]
        record = last.record
        # Taking back a text that was edited elsewhere since would lose that edit.
        if self.text() != record.get("after") or not isinstance(record.get("before"), str):
            raise InputError(
                "the project was changed since, outside the app",
                code="conflicting-keys",
                place=self.named(self.project),
                remedy="change it there",
            )
        write_atomic(self.project, record["before"], anything=True)
        self.noted("undo", f"undid: {last.what}", {"of": last.number})
        return last.what

    def noted(self, kind: str, what: str, record: Mapping[str, Any]) -> None:
        """Add a line to the log: on the disk before this returns. Raises InputError where it
        cannot be written."""
        at = datetime.now(UTC).isoformat(timespec="seconds")
        line = json.dumps({"at": at, "kind": kind, "what": what, **record}, ensure_ascii=True)
        path = self.inside(LOG)
        try:
            with _APPENDING, path.open("ab+") as file:
                # A run that died mid-line would otherwise spoil the next entry too.
                broken = file.tell() > 0 and not _ends_a_line(file)
                file.write(b"\n" * broken + line.encode() + b"\n")
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise unwritable(path, error) from None

    def log(self) -> Log:
        """What was done in the folder."""
        try:
            lines = self.inside(LOG).read_bytes().splitlines()
        except (FileNotFoundError, InputError):  # a link out of the folder is no log of it
            return Log(())
        entries, broken = [], []
        for number, line in enumerate(lines, 1):
            try:
                entry = json.loads(line)
                entries.append(
                    Entry(number, str(entry["at"]), str(entry["kind"]), str(entry["what"]), entry)
                )
            except (ValueError, KeyError, TypeError):
                broken.append(number)
        return Log(tuple(entries), tuple(broken))


def _ends_a_line(file: BinaryIO) -> bool:
    """Whether what a file ends with is a whole line; it can be read and appended to."""
    file.seek(-1, os.SEEK_END)
    return file.read(1) == b"\n"


def existing_folder(path: str | Path) -> Path:
    """The path of a folder. Raises InputError where it is none."""
    folder = Path(path).resolve()
    if not folder.is_dir():
        raise InputError(
            "there is no such folder", code="missing-file", place=str(path), remedy="make it first"
        )
    return folder


# One server at a time on a folder: a lock that ends with the process that holds it.

NAME = ".loopcal-app.lock"
_PLACE = 1 << 30
"""The byte that is locked on Windows, behind what others may read."""


class FolderLock:
    """Held from its making until `release`, or until the process ends in whatever way.

    Raises InputError where another process holds it, with the address it wrote, and where the
    folder cannot be written. A file system without locks lets everybody in.
    """

    def __init__(self, folder: Path, address: str) -> None:
        path = folder / NAME
        if not leads_into(path, folder):
            raise InputError(
                "leads out of the folder",
                code="unwritable-file",
                place=str(path),
                remedy="remove this link",
            )
        try:
            # Not truncated: a file that another app has locked states its address.
            self._file: BinaryIO = path.open("r+b" if path.exists() else "w+b")
        except OSError as error:
            raise unwritable(folder, error) from None
        if not _taken(self._file):
            held = self._file.read(200).decode("utf-8", "replace").strip()
            self._file.close()
            raise InputError(
                f"another app serves this folder already, at {held}",
                code="unwritable-file",
                place=str(folder),
                remedy="open that address, or end that app first",
            )
        self._file.truncate(0)
        self._file.write(address.encode())
        self._file.flush()

    def release(self) -> None:
        """Let others have the folder."""
        self._file.close()


def _taken(file: BinaryIO) -> bool:
    """Whether the lock is ours now; also where the file system has none."""
    try:
        if os.name == "nt":
            import msvcrt

            file.seek(_PLACE)
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined]
            file.seek(0)
        else:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        file.seek(0)
        return False
    except OSError:
        file.seek(0)
    return True
