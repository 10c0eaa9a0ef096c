"""Robust losses: what they are, that their fits are optima, and that their sds are right."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import chdtri

import loopcal as lc
from loopcal.estimation.methods.implicit_loop import METHOD
from loopcal.estimation.problem.problem import build_problem
from loopcal.estimation.solve.gauss_newton import NEGLIGIBLE
from loopcal.estimation.solve.loss import (
    Huber,
    StudentT,
    huber_constant,
    huber_efficiency,
    loss_named,
)
from loopcal.estimation.solve.robust import solve_robust
from loopcal.estimation.solve.sweep import Sweeper
from tests.reference.simulated import planar_arm
from tests.refusals import refused

SDS = {"xP": 1e-4, "yP": 1e-4, "phi2": 2e-4, "phi3": 2e-4}
NOISE = lc.Noise(SDS)
ARM = planar_arm(60)


def spoilt(data: lc.Dataset, share: float, seed: int) -> lc.Dataset:
    """A share of the poses with a coordinate off by 1 to 50 mm."""
    rng = np.random.default_rng(seed)
    readings = {q: v.copy() for q, v in data.readings.items()}
    for i in rng.choice(len(data), round(share * len(data)), replace=False):
        readings[str(rng.choice(["xP", "yP"]))][i] += rng.choice([-1, 1]) * rng.uniform(1e-3, 5e-2)
    return lc.Dataset.from_arrays(readings)


@pytest.mark.parametrize(("r", "k"), [(1, 1.345), (2, 1.501), (3, 1.628)])
def test_hubers_constant_keeps_95_percent_of_the_efficiency(r: int, k: float) -> None:
    assert huber_constant(r) == pytest.approx(k, abs=1e-3)
    s = chdtri(r, (np.arange(100_000) + 0.5) / 100_000)  # the quantiles of |E|^2
    w, bend = Huber().weight(s, r), Huber().bend(s, r)
    slope, square = (w + 2 / r * bend).mean(), (w * w * s).mean() / r
    assert slope**2 / square == pytest.approx(huber_efficiency(huber_constant(r), r), abs=2e-3)


@pytest.mark.parametrize("loss", [Huber(), StudentT()])
def test_weights_are_the_derivative_of_the_loss(loss) -> None:
    s, h = np.array([0.3, 2.0, 9.0, 400.0]), 1e-5
    for r in (1, 3):
        slope = (loss.rho(s + h, r) - loss.rho(s - h, r)) / (2 * h)
        assert loss.weight(s, r) == pytest.approx(slope, rel=1e-6)
        bend = s * (loss.weight(s + h, r) - loss.weight(s - h, r)) / (2 * h)
        assert loss.bend(s, r) == pytest.approx(bend, rel=1e-4, abs=1e-9)


@pytest.mark.parametrize("name", ["huber", "student-t"])
def test_the_end_is_a_minimum_of_the_summed_loss(name: str) -> None:
    loss = loss_named(name)
    assert loss is not None
    problem = build_problem(ARM.off(1e-2, 1e-2), spoilt(ARM.read(SDS, 3), 0.1, 4), NOISE)
    found = solve_robust(problem, loss, method=METHOD)
    assert found.status.converged
    sweeper = Sweeper(problem, loss=loss)

    def cost(parameters) -> float:
        return sweeper.sweep(parameters, found.corrections, closing=NEGLIGIBLE).cost

    least = cost(found.parameters)
    assert found.chi_squared == pytest.approx(least, rel=1e-9)
    assert least < cost(problem.start)
    for i in range(len(found.parameters)):
        for side in (-1, 1):
            moved = found.parameters.copy()
            moved[i] += side * 1e-5
            assert cost(moved) > least


def test_a_fit_that_begins_at_the_end_stays() -> None:
    loss = StudentT()
    problem = build_problem(ARM.off(1e-2, 1e-2), spoilt(ARM.read(SDS, 3), 0.1, 4), NOISE)
    found = solve_robust(problem, loss, method=METHOD)
    again = solve_robust(replace(problem, start=found.parameters), loss, method=METHOD)
    assert again.chi_squared <= found.chi_squared * (1 + 1e-12)
    assert again.parameters == pytest.approx(found.parameters, abs=1e-9)


@pytest.mark.parametrize("method", ["implicit-loop", "reweighted"])
@pytest.mark.parametrize("loss", ["huber", "student-t"])
@pytest.mark.parametrize("share", [0.0, 0.05])
def test_intervals_hold_the_truth_with_and_without_gross_errors(method, loss, share) -> None:
    """The rms of 25 draws of 6 parameters has a standard error of 1 / sqrt(2 * 150) = 0.06.

    Sds that are stated 15 % too small fail 6 of these 8 cases, 15 % too large 4 of them.
    """
    z = []
    for draw in range(25):
        data = spoilt(ARM.read(SDS, 100 + draw), share, 900 + draw)
        result = lc.calibrate(ARM.truth, data, noise=NOISE, method=method, loss=loss)
        errors = [result.value[n] - v for n, v in ARM.values.items()]
        z.append(errors / np.sqrt(np.diag(result.covariance)))
    covered = np.mean(np.abs(z) < 1.96)
    assert covered == pytest.approx(0.95, abs=0.045)
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1.0, abs=0.15)


def test_a_robust_fit_has_no_chi_squared_and_says_its_loss() -> None:
    result = lc.calibrate(
        ARM.truth, ARM.read(SDS, 3), noise=NOISE, loss="huber", method="implicit-loop"
    )
    assert result.chi_squared is None
    assert result.loss == "huber"
    assert "loss huber" in str(result)


def test_unmeasured_quantities_are_allowed() -> None:
    data = spoilt(ARM.read(SDS, 3), 0.05, 4)
    noise = lc.Noise({**SDS, "phi3": np.inf})
    result = lc.calibrate(ARM.truth, data, noise=noise, loss="student-t", method="implicit-loop")
    assert result.status.converged
    assert result.value["l2"] == pytest.approx(ARM.values["l2"], abs=1e-3)


@pytest.mark.parametrize(
    ("how", "code", "stated"),
    [
        ({"loss": "hubber"}, "unknown-name", "hubber"),
        ({"loss": "huber", "method": "least-squares"}, "unsupported", "'least-squares'"),
        (
            {"loss": "huber", "method": "implicit-loop-undamped"},
            "unsupported",
            "'implicit-loop-undamped'",
        ),
        (
            {
                "loss": "huber",
                "noise": lc.Noise(SDS, estimate={"xP": "each"}),
                "method": "implicit-loop",
            },
            "unsupported",
            "'huber'",
        ),
    ],
)
def test_what_a_loss_cannot_do_is_refused(how, code, stated) -> None:
    with refused(code, stated) as caught:
        lc.calibrate(ARM.truth, ARM.read(SDS, 3), **{"noise": NOISE, **how})
    assert caught.value.remedy
