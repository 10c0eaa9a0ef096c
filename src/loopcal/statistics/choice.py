"""The choice of a method by poses that were not used: what the method "auto" does.

Candidates are the nominal machine, placed and mounted, and each method that the readings allow,
with a structured model error where the machine has one, and without. Changes along the run that are
certain are modelled first (`loopcal.statistics.changes`). All are validated on the same
parts: poses at random, and regions of the joint space. The risk of a candidate at a pose is its
squared distance there, averaged over both ways to leave the pose out; without outputs it is minus
twice the log density of its loops.

Of structured candidates those terms leave whose gain is not positive, and the white error of the
machine that the instrument explains as well. The one of least risk is preferred, of those that take
no sensor as exact where there are any: exact readings make the noise of the instrument an error of
the machine. It keeps its certain terms alone where these predict within one paired standard error.
It is taken, or without one the first method, unless another is significantly better: lower in both,
by more than the 97.5 % point of Student's t times the standard error of the mean difference. Errors
in one region are not independent, so regions are the units of the second; the units of the first
are poses. Against a structured candidate both must be significant, because poses of a narrow set
cannot show what its prior is good for elsewhere; between plain methods one is enough. What another
beats by the rule of the verdict (`loopcal.document.choice.beats`) is never taken. Where poses are
too few for regions, only terms leave that the readings contradict, and no significance replaces a
structured candidate, or one that weighs all readings by one that takes some as exact (record 0158).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from loopcal.arrays import Array
from loopcal.document.change_points import NOT_SEARCHED
from loopcal.document.choice import Candidate, Chosen, comparison
from loopcal.estimation.dependence.dependence import likenesses
from loopcal.estimation.plausible import CODE as CONTRADICTED
from loopcal.estimation.result import FitResult
from loopcal.estimation.solve.scratch import one_blas_thread, release_memory, reuse_memory
from loopcal.estimation.solve.solver import Progress as Iterated
from loopcal.execution.executor import Executor, Progress, gathered
from loopcal.execution.forked import helping, process_cores
from loopcal.statistics.case import Case, Entrant, entrants
from loopcal.statistics.changes import CERTAIN, Changes, changes, unchanged
from loopcal.statistics.folds import Index, Scheme, grouped, stated_sds
from loopcal.statistics.gain import Gain
from loopcal.statistics.images import culprits, image_validation, lens_halves
from loopcal.statistics.judged import (
    EXCLUDED,
    IDLE,
    UNCERTAIN,
    Judged,
    begun,
    closest,
    fitted,
    lean,
    refuse,
    tells,
    without_fits,
)
from loopcal.statistics.noise_floor import excess, noise_floor
from loopcal.statistics.risks import (
    beats,
    mean_risk,
    predicts_as_well,
    risk_of,
    rms_of,
    rms_over,
    significantly_better,
)
from loopcal.statistics.run_drift import with_run_drift
from loopcal.statistics.shared_repeats import Means
from loopcal.statistics.station_scales import with_station_scales
from loopcal.statistics.validation import (
    Failed,
    Plan,
    Predicted,
    Validation,
    left_out,
    planned,
    pooled,
    refitted,
    validated,
)

# Record 0047.
FOLDS, BLOCKS, FEWEST = 10, 5, 25
"""Parts at random, regions, and the different poses from which on regions are left out."""
# Chosen, not derived: it saves half the fits of a candidate that is far behind.
HOPELESS = 3.0
"""A costly candidate is discarded halfway whose rms is so many times that of the best, on poses at
random and on regions."""
# Chosen, not derived: a mean over fewer may be one over easy poses.
_LEAST = 0.5
"""A candidate must predict this share of the poses."""


@dataclass(frozen=True, eq=False)
class Choice:
    """result: of the chosen candidate, with what was chosen, over what, by how much, and what
    happened during the run, as its parts; validation: of that candidate."""

    result: FitResult
    validation: Validation | None


@one_blas_thread()  # candidates share the process: else its threads would differ from run to run
def choose(
    case: Case,
    scheme: Scheme | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
    iterated: Iterated | None = None,
) -> Choice:
    """The candidate that predicts poses not used, as the head of this module says.

    scheme: what is left out, by default 10 folds and 5 regions, fewer where poses are few; where it
    names other readings, these are predicted by what was chosen by default. Where nothing can be
    left out, the first candidate that converges is taken, unvalidated. progress: called with how
    many fits without some of the poses are done; iterated: at every iteration of a fit of all.

    Raises InputError where no candidate can be fitted.
    """
    import scipy.linalg  # noqa: F401  ahead of the copies, each of which would load it

    reuse_memory(32)
    case = with_station_scales(with_run_drift(case))
    judged, waiting = list[Judged](), list(entrants(case))
    doubted = waiting[0].case.may_be_faulty
    while doubted and waiting and not any(one.whole for one in judged):
        # the first fit seeks faults for all
        entrant = waiting.pop(0)
        judged.append(fitted(entrant, iterated))
        whole = judged[-1].whole
        if whole is not None and whole.faults:  # no candidate is of use
            words = f"{entrant.name}; nothing was compared: the file is at fault"
            return Choice(_chosen(case, whole, Chosen(entrant.name, (), words, ())), None)
    case = replace(case, trusted=True)
    begins = _of_means(case, scheme, iterated)
    if begins is None:
        begins = _Begun(case, scheme, waiting, *_searched(case, judged, waiting, iterated))
    case, scheme, waiting, judged, run_changes = begins
    other = scheme if scheme and scheme.other is not None else None

    def compared(judged: Sequence[Judged], waiting: Sequence[Entrant]) -> _Compared:
        kept = scheme.of(run_changes.kept) if scheme and not other else None
        return _compared(case, run_changes, judged, waiting, kept, executor, progress, iterated)

    over = compared(judged, [one for one in waiting if not tells(one)])
    taken = over.taken
    if taken.entrant.structured and not run_changes.happened:
        # What is taken may show what the candidate that was searched does not.
        run_changes = _changes(case, taken, NOT_SEARCHED.level) or run_changes
        if run_changes.happened:
            over = compared([], [])
    case, plan, taken, validation = over.case, over.plan, over.taken, over.validation
    about_images: dict[str, Any] = {}
    if plan is not None:
        accused = culprits(over.case, over.judged, taken, plan, run_changes.moved, executor)
        about_images = {"culprits": accused, "halves": lens_halves(taken, plan, executor)}
        if validation is not None:
            validation = replace(validation, images=image_validation(taken, plan, executor))
    assert taken.whole is not None
    exact = (one.failed for one in over.judged if one.error and one.error.code == CONTRADICTED)
    words = over.chosen.words + run_changes.words()
    chosen = replace(over.chosen, words=words, contradicted=next(exact, None))
    if other is not None:
        validation = validated(taken.entrant.case, taken.whole, other)
    nominal = next((one.whole for one in over.judged if one.entrant.drawn and not one.failed), None)
    placed = nominal and nominal.accuracy_after
    result = _chosen(case, taken.whole, chosen).with_parts(
        nominal=placed and placed.distances,
        change_points=run_changes.entry(taken.entrant.case.mechanism),
        discarded=run_changes.discarded,
        shifts=None if run_changes.points else run_changes.searched,
        **about_images,
        validation=validation and validation.entry,
    )
    return Choice(result, validation)


@dataclass(frozen=True, eq=False)
class _Compared:
    """Candidates of a case on the parts of a plan, and which one is taken."""

    case: Case
    judged: Sequence[Judged]
    plan: Plan | None
    taken: Judged
    chosen: Chosen
    validation: Validation | None


def _compared(
    case: Case,
    run_changes: Changes,
    judged: Sequence[Judged],
    waiting: Sequence[Entrant],
    scheme: Scheme | None,
    executor: Executor | None,
    progress: Progress | None,
    iterated: Iterated | None,
) -> _Compared:
    """All candidates of a case, with what happened during its run.

    judged: those at hand, waiting: the others. Where something happened, all are made anew.
    """
    near = next((one.whole for one in judged if one.whole and not one.failed), None)
    whole_fits: dict[str, FitResult | None] = {}
    if run_changes.happened:
        case, near = run_changes.case, run_changes.whole
        whole_fits = {run_changes.by: near}
        judged, waiting = [], list(entrants(case, run_changes.moved, run_changes.made))

    def planned() -> Plan | None:
        return _plan(run_changes.plain, scheme)

    # those without a model error are fitted once, where what happened during the run is known
    more, plan = _all_fitted([begun(one, near) for one in waiting], iterated, whole_fits, planned)
    judged = [*judged, *more]
    refuse(judged)
    few = plan is not None and plan.blocked is None
    leave = partial(lean, rule=EXCLUDED if few else IDLE)
    judged = gathered(process_cores(), leave, case, judged)
    if plan is not None:
        judged = _validated(judged, plan, executor, progress)
        judged = judged if few else _with_fewer(case, judged, plan, executor, progress)
        judged = _refitted(judged, plan, len(case.data), executor)
    taken, chosen, validation = _choice(judged, plan, len(case.data))
    light, taken = [*map(without_fits, judged)], without_fits(taken)
    del judged, more
    release_memory()
    return _Compared(case, light, plan, taken, chosen, validation)


def _chosen(case: Case, result: FitResult, chosen: Chosen) -> FitResult:
    """The result of a candidate, with what is told of its choice."""
    return result.with_parts(
        method=case.fit.method.name, chosen=chosen, noise_floor=noise_floor(result)
    )


def _searched(
    case: Case, judged: Sequence[Judged], waiting: Sequence[Entrant], iterated: Iterated | None
) -> tuple[list[Judged], Changes]:
    """Those at hand and all that tell, with their fits; what happened during the run, by
    the fit of exact readings, which comes closest to the outputs, else by the closest.

    Where something happened, the other fits are in vain and left.
    """
    telling = [begun(one, None) for one in waiting if tells(one)]
    # what several instruments see of one pose shares the errors of its joints
    alone = len([f for f in case.mechanism.families if f.form != "closure"]) < 2
    first = next((one for one in telling if one.case.fit.method.exact is alone), None)
    order = sorted(telling, key=lambda one: one is not first)

    def fit(_: None, one: Entrant) -> Judged:
        return fitted(one, None if helping() else iterated)

    done, run_changes = dict[str, Judged](), None
    with closing(process_cores().run(fit, None, order)) as outcomes:
        for outcome in outcomes:
            one = outcome.value
            done[one.name] = one
            if order[outcome.number] is first:
                # Here, where all cores serve that are free, beside the other fits.
                run_changes = _changes(case, one, happened=outcomes.close)
                if run_changes is not None and run_changes.happened:
                    break
    judged = [*judged, *(done[one.name] for one in telling if one.name in done)]
    if run_changes is None:
        best = closest(judged)
        run_changes = _changes(case, best) if best else None
    return judged, run_changes or unchanged(case)


class _Begun(NamedTuple):
    """A case with its candidates: those that were fitted to see what happened, and all."""

    case: Case
    scheme: Scheme | None
    waiting: list[Entrant]
    judged: list[Judged]
    run_changes: Changes


def _of_means(case: Case, scheme: Scheme | None, iterated: Iterated | None) -> _Begun | None:
    """With repeats as one reading; None where none share an error."""
    for means in Means.each(case, scheme):
        waiting = [*entrants(means.case)]
        made = _searched(means.case, [], waiting, iterated)
        best = closest(made[0])
        if best is not None and best.whole is not None and means.shared(best.whole):
            further = _of_means(means.case, means.scheme, iterated)
            return further or _Begun(means.case, means.scheme, waiting, *made)
    return None


def _changes(
    case: Case,
    by: Judged,
    level: float = CERTAIN,
    happened: Callable[[], None] = lambda: None,
) -> Changes | None:
    """What happened during the run by a candidate's fit; None where it has none."""
    if by.whole is None or by.failed:
        return None
    run_changes = changes(case, by.entrant.case.fit, by.whole, level, happened)
    run_changes = replace(run_changes, by=by.name)
    release_memory()
    return run_changes


