"""Numbers are printed with as many digits as their sd supports, and never more."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from loopcal.presentation.shown import by_sd, rounded_by_sd, significant


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [
        (0.0, 3, "0"),
        (0.0735123, 3, "0.0735"),
        (-0.0735123, 3, "-0.0735"),
        (123.456, 4, "123.5"),
        (123.456, 2, "123"),
        (1234567.0, 3, "1234567"),
        (1.0, 3, "1.00"),
        (0.00012345, 2, "0.00012"),
        (0.000012345, 2, "1.2e-05"),
        (2.0e-7, 2, "2.0e-07"),
        (1.5e9, 3, "1.50e+09"),
        (math.inf, 3, "inf"),
        (math.nan, 3, "nan"),
    ],
)
def test_significant_digits(value: float, digits: int, text: str) -> None:
    assert significant(value, digits) == text


@pytest.mark.parametrize(
    ("value", "sd", "text"),
    [
        (614.87123, 0.0213, "614.871"),
        (614.87123, 0.213, "614.87"),
        (614.87123, 2.13, "614.9"),
        (614.87123, 21.3, "615"),
        (614.87123, 2130.0, "615"),
        (-0.5, 0.0001, "-0.50000"),
        (1e-7, 1e-9, "0.0000001000"),
        (0.1, 1e-20, "0.1"),
        (0.123456789012, 0.0, "0.123456789"),
        (0.123456789012, math.inf, "0.123456789"),
        (0.123456789012, math.nan, "0.123456789"),
    ],
)
def test_a_value_ends_with_the_second_digit_of_its_sd(value: float, sd: float, text: str) -> None:
    assert rounded_by_sd(value, sd) == text


@pytest.mark.parametrize("value", [-0.0, -1e-9, -0.00049])
def test_a_value_that_rounds_to_zero_has_no_minus(value: float) -> None:
    assert rounded_by_sd(value, 0.0213) == "0.000"
    assert rounded_by_sd(value, 0.0213, sign=True) == "+0.000"


def test_a_value_without_sd_has_no_trailing_zeros() -> None:
    assert rounded_by_sd(450.0, math.inf) == "450"
    assert rounded_by_sd(-0.0, math.inf) == "0"
    assert by_sd(-0.353553, None, "m") == "-353.553"


def test_a_change_shows_its_sign() -> None:
    assert rounded_by_sd(0.871, 0.0213, sign=True) == "+0.871"
    assert rounded_by_sd(-0.871, 0.0213, sign=True) == "-0.871"


@given(st.floats(-1e6, 1e6), st.floats(1e-6, 1e6))
def test_what_rounding_drops_is_small_beside_the_sd(value: float, sd: float) -> None:
    dropped = abs(float(rounded_by_sd(value, sd)) - value)
    assert dropped <= max(0.051 * sd, 0.51 if sd > 10 else 0.0)


@given(st.floats(-1e12, 1e12), st.integers(1, 6))
def test_what_is_significant_is_kept(value: float, digits: int) -> None:
    text = significant(value, digits)
    assert float(text) == pytest.approx(value, rel=0.51 * 10 ** (1 - digits), abs=1e-300)
