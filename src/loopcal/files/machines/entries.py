"""Tables of mechanism files from the declarations of `loopcal.mechanisms.keys`: schema and build.

A list stands for a tuple, `false` for None where leaving the key out means something else, and a
number with a unit may be written as a table.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, is_dataclass, replace
from functools import cache, reduce
from operator import or_
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, cast, get_args, get_origin

from pydantic import Field, create_model

from loopcal.errors import InputError
from loopcal.files.machines.mechanism_parts import Amount, Value
from loopcal.files.machines.parameter_entries import in_si
from loopcal.files.toml.model import Finite, Model, UnitName
from loopcal.files.toml.place import Place
from loopcal.mechanisms.keys import REQUIRED, Argument, arguments, summary, type_name
from loopcal.mechanisms.station import Target

Units = Mapping[str, str]
Make = Callable[..., Any]


@cache
def table(make: Make, suffix: str = "", base: type[Model] = Model) -> type[Any]:
    """The model of the table that states the keys of a maker, and those of a base.

    suffix: ends the name of the model; with one the table states its `type`.
    """
    name = "".join(word.title() for word in type_name(make).split("-")) + suffix
    keys: dict[str, Any] = {"type": (Literal[type_name(make)], ...)} if suffix else {}
    keys |= {argument.name: _field(argument) for argument in arguments(make)}
    return create_model(name, __base__=base, __doc__=summary(make), **keys)


def given(make: Make, entry: Any, units: Units, place: Place) -> dict[str, Any]:
    """The arguments that an entry states for a maker, SI.

    units: dimension -> unit of numbers that state none. Raises InputError for a unit that does
    not fit.
    """
    return {
        a.name: _value(a.kind, _Reading(a, entry, units, place), getattr(entry, a.name))
        for a in arguments(make)
    }


def built(make: Make, entry: Any, units: Units, place: Place, **more: Any) -> Any:
    """What a maker makes of an entry, and of further arguments that no file states.

    Raises InputError at the entry where it does not fit.
    """
    try:
        return make(**given(make, entry, units, place), **more)
    except InputError as error:
        raise error if error.place else error.at(str(place)) from None


def _field(argument: Argument) -> Any:
    kind, default = _schema(argument.kind, argument), argument.default
    if argument.off:
        kind = reduce(or_, [k for k in _members(kind) if k is not NoneType]) | Literal[False]
    if isinstance(default, tuple | Mapping):
        default = dict(default) if isinstance(default, Mapping) else list(default)
    stated = ... if default is REQUIRED else default
    return (kind, Field(stated, description=argument.key.says))


def _schema(kind: Any, argument: Argument) -> Any:
    """The type of a key in a file."""
    key = argument.key
    if kind is float:
        number = Annotated[float, Field(gt=0, allow_inf_nan=False)] if key.positive else Finite
        return Amount if key.unit else number
    if kind in (str, int) and key.choices:
        return Literal[key.choices]
    if kind is str and key.is_unit:
        return UnitName
    if kind is Target:
        return list[str]
    if is_dataclass(kind):
        return table(cast("Make", kind))
    if _is_union(kind):
        return Union[tuple(_schema(k, argument) for k in get_args(kind))]  # noqa: UP007
    if get_origin(kind) is Mapping:
        its_key, its_value = get_args(kind)
        return dict[_schema(its_key, argument), _schema(its_value, argument)]  # type: ignore[misc]
    if get_origin(kind) in (tuple, Sequence):
        inner, *rest = get_args(kind)
        fixed = len(rest) + 1 if rest and rest[0] is not Ellipsis else None
        most = fixed or key.most
        return Annotated[
            list[_schema(inner, argument)],  # type: ignore[misc]
            Field(min_length=fixed or key.least or None, max_length=most),
        ]
    return kind


@dataclass(frozen=True)
class _Reading:
    """The key that a value belongs to, of which entry, in which units, and where."""

    argument: Argument
    decides: Any
    units: Units
    place: Place

    @property
    def unit(self) -> str:
        unit = self.argument.key.unit
        return unit(self.decides) if callable(unit) else unit or "1"


def _value(kind: Any, read: _Reading, stated: Any) -> Any:
    """A value as the maker takes it."""
    if stated is None or (stated is False and read.argument.off):
        return None
    here = read.place.at(read.argument.name)
    if isinstance(stated, Value):
        return float(in_si(stated.value, stated.unit, read.unit, here, read.units))
    if isinstance(stated, Model):
        (make,) = (k for k in _members(kind) if is_dataclass(k))
        return built(cast("Make", make), stated, read.units, here)
    if isinstance(stated, Mapping):
        inner = get_args(kind)[1]
        return {k: _value(inner, replace(read, decides=k), v) for k, v in stated.items()}
    if isinstance(stated, list):
        if Target in _members(kind):
            return Target(tuple(stated))
        (inner,) = (get_args(k)[0] for k in _members(kind) if get_origin(k) in (tuple, Sequence))
        if is_dataclass(inner):
            listed = enumerate(stated)
            return tuple(built(cast("Make", inner), v, read.units, here.at(i)) for i, v in listed)
        return tuple(_value(inner, read, v) for v in stated)
    return float(stated) if kind is float else stated


def _is_union(kind: Any) -> bool:
    return get_origin(kind) in (Union, UnionType)


def _members(kind: Any) -> tuple[Any, ...]:
    return get_args(kind) if _is_union(kind) else (kind,)
