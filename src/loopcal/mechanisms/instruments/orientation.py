"""Measured orientations as their files write them: quaternions, rotation vectors, angles."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.errors import InputError
from loopcal.expressions.vectors import dot, rotate, vector
from loopcal.mechanisms.frame import Values, Vector

FORMS = {"quaternion": ("qw", "qx", "qy", "qz"), "rotation-vector": ("rvx", "rvy", "rvz")}
"""Forms of one kind only, with the names of their numbers where none are given."""
_AXES = ("rx", "ry", "rz")
_NEVER_ZERO = 1e-300
"""Added to a squared angle [rad^2]: far below rounding, and no angle is divided by zero."""
_NO_DIRECTION = 1e-6
"""Rounded to some digits, a quaternion is about 1 long; one as short as this says nothing."""


@dataclass(frozen=True)
class Orientation:
    """R_station_target of each pose, from constants that its file holds.

    form: "quaternion", w first, of any length but zero; "rotation-vector", the axis times the
    angle [rad], as the controllers of Universal Robots write it; or a sequence of three turns
    about moving axes such as "rz ry rx" for Rz(a) Ry(b) Rx(c). columns: names of the numbers;
    turns: names of the three small turns that say how far it is off.
    """

    form: str
    columns: tuple[str, ...]
    turns: tuple[str, ...]

    @classmethod
    def of(cls, form: str, columns: Sequence[str] | None, turns: Sequence[str]) -> Orientation:
        """The orientation of a form; without `columns`, those of a sequence are named as its turns.

        Raises InputError for an unknown form, and for another number of columns than it has.
        """
        usual = FORMS.get(form) or tuple(form.split())
        if form not in FORMS:
            if len(usual) != 3 or not set(usual) <= {*_AXES} or usual[1] in usual[::2]:
                raise InputError(
                    f"{form!r} is not a form of orientation",
                    code="unknown-name",
                    remedy='give "quaternion", "rotation-vector" or three turns about moving '
                    'axes, no two alike in a row, say "rz ry rx" for Rz Ry Rx',
                )
            if usual[0] == usual[2]:
                usual = tuple(f"{turn}_{i}" for i, turn in enumerate(usual, 1))
        names = usual if columns is None else tuple(columns)
        if len(names) != len(usual):
            raise InputError(
                f"{len(names)} columns are named for the orientation {form!r}",
                code="wrong-shape",
                remedy=f"name {len(usual)}",
            )
        return cls(form, names, tuple(turns))

    @property
    def units(self) -> dict[str, str]:
        """SI units of the columns."""
        return dict.fromkeys(self.columns, "1" if self.form == "quaternion" else "rad")

    def axes(self, pose_constants: Values) -> list[Vector]:
        """The columns of R_station_target: the target's axes, (3,) each."""
        numbers = [pose_constants[name] for name in self.columns]
        if self.form == "quaternion":
            return _of_quaternion(*numbers)
        if self.form == "rotation-vector":
            return _of_quaternion(*_quaternion(*numbers))
        units = [vector(*row) for row in np.eye(3).tolist()]
        for turn, angle in zip(reversed(self.form.split()), reversed(numbers), strict=True):
            units = [rotate(turn[1], angle, unit) for unit in units]
        return units

    def senseless(self, pose_constants: Mapping[str, Array]) -> NDArray[np.intp]:
        """Positions of the poses whose numbers are no orientation: quaternions of zeros."""
        if self.form != "quaternion":
            return np.zeros(0, dtype=np.intp)
        length = np.sqrt(sum(np.square(pose_constants[name]) for name in self.columns))
        return np.flatnonzero(~(length > _NO_DIRECTION))

    def written(self, quaternions: Array) -> dict[str, Array]:
        """Columns (N,) [SI] that say what quaternions (4, N), w first, say."""
        from scipy.spatial.transform import Rotation

        turned = Rotation.from_quat(quaternions[[1, 2, 3, 0]].T)
        match self.form:
            case "quaternion":
                numbers = turned.as_quat()[:, [3, 0, 1, 2]]
            case "rotation-vector":
                numbers = turned.as_rotvec()
            case _:
                with warnings.catch_warnings():  # of gimbal lock, where any of the angles will do
                    warnings.simplefilter("ignore")
                    numbers = turned.as_euler("".join(t[1] for t in self.form.split()).upper())
        return dict(zip(self.columns, np.ascontiguousarray(numbers.T), strict=True))


def _quaternion(x: Any, y: Any, z: Any) -> tuple[Any, Any, Any, Any]:
    """Of a rotation vector: cos(t/2), and sin(t/2) along it."""
    angle = np.sqrt(x * x + y * y + z * z + _NEVER_ZERO)
    # sin(t/2) / t tends to 1/2 at 0: `_NEVER_ZERO` keeps the quotient finite there.
    part = np.sin(0.5 * angle) / angle
    return np.cos(0.5 * angle), part * x, part * y, part * z


def _of_quaternion(w: Any, x: Any, y: Any, z: Any) -> list[Vector]:
    """Columns of the rotation matrix of a quaternion of any length but zero."""
    s = 2.0 / (w * w + x * x + y * y + z * z)
    return [
        vector(1.0 - s * (y * y + z * z), s * (x * y + w * z), s * (x * z - w * y)),
        vector(s * (x * y - w * z), 1.0 - s * (x * x + z * z), s * (y * z + w * x)),
        vector(s * (x * z + w * y), s * (y * z - w * x), 1.0 - s * (x * x + y * y)),
    ]


def small_turns(measured: Sequence[Any], predicted: Sequence[Any]) -> list[Any]:
    """2 tan(theta/2) u of R_meas^T R_pred, from the columns of both."""
    M = [[dot(a, b) for b in predicted] for a in measured]
    # vee(M - M^T) = 2 sin(theta) u and tr M = 1 + 2 cos(theta); sin / (1 + cos) = tan(theta / 2).
    twice = 2.0 / (1.0 + M[0][0] + M[1][1] + M[2][2])
    return [twice * (M[j][i] - M[i][j]) for i, j in ((1, 2), (2, 0), (0, 1))]
