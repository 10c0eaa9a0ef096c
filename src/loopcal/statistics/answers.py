"""Three of the verdict's answers: where a result is valid, what it is better than, whether it is
good enough for a tolerance."""

from __future__ import annotations

import math
from dataclasses import dataclass

from loopcal import chi_squared
from loopcal.document.accuracy import Distances
from loopcal.document.result_document import ResultDocument
from loopcal.document.verdict import Answer
from loopcal.presentation.shown import with_unit
from loopcal.statistics.candidates import NOMINAL
from loopcal.statistics.tolerance import Quantile, judged

NEAR_ONLY = 3.0
"""Predicted sd in the working region over that at the measured poses from which a result is valid
near these poses only: that of the alarm of single predictions."""
_CERTAIN = 2.0
_BEATEN = 3.3
"""Standard errors at p = 0.001: several rivals are tried, and the choice tried them before."""
_RELATIVE = 0.41
"""sd of an rms of N distances in space over rms / sqrt(N): sqrt(2/3) / 2."""
_DRAWN = "the nominal machine"
_OVER_THE_REGION = "Measure poses all over the region, or use the result near these poses only."
_OUTPUTS = "Add an instrument that measures the end point."


def valid(document: ResultDocument) -> Answer:
    if document.column_faults or not document.status.converged:
        words = "No region was judged: the sds of this fit mean nothing."
        return Answer(None, "region-unknown", None, words, "Mend what is not sound first.")
    region = None if document.prediction is None else document.prediction.region
    if region is None:
        words = "Nothing says how far the machine works: its working region is unknown."
        return Answer(None, "region-unknown", None, words, "State the region ([verdict] region).")
    sources = {one.source for one in region.ranges}
    where = "the working region"
    if sources == {"readings"}:
        where = "the region between the measured poses (no limits are known)"
    elif "turn" in sources:
        where = "the working region (joints without stated limits turn a quarter turn either way)"
    worst = region.worst
    here = with_unit(worst.sd_at_poses, worst.unit, 2)
    if worst.sd is None or worst.ratio is None:
        words = f"The data leave a direction open that moves the end point in {where}."
        return Answer(False, "near-poses-only", None, words, "Measure poses all over the region.")
    there = with_unit(worst.sd, worst.unit, 2)
    both = f"the predicted sd is {there} in {where} and {here} at the measured poses"
    if worst.ratio > NEAR_ONLY:
        words = f"{both[0].upper()}{both[1:]}."
        remedy = "Measure poses all over the region, or state the region in which you work."
        return Answer(False, "near-poses-only", worst.ratio, words, remedy)
    words = f"Valid: {both}."
    return Answer(True, "valid-in-region", worst.ratio, words, None)


def better(document: ResultDocument) -> Answer:
    accuracy, validation = document.accuracy, document.validation
    if accuracy is None:
        words = "The accuracy is unknown: the mechanism has no measured outputs."
        return Answer(None, "no-outputs", None, words, _OUTPUTS)
    unseen = None if validation is None else validation.accuracy
    if unseen is None and not document.status.converged:
        words = "No other poses were predicted: the fit did not converge."
        return Answer(None, "not-validated", None, words, "Make the fit converge first.")
    if unseen is None:
        words = "No other poses were predicted. Expect a larger error there."
        return Answer(None, "not-validated", None, words, "Validate on other poses (--folds 10).")
    compared = _compared(document, unseen)
    rivals, rms, unit = compared.rivals, compared.rms, accuracy.unit
    mine = with_unit(rms, unit)
    for rival in sorted(rivals, key=lambda r: r.difference):
        if rival.difference < -_BEATEN * rival.sd:
            words = (
                f"Worse than {rival.name} on poses not used: {mine} rms instead of "
                f"{with_unit(rms + rival.difference, unit)}."
            )
            remedy = "Use the better one, or measure more poses."
            return Answer(False, "worse", rival.difference, words, remedy)
    first = rivals[0]
    both = f"{mine} rms on poses not used instead of {with_unit(rms + first.difference, unit)}"
    figures = f"{both} (sd of the difference {with_unit(first.sd, unit, 2)})"
    if first.difference > _CERTAIN * first.sd:
        elsewhere = _nominal_elsewhere(document)
        if elsewhere is not None:
            words = f"Better than {first.name} near the measured poses only: {figures}. {elsewhere}"
            return Answer(None, "better-near-only", first.difference, words, _OVER_THE_REGION)
        words = f"Better than {first.name}: {figures}."
        return Answer(True, "better", first.difference, words, None)
    words = f"About as good as {first.name}: {figures}."
    return Answer(None, "no-better", first.difference, words, "Measure more poses to decide.")


