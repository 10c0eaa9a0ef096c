"""Orientations as an instrument would measure them, from where the loops say the body is turned."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.instruments.orientation import Orientation
from loopcal.mechanisms.mechanism import Mechanism

Array = NDArray[np.float64]
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
