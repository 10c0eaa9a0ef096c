"""Write every output of every command onto every input of it, and onto files of others.

Each command runs in a copy of one folder, its output named as one of the files there: by its name,
through a symbolic link, a hard link, and another relative path. Afterwards every file that was
there must have its content, under its name or as a backup; what `--force` replaces is a backup.

    python -m analyses.outputs_onto_inputs [--commands predict,simulate]
"""

from __future__ import annotations

import argparse
import os
import tempfile
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from shutil import copytree, rmtree

from analyses.kills_at_file_operations import PROJECT, command

RESULT = ("result.json", "mechanism.toml", "residuals.csv", "report.html", "record.html")
FOREIGN = ("notes.txt", "notes.csv", "notes.html", "notes.json", "notes.toml")
DATA = ("project.toml", "poses.csv", "measured.csv", "later.csv")
FILES = (
    *(f"project-result/{name}" for name in RESULT),
    *("history-entry", "pairs.csv", "p.script", "prediction.csv"),
    *("targets.csv", *(f"six/project-result/{name}" for name in RESULT[:2])),
    *DATA,
    *FOREIGN,
)
EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
STUDY = """schema = 1
title = "two draws"
draws = 2
seed = 4
[mechanism]
type = "planar-two-link"
[parameters]
l2 = { value = 802, unit = "mm" }
l3 = { value = 597, unit = "mm" }
[prior]
"*" = { sd = inf }
[simulation.ranges]
phi2 = { from = 0, to = 90, step = 30, unit = "deg" }
phi3 = { from = 0, to = 90, step = 30, unit = "deg" }
[noise]
xPyP = { sd = 0.1, unit = "mm" }
"phi*" = { sd = 1, unit = "mrad" }
[[methods]]
method = "least-squares"
[[scenarios]]
name = "one"
"""
COMMANDS = {
    "predict": "predict project-result measured.csv",
    "simulate": "simulate project.toml --seed 9",
    "history": "history arm.history",
    "report": "report project-result",
    "record": "record project-result",
    "verify": "verify project-result later.csv",
    "performance": "performance pairs.csv",
    "fleet": "fleet project-result one two --no-report",
    "correct": "correct six/project-result targets.csv",
}
FOLDERS = {
    "calibrate": ("calibrate project.toml", RESULT[:4]),
    "update": ("update project-result later.csv", RESULT[:4]),
    "plan": ("plan project.toml --poses 5", ("plan.csv", "plan.json", "plan.html")),
    "export": ("export project-result --to json", ("geometry.json", "parameters.csv")),
    "study": ("study study.toml --workers 1", ("draws.parquet", "summary.json", "study.html")),
    "init": ("init slip/poses.csv --urdf slip/arm.urdf", ("project.toml",)),
}  # fmt: skip
"""Commands that write a folder, and the names of their files in it."""


def prepared(root: Path) -> None:
    """A project with readings, results, a history, tables, and files of others."""
    root.mkdir()
    (root / "project.toml").write_text(PROJECT)
    for words in (
        "simulate project.toml --out poses.csv --seed 1",
        "simulate project.toml --out later.csv --seed 3",
        "calibrate project.toml --history arm.history --no-report",
        "report project-result",
        "record project-result",
        "history arm.history --event belt",
        "predict project-result later.csv --out prediction.csv",
    ):
        assert command(words.split(), root) == 0, words
    for number, other in enumerate(("one", "two")):  # machines of one type, of their own readings
        (root / f"{other}.toml").write_text(PROJECT.replace("poses.csv", f"{other}.csv"))
        for words in (
            f"simulate {other}.toml --out {other}.csv --seed {5 + number}",
            f"calibrate {other}.toml --out {other} --no-report",
        ):
            assert command(words.split(), root) == 0, words
    copytree(EXAMPLES / "slipped_reflector", root / "slip")
    copytree(EXAMPLES / "six_axis", root / "six")
    words = "calibrate six/project.toml --no-report --method least-squares --folds 3"
    assert command(words.split(), root) in (0, 4), words
    rows = (root / "six" / "poses.csv").read_text().splitlines()[:5]
    (root / "targets.csv").write_text("\n".join([*rows, ""]))
    (root / "study.toml").write_text(STUDY)
    (root / "measured.csv").write_bytes((root / "later.csv").read_bytes() + b"\n")
    rows = [f"P1,{i},{0.01 * i},0,0,1,0,0" for i in range(5)]
    head = "pose,cycle,x [mm],y [mm],z [mm],commanded x [mm],commanded y [mm],commanded z [mm]"
    (root / "pairs.csv").write_text("\n".join([head, *rows, ""]))
    (root / "p.script").write_text("movej([0.1,0.2,0.3,0.4,0.5,0.6])\n")
    for name in FOREIGN:
        (root / name).write_text(f"mine, {name}\n")


