"""A dataset holds what was read, in SI, unchangeable, and can say where each value came from."""

from __future__ import annotations

import math
import pickle

import numpy as np
import pandas as pd
import polars as pl
import pytest

from loopcal.errors import InputError
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.poses import pose_id
from loopcal.measurements.source import Source
from tests.refusals import refused

TABLE = {"theta": [0.0, 90.0, -180.0], "x": [1.0, 2.0, float("nan")]}


def test_units_become_SI_and_unstated_ones_are_SI_already():
    data = Dataset.from_arrays(TABLE, units={"theta": "deg"})
    np.testing.assert_array_equal(data["theta"], np.array([0.0, 90.0, -180.0]) * (math.pi / 180))
    np.testing.assert_array_equal(data["x"], [1.0, 2.0, np.nan])
    assert data.units == {"theta": "rad"}
    assert data.source.stated == {"theta": "deg"}
    assert data.poses == ("1", "2", "3")
    assert len(data) == 3
    assert data.quantities == ("theta", "x")


def test_arrays_are_contiguous_float64_copies_that_nobody_can_change():
    mine = np.arange(10, dtype=np.int32)[::2]
    data = Dataset.from_arrays({"x": mine}, sds={"x": np.ones(5)})
    mine[:] = 7
    for array in (data["x"], data.sds["x"]):
        assert array.dtype == np.float64
        assert array.flags.c_contiguous
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
    np.testing.assert_array_equal(data["x"], [0, 2, 4, 6, 8])


def test_sds_come_in_the_unit_of_their_quantity_or_from_a_column_of_the_table():
    table = {"id": ["a", "b"], "x": [1.0, 2.0], "u_x": [0.1, 0.0]}
    data = Dataset.from_arrays(table, units={"x": "mm"}, poses="id", sds={"x": "u_x"})
    assert data.quantities == ("x",)
    assert data.poses == ("a", "b")
    np.testing.assert_array_equal(data.sds["x"], np.array([0.1, 0.0]) * 1e-3)


@pytest.mark.parametrize("frame", [pd.DataFrame, pl.DataFrame], ids=["pandas", "polars"])
def test_any_data_frame_will_do(frame):
    table = frame({"pose": [3, 4, 5], "x": [1, None, 3], "y": [1.5, 2.5, None]})
    data = Dataset.from_arrays(table, poses="pose", units={"x": "mm"})
    assert data.poses == ("3", "4", "5")
    np.testing.assert_array_equal(data["x"], np.array([1.0, np.nan, 3.0]) * 1e-3)
    np.testing.assert_array_equal(data["y"], [1.5, 2.5, np.nan])


def test_missing_values_of_every_kind_are_NaN():
    nullable = pd.DataFrame({"x": pd.array([1, None], dtype="Int64")})
    np.testing.assert_array_equal(Dataset.from_arrays(nullable)["x"], [1.0, np.nan])
    masked = np.ma.array([1, 2], mask=[False, True])
    np.testing.assert_array_equal(Dataset.from_arrays({"x": masked})["x"], [1.0, np.nan])
    listed = {"x": [1.0, None]}
    np.testing.assert_array_equal(Dataset.from_arrays(listed)["x"], [1.0, np.nan])


def test_a_table_with_the_columns_of_an_image_is_gone_through_once():
    class Counted(dict):
        gone_through = 0

        def __iter__(self):
            Counted.gone_through += 1
            return super().__iter__()

    table = Counted({f"u{i}": [0.0] for i in range(50)})
    assert len(Dataset.from_arrays(table).readings) == 50
    assert Counted.gone_through == 1


class ArrowLike:
    """What of a pyarrow Table is relied on: names apart from the columns, columns by name."""

    column_names = ("x",)
    columns = ((1.0, 2.0),)

    def __getitem__(self, name: str) -> tuple[float, ...]:
        return self.columns[self.column_names.index(name)]


def test_an_arrow_table_and_a_structured_array_will_do():
    structured = np.array([(1.0, 2.0)], dtype=[("x", float), ("y", float)])
    assert Dataset.from_arrays(structured).quantities == ("x", "y")
    np.testing.assert_array_equal(Dataset.from_arrays(ArrowLike())["x"], [1.0, 2.0])


@pytest.mark.parametrize(
    ("table", "options", "parts"),
    [
        ({"x": [1.0], "y": [1.0, 2.0]}, {}, ["'y' has 2 values for 1 poses", "one value per pose"]),
        ({"x": [[1.0, 2.0]]}, {}, ["'x'", "(1, 2)", "1-D"]),
        ({"x": ["1.0", "2.0"]}, {}, ["'x'", "str", "convert"]),
        ({"x": [True, False]}, {}, ["'x'", "bool"]),
        ({"x": [1.0 + 2.0j]}, {}, ["'x'", "complex"]),
        ({"x": np.array([1.0, "late"], dtype=object)}, {}, ["'x'", "value 2", "'late'"]),
        ({"x": [1.0, math.inf]}, {}, ["pose '2'", "'x'", "inf", "blank"]),
        ({"x": []}, {}, ["no pose"]),
        ({}, {}, ["no pose"]),
        ({"x": [1.0]}, {"poses": ["a", "b"]}, ["'x'", "1 values for 2 poses"]),
        ({"x": [1.0]}, {"units": {"y": "m"}}, ["'y'", "'x'"]),
        ({"x": [1.0]}, {"units": {"x": "meter"}}, ["'meter'"]),
        ({"x": [1.0]}, {"poses": "id"}, ["'id'"]),
        ({"x": [1.0]}, {"sds": {"x": [-1.0]}}, ["sd of 'x'", "below zero", "pose '1'"]),
        ({"x": [1.0]}, {"sds": {"x": [math.nan]}}, ["sd of 'x'", "missing", "pose '1'"]),
        ({"x": [1.0]}, {"sds": {"x": [1.0, 2.0]}}, ["sd of 'x'", "2 values for 1 poses"]),
        ({1: [1.0]}, {}, ["1", "not text"]),
        ([1.0, 2.0], {}, ["list", "dict"]),
    ],
)
def test_what_cannot_be_a_dataset_says_why(table, options, parts):
    with pytest.raises(InputError) as caught:
        Dataset.from_arrays(table, **options)
    for part in parts:
        assert part in str(caught.value)


