"""The [verdict] table of a project: tolerance, working region, and what is required."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from loopcal.errors import InputError, nearest
from loopcal.files.machines.parameter_entries import in_si
from loopcal.files.toml.place import Place
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.outputs import distance_unit

if TYPE_CHECKING:
    from loopcal.files.project.project_schema import SpanEntry, VerdictEntry
    from loopcal.files.project.simulation_entries import SimulationSpec


@dataclass(frozen=True)
class VerdictSpec:
    """tolerance [SI]; region: reading -> range [SI] in which the machine works; require: questions
    that must be answered with yes."""

    tolerance: float | None = None
    region: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    require: tuple[str, ...] = ()


def verdict_spec(
    entry: VerdictEntry, mechanism: Mechanism, simulation: SimulationSpec | None, place: Place
) -> VerdictSpec:
    """What the verdict judges; without a region the ranges of the simulation are it.

    Raises InputError for names, units and ranges that do not fit the mechanism.
    """
    tolerance = None
    if entry.tolerance is not None:
        unit = distance_unit(mechanism)
        at = place.at("tolerance", "unit")
        tolerance = in_si(entry.tolerance.value, entry.tolerance.unit, unit, at)
        if not tolerance > 0.0:
            raise InputError(
                f"the tolerance is {entry.tolerance.value:g}",
                code="invalid-value",
                place=str(place.at("tolerance")),
                remedy="give a distance above zero",
            )
    region = _region(entry, mechanism, place.at("region"))
    if not region and simulation is not None:
        region = {
            name: (span.start, span.start + (span.step or 0.0) * (span.count - 1))
            if span.step
            else (span.start, span.stop)
            for name, span in simulation.ranges.items()
        }
    return VerdictSpec(tolerance, region, tuple(entry.require))


def spans(
    entries: Mapping[str, SpanEntry], units: Mapping[str, str], place: Place
) -> dict[str, tuple[float, float]]:
    """Ranges [SI] of readings with these SI units.

    Raises InputError for other names, and for a range that is none.
    """
    found = {}
    for name, span in entries.items():
        here = place.at(name)
        if name not in units:
            raise InputError(
                f"{name!r} is no reading that drives the mechanism",
                code="unknown-name",
                place=str(here),
                remedy=nearest(name, units),
            )
        found[name] = one_span(span, units[name], here)
    return found


def one_span(span: SpanEntry, si: str, place: Place) -> tuple[float, float]:
    """A range [SI]. Raises InputError unless it goes from a number to a larger one."""
    if not span.from_ < span.to:
        raise InputError(
            f"the range goes from {span.from_:g} to {span.to:g}",
            code="invalid-value",
            place=str(place),
            remedy="give the smaller number first",
        )
    at = place.at("unit")
    return in_si(span.from_, span.unit, si, at), in_si(span.to, span.unit, si, at)


def _region(
    entry: VerdictEntry, mechanism: Mechanism, place: Place
) -> dict[str, tuple[float, float]]:
    units = mechanism.quantities
    return spans(
        entry.region, {q: u for q, u in units.items() if q not in mechanism.outputs}, place
    )
