"""Which poses a figure shows where there are more than an eye, or a browser, can take."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# Markers that a browser draws without delay.
POINTS = 2000
LARGEST = 50
"""How many of the poses shown are those where the figure is largest."""


@dataclass(frozen=True, eq=False)
class Thinned:
    """index: (k,) poses to show, in order; words: what was left out, "" where nothing was."""

    index: NDArray[np.intp]
    words: str


def thinned(sizes: NDArray[np.float64], most: int = POINTS) -> Thinned:
    """At most `most` of the poses with sizes (N,): evenly chosen, and the largest; NaN are none."""
    usable = np.flatnonzero(np.isfinite(sizes))
    if usable.size <= most:
        return Thinned(usable, "")
    largest = min(LARGEST, most // 2)
    even = usable[np.linspace(0, usable.size - 1, most - largest).astype(np.intp)]
    top = usable[np.argsort(np.abs(sizes[usable]))[-largest:]]
    index = np.union1d(even, top)
    return Thinned(
        index,
        f" Shown are {index.size:,} of {usable.size:,} poses, evenly chosen, with the "
        f"{largest} largest among them; all numbers of this report come from all poses.",
    )
