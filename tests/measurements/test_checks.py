"""Readings that cannot be right stop; odd ones warn; real machines pass."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from loopcal.errors import InputError
from loopcal.measurements.checks import check_dataset, check_units
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.source import Source

RNG = np.random.default_rng(20240611)
JOINT = RNG.uniform(-2.9, 2.9, 50)  # [rad]
POINT = RNG.uniform(-1.4, 1.4, 50)  # [m]


def filed(readings: dict, **stated: str) -> Dataset:
    """Readings as if they stood from row 2 on in arm.csv, in columns of upper-case names."""
    number = len(next(iter(readings.values())))
    data = Dataset.from_arrays(readings, units=stated)
    source = Source(
        "arm.csv",
        rows=np.arange(2, number + 2),
        columns={q: q.upper() for q in readings},
        stated=stated,
    )
    return replace(data, source=source)


def warned(data: Dataset, **expected: str) -> list[str]:
    return [str(warning) for warning in check_dataset(data, expected)]


def stopped(data: Dataset, **expected: str) -> str:
    with pytest.raises(InputError) as caught:
        check_dataset(data, expected)
    return str(caught.value)


def test_a_sound_machine_passes_without_a_word():
    data = filed({"s": JOINT, "x": POINT, "t": 2 * JOINT}, s="rad", x="m", t="rad")
    assert warned(data, s="rad", x="m", t="rad") == []


@pytest.mark.parametrize("stated", [{"s": "rad"}, {}], ids=["declared", "unstated"])
def test_degrees_taken_as_rad_stop_with_the_number_and_the_remedy(stated):
    degrees = np.degrees(JOINT)
    message = stopped(filed({"s": degrees}, **stated), s="rad")
    worst = int(np.argmax(np.abs(degrees)))
    assert f"arm.csv, row {worst + 2}, column 'S' (pose '{worst + 1}')" in message
    assert f"'s' reads {degrees[worst]:.6g}" in message
    assert ("declared rad" if stated else "taken as rad") in message
    assert 'unit = "deg"' in message
    assert "check = false" in message


def test_a_joint_that_moves_little_is_still_seen_to_be_in_degrees():
    assert "degrees" in stopped(filed({"s": RNG.uniform(7.5, 11.0, 20)}), s="rad")
    assert "degrees" in stopped(filed({"s": RNG.uniform(-34.0, -2.0, 20)}), s="rad")


def test_joints_of_two_turns_and_a_single_wild_value_do_not_stop():
    turntable = np.linspace(-4 * math.pi, 4 * math.pi, 50)
    assert warned(filed({"s": turntable}, s="rad"), s="rad") == []
    wild = JOINT.copy()
    wild[7] = 40.0
    (message,) = warned(filed({"s": wild}, s="rad"), s="rad")
    assert "arm.csv, row 9, column 'S' (pose '8')" in message
    assert "40 rad" in message


def test_trusted_quantities_are_not_doubted():
    winch = filed({"s": np.linspace(0, 300, 50)}, s="rad")
    assert check_dataset(winch, {"s": "rad"}, trusted={"s"}) == ()
    read_so = replace(winch, source=replace(winch.source, trusted=frozenset({"s"})))
    assert check_dataset(read_so, {"s": "rad"}) == ()
    with pytest.raises(InputError):
        check_dataset(winch, {"s": "rad"})


def test_millimetres_taken_as_metres_stop():
    message = stopped(filed({"x": 1000 * POINT}, x="m"), x="m")
    assert "column 'X'" in message
    assert "millimetres" in message
    assert 'unit = "mm"' in message
    assert warned(filed({"x": 1000 * POINT}, x="mm"), x="m") == []
    assert warned(filed({"x": 40 * POINT}, x="m"), x="m") == []


def test_rad_declared_as_degrees_and_metres_as_millimetres_warn():
    (message,) = warned(filed({"s": JOINT}, s="deg"), s="rad")
    assert "declared deg" in message
    assert "are these rad?" in message
    (message,) = warned(filed({"x": POINT}, x="mm"), x="m")
    assert "are these m?" in message


def test_a_joint_that_hardly_moves_among_others_in_degrees_is_no_reason_to_warn():
    still = filed({"s": JOINT, "t": 50 * JOINT}, s="deg", t="deg")
    assert warned(still, s="rad", t="rad") == []


def test_a_unit_of_another_dimension_stops():
    message = stopped(filed({"x": POINT}, x="rad"), x="m")
    assert "arm.csv, column 'X'" in message
    assert "'x' is in rad (angle), but the mechanism expects length (m)" in message
    assert "unit of length" in message
    with pytest.raises(InputError):
        check_units(filed({"x": POINT}, x="rad"), {"x": "m"})
    with pytest.raises(InputError):  # even of a quantity that is trusted
        check_dataset(filed({"x": POINT}, x="rad"), {"x": "m"}, trusted={"x"})


def test_a_quantity_without_any_reading_stops():
    message = stopped(filed({"x": np.full(5, np.nan)}), x="m")
    assert "'x' has no reading in any of 5 poses" in message
    assert "arm.csv, column 'X'" in message


def test_a_lost_reflector_among_several_stops_naming_its_row():
    points = {f"{axis}_{side}": POINT + 2.0 for side in ("east", "west") for axis in "xyz"}
    lost = {q: np.where(np.arange(50) == 4, 0.0, v) for q, v in points.items() if "west" in q}
    groups = [[f"{axis}_{side}" for axis in "xyz"] for side in ("east", "west")]
    data = filed({**points, **lost})
    with pytest.raises(InputError) as refused:
        check_dataset(data, dict.fromkeys(points, "m"), points=groups)
    assert "x_west, y_west, z_west all read 0 in 1 of 50" in refused.value.message
    assert refused.value.place == "arm.csv, row 6, column 'X_WEST'"
    believed = check_dataset(data, dict.fromkeys(points, "m"), points=groups, trusted={"x_west"})
    assert not any("all read 0" in str(warning) for warning in believed)


def test_a_coordinate_of_zero_is_no_lost_reflector():
    flat = filed({"x": POINT, "y": POINT[::-1], "z": 0.0 * POINT})
    assert check_dataset(flat, dict.fromkeys("xyz", "m"), points=["xyz"])


def test_constant_columns_warn():
    (message,) = warned(filed({"s": np.full(5, 0.25)}), s="rad")
    assert "'s' reads 0.25 rad in all of 5 poses" in message
    assert warned(filed({"s": np.array([0.25])}), s="rad") == []


def test_duplicated_columns_warn_naming_both():
    gap = np.where(np.arange(50) == 3, np.nan, JOINT)
    copied = filed({"s": gap, "t": gap.copy(), "x": POINT})
    (message,) = warned(copied, s="rad", t="rad", x="m")
    assert "'t' reads the same as 's'" in message
    assert warned(filed({"s": gap, "t": JOINT}), s="rad", t="rad") == []


def test_repeated_and_empty_poses_warn():
    readings = {"x": [1.0, 2.0, math.nan, 3.0], "y": [4.0, 1.0, math.nan, math.nan]}
    data = Dataset.from_arrays(readings, poses=["a", "b", "c", "a"])
    repeated, empty = warned(data, x="m", y="m")
    assert "pose ids that occur more than once: a;" in repeated
    assert empty == "poses without any reading: c"
    many = Dataset.from_arrays({"x": np.arange(14.0)}, poses=[*"abcdefg", *"abcdefg"])
    assert "a, b, c, d, e and 2 more" in warned(many, x="m")[0]


def test_sds_rounded_to_zero_warn():
    data = Dataset.from_arrays({"x": [1.0, 2.0, 4.0]}, sds={"x": [1e-6, 0.0, 0.0]})
    (message,) = warned(data, x="m")
    assert "pose '2', sd of 'x'" in message
    assert "0 in 2 of 3 poses" in message
    exact = Dataset.from_arrays({"x": [1.0, 2.0, 4.0]}, sds={"x": [0.0, 0.0, 0.0]})
    assert warned(exact, x="m") == []


def test_quantities_without_readings_and_other_columns_are_passed_over():
    data = filed({"x": POINT, "comment": 1000 * POINT})
    assert warned(data, x="m", passive="rad") == []
    assert warned(data, passive="rad") == []
