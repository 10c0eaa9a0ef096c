"""The app reads, lists, offers and writes nothing outside its folder, and nothing hidden."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

from loopcal.companions.app.project_folder import LOG, NAME, FolderLock, ProjectFolder
from loopcal.companions.app.session import Session
from loopcal.companions.robot.programs.coordinates import JointAxes
from loopcal.companions.robot.programs.registry import BY_ENDING as PROGRAMS
from loopcal.companions.robot.programs.registry import read_program
from loopcal.errors import InputError
from loopcal.files.atomic import write_atomic
from loopcal.files.outputs import INSIDE
from tests.app.plain_command import command
from tests.command_line import run_here

SECRET = "root-of-all"
TAKEN: tuple[str, ...] = (
    "a.csv",
    "a.TSV",
    "a.txt",
    "a.dat",
    "a.xlsx",
    "a.parquet",
    "a.mat",
    "a.urdf",
    "a.xml",
)
TAKEN += ("a.toml", "a.mod", "a.src", "a.ls", "a.jbi", "a.script", "a.conf", "a.yaml")
REFUSED: tuple[str, ...] = (
    "numpy.py",
    "x.csv.py",
    "json.pyc",
    "a.so",
    "a.pth",
    "a.sh",
    "a.exe",
    "py",
    "Makefile",
)
REFUSED += ("a.ipynb", "a.html", "a.js", "a.svg", "a.pyw", "a.csv.", ".env.csv")


@pytest.fixture
def led_out(hostile: Path, tmp_path: Path) -> Path:
    """A folder with a result, and links that lead out of it."""
    outside, folder = tmp_path / "outside", tmp_path / "folder"
    outside.mkdir()
    (outside / "secret.csv").write_text(f"{SECRET}\n1\n")
    (outside / "project.toml").write_text(f'"{SECRET}" = 1\n[mechanism]\n')
    shutil.copytree(hostile, folder)
    (folder / "link.csv").symlink_to(outside / "secret.csv")
    (folder / "relative.csv").symlink_to("../outside/secret.csv")
    (folder / "again.csv").symlink_to("link.csv")
    (folder / "gone.csv").symlink_to(outside / "gone.csv")
    (folder / "data").symlink_to(outside)
    (folder / "project-other").symlink_to(outside)
    (outside / "result.json").write_text(SECRET)
    (folder / ".hidden.csv").write_text(SECRET)
    (folder / "project-result" / "link.csv").symlink_to(outside / "secret.csv")
    (folder / "inner.csv").symlink_to("project.toml")
    return folder


@pytest.fixture
def served_out(led_out: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The same, as what the app starts sees it; a session would keep the variable."""
    monkeypatch.setenv(INSIDE, str(led_out))
    return led_out


def test_what_leaves_the_folder_or_is_hidden_is_neither_listed_nor_served(led_out: Path) -> None:
    folder = ProjectFolder(led_out)
    names = {file.name for file in folder.listed()}
    assert {"project.toml", "inner.csv", "project-result/result.json"} <= names
    bad = ["link.csv", "relative.csv", "again.csv", "gone.csv", "data/secret.csv", ".hidden.csv"]
    bad += ["project-other/result.json", "project-result/link.csv", LOG.replace("loop", ".loop")]
    bad += ["../outside/secret.csv", "project-result/../../outside/secret.csv", NAME]
    bad += [str(led_out.parent / "outside" / "secret.csv"), "data", ""]
    for name in bad:
        assert name not in names
        with pytest.raises(InputError) as caught:
            folder.file(name)
        assert SECRET not in str(caught.value)
    for name in bad[:-2]:
        if name not in (".hidden.csv", NAME):
            assert folder.content(name) is None, name
    assert "link.csv" not in folder.inside_of("project-result")


