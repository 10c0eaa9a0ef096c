"""The findings on a calibration, from all facts of its document, and the verdict they amount to.

Where a result is valid, what it is better than, whether it is good enough for a tolerance: one
fact for each of these questions.

Good enough? Distances at some poses against a tolerance, with a guard band.

The tolerance shall hold in 95 % of all poses. Where distances are those of normal errors, their
power 2/3 is nearly normal (Wilson and Hilferty 1931), so both ends of the 95 % confidence interval
of its 95 % quantile are one-sided normal tolerance factors (noncentral t; Owen 1968). Within this
guard band the decision is open (JCGM 106:2012, section 8.3).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from loopcal import chi_squared
from loopcal.arrays import Array
from loopcal.document import catalogue
from loopcal.document.accuracy import BoardPlace, Distances
from loopcal.document.catalogue import CATALOGUE
from loopcal.document.choice import beats
from loopcal.document.findings import JointErrorEntry, RegionEntry, RegionSd
from loopcal.document.fit import ParameterEntry
from loopcal.document.result_document import ResultDocument
from loopcal.document.verdict import Answer, Fact, Figure, Finding, NextStep, Verdict, fact
from loopcal.errors import listed
from loopcal.estimation.fit_document import fit_document
from loopcal.estimation.methods.registry import METHODS
from loopcal.estimation.result import FitResult
from loopcal.mechanisms.parallel.free_body import TURNS
from loopcal.mechanisms.parameters import labels_of
from loopcal.presentation.shown import significant
from loopcal.statistics.calibration_document import calibration_document, with_findings
from loopcal.statistics.case import NOMINAL
from loopcal.statistics.findings import Findings, findings
from loopcal.statistics.judged_readings import Readings
from loopcal.statistics.region import Span
from loopcal.statistics.sound import SOUND

if TYPE_CHECKING:
    from loopcal.statistics.validation import Validation


def refuses(question: str, answer: Answer) -> bool:
    """Whether an answer stops a run that requires this question: "sound" where it fails, the
    others unless they pass."""
    return answer.passed is False if question == "sound" else answer.passed is not True


def judged(
    document: ResultDocument, tolerance: float | None = None, files: Mapping[str, str] = {}
) -> ResultDocument:
    """The document with all findings and its verdict.

    tolerance: distance [SI] that 95 % of poses shall keep; files: names of project and result, for
    command lines.
    """
    made = findings_of(document, tolerance, files)
    accuracy = document.accuracy
    metric = accuracy is not None and (accuracy.unit == "m" or bool(accuracy.places))
    verdict = Verdict.of(made, files.get("project") if metric else None)
    return replace(document, verdict=verdict, findings=made)


def findings_of(
    document: ResultDocument, tolerance: float | None = None, files: Mapping[str, str] = {}
) -> tuple[Finding, ...]:
    """All findings on a result, the gravest first; arguments as in `judged`."""
    facts = Readings.of(document).facts()
    facts += [one for analysis in SOUND if (one := analysis(document))]
    if all(CATALOGUE[one.code].severity == "info" for one in facts):
        facts.append(fact("sound"))
    region = valid(document)
    unsound = {"valid-in-region": "valid-if-sound", "valid-in-image": "in-image-if-sound"}
    if region.code in unsound and any(map(_upsets, facts)):
        region = replace(region, code=unsound[region.code])
    others = (region, better(document), good_enough(document, tolerance))
    labels = labels_of(document.parameters)
    made = catalogue.findings([*facts, *(one for one in others if one)], files, labels)
    images = _images_to_take(document)
    return tuple(_with_images(one, images) for one in made) if images else made


def _images_to_take(document: ResultDocument) -> str:
    """In place of poses to plan: where no robot moves, or one that reads no joints."""
    if _cameras_alone(document):
        return _MORE_IMAGES
    accuracy = document.accuracy
    machine = document.mechanism
    read = machine is not None and {*TURNS} <= machine.quantities.keys()
    return _MORE_OF_A_HAND if accuracy and accuracy.places and read else ""


def _cameras_alone(document: ResultDocument) -> bool:
    """Whether nothing says where boards are but the images."""
    accuracy = document.accuracy
    return accuracy is not None and bool(accuracy.pixels) and not accuracy.places


def _with_images(one: Finding, images: str) -> Finding:
    if one.code == "model-incomplete" and images == _MORE_OF_A_HAND:
        return replace(one, next=NextStep(_JOINTS))
    planned = one.next and (one.next.command or "").startswith("loopcal plan")
    return replace(one, next=NextStep(images)) if planned else one


_JOINTS = (
    "State the joints in place of the poses, and the robot (--dh or --urdf): its poses err as its "
    "geometry does, which is then estimated too."
)
_MORE_OF_A_HAND = (
    "Take more images, in random order, with the hand turned by 30 deg about two axes, at several "
    "distances and in all parts of the image."
)
_MORE_IMAGES = (
    "Take more images, with the board tilted by 20 to 45 deg either way, at several distances and "
    "in all parts of the image."
)


def _upsets(one: Fact) -> bool:
    """Whether the predicted sd of a fit with this fact lacks an error that may be larger."""
    row = CATALOGUE[one.code]
    return (row.question, row.severity) == ("sound", "refuse") or one.code in _BEYOND


def verdict(
    result: FitResult,
    *,
    validation: Validation | None = None,
    tolerance: float | None = None,
    region: Mapping[str, Span] | None = None,
    found: Findings | None = None,
) -> Verdict:
    """Whether a calibration can be used, and for what: four answers and a headline.

    validation: of the same calibration, without which nothing says what it is better than;
    tolerance: distance [SI] that 95 % of poses in the working region shall keep; region: reading ->
    range [SI] where the machine works, by default its joints' limits; found: the `findings` of the
    result, if they are at hand.
    """
    parts = result.parts
    if validation is not None:
        parts = replace(parts, validation=validation.entry)
    document = calibration_document(fit_document(result), parts)
    document = with_findings(document, found or findings(result, region))
    return Verdict.of(findings_of(document, tolerance))


# Record 0054.
NEAR_ONLY = 3.0
"""Predicted sd in the working region over that at the measured poses from which a result is valid
near these poses only: that of the alarm of single predictions."""
# Paired standard errors that "better" needs (docs/explanation/verdict.md).
_CERTAIN = 2.0
_OF_RMS = 0.41
"""sd of an rms of N distances in space over rms / sqrt(N): sqrt(2/3) / 2."""
_ELSEWHERE = 1.5
"""Errors in regions of the image not used over those of images not used, from which the lens is not
known where no corner was. Chosen: as much again as the corners' noise."""
# Chosen, not derived: of 20 random poses the joints cover as much.
_COVERED = 0.9
"""Share of a joint's range that was measured, from which an error that follows it is seen."""
_DRAWN = "the nominal machine"
_BEYOND = (
    "scales-unlike",
    "scale-off-the-drawing",
    "range-zero",
    "joint-scale",
    "overfitted",
    "observations-conflict",
)
"""Facts that leave a fit usable with care, but move predictions by more than half their sd."""


