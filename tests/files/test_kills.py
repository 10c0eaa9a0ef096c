"""A kill at any file operation: folders are whole or refused, and the next run clears up.

`analyses/kills_at_file_operations.py` does the same to whole commands.
"""

from __future__ import annotations

import os
from pathlib import Path
from shutil import copytree, rmtree

import pytest

import loopcal as lc
from analyses.kills_at_file_operations import PROJECT, child, content, left
from loopcal.cli import main
from loopcal.companions.app.session import Session
from loopcal.companions.life.history_folder import append_entries, read_entries
from loopcal.errors import InputError
from tests.refusals import refused

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="there are no forks here")
SHORT = PROJECT.replace("implicit-loop", "least-squares")


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> tuple[lc.Result, lc.Result]:
    path = tmp_path_factory.mktemp("kills") / "project.toml"
    path.write_text(SHORT)
    project = lc.read_project(path)
    made = (lc.simulate(project, seed=seed) for seed in (1, 2))
    first, second = (lc.calibrate(project, one.dataset) for one in made)
    return first, second


@pytest.mark.parametrize("earlier", [True, False])
def test_a_result_is_old_new_or_refused_whenever_its_writer_dies(
    results: tuple[lc.Result, lc.Result], tmp_path: Path, earlier: bool
) -> None:
    first, second = results
    start, root = tmp_path / "start", tmp_path / "root"
    start.mkdir()
    if earlier:
        lc.write_result(first, start / "r")
        (start / "r" / "report.html").write_text('<meta name="loopcal" content="report">')
    old = content(start)

    def write() -> None:
        lc.write_result(second, root / "r")

    copytree(start, root)
    operations, states = child(write, root, None), set[str]()
    new = content(root)
    assert operations > 10
    for kill_at in range(1, operations + 1):
        rmtree(root)
        copytree(start, root)
        child(write, root, kill_at)
        found = content(root)
        if found in (old, new):
            states.add("old" if found == old else "new")
        else:
            with pytest.raises(InputError) as caught:
                lc.read_result(root / "r")
            assert caught.value.code == ("version-mismatch" if earlier else "missing-file")
            states.add("refused")
        write()
        assert content(root) == new, kill_at
        assert not left(root), kill_at
    assert states == {"old", "new", "refused"}


def test_entries_are_all_there_or_none_once_the_next_run_has_written(tmp_path: Path) -> None:
    folder = tmp_path / "m.history"

    def write() -> None:
        page = tmp_path / "page.html"
        added = [("event", {"words": str(i)}) for i in range(2)]
        append_entries(folder, added, lambda every: {page: marked(len(every.whole))})

    def marked(count: int) -> str:
        return f'<meta name="loopcal" content="history">{count}'

    write()
    for kill_at in range(1, child(write, tmp_path, None) + 1):
        before = len(read_entries(folder).whole)
        child(write, tmp_path, kill_at)
        assert not read_entries(folder).skipped
        write()
        entries = read_entries(folder).whole
        assert len(entries) - before in (2, 4), kill_at
        assert [entry.sequence for entry in entries] == list(range(1, len(entries) + 1))
        assert (tmp_path / "page.html").read_text() == marked(len(entries))
        assert not left(tmp_path)


@pytest.mark.parametrize("changed", ["mechanism.toml", "residuals.csv"])
def test_a_stale_file_is_named_by_whoever_reads_it(
    results: tuple[lc.Result, lc.Result], tmp_path: Path, changed: str
) -> None:
    (tmp_path / "a.toml").write_text(SHORT)
    folders = tmp_path / "a-result", tmp_path / "b"
    for folder, result in zip(folders, results, strict=True):
        lc.write_result(result, folder)
    path = folders[0] / changed
    stated = path.read_bytes()
    path.write_bytes((tmp_path / "b" / changed).read_bytes())
    with refused("version-mismatch", changed):
        lc.compare(*folders)
    if changed == "mechanism.toml":
        for read in (lc.read_result, lambda at: lc.read_mechanism(at / changed)):
            with refused("version-mismatch", changed):
                read(folders[0])
    assert "SHA-256" in Session(tmp_path, main).unreadable()
    path.write_bytes(stated.replace(b"\n", b"\r\n"))  # as git does on Windows
    lc.compare(*folders)
