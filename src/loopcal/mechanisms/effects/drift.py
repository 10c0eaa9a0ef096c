"""What does not stay: an instrument that drifts, a reflector that was set anew, a joint's zero."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Any

import numpy as np

from loopcal.errors import InputError
from loopcal.keys import Key
from loopcal.mechanisms.effects.effect import LENGTHS, LOAD, Name, meant
from loopcal.mechanisms.frame import Values
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parameters import Parameter
from loopcal.units import difference_to_si, to_si, unit

DRIFT_SD = 1e-3
"""Prior sd over a drift's span: 1 mm or 1 mrad; of all lengths 0.1 %, 40 K of aluminium."""
BENDS_MOST = 8
_SHIFT_SD = {"rad": 0.1, "kg": 5.0, "px": 50.0}
"""Prior sd of a shift by unit, else 0.01: 10 mm, and 6 degrees, for what slips may turn far; 50 px,
some percent of a focal length."""
Column = Annotated[str, Key("Name of the known constant, such as a time or a temperature.")]
Since = Annotated[float, Key("Value of the known constant at which the drift is zero.")]
Over = Annotated[float, Key("Span in which the drift grows to P_drift.", positive=True)]
Until = Annotated[
    float | None,
    Key("Where the drift ended: readings beyond it, or without the column, are taken there."),
]


Bends = Annotated[
    int, Key("Terms of a curve beside the straight line, such as 4 for a warm-up; at most 8.")
]


@dataclass(frozen=True)
class Drift:
    """Parameters that follow a known constant t: p' = p + P_drift s, s = (t - since) / over.

    With bends, along a smooth curve as of a warm-up: + sum_k P_driftk 4 s (1 - s) T_k-1(2 s - 1),
    k = 1 .. bends, with Chebyshev's polynomials T: nothing at both ends of the span.

    changing: parameters by names or globs, such as base_* for the place of an instrument, or
    readings, whose zeros drift: x' = x - x_drift (t - since) / over; "lengths" alone: all lengths
    of the machine in proportion, by one parameter, as it warms up; column: the known constant t;
    unit: of since, over and until, such as "s", "K" or "1"; since, over: where the drift is zero,
    and the span in which it grows to P_drift [m or rad]; until: where the drift ended. Readings
    beyond it are taken there, and those to predict from that lack the column; where it is `since`,
    only the latter; bends: terms of the curve.

    Raises InputError for a span that is not a positive number, and for bends outside 0 to 8.
    """

    changing: Annotated[
        tuple[str, ...],
        Key(
            'Parameters by names or globs, readings, or "lengths" alone: all in proportion.',
            least=1,
        ),
    ] = ("base_*",)
    column: Column = "t"
    unit: Annotated[str, Key("Unit of since, over and until.", is_unit=True)] = "1"
    since: Since = 0.0
    over: Over = 1.0
    name: Name = "drift"
    until: Until = None
    bends: Bends = 0

    def __post_init__(self) -> None:
        if not 0 <= self.bends <= BENDS_MOST:
            raise InputError(
                f"the drift {self.name!r} has {self.bends} bends",
                code="invalid-value",
                remedy=f"give a number from 0 to {BENDS_MOST}",
            )
        ends = [self.since] if self.until is None else [self.since, self.until]
        if not 0.0 < self.over < math.inf or not all(map(math.isfinite, ends)):
            until = "" if self.until is None else f" until {self.until:g}"
            raise InputError(
                f"the drift {self.name!r} counts from {self.since:g} over {self.over:g}{until}",
                code="invalid-value",
                remedy="give finite numbers, and a positive span",
            )

    def parameters(self, mechanism: Mechanism) -> dict[str, Parameter]:
        """P_drift of each parameter, in its unit, or of all lengths, and those of its bends."""
        grows = self.changing == (LENGTHS,)
        drifting = {LENGTHS: "1"} if grows else _units(mechanism, self.changing)
        return {
            f"{name}_drift{term}": Parameter(
                f"{name}_drift{term}",
                0.0,
                si,
                DRIFT_SD,
                meaning=f"{said} {_of(mechanism, name)} along the run",
                changes="" if grows else name,
            )
            for name, si in drifting.items()
            for term, said in self._terms
        }

    @property
    def _terms(self) -> list[tuple[str, str]]:
        """Endings of the names of its parameters, and what these are."""
        return [("", "change"), *((str(k), f"bend {k}") for k in range(1, self.bends + 1))]

    def pose_constants(self, mechanism: Mechanism) -> dict[str, str]:
        """The column."""
        return {self.column: unit(self.unit).si}

    def changed(self, mechanism: Mechanism, x: Values, p: Values) -> dict[str, Any]:
        """The parameters as they are at t, and the readings without their drift."""
        since, over = to_si(self.since, self.unit), difference_to_si(self.over, self.unit)
        t = x[self.column]
        if self.until is not None and self.until > self.since:
            until = to_si(self.until, self.unit)
            t = t - (t - until) * _from(until, t)
        share = (t - since) * (1.0 / over)
        shares = [share, *bent(share, self.bends)]

        def drift(name: str) -> Any:
            ends = [term for term, _ in self._terms]
            return sum(p[f"{name}_drift{end}"] * s for end, s in zip(ends, shares, strict=True))

        if self.changing == (LENGTHS,):
            lengths = [q.name for q in mechanism.parameters if q.dimension == "length"]
            return {name: p[name] * (1.0 + drift(LENGTHS)) for name in lengths}
        return {name: _moved(name, drift(name), x, p) for name in _units(mechanism, self.changing)}

    def latest(self) -> dict[str, float]:
        """The column at the end of the run, where that is stated."""
        return {} if self.until is None else {self.column: to_si(self.until, self.unit)}


