"""From a file to quantities in SI: columns, units, sds, ids, and what is left out."""

from __future__ import annotations

import hashlib
import math

import numpy as np
import pytest

from loopcal.files.tables.readers import Column, read_dataset
from loopcal.measurements.checks import check_dataset
from tests.refusals import refused

TABLE = """pose,S,x,u_x,note
p1,90,1.5,0.1,good
p2,-45,,,
# p3 was lost
p4,180,2.5,0.2,windy
p5,0,3.5,0.3,
"""


@pytest.fixture
def path(tmp_path):
    file = tmp_path / "arm.csv"
    file.write_text(TABLE)
    return file


def test_columns_units_and_sds(path):
    data = read_dataset(
        path,
        {
            "theta_1": {"column": "S", "unit": "deg"},
            "x": {"column": "x", "unit": "mm", "sd_column": "u_x", "sd_unit": "um"},
        },
        pose="pose",
    )
    assert data.poses == ("p1", "p2", "p4", "p5")
    degree = math.pi / 180
    np.testing.assert_array_equal(data["theta_1"], np.array([90, -45, 180, 0]) * degree)
    np.testing.assert_array_equal(data["x"], np.array([1.5, np.nan, 2.5, 3.5]) * 1e-3)
    np.testing.assert_array_equal(data.sds["x"], np.array([0.1, np.nan, 0.2, 0.3]) * 1e-6)
    assert data.units == {"theta_1": "rad", "x": "m"}
    source = data.source
    assert source.file == "arm.csv"
    assert source.sha256 == hashlib.sha256(TABLE.encode()).hexdigest()
    assert source.rows_read == 4
    assert source.rows is not None
    assert source.rows.tolist() == [2, 3, 5, 6]
    assert source.columns == {"theta_1": "S", "x": "x"}
    assert source.stated == {"theta_1": "deg", "x": "mm"}
    assert data.place(2, "x", sd=True) == "arm.csv, row 5, column 'u_x'"


def test_columns_by_name_number_and_record_are_the_same(path):
    by_name = read_dataset(path, {"s": "S"}, units={"s": "deg"})
    by_number = read_dataset(path, {"s": 2}, units={"s": "deg"})
    by_record = read_dataset(path, {"s": Column("S", "deg")})
    np.testing.assert_array_equal(by_name["s"], by_number["s"])
    np.testing.assert_array_equal(by_name["s"], by_record["s"])
    assert by_number.source.columns == {"s": "S"}
    assert by_name.poses == ("1", "2", "3", "4")


def test_without_columns_every_column_of_numbers_is_read(path):
    data = read_dataset(path, pose="pose", units={"S": "deg"})
    assert data.quantities == ("S", "x", "u_x")
    assert data["S"][0] == 90 * (math.pi / 180)
    bare = path.with_suffix(".txt")
    bare.write_text("1 2\n3 4\n")
    assert read_dataset(bare).quantities == ("column_1", "column_2")
    assert read_dataset(bare, pose=1).quantities == ("column_2",)


def test_poses_are_thinned_by_row_and_then_left_out_by_id(path):
    data = read_dataset(path, {"x": "x"}, pose="pose", every=2, exclude=["p4"])
    assert data.poses == ("p1",)
    assert data.source.excluded == ("p4",)
    assert data.source.every == 2
    assert data.source.rows_read == 4
    assert read_dataset(path, {"x": "x"}, exclude=[2]).poses == ("1", "3", "4")


def test_what_is_left_out_may_be_anything(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("id,x\n1,1.0\n2,broken\n3,inf\n4,2.0\n")
    assert read_dataset(path, {"x": "x"}, pose="id", exclude=[2, 3]).poses == ("1", "4")
    with refused("invalid-number", "row 3"):
        read_dataset(path, {"x": "x"}, pose="id", exclude=[3])


def test_several_quantities_may_share_one_sd_column(path):
    spec = {q: {"column": c, "sd_column": "u_x"} for q, c in (("x", "x"), ("s", "S"))}
    data = read_dataset(path, spec, exclude=[2])
    np.testing.assert_array_equal(data.sds["x"], data.sds["s"])


def test_check_false_reaches_the_sanity_checks(path):
    wild = {"s": {"column": "S", "unit": "rad"}}
    with refused("implausible-unit", "arm.csv", "row 5", "column 'S'", "pose 'p4'"):
        check_dataset(read_dataset(path, wild, pose="pose"), {"s": "rad"})
    trusted = read_dataset(path, {"s": {**wild["s"], "check": False}})
    assert check_dataset(trusted, {"s": "rad"}) == ()


def test_the_motoman_grid_is_read_whole(shared_data):
    path = shared_data("motoman_ma1400_leica/left_arm_grid.csv")
    columns = {
        **{f"theta_{i}": {"column": c, "unit": "rad"} for i, c in enumerate("SLURBT", 1)},
        **{c: {"column": c, "unit": "m", "sd_column": f"u_{c}"} for c in "xyz"},
    }
    data = read_dataset(path, columns, pose="pose")
    assert len(data) == 208
    assert data["theta_1"][0] == -0.031068
    assert data["z"][2] == -0.384649
    assert data.sds["x"][0] == 7e-6
    assert data.source.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    expected = {q: "m" if q in "xyz" else "rad" for q in columns}
    (rounded,) = check_dataset(data, expected)  # u_y is below 1 µm, written as 0, in some rows
    assert rounded.quantity == "y"


@pytest.mark.parametrize(
    ("name", "poses"),
    [
        ("right_arm_workspace.csv", 587),
        ("right_arm_repeat_table1.csv", 18),
        ("right_arm_repeat_wall1.csv", 19),
        ("right_arm_repeat_self1.csv", 20),
    ],
)
def test_the_other_motoman_files_are_read(shared_data, name, poses):
    data = read_dataset(shared_data(f"motoman_ma1400_leica/{name}"), pose="pose")
    assert len(data) == poses
    assert data.quantities == (*"ESLURBT", *"xyz", "u_x", "u_y", "u_z")
    assert not any(np.isnan(values).any() for values in data.readings.values())


def test_both_sheets_of_the_cable_workbook_are_read(shared_data):
    path = shared_data("abb_irb120_cable/RobotCali.xlsx")
    columns = {
        **{f"q_{i}": {"column": f"q{i}", "unit": "deg"} for i in range(1, 7)},
        "length": {"column": "L", "unit": "mm"},
    }
    first = read_dataset(path, columns)
    second = read_dataset(path, columns, sheet="Sheet2")
    assert (len(first), len(second)) == (120, 10)
    assert first["length"][0] == 509.19 * 1e-3
    assert second.place(9, "q_6") == "RobotCali.xlsx, sheet 'Sheet2', row 11, column 'q6'"
    expected = {q: "m" if q == "length" else "rad" for q in columns}
    assert check_dataset(first, expected) == ()
    with refused("implausible-unit"):
        check_dataset(read_dataset(path, {"q_1": {"column": "q1", "unit": "rad"}}), {"q_1": "rad"})
    with refused("no-data"):
        read_dataset(path, sheet=3)
