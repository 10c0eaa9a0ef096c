"""A small project with readings and an earlier result, and the command run in this process."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from loopcal.cli import main

PROJECT = """\
schema = 1
title = "A planar arm"

[mechanism]
type = "planar-two-link"

[data]
file = "readings.csv"
pose = "pose"
[data.columns]
xP = { column = "x", unit = "mm" }
yP = { column = "y", unit = "mm" }
phi2 = { column = "a", unit = "deg" }
phi3 = { column = "b", unit = "deg" }

[noise]
"?P" = { sd = 0.1, unit = "mm" }
"phi?" = { sd = 1, unit = "mrad" }

[prior]
"*" = { sd = inf }

[fit]
method = "implicit-loop"

[simulation.ranges]
phi2 = { from = -90, to = 90, step = 30, unit = "deg" }
phi3 = { from = 10, to = 150, step = 28, unit = "deg" }
[simulation.truth]
l2 = { value = 803, unit = "mm" }
"""


@dataclass(frozen=True)
class Done:
    """What a command left: exit code, stdout, stderr."""

    code: int
    out: str
    err: str


Run = Callable[..., Done]


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    """Runs `loopcal ARGUMENTS` in this process."""

    def command(*arguments: str | Path) -> Done:
        capsys.readouterr()
        code = main([str(a) for a in arguments])
        told = capsys.readouterr()
        return Done(code, told.out, told.err)

    return command


@pytest.fixture(scope="session")
def calibrated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with project.toml, readings.csv, their truth, and project-result."""
    folder = tmp_path_factory.mktemp("calibrated")
    (folder / "project.toml").write_text(PROJECT)
    project, readings = str(folder / "project.toml"), str(folder / "readings.csv")
    assert main(["simulate", project, "--out", readings, "--seed", "1"]) == 0
    assert main(["calibrate", project]) == 0
    return folder


@pytest.fixture
def folder(calibrated: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of that folder, which is also the current one."""
    copy = tmp_path / "project"
    shutil.copytree(calibrated, copy)
    monkeypatch.chdir(copy)
    return copy


def contents(folder: Path) -> dict[str, bytes]:
    """Every file below a folder, byte for byte."""
    files = [path for path in folder.rglob("*") if path.is_file()]
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}
