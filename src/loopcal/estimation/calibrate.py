"""Calibration: a mechanism, its readings and what is known of their noise, to a result."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, Unpack

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError, NoTrustworthyResult
from loopcal.estimation.faults.search import suspicious
from loopcal.estimation.fit import Fit, FitOptions
from loopcal.estimation.methods.registry import PLAIN, names_where
from loopcal.estimation.noise.learning import components
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.result import Result
from loopcal.estimation.solve.fallback import solve_or_fall_back
from loopcal.estimation.solve.robust import solve_robust
from loopcal.estimation.solve.scratch import one_blas_thread
from loopcal.estimation.solve.solution import Solution
from loopcal.estimation.solve.solver import Progress
from loopcal.estimation.steps import STEPS, State, ended, placed, prepared, refuse_loss
from loopcal.measurements.copies import copies
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise, NoiseLike
from loopcal.mechanisms.mechanism import Mechanism

# Chosen, not derived: it only asks whether lengths end far off, not where exactly.
TRIED, ROUGHLY = 30, 1e-2
"""Iterations, and tolerance, of the fit that shows whether only the drawing is far off."""
LEARNT = 1e-5
"""With terms a fit converges to so many sds, unless the user says otherwise: their own sds are
learnt from it, and are never known to so many digits."""

Array = NDArray[np.float64]


def calibrate(
    mechanism: Mechanism,
    data: Dataset | Any,
    *,
    noise: NoiseLike | None = None,
    fit: Fit | None = None,
    progress: Progress | None = None,
    near: Mapping[str, Array] | None = None,
    trusted: bool = False,
    **options: Unpack[FitOptions],
) -> Result:
    """Calibrate a mechanism by one stated method, by default the implicit loop.

    As `loopcal.statistics.calibrate.calibrate`, which also chooses the method. near: the fit begins
    where one of nearly the same readings ended, which found these corrections (N,) of what no
    sensor reads, so a misfit is no reason to try other starts; trusted: no fault of the file is
    sought.
    """
    fit = Fit.of(fit or Fit(method=PLAIN), options)
    state = _without_copies(mechanism, data, Noise.of(noise), fit, near)
    state = replace(state, trusted=trusted)
    with one_blas_thread():
        for step in STEPS:
            state = step(state)
        return _fitted(state, progress)


def _fitted(state: State, progress: Progress | None) -> Result:
    """The result of all poses in memory, once the machine is placed."""
    fit, problem, rest = state.fit, state.problem, (state.fit, state.data)

    def short(most: int, tolerance: float | None) -> Solution:
        """A fit that shows no more than whether the file is at fault."""
        limits = {"max_iterations": most, "tolerance": tolerance, "progress": progress}
        end = _solve(fit, problem, limits)
        return replace(end, status=end.status.ended_early())

    if state.hopeless:
        end = short(state.most_iterations, fit.tolerance)
        return Result(*rest, problem, end, problem, faults=state.faults)
    solved = _fits(state, progress)
    if state.noise is None or not state.learns:
        end = solved(problem)
        return Result(*rest, problem, end, problem, faults=ended(state, end).faults)
    if state.faults:  # nothing is learnt before a fit at the stated sds has come near
        end = short(min(fit.max_iterations, TRIED), ROUGHLY)
        if left := ended(state, end).faults:
            return Result(*rest, problem, end, problem, faults=left)
    from loopcal.estimation.noise.estimation import estimate_noise

    learnt = components(problem, state.noise)
    estimate = estimate_noise(problem, learnt, solved, begin=state.noise.begin)
    # The result evaluates the nominal machine at the start of its problem.
    at_learnt, end = replace(estimate.problem, start=problem.start), estimate.solution
    faults = ended(state, end).faults
    return Result(*rest, at_learnt, end, problem, estimate, faults=faults)


def _fits(state: State, progress: Progress | None) -> Callable[..., Solution]:
    """The solution at the sds of the problem, from other starts where it does not converge."""
    fit, learns = state.fit, state.learns
    judged = not (fit.solver.exact or fit.robust_loss or learns)
    with_terms = learns and bool(state.mechanism.learnt_terms)
    usual = (fit.tolerance or LEARNT) if with_terms else fit.tolerance
    arrived = state.near is not None
    if with_terms:
        import scipy.linalg  # noqa: F401  before more threads: the limit on BLAS then holds for it

    def solved(problem: Problem, *, tolerance: float | None = None) -> Solution:
        nonlocal arrived

        def once(problem: Problem) -> Solution:
            limits = {"tolerance": usual if tolerance is None else tolerance, "progress": progress}
            return _solve(fit, problem, {"max_iterations": fit.max_iterations, **limits})

        # an undamped method is for study: it shows how its own iteration ends; a fit begun near its
        # end needs no other start, nor does one at other sds that begins where another converged
        if fit.solver.damped or arrived:
            return once(problem)
        end = solve_or_fall_back(problem, once, fit.max_iterations, judged=judged)
        arrived = learns and end.status.converged
        return end

    return solved


def _solve(fit: Fit, problem: Problem, limits: Mapping[str, Any]) -> Solution:
    """The fit of a problem from its start. limits: iterations, tolerance and listeners."""
    if (loss := fit.robust_loss) is not None:
        return solve_robust(problem, loss, method=fit.solver, **limits)
    return fit.solver.solve(problem, **limits)


def _without_copies(
    mechanism: Mechanism,
    data: Dataset | Any,
    noise: Noise | None,
    fit: Fit,
    near: Mapping[str, Array] | None = None,
) -> State:
    """Where a calibration begins: without the rows that copy others.

    Raises InputError for a method that needs another noise.
    """
    refuse_noise(fit, noise)
    if not isinstance(data, Dataset):
        data = Dataset.from_arrays(data)
    repeated = copies(data, [*mechanism.quantities, *mechanism.pose_constants], mechanism.outputs)
    copied = repeated.copied
    if repeated.rows.size and repeated.by_chance:
        data = data.with_agreeing(repeated.rows)
    if copied.size:
        kept = np.delete(np.arange(len(data)), copied)
        data, noise = data.without_copies(copied), noise and noise.take(kept)
        near = near and {name: np.delete(values, copied) for name, values in near.items()}
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
