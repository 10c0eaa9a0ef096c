"""Results are written whole or not at all, and what was there before stays as it was."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from loopcal.errors import InputError
from loopcal.files.atomic import write_all, write_atomic, write_files
from tests.refusals import refused

MARKS = {
    "result.json": '{"schema": 2, "loopcal": "0", "µ": "%s"}',
    "residuals.csv": "pose,residual %s before [m]\n1,0\n",
    "mechanism.toml": "# %s: a mechanism file of loopcal, made by it.\n",
}
"""How `files.outputs` knows that loopcal wrote a file, so that it may be replaced."""
NEW: dict[str, str | bytes] = {name: mark % "new" for name, mark in MARKS.items()}
NEW["residuals.csv"] = NEW["residuals.csv"].encode()  # type: ignore[union-attr]


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def as_bytes(files: dict) -> dict[str, bytes]:
    return {n: d.encode() if isinstance(d, str) else d for n, d in files.items()}


@pytest.fixture
def folder(tmp_path):
    """A folder with two results of an earlier run."""
    folder = tmp_path / "results"
    folder.mkdir()
    for name in ("result.json", "mechanism.toml"):
        (folder / name).write_text(MARKS[name] % "earlier")
    return folder


def test_all_files_are_there_in_full_and_nothing_else(folder):
    write_files(folder, NEW)
    assert contents(folder) == as_bytes(NEW)


def test_folders_are_made_as_needed(tmp_path):
    write_files(tmp_path / "a" / "b", NEW)
    write_atomic(tmp_path / "c" / "one.txt", "text")
    assert contents(tmp_path / "a" / "b") == as_bytes(NEW)
    assert (tmp_path / "c" / "one.txt").read_text() == "text"


def test_files_have_the_rights_of_any_new_file(tmp_path):
    write_atomic(tmp_path / "ours", "x")
    (tmp_path / "theirs").write_text("x")
    assert (tmp_path / "ours").stat().st_mode == (tmp_path / "theirs").stat().st_mode


def test_a_link_stays_a_link_and_a_device_a_device(folder):
    link = folder / "latest.json"
    link.symlink_to(folder / "result.json")
    write_atomic(link, NEW["result.json"])
    assert link.is_symlink()
    assert (folder / "result.json").read_text() == NEW["result.json"]
    write_atomic(os.devnull, "gone")
    assert not Path(os.devnull).is_file()


FAILURES = {
    "a full disk": (errno.ENOSPC, ["disk is full", "free some space"]),
    "a quota": (errno.EDQUOT, ["disk is full"]),
    "a read-only disk": (errno.EROFS, ["no permission", "choose a folder"]),
    "no permission": (errno.EACCES, ["no permission"]),
    "a broken disk": (errno.EIO, [os.strerror(errno.EIO)]),
}


@pytest.mark.parametrize("call", ["fsync", "write", "replace"])
@pytest.mark.parametrize(("code", "parts"), FAILURES.values(), ids=FAILURES)
def test_a_failure_at_the_second_file_leaves_all_as_it_was(folder, monkeypatch, call, code, parts):
    before = contents(folder)
    calls = []
    error = OSError(code, os.strerror(code))
    real_sync, real_open, real_replace = os.fsync, Path.open, Path.replace

    def second(*_: object) -> None:
        calls.append(1)
        if len(calls) == 2:
            raise error

    def sync(handle: int) -> None:
        second()
        real_sync(handle)

    def opened(path: Path, mode: str = "r"):
        if mode == "xb":
            with real_open(path, mode) as file:
                file.write(b"half")
            second()
        return real_open(path, mode.replace("x", "w"))

    def replaced(path: Path, target: Path) -> Path:
        second()
        return real_replace(path, target)

    if call == "fsync":
        monkeypatch.setattr(os, "fsync", sync)
    elif call == "write":
        monkeypatch.setattr(Path, "open", opened)
    else:
        monkeypatch.setattr(Path, "replace", replaced)
    with pytest.raises(InputError) as caught:
        write_files(folder, NEW)
    monkeypatch.undo()
    assert contents(folder) == before
    for part in (str(folder / "residuals.csv"), "nothing was changed", *parts):
        assert part in str(caught.value)
    assert caught.value.exit_code == 3


def test_where_hard_links_are_unknown_the_earlier_files_come_back_too(folder, monkeypatch):
    before = contents(folder)

    def no_links(*_: object) -> None:
        raise OSError(errno.EPERM, os.strerror(errno.EPERM))

    monkeypatch.setattr(os, "link", no_links)
    write_files(folder, {"result.json": NEW["result.json"]})
    assert (folder / "result.json").read_text() == NEW["result.json"]
    (folder / "result.json").write_bytes(before["result.json"])
    (folder / "residuals.csv").mkdir()
    with refused("unwritable-file"):
        write_files(folder, NEW)
    (folder / "residuals.csv").rmdir()
    assert contents(folder) == before


def test_a_folder_made_for_files_that_then_fail_is_removed_again(tmp_path, monkeypatch):
    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(InputError):
        write_files(tmp_path / "new" / "results", NEW)
    assert contents(tmp_path) == {}


def test_an_interrupt_leaves_nothing_behind(folder, monkeypatch):
    before = contents(folder)

    def interrupt(_: int) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fsync", interrupt)
    with pytest.raises(KeyboardInterrupt):
        write_files(folder, NEW)
    assert contents(folder) == before


def test_a_file_where_a_folder_is_needed(tmp_path):
    (tmp_path / "results").write_text("mine")
    for folder in ("results", "results/deeper"):
        with refused("unwritable-file") as caught:
            write_files(tmp_path / folder, NEW)
        assert str(tmp_path / folder) in str(caught.value)
    assert (tmp_path / "results").read_text() == "mine"


def test_a_folder_where_a_file_is_needed(tmp_path):
    with refused("unwritable-file"):
        write_atomic(tmp_path, "x")
    with refused("unwritable-file"):
        write_atomic(tmp_path / ("x" * 300), "x")


def test_what_is_to_go_goes_with_the_rest_or_stays(folder: Path) -> None:
    report = folder / "report.html"
    report.write_text(page := '<meta name="loopcal" content="report">')
    before = contents(folder)
    (folder / "residuals.csv").mkdir()
    new = {folder / name: data for name, data in NEW.items()}
    with refused("unwritable-file"):
        write_all(new, remove=[report])
    (folder / "residuals.csv").rmdir()
    assert contents(folder) == before
    assert report.read_text() == page
    write_all(new, remove=[report, folder / "absent"])
    assert contents(folder) == as_bytes(NEW)
