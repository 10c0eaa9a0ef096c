"""Whether two halves of the images, fitted apart, say the same of the lens.

A lens that lacks a term, or a board that is not as stated, is taken up by the focal length, and by
another amount in other images. The residuals show little of it; two fits of different images do.
With estimates a, b of the halves the covariance of b - a is that of both, less what both took from
the same prior (`comparison.covariance_between`).
"""

from __future__ import annotations

import math

import numpy as np

from loopcal.document.findings import HalvesEntry
from loopcal.document.plain import finite
from loopcal.execution.executor import Executor
from loopcal.statistics.calibrated import Calibrated
from loopcal.statistics.comparison import covariance_between
from loopcal.statistics.folds import folds
from loopcal.statistics.judged import Judged
from loopcal.statistics.validation import Plan, Predicted, left_out


def lens_halves(
    taken: Judged, plan: Plan, executor: Executor | None = None
) -> tuple[HalvesEntry, ...]:
    """Each parameter of a lens by both halves; empty without cameras, and where one cannot be
    fitted."""
    whole, case = taken.whole, taken.entrant.case
    lens = () if whole is None else whole.mechanism.parameters.of_role("lens")
    if whole is None or not {*lens} & {*whole.estimated} or len(np.unique(plan.groups)) < 2:
        return ()
    (made,) = left_out([(case, whole)], folds(plan.groups, 2, seed=0), executor)
    fits = [part.fit for part in made if isinstance(part, Predicted) and part.fit is not None]
    if len(fits) < 2 or fits[0].estimated != fits[1].estimated:
        return ()
    first, second = (Calibrated.of(fit, "") for fit in fits)
    covariance = covariance_between(first.by_residuals, second.by_residuals)
    sd = np.sqrt(np.maximum(np.diag(covariance.matrix), 0.0))
    entries = []
    for i, p in enumerate(whole.mechanism.parameters):
        if p.name in lens and p.name in fits[0].estimated and 0.0 < sd[i] < math.inf:
            one, other = (fit.value[p.name] for fit in fits)
            freedom = finite(float(covariance.freedom[i]))
            entries.append(HalvesEntry(p.name, p.unit, one, other, float(sd[i]), freedom))
    return tuple(entries)
