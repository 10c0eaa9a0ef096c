"""What mechanism files of all types share: units, numbers with units, parameters."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from loopcal.files.toml.model import Finite, Model, Sd, UnitName, complaint, plain_number_as
from loopcal.units import unit


def _of(dimension: str) -> AfterValidator:
    def check(name: str) -> str:
        if unit(name).dimension != dimension:
            words = f"{name!r} is a unit of {unit(name).dimension}"
            raise complaint(words, f"give a unit of {dimension}")
        return name

    return AfterValidator(check)


class Units(Model):
    """Units of the numbers that state none; without them m and rad."""

    length: Annotated[UnitName, _of("length")] | None = None
    angle: Annotated[UnitName, _of("angle")] | None = None

    def by_dimension(self) -> dict[str, str]:
        """Dimension -> name of its unit, for those stated."""
        both = {"length": self.length, "angle": self.angle}
        return {dimension: name for dimension, name in both.items() if name is not None}


class Value(Model):
    """A number with its unit."""

    value: Finite
    unit: UnitName | None = None


Amount = Annotated[Value, plain_number_as("value")]
Motion = Literal["tx", "ty", "tz", "rx", "ry", "rz"]
Motions = Annotated[
    dict[Motion, Amount],
    Field(
        description="Fixed, exactly known motions in the order of writing: displacements along "
        "x, y, z and turns about them.",
        examples=[{"rz": 90, "tx": 0.1}],
    ),
]


class ParameterEntry(Model):
    """What is known of a parameter: nominal value, how well it is known, whether it is fixed."""

    value: Finite | None = None
    unit: UnitName | None = Field(default=None, description="Of the value and of the sd.")
    sd: Sd | None = Field(
        default=None, description="Prior sd: how well the value is known; inf: not at all."
    )
    fixed: bool | None = Field(default=None, description="true: not estimated.")


ParameterEntries = Annotated[
    dict[str, Annotated[ParameterEntry, plain_number_as("value")]],
    Field(
        description="Parameters by name or glob; later lines win.",
        examples=[{"alpha_*": {"fixed": True}, "d_1": {"sd": 1.0, "unit": "mm"}}],
    ),
]
