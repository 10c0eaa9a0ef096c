"""Where the driven quantities of a simulation stand: on a grid, or anywhere within ranges."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from loopcal.arrays import Array
from loopcal.errors import InputError
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.instruments.orientation import Orientation
from loopcal.mechanisms.mechanism import Mechanism


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


# Orientations as an instrument would measure them, from where the loops say the body is turned.

_PARALLEL = np.array([[1.0], [0.0], [0.0], [0.0]])
"""The quaternion of no turn at all, for every pose."""


def unstated_orientations(mechanism: Mechanism, driven: Dataset) -> list[Orientation]:
    """The orientations of which nothing is given: they are to be simulated."""
    return [
        o for o in mechanism.orientations if not set(o.columns) & {*driven.readings, *driven.sds}
    ]


def parallel(orientations: list[Orientation], poses: int) -> dict[str, Array]:
    """Constants (N,) of targets that are not turned at all, beside which turns are measured."""
    return {
        name: np.full(poses, values[0])
        for orientation in orientations
        for name, values in orientation.written(_PARALLEL).items()
    }


@dataclass(frozen=True)
class Measured:
    """Columns (N,) of an orientation as read, and what it is truly off by, off (3, N) [rad]."""

    columns: Mapping[str, Array]
    off: Array


def measured(orientation: Orientation, turns: Array, noise: Array) -> Measured:
    """The orientation as it is read where the truth is turned by `turns`.

    turns: (3, N), 2 tan(theta/2) u beside no turn at all; noise: (3, N) [rad] in the target's own
    frame, NaN where it is not read.
    """
    lost = np.isnan(noise).any(axis=0)
    # Noise in the target's frame is a turn ahead of the true one: R_read = R_true R_noise.
    read = _product(_quaternions(turns), _quaternions(np.where(lost, 0.0, noise)))
    columns = {n: np.where(lost, np.nan, v) for n, v in orientation.written(read).items()}
    return Measured(columns, np.where(lost, 0.0, -noise))


def _quaternions(turns: Array) -> Array:
    q = np.vstack([np.ones(turns.shape[1]), 0.5 * turns])
    unit: Array = q / np.linalg.norm(q, axis=0)
    return unit


def _product(a: Array, b: Array) -> Array:
    """Quaternions (4, N) of the turn b followed, in the fixed frame, by a."""
    scalar = a[0] * b[0] - (a[1:] * b[1:]).sum(axis=0)
    along = a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:], axis=0)
    return np.vstack([scalar, along])
