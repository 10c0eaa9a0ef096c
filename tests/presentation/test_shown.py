"""SI values are printed in the units that people read."""

from __future__ import annotations

import pytest

from loopcal.presentation.shown import by_sd


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (-4.04e-19, "m", "0"),
        (3e-17, "rad", "0"),
        (2e-12, "m", "2e-09"),
        (-4.04e-19, "1/N", "-4.04e-19"),
    ],
)
def test_what_arithmetic_leaves_of_a_length_or_angle_of_zero_is_zero(
    value: float, unit: str, text: str
) -> None:
    assert by_sd(value, None, unit) == text


def test_a_value_with_an_sd_keeps_the_digits_of_its_sd() -> None:
    assert by_sd(4e-13, 1e-13, "m") == "0.00000000040"
