"""Confidence intervals of parameters: from the covariance, and by profile likelihood.

The profile of a parameter is chi-squared minimised over all others while it is held. Where it
has risen by the quantile of chi-squared with one degree of freedom (3.84 for 95 %), there the
interval ends: Venzon and Moolgavkar (1988); Bates and Watts, Nonlinear Regression Analysis and
Its Applications (1988), section 6.1.2. It knows of curvature, of which the covariance, taken at
one point, knows nothing. Least squares knows no sds: there the rise counts in residual variances,
and its quantile is that of F with one and the residual degrees of freedom, the square of
Student's t.

Sds that were learnt are held at what the calibration of all poses found. That they are not known
makes both intervals wider alike: by Student's t and by what learning them adds to the sd
(`loopcal.estimation.noise.kenward_roger`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from loopcal.arrays import Array
from loopcal.document.fit import IntervalEntry
from loopcal.errors import InputError
from loopcal.estimation.methods.registry import names_where
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.problem.starting import start_corrections
from loopcal.estimation.result import FitResult
from loopcal.estimation.solve.gauss_newton import NEGLIGIBLE
from loopcal.estimation.solve.scratch import one_blas_thread
from loopcal.estimation.solve.solver import solve
from loopcal.estimation.solve.sweep import Sweeper
from loopcal.execution.executor import Executor, Progress, gathered
from loopcal.mechanisms.parameters import matching
from loopcal.small_samples import t_quantile

# Chosen, not derived: a tenth of a half width changes no decision.
DIFFERS = 0.1
"""Share of the half width by which an end may differ before the interval is marked."""
# Chosen, not derived: a hundredth of what DIFFERS looks at.
_CLOSE = 1e-3
"""The root is found when the rise is right to this much of a standard deviation."""
# Chosen, not derived: a cap.
_MOST = 30
# Chosen, not derived: an interval that ends farther out is open for any use.
_FARTHEST = 1e3
"""Sds out to which a profile is followed."""


@dataclass(frozen=True)
class Interval:
    """Confidence interval of a parameter [SI] at a level, from the covariance and by profile.

    profile_low, profile_high: where chi-squared, minimised over all other parameters, has risen
    to its limit; None where it never does. differs: whether an end of the two differs by more
    than a tenth of the half width: the parameter acts nonlinearly within its own uncertainty.
    """

    level: float
    low: float
    high: float
    profile_low: float | None
    profile_high: float | None
    differs: bool

    @property
    def entry(self) -> IntervalEntry:
        """As a document holds it."""
        ends = (self.low, self.high), (self.profile_low, self.profile_high)
        return IntervalEntry(self.level, *ends, self.differs)


def interval_entries(intervals: Mapping[str, Interval | None]) -> dict[str, IntervalEntry]:
    """As a document holds them; None: nothing bounds a parameter."""
    level = next((i.level for i in intervals.values() if i is not None), 0.95)
    unbounded = IntervalEntry(level, (None, None), (None, None), differs=False)
    return {name: unbounded if i is None else i.entry for name, i in intervals.items()}


def covariance_interval(result: FitResult, name: str, level: float = 0.95) -> Interval | None:
    """The interval value +- quantile * sd; None where fixed or not identifiable.

    quantile: of the normal distribution; of Student's t where sds were learnt, and for least
    squares.
    """
    sd = result.sd[name]
    if sd is None or not math.isfinite(sd):
        return None
    half = t_quantile(level, result.degrees_of_freedom[name] or math.inf) * sd
    value = result.value[name]
    return Interval(level, value - half, value + half, None, None, False)


def intervals(
    result: FitResult,
    patterns: str | Iterable[str] = "*",
    *,
    level: float = 0.95,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Mapping[str, Interval | None]:
    """Confidence intervals of the parameters that match, both ways, by name.

    None for a parameter that is fixed or not identifiable: nothing bounds it. executor: who
    follows the profiles, this process one by one if it is None; it changes no value. progress:
    called with how many profiles are done.

    Raises InputError for a name that stands for none and for a level that is none. It does so too
    for a method without likelihood (reweighted), and where a calibration did not converge.
    """
    if not 0.0 < level < 1.0:
        raise InputError(
            f"the level is {level:g}",
            code="invalid-value",
            remedy="give a number between 0 and 1, say 0.95",
        )
    _check(result)
    patterns = [patterns] if isinstance(patterns, str) else list(patterns)
    everything = result.mechanism.parameters.names
    wanted = {n for p in patterns for n in matching(p, everything, "parameter")}
    plain = {
        name: covariance_interval(result, name, level) for name in everything if name in wanted
    }
    profiled = {name: interval for name, interval in plain.items() if interval is not None}
    by_profile = gathered(
        executor, _profiled, _Optimum.of(result, level), [*profiled.items()], progress
    )
    return MappingProxyType({**plain, **dict(zip(profiled, by_profile, strict=True))})


def _check(result: FitResult) -> None:
    if not result.fit.solver.likelihood:
        raise InputError(
            f"the method {result.method!r} has no likelihood to profile",
            code="unsupported",
            remedy=f"calibrate with one of {', '.join(names_where('likelihood'))}",
        )
    if result.fit.robust_loss is not None:
        raise InputError(
            f"the loss {result.loss!r} has no likelihood to profile",
            code="unsupported",
            remedy='exclude the outliers it finds and calibrate with loss = "gaussian"',
        )
    if not result.status.converged:
        raise InputError(
            f"the fit did not converge ({result.status.reason}), so there is nothing to profile",
            code="not-converged",
            remedy=result.status.message,
        )


@dataclass(frozen=True)
class _Optimum:
    """Where the profiles begin: the parameters [SI], and chi-squared there.

    plain: (n, n) their covariance at the sds used; variance: what
    the rise of chi-squared counts in; limits: (n,) the root of the rise at which intervals end.
    """

    problem: Problem
    parameters: Array
    plain: Array
    least: float
    variance: float
    limits: Array

    @classmethod
    def of(cls, result: FitResult, level: float) -> _Optimum:
        whole, method = result.problem, result.fit.solver
        best = np.array([result.value[n] for n in whole.mechanism.parameters.names])
        least = _merit(result, whole, best)
        variance = method.unit_variance(least, result.freedom) or 1.0
        if result.variance_factor_applied and result.chi_squared is not None:
            variance = result.chi_squared.variance_factor or 1.0
        learnt = result.learnt_covariance
        wider = np.sqrt(np.diag(learnt.matrix) / np.maximum(np.diag(learnt.plain), 1e-300))
        limits = wider * [t_quantile(level, f) for f in learnt.freedom.tolist()]
        return cls(whole, best, learnt.plain, least, variance, limits)


def _profiled(at: _Optimum, parameter: tuple[str, Interval]) -> Interval:
    """The interval of a parameter, to which its profile is added."""
    name, plain = parameter
    with one_blas_thread():
        j = at.problem.names.index(name)
        profile = _Profile.of(at, j)
        low, high = (_root(profile, side * float(at.limits[j])) for side in (-1.0, 1.0))
    half = 0.5 * (plain.high - plain.low)
    off = [
        end is None or abs(end - straight) > DIFFERS * half
        for end, straight in ((low, plain.low), (high, plain.high))
    ]
    return replace(plain, profile_low=low, profile_high=high, differs=any(off))


@dataclass(frozen=True)
class _Profile:
    """The signed root of the rise of chi-squared over a parameter, in its own sds."""

    value: float
    sd: float
    root: Callable[[float], float | None]

    @classmethod
    def of(cls, at: _Optimum, j: int) -> _Profile:
        held, best = _held(at.problem, j), at.parameters
        position = int(at.problem.free[j])
        sd = math.sqrt(at.plain[j, j])
        # Of estimates that are jointly normal the others follow parameter j by C_ij / C_jj.
        slope = np.delete(at.plain[:, j], j) / at.plain[j, j]
        nominal, prior_sd = float(at.problem.nominal[j]), float(at.problem.prior_sd[j])
        last = [(0.0, best[held.free])]

        def root(z: float) -> float | None:
            """The signed root at value + z sd; None where the others find no place."""
            # along the straight line from the nearest point known, as the covariance has it
            by_distance = sorted(last, key=lambda point: abs(point[0] - z))
            for near, others in (*by_distance[:1], last[0], *by_distance[1:2]):
                for share in (1.0, 0.0):
                    start = best.copy()
                    start[position] += z * sd
                    start[held.free] = others + share * slope * (z - near) * sd
                    place = _reached(replace(held, start=start))
                    if place is None:
                        continue
                    last.append((z, place.others))
                    merit = place.merit
                    # A held parameter has left the prior of the problem: its term is added by hand.
                    if not held.loops_alike:
                        merit += ((start[position] - nominal) / prior_sd) ** 2
                    # Rounding, or an optimum that was not quite reached, may put it below 0.
                    rise = max(merit - at.least, 0.0)
                    return math.copysign(math.sqrt(rise / at.variance), z)
            return None

        return cls(float(best[position]), sd, root)


@dataclass(frozen=True)
class _Place:
    """Where the others go while one parameter is held, and chi-squared there."""

    others: Array
    merit: float


def _reached(problem: Problem) -> _Place | None:
    """The optimum from this start; None where the search does not reach one."""
    try:
        if not problem.free.size:
            sweeper = Sweeper(problem)
            corrections = start_corrections(sweeper, problem.start)
            sweep = sweeper.sweep(problem.start, corrections, closing=NEGLIGIBLE)
            merit = sweep.data.chi_squared
            closed = math.isfinite(merit) and not sweep.late
            return _Place(problem.nominal, merit) if closed else None
        solution = solve(problem)
    except InputError:
        return None  # beyond reach
    if not solution.status.converged:
        return None
    return _Place(solution.parameters[problem.free], solution.chi_squared)


def _held(problem: Problem, j: int) -> Problem:
    """The problem with its j-th estimated parameter held."""
    return replace(
        problem,
        free=np.delete(problem.free, j),
        nominal=np.delete(problem.nominal, j),
        prior_sd=np.delete(problem.prior_sd, j),
    )


def _merit(result: FitResult, problem: Problem, best: Array) -> float:
    """Chi-squared at the solution (the sum of squared loop values for an exact method)."""
    if not result.fit.solver.exact:
        assert result.chi_squared is not None
        return result.chi_squared.value
    return solve(replace(problem, start=best)).chi_squared


def _root(profile: _Profile, target: float) -> float | None:
    """The parameter's value where the signed root reaches the target; None where it never does.

    The root is nearly straight, so secants from the covariance's answer come close at once; they
    are kept within the bracket found so far.
    """
    side = math.copysign(1.0, target)
    inner, outer = 0.0, math.inf  # in sds, on this side of the value
    inner_rise, outer_rise = 0.0, math.inf
    z = abs(target)
    for _ in range(_MOST):
        root = profile.root(side * z)
        rise = math.inf if root is None else abs(root)
        if abs(rise - abs(target)) <= _CLOSE:
            return profile.value + side * z * profile.sd
        if rise < abs(target):
            inner, inner_rise = z, rise
        else:
            outer, outer_rise = z, rise
        z = _next(inner, inner_rise, outer, outer_rise, abs(target))
        if z > _FARTHEST or outer - inner < 1e-9 * max(outer, 1.0):
            return None
    return None


def _next(inner: float, inner_rise: float, outer: float, outer_rise: float, target: float) -> float:
    if math.isinf(outer):
        if inner_rise <= 0.0:
            return 2.0 * inner
        # A flat beginning would send the secant out of reach at once.
        return min(inner * target / inner_rise, 4.0 * inner)
    if math.isinf(outer_rise):
        return 0.5 * (inner + outer)
    z = inner + (outer - inner) * (target - inner_rise) / (outer_rise - inner_rise)
    # Off both ends: in a curved profile one of them would never move, and the secant creep.
    margin = 0.01 * (outer - inner)
    return min(max(z, inner + margin), outer - margin)
