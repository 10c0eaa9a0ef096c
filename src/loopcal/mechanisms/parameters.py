"""Parameters of a mechanism: constants to be estimated, addressed by name, never by position.

Which parameters of a machine only say where a frame lies, and when they are held.

The joints of a parallel machine are points of two bodies, base and platform, whose frames cannot be
seen. A frame is tied by an instrument that reads in it; where none does, the
machine's `Gauge` holds as many parameters at their nominal values as the frame has freedoms, and
what is left is determined. Nothing that can be seen depends on which are held.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from itertools import chain
from typing import Any, Literal, Protocol, cast, get_args

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError, refuse_repeated, unknown_name
from loopcal.lazy import cached_property
from loopcal.units import to_si, unit

Role = Literal[
    "placement",
    "mounting",
    "lens",
    "print",
    "corner",
    "length",
    "twist",
    "zero",
    "angle",
    "scale",
    "effect",
    "model error",
]
ROLES: tuple[Role, ...] = get_args(Role)
"""What a parameter says: "placement", where a machine or an instrument stands, and an instrument's
own zeros; "mounting", where something sits on the body; "lens" and "print", of a camera and of the
board that it sees; "corner", by how much a point of a print is off; of the machine "length";
"scale"; "twist" (a turn between two axes); "zero" (added to a joint's reading); "angle" (twist or
zero, where only its unit is known); "effect" beyond geometry; "model error", of the structured
one."""
GEOMETRY: frozenset[Role] = frozenset({"length", "twist", "zero", "angle", "scale"})
"""Roles of what a drawing of the machine states."""
OF_CAMERAS: frozenset[Role] = frozenset({"lens", "print", "corner"})
"""Roles of what a camera is, and of what is printed."""
BEYOND: frozenset[Role] = frozenset({"effect", "model error"})
"""Roles of what no drawing states."""
_BY_UNIT: dict[str, Role] = {"m": "length", "rad": "angle"}


UNSTATED = cast("Role", "")
"""In place of a role: the one that the unit suggests."""


@dataclass(frozen=True)
class Parameter:
    """A constant of a mechanism.

    nominal [SI], unit: the SI unit it is in; prior_sd [SI]: how well the nominal is known
    (inf: flat, it is not used as information); fixed: not estimated. role: what it says (see
    `ROLES`), by its unit where none is given; owner: the joint, link, instrument, target or effect
    that it belongs to, "" for the machine as a whole; meaning: one line on it, in words; changes:
    the parameter or reading that changes by it during the run; same: the parameter whose value it
    has, so that it is not estimated itself. Raises InputError for a value that is not finite, a
    negative sd, and another role.
    """

    name: str
    nominal: float
    unit: str
    prior_sd: float = math.inf
    fixed: bool = False
    role: Role = UNSTATED
    owner: str = ""
    meaning: str = ""
    changes: str = ""
    same: str = ""

    def __post_init__(self) -> None:
        if not math.isfinite(self.nominal):
            raise InputError(
                f"parameter {self.name!r} has the nominal value {self.nominal}",
                code="invalid-value",
                remedy="give a finite number, the best known value of the parameter",
            )
        if math.isnan(self.prior_sd) or self.prior_sd < 0:
            raise InputError(
                f"the prior sd of {self.name!r} is {self.prior_sd}",
                code="invalid-value",
                remedy="give a positive number, inf for a flat prior, or fix the parameter",
            )
        if self.prior_sd == 0.0 and not self.fixed:
            object.__setattr__(self, "fixed", True)  # known exactly: nothing to estimate
        if self.role == UNSTATED:
            object.__setattr__(self, "role", _BY_UNIT.get(self.unit, "scale"))
        elif self.role not in ROLES:
            raise unknown_name(
                f"parameter {self.name!r} has the role {self.role!r}", self.role, ROLES
            )

    @property
    def dimension(self) -> Literal["length", "angle", ""]:
        """What the machine's own drawing says in m or rad: "length" or "angle"; else ""."""
        return dimension_of(self.role, self.unit)

    @property
    def label(self) -> str:
        """What a sentence calls it."""
        return label_of(self)

    def of(self, role: Role, owner: str = "", meaning: str = "") -> Parameter:
        """The same parameter with another role, owner and meaning; those not given stay."""
        return replace(self, role=role, owner=owner or self.owner, meaning=meaning or self.meaning)


