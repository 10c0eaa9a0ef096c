"""`loopcal init`: what it prints, writes and asks."""

from __future__ import annotations

import io
import sys
from pathlib import Path

import numpy as np
import pytest

from loopcal.cli.asking import ask_on_terminal
from loopcal.errors import InputError
from tests.command_line import run_here
from tests.reference import dh_arm


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    joints = dh_arm.poses(40)
    points = 1e3 * dh_arm.seen(joints)[:, :3, 3]
    head = ",".join([*(f"J{i} [rad]" for i in range(1, 7)), "x", "y", "z"])
    rows = [",".join(f"{v:.6f}" for v in row) for row in np.hstack([joints, points])]
    (tmp_path / "poses.csv").write_text("\n".join([head, *rows]) + "\n", "utf-8")
    (tmp_path / "dh.csv").write_text(dh_arm.dh_table(), "utf-8")
    return tmp_path


def test_one_command_leads_from_two_files_to_a_report(folder: Path) -> None:
    done = run_here("init", "poses.csv", "--dh", "dh.csv", "--run", cwd=folder)
    assert done.returncode in (0, 4), done.stderr
    assert "written: calibration/project.toml" in done.stdout
    assert "next:" not in done.stdout
    assert done.stdout.count("\n") <= 44
    assert (folder / "calibration/project-result/report.html").exists()
    assert "converged" in done.stdout
    assert "all: --full" in done.stdout
    command = "init", "poses.csv", "--dh", "dh.csv", "--force", "--full"
    every = run_here(*command, "--run", cwd=folder).stdout
    assert "not shown" not in every
    assert "observability O1" in every
    assert "add --run" in run_here(*command, cwd=folder).stderr
    assert run_here("init", "poses.csv", "--dh", "dh.csv", cwd=folder).returncode == 0
    with (folder / "calibration" / "project.toml").open("a", encoding="utf-8") as file:
        file.write("# mine\n")
    for typed, meant in (
        ("init poses.csv --dh dh.csv", "init poses.csv --dh dh.csv --force"),
        ("init pose.csv --dh dh.csv --out new", "init poses.csv --dh dh.csv --out new"),
        ("calibrate calibration", "calibrate calibration/project.toml"),
        ("verify calibration poses.csv", "verify calibration/project-result poses.csv"),
        ("verify poses.csv dh.csv", "verify calibration/project-result poses.csv dh.csv"),
        (
            "calibrate calibration/project.toml --method least-square",
            "calibrate calibration/project.toml --method least-squares",
        ),
    ):
        refusal = run_here(*typed.split(), cwd=folder).stderr
        assert refusal.endswith(f"Next command:\n    loopcal {meant}\n"), refusal


def test_a_robot_must_be_named(folder: Path) -> None:
    done = run_here("init", "poses.csv", cwd=folder)
    assert done.returncode == 2
    assert "--urdf" in done.stderr


class _Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_a_question_is_asked_on_a_terminal_until_it_is_answered(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert ask_on_terminal() is None or not sys.stdin.isatty()
    monkeypatch.setattr(sys, "stdin", _Terminal("seven\n3\n2\n"))
    monkeypatch.setattr(sys, "stderr", _Terminal())
    ask = ask_on_terminal()
    assert ask is not None
    assert ask("Which?", ["deg", "gon"]) == 1
    monkeypatch.setattr(sys, "stdin", _Terminal(""))
    with pytest.raises(InputError):
        ask("Which?", ["deg", "gon"])


def test_a_folder_is_read_with_its_robot_but_without_texts_of_programs(folder: Path) -> None:
    (folder / "dh.csv").unlink()
    (folder / "err.txt").write_text("loopcal: fitted; judging\n", "utf-8")
    (folder / "arm.urdf").write_text("<robot/>", "utf-8")
    done = run_here("init", ".", cwd=folder)
    assert "arm.urdf" in done.stderr  # no robot yet, but it was taken
    assert "err.txt" not in done.stderr
