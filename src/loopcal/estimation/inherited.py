"""What an earlier calibration passes on to the update that begins from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loopcal.document.fit import NoiseEntry
from loopcal.document.terms import TermEntry
from loopcal.small_samples import LearntCovariance

Array = NDArray[np.float64]
UPDATED = "implicit loop, updated"
"""Label of the method, in the result of an update."""


@dataclass(frozen=True, eq=False)
class Inherited:
    """covariance: (n, n) [SI] what the estimated parameters gain, because the earlier covariance is
    larger than its information says (dependent residuals, learnt sds); terms: what it learnt of the
    model error; noise: the sds of sensors, empty where others were stated."""

    covariance: Array
    terms: tuple[TermEntry, ...]
    noise: tuple[NoiseEntry, ...]

    def added_to(self, covariance: LearntCovariance, S: Array | None = None) -> LearntCovariance:
        """The covariance of the estimated parameters with it, or that of S (N, m, n) times them."""
        wider = self.covariance if S is None else S @ self.covariance @ np.swapaxes(S, -1, -2)
        return covariance.plus(LearntCovariance(wider, 0.0 * wider, 0.0 * covariance.slopes))
