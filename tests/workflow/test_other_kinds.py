"""A file of another kind in place of a project: every command says what it is and what takes it."""

from __future__ import annotations

from pathlib import Path

import pytest

from loopcal.files.project.project_file import read_project
from tests.command_line import run_here as run

PLACES = {
    "readings.csv": (b"pose,q1,x\n1,0.1,0.2\n", "loopcal init readings.csv"),
    "READINGS.TSV": (b"pose\tq1\n1\t2\n", "loopcal init READINGS.TSV"),
    "empty.csv": (b"", "loopcal init empty.csv"),
    "many readings.xlsx": (b"PK\x03\x04 and more", "loopcal init 'many readings.xlsx'"),
    "readings.parquet": (b"PAR1\x15", "loopcal init readings.parquet"),
    "readings.mat": (b"MATLAB 5.0 MAT-file", "loopcal init readings.mat"),
    "robot.urdf": (b"<robot/>", "loopcal init READINGS --urdf robot.urdf"),
    "robot.urdf.xacro": (b"<robot/>", "--urdf robot.urdf.xacro"),
    "out/result.json": (b"{}", "verify"),
    "out/other.json": (b"{}", "verify"),
    "out": (None, "verify"),
    "project": (None, "project/project.toml"),
    "bare": (None, "project file in it"),
    "mechanism.toml": (b'schema = 1\ntype = "serial"\n', 'file = "mechanism.toml"'),
    "readings": (b"pose,q1,x\n1,0.1,0.2\n", "loopcal init"),
}
COMMANDS = (
    ("calibrate",),
    ("check",),
    ("plan",),
    ("simulate", "--out", "made.csv"),
    ("study",),
    ("calibrate", "--compare"),
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    here = tmp_path_factory.mktemp("kinds")
    for name in ("out", "project", "bare"):
        (here / name).mkdir()
    (here / "project" / "project.toml").write_text("schema = 1\n")
    for name, (content, _) in PLACES.items():
        if content is not None:
            (here / name).write_bytes(content)
    return here


@pytest.mark.parametrize("name", PLACES)
def test_a_file_of_another_kind_is_named_with_what_takes_it(name: str, folder: Path) -> None:
    commands = [c for c in COMMANDS if c != ("study",) or name != "mechanism.toml"]
    for command in commands:
        done = run(*command, name, cwd=folder)
        words = " ".join(done.stderr.split())
        assert done.returncode == 3, (command, words)
        assert PLACES[name][1] in words, (command, words)
        assert name == "readings" or "TOML" not in words


def test_a_project_of_any_other_name_is_read_as_one(folder: Path) -> None:
    other = folder / "arm.project"
    other.write_text('schema = 1\n[mechanism]\ntype = "planar-two-link"\n')
    assert read_project(other).mechanism.name
