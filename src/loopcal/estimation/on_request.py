"""What a result carries only where it was asked for: validation and confidence intervals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from loopcal.estimation.result import Accuracy

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Validation:
    """How well poses were predicted that took no part in the fit.

    scheme: what was left out, as asked; words: the same for the reader; accuracy: of the outputs
    computed from the other readings, over all poses left out, None where no pose has both;
    log_likelihood: sum over these poses of log N(misclosure; 0, W + D Cov_p D^T) in the units of
    the loop equations, None where the method has no distribution for it; by_pose: (N,) its
    terms, distances: (N,) between computed and measured outputs, both in the order of `poses`.
    """

    scheme: Mapping[str, Any]
    words: str
    accuracy: Accuracy | None
    log_likelihood: float | None
    poses: tuple[str, ...] = ()
    distances: Array | None = None
    by_pose: Array | None = None


@dataclass(frozen=True)
class Interval:
    """Confidence interval of a parameter [SI] at a level, from the covariance and by profile.

    profile_low, profile_high: where chi-squared, minimised over all other parameters, has risen
    to its limit; None where it never does. differs: whether an end of the two differs by more
    than a tenth of the half width: the parameter acts nonlinearly within its own uncertainty.
    """

    level: float
    low: float
    high: float
    profile_low: float | None
    profile_high: float | None
    differs: bool
