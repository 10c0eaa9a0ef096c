"""The parameters that a fit estimates, and what the prior knowledge of them costs."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.lazy import cached_property


@dataclass(frozen=True)
class Unknowns:
    """The estimated among all parameters, in SI units.

    start: (n_all,) values to begin from; free: (n,) positions of the estimated ones; names: of
    these; nominal, prior_sd: (n,), sd inf where nothing is known.
    """

    start: Array
    free: NDArray[np.intp]
    names: tuple[str, ...]
    nominal: Array
    prior_sd: Array

    def without_prior(self) -> Unknowns:
        """The same with nothing known beforehand."""
        return replace(self, prior_sd=np.full(len(self.free), np.inf))

    def offset(self, parameters: Array) -> Array:
        """Nominal minus current values, (n,), of parameters (n_all,)."""
        return self.nominal - parameters[self.free]

    @cached_property
    def flat(self) -> bool:
        """Whether nothing is known of any parameter beforehand."""
        return not np.isfinite(self.prior_sd).any()

    def prior_square(self, parameters: Array) -> float:
        """The sum of (p - nominal)^2 / prior variance."""
        if self.flat:
            return 0.0
        off = self.offset(parameters) / self.prior_sd
        return float(off @ off)

    def moved(self, parameters: Array, step: Array) -> Array:
        """Parameters (n_all,) after a step (n,) of the estimated ones."""
        after = parameters.copy()
        after[self.free] += step
        return after
