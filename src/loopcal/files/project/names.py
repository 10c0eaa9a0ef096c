"""What the names in a project's tables may be: quantities and parameters of its mechanism."""

from __future__ import annotations

from collections.abc import Mapping

from loopcal.errors import InputError, nearest, unknown_name
from loopcal.files.toml.place import Names, Scope
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.outputs import distance_unit

QUANTITY = "quantity or known constant"
DRIVEN = "driven quantity"
RANGED = "driven quantity or known constant"
PARAMETER = "parameter"
DEVIATING = "parameter that may deviate"


def scope_of(mechanism: Mechanism) -> Scope:
    """The names of a mechanism, with their SI units; that of distances for what has no name."""
    units = mechanism.units
    names = {
        QUANTITY: _quantities(units),
        DRIVEN: _driven(mechanism, mechanism.quantities),
        RANGED: _driven(mechanism, units),
        PARAMETER: _parameters(mechanism),
        DEVIATING: _deviating(mechanism),
    }
    return Scope(names=names, si=distance_unit(mechanism))


def followers(mechanism: Mechanism) -> set[str]:
    """The quantities that no drive moves: the outputs, with the columns of whole orientations."""
    columns = {n for o in mechanism.orientations for n in (*o.columns, *o.turns)}
    return {*columns, *mechanism.outputs}


def _quantities(units: Mapping[str, str]) -> Names:
    def names(name: str) -> Mapping[str, str]:
        if name not in units:
            raise unknown_name(f"the mechanism has no quantity {name!r}", name, units)
        return {name: units[name]}

    return names


def _driven(mechanism: Mechanism, units: Mapping[str, str]) -> Names:
    follow = followers(mechanism)
    driven = [n for n in units if n not in follow and n not in mechanism.implied]

    def names(name: str) -> Mapping[str, str]:
        if name in units and name not in follow:
            return {name: units[name]}
        follows = "follows from the loops" if name in follow else "is no quantity"
        raise InputError(
            f"{name!r} {follows} of the mechanism",
            code="unknown-name",
            remedy=f"give the ranges of {', '.join(driven)}"
            if name in follow
            else nearest(name, driven),
        )

    return names


def _parameters(mechanism: Mechanism) -> Names:
    parameters = mechanism.parameters
    return lambda key: {name: parameters[name].unit for name in parameters.matching(key)}


def _deviating(mechanism: Mechanism) -> Names:
    def names(key: str) -> Mapping[str, str]:
        matching = [mechanism.parameters[name] for name in mechanism.parameters.matching(key)]
        if any(p.fixed and p.name == key for p in matching):
            raise InputError(
                f"{key!r} is fixed, so it cannot deviate",
                code="conflicting-keys",
                remedy="free it, or state its true value in [simulation.truth]",
            )
        return {p.name: p.unit for p in matching if not p.fixed}

    return names