def _all_fitted(
    entrants: Sequence[Entrant],
    iterated: Iterated | None,
    whole_fits: Mapping[str, FitResult | None],
    plan: Callable[[], Plan | None],
) -> tuple[list[Judged], Plan | None]:
    """Candidates with their fits of all poses, and a plan, side by side.

    whole_fits: fits at hand, by name. Iterations in other processes are not reported.
    """

    def made(_: None, one: Entrant | None) -> Judged | Plan | None:
        if one is None:
            return plan()
        return fitted(one, None if helping() else iterated, whole_fits.get(one.name))

    outcomes: list[Any] = gathered(process_cores(), made, None, [*entrants, None])
    return outcomes[:-1], outcomes[-1]


def _with_fewer(
    case: Case,
    judged: Sequence[Judged],
    plan: Plan,
    executor: Executor | None,
    progress: Progress | None,
) -> list[Judged]:
    """What would be taken, with only those terms that are certain where that predicts as well:
    within one paired standard error, at random poses and in regions."""
    made = [one for one in judged if one.made]
    if all(one.entrant.drawn for one in made):
        return [*judged]
    risks = {one.name: risk_of(one, plan, len(case.data)) for one in made}
    taken = _taken(made, risks, plan)
    fewer = lean(case, taken, UNCERTAIN)
    if fewer is taken:
        return [*judged]
    (fewer,) = _validated([fewer], plan, executor, progress)
    risk, least = risk_of(fewer, plan, len(case.data)), risks[taken.name]
    well = not fewer.failed and predicts_as_well(risk, least, plan)
    return [fewer if one is taken and well else one for one in judged]


