"""The steps of a calibration, each from a state to the next.

They are the same in memory as on a stream, which takes those before the fit with the poses of its
first chunk. An interrupted run takes these again, for they cost little beside the fit, and resumes
that from its checkpoint.

Parallel axes in Denavit and Hartenberg's parameters, whose estimation has no solution.

The common normal of two parallel axes lies anywhere along them. If the second one is misaligned by
little, d, a, alpha and offset jump to values far from the nominal ones: a fit runs away or stalls.
Hayati and Mirmirani (1985) therefore give such a joint a second angle, beta, in place of d.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.document.findings import ColumnFault
from loopcal.errors import InputError
from loopcal.estimation.faults.misfit import at_start
from loopcal.estimation.faults.search import PLAUSIBLE, UNREPAIRED, column_faults
from loopcal.estimation.fit import Fit, Start, modelled, used_noise, weighed
from loopcal.estimation.noise.learning import components, with_model
from loopcal.estimation.plausible import refuse_contradiction
from loopcal.estimation.problem.alignment import begun
from loopcal.estimation.problem.problem import Problem, Weighting, build_problem
from loopcal.estimation.problem.size import refuse_collapse, refuse_without_length
from loopcal.estimation.problem.starting import refuse_unreachable
from loopcal.estimation.solve.fallback import solve_or_fall_back
from loopcal.estimation.solve.reduction import LARGE
from loopcal.estimation.solve.solution import End
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.serial import Joint, parameter_name

if TYPE_CHECKING:
    from loopcal.estimation.noise.estimation import NoiseEstimate


# docs/decisions/0052.
FAULTY = 3
"""Iterations of the fit of a file that is at fault as a whole."""
# Chosen, not derived: it only asks whether lengths end far off, not where exactly.
TRIED, ROUGHLY = 30, 1e-2
"""Iterations, and tolerance, of the fit that shows whether only the drawing is far off."""
LEARNT = 1e-5
"""With terms a fit converges to so many sds, unless the user says otherwise: their own sds are
learnt from it, and are never known to so many digits."""


class Once(Protocol):
    """One fit of a problem from its start: of poses in memory, or of all chunks of a stream."""

    def __call__(self, problem: Problem, most: int, tolerance: float | None, /) -> End[Any]:
        """most: iterations; tolerance: in sds, None is the method's own."""


@dataclass(frozen=True, eq=False)
class Near:
    """Where a fit of nearly the same readings ended: another one of them begins there.

    unread: values (N,) [SI] of what no sensor reads, by quantity; factors: learnt over stated sds,
    by name, None where they had not settled; roughly: the search for sds may end near its end.
    """

    unread: Mapping[str, Array]
    factors: Mapping[str, float] | None = None
    roughly: bool = True

    def take(self, index: NDArray[np.intp]) -> Near:
        """Of the poses at these positions."""
        return replace(self, unread={name: row[index] for name, row in self.unread.items()})


@dataclass(frozen=True, eq=False)
class State:
    """What is known between two steps.

    mechanism, data, noise: what is fitted, in a stream the poses of its first chunk; poses: how
    many there are in all; whole: these are all poses; near: where a fit of nearly the same
    readings ended; trusted: no fault of the file is sought; faults: of the file; begun: where the
    fit begins; end: where it ended; estimate: what it learnt of the sds.
    """

    fit: Fit
    mechanism: Mechanism
    data: Dataset
    noise: Noise | None
    poses: int
    whole: bool = True
    near: Near | None = None
    trusted: bool = False
    faults: tuple[ColumnFault, ...] = ()
    begun: Problem | None = None
    end: End[Any] | None = None
    estimate: NoiseEstimate | None = None

    @property
    def problem(self) -> Problem:
        """Where the fit begins; there once the machine is placed."""
        assert self.begun is not None
        return self.begun

    @property
    def learns(self) -> bool:
        """Whether sds are learnt, of sensors or of terms."""
        noise = self.noise
        return noise is not None and bool(noise.estimate or self.mechanism.learnt_terms)

    @property
    def stated(self) -> bool:
        """Whether the sds say how large the noise is, because none of them is learnt."""
        return self.noise is not None and not self.noise.estimate

    @property
    def hopeless(self) -> bool:
        """Whether the file is at fault so that no fit is of use: a short one shows where."""
        return any(fault.code not in UNREPAIRED for fault in self.faults)