def bent(share: Any, count: int) -> list[Any]:
    """4 s (1 - s) T_k(2 s - 1) for k = 0 .. count - 1."""
    at = 2.0 * share - 1.0
    bubble = 4.0 * share * (1.0 - share)
    terms = [bubble, bubble * at]
    while len(terms) < count:
        terms.append(2.0 * at * terms[-1] - terms[-2])
    return terms[:count]


@dataclass(frozen=True)
class Shift:
    """Parameters that change at once, until they do again: p' = p + P_fromA for A <= t.

    For a reflector knocked in its seat, a tracker that was moved, a machine set up anew between
    the poses. changing: parameters by names or globs, or readings, whose zeros change, as of a
    joint whose encoder was mastered anew: x' = x - x_fromA; "load" alone: the load on the tool of
    an arm, as part of its structured model error; column: a known constant t that grows,
    such as the number of the pose; unit: of at; at: values of t at which a new segment begins,
    rising.
    Before the first, P itself holds; each segment adds its own P_fromA [m or rad], A in SI.
    Readings to predict from that lack the column are taken as after the last change.

    Raises InputError where no change is stated, or they do not rise.
    """

    changing: Annotated[
        tuple[str, ...],
        Key(
            'Parameters by names or globs, and readings; or "load" alone: that on the tool.',
            least=1,
        ),
    ]
    at: Annotated[tuple[float, ...], Key("Where each new segment begins, rising.", least=1)]
    column: Annotated[str, Key("Name of the known constant, such as the number of the pose.")] = (
        "pose"
    )
    unit: Annotated[str, Key("Unit of at.", is_unit=True)] = "1"
    name: Name = "shift"

    def __post_init__(self) -> None:
        if not self.at or any(a >= b for a, b in pairwise(self.at)):
            raise InputError(
                f"the shifts of {self.name!r} are at {list(self.at)}",
                code="invalid-value",
                remedy="list in rising order where each new segment begins",
            )

    def parameters(self, mechanism: Mechanism) -> dict[str, Parameter]:
        """P_fromA of each parameter and segment, in the parameter's unit."""
        return {
            (parameter := _from_name(name, a)): Parameter(
                parameter,
                0.0,
                si,
                shift_sd(si),
                meaning=f"change {_of(mechanism, name)} from {self.column} {a:.12g} on, "
                "against the start",
                changes=name,
            )
            for name, si in _units(mechanism, self.changing).items()
            for a in self._at
        }

    def pose_constants(self, mechanism: Mechanism) -> dict[str, str]:
        """The column."""
        return {self.column: unit(self.unit).si}

    def changed(self, mechanism: Mechanism, x: Values, p: Values) -> dict[str, Any]:
        """The parameters and readings of the segment that t lies in."""
        reached = [_from(a, x[self.column]) for a in self._at]
        within = [begun - following for begun, following in pairwise([*reached, 0.0])]
        return {
            name: _moved(
                name,
                sum(p[_from_name(name, a)] * s for a, s in zip(self._at, within, strict=True)),
                x,
                p,
            )
            for name in _units(mechanism, self.changing)
        }

    def latest(self) -> dict[str, float]:
        """The column, after the last change."""
        return {self.column: max(self._at)}

    @property
    def _at(self) -> list[float]:
        """Beginnings of the segments [SI]."""
        return [to_si(a, self.unit) for a in self.at]


def shift_sd(si: str) -> float:
    """Prior sd of what changed at once, in its SI unit."""
    return _SHIFT_SD.get(si, 0.01)


def _units(mechanism: Mechanism, patterns: tuple[str, ...]) -> dict[str, str]:
    """The SI units of the parameters that names or globs stand for, and of readings by name."""
    if patterns == (LOAD,):
        patterns = () if mechanism.structure is None else mechanism.structure.loaded
    read = {v.name for v in mechanism.variables if v.role == "reading"}
    names = [p for p in patterns if p in read and p not in mechanism.parameters.names]
    units = {p.name: p.unit for p in meant(mechanism, [n for n in patterns if n not in names])}
    return units | {name: mechanism.quantities[name] for name in names}


def _of(mechanism: Mechanism, name: str) -> str:
    """Of what it is the change, for the meaning of a parameter."""
    if name == LENGTHS:
        return f"of all {name}"
    return f"of {name}" if name in mechanism.parameters.names else f"of what {name} reads"


def _moved(name: str, change: Any, x: Values, p: Values) -> Any:
    """A parameter with its change; a reading without that of its zero."""
    return p[name] + change if name in p else x[name] - change


def _from_name(parameter: str, begin: float) -> str:
    return f"{parameter}_from{begin:.12g}"


def _from(begin: float, t: Any) -> Any:
    """1 where t >= begin, else 0; t is a known constant, so no derivative is ever taken."""
    # Measured from one double below `begin`, so that t = begin counts as past and |past| is not 0.
    past = t - float(np.nextafter(begin, -math.inf))
    return 0.5 * (1.0 + past / abs(past))
