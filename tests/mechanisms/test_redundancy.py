"""The set of parameters that readings determine: its size is the known one, whatever the arm."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest

from analyses.instruments import HOME, SCREWS, SIX, SLIDES, Z
from loopcal.expressions.engine import engine_for
from loopcal.files.machines.urdf import read_urdf
from loopcal.measurements.noise import Noise
from loopcal.mechanisms.exponentials import exponentials
from loopcal.mechanisms.instruments.contact import ball_bar, plane, socket, sphere
from loopcal.mechanisms.instruments.length import distance, draw_wire, relative_distance
from loopcal.mechanisms.instruments.point import point
from loopcal.mechanisms.instruments.pose import pose
from loopcal.mechanisms.instruments.spherical import spherical
from loopcal.mechanisms.machine import assemble
from loopcal.mechanisms.origins import LinkJoint, joint_chain
from loopcal.mechanisms.parallel.stewart_gough import stewart_gough
from loopcal.mechanisms.planar import planar_two_link
from loopcal.mechanisms.redundancy import fix_redundant, redundant, without_redundant
from loopcal.mechanisms.serial import Joint, serial_arm, serial_machine
from loopcal.simulation.poses import random_poses
from loopcal.simulation.simulate import simulate
from tests.reference.robots import CHAINS, urdf_of
from tests.refusals import refused

ARMS = {"six": (SIX, 6, 0), "slides": (SLIDES, 3, 2)}


def seen(joints, instrument, axes=False, ranges=None):
    """The mechanism with what is redundant fixed, its instrument preferred."""
    made = assemble(joint_chain(joints, axes=axes), [instrument], {"tool_z": 0.08})
    first = [*instrument.placement, *instrument.parameters]
    unsure = ["tool_x", "tool_y", "tool_z"]
    found = redundant(made, ranges=ranges or {}, first=first, unsure=unsure)
    return without_redundant(made, found)


def singular_values(mechanism, names, poses=150, seed=4):
    """Of the Jacobian by these parameters, with columns of length 1, the tool anywhere."""
    rng = np.random.default_rng(seed)
    engine = engine_for(mechanism.tape, tuple(names), poses)
    nominal = {p.name: p.nominal for p in mechanism.parameters} | {"tool_x": 0.04, "tool_y": -0.06}
    p = np.array([nominal[n] for n in mechanism.tape.parameters])
    spans = [pi if u == "rad" else 0.5 for u in mechanism.quantities.values()]
    x = np.array([rng.uniform(-s, s, poses) for s in spans])
    J = engine.evaluate(p, x).by_parameter.reshape(len(names), -1).T
    return np.linalg.svd(J / np.maximum(np.linalg.norm(J, axis=0), 1e-12), compute_uv=False)


@pytest.mark.parametrize("axes", [False, True])
@pytest.mark.parametrize("name", ARMS)
def test_four_of_a_revolute_two_of_a_prismatic_joint_and_six(name, axes):
    joints, revolute, prismatic = ARMS[name]
    whole = 4 * revolute + 2 * prismatic + 6  # Mooring, Roth and Driels (1991)
    assert len(seen(joints, pose(), axes).parameters.free) == whole
    assert len(seen(joints, point(), axes).parameters.free) == whole - 3


@pytest.mark.parametrize("axes", [False, True])
@pytest.mark.parametrize("name", ARMS)
def test_those_kept_are_independent_and_say_all(name, axes):
    arm = seen(ARMS[name][0], point(), axes)
    kept = singular_values(arm, arm.parameters.free)
    every = singular_values(arm, arm.parameters.names)
    assert kept[-1] > 1e-3
    assert int((every > 1e-6).sum()) == len(kept)


ROBOTS = [n for n in CHAINS if "mimicking" not in n]


@pytest.mark.parametrize("name", ROBOTS)
def test_robots_of_others_have_as_many(name):
    """`analyses/robots.py` does the same for every chain of all of them."""
    robot, base, tip = CHAINS[name]
    joints = read_urdf(urdf_of(robot), base, tip)
    ranges = {j.name: j.limits for j in joints if j.limits and j.mimic is None}
    kinds = [j.kind for j in joints]
    prismatic = kinds.count("prismatic")
    whole = 4 * (len(kinds) - kinds.count("fixed") - prismatic) + 2 * prismatic + 6
    for axes in (False, True):
        assert len(seen(joints, pose(), axes, ranges).parameters.free) == whole
        assert len(seen(joints, point(), axes, ranges).parameters.free) == whole - 3


@pytest.mark.parametrize(("axes", "limits"), [(False, (1e-11, 6e-3)), (True, (1e-5, 4e-4))])
@pytest.mark.parametrize("name", ROBOTS)
def test_the_choice_does_not_hang_on_its_limit(name, axes, limits, monkeypatch):
    robot, base, tip = CHAINS[name]
    joints = read_urdf(urdf_of(robot), base, tip)
    ranges = {j.name: j.limits for j in joints if j.limits and j.mimic is None}
    for instrument in (point(), pose()):
        chosen = seen(joints, instrument, axes, ranges).remarks
        for limit in limits:
            monkeypatch.setattr("loopcal.mechanisms.redundancy.ALIKE", limit)
            assert seen(joints, instrument, axes, ranges).remarks == chosen
        monkeypatch.undo()


INSTRUMENTS = {
    "point": (point(), 27),
    "spherical": (spherical("T"), 27),
    "pose": (pose(), 30),
    "distance": (distance("wire"), 24),
    "draw-wire": (draw_wire(), 25),
    "relative distance": (relative_distance(), 21),
    "sphere": (sphere(centre="centre"), 24),
    "ball-bar that measures": (ball_bar(centre="centre"), 25),
    "plane": (plane(), 23),
    "socket": (socket(), 23),
}
"""Instruments, and how many of an arm's and their own parameters they tell: `test_instruments`
counts the same numbers from readings."""


@pytest.mark.parametrize("instrument", INSTRUMENTS)
def test_other_instruments_tell_as_many_as_their_readings_do(instrument):
    looking, whole = INSTRUMENTS[instrument]
    made = assemble(joint_chain(SIX), [looking], {"tool_x": 0.05, "tool_z": 0.08})
    own = [*looking.placement, *looking.parameters]
    found = redundant(made, first=own, unsure=[n for n in own if not n.startswith("tool")])
    assert len(without_redundant(made, found).parameters.free) == whole


def test_exponentials_have_as_many():
    machine = exponentials(SCREWS, home=HOME)
    for instrument, whole in ((point(), 27), (pose(), 30)):
        made = assemble(machine, [instrument])
        first = [*instrument.placement, *instrument.parameters]
        found = redundant(made, first=first, unsure=list(instrument.parameters))
        assert len(made.parameters) - len(found) == whole


def test_a_dh_arm_loses_the_six_that_everyone_fixes():
    forms = ["dh", "hayati", "dh", "dh", "dh", "dh"]
    rows = [(0.15, -pi / 2), (0.6, 0), (0.12, -pi / 2), (0, pi / 2), (0, -pi / 2), (0, 0)]
    nominal = {f"{k}_{i}": v for i, r in enumerate(rows, 1) for k, v in zip(("a", "alpha"), r)}  # noqa: B905
    nominal |= {"d_1": 0.45, "d_4": 0.64, "d_6": 0.1, "offset_2": -pi / 2, "tool_x": 0.05}
    arm = serial_arm([Joint(f"q{i}", form) for i, form in enumerate(forms, 1)], nominal)
    first = [n for n in arm.parameters.names if n.startswith(("base", "tool"))]
    assert {r.parameter for r in redundant(arm, first=first)} == {
        "d_1", "offset_1", "a_6", "d_6", "alpha_6", "offset_6",
    }  # fmt: skip


def test_the_reasons_name_what_does_the_same():
    remarks = dict(zip(fixed(seen(SIX, point())), seen(SIX, point()).remarks, strict=True))
    assert remarks["q1_x"] == "'q1_x' is fixed: indistinguishable from 'base_x'."
    assert remarks["flange_z"] == "'flange_z' is fixed: indistinguishable from 'tool_z'."
    assert "combination of 'tool_x' and 'tool_y'." in remarks["q6_rz"]


def fixed(mechanism):
    return [p.name for p in mechanism.parameters if p.fixed]


def test_where_nothing_shows_a_parameter_the_reason_says_so():
    one = [LinkJoint("s", "prismatic", axis=Z), LinkJoint("r", "revolute", axis=Z)]
    arm = assemble(joint_chain(one), [point(station=None)], {"tool_x": 0.0})
    found = {r.parameter: r.words for r in redundant(arm, first=["tool_x", "tool_y", "tool_z"])}
    assert found["r_rz"] == "'r_rz' is fixed: it changes no reading."


def test_what_is_fixed_or_has_a_prior_makes_room_for_others():
    instrument = point()
    made = assemble(joint_chain(SIX), [instrument], {"tool_x": 0.05, "tool_z": 0.08})
    first = [*instrument.placement, *instrument.parameters]
    held = made.with_parameters(made.parameters.with_fixed(["base_*"]))
    found = {r.parameter for r in redundant(held, first=first)}
    assert not {n for n in found if n.startswith("q1_")}
    assert len(held.parameters.free) - len(found) == 27
    known = made.with_parameters(made.parameters.with_prior({"tool_*": 1e-3}))
    found = {r.parameter for r in redundant(known, first=first)}
    assert not {"tool_x", "tool_y", "tool_z"} & found
    assert len(made.parameters) - len(found) == 30
    # A guess is no knowledge: the flange need not do what the tool does.
    guessed = made.with_parameters(made.parameters.with_prior({"tool_*": 0.2}))
    assert redundant(guessed, first=first) == redundant(made, first=first)


def test_a_guess_of_zero_is_no_value_that_is_meant():
    """A target in the middle of a wrist would make its joints seem to do nothing."""
    rows = ((0.0, 0.4, 0.5), (0.42, 0.1, 0.0), (0.02, 0.1, 0.5), (0.0, 0.4, -0.5), (0.0, 0.0, 0.5))
    nominal = {
        f"{name}_{i}": value
        for i, (a, d, turn) in enumerate(rows, 1)
        for name, value in (("a", a), ("d", d), ("alpha", turn * pi))
    }
    joints = [Joint(f"q{i}") for i in range(1, 7)]
    made = assemble(serial_machine(joints), [point()], nominal)
    names = ["tool_x", "tool_y", "tool_z"]
    guess = made.with_parameters(made.parameters.with_prior(dict.fromkeys(names, 0.2)))
    free = {
        kind: len(fix_redundant(machine, stated=stated).parameters.free)
        for kind, machine, stated in (
            ("unknown", made, []),
            ("guessed", guess, names),
            ("meant", made, names),
        )
    }
    assert free["guessed"] == free["unknown"] > free["meant"]


def test_parameters_that_shall_be_free_are_kept_first():
    made = assemble(joint_chain(SIX), [point()], {"tool_x": 0.05, "tool_z": 0.08})
    found = {r.parameter for r in redundant(made, first=["flange_x", "flange_z", "q1_x"])}
    assert not found & {"flange_x", "flange_z", "q1_x"}
    assert len(made.parameters) - len(found) == 27


def test_what_nobody_reads_is_eliminated():
    arm = planar_two_link()
    assert redundant(arm) == ()
    # the second joint unread leaves one equation for each pose, and its offset changes nothing
    assert [r.words for r in redundant(arm, unmeasured=["phi3"])] == [
        "'phi30' is fixed: it changes no reading."
    ]


@pytest.mark.parametrize("instrument", INSTRUMENTS)
def test_in_one_step_with_nothing_said_of_the_instrument(instrument):
    looking, whole = INSTRUMENTS[instrument]
    made = fix_redundant(assemble(joint_chain(SIX), [looking]))
    assert len(made.parameters.free) == whole
    assert len(made.remarks) == len(made.parameters) - whole


def test_what_is_kept_stays_free_by_name_or_glob():
    made = assemble(joint_chain(SIX), [point()])
    assert "flange_z" not in fix_redundant(made).parameters.free
    kept = fix_redundant(made, keep=["flange_[xyz]"]).parameters.free
    assert {"flange_x", "flange_y", "flange_z"} < {*kept}
    assert len(kept) == 27
    every = fix_redundant(made, keep=["q1_*"]).parameters.free
    assert len([n for n in every if n.startswith("q1_")]) == 6
    with refused("unknown-name", "flangs_"):
        fix_redundant(made, keep=["flangs_*"])


def test_a_target_that_is_meant_to_stand_on_the_last_axis():
    """Then the tilts of that axis only move the target, which does as much by itself."""
    made = assemble(joint_chain(SIX), [point()])
    somewhere = {*fix_redundant(made).parameters.free}
    meant = {*fix_redundant(made, stated=["tool_x", "tool_y"]).parameters.free}
    held = made.with_parameters(made.parameters.with_fixed(["tool_x", "tool_y"]))
    assert len(somewhere) - len(meant) == 2
    assert {"tool_x", "tool_y"} < meant
    assert len(fix_redundant(held).parameters.free) == len(meant)


def test_a_platform_with_nothing_held_is_left_as_many_as_are_known():
    made = assemble(stewart_gough(), [pose(target="probe")])
    free = made.with_parameters(made.parameters.with_fixed(["*"], False))
    spans = {"platform_x": (-0.1, 0.1), "platform_y": (-0.1, 0.1), "platform_z": (0.6, 0.8)}
    spans |= {f"platform_r{axis}": (-0.3, 0.3) for axis in "xyz"}
    exact = simulate(free, random_poses(spans, 40, seed=1), noise=Noise({"*": 0.0}), seed=1)
    with refused("undetermined-quantities", "'Stewart-Gough platform'") as error:
        fix_redundant(free)
    assert "readings" in str(error.value.remedy)
    found = fix_redundant(free, readings=exact.quantities, unmeasured=["platform_*"])
    assert len(found.parameters.free) == 42  # Masory, Wang and Zhuang (1993)