def prepared(state: State) -> State:
    """With the terms and the noise of the model error that the fit asks for.

    Raises InputError for settings that do not go together.
    """
    fit, data = state.fit, state.data
    mechanism = modelled(fit, fit.with_prior(state.mechanism), data, state.poses)
    noise = used_noise(fit, mechanism, data, state.noise)
    if noise is not None:
        if noise.estimate or mechanism.learnt_terms:
            refuse_loss(fit)
        mechanism, data = with_model(mechanism, weighed(fit, data), noise)
    return replace(state, mechanism=mechanism, data=data, noise=noise)


def placed(state: State) -> State:
    """With the problem, begun where the instrument sees the machine.

    Raises InputError for readings that the machine cannot have made, that contradict each other,
    or that leave its size open.
    """
    fit = state.fit
    problem = started(state.mechanism, state.data, state.noise, fit.start, whole=state.whole)
    problem = problem.weighted(fit.solver.weighting)
    if not problem.loops_alike:
        refuse_contradiction(problem, state.data)
    if state.near is not None:
        problem = begun_near(problem, state.near.unread)
    if problem.weighting is not Weighting.CORRECTED:
        arrays = problem.readings, problem.pose_constants, problem.uncertainty.sd
        refuse_collapse(problem.mechanism, *arrays, priors=not problem.loops_alike)
    return replace(state, begun=problem, mechanism=problem.mechanism)


def examined(state: State) -> State:
    """With the faults of the file as a whole, which are sought before any fit."""
    if state.trusted or not isinstance(state.fit.start, str):
        return state
    faults = column_faults(state.problem, suspected=False, stated=state.stated)
    return replace(state, faults=faults)


STEPS = (prepared, placed, examined)


def fitted(state: State, once: Once) -> State:
    """With the end of its fit, the sds learnt, and the faults that the fit has not removed."""
    fit, problem = state.fit, state.problem

    def short(most: int, tolerance: float | None) -> State:
        """With a fit that shows no more than whether the file is at fault."""
        end = once(problem, min(fit.max_iterations, most), tolerance)
        return _ended(state, replace(end, status=end.status.ended_early()))

    if state.hopeless:
        return short(FAULTY, fit.tolerance)
    solved = _fits(state, once)
    if state.noise is None or not state.learns:
        return _ended(state, solved(problem))
    # Nothing is learnt before a fit at the stated sds has come near.
    if state.faults and (tried := short(TRIED, ROUGHLY)).faults:
        return tried
    from loopcal.estimation.noise.estimation import estimate_noise

    learnt, near = components(problem, state.noise), state.near or Near({})
    estimate = estimate_noise(problem, learnt, solved, begin=near.factors, roughly=near.roughly)
    return replace(_ended(state, estimate.solution), estimate=estimate)


def _ended(state: State, end: End[Any]) -> State:
    """With the faults that a fit has not removed: a machine far from its drawing may be found."""
    faults = state.faults
    if faults and not state.hopeless and end.status.converged:
        missed = at_start(replace(state.problem, start=end.parameters))
        faults = () if missed <= PLAUSIBLE else faults
    return replace(state, end=end, faults=faults)


def _fits(state: State, once: Once) -> Callable[..., End[Any]]:
    """The fit at the sds of a problem, from other starts where it does not converge."""
    fit, learns = state.fit, state.learns
    judged = not (fit.solver.exact or fit.robust_loss or learns)
    with_terms = learns and bool(state.mechanism.learnt_terms)
    usual = (fit.tolerance or LEARNT) if with_terms else fit.tolerance
    # An undamped method is for study: it shows how its own iteration ends. A fit begun near its end
    # needs no other start, nor does one at other sds that begins where another converged.
    arrived = state.near is not None or fit.solver.damped is not None or not state.whole
    if with_terms or len(state.problem.free) >= LARGE:
        import scipy.linalg  # noqa: F401  before more threads: the limit on BLAS then holds for it

    def solved(problem: Problem, *, tolerance: float | None = None) -> End[Any]:
        nonlocal arrived

        def from_start(problem: Problem) -> End[Any]:
            return once(problem, fit.max_iterations, usual if tolerance is None else tolerance)

        if arrived:
            return from_start(problem)
        end = solve_or_fall_back(problem, from_start, fit.max_iterations, judged=judged)
        arrived = learns and end.status.converged
        return end

    return solved


