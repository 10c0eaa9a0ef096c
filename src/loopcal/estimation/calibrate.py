"""Calibration: a mechanism, its readings and what is known of their noise, to a result."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Unpack

import numpy as np
from numpy.typing import NDArray

from loopcal.document.findings import ColumnFault
from loopcal.errors import InputError, NoTrustworthyResult
from loopcal.estimation.faults.misfit import at_start
from loopcal.estimation.faults.search import PLAUSIBLE, UNREPAIRED, column_faults, suspicious
from loopcal.estimation.fit import Fit, FitOptions, Start
from loopcal.estimation.methods.registry import PLAIN, names_where
from loopcal.estimation.model_error import modelled, noise_told, weighed
from loopcal.estimation.noise.learning import components, with_model
from loopcal.estimation.problem.alignment import begun
from loopcal.estimation.problem.parallel_axes import refuse_parallel_axes
from loopcal.estimation.problem.problem import Problem, build_problem
from loopcal.estimation.problem.size import refuse_collapse
from loopcal.estimation.problem.unreachable import refuse_unreachable
from loopcal.estimation.result import Result
from loopcal.estimation.solve.fallback import solve_or_fall_back
from loopcal.estimation.solve.robust import solve_robust
from loopcal.estimation.solve.scratch import one_blas_thread
from loopcal.estimation.solve.solution import Solution
from loopcal.estimation.solve.solver import Progress
from loopcal.measurements.copies import copies
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise, NoiseLike
from loopcal.mechanisms.mechanism import Mechanism

FAULTY = 3
"""Iterations of the fit of a file that is at fault as a whole."""
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
    taken = _prepared(mechanism, data, Noise.of(noise), fit)
    mechanism, data, told = taken.mechanism, taken.data, taken.noise
    if taken.copied.size:
        near = near and {name: np.delete(values, taken.copied) for name, values in near.items()}

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

    learns = told is not None and bool(told.estimate or mechanism.learnt_terms)
    judged = not (near is not None or fit.solver.exact or fit.robust_loss or learns)

    own = (fit.tolerance or LEARNT) if learns and mechanism.learnt_terms else fit.tolerance

    arrived = near is not None

    def solved(problem: Problem, *, tolerance: float | None = None) -> Solution:
        nonlocal arrived

        def once(problem: Problem) -> Solution:
            return fitted(problem, own if tolerance is None else tolerance)

        # an undamped method is for study: it shows how its own iteration ends; a fit begun near its
        # end needs no other start, nor does one at other sds that begins where another converged
        if fit.solver.damped or arrived:
            return once(problem)
        found = solve_or_fall_back(problem, once, fit.max_iterations, judged=judged)
        arrived = learns and found.status.converged
        return found

    if learns and mechanism.learnt_terms:
        import scipy.linalg  # noqa: F401  before the limit, which then holds for its threads too

    with one_blas_thread():
        problem = started(mechanism, data, told, fit.start)
        if near is not None:
            problem = begun_near(problem, near)
        if fit.solver.exact or fit.solver.at_readings:
            arrays = problem.readings, problem.known, problem.uncertainty.sd
            refuse_collapse(problem.mechanism, *arrays, priors=not fit.solver.exact)
        faults: tuple[ColumnFault, ...] = ()
        if not trusted and isinstance(fit.start, str):
            faults = column_faults(problem, suspected=False, stated=_stated(told))
        if any(fault.code not in UNREPAIRED for fault in faults):
            # no fit is of use: a short one, so that there is a result to say so
            short = fitted(problem, fit.tolerance, min(fit.max_iterations, FAULTY))
            short = replace(short, status=short.status.ended_early())
            return Result(fit, data, problem, short, problem, faults=faults)
        if told is None or not learns:
            found = solved(problem)
            faults = faults and left_after(faults, problem, found)
            return Result(fit, data, problem, found, problem, faults=faults)
        if faults:  # nothing is learnt before a fit at the stated sds has come near
            tried = fitted(problem, ROUGHLY, min(fit.max_iterations, TRIED))
            if left := left_after(faults, problem, tried):
                tried = replace(tried, status=tried.status.ended_early())
                return Result(fit, data, problem, tried, problem, faults=left)
        from loopcal.estimation.noise.estimation import estimate_noise

        estimate = estimate_noise(
            problem,
            components(problem, told),
            solved,
            at_readings=fit.solver.at_readings,
            begin=told.begin,
        )
        learnt = replace(estimate.problem, start=problem.start)
        faults = faults and left_after(faults, problem, estimate.solution)
        return Result(fit, data, learnt, estimate.solution, problem, estimate, faults=faults)


@dataclass(frozen=True, eq=False)
class _Prepared:
    """A machine with its model error, its readings, and what is known of their noise; copied:
    positions of the rows that copy others, which are out."""

    mechanism: Mechanism
    data: Dataset
    noise: Noise | None
    copied: NDArray[np.intp]


def _prepared(
    mechanism: Mechanism, data: Dataset | Any, stated: Noise | None, fit: Fit
) -> _Prepared:
    """What is fitted; raises InputError for settings that do not go together."""
    refuse_noise(fit, stated)
    if not isinstance(data, Dataset):
        data = Dataset.from_arrays(data)
    copied = copies(data, [*mechanism.quantities, *mechanism.known], mechanism.outputs)
    if copied.size:
        kept = np.delete(np.arange(len(data)), copied)
        data, stated = data.without_copies(copied), stated and stated.take(kept)
    mechanism = modelled(fit, fit.with_prior(mechanism), len(data))
    told = noise_told(fit, mechanism, data, stated)
    refuse_learning(fit, mechanism, told)
    if told is not None:
        data = weighed(fit, data)
        mechanism, data = with_model(mechanism, data, told)
    return _Prepared(mechanism, data, told, copied)


def may_be_faulty(mechanism: Mechanism, data: Dataset, noise: Noise | None, fit: Fit) -> bool:
    """Whether `calibrate` would seek faults of the file: the machine as drawn misses the readings.

    Also where it cannot be placed.
    """
    if not isinstance(fit.start, str):
        return False
    with one_blas_thread():
        try:
            at = _prepared(mechanism, data, noise, fit)
            problem = started(at.mechanism, at.data, at.noise, fit.start)
            return suspicious(problem, stated=_stated(at.noise))
        except (InputError, NoTrustworthyResult):
            return True


def _stated(noise: Noise | None) -> bool:
    """Whether the sds say how large the noise is, because none of them is learnt."""
    return noise is not None and not noise.estimate


def left_after(
    faults: tuple[ColumnFault, ...], problem: Problem, found: Solution
) -> tuple[ColumnFault, ...]:
    """The faults that a fit has not removed: a machine far from its drawing may yet be found."""
    missed = at_start(replace(problem, start=found.parameters))
    return faults if not found.status.converged or missed > PLAUSIBLE else ()


def begun_near(problem: Problem, near: Mapping[str, Array]) -> Problem:
    """The problem, which begins at these corrections (N,) of what no sensor reads."""
    names = problem.mechanism.tape.quantities
    zero = np.zeros(problem.count)
    return replace(problem, found=np.array([near.get(name, zero) for name in names]))


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
        _refuse_loss(fit)


def refuse_learning(fit: Fit, mechanism: Mechanism, noise: Noise | None) -> None:
    """Raise InputError where a loss would have to learn the sds of terms."""
    if noise is not None and (noise.estimate or mechanism.learnt_terms):
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
    if (placed := begun(problem, start)) is not mechanism:
        problem = problem.with_nominal(placed)
    refuse_unreachable(problem, problem.start)
    return problem
