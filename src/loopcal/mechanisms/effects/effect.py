"""An effect beyond geometry: in every pose it changes what some readings or parameters mean.

The loops f(x, p) become f(x', p'). x' are corrected joint readings, as of a gear that is not round
or a joint that yields. p' are parameters that do not stay the same, as of an instrument that
drifts. Any mechanism can be given effects, whatever machine and instruments it is made of: the
expressions are put into its tape. Effects follow one another: the first acts on the readings, the
next on what it leaves.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Protocol, runtime_checkable

from loopcal.errors import InputError, nearest
from loopcal.expressions.rewriting import substituted
from loopcal.keys import Key, description
from loopcal.mechanisms.frame import Values
from loopcal.mechanisms.machine import ENDS
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parameters import Parameter, Parameters, matching
from loopcal.mechanisms.quantity import Quantity

Joints = Annotated[tuple[str, ...], Key("Joints by names or globs.", least=1)]
Name = Annotated[str, Key("Name of the effect in comparisons of models.")]
RUN_DRIFTS = RUN_DRIFT, RUN_DRIFT_TURNS = "run_drift", "run_drift_turns"
"""Names of the effect, and of its terms, of a drift that is there because the joints tell the order
of the poses (`statistics.run_drift`)."""
STATION_SCALES = "station_scales"
"""Name of the term of the scales of several stations (`statistics.station_scales`)."""
OF_INSTRUMENTS = *RUN_DRIFTS, STATION_SCALES
"""Terms of what instruments do, which is no fault of the machine's."""
LENGTHS = "lengths"
"""What changes where all lengths of the machine do, in proportion."""
LOAD = "load"
"""What changes where the tool carries another load: its mass, or how the arm gives way under it."""


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

    def pose_constants(self, mechanism: Mechanism) -> dict[str, str]:
        """Constants that vary by pose and that it needs, name -> SI unit."""

    def changed(self, mechanism: Mechanism, x: Values, p: Values) -> dict[str, Any]:
        """New values of readings or parameters by name, of traced values."""


@runtime_checkable
class Dated(Protocol):
    """An effect that says in which state a machine is now."""

    def latest(self) -> dict[str, float]:
        """Known constant -> value [SI] from which on nothing changes any more."""


def with_effects(mechanism: Mechanism, effects: Sequence[Effect]) -> Mechanism:
    """The mechanism with effects beyond those it has.

    Their parameters stand behind the others, with their priors; fixed at zero they leave the
    mechanism as it was. `Mechanism.effects` lists the parameters of each. An effect without any
    waits for the structured model error (`Mechanism.awaiting`).

    Raises InputError for two effects of one name or with one parameter, and for what an effect
    cannot act on.
    """
    by_effect: dict[str, dict[str, Parameter]] = {}
    pose_constants: dict[str, Quantity] = {}
    ends = ENDS if any(v.first for v in mechanism.variables) else ENDS[:1]
    taken = {*mechanism.parameters.names}
    named = {*mechanism.effects, *(e.name for e in mechanism.awaiting)}
    for effect in effects:
        if effect.name in (*named, *by_effect):
            raise InputError(
                f"two effects are named {effect.name!r}",
                code="duplicate-name",
                remedy="give each effect a unique name",
            )
        by_effect[effect.name] = {
            n: p.of("effect", effect.name) for n, p in effect.parameters(mechanism).items()
        }
        _refuse_shared(effect.name, by_effect[effect.name], taken)
        taken |= by_effect[effect.name].keys()
        for name, unit in effect.pose_constants(mechanism).items():
            for end in ends:
                constant = Quantity(name + end, unit, "known", name if end else None)
                pose_constants.setdefault(constant.name, constant)
    variables = (
        *mechanism.variables,
        *(v for n, v in pose_constants.items() if n not in mechanism.pose_constants),
    )
    added = [p for parameters in by_effect.values() for p in parameters.values()]
    changed = mechanism.with_tape(
        lambda tape: substituted(
            tape,
            lambda x, p: _meaning(mechanism, effects, _rows(variables), x, p),
            pose_constants=[
                name for name in pose_constants if name not in mechanism.pose_constants
            ],
            parameters=[p.name for p in added],
        )
    )
    latest = dict(mechanism.latest)
    for effect in effects:
        for name, value in effect.latest().items() if isinstance(effect, Dated) else ():
            for end in ends:
                latest[name + end] = max(latest.get(name + end, value), value)
    described = dict(mechanism.description or {"type": "function"})
    effect_tables = [*described.get("effect", []), *(description(effect) for effect in effects)]
    return replace(
        changed,
        variables=variables,
        parameters=Parameters((*mechanism.parameters, *added)),
        description=described | {"effect": effect_tables},
        latest=latest,
        awaiting=(*mechanism.awaiting, *(e for e in effects if not by_effect[e.name])),
    )


