"""A candidate of a choice with its fit: of all poses, and with no more terms than it needs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from loopcal.document.choice import DECISIVE
from loopcal.errors import InputError, LoopcalError, NoTrustworthyResult
from loopcal.estimation.noise.term_parts import Worth, gain, idle, support
from loopcal.estimation.result import FitResult
from loopcal.estimation.solve.solver import Progress as Iterated
from loopcal.estimation.steps import Near
from loopcal.measurements.noise import MODEL
from loopcal.mechanisms.mechanism import PIXELS, Mechanism
from loopcal.mechanisms.structure.smooth import DISCREPANCY
from loopcal.mechanisms.structure.structured import GEOMETRY_TERMS
from loopcal.statistics.case import Begin, Case, Entrant, without_terms
from loopcal.statistics.validation import Failed, Outcome, unread

# docs/decisions/0158.
_ABSENT = 2.0 * math.log(5.0)
"""A term leaves where the readings are five times more probable without it: 2 log of that."""
# docs/decisions/0142.
_ONE_SD = 1.0
"""By so much -2 log of the likelihood rises where a stated sd is off by one sd of its logarithm."""
_TOO_COARSE = 2.5
"""An instrument that errs by more times its stated sd is no likelier a cause than the machine."""


@dataclass(frozen=True, eq=False)
class Judged:
    """A candidate on the parts that it predicted.

    whole: its fit of all poses; made: what became of each part, in their order; failed: why it is
    out, empty where it is not.
    """

    entrant: Entrant
    whole: FitResult | None
    made: tuple[Outcome, ...] = ()
    failed: str = ""
    error: LoopcalError | None = None

    @property
    def name(self) -> str:
        """As the reader knows it."""
        return self.entrant.name

    @property
    def weighs(self) -> bool:
        """Whether its method takes no reading as exact."""
        return not self.entrant.case.fit.method.exact


def begun(one: Entrant, whole: FitResult | None) -> Entrant:
    """A further candidate, for which no fault of the file is sought.

    A plain one begins where another, whole, has converged, and needs no other starts.
    """
    case = replace(one.case, trusted=True)
    if whole is not None and not (one.structured or one.drawn):
        near = unread(whole) if len(case.data) == whole.problem.count else {}
        case = replace(case, begin=Begin.of(whole, case.mechanism), near=Near(near))
    return replace(one, case=case)


def fitted(
    one: Entrant, iterated: Iterated | None = None, whole: FitResult | None = None
) -> Judged:
    """A candidate with its fit of all poses; whole: that fit, where it is at hand."""
    try:
        whole = one.case.calibrated(progress=iterated) if whole is None else whole
    except (InputError, NoTrustworthyResult) as error:
        return Judged(one, None, failed=error.message, error=error)
    if not whole.status.converged:
        return Judged(one, whole, failed=f"the fit did not converge ({whole.status.reason})")
    return Judged(one, whole)


def refuse(judged: Sequence[Judged]) -> None:
    """Raise the first error where nothing can be calibrated, or at no size that means anything.

    A machine of unknown size stays refused although the spread of its lengths about the drawing
    can be learnt. Every fit makes it smaller, because the joints' noise moves a small machine less.
    """
    estimated = [one for one in judged if not one.entrant.drawn]
    plain = [one for one in estimated if not one.entrant.structured]
    sizeless = all(one.error is not None and one.error.code == "unknown-size" for one in plain)
    able = plain if sizeless else estimated
    if not any(one.whole for one in able):
        raise next(one.error for one in able if one.error)


def without_fits(one: Judged) -> Judged:
    """After the choice: without the fits of its parts, each of which holds three matrices of all
    parameters. Without outputs they stay, because what they state is compared."""
    if one.whole is None or not one.whole.mechanism.outputs:
        return one
    made = (
        p if isinstance(p, Failed) else replace(p, fit=None, held=None, near=None) for p in one.made
    )
    return replace(one, made=tuple(made))


@dataclass(frozen=True)
class Rule:
    """Terms leave that are worth at most so much."""

    worth: Worth
    least: float


IDLE, UNCERTAIN = Rule(gain, 0.0), Rule(gain, DECISIVE)
EXCLUDED = Rule(support, -_ABSENT)
"""What the readings cannot show stays: its learnt sd widens the stated ones."""


def lean(case: Case, one: Judged, rule: Rule = IDLE) -> Judged:
    """The candidate without the terms that leave by a rule, and without the white error of
    the machine that the stated sds of sensors explain as well; itself if there are none.

    Dimensions of the drawing stay: without a term they would be exact. So does what changed along
    the run. Where one term leaves, others may gain less or more, so this goes on until no other
    leaves.
    """
    while one.entrant.structured and one.whole is not None and not one.failed:
        fewer = _with_fewer_terms(case, one, one.whole, rule) or _by_sensors(one, one.whole)
        if fewer is None:
            break
        learnt = one.whole.estimate
        factors = learnt.factors if learnt and learnt.settled else None
        begun = replace(
            fewer.case,
            mechanism=_begun_with(fewer.case.mechanism, one.whole),
            trusted=True,
            begin=Begin.of(one.whole, fewer.case.mechanism),
            near=Near(unread(one.whole), factors, roughly=False),
        )
        again = fitted(replace(fewer, case=begun))
        if again.failed:
            break
        one = replace(again, entrant=replace(fewer, case=replace(fewer.case, trusted=True)))
    # asked of every candidate that is left: here beside those of the others
    _ = one.whole and not one.failed and one.whole.chi_squared
    return one


def _with_fewer_terms(case: Case, one: Judged, whole: FitResult, rule: Rule) -> Entrant | None:
    learnt = whole.estimate.variances.terms if whole.estimate else None
    if learnt is None:
        return None
    keep = {name for name, _, _ in GEOMETRY_TERMS.values()}
    changed = {n for p in whole.mechanism.parameters if p.changes for n in (p.name, p.changes)}
    keep |= {t.name for t in whole.mechanism.terms if not changed.isdisjoint(t.parameters)}
    return without_terms(case, one.entrant, idle(learnt, rule.least, rule.worth, keep=keep))


def _by_sensors(one: Judged, whole: FitResult) -> Entrant | None:
    """The candidate whose sensors make all noise; None where the machine's own error was stated,
    gains more than an instrument that is as far off its stated sd as that is known, would make an
    instrument err by far more than stated, or is what a smooth discrepancy leaves."""
    case = one.entrant.case
    if case.noise is None or case.fit.method.exact or MODEL in case.noise.entries:
        return None
    if any(term.name == DISCREPANCY for term in case.mechanism.terms):
        return None
    gain = _gain_of_model(whole)
    if gain is None or gain > _ONE_SD or _beyond_stated(whole) > _TOO_COARSE:
        return None
    return replace(one.entrant, case=replace(case, noise=case.noise.with_exact(MODEL)))


def _gain_of_model(whole: FitResult) -> float | None:
    """What the white error of the machine gains; None where nothing was learnt of it."""
    if whole.estimate is None:
        return None
    quantities = whole.mechanism.tape.quantities
    white = {quantities.index(name) for name in whole.mechanism.disturbances}
    for i, component in enumerate(whole.estimate.stated):
        if white & set(component.quantities) and whole.estimate.factors[component.name] > 0.0:
            return whole.estimate.gain(i)
    return None


def _beyond_stated(whole: FitResult) -> float:
    """How many times its stated sd an instrument would err, if all white noise were its own."""
    assert whole.estimate is not None
    names, sd = whole.mechanism.tape.quantities, whole.problem.uncertainty.sd
    white = [float(np.median(sd[names.index(n)])) for n in whole.mechanism.disturbances]
    times = [1.0]
    for component in whole.estimate.stated:
        read = [i for i in component.quantities if names[i] in whole.mechanism.outputs]
        factor = whole.estimate.factors[component.name]
        if read and factor > 0.0:
            learnt = float(np.median(sd[read]))
            times.append(factor * math.hypot(learnt, max(white, default=0.0)) / learnt)
    return max(times)


def _begun_with(mechanism: Mechanism, whole: FitResult) -> Mechanism:
    """The mechanism whose terms begin at the sds that a fit has learnt."""
    parameters = mechanism.parameters
    learnt = dict(zip(whole.problem.names, whole.problem.prior_sd.tolist(), strict=True))
    learnt = {name: sd for name, sd in learnt.items() if name in parameters.names}
    return mechanism.with_parameters(parameters.with_prior(learnt))


def tells(one: Entrant) -> bool:
    """Whether a candidate tells what happened during the run: a structured one, of images one that
    counts neither joints nor poses as exact."""
    images = any(f.form == PIXELS for f in one.case.mechanism.families)
    return one.structured or (images and not one.cheap)


def closest(judged: Sequence[Judged]) -> Judged | None:
    """The one that fits best of those that tell what happened during the run."""
    able = [one for one in judged if one.whole and not one.failed and tells(one.entrant)]

    def misfit(one: Judged) -> float:
        after = one.whole and one.whole.accuracy_after
        return after.rms if after else math.inf

    return min(able, key=misfit, default=None)