def valid(document: ResultDocument) -> Fact:
    """Where: the predicted sd in the working region beside that at the measured poses."""
    if document.column_faults or not document.status.converged:
        return fact("region-not-judged")
    region = document.region
    if region is None and _cameras_alone(document):
        return _in_image(document)
    if region is None:
        return _gaps_only(document) or fact("region-unknown")
    sources = {one.source for one in region.ranges}
    where = "the working region"
    if sources == {"readings"}:
        images = document.accuracy is not None and document.accuracy.pixels
        within = ", where corners were seen" if images else ""
        where = f"the region between the measured poses{within} (no limits are known)"
    elif "turn" in sources:
        where = "the working region (±90 deg for joints without stated limits)"
    worst, parked = region.worst, region.worst_while_parked
    near = worst.ratio is None or worst.ratio > NEAR_ONLY
    if near and parked and parked.ratio is not None and parked.ratio <= NEAR_ONLY:
        moved = "unbounded" if worst.sd is None else f"{Figure(worst.sd, worst.unit):2}"
        joints = listed(region.parked, 3)
        numbers, seen = _sds(parked), parked.seen
        return fact("valid-while-parked", numbers=numbers, joints=joints, moved=moved, seen=seen)
    if worst.sd is None:
        return fact("direction-open", where=where, seen=worst.seen)
    if near or (follows := _error_beyond(document, region)) is None:
        code = "near-poses-only" if near else "valid-in-region"
        return fact(code, numbers=_sds(worst), where=where, seen=worst.seen)
    error, covered = follows
    return fact(
        "error-follows-joint",
        numbers=_sds(worst),
        where=where,
        seen=worst.seen,
        joint=error.joint,
        parameter=labels_of(document.parameters).get(error.parameter, error.parameter),
        covered=f"{100.0 * covered:.0f}",
    )


def _error_beyond(
    document: ResultDocument, region: RegionEntry
) -> tuple[JointErrorEntry, float] | None:
    """An error that follows a joint beyond its measured range, and the share of the region's that
    was measured; None without one."""
    one = document.joint_error
    if one is None:
        return None
    of = next((r for r in region.ranges if r.quantity == one.joint), None)
    if of is None or not of.high > of.low:
        return None
    covered = (min(one.high, of.high) - max(one.low, of.low)) / (of.high - of.low)
    return None if covered >= _COVERED else (one, max(covered, 0.0))


