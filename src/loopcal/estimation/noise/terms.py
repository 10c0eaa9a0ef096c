"""What a calibration says of each term: the scale it learnt, how sure, and what it gains."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from loopcal.document.terms import TermEntry
from loopcal.estimation.noise.term_scales import Start, TermFit, TermSystem, learn_scales
from loopcal.mechanisms.parameters import BEYOND
from loopcal.presentation.shown import with_unit

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from loopcal.estimation.noise.variances import TermVariances
    from loopcal.mechanisms.mechanism import Mechanism
    from loopcal.mechanisms.terms import Term

_QUANTILE = 1.959963984540054
"""Of the normal distribution, for 95 %."""
# Chosen, not derived: far below any effect that readings show.
_ABSENT = 1e-6
"""A term with this share of its expected sd has no effect."""


@dataclass(frozen=True)
class EstimatedTerm:
    """What the calibration says of one term.

    scale: the learnt sd [SI]; lower, upper: its 95 % interval, from the curvature of the criterion
    by its logarithm; columns: estimated parameters; effective: degrees of freedom that the data
    use of them; gain: by how much the term lowers -2 log of the restricted likelihood, where all
    noise may grow by a factor in its place.
    """

    term: Term
    scale: float
    lower: float
    upper: float
    columns: int
    effective: float
    gain: float


def judged_terms(learnt: TermVariances) -> tuple[EstimatedTerm, ...]:
    """What the last linearisation says of each term."""
    system, at, sds = learnt.system, learnt.at, curvature_sds(learnt)
    judged = []
    present = learn_scales(system, Start(at.x, np.ones(len(at.x), dtype=bool)))
    for i, term in enumerate(system.terms):
        columns = int((system.owner == i).sum())
        # The sds are those of log sd^2, twice those of log sd.
        scale, spread = float(at.scales[i]), math.exp(0.5 * _QUANTILE * sds[1 + i])
        freedom, gain = max(float(at.freedom[i]), 0.0), _gain(system, present, i)
        judged.append(
            EstimatedTerm(term, scale, scale / spread, scale * spread, columns, freedom, gain)
        )
    return tuple(judged)


def _gain(system: TermSystem, present: TermFit, term: int) -> float:
    """By how much the criterion is lower with a term than without it.

    present: with all terms, and all noise free to have a factor. Without a term the other terms and
    that factor make up for it where they can.
    """
    x, others = present.x.copy(), np.ones(len(present.x), dtype=bool)
    x[1 + term], others[1 + term] = 2.0 * math.log(_ABSENT * system.terms[term].sd), False
    without = learn_scales(system, Start(x, others))
    gain = without.criterion - present.criterion
    return gain - float(without.penalties[term] - present.penalties[term])


def term_entries(
    mechanism: Mechanism, estimated: tuple[EstimatedTerm, ...]
) -> tuple[TermEntry, ...]:
    """As a document holds them."""
    entries = []
    for one in estimated:
        unit = mechanism.parameters[one.term.parameters[0]].unit
        scale = with_unit(one.scale, unit, 2, fine=True)
        words = one.term.words or f"{one.term.name} deviate from nominal by {{scale}} (sd)"
        entries.append(
            TermEntry(
                one.term.name,
                unit,
                one.scale,
                (one.lower, one.upper),
                one.term.sd,
                one.columns,
                one.effective,
                one.gain,
                words.replace("{scale}", scale),
                tuple(n for n in one.term.parameters if mechanism.roles.get(n) in BEYOND),
            )
        )
    return tuple(entries)


def curvature_sds(learnt: TermVariances) -> NDArray[np.float64]:
    """Sds of (log of the common factor, log sd^2 of each term), 0 where held."""
    at, free = learnt.at, learnt.free
    sds = np.zeros(len(at.x))
    index = np.flatnonzero(free)
    values, vectors = np.linalg.eigh(at.hessian[np.ix_(index, index)])
    # the criterion is -2 log likelihood: its curvature is twice the information
    variances = np.square(vectors) @ (2.0 / np.maximum(values, 1e-3))
    sds[index] = np.sqrt(variances)
    return sds
