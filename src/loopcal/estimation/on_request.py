"""What a result carries only where it was asked for: validation, intervals, rival models."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from loopcal.estimation.accuracy import Accuracy

if TYPE_CHECKING:
    from loopcal.estimation.result import Result

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


@dataclass(frozen=True, eq=False)
class ComparedModel:
    """One of several models of the same readings, judged by poses that it has not seen.

    effects: those beyond geometry that are switched on; fixed: parameters by names or globs that
    it does not estimate; parameters: how many it does; validation: None where a fit did not
    converge, with the reason in `failed`; behind: by how much its predictive log-likelihood is
    less than the best one's; sd: of that difference, from its scatter over the poses.
    """

    name: str
    effects: tuple[str, ...]
    fixed: tuple[str, ...]
    parameters: int
    validation: Validation | None
    behind: float | None = None
    sd: float | None = None
    failed: str = ""


@dataclass(frozen=True, eq=False)
class ModelComparison:
    """Models compared on the same poses; recommended: the simplest that the data do not refuse.

    result: the calibration of all poses with the recommended model.
    """

    models: tuple[ComparedModel, ...]
    recommended: str
    result: Result

    @property
    def words(self) -> str:
        """Why this model."""
        known = [m for m in self.models if m.behind is not None]
        best = next(m for m in known if m.behind == 0.0)
        if best.name != self.recommended:
            return (
                f"Recommended: {self.recommended}, the simplest of those that predict as well as "
                f"{best.name} within what chance explains."
            )
        if all(m is best or m.parameters >= best.parameters for m in known):
            return f"Recommended: {best.name}, which predicts best and is the simplest."
        return (
            f"Recommended: {best.name}, which predicts best; every simpler model is behind by more "
            "than chance explains."
        )

    def __str__(self) -> str:
        from loopcal.estimation.summary import model_table

        return "\n".join(model_table(self))