def _in_image(document: ResultDocument) -> Fact:
    """Of cameras alone: errors in regions of the image not used beside those of images not used."""
    validation = document.validation
    unseen = validation and validation.accuracy
    apart = validation and validation.images and validation.images.accuracy
    if not unseen or not apart:
        return fact("image-untested")
    numbers = {"rms_in_regions": Figure(apart.rms, "px"), "rms": Figure(unseen.rms, "px")}
    near = apart.rms > _ELSEWHERE * unseen.rms
    return fact("image-covered-in-part" if near else "valid-in-image", numbers=numbers)


def _gaps_only(document: ResultDocument) -> Fact | None:
    """Of a machine that was only touched, whose size is the direction that gaps show worst.

    With the free lengths l and their covariance C the size, (l^T dl) / (l^T l), has the sd
    (l^T C l)^(1/2) / (l^T l).
    """
    if document.accuracy is None or document.prediction is not None:
        return None
    names, matrix = document.covariance.names, np.array(document.covariance.matrix, float)
    values = {p.name: p.value for p in document.parameters if p.unit == "m"}
    lengths = np.array([values.get(name, 0.0) for name in names])
    kept = lengths != 0.0
    long, C = lengths[kept], matrix[np.ix_(kept, kept)]
    variance = float(long @ C @ long) if len(long) else math.nan
    if not variance >= 0.0:  # an open direction has NaN
        return fact("gaps-only", size="is open")
    share, most = math.sqrt(variance) / float(long @ long), float(np.abs(long).max())
    sd, length = Figure(share * most, "m"), Figure(most, "m")
    return fact(
        "gaps-only", size=f"has an sd of {significant(100.0 * share, 2)} % ({sd:2} in {length:3})"
    )


def _sds(of: RegionSd) -> dict[str, Figure | float]:
    return {
        "sd_ratio": Figure(of.ratio or math.inf),
        "sd_in_region": Figure(of.sd or math.inf, of.unit),
        "sd_at_poses": Figure(of.sd_at_poses, of.unit),
    }


def better(document: ResultDocument) -> Fact:
    """Better than the nominal machine, placed and mounted, and than plain least squares."""
    accuracy, validation = document.accuracy, document.validation
    if accuracy is None:
        return fact("no-outputs", reason=document.why_no_accuracy)
    unseen = None if validation is None else validation.accuracy
    if unseen is None:
        return fact("not-validated" if document.status.converged else "fit-failed")
    compared = _compared(document, unseen)
    drawn = _drawn(document)
    ahead = [r for r in compared.rivals if r.beats and (drawn or r.name != _DRAWN)]
    if ahead:
        worst = min(ahead, key=lambda rival: rival.difference)
        code = "worse" if worst.name in METHODS else "worse-than-model"
        code = "worse-than-drawing" if worst.name == _DRAWN else code
        return compared.fact(code, worst, accuracy.unit)
    first = compared.rivals[0]  # methods that predict alike leave nothing to decide
    if not drawn and first.difference <= _CERTAIN * first.sd:
        return fact("nothing-stated", numbers={"rms": Figure(compared.rms, accuracy.unit)})
    if first.difference <= _CERTAIN * first.sd:
        return compared.fact("no-better", first, accuracy.unit)
    elsewhere = _nominal_elsewhere(document)
    code = "better-near-only" if elsewhere else "better"
    return compared.fact(code, first, accuracy.unit, **elsewhere)


def _drawn(document: ResultDocument) -> bool:
    """Whether a machine or a lens was stated, to compare with; what is printed does not count."""
    parameters = {p.name: p for p in document.parameters}

    def stated(one: ParameterEntry) -> bool:
        focal = parameters.get(f"{one.owner}_f")
        free = focal is not None and focal.prior_sd is None and not focal.fixed
        return one.role not in ("placement", "mounting", "print", "corner") and not (
            one.role == "lens" and free
        )

    return any(map(stated, document.parameters))


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
        sd = _OF_RMS * math.hypot(drawn.rms, unseen.rms) / math.sqrt(n)
        difference = drawn.rms - unseen.rms
        paired.append(Rival(_DRAWN, difference, sd, beats(difference, sd, None, None)))
    return _Compared(unseen.rms, tuple(sorted(paired, key=lambda r: r.name != _DRAWN)))


_ONLY_IMAGES = "only the images say where the board is"


