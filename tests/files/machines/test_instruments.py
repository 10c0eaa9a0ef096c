"""Instruments in mechanism files: read, refused and written as they were."""

from __future__ import annotations

import numpy as np
import pytest

from loopcal.errors import Code
from loopcal.files.machines.mechanism_file import mechanism_from_data
from loopcal.files.machines.mechanism_writer import mechanism_to_toml
from loopcal.files.toml.place import Place
from loopcal.files.toml.reader import toml_data
from loopcal.measurements.noise import Noise
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.simulation.simulate import simulate
from tests.refusals import refused

ARM = """
type = "serial"
[[joint]]
name = "q1"
a = 0.4
alpha = 1.0
[[joint]]
name = "q2"
a = 0.3
"""
TWO_STATIONS = """
[[instrument]]
type = "point"
name = "east"
readings = ["x_east", "y_east", "z_east"]
station = "east"
[[instrument]]
type = "point"
name = "west"
readings = ["x_west", "y_west", "z_west"]
station = "west"
target = "elbow"
[parameters]
east_x = 2.0
"""


def read(text: str) -> Mechanism:
    data = {k: v for k, v in toml_data(text, "arm.toml").items() if k != "schema"}
    return mechanism_from_data(data, Place("arm.toml"))


def test_stations_and_targets_are_named_and_written_again_bit_for_bit() -> None:
    mechanism = read(ARM + TWO_STATIONS)
    assert mechanism.parameters.names[:2] == ("east_x", "east_y")
    assert mechanism.parameters["east_x"].nominal == 2.0
    assert {"west_rx", "tool_z", "elbow_x"} <= set(mechanism.parameters.names)
    assert [family.name for family in mechanism.families] == ["east", "west"]
    again = read(mechanism_to_toml(mechanism))
    assert again == mechanism


EVERY_TYPE = """
[[instrument]]
type = "spherical"
name = "T1"
readings = ["d", "az", "el"]
target = "ball"
offsets = true
[[instrument]]
type = "spherical"
name = "T1b"
station = "T1"
offsets = true
[[instrument]]
type = "pose"
orientation = "rz ry rx"
columns = ["A", "B", "C"]
station = "camera"
[[instrument]]
type = "pose"
name = "frame"
readings = ["fx", "fy", "fz"]
target = []
[[instrument]]
type = "distance"
anchor = "pin"
offset = true
[[instrument]]
type = "draw-wire"
[[instrument]]
type = "relative-distance"
target = ["tool_x", "tool_y", "tool_z"]
[[instrument]]
type = "ball-bar"
centre = "pin"
[[instrument]]
type = "sphere"
[[instrument]]
type = "plane"
normal = [0.1, 0.7, 0.3]
[[instrument]]
type = "socket"
gaps = ["g1", "g2", "g3"]
[parameters]
wire_x = { value = 300, unit = "mm", sd = 10 }
bar_length = { value = 0.3, fixed = true }
"""


def test_every_type_of_instrument_is_written_again_bit_for_bit() -> None:
    mechanism = read(ARM + EVERY_TYPE)
    assert mechanism.description is not None
    assert {i["type"] for i in mechanism.description["instrument"]} == {
        *("spherical", "pose", "distance", "draw-wire", "relative-distance"),
        *("ball-bar", "sphere", "plane", "socket"),
    }
    assert mechanism.parameters["wire_x"].nominal == 0.3
    assert {"T1_range_offset", "pin_x", "tool_rz", "plane_tilt_2"} <= set(
        mechanism.parameters.names
    )
    again = read(mechanism_to_toml(mechanism))
    assert again == mechanism


def test_an_arm_without_instruments_has_no_loop_and_says_so() -> None:
    with refused("undetermined-quantities", "'serial arm'"):
        read("instrument = []\n" + ARM)


