"""No command destroys a file; exit code 3 leaves all as it was; `analyses/outputs_onto_inputs.py`
tries all outputs on all files."""

from __future__ import annotations

from pathlib import Path
from shutil import copytree

import pytest

from analyses import outputs_onto_inputs
from analyses.outputs_onto_inputs import COMMANDS, FOLDERS, snapshot
from loopcal.cli import registry
from tests.command_line import run_here


@pytest.fixture(scope="module")
def start(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("outputs") / "start"
    outputs_onto_inputs.prepared(root)
    return root


@pytest.fixture
def root(start: Path, tmp_path: Path) -> Path:
    copytree(start, tmp_path / "root")
    return tmp_path / "root"


ONTO = {
    "predict": ("measured.csv", "poses.csv", "project-result/residuals.csv"),
    "simulate": ("measured.csv", "project-result/residuals.csv"),
    "history": ("project-result/result.json", "project-result/record.html", "history-entry"),
    "record": ("project-result/mechanism.toml", "project-result/report.html", "notes.html"),
    "verify": ("later.csv", "project-result/record.html", "project-result/result.json"),
    "performance": ("pairs.csv", "project-result/report.html"),
    "report": ("poses.csv", "project-result/record.html", "project.toml"),
}


@pytest.mark.parametrize("name", ONTO)
def test_no_output_replaces_an_input_or_another_result(name: str, root: Path) -> None:
    before = snapshot(root)
    for file in ONTO[name]:
        target = root / file
        if file == "history-entry":
            target = next((root / "arm.history").glob("*.json"))
        words = [*COMMANDS[name].split(), "--out", str(target)]
        done = run_here(*words, cwd=root)
        assert (done.returncode, snapshot(root)) == (3, before), done.stderr
        assert str(target) in done.stderr
        assert "--force" in done.stderr
    done = run_here(*words, "--force", cwd=root)
    assert done.returncode == 0, done.stderr
    assert target.with_name(f"{target.name}.bak").read_bytes() == before[target]
    assert target.read_bytes() != before[target]


@pytest.mark.parametrize("name", ["calibrate", "update", "plan", "export"])
def test_a_folder_with_a_file_of_others_stays_as_it_was(name: str, root: Path) -> None:
    words, files = FOLDERS[name]
    (root / "out").mkdir()
    mine = root / "out" / files[-1]
    mine.write_text("mine")
    before = snapshot(root)
    done = run_here(*words.split(), "--out", "out", cwd=root)
    assert (done.returncode, snapshot(root)) == (3, before), done.stderr
    assert run_here(*words.split(), "--out", "out", "--force", cwd=root).returncode == 0
    assert mine.with_name(f"{mine.name}.bak").read_text() == "mine"
    assert run_here(*words.split(), "--out", "out", cwd=root).returncode == 0  # its own now


REFUSED = {
    "a table for a history": "calibrate project.toml --history poses.csv",
    "a device for a history": "calibrate project.toml --history /dev/null",
    "an updated history": "update project-result later.csv --history project.toml --out new",
    "a verified history": "verify project-result later.csv --history poses.csv --out page.html",
    "a history below a file": "calibrate project.toml --out new --history poses.csv/arm.history",
    "a page on a full disk": "history new.history --add project-result --out /dev/full",
    "a page in no folder": "history arm.history --event belt --out poses.csv/page.html",
    "the second of two results": "history arm.history --add project-result --add nothing",
    "a fleet with a page of others": "fleet project-result one two --out notes.toml",
    "a program beside a plan": "plan project.toml --poses 5 --out new --program p.script",
}


@pytest.mark.parametrize("words", REFUSED.values(), ids=REFUSED)
def test_exit_code_3_leaves_everything_as_it_was(words: str, root: Path) -> None:
    before = snapshot(root)
    done = run_here(*words.split(), cwd=root)
    assert done.returncode == 3, done.stderr
    assert snapshot(root) == before
    assert not [p for p in root.rglob("*") if p.is_dir() and p not in _folders(before)]


def _folders(files: dict[Path, bytes]) -> set[Path]:
    return {parent for path in files for parent in path.parents}


def test_a_full_disk_is_named_by_history(root: Path) -> None:
    done = run_here("history", "arm.history", "--event", "belt", "--out", "/dev/full", cwd=root)
    assert "the disk is full" in done.stderr


def test_every_command_with_an_output_takes_force_and_refuses_an_empty_name() -> None:
    with_out = [n for n in registry.COMMANDS if "--out" in run_here(n, "--help").stdout]
    assert len(with_out) >= 15
    for name in with_out:
        assert "--force" in run_here(name, "--help").stdout, name
        done = run_here(name, "--out", "")
        assert done.returncode == 2, name
        assert "--out" in done.stderr
    for name in ("calibrate", "update", "verify"):
        assert run_here(name, "a", *["b"] * (name != "calibrate"), "--history", "").returncode == 2
