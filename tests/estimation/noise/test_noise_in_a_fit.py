"""What a fit makes of exact, unmeasured, correlated and differently uncertain readings."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares

from loopcal.estimation.calibrate import calibrate
from loopcal.estimation.result import FitResult
from loopcal.expressions.vectors import vector
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise
from loopcal.mechanisms.chain import apply
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.prior import Prior
from loopcal.mechanisms.serial import chain_steps
from tests.reference.four_bars import eliminated, passive
from tests.reference.lagrange import DenseLagrange
from tests.reference.plain_tape import loop_values
from tests.reference.random_cases import random_arm
from tests.reference.simulated import Simulated, ma1400, planar_arm
from tests.refusals import refused

Array = NDArray[np.float64]
SD = {"xP": 1e-3, "yP": 2e-3, "phi2": 1e-3, "phi3": 5e-4}


def fit(machine: Mechanism, data: Dataset, noise: Any, **more: Any) -> FitResult:
    result = calibrate(machine, data, noise=Noise(noise), **{"start": "nominal", **more})
    assert result.status.converged, result.status.message
    return result


def chi_squared(result: FitResult) -> float:
    assert result.chi_squared is not None
    return result.chi_squared.value


def alike(first: FitResult, second: FitResult, tolerance: float = 1e-9) -> None:
    """Equal parameters (relative), sds and chi-squared."""
    for name in first.estimated:
        assert first.value[name] == pytest.approx(second.value[name], rel=tolerance, abs=tolerance)
        assert first.sd[name] == pytest.approx(second.sd[name], rel=1e-6)
    assert chi_squared(first) == pytest.approx(chi_squared(second), rel=tolerance)


# unmeasured


def test_an_unmeasured_coordinate_is_its_equation_left_out() -> None:
    """Point and plane: a camera that sees x and y of an arm, or a tracker's z that is unknown."""
    simulated = random_arm(5)
    machine = simulated.truth
    fixed = machine.with_parameters(machine.parameters.with_fixed(["x3B", "y3B", "z3B"]))
    sds = dict.fromkeys(simulated.exact, 0.0001)
    data = simulated.read(sds, seed=1)

    def without_z(x: Any, p: Any) -> Any:
        assert machine.description is not None
        steps = chain_steps(machine.description["joints"])
        tip = vector(p["x3B"], p["y3B"], p["z3B"])
        reached = apply(steps, tip, x, p)
        return reached[0] - x["x"], reached[1] - x["y"]

    quantities = {q: u for q, u in machine.quantities.items() if q != "z"}
    by_hand = Mechanism.from_function(without_z, quantities, {p.name: p for p in fixed.parameters})
    left = Dataset.from_arrays({q: data[q] for q in quantities})
    reference = fit(by_hand, left, {"*": 1e-4})
    alike(fit(fixed, data, {"*": 1e-4, "z": math.inf}), reference)
    blank = data.with_readings({"z": np.full(len(data), np.nan)})
    alike(fit(fixed, blank, {"*": 1e-4}), reference)
    absent = fit(fixed, left, {"*": 1e-4, "z": math.inf})
    alike(absent, reference)
    assert reference.chi_squared is not None
    assert absent.chi_squared is not None
    assert (
        absent.chi_squared.degrees_of_freedom
        == reference.chi_squared.degrees_of_freedom
        == 2 * len(data) - reference.identifiability.rank
    )


@pytest.mark.parametrize("sd", [1e-6, 1e-4, 1e-2])
def test_a_passive_joint_is_the_joint_eliminated_by_hand(sd: float) -> None:
    with_coupler, without = passive(), eliminated()
    data = with_coupler.read({"crank": sd, "rocker": sd}, seed=3)
    start = {"a": 0.201, "b": 0.549, "c": 0.451, "crank0": 0.02, "rocker0": 0.06}
    reference = fit(without.truth, data, {"crank": sd, "rocker": sd}, start=start)
    guess = data["coupler"] + 0.02 * np.sin(np.arange(len(data)))
    unknown = {"crank": sd, "rocker": sd, "coupler": math.inf}
    result = fit(with_coupler.truth, data.with_readings({"coupler": guess}), unknown, start=start)
    alike(result, reference)
    assert result.closure_after.max <= 1e-14
    # the coupler is found: its angle is that between the corrected ends
    crank = data["crank"] + result.corrections["crank"] + result.value["crank0"]
    rocker = data["rocker"] + result.corrections["rocker"] + result.value["rocker0"]
    v = result.value
    across = v["c"] * np.sin(rocker) - v["a"] * np.sin(crank)
    along = v["c"] * np.cos(rocker) + v["d"] - v["a"] * np.cos(crank)
    found = guess + result.corrections["coupler"]
    assert np.cos(found - np.arctan2(across, along)) == pytest.approx(np.ones(len(data)))