def joints(mechanism: Mechanism, patterns: Sequence[str], unit: str | None = None) -> list[str]:
    """The joints that names or globs stand for: quantities that no instrument reads.

    Globs find only joints in `unit`, if one is given; of a machine with passive joints and platform
    coordinates they find these too, so name its sensed joints. Raises InputError where there are
    none.
    """
    read = {q for family in mechanism.families for q in family.readings} | {*mechanism.outputs}
    quantities = [v.name for v in mechanism.variables if v.role == "reading" and v.first is None]
    quantities = [q for q in quantities if q not in read]
    chosen = dict.fromkeys(
        name
        for pattern in patterns
        for name in matching(pattern, quantities, "joint")
        if name == pattern or unit in (None, mechanism.quantities[name])
    )
    for name in chosen:
        if unit is not None and mechanism.quantities[name] != unit:
            raise InputError(
                f"{name!r} is in {mechanism.quantities[name]}, but this effect acts on joints in "
                f"{unit}",
                code="wrong-unit",
                remedy="name other joints",
            )
    if not chosen:
        raise InputError(
            f"no joint is called {' or '.join(map(repr, patterns))}"
            + (f" and in {unit}" if unit else ""),
            code="unknown-name",
            remedy="name measured joints, or remove this effect",
        )
    return list(chosen)


def meant(mechanism: Mechanism, patterns: Sequence[str]) -> list[Parameter]:
    """The parameters that names or globs stand for.

    Raises InputError for one that stands for none.
    """
    names = dict.fromkeys(n for pattern in patterns for n in mechanism.parameters.matching(pattern))
    return [mechanism.parameters[name] for name in names]


def _rows(variables: Sequence[Quantity]) -> list[dict[str, str]]:
    """For each pose of a row: what its variables are called, by their names in the first pose."""
    second = {v.first: v.name for v in variables if v.first}
    return [{v.name: v.name for v in variables}, *([second] if second else [])]


def _meaning(
    mechanism: Mechanism,
    effects: Sequence[Effect],
    rows: Sequence[Mapping[str, str]],
    x: Values,
    p: Values,
) -> tuple[dict[str, Any], dict[str, Any]]:
    """x' and p' of a row, which may hold two poses."""
    readings: dict[str, Any] = {}
    constants: dict[str, Any] = dict(p)
    for number, called in enumerate(rows):
        row = {name: x[variable] for name, variable in called.items()}
        for effect in effects:
            for name, value in effect.changed(mechanism, row, constants).items():
                if name in mechanism.quantities:
                    row[name] = readings[called[name]] = value
                elif number:
                    raise InputError(
                        f"the effect {effect.name!r} changes the parameter {name!r} by pose, "
                        f"but an instrument compares two poses",
                        code="unsupported",
                        remedy="remove the effect or the instrument",
                    )
                else:
                    constants[name] = value
    # What no effect touched stays an input of the tape, not a copy of one.
    return readings, {n: v for n, v in constants.items() if v is not p[n]}


def _refuse_shared(effect: str, parameters: Mapping[str, Parameter], taken: set[str]) -> None:
    for name in parameters:
        if name in taken:
            raise InputError(
                f"the parameter {name!r} of the effect {effect!r} exists already",
                code="duplicate-name",
                remedy="apply each kind of effect once per joint or parameter",
            )


# A model of a machine: which of its effects are switched on, and what is not estimated.


@dataclass(frozen=True)
class Model:
    """effects: names of those switched on; fixed: parameters by names or globs, not estimated."""

    effects: Annotated[
        tuple[str, ...], Key("Names of the mechanism's effects that are switched on.")
    ] = ()
    fixed: Annotated[
        tuple[str, ...], Key("Parameters, by name or glob, that this model does not estimate.")
    ] = ()


def with_only(mechanism: Mechanism, model: Model) -> Mechanism:
    """The mechanism of a model: parameters of other effects fixed at zero, those named fixed.

    Raises InputError for an effect or parameter that is not there.
    """
    for name in model.effects:
        if name not in mechanism.effects:
            raise InputError(
                f"the mechanism has no effect {name!r}",
                code="unknown-name",
                remedy=nearest(name, mechanism.effects)
                if mechanism.effects
                else "describe it in the mechanism first: [[effect]]",
            )
    off = [
        p for name, names in mechanism.effects.items() if name not in model.effects for p in names
    ]
    parameters = mechanism.parameters.with_nominal(dict.fromkeys(off, 0.0)).with_fixed(off)
    return mechanism.with_parameters(parameters.with_fixed(model.fixed))
