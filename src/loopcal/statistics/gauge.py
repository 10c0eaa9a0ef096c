"""Which changes of the parameters only say where an instrument saw the machine stand.

Moving the instrument moves all points rigidly and leaves the machine what it is. To first order
the parameters then change along six directions (three in a plane), the gauge of the calibration.
They are told by the mechanism's placement, differentiated by central differences; parameters
that turn by a full turn are the same.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np

from loopcal.arrays import Array
from loopcal.mechanisms.mechanism import Mechanism

_STEP = 1e-4
"""Of central differences [m, rad]: their own error is its square, rounding's its inverse."""


def values_of(mechanism: Mechanism) -> Array:
    """The nominal values (n_all,) [SI]."""
    return np.array([p.nominal for p in mechanism.parameters])


def difference(mechanism: Mechanism, a: Array, b: Array) -> Array:
    """b - a (n_all,), angles within half a turn."""
    turns = np.array([p.unit == "rad" for p in mechanism.parameters])
    plain = b - a
    return np.where(turns, plain - 2.0 * math.pi * np.round(plain / (2.0 * math.pi)), plain)


def moved(mechanism: Mechanism, values: Array, rotation: Array, shift: Array) -> Array:
    """The parameters (n_all,) of the machine moved by p -> rotation @ p + shift."""
    assert mechanism.placement is not None
    names = mechanism.parameters.names
    by_name: Mapping[str, float] = dict(zip(names, values.tolist(), strict=True))
    moved_values = mechanism.placement.moved(by_name, rotation, shift)
    return np.array([moved_values[name] for name in names])


def gauge(mechanism: Mechanism, values: Array, centre: Array) -> Array:
    """How the parameters change when the machine turns about a point and shifts: (n_all, g).

    g: 6 in space, 3 in a plane; (n_all, 0) for a mechanism that cannot say.
    """
    if mechanism.placement is None:
        return np.zeros((len(values), 0))
    columns = []
    for turn, shift in _motions(len(centre)):
        ends = []
        for side in (1.0, -1.0):
            R = rotation_by(side * _STEP * turn)
            ends.append(moved(mechanism, values, R, centre - R @ centre + side * _STEP * shift))
        columns.append(difference(mechanism, ends[1], ends[0]) / (2.0 * _STEP))
    return np.array(columns).T


def carried(mechanism: Mechanism, values: Array, rotation: Array, shift: Array) -> Array:
    """How the parameters of the moved machine change with its own: (n_all, n_all)."""
    return changes(mechanism, lambda p: moved(mechanism, p, rotation, shift), values)


def changes(mechanism: Mechanism, of: Callable[[Array], Array], values: Array) -> Array:
    """How parameters of a mechanism, made of values (n,), change with these: (n_all, n)."""
    columns = []
    for step in _STEP * np.eye(len(values)):
        ends = [of(values + side * step) for side in (1.0, -1.0)]
        columns.append(difference(mechanism, ends[1], ends[0]) / (2.0 * _STEP))
    return np.array(columns).T


def _motions(d: int) -> list[tuple[Array, Array]]:
    """Unit turns and unit shifts, the turns as vectors (one number in a plane)."""
    turns = 1 if d == 2 else 3
    return [(turn, np.zeros(d)) for turn in np.eye(turns)] + [
        (np.zeros(turns), shift) for shift in np.eye(d)
    ]


def rotation_by(turn: Array) -> Array:
    """The rotation by a vector (3,), or by an angle (1,) in a plane (Rodrigues)."""
    angle = float(np.linalg.norm(turn))
    if len(turn) == 1:
        c, s = math.cos(turn[0]), math.sin(turn[0])
        return np.array([[c, -s], [s, c]])
    if angle == 0.0:
        return np.eye(3)
    x, y, z = turn / angle
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + math.sin(angle) * K + (1.0 - math.cos(angle)) * K @ K)
