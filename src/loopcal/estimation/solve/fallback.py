"""What is tried after a fit that did not converge or misfits: other starts, in a fixed order.

    1. least squares: the parameters that close the loops best with the readings taken as exact;
    2. the iteration of the thesis, undamped, from the same start;
    3. the best of least-squares fits from several starts, ever farther from the start.

The result is the first of them from which the fit converges: no higher than where it ended before,
and with as many directions determined as at the start, so that no parameter has run away.

A fit that converged with a chi-squared far above its degrees of freedom may be at a local optimum.
Then least-squares fits from the stated start and from the best of several are refined where the
merit is lower than at the end of the fit. That costs a few dozen sweeps of some poses elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from loopcal.arrays import Array
from loopcal.errors import InputError
from loopcal.estimation.problem.problem import Problem, Weighting, taken
from loopcal.estimation.solve.in_memory import outside_domain
from loopcal.estimation.solve.kernel import unload
from loopcal.estimation.solve.loss import Loss
from loopcal.estimation.solve.merit import without_state
from loopcal.estimation.solve.reduction import Accumulator, overflowing, spectrum
from loopcal.estimation.solve.solution import MOST_ITERATIONS, Solution, Status
from loopcal.estimation.solve.solver import Progress, solve
from loopcal.estimation.solve.sweep import Sweeper
from loopcal.presentation.shown import significant

# docs/decisions/0023.
_POSES = 200
"""Starts are sought on so many of the poses at most."""
# Chosen, not derived: time of a search whose end is fitted again.
_MOST = 100
"""Iterations of a search for a start."""
# Three radii with eight draws are the 24 starts of docs/decisions/0023.
_RADII, _DRAWS, _SEARCH, _GLANCE = (0.1, 0.3, 1.0), 8, 50, 3
"""Several starts: so many at each radius, as shares of half a turn, of the largest length and of
other parameters themselves; each is searched for so many iterations, after a misfit for few."""
# Chosen, not derived: above what convergence leaves open, below what another optimum changes.
_HIGHER = 1e-6
# docs/decisions/0023.
_MISFIT = 10.0
"""Chi-squared for each degree of freedom from which another optimum is sought."""


def solve_or_fall_back(
    problem: Problem,
    fit: Callable[[Problem], Solution],
    max_iterations: int = MOST_ITERATIONS,
    *,
    judged: bool = False,
) -> Solution:
    """The fit from the problem's start, or from others if it does not converge.

    The status says what was tried; max_iterations: of each search for a start, at most; judged:
    whether chi-squared shows how well the fit agrees with the sds, so that a misfit is tried again
    too. Raises InputError as the fit does.
    """
    first, most = fit(problem), min(max_iterations, _MOST)
    if first.status.converged:
        freedom = max(first.equations - len(problem.free), 1)
        misfits = judged and first.chi_squared > _MISFIT * freedom
        return _or_lower(problem, fit, first, most) if misfits else first
    if first.status.reason == "runaway":
        return first  # elsewhere a model that invites parameters to infinity has false optima
    tried: list[str] = []
    rank = solve(problem.weighted(Weighting.ALIKE), max_iterations=0).spectrum.rank
    for name, start in _starts(problem, most):
        tried.append(name)
        try:
            refit = fit(replace(problem, start=start))
        except InputError:  # the loops have no value there
            continue
        lower = refit.chi_squared <= first.chi_squared * (1 + _HIGHER)
        if refit.status.converged and lower and refit.spectrum.rank >= rank:
            note = f"Started from {name}: from the stated start it ended {first.status.reason}."
            return _with_note(refit, note)
    words = ", ".join(tried)
    return _with_note(first, f"Starting from {words} did not help." if words else "")


def _or_lower(
    problem: Problem, fit: Callable[[Problem], Solution], first: Solution, most: int
) -> Solution:
    """A fit that converged, or one from elsewhere that ends lower with no direction lost."""
    some = _some(problem)
    merit = _merit(some, first.parameters)
    for name, start in _lower_starts(some, most):
        try:
            if not _merit(some, start) < merit:
                continue
            refit = fit(replace(problem, start=start))
        except InputError:  # the loops have no value there
            continue
        lower = refit.chi_squared < first.chi_squared * (1 - _HIGHER)
        if refit.status.converged and lower and refit.spectrum.rank >= first.spectrum.rank:
            times = significant(first.chi_squared / max(refit.chi_squared, 1e-300), 2)
            note = f"Started from {name}: from the stated start chi-squared is {times} times this."
            return _with_note(refit, note)
    return first


def _merit(problem: Problem, parameters: Array) -> float:
    """Chi-squared at these parameters, infinite where the loops do not close."""
    try:
        solution = solve(replace(problem, start=parameters), max_iterations=0)
    except InputError:
        return np.inf
    return np.inf if solution.status.reason == "cannot_close" else solution.chi_squared


def _lower_starts(some: Problem, most: int) -> Iterator[tuple[str, Array]]:
    """Least-squares fits from the stated start, and from the best of several."""
    if end := _least_squares(some, some.start, most):
        yield "least squares", end.parameters
    if (best := _best(some, _GLANCE)) is not None and (end := _least_squares(some, best, most)):
        yield "the best of several starts", end.parameters


def _best(some: Problem, iterations: int) -> Array | None:
    """The end of the best of least-squares fits from several starts."""
    best, least = None, np.inf
    for start in _several(some):
        end = _least_squares(some, start, iterations)
        if end and end.chi_squared < least:
            best, least = end.parameters, end.chi_squared
    return best


def _least_squares(some: Problem, start: Array, most: int) -> Solution | None:
    """The fit with the readings taken as exact; None where the loops have no value."""
    try:
        begun = replace(some, start=start, weighting=Weighting.ALIKE)
        return solve(begun, max_iterations=most)
    except InputError:
        return None


def _some(problem: Problem) -> Problem:
    """The problem with a part of its poses, if there are many."""
    stride = max(1, len(problem.poses) // _POSES)
    return taken(problem, np.arange(0, len(problem.poses), stride)) if stride > 1 else problem


def _with_note(solution: Solution, note: str) -> Solution:
    message = f"{solution.status.message} {note}".strip()
    return replace(solution, status=replace(solution.status, message=message, note=note))


def _starts(problem: Problem, most: int) -> Iterator[tuple[str, Array]]:
    some = _some(problem)
    searches: dict[str, Callable[[], Solution]] = {
        "least squares": lambda: solve(some.weighted(Weighting.ALIKE), max_iterations=most),
    }
    if not some.loops_alike and not any(pattern.predicted for pattern in some.patterns):
        searches["the iteration of the thesis"] = lambda: iterate_undamped(
            some, max_iterations=most
        )
    for name, search in searches.items():
        try:
            parameters = search().parameters
        except InputError:
            continue
        if np.isfinite(parameters).all():
            yield name, parameters
    if (best := _best(some, min(most, _SEARCH))) is not None:
        yield "the best of several starts", best


def _several(problem: Problem) -> Iterator[Array]:
    """Parameters (n_all,) around the start, the same in every run."""
    units = np.array(problem.units)
    begun = problem.start[problem.free]
    lengths = np.abs(begun[units == "m"])
    spread = np.abs(begun)
    spread[units == "rad"] = np.pi
    spread[units == "m"] = lengths.max(initial=0.0)
    rng = np.random.default_rng(0)
    for radius in _RADII:
        for _ in range(_DRAWS):
            yield problem.unknowns.moved(
                problem.start, radius * spread * rng.uniform(-1.0, 1.0, len(spread))
            )


# The seed's own iteration, step by step and undamped, for study: equations (3.24) to (3.30).

TOLERANCE = 1e-10
"""Converged when no normalised parameter or correction moves by more than this many sds."""


def iterate_undamped(
    problem: Problem,
    *,
    loss: Loss | None = None,
    max_iterations: int = MOST_ITERATIONS,
    tolerance: float | None = None,
    progress: Progress | None = None,
) -> Solution:
    """Full steps in parameters and corrections together, as the seed writes them.

    D_i = R_i^-T J_q,i and E_i = Q_i^T y_i - R_i^-T f_i; [D; I] dq = [E; -q] in least squares;
    y_i <- Q_i (E_i - D_i dq), q <- q + dq, until neither moves. Nothing keeps a step from making
    things worse: the status then says "max_iterations" or "diverged", and the point is whatever
    was reached. Needs finite memory for all D_i at once, and every quantity measured or exact.
    It knows no loss, which `Fit` refuses, and reports no progress.

    Raises InputError if a quantity is unmeasured.
    """
    if any(pattern.unmeasured for pattern in problem.patterns):
        raise InputError(
            "the undamped iteration of the thesis cannot handle unmeasured quantities",
            code="unsupported",
            remedy='use method = "implicit-loop"',
        )
    least = TOLERANCE if tolerance is None else tolerance
    sweeper = Sweeper(problem)
    parameters = problem.start.copy()
    corrections = np.zeros_like(problem.readings)
    reason, iteration, first = "max_iterations", 0, np.inf
    before = parameters, corrections
    while reason == "max_iterations" and iteration < max_iterations:
        iteration += 1
        offset = problem.nominal - parameters[problem.free]
        data, steps, proposals = _linearised(sweeper, parameters, corrections)
        if not data.finite:
            if iteration == 1:
                raise outside_domain(problem, parameters)
            reason, (parameters, corrections) = "diverged", before
            break
        before = parameters.copy(), corrections
        if iteration == 1:
            first = data.chi_squared + float(np.square(offset / problem.prior_sd).sum())
        system = spectrum(data, offset, problem.prior_sd)
        step = system.step()
        new = proposals - np.einsum("nkb,n->kb", steps, step)
        parameters[problem.free] += step
        moved = np.abs(step / np.sqrt(np.maximum(np.diag(system.covariance()), 1e-300))).max()
        sd = np.where(problem.uncertainty.sd > 0, problem.uncertainty.sd, np.inf)
        shifted = (np.abs(new - corrections) / sd).max()
        corrections = new
        if max(moved, shifted) <= least * max(1.0, np.abs(corrections / sd).max()):
            reason = "converged"
    sweep = sweeper.sweep(parameters, corrections)
    end = spectrum(sweep.data, problem.unknowns.offset(parameters), problem.prior_sd)
    prior = problem.unknowns.prior_square(parameters)
    if reason == "max_iterations" and not sweep.data.chi_squared + prior <= first:
        reason = "diverged"
    status = Status.of(reason, iteration, sweeper.evaluations / len(problem.poses))
    return Solution(parameters, corrections, without_state(sweep), end, prior, status)


@overflowing
def _linearised(
    sweeper: Sweeper, parameters: Array, corrections: Array
) -> tuple[Accumulator, Array, Array]:
    """The parameter system; S Q D, (n, k, N), which turns dq into corrections; and S Q E."""
    problem = sweeper.problem
    data = Accumulator(len(problem.free), True, problem.units)
    steps = np.zeros((len(problem.free), *corrections.shape))
    proposals = np.zeros_like(corrections)
    for pattern, block in sweeper.blocks(parameters, corrections):
        values = sweeper.loop_values(pattern, block)
        sweeper.evaluations += block.count
        whitened = sweeper.reduce(values, block)
        data.add(whitened.rows)
        proposals[:, block.poses] = whitened.correction
        for j, column in enumerate(whitened.D):
            steps[j][:, block.poses] = unload(whitened.G, column, block.noise)
    return data, steps, proposals
