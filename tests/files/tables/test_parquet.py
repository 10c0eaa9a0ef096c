"""Parquet: values exactly, nulls as missing, only the columns asked for."""

from __future__ import annotations

import datetime
from decimal import Decimal

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from loopcal.errors import InputError
from loopcal.files.tables import parquet
from loopcal.files.tables.parquet import read_parquet
from loopcal.files.tables.readers import Column, column_labels, read_dataset
from tests.refusals import refused


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "arm.parquet"
    frame = pl.DataFrame(
        {
            "pose": [11, 12, 13],
            "x": [0.1, None, 1 / 3],
            "n": [1, 2, None],
            "text": ["1.5", "n/a", "2,5"],
            "note": ["good", "windy", "3"],
            "d": [Decimal("1.25"), None, None],
            "flag": [True, None, False],
            "when": [None, datetime.date(2024, 5, 17), None],
            "none": [None, None, None],
        }
    )
    frame.write_parquet(path)
    return path


def test_numbers_nulls_and_ids(path):
    columns = {"x": "x", "n": "n", "d": "d"}
    data = read_dataset(path, columns, pose="pose", units={"x": "mm"})
    np.testing.assert_array_equal(data["x"], np.array([0.1, np.nan, 1 / 3]) * 1e-3)
    np.testing.assert_array_equal(data["n"], [1, 2, np.nan])
    np.testing.assert_array_equal(data["d"], [1.25, np.nan, np.nan])
    assert data.poses == ("11", "12", "13")
    assert data.exclude([11]).place(0, "n") == "arm.parquet, row 2, column 'n'"


@settings(max_examples=25)
@given(st.lists(st.floats(allow_nan=True, allow_infinity=False), min_size=1, max_size=20))
def test_values_come_back_exactly(tmp_path_factory, values):
    path = tmp_path_factory.mktemp("parquet") / "a.parquet"
    pl.DataFrame({"x": values}).write_parquet(path)
    table = read_parquet(path)
    found = table.numbers(0, np.arange(len(values)))
    np.testing.assert_array_equal(found, values)


def test_only_the_columns_asked_for_are_read(path):
    assert list(read_parquet(path, wanted={"x", 1}).columns) == [0, 1]
    data = read_dataset(path, every=2, exclude=[3], units={"x": "mm"})
    assert data.quantities == ("pose", "x", "n", "text", "d")


def test_text_is_read_by_the_rule_of_text(path):
    with refused("invalid-number", "arm.parquet", "row 3", "column 'text'", "'2,5'"):
        read_dataset(path, {"t": "text"})
    np.testing.assert_array_equal(
        read_dataset(path, {"t": "text"}, exclude=[3])["t"], [1.5, np.nan]
    )


@pytest.mark.parametrize(
    ("columns", "parts"),
    [
        ({"q": "X"}, ["arm.parquet", "no column 'X'", "'pose', 'x'"]),
        ({"q": "flag"}, ["row 1, column 'flag'", "'True'"]),
        ({"q": "when"}, ["row 2, column 'when'", "'2024-05-17'"]),
    ],
)
def test_wrong_columns(path, columns, parts):
    with pytest.raises(InputError) as caught:
        read_dataset(path, columns)
    for part in parts:
        assert part in str(caught.value)


def test_a_column_of_nothing_is_all_missing(path):
    assert np.isnan(read_dataset(path, {"q": "none"})["q"]).all()


@pytest.mark.parametrize("keep", [0, 3, 200, -4])
def test_broken_files(path, keep):
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(InputError) as caught:
        read_dataset(path)
    assert "arm.parquet" in str(caught.value)
    assert ("empty" if not keep else "Parquet") in str(caught.value)


def test_a_file_without_rows(tmp_path):
    path = tmp_path / "none.parquet"
    pl.DataFrame({"x": []}, schema={"x": pl.Float64}).write_parquet(path)
    with refused("no-data", "none.parquet"):
        read_dataset(path)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Three files of one table, columns in another order in one, read three rows at a time."""
    monkeypatch.setattr(parquet, "BLOCK", 3)
    whole = pl.DataFrame({"id": [*"abcdefghij"], "x": np.arange(10.0), "n": range(10)})
    whole = whole.with_columns(u=0.1 + pl.col("x"))
    whole.write_parquet(tmp_path / "whole.parquet")
    folder = tmp_path / "poses"
    folder.mkdir()
    whole[:4].write_parquet(folder / "a.parquet")
    whole[4:9].select("u", "n", "x", "id").write_parquet(folder / "b.PQ")
    whole[9:].cast({"n": pl.Float32}).write_parquet(folder / "c.parquet")
    (folder / ".hidden.parquet").write_text("no Parquet")
    (folder / "notes.txt").write_text("windy")
    return folder


@pytest.mark.parametrize(
    "how",
    [
        {},
        {"pose": "id"},
        {"pose": "id", "every": 2, "exclude": ["b", "g"]},
        {"every": 4, "exclude": 5},
        {"every": 100},
    ],
    ids=str,
)
def test_a_folder_is_its_files_one_after_the_other(folder, how):
    columns = {"x": Column("x", "mm", sd_column="u"), "n": Column(3)}
    data = read_dataset(folder, columns, **how)
    whole = read_dataset(folder.with_name("whole.parquet"), columns, **how)
    assert data.poses == whole.poses
    assert data.source.excluded == whole.source.excluded
    assert data.source.rows_read == whole.source.rows_read == 10
    for quantity in ("x", "n"):
        np.testing.assert_array_equal(data[quantity], whole[quantity])
    np.testing.assert_array_equal(data.sds["x"], whole.sds["x"])
    assert column_labels(folder) == ("id", "x", "n", "u")


def test_in_a_folder_a_value_has_its_file_and_its_row_there(folder):
    data = read_dataset(folder, {"x": "x"}, every=2, exclude=["1"])
    places = [data.place(i, "x") for i in range(len(data))]
    assert places[0] == "poses, a.parquet, row 3, column 'x'"
    assert places[1] == "poses, b.PQ, row 1, column 'x'"
    frame = pl.read_parquet(folder / "b.PQ")
    frame.with_columns(x=pl.Series([0.0, 1.0, np.inf, 2.0, 3.0])).write_parquet(folder / "b.PQ")
    with refused("invalid-number", "b.PQ", "row 3", "column 'x'", "'x'"):
        read_dataset(folder, {"x": "x"})
    with refused("invalid-number", "a.parquet", "row 1", "column 'id'", "'a'"):
        read_dataset(folder, {"x": "id"})


@pytest.mark.parametrize(
    ("frame", "code", "stated"),
    [
        ({"id": ["k"], "x": [1.0], "n": [1]}, "unreadable-file", ("d.parquet",)),
        ({"id": ["k"], "x": ["1"], "n": [1], "u": [1.0]}, "invalid-number", ("'x'", "Float64")),
    ],
)
def test_files_that_do_not_go_together(folder, frame, code, stated):
    pl.DataFrame(frame).write_parquet(folder / "d.parquet")
    with refused(code, *stated) as error:
        read_dataset(folder, {"x": "x"})
    assert error.value.remedy


def test_a_folder_without_poses(folder):
    for path in folder.iterdir():
        path.unlink()
    with refused("wrong-file-type"):
        read_dataset(folder)
    pl.DataFrame({"x": []}, schema={"x": pl.Float64}).write_parquet(folder / "a.parquet")
    with refused("no-data"):
        read_dataset(folder)
