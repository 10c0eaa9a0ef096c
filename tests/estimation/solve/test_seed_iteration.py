"""The seed's undamped iteration, by name, is its formulas (3.24) to (3.30)."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from loopcal.estimation.calibrate import calibrate
from loopcal.estimation.problem.problem import build_problem
from loopcal.estimation.solve.fallback import iterate_undamped
from loopcal.estimation.solve.solution import Status
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.prior import Prior
from tests.reference.plain_tape import complex_step, loop_values
from tests.reference.simulated import Simulated, ma1400, planar_arm
from tests.refusals import refused

Array = NDArray[np.float64]
ARMS = {"planar": planar_arm(30), "MA1400": ma1400(30)}


def by_hand(simulated: Simulated, sds: Array, prior_sds: Array, start: Array, steps: int) -> Array:
    """The seed's iteration pose by pose, written from its formulas; parameters after `steps`."""
    tape = simulated.truth.tape
    readings = np.array([simulated.read({}, 0)[q] for q in tape.quantities])
    readings = readings + NOISE(readings.shape, sds)
    poses, m = readings.shape[1], len(tape.loops)
    y, q = np.zeros_like(readings), np.zeros(len(start))
    for _ in range(steps):
        p = start + prior_sds * q
        x = readings + sds[:, None] * y
        f = loop_values(tape, x, np.broadcast_to(p[:, None], (len(p), poses)))
        slopes = complex_step(tape, x, p)
        D, E, Q = [], [], []
        for i in range(poses):
            J_y = slopes.by_quantity[:, :, i].T * sds
            J_q = slopes.by_parameter[:, :, i].T * prior_sds
            Q_i, R_i = np.linalg.qr(J_y.T)
            Q.append(Q_i)
            D.append(np.linalg.solve(R_i.T, J_q))
            E.append(Q_i.T @ y[:, i] - np.linalg.solve(R_i.T, f[:, i]))
        stacked = np.vstack([*D, np.eye(len(q))])
        right = np.concatenate([*E, -q])
        dq = np.linalg.lstsq(stacked, right)[0]
        for i in range(poses):
            y[:, i] = Q[i] @ (E[i] - D[i] @ dq)
        q = q + dq
        assert m == len(E[0])
    parameters: Array = start + prior_sds * q
    return parameters


def NOISE(shape: tuple[int, ...], sds: Array) -> Array:
    """The same noise for both: correction taken from exact readings."""
    drawn: Array = sds[:, None] * np.random.default_rng(7).normal(size=shape)
    return drawn


@pytest.mark.parametrize("steps", [1, 2, 3])
@pytest.mark.parametrize("name", ARMS)
def test_so_many_steps_are_those_of_the_formulas(name: str, steps: int) -> None:
    simulated = ARMS[name]
    units = simulated.truth.quantities
    sds = {q: 2e-3 if unit == "rad" else 1e-3 for q, unit in units.items()}
    prior_sds = {p.name: 5e-3 if p.unit == "m" else 1e-2 for p in simulated.truth.parameters}
    stacked = np.array(list(sds.values()))
    start = simulated.off(2e-3, 4e-3)
    exact = np.array([simulated.exact[q] for q in simulated.exact])
    noisy = dict(zip(simulated.exact, exact + NOISE(exact.shape, stacked), strict=True))
    data = simulated.read().with_readings(noisy)
    machine = Prior(prior_sds).apply(start)
    solution = iterate_undamped(build_problem(machine, data, Noise(sds)), max_iterations=steps)
    nominal = np.array([p.nominal for p in start.parameters])
    expected = by_hand(simulated, stacked, np.array(list(prior_sds.values())), nominal, steps)
    assert solution.parameters == pytest.approx(expected, rel=1e-10, abs=1e-12)
    assert solution.status.iterations == steps
    assert solution.status.reason == "max_iterations"