def test_a_passive_joint_without_any_column_is_found_from_zero() -> None:
    with_coupler, without = passive(), eliminated()
    sds = {"crank": 1e-4, "rocker": 1e-4}
    data = without.read(sds, seed=3)
    result = fit(with_coupler.truth, data, {**sds, "coupler": math.inf})
    alike(result, fit(without.truth, data, sds))


def test_readings_missing_in_some_poses_are_unmeasured_there() -> None:
    simulated = planar_arm(50)
    data = simulated.read(SD, seed=2)
    x_p, phi3 = data["xP"].copy(), data["phi3"].copy()
    x_p[[3, 10, 11]] = np.nan
    phi3[[11, 20]] = np.nan
    partial = data.with_readings({"xP": x_p, "phi3": phi3})
    result = fit(simulated.truth, partial, SD)
    # independently: no weight where there is no reading
    names = simulated.truth.tape.quantities
    precision = np.zeros((50, 4, 4))
    for i, name in enumerate(names):
        precision[:, i, i] = np.where(np.isnan(partial[name]), 0.0, SD[name] ** -2)
    readings = np.array([data[q] for q in names])  # as starting values
    nominal = np.array(list(simulated.values.values()))
    oracle = DenseLagrange(
        simulated.truth.tape, readings, precision, nominal, np.zeros((6, 6))
    ).solve(nominal)
    assert list(result.value.values()) == pytest.approx(oracle.parameters, rel=1e-9, abs=1e-12)
    assert chi_squared(result) == pytest.approx(oracle.merit, rel=1e-9)
    assert result.chi_squared is not None
    assert result.chi_squared.degrees_of_freedom == 2 * 50 - 5 - 6
    assert result.accuracy_after is not None
    # a point without x has no distance, and without an elbow the point cannot be predicted
    assert result.accuracy_after.poses == 46


def test_a_pose_of_which_nothing_is_left_changes_nothing() -> None:
    """Two loops and two unmeasured quantities: the pose explains itself, whatever it reads."""
    simulated = planar_arm(40)
    data = simulated.read(SD, seed=2)
    without = fit(simulated.truth, data.take(slice(1, None)), SD)
    x_p, y_p = data["xP"].copy(), data["yP"].copy()
    x_p[0] = y_p[0] = np.nan
    result = fit(simulated.truth, data.with_readings({"xP": x_p, "yP": y_p}), SD)
    alike(result, without)
    assert result.corrections["phi2"][0] == 0.0


def test_more_unmeasured_quantities_than_loops_are_refused_with_the_pose() -> None:
    simulated = planar_arm(40)
    data = simulated.read(SD, seed=2)
    readings = {q: data[q].copy() for q in ("xP", "yP", "phi2")}
    for values in readings.values():
        values[7] = np.nan
    with refused("undetermined-quantities", "pose '8'", "3 unmeasured", "2 loop"):
        calibrate(simulated.truth, data.with_readings(readings), noise=Noise(SD))


def test_least_squares_leaves_poses_without_a_coordinate_their_other_equations() -> None:
    simulated = planar_arm(40)
    data = simulated.read(SD, seed=2)
    x_p = data["xP"].copy()
    x_p[:5] = np.nan
    result = calibrate(
        simulated.truth, data.with_readings({"xP": x_p}), method="least-squares", start="nominal"
    )
    assert result.status.converged
    names = simulated.truth.tape.quantities
    weight = np.ones((2, 40))
    weight[0, :5] = 0.0  # the equation of x decides x itself there

    def residuals(p: Array) -> Array:
        x = np.array([data[q] for q in names])
        f = loop_values(simulated.truth.tape, x, np.broadcast_to(p[:, None], (6, 40)))
        out: Array = (weight * f).ravel()
        return out

    nominal = np.array(list(simulated.values.values()))
    found = least_squares(residuals, nominal, jac="3-point", xtol=1e-15, ftol=1e-15, gtol=1e-15)
    assert list(result.value.values()) == pytest.approx(found.x, abs=1e-9)


