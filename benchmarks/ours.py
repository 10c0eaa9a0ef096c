"""loopcal on the benchmark's problem: the solve alone, and the whole call with all it reports.

Each on either engine, on any number of threads.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from problems import Fit, Problem

import loopcal
from loopcal.estimation.problem.problem import build_problem
from loopcal.estimation.solve.solver import solve
from loopcal.expressions.choice import AVAILABLE

T = TypeVar("T")
SETTINGS = ("LOOPCAL_ENGINE", "LOOPCAL_THREADS")
BEST = "compiled" if AVAILABLE else "numpy"


def on_engine(engine: str, run: Callable[[], T], threads: int | None = None) -> Callable[[], T]:
    """The same on the engine "numpy" or "compiled"; threads: all cores if not given."""
    asked = {"LOOPCAL_ENGINE": engine}
    if threads is not None:
        asked["LOOPCAL_THREADS"] = str(threads)

    def chosen() -> T:
        before = {name: os.environ.pop(name, None) for name in SETTINGS}
        os.environ.update(asked)
        try:
            return run()
        finally:
            for name, value in before.items():
                os.environ.pop(name, None)
                if value is not None:
                    os.environ[name] = value

    return chosen


def solver(problem: Problem) -> Callable[[], Fit]:
    """From readings to parameters: build_problem and solve. Tracing the loops is done before."""
    mechanism, data, noise = problem.mechanism, problem.dataset, problem.noise

    def run() -> Fit:
        found = solve(build_problem(mechanism, data, noise))
        if not found.status.converged:
            raise RuntimeError(f"loopcal did not converge: {found.status.message}")
        return Fit(found.parameters, found.chi_squared, found.status.evaluations)

    return run


def calibrator(problem: Problem) -> Callable[[], Fit]:
    """The whole call: also residuals, accuracy before and after, covariance, identifiability."""
    mechanism, data, noise = problem.mechanism, problem.dataset, problem.noise

    def run() -> Fit:
        result = loopcal.calibrate(
            mechanism, data, noise=noise, start="nominal", method="implicit-loop"
        )
        assert result.chi_squared is not None
        values = np.array(list(result.value.values()))
        return Fit(values, result.chi_squared.value, result.status.evaluations)

    return run


def sds(problem: Problem) -> NDArray[np.float64]:
    """The sds of the parameters, (27,) [SI]."""
    result = loopcal.calibrate(
        problem.mechanism,
        problem.dataset,
        noise=problem.noise,
        start="nominal",
        method="implicit-loop",
    )
    return np.array(list(result.sd.values()), dtype=float)
