"""Skeletons end where the loops say that the tool point is."""

from __future__ import annotations

import numpy as np
import pytest

import loopcal as lc
from analyses.machines import CASES
from loopcal.mechanisms.exponentials import ScrewJoint, exponentials
from loopcal.mechanisms.instruments.point import point
from loopcal.mechanisms.machine import assemble
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.origins import LinkJoint, joint_chain
from loopcal.mechanisms.planar import motoman_ma1400, planar_two_link
from loopcal.mechanisms.serial import Joint, serial_arm
from loopcal.mechanisms.skeleton import skeleton
from loopcal.mechanisms.station import Target
from tests.reference.machines import dh_arm
from tests.reference.plain_tape import loop_values

ARMS = {
    "dh with a base": dh_arm(),
    "dh without": serial_arm([Joint("a"), Joint("b")], {"a_1": 0.5, "a_2": 0.4}, base=False),
    "transitions": motoman_ma1400(),
    "origins": assemble(
        joint_chain(
            [
                LinkJoint("lift", "prismatic", (0.1, 0, 0.2), axis=(0, 0, 1)),
                LinkJoint("plate", "fixed", (0, 0.3, 0), (0, np.pi / 2, 0)),
                LinkJoint("turn", "revolute", (0.4, 0, 0), axis=(0, 0.6, 0.8)),
            ]
        ),
        [point(station="tracker", target="ball")],
        {"tracker_x": 1.0, "tracker_rz": 0.5, "ball_x": 0.2, "ball_z": -0.1},
    ),
    "exponentials": assemble(
        exponentials(
            [ScrewJoint("a", (0, 0, 1)), ScrewJoint("b", (0, 1, 0), (0.3, 0, 0.5))],
            home=((0.6, 0, 0.5), (0.1, 0.2, 0.3)),
        ),
        [point(station=None, target=Target(("u", "v", "w")))],
        {"v": 0.1, "b_x": 0.01},
    ),
    "planar": planar_two_link({"phi20": 0.1, "xA": 0.2}),
}


@pytest.mark.parametrize("name", ARMS)
def test_it_ends_at_the_tool_point(name: str) -> None:
    arm = ARMS[name]
    random = np.random.default_rng(2)
    joints = {
        q: 0.0 if q in arm.outputs else float(random.uniform(-2.0, 2.0)) for q in arm.quantities
    }
    points = skeleton(arm, joints)
    assert points is not None
    # with outputs at zero, the loops' values are the point reached
    reached = loop_values(
        arm.tape,
        [joints[q] for q in arm.tape.quantities],
        [parameter.nominal for parameter in arm.parameters],
    )
    np.testing.assert_allclose(points[-1], reached, atol=1e-12)
    assert len(points) >= len(joints) - len(arm.outputs)


def test_links_keep_their_lengths() -> None:
    arm = planar_two_link()
    for phi in (0.0, 1.0, 2.5):
        points = skeleton(arm, {"phi2": phi, "phi3": 2.0 * phi})
        assert points is not None
        lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
        np.testing.assert_allclose(lengths, [0.8, 0.6], rtol=1e-12)


def test_what_is_no_arm_has_none() -> None:
    gauge = Mechanism.from_function(
        lambda x, p: (x.a * p.gain - x.b,),
        quantities={"a": "1", "b": "1"},
        parameters={"gain": (1.0, "1")},
    )
    assert skeleton(gauge, {"a": 1.0}) is None


@pytest.mark.parametrize(
    "name",
    [
        "four-bar, point",
        "five-bar, point",
        "3-RRR, pose",
        "linear delta, point",
        "rotary delta, point",
        "Stewart-Gough, pose",
        "Stewart-Gough, three angles",
    ],
)
def test_legs_of_a_parallel_machine_are_as_long_as_they_are_and_stand_where_it_is_seen(
    name: str,
) -> None:
    case = CASES[name]
    base = {"base_x": 0.3, "base_y": -0.2, "base_rz": 0.4}
    mechanism = case.made()
    base = {n: v for n, v in base.items() if n in mechanism.parameters.names}
    mechanism = mechanism.with_nominal(base)
    noise = lc.Noise({"*": 0.0, "platform_*": np.inf})
    made = lc.simulate(mechanism, lc.random_poses(case.driven, 5, seed=1), noise=noise, seed=1)
    values = {p.name: p.nominal for p in mechanism.parameters}
    for pose in range(5):
        readings = {
            q: float(v[pose])
            for q in mechanism.quantities
            if np.isfinite(v := made.dataset[q]).all()
        }
        drawn = skeleton(mechanism, readings)
        assert drawn is not None
        lifted = np.flatnonzero(np.isnan(drawn).any(axis=1))
        lines = np.split(drawn, lifted)
        first = lines[0][~np.isnan(lines[0]).any(axis=1)]
        known = {
            "four-bar": ["crank", "coupler", "rocker"],
            "five-bar": ["proximal_1", "distal_1", "distal_2", "proximal_2"],
            "3-RRR": ["proximal_1", "distal_1"],
            "linear delta": ["rod_1"],
            "rotary delta": ["proximal_1", "distal_1"],
        }.get(mechanism.name)
        lengths = np.linalg.norm(np.diff(first, axis=0), axis=1)[-len(known or [0]) :]
        expected = [values[n] for n in known or []]
        if known is None:
            expected = [readings["leg_1"] + values["leg_1_offset"]]
        np.testing.assert_allclose(lengths, expected, atol=1e-9)
        foot = np.array([values["a1_x"], values["a1_y"], 0.0])[: drawn.shape[1]]
        if base:
            c, s = np.cos(0.4), np.sin(0.4)
            x, y = foot[:2]
            foot[:2] = 0.3 + c * x - s * y, -0.2 + s * x + c * y
        np.testing.assert_allclose(drawn[0], foot, atol=1e-12)


def test_a_platform_that_is_not_found_is_not_drawn() -> None:
    mechanism = CASES["five-bar, point"].made()
    assert skeleton(mechanism, {"theta_1": 0.0, "theta_2": 0.0, "x": 5.0, "y": 5.0}) is None
    assert skeleton(mechanism, {"theta_1": 2.2}) is None