# exact


def test_an_exact_quantity_is_the_limit_of_a_very_certain_one() -> None:
    simulated = planar_arm(50)
    data = simulated.read(SD, seed=4)
    exact = fit(simulated.truth, data, SD | {"phi2": 0.0})
    assert np.all(exact.corrections["phi2"] == 0.0)
    certain = fit(simulated.truth, data, SD | {"phi2": 1e-10})
    alike(exact, certain, 1e-9)


def test_exact_readings_in_some_poses() -> None:
    simulated = planar_arm(50)
    data = simulated.read(SD, seed=4)
    sd = np.where(np.arange(50) % 3 == 0, 0.0, 1e-3)
    result = fit(simulated.truth, data, SD | {"phi2": sd})
    assert np.all(result.corrections["phi2"][::3] == 0.0)
    assert np.all(result.corrections["phi2"][1::3] != 0.0)
    near = fit(simulated.truth, data, SD | {"phi2": np.maximum(sd, 1e-10)})
    alike(result, near, 1e-9)


def test_a_loop_of_exact_quantities_cannot_close_and_says_so() -> None:
    simulated = planar_arm(50)
    data = simulated.read(SD, seed=4)
    with refused("exact-readings", "50 poses", "pose '1'") as caught:
        fit(simulated.truth, data, SD | {"yP": 0.0, "phi*": 0.0})
    assert "sd above 0" in str(caught.value)


def test_two_coordinates_may_be_exact_if_the_joints_are_not() -> None:
    simulated = planar_arm(50)
    data = simulated.read(SD, seed=4)
    result = fit(simulated.truth, data, SD | {"xP": 0.0, "yP": 0.0})
    assert np.all(result.corrections["xP"] == 0.0)
    assert result.closure_after.max <= 1e-14


# correlated, and differing by reading


def test_sds_per_reading_are_a_covariance_per_pose() -> None:
    simulated = planar_arm(50)
    data = simulated.read(SD, seed=5)
    rng = np.random.default_rng(6)
    sds = {q: sd * rng.uniform(0.5, 2.0, 50) for q, sd in SD.items()}
    stacked = np.array([sds[q] for q in SD])
    diagonal = np.einsum("ib,ij->bij", stacked**2, np.eye(4))
    reference = fit(simulated.truth, data, {tuple(SD): diagonal})
    alike(fit(simulated.truth, data, sds), reference)
    own = Dataset.from_arrays({q: data[q] for q in SD}, sds=sds)
    alike(fit(simulated.truth, own, {}), reference)
    assert fit(simulated.truth, own, {}).noise[0].source == "reading"


def test_a_point_half_as_certain_counts_a_quarter() -> None:
    """A reading with sd s, twice, is one with sd s over the root of two."""
    simulated = planar_arm(30)
    data = simulated.read(SD, seed=5)
    twice = data.take(np.repeat(np.arange(30), 2))
    result = fit(simulated.truth, twice, SD)
    once = fit(simulated.truth, data, {q: sd / math.sqrt(2) for q, sd in SD.items()})
    for name in result.estimated:
        assert result.value[name] == pytest.approx(once.value[name], rel=1e-9, abs=1e-12)
        assert result.sd[name] == pytest.approx(once.sd[name], rel=1e-7)


