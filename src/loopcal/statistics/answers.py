"""Where a result is valid, what it is better than, whether it is good enough for a tolerance: one
fact for each of these questions."""

from __future__ import annotations

import math
from dataclasses import dataclass

from loopcal import chi_squared
from loopcal.document.accuracy import Distances
from loopcal.document.choice import beats
from loopcal.document.judgement import Fact, Figure, fact
from loopcal.document.result_document import ResultDocument
from loopcal.statistics.candidates import NOMINAL
from loopcal.statistics.tolerance import Quantile, kept

# Record 0054.
NEAR_ONLY = 3.0
"""Predicted sd in the working region over that at the measured poses from which a result is valid
near these poses only: that of the alarm of single predictions."""
# Paired standard errors that "better" needs (docs/explanation/verdict.md).
_CERTAIN = 2.0
_RELATIVE = 0.41
"""sd of an rms of N distances in space over rms / sqrt(N): sqrt(2/3) / 2."""
_DRAWN = "the nominal machine"


def valid(document: ResultDocument) -> Fact:
    """Where: the predicted sd in the working region beside that at the measured poses."""
    if document.column_faults or not document.status.converged:
        return fact("region-not-judged")
    region = None if document.prediction is None else document.prediction.region
    if region is None:
        return fact("region-unknown")
    sources = {one.source for one in region.ranges}
    where = "the working region"
    if sources == {"readings"}:
        where = "the region between the measured poses (no limits are known)"
    elif "turn" in sources:
        where = "the working region (joints without stated limits turn a quarter turn either way)"
    worst = region.worst
    if worst.sd is None or worst.ratio is None:
        return fact("direction-open", where=where)
    numbers = {
        "sd_ratio": Figure(worst.ratio),
        "sd_in_region": Figure(worst.sd, worst.unit),
        "sd_at_poses": Figure(worst.sd_at_poses, worst.unit),
    }
    code = "near-poses-only" if worst.ratio > NEAR_ONLY else "valid-in-region"
    return fact(code, numbers=numbers, where=where)


def better(document: ResultDocument) -> Fact:
    """Better than the nominal machine, placed and mounted, and than plain least squares."""
    accuracy, validation = document.accuracy, document.validation
    if accuracy is None:
        return fact("no-outputs", reason=document.why_no_accuracy)
    unseen = None if validation is None else validation.accuracy
    if unseen is None:
        return fact("not-validated" if document.status.converged else "fit-failed")
    compared = _compared(document, unseen)
    ahead = [rival for rival in compared.rivals if rival.beats]
    if ahead:
        worst = min(ahead, key=lambda rival: rival.difference)
        return compared.fact("worse", worst, accuracy.unit)
    first = compared.rivals[0]  # methods that predict alike leave nothing to decide
    if first.difference <= _CERTAIN * first.sd:
        return compared.fact("no-better", first, accuracy.unit)
    elsewhere = _nominal_elsewhere(document)
    code = "better-near-only" if elsewhere else "better"
    return compared.fact(code, first, accuracy.unit, **elsewhere)


def _nominal_elsewhere(document: ResultDocument) -> dict[str, float]:
    """Both rms where the nominal machine predicts the regions not used better."""
    candidates = () if document.chosen is None else document.chosen.over
    drawn = next((c.blocked for c in candidates if c.name == NOMINAL), None)
    chosen = candidates[0].blocked if candidates else None
    if chosen is None or drawn is None or chosen.rms <= drawn.rms:
        return {}
    return {"blocked_rms": chosen.rms, "nominal_blocked_rms": drawn.rms}


@dataclass(frozen=True)
class Rival:
    """What a result is compared with: its rms minus that of the result, the sd of this, and
    whether it beats the result."""

    name: str
    difference: float
    sd: float
    beats: bool


@dataclass(frozen=True)
class _Compared:
    """Rms of a result on poses not used, and its rivals there, the nominal machine first."""

    rms: float
    rivals: tuple[Rival, ...]

    def fact(self, code: str, rival: Rival, unit: str, **more: float) -> Fact:
        """This beside one of the rivals."""
        sizes = {"difference": rival.difference, "rms": self.rms}
        sizes |= {"rival_rms": self.rms + rival.difference, "sd": rival.sd, **more}
        numbers = {name: Figure(value, unit) for name, value in sizes.items()}
        return fact(code, numbers=numbers, rival=rival.name)


def _compared(document: ResultDocument, unseen: Distances) -> _Compared:
    """On the same poses: those of the choice, else those of the validation."""
    over, paired = () if document.chosen is None else document.chosen.over, list[Rival]()
    if over and over[0].out_of_sample is not None:
        unseen, regions = over[0].out_of_sample, over[0].rms_elsewhere
        for one in over[1:]:
            if one.difference is None or one.sd is None:
                continue
            ahead = beats(one.difference, one.sd, one.rms_elsewhere, regions)
            name = _DRAWN if one.name == NOMINAL else one.name
            paired.append(Rival(name, one.difference, one.sd, ahead))
    if all(rival.name != _DRAWN for rival in paired):
        assert document.accuracy is not None
        drawn = document.accuracy.nominal or document.accuracy.before
        n = max(unseen.poses or document.data.used, 1)
        # Without pairs: both rms are taken as independent, and their variances add.
        sd = _RELATIVE * math.hypot(drawn.rms, unseen.rms) / math.sqrt(n)
        difference = drawn.rms - unseen.rms
        paired.append(Rival(_DRAWN, difference, sd, beats(difference, sd, None, None)))
    return _Compared(unseen.rms, tuple(sorted(paired, key=lambda r: r.name != _DRAWN)))


def good_enough(document: ResultDocument, tolerance: float | None) -> Fact | None:
    """Whether 95 % of poses keep a tolerance; None where none is stated."""
    if tolerance is None:
        return None
    accuracy, validation = document.accuracy, document.validation
    unseen = None if validation is None else (validation.blocked or validation).accuracy
    if accuracy is None:
        return fact("no-distances", reason=document.why_no_accuracy)
    if unseen is None:
        return fact("tolerance-untested")
    unit = accuracy.unit
    quantile = Quantile.of_summary(unseen.p95, unseen.poses or document.data.used)
    quantile = quantile and quantile.widened(_beyond(document, unit))
    region = None if document.prediction is None else document.prediction.region
    seen = region is not None and region.of(unit) is not None
    where = "in the working region" if seen else "near the measured poses"
    return kept(quantile, tolerance, unit, where)


def _beyond(document: ResultDocument, unit: str) -> float:
    """95 % of the error [unit] that the parameters add in the working region to that at the poses;
    0 where the region is not known."""
    region = None if document.prediction is None else document.prediction.region
    region_sd = None if region is None else region.of(unit)
    if region_sd is None:
        return 0.0
    if region_sd.sd is None:
        return math.inf
    # sd is that of three coordinates together: d^2 = sd^2 chi-squared(3) / 3 where they are alike.
    more = max(region_sd.sd**2 - region_sd.sd_at_poses**2, 0.0)
    return math.sqrt(more * chi_squared.quantile(0.05, 3) / 3.0)
