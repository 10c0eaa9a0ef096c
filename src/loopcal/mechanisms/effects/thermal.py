"""Thermal expansion: parameters that change with a temperature that is read in each pose."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any

from loopcal.errors import InputError
from loopcal.keys import Key
from loopcal.mechanisms.effects.effect import Name, meant
from loopcal.mechanisms.frame import Values
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parameters import Parameter
from loopcal.units import to_si, unit

SD = 1e-4
"""Prior sd of a coefficient [m/K or rad/K]: 4 m of aluminium grow by 0.09 mm per kelvin."""
EXPANSION = 24e-6
"""Prior sd of an expansion of all lengths [1/K]: that of aluminium; steel has half of it."""
Column = Annotated[str, Key("Name of the known constant: the temperature in each pose.")]
Reference = Annotated[
    float, Key("Temperature at which the parameters have their own values, in `unit`.")
]


@dataclass(frozen=True)
class Thermal:
    """Parameters that change with a temperature T: p' = p + P_thermal (T - reference).

    changing: parameters by names or globs: a length of a link, the zero of a joint; without any all
    lengths of the machine in proportion, p' = p (1 + NAME_expansion (T - reference)), by one
    coefficient [1/K]; column: the known constant T [K]; reference: where p' = p, by default 20 degC
    (ISO 1); unit: of reference, "degC" or "K". P_thermal is in the unit of P per kelvin, m/K or
    rad/K.

    Raises InputError for a unit of another dimension, and a parameter whose unit has no quotient.
    """

    changing: Annotated[
        tuple[str, ...],
        Key("Parameters by names or globs. Default: all lengths in proportion."),
    ] = ()
    column: Column = "temperature"
    reference: Reference = 20.0
    unit: Annotated[str, Key("Unit of reference, degC or K.", is_unit=True)] = "degC"
    name: Name = "thermal"

    def __post_init__(self) -> None:
        if unit(self.unit).si != "K" or not math.isfinite(self.reference):
            raise InputError(
                f"the reference of {self.name!r} is {self.reference:g} {self.unit}",
                code="invalid-value",
                remedy='give a temperature in "degC" or "K"',
            )

    def parameters(self, mechanism: Mechanism) -> dict[str, Parameter]:
        """P_thermal of each parameter, in its unit per kelvin; or one of all lengths."""
        if not self.changing:
            name = f"{self.name}_expansion"
            meaning = "expansion of all lengths"
            return {name: Parameter(name, 0.0, "1/K", EXPANSION, meaning=meaning)}
        return {
            (coefficient := f"{p.name}_thermal"): Parameter(
                coefficient, 0.0, unit(f"{p.unit}/K").si, SD, meaning=f"expansion of {p.name}"
            )
            for p in meant(mechanism, self.changing)
        }

    def pose_constants(self, mechanism: Mechanism) -> dict[str, str]:
        """The temperature."""
        return {self.column: "K"}

    def changed(self, mechanism: Mechanism, x: Values, p: Values) -> dict[str, Any]:
        """The parameters as they are at T."""
        warmer = x[self.column] - to_si(self.reference, self.unit)
        if not self.changing:
            grown = 1.0 + p[f"{self.name}_expansion"] * warmer
            lengths = [q for q in mechanism.parameters if q.dimension == "length"]
            return {q.name: p[q.name] * grown for q in lengths}
        names = [parameter.name for parameter in meant(mechanism, self.changing)]
        return {name: p[name] + p[f"{name}_thermal"] * warmer for name in names}
