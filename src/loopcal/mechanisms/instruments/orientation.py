"""Measured orientations as their files write them: quaternions, rotation vectors, angles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from loopcal.errors import InputError
from loopcal.expressions.vectors import rotate, vector
from loopcal.mechanisms.frame import Values, Vector

FORMS = {"quaternion": ("qw", "qx", "qy", "qz"), "rotation-vector": ("rvx", "rvy", "rvz")}
"""Forms of one kind only, with the names of their numbers where none are given."""
_AXES = ("rx", "ry", "rz")
_NEVER_ZERO = 1e-300
"""Added to a squared angle [rad^2]: far below rounding, and no angle is divided by zero."""


@dataclass(frozen=True)
class Orientation:
    """R_station_target of each pose, from constants that its file holds.

    form: "quaternion", w first, of any length but zero; "rotation-vector", the axis times the
    angle [rad], as the controllers of Universal Robots write it; or a sequence of three turns
    about moving axes such as "rz ry rx" for Rz(a) Ry(b) Rx(c). columns: names of the numbers.
    """

    form: str
    columns: tuple[str, ...]

    @classmethod
    def of(cls, form: str, columns: Sequence[str] | None = None) -> Orientation:
        """The form with its columns; those of a sequence are named like its turns.

        Raises InputError for a form that is none, and for columns that are not as many.
        """
        if form in FORMS:
            usual = FORMS[form]
        else:
            usual = tuple(form.split())
            turns = len(usual) == 3 and set(usual) <= set(_AXES)
            if not turns or usual[0] == usual[1] or usual[1] == usual[2]:
                raise InputError(
                    f"{form!r} is no way to write an orientation",
                    remedy='give "quaternion", "rotation-vector" or three turns about moving '
                    'axes, no two alike in a row, say "rz ry rx" for Rz Ry Rx',
                )
            if len(set(usual)) < 3 and columns is None:
                usual = tuple(f"{turn}_{i}" for i, turn in enumerate(usual, 1))
        names = usual if columns is None else tuple(columns)
        if len(names) != len(usual):
            raise InputError(
                f"{len(names)} columns are named for the orientation {form!r}",
                remedy=f"name {len(usual)}",
            )
        return cls(form, names)

    @property
    def units(self) -> dict[str, str]:
        """SI units of the columns."""
        return dict.fromkeys(self.columns, "1" if self.form == "quaternion" else "rad")

    @property
    def description(self) -> dict[str, str | list[str]]:
        """What a mechanism file says of it."""
        return {"orientation": self.form, "columns": list(self.columns)}

    def axes(self, known: Values) -> list[Vector]:
        """The columns of R_station_target: the target's axes, (3,) each."""
        given = [known[name] for name in self.columns]
        units = [vector(*row) for row in np.eye(3).tolist()]
        if self.form == "quaternion":
            return _of_quaternion(*given)
        if self.form == "rotation-vector":
            return _of_quaternion(*_quaternion(*given))
        for turn, angle in zip(reversed(self.form.split()), reversed(given), strict=True):
            units = [rotate(turn[1], angle, unit) for unit in units]
        return units


def _quaternion(x: Any, y: Any, z: Any) -> tuple[Any, Any, Any, Any]:
    """Of a rotation vector: cos(t/2), and sin(t/2) along it."""
    angle = np.sqrt(x * x + y * y + z * z + _NEVER_ZERO)
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
