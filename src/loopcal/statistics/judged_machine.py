"""What the verdict finds in the parameters: how far the machine ended from its drawing."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from operator import attrgetter

import numpy as np

from loopcal.document.fit import ParameterEntry
from loopcal.document.result_document import ResultDocument
from loopcal.document.verdict import Fact, Figure, Where, fact
from loopcal.mechanisms.chain import product
from loopcal.mechanisms.station import Station
from loopcal.mechanisms.structure.structured import GEOMETRY_TERMS, GRAVITY_TILT, MOUNTED
from loopcal.presentation.shown import with_unit
from loopcal.small_samples import f_limit
from loopcal.statistics.judged_readings import RARE

# FAR and BEYOND: record 0054, end points.
FAR = 10.0
"""A length that ends this many times the machine's size away from its nominal value is none."""
BEYOND = 100.0
"""The same of prior sds."""
# Chosen, not derived: machines collapse to nothing, and drawings are right to some per cent.
SHRUNK = 0.1
"""A fit whose lengths add up to less than this share of the nominal ones has collapsed."""
# Chosen, not derived: record 0052 takes no drawing to be off by a tenth of its size.
ANOTHER = 0.1
"""Lengths that are off the drawing by this share of their size, and angles by so many rad, all in
all, are those of another machine."""
# Chosen, not derived: fewer give no size, and 5 sds leave no doubt among a hundred parameters.
_FEWEST, _CLEAR = 3, 5.0
"""Other parameters of a kind that one is compared with; by how many of its own sds, and of their
distances, it must be off."""


def prior_tension(document: ResultDocument) -> Fact | None:
    """The parameter farthest from its nominal value in prior sds.

    |value - nominal| over the prior sd, which the sd of that difference never exceeds. What changed
    along the run is no matter of a drawing, and is stated as that change."""
    changes = document.change_points
    along = {point.effect for point in changes.found if point.modelled} if changes else set()
    estimated = [
        p for p in document.parameters if p.prior_sd and not p.fixed and p.owner not in along
    ]
    if document.sensors_exact or not estimated:
        return None
    z, p = max(((_off(p) / (p.prior_sd or math.inf), p) for p in estimated), key=lambda one: one[0])
    # Two-sided normal tail of the worst of several (Bonferroni).
    if len(estimated) * math.erfc(z / math.sqrt(2.0)) >= RARE:
        return None
    prior_sd = with_unit(p.prior_sd, p.unit)
    if p.meaning == GRAVITY_TILT:
        tilts = [one for one in estimated if one.meaning == GRAVITY_TILT]
        # cos a cos b is the cosine of the angle to the nominal direction (`Direction`).
        turn = math.acos(math.prod(math.cos(one.value) for one in tilts))
        off = with_unit(turn, p.unit, 2)
        return fact("gravity-elsewhere", _of(*tilts), {"sds": z}, off=off, usual=prior_sd)
    off = with_unit(p.value - p.nominal, p.unit)
    return fact("prior-tension", _of(p), {"sds": z}, off=off, prior_sd=prior_sd)


def far_from_nominal(document: ResultDocument) -> Fact | None:
    """Where a fit ends that lost its way: beyond the machine, beyond its prior, or shrunk."""
    estimated = [p for p in document.parameters if not p.fixed]
    lengths = [p for p in estimated if p.unit == "m"]
    size = sum(abs(p.nominal) for p in document.parameters if p.unit == "m") + _farthest(document)
    far = [(abs(p.value - p.nominal) / (FAR * size), p) for p in lengths if size > 0.0]
    far += [(abs(p.value - p.nominal) / (BEYOND * p.prior_sd), p) for p in estimated if p.prior_sd]
    worst, p = max(far, key=lambda one: one[0], default=(0.0, None))
    if p is not None and worst > 1.0:
        off, nominal = with_unit(p.value - p.nominal, p.unit), with_unit(p.nominal, p.unit)
        return fact("far-from-nominal", _of(p), {"share": worst}, off=off, nominal=nominal)
    drawn, fitted = (sum(abs(getattr(p, v)) for p in lengths) for v in ("nominal", "value"))
    if drawn > 0.0 and fitted < SHRUNK * drawn:
        return fact("lengths-shrank", numbers={"share": fitted / drawn})
    return None


def _farthest(document: ResultDocument) -> float:
    """The largest typical length [m] that was read: how far away instruments stand."""
    if document.prediction is None or document.mechanism is None:
        return 0.0
    units = document.mechanism.quantities
    read = [abs(v) for q, v in document.prediction.typical.items() if units.get(q) == "m"]
    return max(read, default=0.0)


def off_the_drawing(document: ResultDocument) -> Fact | None:
    """One dimension, all of them, or what is mounted far off: the drawing is wrong there."""
    alike = [*_dimensions(document)]
    return _one_off(alike) or _all_off(document, alike) or _mounted_off(document)


def _dimensions(document: ResultDocument) -> Iterator[list[ParameterEntry]]:
    """What the drawing states, by kind, that only a learnt sd holds near it, or nothing."""
    learnt = {term.name: term.columns for term in document.terms}
    by_kind: dict[tuple[str, str], list[ParameterEntry]] = {}
    for p in document.parameters:
        if (p.role, p.unit) in GEOMETRY_TERMS and not p.fixed:
            by_kind.setdefault((p.role, p.unit), []).append(p)
    for kind, entries in by_kind.items():
        # A document does not mark learnt sds: as many parameters share one as its term has columns.
        shared, count = Counter(p.prior_sd for p in entries), learnt.get(GEOMETRY_TERMS[kind][0])
        alike = [p for p in entries if not p.prior_sd or shared[p.prior_sd] == count]
        if alike:
            yield alike


