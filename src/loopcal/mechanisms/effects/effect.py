"""An effect beyond geometry: in every pose it changes what some readings or parameters mean.

The loops f(x, p) become f(x', p'), where x' are joint readings set right (a gear that is not
round, a joint that yields) and p' parameters that do not stay the same (an instrument that
drifts). Any mechanism can be given effects, whatever machine and instruments it is made of: the
expressions are put into its tape. Effects follow one another: the first acts on the readings, the
next on what it leaves.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Any, Protocol

from loopcal.errors import InputError
from loopcal.expressions.substitution import substituted
from loopcal.mechanisms.frame import Values
from loopcal.mechanisms.keys import Key, description
from loopcal.mechanisms.machine import ENDS
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parameters import Parameter, Parameters, matching

Joints = Annotated[tuple[str, ...], Key("Joints by names or globs.", least=1)]
Changing = Annotated[tuple[str, ...], Key("Parameters by names or globs.", least=1)]
Name = Annotated[str, Key("Name of the effect in comparisons of models.")]


class Effect(Protocol):
    """What changes, by how much, and which parameters say so: a frozen dataclass.

    Its fields that are annotated with a `Key` are what a mechanism file says of it.
    """

    @property
    def name(self) -> str:
        """What a comparison of models calls it."""

    def parameters(self, mechanism: Mechanism) -> dict[str, Parameter]:
        """Its own parameters, all zero where the effect is not there, with their prior sds.

        Raises InputError for a joint or parameter that the mechanism has not.
        """

    def known(self, mechanism: Mechanism) -> dict[str, str]:
        """Constants that vary by pose and that it needs, name -> SI unit."""

    def changed(self, mechanism: Mechanism, x: Values, p: Values) -> dict[str, Any]:
        """New values of readings or parameters by name, of traced values."""


def with_effects(mechanism: Mechanism, effects: Sequence[Effect]) -> Mechanism:
    """The mechanism with effects beyond those it has.

    Their parameters stand behind the others, with their priors; fixed at zero they leave the
    mechanism as it was. `Mechanism.effects` tells which parameters are whose.

    Raises InputError for two effects of one name or with one parameter, and for what an effect
    cannot act on.
    """
    own: dict[str, dict[str, Parameter]] = {}
    known: dict[str, str] = {}
    ends = _ends(mechanism)
    taken = {*mechanism.parameters.names}
    for effect in effects:
        if effect.name in (*mechanism.effects, *own):
            raise InputError(
                f"{effect.name!r} names two effects",
                code="duplicate-name",
                remedy="give each effect a name of its own",
            )
        own[effect.name] = effect.parameters(mechanism)
        _refuse_shared(effect.name, own[effect.name], taken)
        taken |= own[effect.name].keys()
        known |= {n + end: u for n, u in effect.known(mechanism).items() for end in ends}
    added = [p for its in own.values() for p in its.values()]
    tape = substituted(
        mechanism.tape,
        lambda x, p: _meaning(mechanism, effects, x, p),
        known=[name for name in known if name not in mechanism.known],
        parameters=[p.name for p in added],
    )
    described = dict(mechanism.description or {"type": "function"})
    told = [*described.get("effect", []), *(description(effect) for effect in effects)]
    return replace(
        mechanism,
        tape=tape,
        parameters=Parameters((*mechanism.parameters, *added)),
        known={**mechanism.known, **known},
        description=described | {"effect": told},
        effects={**mechanism.effects, **{name: tuple(its) for name, its in own.items()}},
    )


def joints(mechanism: Mechanism, patterns: Sequence[str], unit: str | None = None) -> list[str]:
    """The joints that names or globs stand for: quantities that no instrument reads.

    Globs find only joints in `unit`, if one is given; of a machine with passive joints and platform
    coordinates they find these too, so name its sensed joints. Raises InputError where there are
    none.
    """
    read = {q for family in mechanism.families for q in family.readings} | {*mechanism.outputs}
    twins = {q + end for q in mechanism.quantities for end in ENDS if end}
    own = [q for q in mechanism.quantities if q not in read and q not in twins]
    found = dict.fromkeys(
        name
        for pattern in patterns
        for name in matching(pattern, own, "joint")
        if name == pattern or unit in (None, mechanism.quantities[name])
    )
    for name in found:
        if unit is not None and mechanism.quantities[name] != unit:
            raise InputError(
                f"{name!r} is in {mechanism.quantities[name]}, and this effect acts on joints in "
                f"{unit}",
                code="wrong-unit",
                remedy="name other joints",
            )
    if not found:
        raise InputError(
            f"no joint is called {' or '.join(map(repr, patterns))}"
            + (f" and in {unit}" if unit else ""),
            code="unknown-name",
            remedy="name joints that are read, or leave this effect out",
        )
    return list(found)


def meant(mechanism: Mechanism, patterns: Sequence[str]) -> list[Parameter]:
    """The parameters that names or globs stand for.

    Raises InputError for one that stands for none.
    """
    names = dict.fromkeys(n for pattern in patterns for n in mechanism.parameters.matching(pattern))
    return [mechanism.parameters[name] for name in names]


def _meaning(
    mechanism: Mechanism, effects: Sequence[Effect], x: Values, p: Values
) -> tuple[dict[str, Any], dict[str, Any]]:
    """x' and p' of a row, which may hold two poses."""
    readings: dict[str, Any] = {}
    constants: dict[str, Any] = dict(p)
    for end in _ends(mechanism):
        row = {name.removesuffix(end): value for name, value in x.items() if name.endswith(end)}
        for effect in effects:
            for name, value in effect.changed(mechanism, row, constants).items():
                if name in mechanism.quantities:
                    row[name] = readings[name + end] = value
                elif end:
                    raise InputError(
                        f"the effect {effect.name!r} changes the parameter {name!r} by pose, and "
                        "an instrument looks at two poses at once",
                        code="unsupported",
                        remedy="leave the effect or the instrument out",
                    )
                else:
                    constants[name] = value
    return readings, {n: v for n, v in constants.items() if v is not p[n]}


def _ends(mechanism: Mechanism) -> tuple[str, ...]:
    twin = any(q + ENDS[1] in mechanism.quantities for q in mechanism.quantities)
    return ENDS if twin else ENDS[:1]


def _refuse_shared(effect: str, own: Mapping[str, Parameter], taken: set[str]) -> None:
    for name in own:
        if name in taken:
            raise InputError(
                f"the effect {effect!r} has a parameter {name!r}, and so has something before it",
                code="duplicate-name",
                remedy="let one effect of a kind act on a joint or parameter",
            )