def test_sd_may_be_infinite_and_may_lack_where_the_reading_does():
    data = Dataset.from_arrays({"x": [1.0, math.nan]}, sds={"x": [math.inf, math.nan]})
    assert data.sds["x"][0] == math.inf


@pytest.fixture
def filed() -> Dataset:
    """Five poses that lie in rows 2, 3, 5, 6, 7 of a file."""
    source = Source("a.csv", rows_read=5, rows=np.array([2, 3, 5, 6, 7]), columns={"x": "X"})
    return Dataset({"x": np.arange(5.0)}, {}, ("a", "b", "c", "d", "d"), {"x": np.ones(5)}, source)


def test_leaving_out_poses_keeps_rows_and_says_so(filed):
    left = filed.exclude(["b", "d"])
    assert left.poses == ("a", "c")
    assert left.source.excluded == ("b", "d")
    assert left.source.rows_read == 5
    assert left.place(1, "x") == "a.csv, row 5, column 'X'"
    assert left.sds["x"].shape == (2,)
    assert len(filed) == 5


def test_thinning_keeps_the_first_and_every_nth(filed):
    thin = filed.thin(2)
    np.testing.assert_array_equal(thin["x"], [0.0, 2.0, 4.0])
    assert thin.source.every == 2
    assert thin.thin(2).source.every == 4
    for wrong in (0, -1, 1.5, True):
        with refused("invalid-value", f"every is {wrong!r}"):
            filed.thin(wrong)


def test_selection_is_by_id_and_taking_by_position(filed):
    assert filed.select(["d", "a"]).poses == ("a", "d", "d")
    assert filed.take([4, 0]).place(0) == "a.csv, row 7"
    assert filed.take(filed["x"] > 2).poses == ("d", "d")
    assert filed.take(slice(1, 3)).poses == ("b", "c")
    with refused("unknown-name", "'aa'") as caught:
        filed.select(["d", "aa"])
    assert "a.csv" in str(caught.value)
    with refused("no-data"):
        filed.exclude(filed.poses)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (13, "13"),
        (13.0, "13"),
        ("13", "13"),
        ("13.0", "13"),
        ("1.10", "1.10"),
        (np.int64(7), "7"),
        (1.5, "1.5"),
        (" w ", "w"),
    ],
)
def test_one_pose_has_one_id_however_it_is_written(value, text):
    assert pose_id(value) == text


def test_ids_given_as_numbers_find_their_poses():
    data = Dataset.from_arrays({"x": [1.0, 2.0, 3.0]})
    assert data.exclude([2]).poses == ("1", "3")
    assert data.exclude([]).poses == data.poses


def test_new_readings_forget_where_the_old_ones_came_from(filed):
    new = filed.with_readings({"x": [1.0] * 5, "q": [180.0] * 5}, units={"q": "deg"})
    np.testing.assert_array_equal(new["q"], 180.0 * (math.pi / 180))
    assert new.source.columns == {}
    assert new.units == {"q": "rad"}
    assert new.place(0, "x") == "a.csv, row 2, quantity 'x'"
    with refused("wrong-shape", "1 values", "5 poses"):
        filed.with_readings({"x": [1.0]})


def test_it_prints_what_it_holds(filed):
    assert repr(filed) == "<Dataset: 5 poses of x from a.csv>"
    assert str(filed).splitlines()[1:] == [
        "quantity  unit  readings  smallest  largest",
        "x         SI    5         0         4",
    ]
    html = Dataset.from_arrays({"<x>": [math.nan]}, units={"<x>": "mm"})._repr_html_()
    assert "&lt;x&gt;</td><td>m</td><td>0</td>" in html


def test_an_unknown_quantity_names_the_nearest():
    with refused("unknown-name", "did you mean 'theta_1'"):
        Dataset.from_arrays({"theta_1": [1.0]})["theta1"]


def test_it_goes_to_another_process_unchanged(filed):
    copy = pickle.loads(pickle.dumps(filed))
    assert copy.poses == filed.poses
    np.testing.assert_array_equal(copy["x"], filed["x"])


@pytest.mark.parametrize(("unit", "most"), [("rad", 1e8), ("deg", 5e9), ("mm", 1e33), ("N", 1e30)])
def test_a_reading_larger_than_any_sensor_makes_is_refused(unit: str, most: float) -> None:
    assert len(Dataset.from_arrays({"a": [1.0, 0.9 * most]}, units={"a": unit})) == 2
    with refused("implausible-readings", "'2'") as error:
        Dataset.from_arrays({"a": [1.0, -2.0 * most]}, units={"a": unit})
    assert error.value.remedy
