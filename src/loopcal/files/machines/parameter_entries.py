"""Parameters as files speak of them: by name or glob, each number with a unit that must fit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from typing import Annotated, Any

from loopcal.errors import InputError, placed
from loopcal.files.toml.place import Place
from loopcal.keys import Key
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parameters import Parameter, Parameters
from loopcal.mechanisms.prior import ESTIMATES, check_estimate
from loopcal.mechanisms.terms import stated_terms
from loopcal.units import unit

NO_UNITS: Mapping[str, str] = {}


@dataclass(frozen=True)
class Units:
    """Units of the numbers that state none; without them m and rad."""

    length: Annotated[str | None, Key("Of lengths.", is_unit="length")] = None
    angle: Annotated[str | None, Key("Of angles.", is_unit="angle")] = None


def by_dimension(units: Units) -> dict[str, str]:
    """Dimension -> name of its unit, for those stated."""
    both = {"length": units.length, "angle": units.angle}
    return {dimension: name for dimension, name in both.items() if name is not None}


@dataclass(frozen=True)
class StatedParameter:
    """What is known of a parameter: nominal value, how well it is known, whether it is fixed."""

    value: Annotated[float | None, Key("Nominal value.", alone=True)] = None
    unit: Annotated[str | None, Key("Of the value and of the sd.", is_unit=True)] = None
    sd: Annotated[
        float | None, Key("Prior sd: how well the value is known; inf: not at all.", sd=True)
    ] = None
    fixed: Annotated[bool | None, Key("true: not estimated.")] = None


PARAMETERS = Key(
    "Parameters by name or glob; later lines win.",
    example={"alpha_*": {"fixed": True}, "d_1": {"sd": 1.0, "unit": "mm"}},
)


def in_si(
    number: float,
    stated: str | None,
    si: str,
    place: Place,
    units: Mapping[str, str] = NO_UNITS,
    *,
    difference: bool = False,
) -> float:
    """A number in its stated unit, in the file's unit of that dimension, or in SI, as SI value.

    si: the unit that is expected; units: dimension -> the file's unit. difference: the number is
    an sd, a step or a span, which has no zero. A number that is SI already comes back as it is,
    bit for bit. Raises InputError for a unit of another dimension.
    """
    expected = unit(si)
    stated_unit = unit(stated or units.get(expected.dimension, si))
    if stated_unit.dimension != expected.dimension:
        raise InputError(
            f"{stated_unit.name} is a unit of {stated_unit.dimension}, but this needs "
            f"{expected.dimension} ({expected.si})",
            code="wrong-unit",
            place=str(place),
            remedy=f"give a unit of {expected.dimension}, or none for {expected.si}",
        )
    value = number if stated_unit.factor == 1.0 else number * stated_unit.factor
    return value if difference or not stated_unit.zero else value + stated_unit.zero


@dataclass(frozen=True)
class Amount:
    """A number with its unit."""

    value: Annotated[float, Key("The number.", alone=True)]
    unit: Annotated[str | None, Key("Of the number.", is_unit=True)] = None


Home = Annotated[
    Mapping[str, Amount],
    Key(
        "Usual values of unread quantities, at which the search for them begins.",
        example={"platform_z": {"value": 700, "unit": "mm"}},
    ),
]


def home_in_si(
    home: Mapping[str, Amount],
    quantities: Mapping[str, str],
    place: Place,
    units: Mapping[str, str] = NO_UNITS,
) -> dict[str, float]:
    """Quantity -> usual value [SI]; what is no quantity of the machine stays as stated."""
    return {
        name: in_si(amount.value, amount.unit, quantities[name], place.at(name), units)
        if name in quantities
        else amount.value
        for name, amount in home.items()
    }


def changed(
    parameters: Parameters,
    entries: Mapping[str, StatedParameter],
    place: Place,
    units: Mapping[str, str] = NO_UNITS,
) -> Parameters:
    """The parameters with the values, prior sds and fixed flags of the entries; later ones win.

    Raises InputError for a name or glob that stands for nothing, and a unit that does not fit.
    """
    changes: dict[str, dict[str, Any]] = {name: {} for name in parameters.names}
    for key, entry in entries.items():
        entry_place = place.at(key)
        with placed(entry_place):
            names = parameters.matching(key)
        for name in names:
            si, at = parameters[name].unit, entry_place.at("unit")
            if entry.value is not None:
                changes[name]["nominal"] = in_si(entry.value, entry.unit, si, at, units)
            if entry.sd is not None:
                changes[name]["prior_sd"] = in_si(
                    entry.sd, entry.unit, si, at, units, difference=True
                )
            if entry.fixed is not None and not parameters[name].same:
                changes[name]["fixed"] = entry.fixed
            if changes[name].get("prior_sd") == 0.0 and changes[name].get("fixed") is False:
                raise InputError(
                    f"the sd of {name!r} is 0, which fixes it, but fixed = false frees it",
                    code="conflicting-keys",
                    place=str(entry_place),
                    remedy="give a positive sd, or leave fixed = false out",
                )
    for p in parameters:
        of_first = {k: v for k, v in changes.get(p.same, {}).items() if k != "fixed"}
        if p.same and changes[p.name] not in ({}, of_first):
            raise InputError(
                f"{p.name!r} is the same as {p.same!r}, but something else is stated of it",
                code="conflicting-keys",
                place=str(place.at(p.name)),
                remedy=f"state it of {p.same!r} alone",
            )
    return Parameters(tuple(replace(p, **changes[p.name]) for p in parameters))


def entries_of(
    parameters: Parameters, entries: Mapping[str, StatedParameter]
) -> dict[str, StatedParameter]:
    """Those whose name or glob stands for one of these parameters."""
    return {k: e for k, e in entries.items() if any(fnmatchcase(n, k) for n in parameters.names)}


def declared_parameters(
    entries: Mapping[str, StatedParameter], place: Place
) -> dict[str, Parameter]:
    """Parameters that a file declares for a function: each plain name with value and unit.

    Raises InputError where a value or a unit is missing.
    """
    parameters = {}
    for name, entry in entries.items():
        # A glob speaks of parameters that exist; it declares none.
        if any(c in name for c in "*?["):
            continue
        for key, example in (("value", "0.8"), ("unit", '"m", "rad" or "1"')):
            if getattr(entry, key) is None:
                raise InputError(
                    f"the parameter {name!r} is declared without a {key}",
                    code="missing-key",
                    place=str(place.at(name)),
                    remedy=f"give {key} = {example}",
                )
        assert entry.value is not None
        assert entry.unit is not None
        si = unit(entry.unit).si
        parameters[name] = Parameter(name, in_si(entry.value, entry.unit, si, place), si)
    return parameters


SAME = Key(
    "Parameters that equal each other, by a name of your choice: the first is estimated for all.",
    example={"gears": ["S1_scale", "S2_scale"]},
)
PRIOR = Key(
    "Prior sds of parameters by name or glob, inf: flat; later lines win.",
    example={"d_*": {"sd": 1.0, "unit": "mm"}},
)


@dataclass(frozen=True)
class StatedPrior:
    """How well the nominal values are known."""

    sd: Annotated[
        float, Key("Prior sd; inf: the nominal value is no information.", sd=True, alone=True)
    ]
    unit: Annotated[str | None, Key("Of the sd.", is_unit=True)] = None
    estimate: Annotated[
        str | None,
        Key(
            "group: these parameters share one sd, which is learnt from the calibration; the sd "
            "stated is its expected size, known to a factor of e.",
            choices=ESTIMATES,
        ),
    ] = None


def with_priors(mechanism: Mechanism, priors: Mapping[str, StatedPrior], place: Place) -> Mechanism:
    """The mechanism with the prior sds of a file, and a term for each that is learnt.

    Raises InputError for a name that stands for nothing, a unit that does not fit, and for an sd
    to be learnt that is 0 or inf.
    """
    parameters = changed(mechanism.parameters, prior_sds(priors), place)
    for key, prior in priors.items():
        with placed(place.at(key)):
            if prior.estimate is not None:
                check_estimate(key, prior.estimate, prior.sd)
    learnt = {key: prior.estimate is not None for key, prior in priors.items()}
    with placed(place):
        terms = stated_terms(mechanism.terms, parameters, learnt)
    return replace(mechanism, parameters=parameters, terms=terms)


def prior_sds(priors: Mapping[str, StatedPrior]) -> dict[str, StatedParameter]:
    """Prior sds as statements about parameters."""
    return {key: StatedParameter(sd=prior.sd, unit=prior.unit) for key, prior in priors.items()}