@pytest.mark.parametrize("level", [1e-5, 1e-3])
@pytest.mark.parametrize("name", ARMS)
def test_on_easy_data_it_reaches_the_optimum_of_the_globalised_solver(
    name: str, level: float
) -> None:
    simulated = ARMS[name]
    sds = dict.fromkeys(simulated.exact, level)
    data, start = simulated.read(sds, seed=2), simulated.off(1e-3, 2e-3)
    undamped = calibrate(
        start, data, noise=Noise(sds), method="implicit-loop-undamped", start="nominal"
    )
    globalised = calibrate(start, data, noise=Noise(sds), start="nominal")
    assert undamped.status.converged
    assert undamped.method == "implicit-loop-undamped"
    for parameter in undamped.estimated:
        value = globalised.value[parameter]
        assert undamped.value[parameter] == pytest.approx(value, rel=1e-9, abs=1e-11)
        assert undamped.sd[parameter] == pytest.approx(globalised.sd[parameter], rel=1e-6)
    assert undamped.chi_squared is not None
    assert globalised.chi_squared is not None
    assert undamped.chi_squared.value == pytest.approx(globalised.chi_squared.value, rel=1e-9)
    assert undamped.closure_after.max <= 1e-12


def test_from_afar_it_runs_away_and_says_so_where_the_globalised_solver_converges() -> None:
    simulated = ma1400(30)
    sds = dict.fromkeys(simulated.exact, 1e-3)
    data, noise = simulated.read(sds, seed=2), Noise(sds)
    undamped: list[Status] = []
    globalised: list[Status] = []
    for seed in range(8):
        start = simulated.off(0.3, 1.0, seed=seed)
        for method, ended in (("implicit-loop-undamped", undamped), ("implicit-loop", globalised)):
            result = calibrate(
                start,
                data,
                noise=noise,
                trusted=True,
                method=method,
                start="nominal",
                max_iterations=50,
            )
            assert result.chi_squared is not None
            assert result.status.converged == (result.chi_squared.value < 100)
            ended.append(result.status)
    assert sum(status.reason == "diverged" for status in undamped) >= 3
    assert sum(status.converged for status in globalised) >= 7
    lost = next(status for status in undamped if status.reason == "diverged")
    assert lost.reason == "diverged"
    assert "implicit-loop" in lost.message


def test_a_step_out_of_the_domain_ends_it_at_the_last_point_that_was_inside() -> None:
    machine = Mechanism.from_function(
        lambda x, p: (x["b"] - p["k"] * np.log(x["a"] + p["c"]),),
        {"a": "m", "b": "m"},
        {"k": (1.0, "1"), "c": (3.0, "m")},
    )
    a = np.linspace(0.0, 2.0, 30)
    data = Dataset.from_arrays({"a": a, "b": 2.0 * np.log(a + 0.05)})
    method = "implicit-loop-undamped"
    result = calibrate(machine, data, noise=Noise({"*": 1e-4}), method=method)
    assert result.status.reason == "diverged"
    assert all(math.isfinite(value) for value in result.value.values())
    start = {"c": -1.0}
    with refused("outside-domain"):
        calibrate(machine, data, noise=Noise({"*": 1e-4}), method=method, start=start)


def test_it_knows_no_unmeasured_quantities() -> None:
    simulated = planar_arm(30)
    with refused("unsupported", "implicit-loop"):
        calibrate(
            simulated.truth,
            simulated.read(),
            noise=Noise({"*": 1e-3, "phi3": math.inf}),
            method="implicit-loop-undamped",
        )


def test_exact_quantities_are_not_corrected() -> None:
    simulated = planar_arm(30)
    sds = {"xP": 1e-3, "yP": 1e-3, "phi2": 0.0, "phi3": 0.0}
    data, start = simulated.read(dict.fromkeys(sds, 1e-4), seed=2), simulated.off(1e-3, 1e-3)
    result = calibrate(
        start, data, noise=Noise(sds), method="implicit-loop-undamped", start="nominal"
    )
    assert result.status.converged
    assert np.all(result.corrections["phi2"] == 0.0)
