"""Makers' figures in [noise]: what they become, and where a mistake in them stands."""

from __future__ import annotations

import math

import numpy as np
import pytest

import loopcal as lc
from loopcal.errors import InputError
from loopcal.files.project.project_file import read_project

HEAD = 'schema = 1\n[mechanism]\ntype = "serial"\njoint = [{ name = "q_1" }, { name = "q_2" }]\n'


def entries(text: str):
    return dict(read_project("-", text=f"{HEAD}[noise]\n{text}").noise.entries)


def test_encoders_rounding_and_an_sd_add_in_quadrature():
    text = '"q_*" = { encoder = { bits = 12 }, rounded_to = 0.1, sd = 0.02, unit = "deg" }'
    parts = [2 * math.pi / 4096 / 12**0.5, math.radians(0.1) / 12**0.5, math.radians(0.02)]
    found = entries(text)
    assert found == pytest.approx(dict.fromkeys(["q_1", "q_2"], math.hypot(*parts)))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("{ encoder = { counts = 4096 } }", lc.encoder_sd(counts=4096)),
        ('{ encoder = { accuracy = "5 arcsec", kind = "mpe" } }', math.radians(2.5 / 3600)),
        ('{ encoder = { accuracy = "5 arcsec", kind = "sd" } }', math.radians(5 / 3600)),
        ('{ encoder = { accuracy = "3 mrad", coverage = "uniform" } }', 3e-3 / 3**0.5),
        ("{ encoder = { bits = 17, gear = 50 } }", lc.encoder_sd(bits=17) / 50),
        ('{ rounded_to = 0.1, unit = "deg" }', math.radians(0.1) / 12**0.5),
    ],
)
def test_an_encoder_in_every_spelling(text, expected):
    assert entries(f"q_1 = {text}") == pytest.approx({"q_1": expected})


@pytest.mark.parametrize(
    "text",
    [
        'xyz = { tracker = "leica-at500" }',
        '"x,y,z" = { tracker = { name = "leica-at500" } }',
        'xyz = { tracker = { range = "10 um + 0.3 um/m", transverse = "15 um + 6 um/m" } }',
        'xyz = { tracker = { range = "5 um + 0.15 um/m", transverse = "7.5um+3um/m", kind="sd" } }',
    ],
)
def test_a_tracker_by_name_or_figures(text):
    points = [[1.0, 2.0, 3.0], [4.0, 0.0, -1.0]]
    found = entries(text)[("x", "y", "z")].covariance(points)
    np.testing.assert_allclose(found, lc.tracker_covariance(points, "leica-at500"), atol=1e-22)


def test_the_station_and_rounding_are_in_the_unit_of_the_entry():
    text = (
        'xyz = { tracker = "leica-at500", station = [0, 0, 500], rounded_to = 0.01, unit = "mm" }'
    )
    found = entries(text)[("x", "y", "z")]
    assert found.station == pytest.approx((0, 0, 0.5))
    assert found.rounding == pytest.approx(1e-5 / 12**0.5)


@pytest.mark.parametrize(
    ("text", "place", "words"),
    [
        ('xyz = { tracker = "leica-at50" }', "noise.xyz.tracker", "leica-at500"),
        ("xyz = { tracker = 5 }", "noise.xyz.tracker", "name"),
        ('x = { tracker = "leica-at500" }', "noise.x.tracker", "not x"),
        ('"q_1,q_2" = { tracker = "leica-at500" }', 'noise."q_1,q_2".tracker', "not q_1, q_2"),
        ('xyz = { tracker = "leica-at500", sd = 1 }', "noise.xyz", "sd"),
        ('xyz = { tracker = { range = "10 um" } }', "noise.xyz.tracker", "transverse"),
        (
            'xyz = { tracker = { range = "ten um", transverse = "1 um" } }',
            "noise.xyz.tracker",
            "cannot be read",
        ),
        (
            'xyz = { tracker = { range = "10 kg", transverse = "1 um" } }',
            "noise.xyz.tracker",
            "'10 kg'",
        ),
        (
            'xyz = { tracker = { range = "10 furlong", transverse = "1 um" } }',
            "noise.xyz.tracker",
            "furlong",
        ),
        ('xyz = { tracker = { ranje = "10 um" } }', "noise.xyz.tracker.ranje", "range"),
        ('xyz = { tracker = "leica-at500", station = [1, 2] }', "noise.xyz.station", "2 coord"),
        ('xyz = { tracker = "leica-at500", unit = "deg" }', "noise.xyz.unit", "angle"),
        ("xyz = { station = [1, 2, 3], sd = 1 }", "noise.xyz.station", "tracker"),
        ("x = { encoder = { bits = 20 } }", "noise.x.encoder", "angle"),
        ('q_1 = { encoder = { accuracy = "5 um" } }', "noise.q_1.encoder.accuracy", "length"),
        ('q_1 = { encoder = { accuracy = "5" } }', "noise.q_1.encoder", "cannot be read"),
        ("q_1 = { encoder = { bits = 0 } }", "noise.q_1.encoder.bits", "too small"),
        ("q_1 = { encoder = { bits = 20, counts = 5 } }", "noise.q_1.encoder", "both"),
        ("q_1 = { encoder = {} }", "noise.q_1.encoder", "encoder"),
        ('q_1 = { encoder = { bits = 3, kind = "mpe" } }', "noise.q_1.encoder", "accuracy"),
        ("q_1 = { rounded_to = -1 }", "noise.q_1.rounded_to", "too small"),
        ('q_1 = { rounded_to = 1, unit = "mm" }', "noise.q_1.unit", "length"),
        ("q_1 = {}", "noise.q_1", "no sd"),
        ("q_1 = { rounded_to = 1, covariance = [[1]] }", "noise.q_1", "rounded_to and covariance"),
    ],
)
def test_a_mistake_is_named_where_it_stands(text, place, words):
    with pytest.raises(InputError) as caught:
        entries(text)
    assert (caught.value.place or "").endswith(f": {place}")
    assert words in str(caught.value)
    assert caught.value.remedy


def test_a_tracker_of_ranges_and_angles_is_known_by_their_units():
    text = """schema = 1
mechanism = { type = "serial", joint = [{ name = "q" }], instrument = [{ type = "spherical" }] }
[noise]
"tracker_range,tracker_azimuth,tracker_elevation" = { tracker = "leica-at500" }
"""
    found = dict(read_project("-", text=text).noise.entries)
    tracker = found[("tracker_range", "tracker_azimuth", "tracker_elevation")]
    assert tracker == lc.Tracker.of("leica-at500", native=True)
