"""What a block kernel gives: corrections, and the equations in the parameters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loopcal.lazy import cached_property

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Reduced:
    """A block of b poses, linearised at readings + corrections and reduced.

    correction: (k, b) new corrections with these parameters held [SI]; step: (b,) the longest
    move to them in sds; singular: (b,) poses whose loops cannot close; rows: (n + 1, r, b), the n
    columns of D and last E, or total: (n + 1, n + 1), their products summed over loops and poses.
    rows are overwritten by the next block.
    """

    correction: Array
    step: Array
    singular: NDArray[np.bool_]
    rows: Array | None = None
    total: Array | None = None

    @property
    def E(self) -> Array:
        """Whitened misclosure, (r, b)."""
        assert self.rows is not None
        part: Array = self.rows[-1]
        return part


@dataclass(frozen=True)
class Closed:
    """Corrections (k, b) [SI], and the poses (b,) that did not settle.

    step: the largest last step in sds; contraction: the worst ratio of a step to the one before,
    0 where there was none before; evaluations: of the loops, summed over poses.
    """

    corrections: Array
    open: NDArray[np.bool_]
    step: float = np.inf
    contraction: float = 0.0
    evaluations: int = 0

    @cached_property
    def failed(self) -> bool:
        """Whether any pose did not settle."""
        return bool(self.open.any())
