"""The [[effect]] tables of a mechanism file, put into the mechanism that the rest describes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from loopcal.errors import InputError
from loopcal.files.machines.parameter_entries import in_si
from loopcal.files.toml.place import Place
from loopcal.mechanisms.effects.backlash import Backlash
from loopcal.mechanisms.effects.compliance import Compliance
from loopcal.mechanisms.effects.drift import Drift, Shift
from loopcal.mechanisms.effects.effect import Effect, with_effects
from loopcal.mechanisms.effects.gravity import Load
from loopcal.mechanisms.effects.harmonics import Harmonics
from loopcal.mechanisms.effects.scale import Scale
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.units import unit

if TYPE_CHECKING:
    from loopcal.files.machines import effect_schema as schema

Units = Mapping[str, str]


def affected(
    mechanism: Mechanism, entries: Sequence[schema.AnyEffect], units: Units, place: Place
) -> Mechanism:
    """The mechanism with the effects of these tables.

    units: dimension -> unit of numbers that state none. Raises InputError at the table that does
    not fit.
    """
    effects: list[Effect] = []
    for i, entry in enumerate(entries):
        here = place.at(i)
        try:
            effects.append(_MAKERS[entry.type](entry, units, here))
            made = with_effects(mechanism, effects)
        except InputError as error:
            raise error if error.place else error.at(str(here)) from None
    return made if effects else mechanism


def needed(
    mechanism: Mechanism, entries: Sequence[schema.AnyEffect], units: Units, place: Place
) -> set[str]:
    """Names of the parameters and known constants that the effects of these tables bring."""
    made = [_MAKERS[e.type](e, units, place.at(i)) for i, e in enumerate(entries)]
    brought = [{*e.parameters(mechanism), *e.known(mechanism)} for e in made]
    return set().union(*brought) - {*mechanism.known}


def _harmonics(entry: schema.HarmonicsEffect, units: Units, place: Place) -> Harmonics:
    orders = tuple(float(k) for k in entry.orders)
    return Harmonics(tuple(entry.joints), orders, entry.name)


def _scale(entry: schema.ScaleEffect, units: Units, place: Place) -> Scale:
    return Scale(tuple(entry.joints), entry.name)


def _compliance(entry: schema.ComplianceEffect, units: Units, place: Place) -> Compliance:
    loads = [_load(load, units, place.at("loads", i)) for i, load in enumerate(entry.loads)]
    x, y, z = map(float, entry.gravity)
    return Compliance(tuple(loads), tuple(entry.yielding), (x, y, z), entry.name)


def _load(entry: schema.LoadEntry, units: Units, place: Place) -> Load:
    point, mass = (0.0, 0.0, 0.0), None
    if entry.point is not None:
        here = place.at("point")
        x, y, z = (float(in_si(v.value, v.unit, "m", here, units)) for v in entry.point)
        point = (x, y, z)
    if entry.mass is not None:
        mass = float(in_si(entry.mass.value, entry.mass.unit, "kg", place.at("mass")))
    return Load(entry.name, entry.joint, point, mass)


def _backlash(entry: schema.BacklashEffect, units: Units, place: Place) -> Backlash:
    return Backlash(tuple(entry.joints), entry.direction, entry.name)


def _drift(entry: schema.DriftEffect, units: Units, place: Place) -> Drift:
    its = unit(entry.unit)
    since, over = (float(v) * its.factor for v in (entry.since, entry.over))
    return Drift(tuple(entry.changing), entry.column, its.si, since, over, entry.name)


def _shift(entry: schema.ShiftEffect, units: Units, place: Place) -> Shift:
    its = unit(entry.unit)
    at = tuple(float(v) * its.factor for v in entry.at)
    return Shift(tuple(entry.changing), at, entry.column, its.si, entry.name)


_MAKERS: dict[str, Callable[[Any, Units, Place], Effect]] = {
    "harmonics": _harmonics,
    "scale": _scale,
    "compliance": _compliance,
    "backlash": _backlash,
    "drift": _drift,
    "shift": _shift,
}
