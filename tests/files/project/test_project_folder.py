"""A project's folder: what is handed in, what is written down, what is taken back."""

from __future__ import annotations

from pathlib import Path

import pytest

from loopcal.companions.app.project_folder import LOG, ProjectFolder
from loopcal.errors import InputError


def test_a_change_can_be_taken_back_to_the_last_byte(tmp_path: Path) -> None:
    folder = ProjectFolder(tmp_path)
    before = "# mine\nschema = 1\n[mechanism]\ntype='x'  # odd  spaces\n"
    folder.project.write_text(before)
    folder.change("[mechanism]\n", "changed", "because")
    folder.change("[mechanism]\n#2\n", "changed again", "")
    assert folder.undo() == "changed again"
    assert folder.undo() == "changed"
    assert folder.project.read_text() == before
    with pytest.raises(InputError):
        folder.undo()
    assert [e.kind for e in folder.log().entries] == ["edit", "edit", "undo", "undo"]
    assert folder.log().entries[0].record["reason"] == "because"


def test_a_change_made_elsewhere_is_not_undone(tmp_path: Path) -> None:
    folder = ProjectFolder(tmp_path)
    folder.project.write_text("a")
    folder.change("b", "changed", "")
    folder.project.write_text("by hand")
    with pytest.raises(InputError):
        folder.undo()
    assert folder.project.read_text() == "by hand"


def test_a_broken_line_of_the_log_is_named_and_the_next_one_is_whole(tmp_path: Path) -> None:
    folder = ProjectFolder(tmp_path)
    folder.noted("begun", "one", {"command": "loopcal check"})
    path = tmp_path / LOG
    path.write_bytes(path.read_bytes() + b'{"at": "2026-01-01T00:00')  # killed while it wrote
    folder.noted("ended", "two", {"code": 0})
    log = folder.log()
    assert [e.what for e in log.entries] == ["one", "two"]
    assert log.broken == (2,)


def test_a_run_that_did_not_end_is_known(tmp_path: Path) -> None:
    folder = ProjectFolder(tmp_path)
    assert folder.log().unfinished() is None
    folder.noted("begun", "Calibrate", {"command": "loopcal calibrate project.toml"})
    unfinished = folder.log().unfinished()
    assert unfinished is not None
    assert unfinished.what == "Calibrate"
    folder.noted("ended", "Calibrate", {"code": 0})
    assert folder.log().unfinished() is None


@pytest.mark.parametrize("name", ["../x.csv", "/etc/passwd", "a/../../x", "..", "x\0y"])
def test_nothing_outside_the_folder_is_reached(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError):
        ProjectFolder(tmp_path).inside(name)


def test_a_link_out_of_the_folder_is_not_followed(tmp_path: Path) -> None:
    inside = tmp_path / "in"
    inside.mkdir()
    (tmp_path / "secret").write_text("x")
    (inside / "link").symlink_to(tmp_path / "secret")
    with pytest.raises(InputError):
        ProjectFolder(inside).inside("link")


def test_what_is_handed_in_keeps_its_last_name_and_overwrites_nothing(tmp_path: Path) -> None:
    folder = ProjectFolder(tmp_path)
    assert folder.take("C:\\data\\..\\run 1.csv", b"a").name == "run 1.csv"
    assert folder.take("run 1.csv", b"a").name == "run 1.csv"
    with pytest.raises(InputError):
        folder.take("run 1.csv", b"b")
    for name in ("", "..", ".hidden", "a\nb", "x" * 300):
        with pytest.raises(InputError):
            folder.take(name, b"a")
