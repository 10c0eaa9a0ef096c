"""What the verdict finds in the parameters: how far the machine ended from its drawing."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np

from loopcal.document.fit import ParameterEntry
from loopcal.document.result_document import ResultDocument
from loopcal.mechanisms.structure.structured import MOUNTED
from loopcal.presentation.rounding import significant
from loopcal.presentation.shown import with_unit
from loopcal.small_samples import f_limit
from loopcal.statistics.rule import RARE, Said

FAR = 10.0
"""A length that ends this many times the machine's size away from its nominal value is none."""
BEYOND = 100.0
"""The same of prior sds."""
SHRUNK = 0.1
"""A fit whose lengths add up to less than this share of the nominal ones has collapsed."""
ANOTHER = 0.1
"""Lengths that are off the drawing by this share of their size, and angles by so many rad, all in
all, are those of another machine."""
_FEWEST, _CLEAR = 3, 5.0
"""Other parameters of a kind that one is compared with; by how many of its own sds, and of their
distances, it must be off."""


def prior_tension(document: ResultDocument) -> Said | None:
    """The parameter farthest from its nominal value in prior sds.

    |value - nominal| over the prior sd, which the sd of that difference never exceeds."""
    estimated = [p for p in document.parameters if p.prior_sd and not p.fixed]
    if document.sensors_exact or not estimated:
        return None
    found = [(abs(p.value - p.nominal) / (p.prior_sd or math.inf), p) for p in estimated]
    z, p = max(found, key=lambda one: one[0])
    if len(found) * math.erfc(z / math.sqrt(2.0)) >= RARE:
        return None
    off, known = with_unit(p.value - p.nominal, p.unit), with_unit(p.prior_sd, p.unit)
    return Said(
        f"{p.name} is {off} off its nominal value, which was known to {known} "
        f"({significant(z, 2)} sds).",
        z,
    )


def far_from_nominal(document: ResultDocument) -> Said | None:
    """Where a fit ends that lost its way: beyond the machine, beyond its prior, or shrunk."""
    estimated = [p for p in document.parameters if not p.fixed]
    lengths = [p for p in estimated if p.unit == "m"]
    size = sum(abs(p.nominal) for p in document.parameters if p.unit == "m") + _farthest(document)
    far = [(abs(p.value - p.nominal) / (FAR * size), p) for p in lengths if size > 0.0]
    far += [(abs(p.value - p.nominal) / (BEYOND * p.prior_sd), p) for p in estimated if p.prior_sd]
    worst, p = max(far, key=lambda one: one[0], default=(0.0, None))
    if p is not None and worst > 1.0:
        off, nominal = with_unit(p.value - p.nominal, p.unit), with_unit(p.nominal, p.unit)
        return Said(
            f"{p.name} ended {off} away from its nominal value, {nominal}: no machine is so far "
            "from its drawing.",
            worst,
        )
    drawn, found = (sum(map(abs, v)) for v in ([p.nominal for p in lengths], _values(lengths)))
    if drawn > 0.0 and found < SHRUNK * drawn:
        return Said(
            f"The estimated lengths shrank to {significant(found / drawn, 2)} of the nominal ones.",
            found / drawn,
        )
    return None


def _values(parameters: Sequence[ParameterEntry]) -> list[float]:
    return [p.value for p in parameters]


def _farthest(document: ResultDocument) -> float:
    """The largest typical length [m] that was read: how far away instruments stand."""
    if document.prediction is None or document.mechanism is None:
        return 0.0
    units = document.mechanism.quantities
    read = [abs(v) for q, v in document.prediction.typical.items() if units.get(q) == "m"]
    return max(read, default=0.0)


def off_the_drawing(document: ResultDocument) -> Said | None:
    """One dimension, all of them, or what is mounted far off: the drawing is wrong there."""
    alike = [*_dimensions(document)]
    return _one_off(alike) or _all_off(document, alike) or _mounted_off(document)


