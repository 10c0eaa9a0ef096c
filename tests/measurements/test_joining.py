"""Readings of several files, joined by pose id."""

from __future__ import annotations

import numpy as np
import pytest

from loopcal.errors import Code
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.joining import join
from tests.refusals import refused


def joints(*poses: str) -> Dataset:
    return Dataset.from_arrays({"q": np.arange(len(poses)) / 10}, poses=poses)


def tracker(*poses: str, name: str = "x") -> Dataset:
    return Dataset.from_arrays({name: np.arange(len(poses)) + 1.0}, poses=poses)


def test_readings_meet_by_id_whatever_their_order() -> None:
    joined = join([joints("a", "b", "c"), tracker("c", "a", "b")], [True, False])
    assert joined.dataset.poses == ("a", "b", "c")
    assert joined.dataset["x"].tolist() == [2.0, 3.0, 1.0]
    assert joined.left_out == ()


def test_poses_without_joints_or_without_any_instrument_are_left_out_and_told() -> None:
    parts = [joints("a", "b", "c", "d"), tracker("b", "z"), tracker("c", name="y")]
    joined = join(parts, [True, False, False])
    assert joined.dataset.poses == ("b", "c")
    assert np.array_equal(joined.dataset["x"], [1.0, np.nan], equal_nan=True)
    assert np.array_equal(joined.dataset["y"], [np.nan, 1.0], equal_nan=True)
    assert joined.left_out == (("part 1", ("a", "d")), ("part 2", ("z",)))


def test_joints_in_two_files_are_needed_from_both() -> None:
    other = Dataset.from_arrays({"q2": [0.5, 0.6]}, poses=["b", "c"])
    joined = join([joints("a", "b", "c"), other, tracker("a", "b")], [True, True, False])
    assert joined.dataset.poses == ("b",)


def test_sds_come_along() -> None:
    with_sd = Dataset.from_arrays({"x": [1.0], "u": [0.1]}, poses=["b"], sds={"x": "u"})
    joined = join([joints("a", "b"), with_sd], [True, False])
    assert joined.dataset.sds["x"].tolist() == [0.1]


@pytest.mark.parametrize(
    ("parts", "code", "stated"),
    [
        ([joints("a", "a"), tracker("a")], "duplicate-name", ("twice",)),
        ([joints("a"), joints("a")], "duplicate-column", ("'q'",)),
        ([joints("a"), tracker("b")], "mismatched-poses", ("part 1", "part 2")),
    ],
)
def test_what_cannot_be_joined_is_refused(
    parts: list[Dataset], code: Code, stated: tuple[str, ...]
) -> None:
    with refused(code, *stated) as caught:
        join(parts, [True, False])
    assert caught.value.remedy
