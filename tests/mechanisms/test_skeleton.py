"""Skeletons end where the loops say that the tool point is."""

from __future__ import annotations

import numpy as np
import pytest

from loopcal.mechanisms.exponentials import ScrewJoint, exponentials
from loopcal.mechanisms.instruments.point import point
from loopcal.mechanisms.machine import assemble
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.motoman import motoman_ma1400
from loopcal.mechanisms.origins import LinkJoint, joint_chain
from loopcal.mechanisms.planar import planar_two_link
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