def _nominal_elsewhere(document: ResultDocument) -> str | None:
    """What is said where the nominal machine predicts the regions not used better."""
    candidates = () if document.chosen is None else document.chosen.over
    drawn = next((c.blocked for c in candidates if c.name == NOMINAL), None)
    own = candidates[0].blocked if candidates else None
    if own is None or drawn is None or own.rms <= drawn.rms or document.accuracy is None:
        return None
    unit = document.accuracy.unit
    return (
        f"In regions not used it is worse: {with_unit(own.rms, unit)} rms instead of "
        f"{with_unit(drawn.rms, unit)}."
    )


@dataclass(frozen=True)
class Rival:
    """What a result is compared with: its rms minus that of the result, and the sd of this."""

    name: str
    difference: float
    sd: float


@dataclass(frozen=True)
class _Compared:
    """Rms of a result on poses not used, and its rivals there, the nominal machine first."""

    rms: float
    rivals: tuple[Rival, ...]


def _compared(document: ResultDocument, unseen: Distances) -> _Compared:
    """On the same poses: those of the choice, else those of the validation."""
    chosen = document.chosen
    if chosen is not None and chosen.over and (own := chosen.over[0].out_of_sample) is not None:
        paired = [
            Rival(_DRAWN if c.name == NOMINAL else c.name, c.difference, c.sd)
            for c in chosen.over[1:]
            if c.difference is not None and c.sd is not None
        ]
        if paired:
            return _Compared(own.rms, tuple(sorted(paired, key=lambda r: r.name != _DRAWN)))
    assert document.accuracy is not None
    drawn = document.accuracy.nominal or document.accuracy.before
    n = max(unseen.poses or document.data.used, 1)
    sd = _RELATIVE * math.hypot(drawn.rms, unseen.rms) / math.sqrt(n)
    return _Compared(unseen.rms, (Rival(_DRAWN, drawn.rms - unseen.rms, sd),))


def good_enough(document: ResultDocument, tolerance: float | None) -> Answer:
    accuracy, validation = document.accuracy, document.validation
    unit = "m" if accuracy is None else accuracy.unit
    unseen = None if validation is None else (validation.blocked or validation).accuracy
    quantile = None
    if tolerance is not None and accuracy is None:
        words = "The accuracy is unknown: the mechanism has no measured outputs."
        return Answer(None, "unknown-accuracy", None, words, _OUTPUTS)
    if tolerance is not None and unseen is None:
        words = "No pose was left out to test the tolerance."
        return Answer(
            None, "unknown-accuracy", None, words, "Validate on other poses (--folds 10)."
        )
    if unseen is not None:
        quantile = Quantile.of_summary(unseen.p95, unseen.poses or document.data.used)
        quantile = quantile and quantile.widened(_beyond(document, unit))
    region = None if document.prediction is None else document.prediction.region
    known = region is not None and region.of(unit) is not None
    where = "in the working region" if known else "near the measured poses"
    return judged(quantile, tolerance, unit, where)


def _beyond(document: ResultDocument, unit: str) -> float:
    """95 % of the error [unit] that the parameters add in the working region to that at the poses;
    0 where the region is not known."""
    region = None if document.prediction is None else document.prediction.region
    own = None if region is None else region.of(unit)
    if own is None:
        return 0.0
    if own.sd is None:
        return math.inf
    more = max(own.sd**2 - own.sd_at_poses**2, 0.0)
    return math.sqrt(more * chi_squared.quantile(0.05, 3) / 3.0)
