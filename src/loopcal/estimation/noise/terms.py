"""What a calibration says of each term: the scale it learnt, how sure, and what it gains."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from loopcal.document.terms import TermEntry
from loopcal.estimation.noise.term_scales import TermFit, TermSystem, TermVariances, searched
from loopcal.mechanisms.parameters import BEYOND
from loopcal.presentation.shown import with_unit

if TYPE_CHECKING:
    from loopcal.mechanisms.mechanism import Mechanism

_QUANTILE = 1.959963984540054
"""Of the normal distribution, for 95 %."""
# Chosen, not derived: far below any effect that readings show.
_ABSENT = 1e-6
"""A term with this share of its expected sd has no effect."""


def term_entries(mechanism: Mechanism, learnt: TermVariances) -> tuple[TermEntry, ...]:
    """What the last linearisation says of each term, as a document holds it.

    The interval is from the curvature of the criterion by the logarithm of the scale.
    """
    system, at, sds = learnt.system, learnt.at, learnt.sds
    # With all noise free to have a factor, which may grow in the place of a term.
    present = searched(system, at.x, np.ones(len(at.x), dtype=bool)).at
    entries = []
    for i, term in enumerate(system.terms):
        unit = mechanism.parameters[term.parameters[0]].unit
        # The sds are those of log sd^2, twice those of log sd.
        scale, spread = float(at.scales[i]), math.exp(0.5 * _QUANTILE * sds[1 + i])
        words = term.words or f"{term.name} deviate from nominal by {{scale}} (sd)"
        entries.append(
            TermEntry(
                term.name,
                unit,
                scale,
                (scale / spread, scale * spread),
                term.sd,
                int((system.owner == i).sum()),
                max(float(at.freedom[i]), 0.0),
                _gain(system, present, i),
                words.replace("{scale}", with_unit(scale, unit, 2, fine=True)),
                tuple(n for n in term.parameters if mechanism.roles.get(n) in BEYOND),
            )
        )
    return tuple(entries)


def _gain(system: TermSystem, present: TermFit, term: int) -> float:
    """By how much the criterion is lower with a term than without it.

    present: with all terms, and all noise free to have a factor. Without a term the other terms and
    that factor make up for it where they can.
    """
    x, others = present.x.copy(), np.ones(len(present.x), dtype=bool)
    x[1 + term], others[1 + term] = 2.0 * math.log(_ABSENT * system.terms[term].sd), False
    without = searched(system, x, others).at
    gain = without.criterion - present.criterion
    return gain - float(without.penalties[term] - present.penalties[term])