class Described(Protocol):
    """What says of itself what it is."""

    @property
    def name(self) -> str:
        """Of the parameter."""

    @property
    def role(self) -> str:
        """One of `ROLES`; empty: written by an early version."""

    @property
    def owner(self) -> str:
        """The joint, link, instrument, target or effect that it belongs to."""

    @property
    def meaning(self) -> str:
        """One line on it."""


def label_of(parameter: Described) -> str:
    """The name of a parameter and, in brackets, what it is and of what; the name alone where
    nothing says it.

    >>> label_of(Parameter("a1_x", 0.0, "m", owner="a1", meaning="position along x"))
    'a1_x (position along x of a1)'
    """
    owner, words = parameter.owner, parameter.meaning.partition(":")[0]
    if not words:
        return parameter.name
    # An effect is a term of the model: what it acts on is in its words.
    if owner and parameter.role not in BEYOND and owner not in words.split():
        words = f"{words} of {owner}"
    return f"{parameter.name} ({words})"


def labels_of(parameters: Iterable[Described]) -> dict[str, str]:
    """Name of each parameter -> what a sentence calls it."""
    return {p.name: label_of(p) for p in parameters}


def dimension_of(role: str, unit_name: str) -> Literal["length", "angle", ""]:
    """ "length" or "angle" for a role of the drawing in m or rad; else ""."""
    if role not in GEOMETRY:
        return ""
    return "length" if unit_name == "m" else "angle" if unit_name == "rad" else ""


@dataclass(frozen=True)
class Parameters:
    """The parameters of a mechanism in the order they were declared."""

    items: tuple[Parameter, ...]

    def __post_init__(self) -> None:
        refuse_repeated(
            (p.name for p in self.items), "parameter {!r} is declared twice", "name each once"
        )
        if any(p.same for p in self.items):
            object.__setattr__(self, "items", tuple([self._following(p) for p in self.items]))

    def _following(self, parameter: Parameter) -> Parameter:
        """The parameter with what is known of the one that it equals."""
        if not parameter.same:
            return parameter
        first = self[parameter.same]
        return replace(parameter, nominal=first.nominal, prior_sd=first.prior_sd)

    def __iter__(self) -> Iterator[Parameter]:
        return iter(self.items)

    def __len__(self) -> int:
        return len(self.items)

    def __getitem__(self, name: str) -> Parameter:
        if name in self._by_name:
            return self._by_name[name]
        raise unknown_name(f"there is no parameter {name!r}", name, self.names)

    @cached_property
    def _by_name(self) -> Mapping[str, Parameter]:
        return {p.name: p for p in self.items}

    @cached_property
    def names(self) -> tuple[str, ...]:
        """All names, in order."""
        return tuple([p.name for p in self.items])

    @cached_property
    def free(self) -> tuple[str, ...]:
        """Names of the parameters that are estimated, in order."""
        return tuple([p.name for p in self.items if not p.fixed])

    @cached_property
    def nominal(self) -> Mapping[str, float]:
        """Name -> nominal value [SI], in order."""
        return {p.name: p.nominal for p in self.items}

    def of_role(self, *roles: Role) -> tuple[str, ...]:
        """Names of the parameters with one of these roles, in order."""
        return tuple([p.name for p in self.items if p.role in roles])

    def matching(self, pattern: str) -> tuple[str, ...]:
        """Names that a name or glob stands for.

        Raises InputError if it stands for none.
        """
        return matching(pattern, self.names, "parameter")

    def with_nominal(self, values: Mapping[str, float]) -> Parameters:
        """The same parameters with other nominal values [SI] for the names given."""
        return self._changed({n: {"nominal": float(v)} for n, v in values.items()})

    def with_prior(self, sds: Mapping[str, float]) -> Parameters:
        """The same parameters with other prior sds [SI]; keys may be globs, later ones win."""
        names = frozenset(self.names)
        changes = {
            n: {"prior_sd": float(sd)}
            for key, sd in sds.items()
            for n in ((key,) if key in names else self.matching(key))
        }
        return self._changed(changes)

    def with_fixed(self, patterns: Iterable[str], fixed: bool = True) -> Parameters:
        """The same parameters with those named (or matched by globs) fixed, or set free."""
        return self._changed({n: {"fixed": fixed} for key in patterns for n in self.matching(key)})

    def with_role(self, role: Role, names: Iterable[str], owner: str = "") -> Parameters:
        """The same parameters, those named with another role, and owner where one is given."""
        named = frozenset(names)
        return Parameters(tuple([p.of(role, owner) if p.name in named else p for p in self.items]))

    def _changed(self, changes: Mapping[str, Mapping[str, Any]]) -> Parameters:
        for name in changes:
            self[name]  # raises for a name that is not there
        return Parameters(
            tuple([_with(p, changes[p.name]) if p.name in changes else p for p in self.items])
        )