def begun_near(problem: Problem, unread: Mapping[str, Array]) -> Problem:
    """The problem, which begins at these values (N,) [SI] of what no sensor reads.

    Not at corrections: what stands for a missing reading comes from its neighbours, which differ
    where poses are left out.
    """
    rows = zip(problem.mechanism.tape.quantities, problem.readings, strict=True)
    first = np.array([unread.get(name, row) - row for name, row in rows])
    return replace(problem, first_corrections=first)


def started(
    mechanism: Mechanism,
    data: Dataset,
    noise: Noise | None,
    start: Start,
    *,
    whole: bool = True,
) -> Problem:
    """The problem of a mechanism and its readings, at the point where a fit begins.

    noise: None takes the readings as exact; whole: these are all poses. Raises InputError for
    readings that the machine cannot have made, for parallel axes whose parameters have no
    solution, and for parameter values by a name that is not there.
    """
    if not isinstance(start, str):
        for name in start:
            mechanism.parameters[name]  # raises for a name that is not there
        problem = build_problem(mechanism, data, noise, start, whole=whole)
        _refuse_undetermined(problem)
        return problem
    problem = build_problem(mechanism, data, noise, whole=whole)
    _refuse_undetermined(problem)
    if (aligned := begun(problem, start)) is not mechanism:
        problem = problem.with_nominal(aligned)
    refuse_unreachable(problem, problem.start)
    return problem


def _refuse_undetermined(problem: Problem) -> None:
    arrays = problem.readings, problem.pose_constants, problem.uncertainty.sd
    refuse_without_length(problem.mechanism, *arrays)
    refuse_parallel_axes(problem.mechanism)


def refuse_loss(fit: Fit) -> None:
    """Raise InputError where a loss would have to learn sds."""
    if fit.robust_loss is not None:
        raise InputError(
            f"sds cannot be estimated under the loss {fit.loss!r}: outliers would inflate them",
            code="unsupported",
            remedy="find the outliers with this loss first and exclude them, then estimate; or "
            'take the sds as given (leave out "estimate")',
        )


_PARALLEL = 1e-3
"""Axes at a smaller angle [rad] or sine are parallel, as misaligned as robots are made."""
# Chosen, not derived: along parallel axes a wider prior leaves d to the rounding of their angle.
_WEAK = 0.1
"""A prior of d holds a joint only if its sd is at most this share of the largest length."""


def refuse_parallel_axes(mechanism: Mechanism) -> None:
    """Raise InputError for parallel consecutive axes between which d, d and alpha are free.

    Only of revolute joints that follow each other without fixed motions, both "dh" or both "mdh".
    """
    by_name = {p.name: p for p in mechanism.parameters}
    size = max((abs(p.nominal) for p in by_name.values() if p.unit == "m"), default=0.0)
    joints = (mechanism.description or {}).get("joints", [])
    for number, (one, two) in enumerate(pairwise(joints), 1):
        if not (isinstance(one, Joint) and isinstance(two, Joint)) or one.after or two.before:
            continue
        if one.form != two.form or one.form not in ("dh", "mdh"):
            continue
        if "prismatic" in (one.kind, two.kind):
            continue
        # "mdh" turns by alpha before its joint: the alpha between the two is that of the second.
        between = number if one.form == "dh" else number + 1
        alpha = by_name.get(parameter_name(one.form, "alpha", between))
        slides = [by_name.get(parameter_name(one.form, "d", i)) for i in (number, number + 1)]
        if alpha is None or alpha.fixed or abs(math.sin(alpha.nominal)) > _PARALLEL:
            continue
        if all(d is not None and not d.fixed and d.prior_sd > _WEAK * size for d in slides):
            raise _parallel(one, two, number)


def _parallel(one: Joint, two: Joint, number: int) -> InputError:
    names = [parameter_name(one.form, "d", i) for i in (number, number + 1)]
    remedy = f'give joint {one.name!r} the form = "hayati"'
    if one.form == "mdh":
        remedy = f'describe the arm by form = "dh", and joint {one.name!r} by form = "hayati"'
    return InputError(
        f"the axes of joints {one.name!r} and {two.name!r} are parallel, and {names[0]!r} and "
        f"{names[1]!r} are both free: no readings can determine where their common normal lies",
        code="not-identifiable",
        remedy=f"{remedy}, or fix one of the two, or give them a prior sd of a few mm",
    )
