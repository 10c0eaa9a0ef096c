"""How far outputs and loops are off: distances and loop values, summed up."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Closure:
    """Size of the loop equations' values [SI] over all poses."""

    rms: float
    max: float

    @classmethod
    def of(cls, residuals: Mapping[str, Array]) -> Closure:
        """From the values of the loops that hold, loop -> (N,)."""
        values = np.array(list(residuals.values()))
        values = values[np.isfinite(values)]
        return cls(float(np.sqrt(np.square(values).mean())), float(np.abs(values).max()))


@dataclass(frozen=True)
class Accuracy:
    """Distances between computed and measured outputs [unit] where both are there.

    The computed output comes from the other readings alone, without corrections.
    """

    unit: str
    mean: float
    rms: float
    p95: float
    max: float
    poses: int

    @classmethod
    def of(cls, distances: Array, unit: str) -> Accuracy | None:
        """From distances of any shape; missing ones (NaN) do not count."""
        distances = distances[np.isfinite(distances)]
        if not distances.size:
            return None
        return cls(
            unit,
            float(distances.mean()),
            float(np.sqrt(np.square(distances).mean())),
            float(np.percentile(distances, 95)),
            float(distances.max()),
            int(distances.size),
        )