def good_enough(document: ResultDocument, tolerance: float | None) -> Fact | None:
    """Whether 95 % of poses keep a tolerance; None where none is stated."""
    if tolerance is None:
        return None
    accuracy, validation = document.accuracy, document.validation
    held = None if validation is None else validation.blocked or validation
    if accuracy is None:
        return fact("no-distances", reason=document.why_no_accuracy)
    unit, unseen = accuracy.unit, None if held is None else held.accuracy
    if unit == "px":
        if not accuracy.places:
            return fact("no-distances", reason=_ONLY_IMAGES)
        unit, unseen = "m", None if held is None else _place(held.places)
    if unseen is None:
        return fact("tolerance-untested")
    quantile = Quantile.of_summary(unseen.p95, unseen.poses or document.data.used)
    quantile = quantile and quantile.widened(_beyond(document, unit))
    region = document.region
    seen = region is not None and region.of(unit) is not None
    where = "in the working region" if seen else "near the measured poses"
    return kept(quantile, tolerance, unit, where)


def _place(places: Sequence[BoardPlace]) -> Distances | None:
    """By all cameras together; where they see several bodies, by the worst of them."""
    together = [one.position for one in places if one.instrument is None]
    every = together or [one.position for one in places]
    return max((one for one in every if one), key=lambda one: one.p95, default=None)


def _beyond(document: ResultDocument, unit: str) -> float:
    """95 % of the error [unit] that the parameters add in the working region to that at the poses;
    0 where the region is not known."""
    region = document.region
    region_sd = None if region is None else region.of(unit)
    if region_sd is None:
        return 0.0
    if region_sd.sd is None:
        return math.inf
    # sd is that of three coordinates together: d^2 = sd^2 chi-squared(3) / 3 where they are alike.
    more = max(region_sd.sd**2 - region_sd.sd_at_poses**2, 0.0)
    return math.sqrt(more * chi_squared.quantile(0.05, 3) / 3.0)


# The level that all pages state.
CONFIDENCE = 0.95
_NORMAL = 1.6448536269514722
"""Quantile of the standard normal distribution at 0.95, the share of all poses that shall lie
within the tolerance."""
# Two distances have an sd with one degree of freedom, whose bounds say nothing.
_FEWEST = 3


@dataclass(frozen=True)
class Quantile:
    """The distance that 95 % of poses do not exceed [unit], and the interval that holds it."""

    value: float
    low: float
    high: float

    @classmethod
    def of(cls, distances: Array) -> Quantile | None:
        """From distances (N,), those that are missing left out; None for fewer than three."""
        finite = distances[np.isfinite(distances)]
        if len(finite) < _FEWEST:
            return None
        u = np.cbrt(np.square(finite))
        mean, sd = float(u.mean()), float(u.std(ddof=1))
        factors = (_NORMAL, *_factors(len(finite)))
        return cls(*(max(mean + k * sd, 0.0) ** 1.5 for k in factors))

    @classmethod
    def of_summary(cls, p95: float, poses: int) -> Quantile | None:
        """From the 95 % quantile of so many distances, those of normal errors in space."""
        if poses < _FEWEST:
            return None
        # Mean 1 - 2 / (9 k), variance 2 / (9 k) with k = 3 (Wilson and Hilferty 1931).
        mean, sd = 1.0 - 2.0 / 27.0, math.sqrt(2.0 / 27.0)  # of (chi-squared(3) / 3)^(1/3)
        middle = mean + _NORMAL * sd
        low, high = (max((mean + k * sd) / middle, 0.0) ** 1.5 for k in _factors(poses))
        return cls(p95, low * p95, high * p95)

    def widened(self, more: float) -> Quantile:
        """With an independent error of this 95 % quantile besides."""
        return Quantile(*(math.hypot(v, more) for v in (self.value, self.low, self.high)))


def _factors(poses: int) -> tuple[float, float]:
    """Tolerance factors of both ends of the interval, for so many poses."""
    from scipy.special import nctdtrit

    root = math.sqrt(poses)
    chances = 0.5 * (1.0 - CONFIDENCE), 0.5 * (1.0 + CONFIDENCE)
    low, high = (float(nctdtrit(poses - 1.0, root * _NORMAL, p)) / root for p in chances)
    return low, high


def kept(quantile: Quantile | None, tolerance: float, unit: str, where: str) -> Fact:
    """Whether a tolerance [unit] is kept; where: of which poses the quantile speaks."""
    if quantile is None:
        return fact("few-distances", where=where)
    limit = Figure(tolerance, unit)
    if not math.isfinite(quantile.value):
        return fact("error-unbounded", where=where, limit=f"{limit}")
    sizes = {"error": quantile.value, "low": quantile.low, "high": quantile.high}
    numbers = {name: Figure(value, unit) for name, value in sizes.items()} | {"tolerance": limit}
    code = "near-tolerance"
    if quantile.high <= tolerance:
        code = "within-tolerance"
    elif quantile.low > tolerance:
        code = "outside-tolerance"
    return fact(code, numbers=numbers, where=where)