def kept(before: Mapping[Path, bytes], root: Path) -> list[str]:
    """Files of before whose content is nowhere any more."""
    there = {p.read_bytes() for p in root.rglob("*") if p.is_file()}
    return [str(path) for path, content in before.items() if content not in there]


def snapshot(root: Path) -> dict[Path, bytes]:
    """Path -> content of all files."""
    return {p: p.read_bytes() for p in root.rglob("*") if p.is_file()}


def names(root: Path, target: Path) -> Iterable[str]:
    """The target by other names; links are made."""
    yield str(target.relative_to(root))
    yield f"project-result/../{target.relative_to(root)}"
    link, hard = root / f"link{target.suffix}", root / f"hard{target.suffix}"
    link.symlink_to(target)
    yield link.name
    os.link(target, hard)
    yield hard.name


def trial(name: str, start: Path, root: Path, *, force: bool) -> Counter[str]:
    """Outcomes of one command with its output on every file."""
    outcomes = Counter[str]()
    copytree(start, root)
    for file in FILES:
        target = root / file
        if file == "history-entry":
            target = next((root / "arm.history").glob("*.json"))
        for other in names(root, target):
            outcomes += _tried([*COMMANDS[name].split(), "--out", other], root, force)
            if force:
                rmtree(root)
                copytree(start, root)
                break  # what force replaces is in the backup, whichever name led there
        for made in (root / f"link{target.suffix}", root / f"hard{target.suffix}"):
            made.unlink(missing_ok=True)
    rmtree(root)
    return outcomes


def folder_trial(name: str, start: Path, root: Path, *, force: bool) -> Counter[str]:
    """Outcomes of one command that writes a folder in which files of others have its names."""
    words, files = FOLDERS[name]
    outcomes = Counter[str]()
    for file in files:
        for link in (False, True):
            copytree(start, root)
            (root / "out").mkdir()
            if link:
                (root / "out" / file).symlink_to(root / "notes.txt")
            else:
                (root / "out" / file).write_text("mine, and nowhere else\n")
            outcomes += _tried([*words.split(), "--out", "out"], root, force)
            rmtree(root)
    return outcomes


def _tried(words: list[str], root: Path, force: bool) -> Counter[str]:
    before = snapshot(root)
    code = command([*words, "--force"] if force else words, root)
    after = snapshot(root)
    found = Counter({f"exit {code}": 1})
    changed = [path for path in before if after.get(path) != before[path]]
    gone = [path for path in kept(before, root) if not _same_kind(Path(path), words)]
    if gone:
        found[f"LOST {sorted({Path(path).name for path in gone})}"] += 1
    if code == 3 and after != before:
        found[f"EXIT 3, AND CHANGED {sorted({p.name for p in changed})}"] += 1
    return found


def _same_kind(path: Path, words: list[str]) -> bool:
    """Whether a file that is replaced was written by this same command."""
    own = {
        "report": ("report.html",),
        "record": ("record.html",),
        "simulate": ("poses.csv", "later.csv", "poses.truth.json", "later.truth.json"),
        "predict": ("prediction.csv",),
    }
    notes = path.parent.name == "deployed"
    return notes or path.name in own.get(words[0], ()) or path.name.startswith(("link", "hard"))


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--commands", default=",".join([*COMMANDS, *FOLDERS]))
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        start = Path(folder).resolve() / "start"
        prepared(start)
        for name in given.commands.split(","):
            tried = trial if name in COMMANDS else folder_trial
            for force in (False, True):
                done = tried(name, start, start.with_name("tried"), force=force)
                print(f"{name:11} {'--force' if force else '':7} {dict(done)}", flush=True)


if __name__ == "__main__":
    main()
