"""A joint about any axis turns as Rodrigues' formula says; directions must be directions."""

from __future__ import annotations

import math

import numpy as np
import pytest

from loopcal.mechanisms.chain import AxisFrame, Step, product, unit_direction
from tests.refusals import refused

AXES = [(1, 0, 0), (0, -1, 0), (0, 0, 1), (0.6, 0, -0.8), (2 / 3, -1 / 3, 2 / 3)]


def rodrigues(axis, angle):
    x, y, z = axis
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(angle) * K + (1 - math.cos(angle)) * K @ K


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize("angle", [0.7, -2.9])
def test_a_revolute_joint_turns_about_its_axis(axis, angle):
    T = product(AxisFrame.of(axis, "q").moving("q", "revolute"), {"q": angle}, {})
    np.testing.assert_allclose(T[:3, :3], rodrigues(axis, angle), atol=1e-15)
    np.testing.assert_array_equal(T[:3, 3], 0.0)


@pytest.mark.parametrize("axis", AXES)
def test_a_prismatic_joint_moves_along_it(axis):
    steps = AxisFrame.of(axis, "q").moving("q", "prismatic", (), -2.0, 0.1)
    T = product(steps, {"q": 0.3}, {})
    np.testing.assert_allclose(T[:3, 3], (0.1 - 0.6) * np.array(axis), atol=1e-15)
    np.testing.assert_allclose(T[:3, :3], np.eye(3), atol=1e-15)


@pytest.mark.parametrize("axis", AXES)
def test_its_own_parameters_move_the_axis_alone(axis):
    frame = AxisFrame.of(axis, "q")
    own = [Step("t" + frame.letters[0], "shift"), Step("r" + frame.letters[1], "tilt")]
    steps = frame.moving("q", "revolute", own)
    at_zero = product(steps, {"q": 0.0}, {"shift": 0.2, "tilt": 0.3})
    np.testing.assert_allclose(at_zero, np.eye(4), atol=1e-15)
    turned = product(steps, {"q": 0.5}, {"shift": 0.2, "tilt": 0.3})
    values, vectors = np.linalg.eig(turned[:3, :3])
    direction = np.real(vectors[:, np.argmin(np.abs(values - 1.0))])
    assert abs(direction @ np.array(axis)) == pytest.approx(math.cos(0.3), abs=1e-12)


@pytest.mark.parametrize(
    ("axis", "code", "stated"),
    [
        ((0, 0, 0), "invalid-value", ("'elbow'",)),
        ((1, 1, 0), "invalid-value", ("1.41421", "'elbow'")),
        ((0, math.nan, 1), "invalid-value", ("'elbow'",)),
    ],
)
def test_what_is_no_direction_is_refused(axis, code, stated):
    with refused(code, *stated) as raised:
        unit_direction(axis, "elbow")
    assert "'elbow'" in raised.value.message
    assert raised.value.remedy


def test_a_direction_rounded_to_four_digits_is_one():
    assert np.linalg.norm(unit_direction((0.7071, 0.0, 0.7071), "q")) == pytest.approx(1, abs=1e-15)