def _refitted(
    judged: Sequence[Judged], plan: Plan, poses: int, executor: Executor | None
) -> list[Judged]:
    """With every part of what would be taken fitted; where that changes what would be taken, of
    that as well. Steps from the fit of all only show who loses (record 0061)."""
    judged = list(judged)
    for _ in judged:
        made = [one for one in judged if one.made]
        if all(one.entrant.drawn for one in made):
            break
        taken = _taken(made, {one.name: risk_of(one, plan, poses) for one in made}, plan)
        steps = any(isinstance(part, Predicted) and part.near for part in taken.made)
        if not steps or taken.whole is None:
            break
        parts = tuple(refitted(taken.entrant.case, taken.whole, taken.made, executor))
        judged = [replace(one, made=parts) if one is taken else one for one in judged]
    return judged


def _plan(case: Case, scheme: Scheme | None) -> Plan | None:
    """What is left out; None where there are too few different poses for any part."""
    sds = stated_sds(case.noise, case.mechanism, case.data)
    groups = None if scheme is None else scheme.groups
    different = len(np.unique(grouped(case.mechanism, case.data, groups, sds)))
    if different < 2:
        return None
    if scheme is None:
        scheme = Scheme(min(FOLDS, different))
    if scheme.blocks is None:
        regions = different >= FEWEST and not scheme.place_anew
        scheme = replace(scheme, blocks=BLOCKS if regions else 0)
    return planned(case, scheme)


