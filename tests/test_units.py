"""Units: known factors, round trips, spellings, and a message that names the nearest unit."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from loopcal.errors import InputError
from loopcal.units import (
    _UNITS,
    SI,
    Unit,
    convertible,
    difference_from_si,
    difference_to_si,
    from_si,
    to_si,
    unit,
)
from tests.refusals import refused

# Definitions, from the SI brochure (9th edition) and the international inch of 1959.
FACTORS = {
    "m": 1.0,
    "cm": 0.01,
    "mm": 0.001,
    "um": 1e-6,
    "nm": 1e-9,
    "in": 0.0254,
    "rad": 1.0,
    "mrad": 1e-3,
    "urad": 1e-6,
    "deg": 0.017453292519943295,
    "arcmin": 2.908882086657216e-4,
    "arcsec": 4.84813681109536e-6,
    "turn": 6.283185307179586,
    "gon": 0.015707963267948967,
    "px": 1.0,
    "1": 1.0,
    "ppm": 1e-6,
    "kg": 1.0,
    "g": 1e-3,
    "N": 1.0,
    "s": 1.0,
    "ms": 1e-3,
    "us": 1e-6,
    "ns": 1e-9,
    "K": 1.0,
    "mK": 1e-3,
}
COMPOSED = {
    "rad/m": 1.0,
    "mrad/m": 1e-3,
    "urad/m": 1e-6,
    "rad/(N m)": 1.0,
    "urad/(N m)": 1e-6,
    "m/N": 1.0,
    "um/N": 1e-6,
    "um/K": 1e-6,
    "mm/mK": 1.0,
    "arcsec/degC": FACTORS["arcsec"],
}
FACTORS |= COMPOSED
NAMES = sorted([*(name for name in _UNITS if not _UNITS[name].zero), *COMPOSED])


@pytest.mark.parametrize("name", NAMES)
def test_one_of_a_unit_is_its_definition_in_si(name: str) -> None:
    assert to_si(1.0, name) == pytest.approx(FACTORS[name], rel=1e-15)


@given(st.sampled_from(NAMES), st.floats(-1e12, 1e12))
def test_there_and_back_is_the_same_value(name: str, value: float) -> None:
    assert from_si(to_si(value, name), name) == pytest.approx(value, rel=4e-16, abs=1e-300)


@given(st.sampled_from(NAMES), st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=8))
def test_an_array_is_converted_value_by_value(name: str, values: list[float]) -> None:
    array = np.array(values).reshape(1, -1)
    converted = to_si(array, name)
    assert converted.shape == array.shape
    assert converted.tolist() == [[to_si(value, name) for value in values]]
    np.testing.assert_array_equal(array, [values], err_msg="the input stays as it was")


@pytest.mark.parametrize("value", [math.inf, -math.inf])
def test_infinite_stays_infinite_in_every_unit(value: float) -> None:
    assert {to_si(value, name) for name in NAMES} == {value}


@pytest.mark.parametrize("name", NAMES)
def test_the_si_unit_of_a_dimension_has_factor_one(name: str) -> None:
    si = unit(unit(name).si)
    assert si == Unit(si.name, unit(name).dimension, 1.0)
    assert name in COMPOSED or si.name == SI[unit(name).dimension]
    assert convertible(name, si.name)


def test_celsius_has_a_zero_and_differences_have_none() -> None:
    assert to_si(20.0, "degC") == 293.15
    assert from_si(293.15, "°C") == 20.0
    assert difference_to_si(0.1, "degC") == difference_from_si(0.1, "degC") == 0.1
    np.testing.assert_array_equal(to_si(np.array([-273.15, 0.0]), "degC"), [0.0, 273.15])
    assert convertible("degC", "K")


def test_in_a_composed_unit_a_temperature_is_a_difference() -> None:
    assert to_si(2.0, "um/degC") == to_si(2.0, "um/K") == 2e-6
    assert unit("µm/°C").name == "um/degC"
    assert unit("um/degC").si == "m/K"
    assert convertible("mm/K", "um/degC")
    assert not convertible("mm/K", "rad/K")


@pytest.mark.parametrize("name", ["m/", "/K", "m/K/s", "m/(K", "m/()", "m/(K kg) s", "m/kelvin"])
def test_what_does_not_compose_is_not_known(name: str) -> None:
    with refused("unknown-unit"):
        unit(name)


@pytest.mark.parametrize(
    ("spelling", "name"),
    [
        ("µm", "um"),
        ("μm", "um"),  # micro sign and Greek mu are different characters
        ("micron", "um"),
        ("inch", "in"),
        ("µrad", "urad"),
        ("°", "deg"),
        ("degrees", "deg"),
        ("arcseconds", "arcsec"),
        ('"', "arcsec"),
        ("″", "arcsec"),
        ("arcminute", "arcmin"),
        ("", "1"),
        ("-", "1"),
        ("  mm ", "mm"),
    ],
)
def test_spellings_of_one_unit_are_one_unit(spelling: str, name: str) -> None:
    assert unit(spelling) is unit(name)


@given(st.sampled_from(NAMES), st.sampled_from(NAMES))
def test_units_convert_when_their_dimensions_agree(name: str, other: str) -> None:
    assert convertible(name, other) == (unit(name).dimension == unit(other).dimension)
    assert convertible(name, other) == convertible(other, name)


@pytest.mark.parametrize(
    ("typed", "meant"), [("mmm", "mm"), ("arcsecs", "arcsec"), ("degr", "deg"), ("mrd", "mrad")]
)
def test_an_unknown_unit_is_told_the_nearest(typed: str, meant: str) -> None:
    with pytest.raises(InputError) as caught:
        unit(typed)
    assert str(caught.value) == (
        f"unit {typed!r} is not known\n  What to do: did you mean {meant!r}?"
    )


def test_case_is_kept_apart() -> None:
    # "MM" may be mega: what would mislead raises.
    for name in ("MM", "Rad", "M"):
        with refused("unknown-unit"):
            unit(name)
