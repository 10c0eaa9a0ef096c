"""What an earlier calibration passes on to the update that begins from it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from loopcal.arrays import Array
from loopcal.document.choice import TermEntry
from loopcal.document.fit import NoiseEntry
from loopcal.small_samples import LearntCovariance


@dataclass(frozen=True, eq=False)
class Inherited:
    """covariance: (n, n) [SI] what the estimated parameters gain, because the earlier covariance is
    larger than its information says (dependent residuals, learnt sds); terms: what it learnt of the
    model error; noise: the sds of sensors, empty where others were stated; conditions: in which it
    was measured, as `FitResult.conditions`."""

    covariance: Array
    terms: tuple[TermEntry, ...]
    noise: tuple[NoiseEntry, ...]
    conditions: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def added_to(self, covariance: LearntCovariance, S: Array | None = None) -> LearntCovariance:
        """The covariance of the estimated parameters with it, or that of S (N, m, n) times them."""
        wider = self.covariance if S is None else S @ self.covariance @ np.swapaxes(S, -1, -2)
        # Errors of the sds, along which the parameters' covariance is taken as known.
        errors = max((len(entry.slopes) for entry in self.noise), default=0)
        slopes = np.zeros((errors, *wider.shape))
        return LearntCovariance(covariance.matrix + wider, covariance.plain, slopes)