@pytest.mark.parametrize(
    "name", ["link.csv", "again.csv", "data/secret.csv", "../outside/secret.csv"]
)
@pytest.mark.parametrize("line", ["noise {}", "verify project-result {}", "init {} --out new"])
def test_no_command_of_the_app_reads_what_leaves_the_folder(
    served_out: Path, name: str, line: str
) -> None:
    done = run_here(*line.format(name).split(), cwd=served_out)
    assert done.returncode == 3, done.stdout
    assert "leads out of the folder" in done.stderr
    assert SECRET not in done.stdout + done.stderr


@pytest.mark.parametrize("ending", ["toml", "json", "urdf", "xlsx", "parquet", "mat"])
def test_no_reader_reads_what_leaves_the_folder(served_out: Path, ending: str) -> None:
    link = served_out / f"file.{ending}"
    link.symlink_to(served_out.parent / "outside" / "secret.csv")
    lines = {"toml": "check {}", "json": "report {}", "urdf": "init own.csv --urdf {}"}
    (served_out / "own.csv").write_text("q1,x,y,z\n1,2,3,4\n")
    done = run_here(*lines.get(ending, "noise {}").format(link.name).split(), cwd=served_out)
    assert done.returncode == 3, done.stdout
    assert "leads out of the folder" in done.stderr
    assert SECRET not in done.stdout + done.stderr


@pytest.mark.parametrize("ending", [".mod", ".src", ".ls", ".jbi", ".script", ".csv"])
def test_no_program_is_read_that_leaves_the_folder(served_out: Path, ending: str) -> None:
    link = served_out / f"program{ending}"
    link.symlink_to(served_out.parent / "outside" / "secret.csv")
    with pytest.raises(InputError, match="leads out of the folder"):
        read_program(link, JointAxes({}))


def test_nothing_is_written_through_a_link_out_of_the_folder(served_out: Path) -> None:
    outside = served_out.parent / "outside"
    before = {path.name: path.read_bytes() for path in outside.iterdir()}
    for name in ("link.csv", "data/new.csv", "gone.csv"):
        with pytest.raises(InputError, match="leads out of the folder"):
            write_atomic(served_out / name, "x")
    for name in (LOG, NAME):
        (served_out / name).unlink(missing_ok=True)
        (served_out / name).symlink_to(outside / "secret.csv")
    with pytest.raises(InputError):
        ProjectFolder(served_out).noted("note", "x", {})
    assert ProjectFolder(served_out).log().entries == ()
    with pytest.raises(InputError, match="out of the folder"):
        FolderLock(served_out, "http://x")
    assert {path.name: path.read_bytes() for path in outside.iterdir()} == before


@pytest.mark.parametrize("kind", ["a link out", "no text"])
def test_a_project_file_that_cannot_be_read_is_an_objection_not_a_fault(
    led_out: Path, kind: str
) -> None:
    project = led_out / "project.toml"
    project.unlink()
    if kind == "a link out":
        project.symlink_to(led_out.parent / "outside" / "project.toml")
    else:
        project.write_bytes(b"\xff\xfe\xfd")
    session = Session(led_out, command)
    assert session.project() is None
    assert session.objection()
    assert SECRET not in str(session.objection())
    assert session.state().objection == session.objection()


def test_a_result_that_is_a_link_out_is_none(led_out: Path) -> None:
    result, outside = led_out / "project-result", led_out.parent / "outside" / "result"
    result.rename(outside)
    result.symlink_to(outside)
    session = Session(led_out, command)
    assert session.source() is None
    assert session.deployed() == {}


def test_files_of_known_endings_are_taken_in_and_no_others(tmp_path: Path) -> None:
    folder = ProjectFolder(tmp_path, frozenset(PROGRAMS))
    for name in TAKEN:
        assert folder.take(name, b"1").read_bytes() == b"1"
    before = sorted(os.listdir(tmp_path))
    for name in REFUSED:
        with pytest.raises(InputError):
            folder.take(name, b"1")
    assert sorted(os.listdir(tmp_path)) == before
