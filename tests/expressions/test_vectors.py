"""Vectors and rotations obey the laws of space, on plain numbers, arrays and traced values."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from loopcal.expressions.trace import trace
from loopcal.expressions.vectors import cross, dot, norm, rot_x, rot_y, rot_z, rotate, vector
from tests.reference.plain_tape import loop_values
from tests.refusals import refused

ROTATIONS: dict[str, Callable[[Any], Any]] = {"x": rot_x, "y": rot_y, "z": rot_z}
AXES = st.sampled_from("xyz")
ANGLES = st.floats(-10, 10)
VECTORS = st.lists(st.floats(-5, 5), min_size=3, max_size=3).map(np.array)


@given(AXES, ANGLES, VECTORS)
def test_rotate_is_the_matrix_times_the_vector(axis: str, angle: float, v: Any) -> None:
    assert rotate(axis, angle, v) == pytest.approx(ROTATIONS[axis](angle) @ v, abs=1e-14)


@given(AXES, ANGLES)
def test_rotations_are_orthogonal_and_right_handed(axis: str, angle: float) -> None:
    R = ROTATIONS[axis](angle)
    assert abs(R @ R.T - np.eye(3)).max() <= 1e-15
    assert np.linalg.det(R) == pytest.approx(1.0, abs=1e-15)


@given(AXES, ANGLES, ANGLES)
def test_angles_about_one_axis_add(axis: str, first: float, second: float) -> None:
    R = ROTATIONS[axis]
    assert R(first) @ R(second) == pytest.approx(R(first + second), abs=1e-14)


@pytest.mark.parametrize(("axis", "first", "second"), [("z", 0, 1), ("x", 1, 2), ("y", 2, 0)])
def test_a_quarter_turn_takes_each_axis_to_the_next(axis: str, first: int, second: int) -> None:
    unit = np.eye(3)
    assert rotate(axis, np.pi / 2, unit[first]) == pytest.approx(unit[second], abs=1e-15)
    assert rotate(axis, np.pi / 2, unit["xyz".index(axis)]) == pytest.approx(
        unit["xyz".index(axis)], abs=1e-15
    )


@given(VECTORS, VECTORS)
def test_products_are_those_of_numpy(a: Any, b: Any) -> None:
    assert dot(a, b) == pytest.approx(np.dot(a, b), abs=1e-13)
    assert cross(a, b) == pytest.approx(np.cross(a, b), abs=1e-13)
    assert norm(a) == pytest.approx(np.linalg.norm(a), abs=1e-13)


def test_arrays_of_poses_are_turned_one_by_one() -> None:
    angles = np.linspace(-3, 3, 7)
    v = vector(1.0, angles, 0.5)
    assert v.shape == (3, 7)
    turned = rotate("y", angles, v)
    for i, angle in enumerate(angles):
        assert turned[:, i] == pytest.approx(rot_y(angle) @ v[:, i], abs=1e-15)
    assert norm(turned) == pytest.approx(norm(v))


def test_traced_vectors_mean_the_same_as_plain_ones() -> None:
    def loops(x: Any, p: Any) -> Any:
        tip = rot_z(x["t"]) @ (rotate("x", p["k"], vector(x["a"], 0.5, 0.0)) + vector(0, 1, 2))
        return [*cross(tip, vector(1.0, x["a"], 2.0)), dot(tip, tip), norm(tip) + x["t"]]

    t, a, k = 0.7, 1.3, -0.4
    tape = trace(loops, quantities="ta", parameters="k")
    expected = loops({"t": t, "a": a}, {"k": k})
    assert loop_values(tape, [t, a], [k]) == pytest.approx(np.array(expected), rel=1e-14)


def test_a_matrix_of_traced_angles_multiplies_as_a_matrix() -> None:
    def loops(x: Any, p: Any) -> Any:
        return (rot_x(x["t"]) @ rot_y(p["k"]) @ rot_z(0.3)).ravel() + x["t"]

    tape = trace(loops, quantities="t", parameters="k")
    expected = loops({"t": 0.7}, {"k": -0.4})
    assert loop_values(tape, [0.7], [-0.4]) == pytest.approx(expected, rel=1e-14)


def test_an_axis_that_is_none_is_refused() -> None:
    with refused("invalid-value", "'w'", "'x'", "'y'", "'z'"):
        rotate("w", 0.1, [1.0, 2.0, 3.0])