def _dimensions(document: ResultDocument) -> Iterator[list[ParameterEntry]]:
    """Lengths, and angles, that nothing but a learnt sd holds near the drawing, or nothing."""
    kinds = {} if document.mechanism is None else document.mechanism.kinds
    learnt = {term.name: term.columns for term in document.terms}
    for kind in ("length", "angle"):
        own = [p for p in document.parameters if kinds.get(p.name) == kind and not p.fixed]
        shared, count = Counter(p.prior_sd for p in own), learnt.get(f"{kind}s")
        alike = [p for p in own if not p.prior_sd or shared[p.prior_sd] == count]
        if alike:
            yield alike


def _one_off(dimensions: Sequence[list[ParameterEntry]]) -> Said | None:
    """One that is far off, compared with the root mean square of the others of its kind."""
    for alike in dimensions:
        worst, unit = max(alike, key=_off), alike[0].unit
        others = len(alike) - 1
        if others < _FEWEST or not worst.sd:
            continue
        # what the poses hardly determine stays at the drawing: its sd counts as well
        squares = [_off(p) ** 2 + (p.sd or 0.0) ** 2 for p in alike if p is not worst]
        usual = math.sqrt(sum(squares) / others)
        if _off(worst) < _CLEAR * max(usual, worst.sd):
            continue
        freedom = np.array(float(others))
        if _off(worst) > math.sqrt(f_limit(1.0 - RARE / len(alike), 1, freedom)) * usual:
            off = with_unit(worst.value - worst.nominal, unit)
            kind = {"m": "lengths", "rad": "angles"}.get(unit, "parameters")
            return Said(
                f"{worst.name} is off the drawing by {off}; the other {kind} are within "
                f"{with_unit(usual, unit, 2)} (rms).",
                worst.value - worst.nominal,
            )
    return None


def _all_off(document: ResultDocument, dimensions: Sequence[list[ParameterEntry]]) -> Said | None:
    """All lengths, or all angles, far off: another machine is drawn."""
    kinds = {} if document.mechanism is None else document.mechanism.kinds
    for alike in dimensions:
        kind = kinds[alike[0].name]
        drawn = [p.nominal for p in document.parameters if kinds.get(p.name) == kind]
        size = _rms(drawn) if kind == "length" else 1.0
        off, sure = _rms([_off(p) for p in alike]), _rms([p.sd or 0.0 for p in alike])
        if len(alike) > _FEWEST and off > max(ANOTHER * size, _CLEAR * sure):
            return Said(
                f"The {kind}s are off the drawing by {with_unit(off, alike[0].unit, 2)} (rms): "
                "this may be the drawing of another machine.",
                off,
            )
    return None


def _mounted_off(document: ResultDocument) -> Said | None:
    """What is mounted farther from its place in the drawing than things are mounted."""
    if document.mechanism is None:
        return None
    unstated = {name for names in document.mechanism.unstated for name in names}
    own = [
        p
        for p in document.parameters
        if document.mechanism.kinds.get(p.name) == "mounting"
        and not (p.fixed or p.prior_sd or p.name in unstated)
        and p.unit in MOUNTED
    ]
    p = max(own, key=lambda p: _off(p) / MOUNTED[p.unit], default=None)
    if p is None or not p.sd or _off(p) < _CLEAR * p.sd:
        return None
    z = _off(p) / MOUNTED[p.unit]
    if len(own) * math.erfc(z / math.sqrt(2.0)) >= RARE:
        return None
    off, usual = with_unit(p.value - p.nominal, p.unit), with_unit(MOUNTED[p.unit], p.unit)
    return Said(
        f"{p.name} is off the drawing by {off}; what is mounted is usually within {usual} (sd).",
        p.value - p.nominal,
    )


def _rms(values: Sequence[float]) -> float:
    return math.sqrt(sum(v * v for v in values) / len(values)) if values else 0.0


def _off(p: ParameterEntry) -> float:
    return abs(p.value - p.nominal)
