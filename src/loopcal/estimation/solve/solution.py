"""Where a fit ended: parameters, the state of the merit there, and the parameter system."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from loopcal.estimation.solve.merit import Evaluation, State
from loopcal.estimation.solve.reduction import Accumulator, Spectrum
from loopcal.estimation.solve.status import Status

Array = NDArray[np.float64]
Other = TypeVar("Other")


@dataclass(frozen=True)
class End(Generic[State]):
    """Where a fit ended.

    parameters: (n_all,) [SI]; state: of the merit, with loops closed there; sums: over all poses;
    spectrum: of data and prior; prior_square: (p - nominal)^2 over prior variance, summed; status.
    """

    parameters: Array
    state: State
    sums: Evaluation[None]
    spectrum: Spectrum
    prior_square: float
    status: Status

    def with_state(self, state: Other) -> End[Other]:
        """The same end, with the state of another merit."""
        return End(self.parameters, state, self.sums, self.spectrum, self.prior_square, self.status)

    @property
    def corrections(self: End[Array]) -> Array:
        """Of poses in memory: the corrections (k, N) [SI] that close the loops."""
        return self.state

    @property
    def data(self) -> Accumulator:
        """The parameter system of all poses, without the prior."""
        return self.sums.data

    @property
    def cost(self) -> float:
        """The loss summed over all poses."""
        return self.sums.cost

    @property
    def equations(self) -> int:
        """Loop equations of all poses, less the unmeasured quantities they determine."""
        return self.sums.equations

    @property
    def poses(self) -> int:
        """How many poses were used."""
        return self.sums.poses

    @property
    def chi_squared(self) -> float:
        """The merit: corrections, or what the loss makes of them, and prior together."""
        return self.cost + self.prior_square


Solution = End[Array]
"""Where a fit of poses in memory ended."""