def _with(parameter: Parameter, changes: Mapping[str, Any]) -> Parameter:
    """The parameter with other values; itself where none differs."""
    fields = vars(parameter)
    # Most changes touch few of many parameters: what stays is shared, not copied.
    if all(fields[name] == value for name, value in changes.items()):
        return parameter
    # Thousands in a calibration: its initialiser sets each field of a frozen object by a call.
    made = object.__new__(Parameter)
    vars(made).update(fields, **changes)
    made.__post_init__()
    return made


def stated(
    parameters: Mapping[str, Parameter], nominal: Mapping[str, float | Parameter]
) -> dict[str, Parameter]:
    """The parameters that are given other values [SI]; role, owner and meaning stay.

    Raises InputError for a name that is none of theirs.
    """
    made = {}
    for name, value in nominal.items():
        if name not in parameters:
            raise unknown_name(f"there is no parameter {name!r}", name, parameters)
        drawn = parameters[name]
        made[name] = (
            replace(value, name=name, role=drawn.role, owner=drawn.owner, meaning=drawn.meaning)
            if isinstance(value, Parameter)
            else replace(drawn, nominal=float(value))
        )
    return made


def matching(pattern: str, names: Iterable[str], what: str) -> tuple[str, ...]:
    """The names that a name or a glob (*, ?, [..]) stands for, in their order.

    Raises InputError naming the nearest name if it stands for none.
    """
    candidates = tuple(names)
    if pattern in candidates:
        return (pattern,)
    matched = tuple(name for name in candidates if fnmatchcase(name, pattern))
    if not matched:
        raise unknown_name(f"no {what} is called {pattern!r}", pattern, candidates)
    return matched


def declared(parameters: Mapping[str, object]) -> Parameters:
    """Parameters from {name: (value, unit)} or {name: value [SI]} or {name: Parameter}.

    Raises InputError for a value that is not a number or a unit that is not known.
    """
    items = []
    for name, declaration in parameters.items():
        if isinstance(declaration, Parameter):
            items.append(replace(declaration, name=name))
            continue
        pair = declaration if isinstance(declaration, tuple) else (declaration, "1")
        try:
            value, unit_name = pair
            number = float(value)
        except (TypeError, ValueError):
            raise InputError(
                f"parameter {name!r} has the value {declaration!r}",
                code="invalid-value",
                remedy="give (value, unit), for example (0.8, 'm')",
            ) from None
        items.append(Parameter(name, to_si(number, str(unit_name)), unit(str(unit_name)).si))
    return Parameters(tuple(items))


@dataclass(frozen=True)
class Gauge:
    """Parameters that place a frame or set the scale, by what they place.

    base: where the base frame lies, tied by an instrument that reads coordinates in it; base_joints
    and body_joints: the coordinates of joints, (a1_x, a1_y, a1_z) and so on, by which the frames of
    base and body lie; the body's is tied by an instrument that reads the pose of that very frame;
    scaled: the machine itself reads angles alone, so that the distance of two joints of the base is
    its size, tied by any measured length. translating: the body never turns; the place of a target
    on it is indistinguishable from that of the station, and one target of each station is held.
    """

    base: tuple[str, ...] = ()
    base_joints: tuple[tuple[str, ...], ...] = ()
    body_joints: tuple[tuple[str, ...], ...] = ()
    scaled: bool = False
    translating: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        """All parameters that may be held for a frame."""
        return (*self.base, *chain(*self.base_joints, *self.body_joints))


