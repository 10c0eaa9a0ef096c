"""Other ways to read poses of the flange, by the words under which a project keeps them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

import numpy as np

from loopcal.arrays import Array
from loopcal.mechanisms.placement import inverse

UNITS = {
    1000.0: "mm",
    100.0: "cm",
    1.0 / 0.0254: "inches",
}
"""How many of a unit one metre has."""
INVERTED, TRANSPOSED = "inverted", "rotations transposed"


def quaternions_in(order: str) -> str:
    return f"quaternions in the order {order}"


def positions_in(unit: str, *, converted: bool) -> str:
    """Positions in a unit, or in metres that were converted from it once too often."""
    return f"positions converted from {unit}" if converted else f"positions in {unit}"


QUATERNIONS = {"x, y, z, w": (3, 0, 1, 2), "w, x, y, z": (1, 2, 3, 0)}
"""Which element of a quaternion that was read stands where, by the order in which they fit."""


def _transposed(T: Array) -> Array:
    T = T.copy()
    T[:, :3, :3] = np.swapaxes(T[:, :3, :3], 1, 2)
    return T


def _requaternioned(order: tuple[int, ...]) -> Callable[[Array], Array]:
    """The rotations whose quaternions have the elements of those of T in another order."""

    def change(T: Array) -> Array:
        from scipy.spatial.transform import Rotation

        T = T.copy()
        q = Rotation.from_matrix(T[:, :3, :3]).as_quat()
        T[:, :3, :3] = Rotation.from_quat(q[:, list(order)]).as_matrix()
        return T

    return change


def _longer(factor: float) -> Callable[[Array], Array]:
    def change(T: Array) -> Array:
        T = T.copy()
        T[:, :3, 3] *= factor
        return T

    return change


POSITIONS: Mapping[str, Callable[[Array], Array]] = {
    **{positions_in(unit, converted=False): _longer(1.0 / k) for k, unit in UNITS.items()},
    **{positions_in(unit, converted=True): _longer(k) for k, unit in UNITS.items()},
}
CHANGES: Mapping[str, Callable[[Array], Array]] = {
    INVERTED: inverse,
    TRANSPOSED: _transposed,
    **{quaternions_in(name): _requaternioned(order) for name, order in QUATERNIONS.items()},
    **POSITIONS,
}


def changed(T: Array, ways: Mapping[str, Array], words: Iterable[str]) -> Array:
    """Poses (n, 4, 4) read as these words say, in their order: names of changes, and of ways to
    read the turns of this file."""
    for word in words:
        T = CHANGES[word](T) if word in CHANGES else ways.get(word, T)
    return T
