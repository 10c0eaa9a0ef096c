"""Outputs are predicted from other readings alone, not from what was measured with them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from loopcal import Noise, calibrate
from loopcal.estimation.prediction import predict_outputs
from loopcal.mechanisms.instruments.pose import pose
from loopcal.mechanisms.machine import assemble
from loopcal.mechanisms.parallel.stewart_gough import stewart_gough
from loopcal.simulation.poses import random_poses
from loopcal.simulation.simulate import simulate
from loopcal.statistics.prediction import predict

NOISE = Noise({"leg_*": 1e-5, "xyz": 1.5e-5, "pose_w?": 5e-5, "platform_*": np.inf})
PLACES = {
    **dict.fromkeys(("platform_x", "platform_y"), (-0.1, 0.1)),
    "platform_z": (0.6, 0.8),
    **dict.fromkeys(("platform_rz", "platform_ry", "platform_rx"), (-0.3, 0.3)),
}


def test_a_measured_orientation_does_not_help_to_predict_where_a_platform_is() -> None:
    machine = assemble(stewart_gough(), [pose()])
    far = {"base_x": 2.4, "base_rz": 1.1, "b2_x": machine.parameters["b2_x"].nominal + 5e-4}
    made = simulate(machine, random_poses(PLACES, 40, seed=1), noise=NOISE, seed=1, truth=far)
    gauge = machine.with_parameters(
        machine.parameters.with_fixed(["[ab]?_[xyz]", "leg_*", "tool_*"])
    )
    result = calibrate(gauge, made.dataset, noise=NOISE, method="implicit-loop")
    before = result.accuracy_before
    assert before is not None
    # aligned: what is left is half a millimetre of one joint, though turned by 63 degrees
    assert before.rms < 1e-3
    legs = {q: made.dataset[q] for q in made.dataset.quantities if q.startswith("leg_")}
    predicted = predict(result, legs)
    measured = np.array([made.dataset[axis] for axis in "xyz"])
    apart = np.array([predicted.outputs[axis] for axis in "xyz"]) - measured
    differences = np.array([result.differences_after[axis] for axis in "xyz"])
    assert apart == pytest.approx(differences, abs=1e-9)


def test_a_pose_that_no_loop_reaches_is_lost_and_disturbs_no_other() -> None:
    machine = assemble(stewart_gough(), [pose()])
    exact = simulate(
        machine, random_poses(PLACES, 30, seed=3), noise=Noise({"*": 0.0}), seed=0
    ).quantities
    tape = machine.predicting().tape
    platform = [q for q in tape.quantities if q.startswith("platform_")]
    found = replace(machine, outputs=(*machine.outputs, *platform))
    starts = dict.fromkeys(found.outputs, 0.0) | {q: machine.home[q] for q in platform}
    readings = np.array([np.broadcast_to(starts.get(q, exact[q]), 30) for q in tape.quantities])
    parameters = np.array([p.nominal for p in machine.parameters])
    known = np.zeros((len(tape.pose_constants), 30))
    readings[tape.quantities.index("leg_1"), 4] = 5.0
    readings[tape.quantities.index("leg_2"), 7] = np.nan
    y = predict_outputs(found, parameters, readings, known)
    lost = np.isnan(y).any(axis=0)
    assert np.flatnonzero(lost).tolist() == [4, 7]
    expected = np.array([exact[q] for q in found.outputs])
    assert y[:, ~lost] == pytest.approx(expected[:, ~lost], abs=1e-11)