def _one_off(dimensions: Sequence[list[ParameterEntry]]) -> Fact | None:
    """One that is far off, compared with the root mean square of the others of its kind."""
    for alike in dimensions:
        worst, unit = max(alike, key=_off), alike[0].unit
        rest = [p for p in alike if p is not worst]
        others = sum(map(_determined, rest))
        if others < _FEWEST or not worst.sd:
            continue
        # without a prior the sds of the poses are in the distances, however rough: they count twice
        squares = [_off(p) ** 2 + (0.0 if p.prior_sd else (p.sd or 0.0) ** 2) for p in rest]
        usual = math.sqrt(sum(squares) / others)
        if _off(worst) < _CLEAR * max(usual, worst.sd):
            continue
        # One square over the mean of the others is F(1, others); all share the level (Bonferroni).
        freedom = np.array(others)
        if _off(worst) > math.sqrt(f_limit(1.0 - RARE / len(alike), 1, freedom)) * usual:
            numbers = {"difference": Figure(worst.value - worst.nominal, unit)}
            kind = GEOMETRY_TERMS[worst.role, unit][0].replace("_", " ")
            within = with_unit(usual, unit, 2)
            return fact("off-the-drawing", _of(worst), numbers, kind=kind, usual=within)
    return None


def _determined(p: ParameterEntry) -> float:
    """The share of a parameter that the poses determine, 1 - sd^2 / prior sd^2 (MacKay 1992).

    What they leave open stays at the drawing and says nothing of its size; the learnt sd, which
    the one that is off has made large, says nothing either."""
    return 1.0 - min((p.sd or 0.0) / p.prior_sd, 1.0) ** 2 if p.prior_sd else 1.0


def _all_off(document: ResultDocument, dimensions: Sequence[list[ParameterEntry]]) -> Fact | None:
    """All of a kind far off: another machine is drawn."""
    for alike in dimensions:
        role, unit = alike[0].role, alike[0].unit
        drawn = [p.nominal for p in document.parameters if p.dimension == "length"]
        # Axes of a product of exponentials have shifts, which are all 0 in the drawing.
        size = (_rms(drawn) or _farthest(document)) if unit == "m" else 1.0
        off, sure = _rms([_off(p) for p in alike]), _rms([p.sd or 0.0 for p in alike])
        if len(alike) > _FEWEST and off > max(ANOTHER * size, _CLEAR * sure):
            numbers = {"difference": Figure(off, unit)}
            kind = GEOMETRY_TERMS[role, unit][0].replace("_", " ")
            return fact("another-drawing", _of(*alike), numbers, kind=kind)
    return None


def _mounted_off(document: ResultDocument) -> Fact | None:
    """What is mounted farther from its place in the drawing than things are mounted."""
    if document.mechanism is None:
        return None
    unstated = {name for names in document.mechanism.unstated for name in names}
    mountings = [
        p
        for p in document.parameters
        if p.role == "mounting"
        and not (p.fixed or p.prior_sd or p.name in unstated)
        and p.unit in MOUNTED
    ]
    off = {p.name: _turned(p, document) if p.unit == "rad" else _off(p) for p in mountings}
    p = max(mountings, key=lambda p: off[p.name] / MOUNTED[p.unit], default=None)
    if p is None or not p.sd or off[p.name] < _CLEAR * p.sd:
        return None
    z = off[p.name] / MOUNTED[p.unit]
    if len(mountings) * math.erfc(z / math.sqrt(2.0)) >= RARE:
        return None
    numbers = {"difference": Figure(math.copysign(off[p.name], p.value - p.nominal), p.unit)}
    return fact("mounting-off", _of(p), numbers, usual=with_unit(MOUNTED[p.unit], p.unit))


def _rms(values: Sequence[float]) -> float:
    return math.sqrt(sum(v * v for v in values) / len(values)) if values else 0.0


def _off(p: ParameterEntry) -> float:
    return abs(p.value - p.nominal)


def _turned(p: ParameterEntry, document: ResultDocument) -> float:
    """The angle by which a frame is turned from its place in the drawing, or that of p alone.

    With a pitch of 90 degrees, as of a camera that looks ahead, yaw and roll turn about one axis,
    and only their sum is known.
    """
    place = Station(p.owner)
    of = {one.name: one for one in document.parameters if one.name in place.parameters}
    if p.name not in of or len(of) < len(place.parameters):
        return _off(p)
    start, end = (
        product(place.steps, {}, {name: value(one) for name, one in of.items()})[:3, :3]
        for value in (attrgetter("nominal"), attrgetter("value"))
    )
    # |R - 1| = sqrt(8) sin(angle / 2): the trace would round small angles away.
    return 2.0 * math.asin(min(float(np.linalg.norm(end - start)) / math.sqrt(8.0), 1.0))


def _of(*parameters: ParameterEntry) -> Where:
    return Where(parameters=tuple(p.name for p in parameters))
