"""What a calibration says of each term: the scale it learnt, how sure, and what it gains."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from loopcal.document.terms import TermEntry
from loopcal.estimation.noise.term_scales import TermFit
from loopcal.presentation.shown import with_unit

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from loopcal.estimation.noise.variances import Variances
    from loopcal.mechanisms.mechanism import Mechanism
    from loopcal.mechanisms.terms import Term

_QUANTILE = 1.959963984540054
"""Of the normal distribution, for 95 %."""


@dataclass(frozen=True)
class EstimatedTerm:
    """What the calibration says of one term.

    scale: the learnt sd [SI]; lower, upper: its 95 % interval, from the curvature of the criterion
    by its logarithm; columns: estimated parameters; effective: degrees of freedom that the data
    use of them; gain: by how much the term lowers -2 log of the restricted likelihood.
    """

    term: Term
    scale: float
    lower: float
    upper: float
    columns: int
    effective: float
    gain: float


def judged_terms(
    found: Variances, without: Callable[[int], Variances]
) -> tuple[EstimatedTerm, ...]:
    """What the last linearisation says of each term with estimated parameters.

    without: the variances learnt again with a term counting as absent.
    """
    learnt = found.terms
    if learnt is None:
        return ()
    at, sds = learnt.at, _sds(learnt.at, learnt.free)
    judged = []
    for i, term in enumerate(learnt.system.terms):
        columns = int((learnt.system.owner == i).sum())
        if not columns:
            continue
        scale, spread = float(at.scales[i]), math.exp(0.5 * _QUANTILE * sds[1 + i])
        other = without(i)
        assert other.terms is not None
        gain = other.criterion - float(other.terms.at.penalties[i])
        gain -= found.criterion - float(at.penalties[i])
        freedom = max(float(at.freedom[i]), 0.0)
        judged.append(
            EstimatedTerm(term, scale, scale / spread, scale * spread, columns, freedom, gain)
        )
    return tuple(judged)


def term_entries(
    mechanism: Mechanism, estimated: tuple[EstimatedTerm, ...]
) -> tuple[TermEntry, ...]:
    """As a document holds them."""
    found = []
    for one in estimated:
        unit = mechanism.parameters[one.term.parameters[0]].unit
        scale = with_unit(one.scale, unit, 2, fine=True)
        words = one.term.words or f"{one.term.name} deviate from nominal by {{scale}} (sd)"
        found.append(
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
            )
        )
    return tuple(found)


def _sds(at: TermFit, free: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Sds of x (log phi, log sd^2 of each term), 0 where held."""
    sds = np.zeros(len(at.x))
    index = np.flatnonzero(free)
    values, vectors = np.linalg.eigh(at.hessian[np.ix_(index, index)])
    # the criterion is -2 log likelihood: its curvature is twice the information
    variances = np.square(vectors) @ (2.0 / np.maximum(values, 1e-3))
    sds[index] = np.sqrt(variances)
    return sds
