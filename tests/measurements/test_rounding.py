"""Readings recorded in steps that are not small against their sd are named; targets are not."""

from __future__ import annotations

import numpy as np
import pytest

import loopcal as lc
from loopcal.measurements.resolution import recorded_step
from loopcal.units import from_si
from tests.reference.simulated import planar_arm

ARM = planar_arm(poses=60)
SDS = {"xP": 1e-5, "yP": 1e-5, "phi2": 5e-5, "phi3": 5e-5}
UNITS = {"xP": "mm", "yP": "mm", "phi2": "deg", "phi3": "deg"}


def coarse(decimals, noise):
    """What is named of joints written in degrees with so many decimals."""
    written = {
        q: np.round(from_si(v, UNITS[q]), 4 if q in ("xP", "yP") else decimals)
        for q, v in ARM.read(SDS, 1).readings.items()
    }
    data = lc.Dataset.from_arrays(written, units=UNITS)
    result = lc.calibrate(ARM.truth, data, noise=noise, method="implicit-loop")
    return result.document.data.coarse


@pytest.mark.parametrize("accounted", [False, True, "learnt"])
def test_coarse_joints_are_named_with_step_and_sd_whatever_the_noise_says(accounted):
    step = np.radians(0.1)
    if accounted == "learnt":
        noise = lc.Noise(SDS, estimate={"phi*": "group"})
    else:
        joint = step / np.sqrt(12) if accounted else 5e-5
        noise = lc.Noise(SDS | {"phi2": joint, "phi3": joint})
    (found,) = coarse(1, noise)
    assert found.quantities == ("phi2", "phi3")
    assert found.step == pytest.approx(step, rel=1e-9)
    assert found.sd == pytest.approx(step / np.sqrt(12), rel=1e-9)
    assert "0.10 deg" in str(found)


def test_steps_that_are_small_against_the_sd_are_not_named():
    assert coarse(3, lc.Noise(SDS)) == ()


def test_targets_on_a_grid_are_no_coarse_readings():
    """The joints were sent to multiples of ten degrees, and are where they were sent to."""
    rng = np.random.default_rng(2)
    joints = np.radians(10.0 * rng.integers(-17, 18, (2, 60)))
    targets = {"phi2": joints[0], "phi3": joints[1]}
    data = lc.simulate(ARM.truth, targets, noise=lc.Noise(SDS), seed=1).dataset
    readings = dict(data.readings) | targets
    result = lc.calibrate(
        ARM.truth,
        lc.Dataset.from_arrays({q: from_si(v, UNITS[q]) for q, v in readings.items()}, units=UNITS),
        noise=lc.Noise(SDS),
        method="implicit-loop",
    )
    assert recorded_step(result.dataset, "phi2") == pytest.approx(np.radians(10.0))
    assert result.document.data.coarse == ()


def test_learnt_sds_below_the_rounding_show_targets():
    """Joints sent to multiples of 0.01 deg reach them within 30 urad; their rounding is 50 urad."""
    step, sds = np.radians(0.01), SDS | {"phi2": 3e-5, "phi3": 3e-5}
    targets = {q: np.round(ARM.read(SDS, 1).readings[q] / step) * step for q in ("phi2", "phi3")}
    noise = lc.Noise(SDS, estimate={"phi*": "group"})
    for seed in range(25000, 25004):
        rng = np.random.default_rng(seed)
        reached = {q: v + 3e-5 * rng.standard_normal(v.size) for q, v in targets.items()}
        read = lc.simulate(ARM.truth, reached, noise=lc.Noise(sds), seed=seed).dataset.readings
        written = {q: from_si(v, UNITS[q]) for q, v in {**read, **targets}.items()}
        data = lc.Dataset.from_arrays(written, units=UNITS)
        result = lc.calibrate(ARM.truth, data, noise=noise, method="implicit-loop")
        assert result.document.data.coarse == ()


def test_real_numbers_have_no_step():
    assert recorded_step(ARM.read(SDS, 1), "phi2") == 0.0