class Reader(Protocol):
    """What an instrument says of the frames that it ties."""

    @property
    def readings(self) -> Mapping[str, str]:
        """Its readings and their SI units."""

    @property
    def parameters(self) -> Mapping[str, Parameter]:
        """Of what it looks at on the body."""

    @property
    def mounted(self) -> Iterable[str]:
        """Of them, those of where on the body that is."""

    @property
    def placement(self) -> Mapping[str, Parameter]:
        """Of where it stands."""

    @property
    def implied(self) -> Mapping[str, float]:
        """Readings that are the same in every pose by construction, and so measure nothing."""

    @property
    def form(self) -> str:
        """What its readings are together."""


_COORDINATES = ("point", "spherical", "pose")
"""Forms of readings that say where in a frame something is, rather than how far from a thing."""


def held(gauge: Gauge, instruments: Sequence[Reader], drawn: Mapping[str, Parameter]) -> set[str]:
    """Names of the parameters that nothing but the drawing can say; drawn: with its values."""
    names: set[str] = set()
    base, size = _frame(gauge.base_joints, drawn)
    if not any(i.form in _COORDINATES and not i.placement for i in instruments):
        names |= {*gauge.base, *base}
    # The pose of a target leaves the target's place in the body's frame open, so it ties nothing.
    if not any(i.form == "pose" and not i.parameters for i in instruments):
        names |= {*_frame(gauge.body_joints, drawn)[0]}
    if gauge.translating:
        names |= _one_target_each(instruments)
    units = [u for i in instruments for q, u in i.readings.items() if q not in i.implied]
    # Angles are the same for a machine of any size.
    if gauge.scaled and "m" not in units:
        names |= {size}
    return names


def _one_target_each(instruments: Sequence[Reader]) -> set[str]:
    """The first target of all instruments that a station or a target ties to each other.

    What never turns shows the difference between a target and the station alone, or the base where
    the instrument stands in its frame.
    """
    groups: list[tuple[set[str], set[str]]] = []
    for i in instruments:
        target = {n for n in i.mounted if i.parameters[n].unit == "m"}
        if target:
            tied = {*i.placement, *target} if i.placement else {"", *target}
            linked = [group for group in groups if group[0] & tied]
            groups = [group for group in groups if group not in linked]
            first = linked[0][1] if linked else target
            groups.append((tied.union(*(group[0] for group in linked)), first))
    return {name for _, first in groups for name in first}


_APART = 0.3
"""Least distance of a second joint, in that of the farthest one: nearer ones turn the frame."""


def _frame(
    joints: Sequence[Sequence[str]], drawn: Mapping[str, Parameter]
) -> tuple[list[str], str]:
    """The coordinates by which a frame lies, and the one that sets its size.

    All of the first joint; of the second all but the one along which it lies most, which sets the
    size; in space, of the joint farthest from the line of both, the one most across their plane.
    """
    if not joints:
        return [], ""
    at = np.array([[drawn[name].nominal for name in joint] for joint in joints])
    away = at - at[0]
    second = _first_largest(np.linalg.norm(away, axis=1), _APART)
    along = _first_largest(np.abs(away[second]))
    size = joints[second][along]
    coordinates = [*joints[0], *(name for name in joints[second] if name != size)]
    if at.shape[1] > 2:  # in space a turn about the line of both is left
        across = np.cross(away[second], away)
        third = _first_largest(np.linalg.norm(across, axis=1))
        coordinates.append(joints[third][_first_largest(np.abs(across[third]))])
    return coordinates, size


def _first_largest(sizes: NDArray[np.float64], share: float = 1.0 - 1e-3) -> int:
    """The first of those that are as large as the largest, or as this share of it."""
    return int(np.argmax(sizes >= share * sizes.max()))


def fixed(parameters: Mapping[str, Parameter], names: set[str]) -> dict[str, Parameter]:
    """The parameters, those named held at their nominal values."""
    return {n: replace(p, fixed=True) if n in names else p for n, p in parameters.items()}
