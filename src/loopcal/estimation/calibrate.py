"""Calibration: a mechanism, its readings and what is known of their noise, to a result."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Unpack

from loopcal.document.findings import ColumnFault
from loopcal.errors import InputError
from loopcal.estimation.faults.search import column_faults, suspicious
from loopcal.estimation.fit import Fit, FitOptions, Start
from loopcal.estimation.methods.registry import names_where
from loopcal.estimation.model_error import modelled, noise_told, weighed
from loopcal.estimation.noise.learning import components, with_model
from loopcal.estimation.problem.alignment import begins_aligned, placed
from loopcal.estimation.problem.parallel_axes import refuse_parallel_axes
from loopcal.estimation.problem.problem import Problem, build_problem
from loopcal.estimation.problem.unreachable import refuse_unreachable
from loopcal.estimation.result import Result
from loopcal.estimation.solve.fallback import solve_or_fall_back
from loopcal.estimation.solve.robust import solve_robust
from loopcal.estimation.solve.scratch import one_blas_thread
from loopcal.estimation.solve.solution import Solution
from loopcal.estimation.solve.solver import Progress
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise, NoiseLike
from loopcal.mechanisms.mechanism import Mechanism

FAULTY = 3
"""Iterations of the fit of a file that is at fault as a whole."""
LEARNT = 1e-5
"""With terms a fit converges to so many sds, unless the user says otherwise: their own sds are
learnt from it, and are never known to so many digits."""


def calibrate(
    mechanism: Mechanism,
    data: Dataset | Any,
    *,
    noise: NoiseLike | None = None,
    fit: Fit | None = None,
    progress: Progress | None = None,
    **options: Unpack[FitOptions],
) -> Result:
    """Calibrate a mechanism from readings.

    data: a Dataset, or a dict of (N,) arrays or any DataFrame of readings in SI units; noise: a
    Noise, or a dict of sds [SI] by quantity, which every method needs that is not exact; fit: the
    settings, or as keyword arguments prior, method, loss, start, max_iterations and tolerance,
    which override it; progress: called at every iteration. Angles are rad, lengths m throughout.

    method "implicit-loop" (default) finds the parameters of maximum likelihood while every loop
    closes: minimise sum_i c_i^T Sigma^-1 c_i + (p - nominal)^T Sigma_p^-1 (p - nominal) over
    parameters p and corrections c_i subject to f(reading_i + c_i, p) = 0 (Wampler, Hollerbach and
    Arai 1995; thesis 3.7 to 3.30). "least-squares" takes the readings as exact and minimises the
    sum of squared loop values (thesis 3.1 to 3.6), without noise or prior. "reweighted" weights
    the loop values at the readings by their propagated noise J_x Sigma J_x^T, and lets that noise
    say nothing about the parameters: the robust choice where poses are alike and sds guessed.
    "implicit-loop-undamped" is the iteration of the thesis, for study.

    loss "huber" or "student-t" lets poses that do not fit count less
    (`loopcal.estimation.solve.loss`); the covariance is then valid without normal errors, and
    there is no chi-squared. It needs "implicit-loop" or "reweighted" and stated sds.

    start "nominal"; "align" moves the nominal machine rigidly to where the instrument sees it;
    "auto" (default) aligns a machine whose placement parameters are free with flat priors; or
    parameter values [SI] by name.

    A file that is at fault as a whole (columns in another unit, reversed or exchanged, rows shifted
    or shuffled, readings of another machine) is recognised before the fit where it begins at the
    nominal machine. The fit is then cut short, no sd is estimated, and `Result.faults` names them.

    Raises InputError for input that cannot be used. A fit that does not converge is returned, with
    the reason in its status.
    """
    fit, stated = Fit.of(fit, options), Noise.of(noise)
    refuse_noise(fit, stated)
    if not isinstance(data, Dataset):
        data = Dataset.from_arrays(data)
    mechanism = modelled(fit, fit.with_prior(mechanism), len(data))
    told = noise_told(fit, mechanism, data, stated)
    refuse_learning(fit, mechanism, told)
    if told is not None:
        data = weighed(fit, data)
        mechanism, data = with_model(mechanism, data, told)

    def fitted(
        problem: Problem, tolerance: float | None, max_iterations: int = fit.max_iterations
    ) -> Solution:
        limits: dict[str, Any] = {
            "max_iterations": max_iterations,
            "tolerance": tolerance,
            "progress": progress,
        }
        if (loss := fit.robust_loss) is not None:
            return solve_robust(problem, loss, method=fit.solver, **limits)
        return fit.solver.solve(problem, **limits)

    learns = told is not None and bool(told.estimate or mechanism.terms)
    judged = not (fit.solver.exact or fit.robust_loss or learns)

    own = (fit.tolerance or LEARNT) if told is not None and mechanism.terms else fit.tolerance

    def solved(problem: Problem, *, tolerance: float | None = None) -> Solution:
        def once(problem: Problem) -> Solution:
            return fitted(problem, own if tolerance is None else tolerance)

        # an undamped method is for study: it shows how its own iteration ends
        if fit.solver.damped:
            return once(problem)
        return solve_or_fall_back(problem, once, fit.max_iterations, judged=judged)

    with one_blas_thread():
        problem = started(mechanism, data, told, fit.start)
        faults: tuple[ColumnFault, ...] = ()
        if isinstance(fit.start, str) and suspicious(problem):
            faults = column_faults(problem)
        if faults:  # no fit is of use: a short one, so that there is a result to say so
            short = fitted(problem, fit.tolerance, min(fit.max_iterations, FAULTY))
            return Result(fit, data, problem, short, problem, faults=faults)
        if told is None or not learns:
            return Result(fit, data, problem, solved(problem), problem)
        from loopcal.estimation.noise.estimation import estimate_noise

        estimate = estimate_noise(
            problem,
            components(problem, told),
            solved,
            at_readings=fit.solver.at_readings,
            begin=told.begin,
        )
        learnt = replace(estimate.problem, start=problem.start)
        return Result(fit, data, learnt, estimate.solution, problem, estimate)


def refuse_noise(fit: Fit, noise: Noise | None) -> None:
    """Raise InputError where these settings need a noise, or cannot learn from this one."""
    if noise is None and not fit.method.exact:
        raise InputError(
            f"the method {fit.method.name!r} needs the sds of the readings",
            code="missing-sd",
            remedy="give noise=Noise({...}) with an sd for every quantity, or use "
            f"method={' or '.join(map(repr, names_where('exact')))}",
        )
    if noise is not None and noise.estimate:
        _refuse_loss(fit)


def refuse_learning(fit: Fit, mechanism: Mechanism, noise: Noise | None) -> None:
    """Raise InputError where a loss would have to learn the sds of terms."""
    if noise is not None and (noise.estimate or mechanism.terms):
        _refuse_loss(fit)


def _refuse_loss(fit: Fit) -> None:
    if fit.robust_loss is not None:
        raise InputError(
            f"sds cannot be estimated under the loss {fit.loss!r}: outliers would inflate them",
            code="unsupported",
            remedy="find the outliers with this loss first and exclude them, then estimate; or "
            'take the sds as given (leave out "estimate")',
        )


def started(mechanism: Mechanism, data: Dataset, noise: Noise | None, start: Start) -> Problem:
    """The problem of a mechanism and its readings, at the point where a fit begins.

    noise: None takes the readings as exact. Raises InputError for readings that the machine cannot
    have made, for parallel axes whose parameters have no solution, and for parameter values by a
    name that is not there.
    """
    if not isinstance(start, str):
        for name in start:
            mechanism.parameters[name]  # raises for a name that is not there
        problem = build_problem(mechanism, data, noise, start)
        refuse_parallel_axes(mechanism)
        return problem
    problem = build_problem(mechanism, data, noise)
    refuse_parallel_axes(mechanism)
    if begins_aligned(mechanism, start):
        problem = problem.with_nominal(placed(problem)[0])
    refuse_unreachable(problem, problem.start)
    return problem
