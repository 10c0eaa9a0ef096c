"""The facts that follow from the method, with random machines and random covariances.

(Method, end of section 3.) Full covariances that differ from pose to pose throughout, unless the
fact is about something simpler.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from loopcal.estimation.calibrate import calibrate
from loopcal.estimation.result import FitResult
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.prior import Prior
from tests.reference.plain_tape import FUNCTIONS
from tests.reference.random_cases import Case, cases, four_bar, random_arm, random_covariances
from tests.reference.simulated import ma1400, planar_arm

Array = NDArray[np.float64]
CASES = cases()
DRAWS = 300


def fit(case: Case, data: Dataset, **changes: Any) -> FitResult:
    arguments = {"noise": case.noise, "start": "nominal", **changes}
    result = calibrate(arguments.pop("machine", case.truth), data, **arguments)
    assert result.status.converged
    return result


def values(result: FitResult) -> Array:
    return np.array([result.value[name] for name in result.estimated])


def sds(result: FitResult) -> Array:
    return np.sqrt(np.diag(result.covariance))


def apart(first: FitResult, second: FitResult) -> float:
    """Largest distance of two results in sds."""
    return float(np.max(abs(values(first) - values(second)) / sds(first)))


def chi_squared(result: FitResult) -> float:
    assert result.chi_squared is not None
    return result.chi_squared.value


@cache
def many_fits(name: str) -> list[FitResult]:
    """Fits of many draws of one case, made once for all laws about them."""
    case = CASES[name]
    return [fit(case, case.draw(seed)) for seed in range(DRAWS)]


# 1 -- exact joints: the basic calibration


@pytest.mark.parametrize("sd", [1e-6, 1e-3, 10.0])
@pytest.mark.parametrize("name", ["planar", "three joints", "MA1400"])
def test_with_exact_joints_and_equal_coordinates_it_is_the_basic_calibration(
    name: str, sd: float
) -> None:
    simulated = {"planar": planar_arm(), "three joints": random_arm(1), "MA1400": ma1400(60)}[name]
    noise = {q: sd if q in simulated.truth.outputs else 0.0 for q in simulated.exact}
    data = simulated.read(dict.fromkeys(simulated.exact, 1e-3), seed=3)
    start = simulated.off(1e-3, 1e-3)
    new = calibrate(start, data, noise=Noise(noise), start="nominal")
    basic = calibrate(start, data, method="least-squares", start="nominal")
    assert new.status.converged
    assert basic.status.converged
    assert values(new) == pytest.approx(values(basic), rel=1e-9, abs=1e-12)
    # chi-squared is then the squared distances over the variance, and so says the same
    square = sum(float(r @ r) for r in basic.residuals_after.values())
    assert chi_squared(new) == pytest.approx(square / sd**2, rel=1e-9)


# 2 -- the expectation of chi-squared


@pytest.mark.parametrize("name", CASES)
def test_chi_squared_is_distributed_as_chi_squared(name: str) -> None:
    from scipy.stats import chi2, kstest

    case = CASES[name]
    found = [chi_squared(result) for result in many_fits(name)]
    poses, loops = len(next(iter(case.simulated.exact.values()))), len(case.truth.tape.loops)
    freedom = poses * loops - len(case.truth.parameters.free)
    error_of_mean = math.sqrt(2 * freedom / DRAWS)
    assert abs(np.mean(found) - freedom) <= 3 * error_of_mean
    assert kstest(found, chi2(freedom).cdf).pvalue > 0.01


def test_the_result_states_those_degrees_of_freedom_and_the_probability() -> None:
    from scipy.stats import chi2

    case = CASES["planar"]
    stated = fit(case, case.draw(1)).chi_squared
    assert stated is not None
    assert stated.degrees_of_freedom == 2 * 40 - 6
    assert stated.p_value == pytest.approx(chi2.sf(stated.value, 74), rel=1e-12)
    assert stated.variance_factor == pytest.approx(stated.value / 74)


# 3 -- the covariance of the parameters


def spread_agrees(errors: Array, covariance: Array) -> None:
    """Errors (draws, n) are of this covariance: their whitened moments are those of N(0, I)."""
    draws, n = errors.shape
    whitened = np.linalg.solve(np.linalg.cholesky(covariance), errors.T)
    square = np.square(whitened).sum(axis=0)
    assert abs(square.mean() - n) <= 3 * math.sqrt(2 * n / draws)
    assert np.max(abs(whitened.mean(axis=1))) <= 4 / math.sqrt(draws)
    # eigenvalues of the sample covariance of white noise (Marchenko and Pastur)
    spread = np.linalg.eigvalsh(np.cov(whitened))
    edge = math.sqrt(n / draws)
    assert (1 - edge) ** 2 * 0.8 <= spread.min()
    assert spread.max() <= (1 + edge) ** 2 * 1.2
    ratio = errors.std(axis=0) / np.sqrt(np.diag(covariance))
    assert np.max(abs(ratio - 1)) <= 4 / math.sqrt(2 * draws)


@pytest.mark.parametrize("name", CASES)
def test_the_estimates_of_many_draws_spread_as_the_covariance_says(name: str) -> None:
    case, results = CASES[name], many_fits(name)
    truth = np.array([case.simulated.values[n] for n in results[0].estimated])
    spread_agrees(np.array([values(r) - truth for r in results]), results[0].covariance)


@pytest.mark.parametrize("name", ["planar", "three joints"])
def test_with_a_prior_errors_spread_as_the_posterior_covariance_says(name: str) -> None:
    case = CASES[name]
    # a prior about as informative as the data, its nominal drawn anew for every draw
    flat = fit(case, case.draw(0))
    prior_sd = dict(zip(flat.estimated, sds(flat), strict=True))
    rng = np.random.default_rng(1)
    results = []
    for seed in range(DRAWS):
        nominal = {n: v + rng.normal(0, prior_sd[n]) for n, v in case.simulated.values.items()}
        machine = case.truth.with_nominal(nominal)
        results.append(fit(case, case.draw(seed), machine=machine, prior=Prior(prior_sd)))
    truth = np.array(list(case.simulated.values.values()))
    spread_agrees(np.array([values(r) - truth for r in results]), results[0].covariance)
    # chi-squared then counts the priors as observations, one per parameter
    chi = results[0].chi_squared
    assert chi is not None
    freedom = chi.degrees_of_freedom
    assert freedom == (flat.chi_squared.degrees_of_freedom if flat.chi_squared else 0) + len(truth)
    mean = np.mean([chi_squared(r) for r in results])
    assert abs(mean - freedom) <= 3 * math.sqrt(2 * freedom / DRAWS)


# 4 -- the scale of the covariances


@pytest.mark.parametrize("factor", [1e-3, 0.5, 7.0, 1e3])
@pytest.mark.parametrize("name", CASES)
def test_scaling_all_covariances_leaves_the_parameters(name: str, factor: float) -> None:
    case = CASES[name]
    data = case.draw(2)
    scaled = replace(case, covariances=factor**2 * case.covariances)
    first, second = fit(case, data), fit(scaled, data)
    assert apart(first, second) <= 1e-7
    assert chi_squared(second) * factor**2 == pytest.approx(chi_squared(first), rel=1e-9)
    assert sds(second) == pytest.approx(factor * sds(first), rel=1e-6)
    for quantity, correction in first.corrections.items():
        assert second.corrections[quantity] == pytest.approx(correction, abs=1e-11)


# 5 -- order, recombination, units


@pytest.mark.parametrize("name", CASES)
def test_the_order_of_poses_is_nothing(name: str) -> None:
    case = CASES[name]
    order = np.random.default_rng(3).permutation(len(case.covariances))
    first = fit(case, case.draw(4))
    second = fit(case.with_poses(order), case.draw(4).take(order))
    assert apart(first, second) <= 1e-7
    assert chi_squared(second) == pytest.approx(chi_squared(first), rel=1e-10)
    for quantity, correction in first.corrections.items():
        assert second.corrections[quantity] == pytest.approx(correction[order], abs=1e-12)


def recombined(case: Case, mix: Callable[[list[Any], Any], list[Any]], **more: Any) -> Mechanism:
    """The machine of a case with its equations put through `mix`, from the tape of the case."""
    tape = case.truth.tape

    def loops(x: Any, p: Any) -> Any:
        functions: dict[str, Any] = {**FUNCTIONS, "sin": np.sin, "cos": np.cos}
        inputs = {"quantity": tape.quantities, "parameter": tape.parameters}
        done: list[Any] = []
        for name, payload in tape.operations:
            if name == "constant":
                done.append(payload[0])
            elif name in inputs:
                done.append((x if name == "quantity" else p)[inputs[name][int(payload[0])]])
            else:
                done.append(functions[name](*(done[int(a)] for a in payload)))
        return mix([done[o] for o in tape.outputs], x)

    return Mechanism.from_function(
        loops,
        dict(case.truth.quantities),
        {p.name: p for p in case.truth.parameters},
        outputs=case.truth.outputs,
        **more,
    )


@pytest.mark.parametrize("name", CASES)
def test_the_order_of_equations_is_nothing(name: str) -> None:
    case = CASES[name]
    first = fit(case, case.draw(5))
    second = fit(case, case.draw(5), machine=recombined(case, lambda f, x: f[::-1]))
    assert apart(first, second) <= 1e-7
    assert chi_squared(second) == pytest.approx(chi_squared(first), rel=1e-10)


@pytest.mark.parametrize("name", CASES)
def test_an_invertible_recombination_of_the_equations_is_nothing(name: str) -> None:
    case = CASES[name]
    m = len(case.truth.tape.loops)
    M = np.random.default_rng(6).normal(size=(m, m)) * np.array([10.0, 1.0, 0.1])[:m]
    machine = recombined(case, lambda f, x: list(M @ np.array(f, dtype=object)))
    first, second = fit(case, case.draw(5)), fit(case, case.draw(5), machine=machine)
    assert apart(first, second) <= 1e-7
    assert chi_squared(second) == pytest.approx(chi_squared(first), rel=1e-10)
    assert second.covariance == pytest.approx(
        first.covariance, abs=1e-6 * float(np.diag(first.covariance).max())
    )


@pytest.mark.parametrize("name", CASES)
def test_nor_is_one_that_differs_from_pose_to_pose(name: str) -> None:
    case = CASES[name]
    m, poses = len(case.truth.tape.loops), len(case.covariances)
    M = np.random.default_rng(7).normal(size=(m, m, poses)) + 2 * np.eye(m)[:, :, None]
    known = {f"M{i}{j}": M[i, j] for i in range(m) for j in range(m)}

    def mix(f: list[Any], x: Any) -> list[Any]:
        return [sum(x[f"M{i}{j}"] * f[j] for j in range(m)) for i in range(m)]

    machine = recombined(case, mix, pose_constants=dict.fromkeys(known, "1"))
    data = case.draw(5)
    first = fit(case, data)
    second = fit(case, data.with_readings(known), machine=machine)
    assert apart(first, second) <= 1e-7
    assert chi_squared(second) == pytest.approx(chi_squared(first), rel=1e-10)


def test_units_are_nothing_inside_the_loop() -> None:
    """The same arm written in millimetres and degrees by its user, as pure numbers."""
    simulated = planar_arm()

    def in_mm_and_deg(x: Any, p: Any) -> Any:
        a = np.pi / 180 * (x.phi2 + p.phi20)
        b = a + np.pi / 180 * (x.phi3 + p.phi30)
        return (
            p.xA + p.l2 * np.cos(a) + p.l3 * np.cos(b) - x.xP,
            p.yA + p.l2 * np.sin(a) + p.l3 * np.sin(b) - x.yP,
        )

    scale = {"m": 1e3, "rad": 180 / math.pi}
    machine = Mechanism.from_function(
        in_mm_and_deg,
        dict.fromkeys(simulated.exact, "1"),
        {p.name: (p.nominal * scale[p.unit], "1") for p in simulated.truth.parameters},
    )
    sd = {"xP": 1e-4, "yP": 2e-4, "phi2": 1e-3, "phi3": 5e-4}
    data = simulated.read(sd, seed=8)
    by = {q: scale[u] for q, u in simulated.truth.quantities.items()}
    scaled = Dataset.from_arrays({q: data[q] * by[q] for q in data.quantities})
    first = calibrate(simulated.truth, data, noise=Noise(sd), start="nominal")
    second = calibrate(
        machine, scaled, noise=Noise({q: s * by[q] for q, s in sd.items()}), start="nominal"
    )
    assert first.status.converged
    assert second.status.converged
    assert chi_squared(second) == pytest.approx(chi_squared(first), rel=1e-10)
    for parameter in simulated.truth.parameters:
        factor, name = scale[parameter.unit], parameter.name
        assert second.value[name] == pytest.approx(factor * first.value[name], rel=1e-9)
        assert second.sd[name] == pytest.approx(factor * (first.sd[name] or 0.0), rel=1e-7)


def test_units_are_nothing_where_data_enter() -> None:
    simulated = planar_arm()
    sd = {"xP": 1e-4, "yP": 2e-4, "phi2": 1e-3, "phi3": 5e-4}
    data = simulated.read(sd, seed=8)
    units = {"xP": "mm", "yP": "in", "phi2": "deg", "phi3": "mrad"}
    factors = {"xP": 1e-3, "yP": 0.0254, "phi2": math.pi / 180, "phi3": 1e-3}
    stated = Dataset.from_arrays({q: data[q] / factors[q] for q in units}, units=units)
    first = calibrate(simulated.truth, data, noise=Noise(sd))
    second = calibrate(simulated.truth, stated, noise=Noise(sd))
    assert apart(first, second) <= 1e-7


def test_fixing_a_parameter_at_its_truth_is_leaving_it_out() -> None:
    """A fixed parameter, a prior sd of zero and a very small one lead to the same."""
    simulated = four_bar()
    covariances = random_covariances(simulated.truth, 40, 1e-4, 5)
    case = Case(simulated, covariances)
    data = case.draw(9)
    fixed = case.truth.with_parameters(case.truth.parameters.with_fixed(["b"]))
    results = [
        fit(case, data, machine=fixed),
        fit(case, data, prior=Prior({"b": 0.0})),
        fit(case, data, prior=Prior({"b": 1e-9})),
    ]
    for result in results[1:]:
        for name in results[0].estimated:
            assert result.value[name] == pytest.approx(results[0].value[name], abs=1e-9)
    assert results[0].sd["b"] is None
