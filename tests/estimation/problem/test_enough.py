"""What cannot be calibrated is told so, with its calibration index."""

from __future__ import annotations

import numpy as np
import pytest

import loopcal as lc
from analyses.machines import FIVE_BAR, ROTARY_DELTA, Ranges
from loopcal.mechanisms.machine import Machine, assemble
from loopcal.mechanisms.parallel.delta import rotary_delta
from loopcal.mechanisms.parallel.five_bar import five_bar
from tests.refusals import refused

NOISE = lc.Noise({"*": 5e-5, "platform_*": np.inf})


def readings(machine: Machine, driven: Ranges) -> lc.Dataset:
    poses = lc.random_poses(driven, 30, seed=1)
    return lc.simulate(assemble(machine), poses, noise=NOISE, seed=1).dataset


@pytest.mark.parametrize(
    ("machine", "driven", "sensed"), [(five_bar(), FIVE_BAR, 2), (rotary_delta(), ROTARY_DELTA, 3)]
)
def test_a_machine_without_redundant_sensors_is_told_its_index(
    machine: Machine, driven: Ranges, sensed: int
) -> None:
    index = f"C = S - M = {sensed} sensed - {sensed} of mobility = 0"
    for run in (lc.calibrate, lc.check):
        with refused("undetermined-quantities", repr(machine.name), index, "platform_x"):
            run(assemble(machine), readings(machine, driven), noise=NOISE)


def test_a_prior_makes_up_for_no_redundancy() -> None:
    machine = five_bar()
    with refused("undetermined-quantities", "'five-bar'"):
        lc.calibrate(
            assemble(machine),
            readings(machine, FIVE_BAR),
            noise=NOISE,
            prior=lc.Prior({"*": 1e-3}),
            method="implicit-loop",
        )


def test_a_sensor_that_is_lost_in_one_pose_leaves_it_blind() -> None:
    machine = five_bar(passive=["phi_1"])
    data = readings(machine, FIVE_BAR)
    lost = {q: np.array(data[q]) for q in data.quantities if not q.startswith("platform_")}
    for q in ("theta_1", "phi_1"):
        lost[q][7] = np.nan
    with refused("undetermined-quantities", "pose '8'", "1 sensed", "2 of", "-1"):
        lc.calibrate(assemble(machine), lost, noise=NOISE, method="implicit-loop")
