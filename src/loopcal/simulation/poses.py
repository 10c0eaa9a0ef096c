"""Where the driven quantities of a simulation stand: on a grid, or anywhere within ranges."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from loopcal.errors import InputError

Array = NDArray[np.float64]


def grid_poses(values: Mapping[str, ArrayLike]) -> dict[str, Array]:
    """Every combination of the values of each quantity, the last one changing fastest.

    >>> grid_poses({"phi2": [0.0, 1.0], "phi3": [5.0, 6.0]})["phi3"]
    array([5., 6., 5., 6.])
    """
    axes = np.meshgrid(*(np.asarray(v, dtype=float) for v in values.values()), indexing="ij")
    return {name: axis.ravel() for name, axis in zip(values, axes, strict=True)}


def random_poses(
    ranges: Mapping[str, tuple[float, float]], number: int, *, seed: int
) -> dict[str, Array]:
    """So many poses, each quantity uniform and independent within its range [SI].

    The same seed gives the same poses, and a simulation with that seed draws its noise apart
    from them. Raises InputError for a range that is not one.
    """
    if number < 1:
        raise InputError(
            f"{number} poses are requested",
            code="invalid-value",
            remedy="request at least one pose",
        )
    for name, (low, high) in ranges.items():
        if not (math.isfinite(low) and math.isfinite(high) and low <= high):
            raise InputError(
                f"the range of {name!r} goes from {low:.6g} to {high:.6g}",
                code="invalid-value",
                remedy="give two finite numbers, the smaller one first",
            )
    draws = stream(seed, "poses").random((len(ranges), number))
    return {
        name: low + (high - low) * draw
        for (name, (low, high)), draw in zip(ranges.items(), draws, strict=True)
    }


STREAMS = ("poses", "noise", "machine")


def stream(seed: int, use: str) -> np.random.Generator:
    """The random numbers of one use of a seed: PCG64, one independent stream for each.

    use: "poses", "noise", or "machine" for deviations of the true parameters from nominal.
    Raises InputError unless the seed is a whole number from 0 on.
    """
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise InputError(
            f"the seed is {seed!r}", code="invalid-value", remedy="give a whole number, 0 or more"
        )
    # Spawned streams are independent: another number of poses leaves the noise as it is.
    children = np.random.SeedSequence(int(seed)).spawn(len(STREAMS))
    return np.random.Generator(np.random.PCG64(children[STREAMS.index(use)]))