@pytest.mark.parametrize(
    ("text", "code", "stated"),
    [
        (ARM + '[[instrument]]\ntype = "pointt"\n', "unknown-name", ("pointt",)),
        (
            ARM + '[[instrument]]\ntype = "point"\nreadings = ["x"]\n',
            "wrong-shape",
            ("1", "'point'"),
        ),
        (
            ARM + '[[instrument]]\ntype = "point"\nreadings = ["x", "y", "q1"]\n',
            "duplicate-name",
            ("'q1'",),
        ),
        (ARM + 2 * '[[instrument]]\ntype = "point"\n', "duplicate-name", ("'x'",)),
        (ARM.replace('"q1"', '"a_2"'), "duplicate-name", ("'a_2'", "reading", "'read_a_2'")),
        (ARM + '[[instrument]]\nname = "T"\n', "missing-key", ("'type'",)),
        (
            ARM + '[[instrument]]\ntype = "spherical"\nreadings = ["r"]\n',
            "wrong-shape",
            ("1", "'tracker'"),
        ),
        (
            ARM + '[[instrument]]\ntype = "pose"\norientation = "rz rz rx"\n',
            "unknown-name",
            ("'rz rz rx'",),
        ),
        (
            ARM + '[[instrument]]\ntype = "pose"\ncolumns = ["q"]\n',
            "wrong-shape",
            ("1", "'quaternion'"),
        ),
        (
            ARM + '[[instrument]]\ntype = "pose"\nturns = ["a", "b"]\n',
            "wrong-shape",
            ("2", "'pose'"),
        ),
        (
            ARM + '[[instrument]]\ntype = "pose"\ntarget = ["a", "b", "c"]\n',
            "missing-key",
            ("'pose'",),
        ),
        (
            ARM + '[[instrument]]\ntype = "plane"\nnormal = [0, 0, 0]\n',
            "invalid-value",
            ("'plane'",),
        ),
        (ARM + '[[instrument]]\ntype = "socket"\ngaps = ["a"]\n', "wrong-shape", ("1", "'socket'")),
        (
            ARM + 2 * '[[instrument]]\ntype = "spherical"\nname = "T1"\n',
            "duplicate-name",
            ("'T1_range'",),
        ),
        (
            ARM
            + '[[instrument]]\ntype = "spherical"\nname = "T1"\n'
            + '[[instrument]]\ntype = "draw-wire"\nname = "w"\nanchor = "T1"\n',
            "duplicate-name",
            ("'T1_x'",),
        ),
        (
            ARM + '[[instrument]]\ntype = "spherical"\nname = "T1"\ntarget = "T1"\n',
            "duplicate-name",
            ("'T1_x'",),
        ),
        (
            "base = true\n" + ARM + '[[instrument]]\ntype = "point"\n',
            "conflicting-keys",
            ("'base'",),
        ),
    ],
)
def test_instruments_that_do_not_fit_are_refused(
    text: str, code: Code, stated: tuple[str, ...]
) -> None:
    with refused(code, *stated) as caught:
        read(text)
    assert str(caught.value).startswith("arm.toml")
    assert caught.value.remedy


def test_the_planar_arm_is_looked_at_by_any_instrument_too() -> None:
    text = """
type = "planar-two-link"
[[instrument]]
type = "spherical"
target = []
[[instrument]]
type = "draw-wire"
target = []
"""
    arm = read(text)
    assert arm.parameters["phi20"].fixed
    in_base = text.replace('"spherical"', '"point"\nstation = false')
    assert not read(in_base).parameters["phi20"].fixed
    assert list(arm.quantities) == ["phi2", "phi3", "tracker_range", "tracker_azimuth", "wire"]
    exact = Noise({"*": 0.0})
    made = simulate(arm, {"phi2": [0.3], "phi3": [0.9]}, noise=exact, seed=0)
    assert made.dataset["tracker_range"] == pytest.approx(abs(0.8 + 0.6 * np.exp(0.9j)))
    assert read(mechanism_to_toml(arm)) == arm
