"""What a choice says of images beside the method: what is at fault, how far to trust a lens.

Only cameras measure these machines. The folds are those that chose the method.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from loopcal.document.choice import Candidate
from loopcal.document.findings import HalvesEntry
from loopcal.document.plain import finite
from loopcal.errors import NoTrustworthyResult
from loopcal.estimation.result import FitResult
from loopcal.execution.executor import Executor
from loopcal.mechanisms.mechanism import PIXELS
from loopcal.statistics.calibrated import Calibrated
from loopcal.statistics.case import Case, Entrant, instruments_alone, nominal_case, unstated_lenses
from loopcal.statistics.comparison import covariance_between
from loopcal.statistics.folds import folds, image_regions
from loopcal.statistics.gain import Gain
from loopcal.statistics.judged import Judged, fitted
from loopcal.statistics.risks import risk_of
from loopcal.statistics.validation import Plan, Predicted, Validation, left_out, pooled

PARTS = {"lens": "lens", "print": "board", "corner": "board"}
"""By the role of a parameter what it belongs to; the rest is the robot's."""


def culprits(
    case: Case,
    judged: Sequence[Judged],
    taken: Judged,
    plan: Plan,
    moved: Collection[str] = (),
    executor: Executor | None = None,
) -> tuple[Candidate, ...]:
    """What is at fault where images do not fit: the machine as stated, it with the robot, the lens
    or the board freed, and the chosen calibration.

    Each is freed alone, with its priors, while all else is held as stated; where things stand is
    always free. The same images are left out as in the choice of a method, so what predicts them
    better than the machine as stated has what the statement lacks. The chosen calibration has all
    of them freed.

    judged: the candidates of the choice, with the nominal machine; moved: parameters of what
    slipped during the run. Differences are to the machine as stated. Empty for a machine without
    cameras, and where the nominal machine was not validated.
    """
    held = next((one for one in judged if one.entrant.drawn and one.made), None)
    if held is None or not any(f.form == PIXELS for f in case.mechanism.families):
        return ()
    freed, plan = _freed(case, moved), replace(plan, blocked=None)
    if not freed:
        return ()
    alone = [fitted(Entrant(name, one)) for name, one in freed.items()]
    able = [(one.entrant.case, one.whole) for one in alone if one.whole and not one.failed]
    made = iter(left_out(able, plan.indices, executor, stepped=True))
    alone = [one if one.failed else replace(one, made=tuple(next(made))) for one in alone]
    count = len(plan.random.indices)
    first, *others = (replace(one, made=one.made[:count]) for one in (held, *alone, taken))
    return (_judged(first, first, plan), *(_judged(one, first, plan) for one in others))


def _freed(case: Case, moved: Collection[str]) -> dict[str, Case]:
    """The nominal machine with what belongs to the robot, the lens, the board."""
    mechanism = case.fit.with_prior(case.mechanism)
    placed = {*mechanism.parameters.of_role("placement", "mounting"), *moved}
    placed |= instruments_alone(mechanism) | unstated_lenses(mechanism)
    groups: dict[str, list[str]] = {}
    for p in mechanism.parameters:
        if not p.fixed and p.name not in placed:
            groups.setdefault(PARTS.get(p.role, "robot"), []).append(p.name)
    return {
        part: replace(nominal_case(case, (*moved, *groups[part])), trusted=True)
        for part in ("robot", "lens", "board")
        if part in groups
    }


def _judged(one: Judged, first: Judged, plan: Plan) -> Candidate:
    """One of them on the images not used, beside the machine as stated."""
    if not one.made or one.whole is None:
        return Candidate(one.name, None, None, None, None, one.failed)
    data = one.entrant.case.data
    accuracy = pooled(one.whole, one.made, plan, data, stating=False).accuracy
    mine, base = (risk_of(j, plan, len(data))[0] for j in (one, first))
    gain = Gain.in_rms(base, mine, plan.groups)
    return Candidate(
        one.name,
        None if accuracy is None else accuracy.distances,
        None,
        None if gain is None else gain.difference,
        None if gain is None else gain.sd,
    )


def lens_halves(
    taken: Judged, plan: Plan, executor: Executor | None = None
) -> tuple[HalvesEntry, ...]:
    """Each parameter of a lens by two halves of the images, fitted apart; empty without cameras,
    and where one half cannot be fitted.

    A lens that lacks a term, or a board that is not as stated, is taken up by the focal length, and
    by another amount in other images. The residuals show little of it; two fits of different images
    do. With estimates a, b of the halves the covariance of b - a is that of both, less what both
    took from the same prior (`comparison.covariance_between`). What no lens describes is one field
    in both: it moves them by what `lens_fields.apart` says, not by what it moves each.
    """
    whole, case = taken.whole, taken.entrant.case
    lens = () if whole is None else whole.mechanism.parameters.of_role("lens")
    if whole is None or not {*lens} & {*whole.estimated} or len(np.unique(plan.groups)) < 2:
        return ()
    (made,) = left_out([(case, whole)], folds(plan.groups, 2, seed=0), executor)
    fits = [part.fit for part in made if isinstance(part, Predicted) and part.fit is not None]
    return halves_apart(whole, *fits) if len(fits) == 2 else ()


def halves_apart(whole: FitResult, *fits: FitResult) -> tuple[HalvesEntry, ...]:
    """The same of fits of all images and of the halves."""
    if any(fit.estimated != whole.estimated for fit in fits):
        return ()
    lens = whole.mechanism.parameters.of_role("lens")
    of_all, first, second = (Calibrated.of(fit, "").with_offsets for fit in (whole, *fits))
    covariance = covariance_between(first, second, learnt=of_all.fields)
    sd = np.sqrt(np.maximum(np.diag(covariance.matrix), 0.0))
    entries = []
    for i, p in enumerate(whole.mechanism.parameters):
        if p.name in lens and p.name in whole.estimated and 0.0 < sd[i] < math.inf:
            one, other = (fit.value[p.name] for fit in fits)
            freedom = finite(float(covariance.freedom[i]))
            entries.append(HalvesEntry(p.name, p.unit, one, other, float(sd[i]), freedom))
    return tuple(entries)


def image_validation(
    taken: Judged, plan: Plan, executor: Executor | None = None
) -> Validation | None:
    """The chosen calibration on images whose board stands where no other image has one; None
    without cameras, or with few images.

    A lens is as good as its model where corners were. Regions of the image left out one by one show
    what it is worth elsewhere. They are judged after the choice, by the chosen calibration alone.
    """
    case, whole = taken.entrant.case, taken.whole
    parts = image_regions(case.mechanism, case.data, plan.groups)
    if parts is None or whole is None:
        return None
    (made,) = left_out([(case, whole)], parts.indices, executor)  # steps state no regions
    try:
        return pooled(whole, made, Plan(parts, None, plan.groups), case.data)
    except NoTrustworthyResult:
        return None
