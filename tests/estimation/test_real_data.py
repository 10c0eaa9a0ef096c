"""Measured data of a Motoman MA1400 and a laser tracker, against independent fits of the same."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from loopcal.estimation.calibrate import calibrate
from loopcal.estimation.result import FitResult
from loopcal.files.tables.readers import read_dataset
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.planar import AXES, DIRECTIONS, NOMINAL, motoman_ma1400
from loopcal.mechanisms.prior import Prior
from loopcal.mechanisms.serial import Joint, serial_arm
from loopcal.workflow.result import Result
from tests.reference.optimality import diagonal, optimality

LEFT = {"z1": 1.4159, "x6B": 0.05, "y6B": 0.0, "z6B": -0.45}
RIGHT = {"z1": 1.4159, "x6B": 0.045 * math.cos(0.38), "y6B": 0.045 * math.sin(0.38), "z6B": -0.445}
NOISE = Noise({"theta_*": 5e-5})  # 50 microradians; the tracker states its own
JOINTS = {f"theta_{i}": letter for i, letter in enumerate("SLURBT", 1)}

Find = Callable[[str], Path]


def measured(path: Path) -> Dataset:
    columns: dict[str, dict[str, str]] = {
        q: {"column": c, "unit": "rad"} for q, c in JOINTS.items()
    }
    columns |= {a: {"column": a, "unit": "m", "sd_column": f"u_{a}"} for a in "xyz"}
    return read_dataset(path, columns, pose="pose")


@pytest.fixture(scope="module")
def left(shared_data: Find) -> Dataset:
    return measured(shared_data("motoman_ma1400_leica/left_arm_grid.csv"))


@pytest.fixture(scope="module")
def right(shared_data: Find) -> Dataset:
    return measured(shared_data("motoman_ma1400_leica/right_arm_workspace.csv"))


def left_arm() -> Mechanism:
    """The MA1400 whose tracker sees it turned by about 87 degrees: a quarter turn ahead."""
    joints = [
        Joint(
            f"theta_{i}",
            f"transition-{axis}",
            direction=direction,
            before={"rz": math.pi / 2} if i == 1 else {},
        )
        for i, (axis, direction) in enumerate(zip(AXES, DIRECTIONS, strict=True), 1)
    ]
    return serial_arm(joints, {**NOMINAL, **LEFT}, name="MA1400, left arm")


def rms_in_mm(result: FitResult) -> float:
    assert result.accuracy_after is not None
    return 1e3 * result.accuracy_after.rms


def test_the_left_arm_by_least_squares_from_the_drawing(left: Dataset) -> None:
    result = calibrate(left_arm(), left, method="least-squares")
    assert len(left) == 208
    assert result.status.converged
    assert len(result.estimated) == 27
    assert result.identifiability.rank == 27
    assert rms_in_mm(result) == pytest.approx(0.0735, abs=0.0005)
    assert result.accuracy_after is not None
    assert 1e3 * result.accuracy_after.max == pytest.approx(0.158, abs=0.002)
    assert result.accuracy_before is not None
    assert 1e3 * result.accuracy_before.rms < 1.0  # the tracker was placed by alignment
    assert result.identifiability.condition_number == pytest.approx(5.4e4, rel=0.05)


def test_the_left_arm_by_the_implicit_loop_with_flat_priors(left: Dataset) -> None:
    result = calibrate(left_arm(), left, noise=NOISE)
    assert result.status.converged
    assert result.chi_squared is not None
    assert result.chi_squared.value == pytest.approx(350.49, abs=0.02)
    assert result.chi_squared.degrees_of_freedom == 3 * 208 - 27
    assert rms_in_mm(result) == pytest.approx(0.1069, abs=0.0005)
    assert result.closure_after.max <= 1e-14
    sds = {q: result.reading_sds[q] for q in result.mechanism.tape.quantities}
    told = optimality(result, diagonal(result, sds))
    assert told.corrections <= 1e-6
    assert told.parameters <= 1e-4
    assert told.chi_squared == pytest.approx(result.chi_squared.value, rel=1e-6)


def test_the_left_arm_by_the_implicit_loop_with_the_drawings_tolerances(left: Dataset) -> None:
    machine = left_arm()
    assert machine.placement is not None
    tolerances = {p.name: 2e-3 if p.unit == "m" else 5e-3 for p in machine.parameters}
    tolerances |= dict.fromkeys(("x6B", "y6B", "z6B"), 20e-3)
    tolerances |= dict.fromkeys(machine.placement.parameters, math.inf)
    result = calibrate(machine, left, noise=NOISE, prior=Prior(tolerances))
    assert result.status.converged
    assert rms_in_mm(result) <= 0.081
    assert rms_in_mm(result) == pytest.approx(0.0790, abs=0.0005)
    assert result.closure_after.max <= 1e-14
    for name, tolerance in tolerances.items():
        if tolerance < 20e-3:  # the reflector sits elsewhere than its drawing says
            change = result.value[name] - result.mechanism.parameters[name].nominal
            assert abs(change) <= 3 * tolerance


def test_the_right_arm_by_least_squares(right: Dataset) -> None:
    result = calibrate(motoman_ma1400(RIGHT), right, method="least-squares")
    assert len(right) == 587
    assert result.status.converged
    assert rms_in_mm(result) == pytest.approx(2.36, abs=0.02)
    assert result.accuracy_after is not None
    assert 1e3 * result.accuracy_after.max == pytest.approx(18.6, abs=0.2)
    assert result.accuracy_before is not None
    assert 1e3 * result.accuracy_before.rms == pytest.approx(3.15, abs=0.1)


def test_the_right_arm_by_the_implicit_loop_says_that_the_sds_cannot_be_right(
    right: Dataset,
) -> None:
    result = calibrate(motoman_ma1400(RIGHT), right, noise=NOISE)
    assert result.status.converged
    assert result.chi_squared is not None
    assert result.chi_squared.variance_factor == pytest.approx(1081, rel=0.02)
    assert result.chi_squared.p_value == pytest.approx(0.0, abs=1e-12)
    warning = next(w for w in result.warnings if "Chi-squared" in w)
    assert "Chi-squared per degree of freedom is 1081" in warning
    assert "these sds are too small" in warning
    assert "model error" in warning
    assert warning in " ".join(str(Result.of(result)).split())  # lines are wrapped
    # a closed loop is no accuracy: told from the joints alone it is no better than before
    assert result.closure_after.max <= 1e-14
    assert rms_in_mm(result) > 2.36


def test_both_arms_are_one_design_though_the_tracker_saw_them_differently(
    left: Dataset, right: Dataset
) -> None:
    first = calibrate(left_arm(), left, method="least-squares")
    second = calibrate(motoman_ma1400(RIGHT), right, method="least-squares")
    for name in ("z2", "x4"):
        assert first.value[name] == pytest.approx(NOMINAL[name], abs=2e-3)
        assert second.value[name] == pytest.approx(NOMINAL[name], abs=2e-3)


def test_the_gross_outlier_is_where_the_documentation_says(right: Dataset) -> None:
    result = calibrate(motoman_ma1400(RIGHT), right, method="least-squares")
    distances = np.sqrt(sum(np.square(r) for r in result.residuals_after.values()))
    assert right.poses[int(np.argmax(distances))] == "13"
