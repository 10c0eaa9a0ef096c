"""Random poses to look at: within limits, and touching where things touch."""

from __future__ import annotations

import numpy as np
import pytest

from analyses.instruments import SIX
from loopcal.mechanisms.instruments.contact import plane, socket
from loopcal.mechanisms.instruments.point import point
from loopcal.mechanisms.instruments.pose import pose
from loopcal.mechanisms.machine import assemble
from loopcal.mechanisms.origins import joint_chain
from loopcal.mechanisms.redundancy import samples
from tests.reference.plain_tape import loop_values

TOOL = {"tool_x": 0.05, "tool_z": 0.08}


def sampled(instruments, ranges=None, unsure=()):
    made = assemble(joint_chain(SIX), instruments, TOOL)
    return made, samples(made, ranges=ranges or {}, unsure=unsure, readings={})


def values(made, sample):
    count = sample.readings.shape[1]
    p = np.broadcast_to(sample.parameters[:, None], (len(sample.parameters), count))
    known = sample.pose_constants if len(sample.pose_constants) else None
    all_loops = np.array(loop_values(made.tape, sample.readings, p, known))
    return all_loops[list(sample.loops)]


def test_joints_stand_anywhere_within_their_limits():
    made, (only,) = sampled([point()], {"q2": (0.1, 0.4)})
    rows = dict(zip(made.tape.quantities, only.readings, strict=True))
    assert 0.1 <= rows["q2"].min() < 0.15
    assert 0.35 < rows["q2"].max() <= 0.4
    assert rows["q1"].max() - rows["q1"].min() > 5.0


@pytest.mark.parametrize("make", [socket, plane])
def test_what_touches_does_so_in_each_pose(make):
    contact = make()
    made, (only,) = sampled([contact], unsure=list(contact.placement))
    assert np.abs(values(made, only)).max() < 1e-9
    joints = only.readings[:6]
    assert joints.shape[1] >= 30
    assert (joints.max(axis=1) - joints.min(axis=1)).min() > 0.5


def test_beside_an_instrument_contacts_have_poses_of_their_own():
    contact = socket()
    made, (seen, touching) = sampled([point(), contact], unsure=list(contact.placement))
    assert [made.tape.loops[i] for i in seen.loops] == ["x", "y", "z"]
    assert [made.tape.loops[i] for i in touching.loops] == list(contact.readings)


def test_an_orientation_is_as_it_would_be_measured():
    made, (only,) = sampled([pose()])
    turns = [i for i, loop in enumerate(made.tape.loops) if loop in made.implied]
    read = only.readings[[made.tape.quantities.index(made.tape.loops[i]) for i in turns]]
    np.testing.assert_allclose(values(made, only)[turns] + read, 0.0, atol=1e-12)
