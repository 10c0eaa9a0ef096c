"""What is written over is of the same kind and of loopcal, and no input; all else needs force."""

from __future__ import annotations

import os
from hashlib import sha256
from itertools import permutations
from pathlib import Path

import pytest

from loopcal.files.atomic import write_all, write_atomic, write_files
from loopcal.files.json_files import marked_json
from loopcal.files.outputs import command, refuse_foreign
from loopcal.files.tables.raw import bytes_of
from tests.refusals import refused

KINDS = {
    "report": '<html><meta name="loopcal" content="report"> one',
    "history": '<html><meta name="loopcal" content="history"> one',
    "record": f'<html><meta name="loopcal-record" content="{"0" * 64}">',
    "JSON": marked_json({"x": 1}),
    "mechanism": "# arm: a mechanism file of loopcal, made by it.\n",
    "start": "# Where the next machine of this type begins: arm.\n",
    "prediction": "pose,x [m],extrapolated\n1,2,no\n",
    "residuals": "pose,residual x before [m]\n1,2\n",
}
FOREIGN = {
    "text": "mine",
    "page": '<html><meta name="generator" content="another program">',
    "table": "pose,x [m],y [m]\n1,2,3\n",
    "JSON of others": '{"schema": 2, "title": "mine"}',
    "quoting": "# notes on loopcal\n# a mechanism file of loopcal, made by it.\n",
    "empty": "",
}


@pytest.mark.parametrize("kind", KINDS)
def test_a_file_gives_way_to_one_of_its_kind(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "out"
    path.write_text(KINDS[kind])
    write_atomic(path, KINDS[kind] + "more")
    assert path.read_text() == KINDS[kind] + "more"
    assert os.listdir(tmp_path) == ["out"]


def test_a_report_of_an_earlier_version_gives_way_to_a_report(tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    path.write_text('<html><meta name="generator" content="loopcal 0.1.0">')
    write_atomic(path, KINDS["report"])
    assert path.read_text() == KINDS["report"]


def test_no_file_gives_way_to_another_kind_without_force_and_with_it_a_backup_is_kept(
    tmp_path: Path,
) -> None:
    path, every = tmp_path / "out", {**KINDS, **FOREIGN}
    pairs = [(old, new) for old, new in permutations(every, 2) if every[old] != every[new]]
    for number, (old, new) in enumerate(pairs, 1):
        path.write_text(every[old])
        with refused("unwritable-file", "--force", str(path)):
            write_atomic(path, every[new])
        assert path.read_text() == every[old]
        with command(force=True):
            write_atomic(path, every[new])
        backup = path.with_name(f"out.bak{number if number > 1 else ''}")
        assert (path.read_text(), backup.read_text()) == (every[new], every[old])


def test_others_stay_in_a_folder_whatever_comes_with_them(tmp_path: Path) -> None:
    write_files(tmp_path, {"a": KINDS["JSON"], "b": KINDS["report"]})
    (tmp_path / "b").write_text("mine")
    for files, remove in (
        ({"a": KINDS["JSON"] + " ", "b": KINDS["report"]}, ()),
        ({"a": KINDS["JSON"] + " "}, ("b",)),
    ):
        with refused("unwritable-file", "b"):
            write_all(
                {tmp_path / name: data for name, data in files.items()},
                remove=[tmp_path / name for name in remove],
            )
        assert (tmp_path / "a").read_text() == KINDS["JSON"]
    with command(force=True):
        write_all({tmp_path / "a": KINDS["JSON"] + " "}, remove=[tmp_path / "b"])
    assert not (tmp_path / "b").exists()
    assert (tmp_path / "b.bak").read_text() == "mine"


@pytest.mark.parametrize("other", ["name", "symbolic", "hard", "through"])
def test_an_input_is_kept_by_whatever_name_it_is_called(tmp_path: Path, other: str) -> None:
    path, named = tmp_path / "in.csv", tmp_path / "other.csv"
    path.write_text(KINDS["prediction"])
    (tmp_path / "deep").mkdir()
    if other == "symbolic":
        named.symlink_to(path)
    elif other == "hard":
        os.link(path, named)
    else:
        named = path if other == "name" else tmp_path / "deep" / ".." / "in.csv"
    with command():
        bytes_of(path, 1000)
        for write in (lambda: write_atomic(named, "x"), lambda: refuse_foreign(named)):
            with refused("unwritable-file", "reads it"):
                write()
        with command(force=True):
            write_atomic(named, "x")
    assert any(p.read_text() == KINDS["prediction"] for p in tmp_path.glob("*.bak"))
    path.write_text(KINDS["prediction"])
    write_atomic(path, KINDS["prediction"] + "2,3,no\n")  # another command


@pytest.mark.parametrize("listing", ["plan.json", "plan.truth.json"])
def test_a_listed_table_gives_way_until_somebody_fills_it_in(tmp_path: Path, listing: str) -> None:
    def written(table: str) -> None:
        tables = {"plan.csv": table}
        write_files(tmp_path, {**tables, listing: marked_json({}, tables)})

    written("pose,x\n1,2\n")
    assert sha256(b"pose,x\n1,2\n").hexdigest() in (tmp_path / listing).read_text()
    written("pose,x\n1,3\n")
    (tmp_path / "plan.csv").write_text("pose,x\n1,3.001\n")
    with refused("unwritable-file", "changed since"):
        written("pose,x\n1,4\n")
    assert (tmp_path / "plan.csv").read_text() == "pose,x\n1,3.001\n"
