"""A mechanism written and read again is the same machine, bit for bit."""

from __future__ import annotations

import math
import tomllib
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import loopcal as lc
from loopcal.files.machines.mechanism_file import mechanism_from_data
from loopcal.files.machines.mechanism_writer import mechanism_to_toml
from loopcal.mechanisms.chain import MOTIONS
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parameters import Parameters
from loopcal.mechanisms.planar import motoman_ma1400, planar_two_link
from loopcal.mechanisms.serial import FORMS, Joint, serial_arm

numbers = st.floats(-1e6, 1e6) | st.floats(allow_nan=False, allow_infinity=False)
motions = st.dictionaries(st.sampled_from(MOTIONS), numbers, max_size=3)
names = st.text("abcdefgxyz_0123456789.-äµ\"'\\#=", min_size=1, max_size=8)


@st.composite
def arms(draw: st.DrawFn) -> Mechanism:
    labels = draw(st.lists(names, min_size=4, max_size=7, unique=True))
    joints = [
        Joint(
            name,
            draw(st.sampled_from(FORMS)),
            draw(st.sampled_from(["revolute", "prismatic"])),
            draw(st.sampled_from([1, -1])),
            draw(motions),
            draw(motions),
        )
        for name in labels[3:]
    ]
    x, y, z = labels[:3]
    base = draw(st.sampled_from([True, False, None]))
    return serial_arm(joints, {}, base=base, point=(x, y, z), name=draw(st.text(max_size=20)))


@st.composite
def known_better(draw: st.DrawFn, mechanisms: st.SearchStrategy[Mechanism]) -> Mechanism:
    mechanism = draw(mechanisms)
    items = [
        replace(
            parameter,
            nominal=draw(numbers),
            prior_sd=draw(st.floats(0.0, allow_nan=False)),
            fixed=draw(st.booleans()),
        )
        for parameter in mechanism.parameters
    ]
    return mechanism.with_parameters(Parameters(tuple(items)))


def bits(mechanism: Mechanism) -> list[object]:
    return [(p.name, p.nominal.hex(), p.unit, p.prior_sd, p.fixed) for p in mechanism.parameters]


def read_again(mechanism: Mechanism, function=None) -> Mechanism:
    data = tomllib.loads(mechanism_to_toml(mechanism))
    assert data.pop("schema") == 1
    return mechanism_from_data(data, "again.toml", function=function)


def assert_same(one: Mechanism, other: Mechanism) -> None:
    assert one.tape == other.tape
    assert bits(one) == bits(other)
    assert (one.name, one.outputs, one.description) == (
        other.name,
        other.outputs,
        other.description,
    )
    assert dict(one.quantities) == dict(other.quantities)


@settings(max_examples=60)
@given(known_better(arms()))
def test_any_serial_arm_survives(arm):
    again = read_again(arm)
    assert_same(again, arm)
    assert mechanism_to_toml(again) == mechanism_to_toml(arm)


def expanding(arm: Mechanism) -> Mechanism:
    return lc.with_effects(arm, [lc.effects.Thermal()])


@settings(max_examples=30)
@given(known_better(arms()).map(expanding))
def test_lengths_that_expand_survive_whatever_they_are(arm):
    assert_same(read_again(arm), arm)


READY = [
    planar_two_link(),
    planar_two_link(name="another name"),
    motoman_ma1400(),
    motoman_ma1400(before={"rz": math.pi / 2, "tx": 0.1}),
]


@settings(max_examples=30)
@given(known_better(st.sampled_from(READY)))
def test_ready_made_machines_survive(machine):
    assert_same(read_again(machine), machine)


def gain(x, p):
    return [x.a * p.gain + x.load * p.give - x.b]


def test_a_function_survives_but_for_its_code():
    made = Mechanism.from_function(
        gain,
        {"a": "m", "b": "m"},
        {"gain": (1 / 3, "1"), "give": (1e-9, "1")},
        ("b",),
        pose_constants={"load": "m"},
        loops=["balance"],
    )
    made = made.with_parameters(made.parameters.with_prior({"g*": 0.1}).with_fixed(["give"]))
    assert_same(read_again(made, gain), made)
    assert_same(read_again(made, made), made)
    assert "--mechanism" in mechanism_to_toml(made)


def test_the_file_says_what_it_is():
    text = mechanism_to_toml(motoman_ma1400())
    assert text.startswith("# Motoman MA1400: a mechanism file of loopcal")
    assert 'x1 = { value = 0.15, unit = "m" }' in text.splitlines()


@pytest.mark.parametrize("name", ["line\nbreak", "# hash", 'quote"', "", "\x07bell"])
def test_no_name_can_break_the_file(name):
    assert read_again(planar_two_link(name=name)).name == name