def _validated(
    judged: Sequence[Judged], plan: Plan, executor: Executor | None, progress: Progress | None
) -> list[Judged]:
    """All candidates on the parts of a plan; costly ones that are hopeless at half time go."""
    # Every second part: both halves then hold random parts and regions.
    halves = plan.indices[::2], plan.indices[1::2]
    total, before = len(plan.indices) * sum(not one.failed for one in judged), 0

    def advance(done: int, _: int) -> None:
        if progress:
            progress(before + done, total)

    for half in halves:
        whole_by_name = {one.name: (one.entrant.case, one.whole) for one in judged if one.whole}
        alive = [one.name for one in judged if not one.failed and one.name in whole_by_name]
        outcomes = left_out(
            [whole_by_name[name] for name in alive],
            half,
            executor,
            advance,
            anew=plan.anew,
            stepped=True,
        )
        before += len(half) * len(alive)
        made = dict(zip(alive, outcomes, strict=True))
        judged = [replace(one, made=(*one.made, *made.get(one.name, ()))) for one in judged]
        if half is halves[0]:
            judged = _without_hopeless(judged, (len(plan.random.indices) + 1) // 2)
    count = len(halves[0])
    order = np.argsort([*range(0, 2 * count, 2), *range(1, 2 * len(halves[1]), 2)])
    return [_ordered(one, order) for one in judged]


def _ordered(one: Judged, order: Index) -> Judged:
    """The parts in the order of the plan; a candidate that lost too many poses is out."""
    if one.failed:
        return one
    made = tuple(one.made[i] for i in order)
    lost = [part for part in made if isinstance(part, Failed)]
    poses = sum(len(part.index) for part in made)
    if sum(len(part.index) for part in lost) > (1.0 - _LEAST) * poses:
        return replace(one, made=(), failed=f"most parts failed: {lost[0].reason}")
    return replace(one, made=made)


def _without_hopeless(judged: Sequence[Judged], random: int) -> list[Judged]:
    """Those that may still be chosen; random: how many of the parts are poses at random."""
    alive = [one for one in judged if not one.failed and one.made]
    ways = {
        one.name: (rms_over(one, one.made[:random]), rms_over(one, one.made[random:]))
        for one in alive
    }
    best = [min(sizes, default=0.0) for sizes in zip(*ways.values(), strict=True)]
    kept = []
    for one in judged:
        rms_values = ways.get(one.name, ())
        times = [a / b for a, b in zip(rms_values, best, strict=False) if 0.0 < b < math.inf]
        if min(times, default=0.0) > HOPELESS and not one.entrant.cheap:
            one = replace(one, made=(), failed=f"{min(times):.1f} times the best rms halfway")
        kept.append(one)
    return kept


def _choice(
    judged: Sequence[Judged], plan: Plan | None, poses: int
) -> tuple[Judged, Chosen, Validation | None]:
    """The candidate that is taken, what is told of the choice, and its validation."""
    if plan is None or not any(one.made for one in judged if not one.entrant.drawn):
        taken = _unvalidated(judged)
        assert taken.whole is not None
        if not taken.whole.status.converged:
            why = "no fit converged"
        else:
            why = (
                "there are too few different poses" if plan is None else "fits without some failed"
            )
        words = f"{taken.name}; not validated: {why}"
        return taken, Chosen(taken.name, _terms(taken), words, tuple(map(_bare, judged))), None
    risks = {one.name: risk_of(one, plan, poses) for one in judged if one.made}
    taken = _taken([one for one in judged if one.made], risks, plan)
    assert taken.whole is not None
    validations = {
        one.name: pooled(one.whole, one.made, plan, one.entrant.case.data, stating=one is taken)
        for one in judged
        if one.made and one.whole is not None
    }
    ordered = [taken, *(one for one in judged if one is not taken)]
    best = validations[taken.name].accuracy
    over = []
    for one in ordered:
        validation = validations.get(one.name)
        gain = None
        if validation is not None and validation.accuracy is not None and best is not None:
            gain = Gain.in_rms(risks[taken.name][0], risks[one.name][0], plan.groups)
        learnt = one.whole if one.made and not taken.entrant.structured else None
        entry = _candidate(one, validation, gain)
        over.append(replace(entry, terms=() if learnt is None else learnt.terms))
    if taken.entrant.structured:
        _tell_order(judged, ordered, over)
    better = [
        one.name
        for one in judged
        if one.made and mean_risk(risks[one.name]) < mean_risk(risks[taken.name])
    ]
    words = comparison(over, "" if best is None else best.unit, better)
    return taken, Chosen(taken.name, _terms(taken), words, tuple(over)), validations[taken.name]


def _tell_order(judged: Sequence[Judged], ordered: Sequence[Judged], over: list[Candidate]) -> None:
    """Note at the first plain candidate whether its residuals depend on the pose order."""
    plain = (one for one in judged if not (one.entrant.structured or one.entrant.drawn))
    for one in plain:
        if (whole := one.whole) is not None and not one.failed:
            tests = likenesses(whole.problem, whole.solution, whole.pose_equations(bare=True))
            if tests.serial:
                i = ordered.index(one)
                over[i] = replace(over[i], serial=tests.serial[0].serial)
            return


def _taken(judged: Sequence[Judged], risks: Mapping[str, Array], plan: Plan) -> Judged:
    """The candidate that the rule at the head of this module takes."""

    def score(one: Judged) -> float:
        return mean_risk(risks[one.name])

    structured = [one for one in judged if one.entrant.structured]
    uncertain = [one for one in structured if one.weighs]
    preferred = min(uncertain or structured, key=score) if structured else judged[0]
    enough, least = all if structured else any, risks[preferred.name]
    rivals = judged
    if plan.blocked is None:  # too few poses to show that exact readings say enough
        rivals = [] if structured else [one for one in judged if one.entrant.drawn or one.weighs]
    better = [one for one in rivals if significantly_better(risks[one.name], least, plan, enough)]
    taken = min(better, key=score) if better else preferred
    # Each round lowers the rms on common poses. The bound ends a cycle of candidates that failed
    # on different ones.
    for _ in judged if taken.entrant.case.mechanism.outputs else ():
        # the verdict would condemn what another one beats
        beaten = [one for one in judged if beats(risks[one.name], risks[taken.name], plan)]
        taken = min(beaten, key=lambda one: rms_of(risks[one.name][0]) or 0.0, default=taken)
    return taken


def _unvalidated(judged: Sequence[Judged]) -> Judged:
    """The first calibration that converged; without one the first, whose status says why.

    Never the nominal machine, which would hide that nothing could be calibrated.
    """
    fitted = [one for one in judged if one.whole is not None and not one.entrant.drawn]
    return next((one for one in fitted if one.whole and one.whole.status.converged), fitted[0])


def _terms(one: Judged) -> tuple[str, ...]:
    if one.whole is None:
        return ()
    names = [term.name for term in one.whole.mechanism.terms]
    return tuple(dict.fromkeys([*names, *(term.name for term in one.whole.terms)]))


def _bare(one: Judged) -> Candidate:
    chi = more = None
    if one.whole is not None and one.whole.status.converged and not one.entrant.drawn:
        chi, more = one.whole.chi_squared, excess(one.whole)
    out = one.failed or None
    return Candidate(one.name, None, None, None, None, out, chi_squared=chi, excess=more)


def _candidate(one: Judged, validation: Validation | None, gain: Gain | None) -> Candidate:
    """As a document holds it; gain: of the chosen one over it, at random parts."""
    bare = _bare(one)
    if validation is None or validation.accuracy is None:
        return bare
    blocked = validation.blocked and validation.blocked.accuracy
    return replace(
        bare,
        out_of_sample=validation.accuracy.distances,
        blocked=blocked.distances if blocked else None,
        difference=None if gain is None else gain.difference,
        sd=None if gain is None else gain.sd,
    )