@pytest.mark.parametrize("name", ["planar", "MA1400"])
def test_correlated_coordinates_are_uncorrelated_ones_seen_turned(name: str) -> None:
    """The tracker's distance and angles: a covariance turned with the frame changes nothing."""
    simulated = {"planar": planar_arm(50), "MA1400": ma1400(60)}[name]
    machine = simulated.truth
    outputs, d = machine.outputs, len(machine.outputs)
    joints = {q: 1e-4 for q in simulated.exact if q not in outputs}
    sds = np.array([1e-4, 3e-4, 2e-4])[:d]
    data = simulated.read({**joints, **dict(zip(outputs, sds, strict=True))}, seed=7)
    a, b = np.linalg.qr(np.random.default_rng(8).normal(size=(d, d)))
    R = a * np.sign(np.diag(b))
    R[0] *= np.linalg.det(R)
    assert machine.placement is not None
    turned = machine.with_nominal(machine.placement.moved(simulated.values, R, np.zeros(d)))
    point = R @ np.array([data[q] for q in outputs])
    seen = data.with_readings(dict(zip(outputs, point, strict=True)))
    first = fit(machine, data, {**joints, **dict(zip(outputs, sds, strict=True))})
    second = fit(turned, seen, {**joints, outputs: R @ np.diag(sds**2) @ R.T})
    assert chi_squared(second) == pytest.approx(chi_squared(first), rel=1e-8)
    for joint in joints:
        assert second.corrections[joint] == pytest.approx(first.corrections[joint], abs=1e-11)


def test_a_covariance_may_be_singular() -> None:
    """A tracker that errs only along its beam, and joints that read the same belt."""
    simulated = planar_arm(60)
    rng = np.random.default_rng(9)
    beam = np.array([0.6, 0.8])
    errors = 1e-3 * rng.normal(size=60)
    readings = {
        q: v.copy() for q, v in simulated.read({"phi2": 1e-3, "phi3": 1e-3}).readings.items()
    }
    readings["xP"] += beam[0] * errors
    readings["yP"] += beam[1] * errors
    data = Dataset.from_arrays(readings)
    singular = 1e-6 * np.outer(beam, beam)
    result = fit(simulated.truth, data, {"phi*": 1e-3, ("xP", "yP"): singular})
    across = -beam[1] * result.corrections["xP"] + beam[0] * result.corrections["yP"]
    assert abs(across).max() <= 1e-14  # no correction where there is no uncertainty
    assert abs(result.corrections["xP"]).max() > 1e-4
    nearly = singular + 1e-18 * np.eye(2)
    alike(result, fit(simulated.truth, data, {"phi*": 1e-3, ("xP", "yP"): nearly}), 1e-8)


def test_part_of_a_correlated_block_may_be_unmeasured_in_a_pose() -> None:
    simulated = planar_arm(50)
    data = simulated.read(SD, seed=5)
    covariance = np.array([[4e-6, 3e-6], [3e-6, 9e-6]])
    x_p = data["xP"].copy()
    x_p[:10] = np.nan
    partial = data.with_readings({"xP": x_p})
    result = fit(simulated.truth, partial, {"phi*": 1e-3, ("xP", "yP"): covariance})
    # what is left of the block is its own variance
    per_pose = np.broadcast_to(covariance, (50, 2, 2)).copy()
    per_pose[:10, 0, 1] = per_pose[:10, 1, 0] = 0.0
    alike(result, fit(simulated.truth, partial, {"phi*": 1e-3, ("xP", "yP"): per_pose}))


def test_later_entries_win_over_a_block() -> None:
    simulated = planar_arm(40)
    data = simulated.read(SD, seed=5)
    block = {("xP", "yP"): np.array([[1e-4, 9e-5], [9e-5, 1e-4]])}
    alike(
        fit(simulated.truth, data, {"phi*": 1e-3, **block, "?P": 1e-3}),
        fit(simulated.truth, data, {"phi*": 1e-3, "?P": 1e-3}),
    )


def test_a_flat_prior_is_the_limit_of_a_wide_one() -> None:
    simulated = planar_arm(50)
    data = simulated.read(SD, seed=5)
    flat = fit(simulated.truth, data, SD)
    wide = fit(simulated.truth, data, SD, prior=Prior({"*": 1e3}))
    for name in flat.estimated:
        assert flat.value[name] == pytest.approx(wide.value[name], abs=1e-9)
        assert flat.sd[name] == pytest.approx(wide.sd[name], rel=1e-9)


def test_a_narrow_prior_holds_the_nominal() -> None:
    simulated: Simulated = planar_arm(50)
    data = simulated.read(SD, seed=5)
    start = simulated.off(1e-2, 1e-2)
    held = fit(start, data, SD, prior=Prior({"l2": 1e-9}))
    assert held.value["l2"] == pytest.approx(start.parameters["l2"].nominal, abs=1e-9)
    assert held.sd["l2"] == pytest.approx(1e-9, rel=1e-6)
