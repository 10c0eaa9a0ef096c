"""NIST's certified nonlinear regressions: right to six digits, or not called converged."""

from __future__ import annotations

import math

import numpy as np
import pytest

import loopcal as lc
from tests.reference.nist import certified

PROBLEMS = certified()
RUN_AWAY = {("MGH09", 0), ("MGH17", 0)}
"""From these starts chi-squared falls towards infinite parameters, by either method."""


@pytest.mark.parametrize("method", ["implicit-loop", "least-squares"])
@pytest.mark.parametrize("start", [0, 1])
@pytest.mark.parametrize("name", PROBLEMS)
def test_parameters_and_sds_are_certified_or_the_fit_has_not_converged(
    name: str, start: int, method: str
) -> None:
    problem = PROBLEMS[name]
    noise = problem.noise if method == "implicit-loop" else None
    result = lc.calibrate(
        problem.mechanism, problem.data, noise=noise, method=method, start=problem.starts[start]
    )
    assert len(result.dataset) == len(problem.data)  # rounded readings that repeat are honest
    assert result.status.converged == ((name, start) not in RUN_AWAY)
    if not result.status.converged:
        assert result.status.reason == "runaway"
        return
    # residuals of Lanczos1 are hardly more than one rounding of its readings
    step = np.finfo(float).eps * np.abs(problem.data.readings["y"]).max()
    rounding = max(1e-6, step / problem.residual_sd)
    factor = 1.0
    if result.chi_squared is not None:
        factor = math.sqrt(result.chi_squared.variance_factor or math.nan)
        assert factor == pytest.approx(1.0, rel=rounding)
    # certified sds hold for independent errors, also where residuals depend on the order
    sds = np.sqrt(np.diag(result.as_if_independent().covariance))
    for parameter, value in problem.values.items():
        sd = float(sds[result.estimated.index(parameter)])
        assert result.value[parameter] == pytest.approx(value, rel=1e-6)
        assert factor * sd == pytest.approx(problem.sds[parameter], rel=rounding)


def test_a_parameter_without_effect_left_is_named() -> None:
    problem = PROBLEMS["MGH17"]
    result = lc.calibrate(
        problem.mechanism,
        problem.data,
        noise=problem.noise,
        method="implicit-loop",
        start=problem.starts[0],
    )
    assert result.status.reason == "runaway"
    assert "Parameters: b4, b5." in result.status.message
