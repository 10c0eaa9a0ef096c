"""Kill a command at each of its file operations: is each folder wholly old, new, or refused?

A fork of this process runs the command and ends itself just before its n-th operation on a file: an
opening for writing, a rename, link, removal, folder made, or data forced to the disk. Then the
folders are compared with those before and those of a run that was not killed, another command reads
the result, and the same command runs again, which must leave nothing of the dead one. At the 35,
24, 4 and 23 operations of `calibrate`, `update`, `record` and `history` every folder was old, new
or refused, and clean after the next run. Of two entries of a history that are added at once, one
may be there alone until then.

    python -m analyses.kills_at_file_operations
"""

from __future__ import annotations

import os
import sys
import tempfile
import warnings
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from shutil import copytree, rmtree
from typing import Any

from loopcal.cli import main as loopcal
from loopcal.files.history.folder import read_entries

EVENTS = ("open", "os.rename", "os.link", "os.remove", "os.mkdir", "os.rmdir")
WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT
PROJECT = """schema = 1
title = "killed"
[mechanism]
type = "planar-two-link"
[data]
file = "poses.csv"
pose = "pose"
[data.columns]
phi2 = { column = "phi2", unit = "rad" }
phi3 = { column = "phi3", unit = "rad" }
xP = { column = "xP", unit = "m" }
yP = { column = "yP", unit = "m" }
[noise]
"phi*" = { sd = 1, unit = "mrad" }
xPyP = { sd = 0.1, unit = "mm" }
[parameters]
l2 = { value = 800, unit = "mm" }
l3 = { value = 600, unit = "mm" }
[prior]
"*" = { sd = inf }
[fit]
method = "implicit-loop"
[simulation.ranges]
phi2 = { from = -90, to = 90, step = 60, unit = "deg" }
phi3 = { from = -90, to = 90, step = 60, unit = "deg" }
"""
Folders = dict[str, dict[str, bytes]]


def child(act: Callable[[], object], root: Path, kill_at: int | None) -> int:
    """Run in a fork, killed before the n-th operation below a folder; how many there were else."""
    read, write = os.pipe()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # forks beside threads: this one ends without them
        number = os.fork()
    if number == 0:
        try:
            done = _counting(act, root, kill_at)
            os.write(write, str(done).encode())
        finally:
            os._exit(0)
    os.close(write)
    with os.fdopen(read) as answer:
        told = answer.read()
    os.waitpid(number, 0)
    return int(told or -1)


def _counting(act: Callable[[], object], root: Path, kill_at: int | None) -> int:
    count, top, sync = 0, str(root), os.fsync

    def operation() -> None:
        nonlocal count
        count += 1
        if count == kill_at:
            os._exit(0)

    def heard(event: str, arguments: tuple[object, ...]) -> None:
        if event not in EVENTS:
            return
        path, flags = str(arguments[0]), arguments[2] if event == "open" else WRITING
        if os.path.abspath(path).startswith(top) and isinstance(flags, int) and flags & WRITING:
            operation()

    def forced(fd: Any) -> None:
        operation()
        sync(fd)

    os.fsync = forced
    sys.addaudithook(heard)
    act()
    return count


def command(words: Sequence[str], folder: Path) -> int:
    """Exit code of a command in a folder, silent."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    with open(nowhere, "w") as silent:
        out, error, before = sys.stdout, sys.stderr, Path.cwd()
        sys.stdout = sys.stderr = silent
        os.chdir(folder)
        try:
            return loopcal(list(words))
        finally:
            os.chdir(before)
            sys.stdout, sys.stderr = out, error


def content(root: Path) -> Folders:
    """Folder -> name -> bytes of the files that are not hidden; of a history how many entries."""
    found: Folders = {}
    for folder in [root, *(p for p in root.rglob("*") if p.is_dir())]:
        files = {
            p.name: p.read_bytes()
            for p in folder.iterdir()
            if p.is_file() and not p.name.startswith(".")
        }
        if folder.suffix == ".history":
            entries = read_entries(folder)
            files = {"entries": str((len(entries.whole), len(entries.skipped))).encode()}
        for name in [n for n in files if n.endswith("history.html") or n.startswith("history-")]:
            files[name] = b"whole" if files[name].rstrip()[-7:] in (b"</html>",) else b"note"
        files.pop("record.html", None)  # it has a number of its own: its seal is checked instead
        if files:
            found[str(folder.relative_to(root))] = files
    return found


def left(root: Path) -> list[str]:
    """What dead runs have left."""
    return [p.name for p in root.rglob(".*") if p.suffix in (".part", ".old")]


def prepared(root: Path) -> None:
    """A project, its calibration, a history, an update and a record."""
    root.mkdir()
    (root / "project.toml").write_text(PROJECT)
    for words in (
        "simulate project.toml --out poses.csv --seed 1",
        "calibrate project.toml --history arm.history",
        "simulate project.toml --out later.csv --seed 3",
        "update project-result later.csv",
        "record project-result",
        "history arm.history",
    ):
        assert command(words.split(), root) == 0, words


COMMANDS = {
    "calibrate": "calibrate project.toml --method least-squares --history arm.history",
    "update": "update project-result later.csv --same-place",
    "record": "record project-result",
    "history": "history arm.history --add project-result --event belt",
}


def trial(words: str, start: Path, root: Path) -> Counter[str]:
    """How often each outcome came, over all operations of a command."""

    def act() -> None:
        command(words.split(), root)

    def again() -> None:
        rmtree(root, ignore_errors=True)
        copytree(start, root)

    again()
    old = content(root)
    operations = child(act, root, None)
    new, outcomes = content(root), Counter[str]()
    for kill_at in range(1, operations + 1):
        again()
        child(act, root, kill_at)
        outcomes[outcome(words, root, old, new)] += 1
        child(act, root, None)
        if left(root):
            outcomes["LEFT BEHIND"] += 1
        if words.split()[0] != "history" and content(root) != new:
            history = "arm.history"  # a second entry where the first run had got so far
            if {**content(root), history: {}} != {**new, history: {}}:
                outcomes["NOT NEW AFTER THE NEXT RUN"] += 1
    outcomes["operations"] = operations
    return outcomes


def outcome(words: str, root: Path, old: Folders, new: Folders) -> str:
    """What a killed run has left, as other commands see it."""
    found = content(root)
    for name in {*old, *new, *found}:
        its = found.get(name, {})
        if its in (old.get(name, {}), new.get(name, {})):
            continue
        if name.endswith(".history") and its["entries"].endswith(b", 0)"):
            return "entries whole, the rest comes with the next run"
        if name == "." or name.endswith("deployed"):
            return f"MIXED in {name}"
        read = ["predict", name, "poses.csv", "--out", "prediction.csv"]
        if command(read, root) != 3:
            return f"MIXED in {name}, and read"
        return "refused"
    record = root / "project-result" / "record.html"
    if words.startswith("record") and command(["record", str(record), "--verify"], root) != 0:
        return "RECORD BROKEN"
    kinds = {name: "old" if found.get(name) == old.get(name) else "new" for name in new}
    return "old" if "new" not in kinds.values() else "new"


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        start = Path(folder).resolve() / "start"
        prepared(start)
        for name, words in COMMANDS.items():
            print(f"{name:10} {dict(trial(words, start, start.with_name('killed')))}")


if __name__ == "__main__":
    main()
