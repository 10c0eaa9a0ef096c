"""Calibration: a mechanism, its readings and what is known of their noise, to a result."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Unpack

import numpy as np

from loopcal.errors import InputError, NoTrustworthyResult
from loopcal.estimation.faults.search import suspicious
from loopcal.estimation.fit import Fit, FitOptions
from loopcal.estimation.methods.registry import PLAIN, names_where
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.result import FitResult
from loopcal.estimation.solve.robust import solve_robust
from loopcal.estimation.solve.scratch import one_blas_thread
from loopcal.estimation.solve.solution import Solution
from loopcal.estimation.solve.solver import Progress
from loopcal.estimation.steps import STEPS, Near, State, fitted, placed, prepared, refuse_loss
from loopcal.measurements.copies import copies
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise, NoiseLike
from loopcal.mechanisms.mechanism import Mechanism


def calibrate(
    mechanism: Mechanism,
    data: Dataset | Any,
    *,
    noise: NoiseLike | None = None,
    fit: Fit | None = None,
    progress: Progress | None = None,
    near: Near | None = None,
    trusted: bool = False,
    **options: Unpack[FitOptions],
) -> FitResult:
    """Calibrate a mechanism by one stated method, by default the implicit loop.

    As `loopcal.statistics.calibrate.calibrate`, which also chooses the method. near: the fit begins
    where one of nearly the same readings ended, so a misfit is no reason to try other starts;
    trusted: no fault of the file is sought.
    """
    fit = Fit.of(fit or Fit(method=PLAIN), options)
    state = _without_copies(mechanism, data, Noise.of(noise), fit, near)
    state = replace(state, trusted=trusted)

    def once(problem: Problem, most: int, tolerance: float | None) -> Solution:
        limits: Any = {"max_iterations": most, "tolerance": tolerance, "progress": progress}
        if (loss := fit.robust_loss) is not None:
            return solve_robust(problem, loss, method=fit.solver, **limits)
        return fit.solver.solve(problem, **limits)

    with one_blas_thread():
        for step in STEPS:
            state = step(state)
        return _result(fitted(state, once))


def _result(state: State) -> FitResult:
    """What all poses in memory came to."""
    begun, learnt = state.problem, state.estimate
    assert state.end is not None
    # The result evaluates the nominal machine at the start of its problem.
    problem = replace(learnt.problem, start=begun.start) if learnt else begun
    return FitResult(state.fit, state.data, problem, state.end, begun, learnt, faults=state.faults)


def _without_copies(
    mechanism: Mechanism,
    data: Dataset | Any,
    noise: Noise | None,
    fit: Fit,
    near: Near | None = None,
) -> State:
    """Where a calibration begins: without the rows that copy others.

    Raises InputError for a method that needs another noise.
    """
    refuse_noise(fit, noise)
    if not isinstance(data, Dataset):
        data = Dataset.from_arrays(data)
    repeated = copies(data, mechanism.recorded, mechanism.outputs)
    copied = repeated.copied
    if repeated.rows.size and repeated.by_chance:
        data = data.with_agreeing(repeated.rows)
    if copied.size:
        kept = np.delete(np.arange(len(data)), copied)
        data, noise = data.without_copies(copied), noise and noise.take(kept)
        near = near and near.take(kept)
    return State(fit, mechanism, data, noise, len(data), near=near)


def may_be_faulty(mechanism: Mechanism, data: Dataset, noise: Noise | None, fit: Fit) -> bool:
    """Whether `calibrate` would seek faults of the file: the machine as drawn misses the readings.

    Also where it cannot be placed.
    """
    if not isinstance(fit.start, str):
        return False
    with one_blas_thread():
        try:
            state = placed(prepared(_without_copies(mechanism, data, noise, fit)))
            return suspicious(state.problem, stated=state.stated)
        except (InputError, NoTrustworthyResult):
            return True


def refuse_noise(fit: Fit, noise: Noise | None) -> None:
    """Raise InputError where these settings need a noise, or cannot learn from this one."""
    if noise is None and not fit.method.exact and not fit.method.choice:
        raise InputError(
            f"the method {fit.method.name!r} needs the sds of the readings",
            code="missing-sd",
            remedy="give noise=Noise({...}) with an sd for every quantity, or use "
            f"method={' or '.join(map(repr, names_where('exact')))}",
        )
    if noise is not None and noise.estimate:
        refuse_loss(fit)
