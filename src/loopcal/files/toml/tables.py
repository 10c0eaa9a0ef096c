"""Tables of files from the declarations of `loopcal.keys`: model with schema, and the value made.

A list stands for a tuple, `false` for None where leaving the key out means something else, a
dataclass without keys for its first field, and a number with a unit may be written as a table.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cache, reduce
from operator import or_
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, cast, get_args, get_origin, get_type_hints

from pydantic import (
    BaseModel,
    Discriminator,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    Tag,
    TypeAdapter,
    create_model,
)
from pydantic_core import CoreSchema, PydanticKnownError, core_schema

from loopcal.errors import InputError, nearest, placed
from loopcal.files.machines.parameter_entries import in_si
from loopcal.files.toml.model import (
    Finite,
    Model,
    NameOrNumber,
    OrPlain,
    Sd,
    UnitName,
    Value,
    alone_as,
    complaint,
    unit_name,
    validated,
)
from loopcal.files.toml.place import NOTHING, Place, Scope
from loopcal.keys import CONTEXT, REQUIRED, Argument, Key, arguments, made, summary, type_name

Make = Callable[..., Any]


@cache
def table(make: Make, suffix: str = "", common: Make | None = None) -> type[Any]:
    """The model of the table that states the keys of a maker, and those that it has in common.

    suffix: ends the name of the model; with one the table states its `type`.
    """
    words = make.__qualname__.replace(".", "_").split("_")
    name = "".join(word[:1].upper() + word[1:] for word in words) + suffix
    keys: dict[str, Any] = {"type": (Literal[type_name(make)], ...)} if suffix else {}
    for one in (make,) if common is None else (common, make):
        keys |= {argument.name: _field(argument) for argument in arguments(one)}
    return create_model(name, __base__=Model, __doc__=summary(make), **keys)


@dataclass(frozen=True)
class Tables:
    """A file, or a table, that was checked against what declares its keys.

    What they state is made key by key, for one may need what another gives.
    """

    make: Make
    entry: Any
    place: Place

    def made(self, name: str, scope: Scope = NOTHING) -> Any:
        """What is stated under this key, SI.

        Raises InputError for a unit that does not fit, and a name that is none.
        """
        a = next(a for a in arguments(self.make) if a.name == name)
        at = _Reading(a.key, self.entry, self.entry, scope, self.place.at(a.written))
        return _value(a.kind, at, getattr(self.entry, name), a.off)

    def listed(self, name: str, make: Make) -> tuple[Tables, ...]:
        """The tables of a list under this key, not made yet."""
        entries = enumerate(getattr(self.entry, name))
        return tuple(Tables(make, entry, self.place.at(name, i)) for i, entry in entries)


def read_tables(make: Make, data: Any, place: Place) -> Tables:
    """The tables of a file. Raises InputError at the place of what is not declared."""
    return Tables(make, validated(table(make), data, place), place)


def stated_arguments(make: Make, entry: Any, scope: Scope, place: Place) -> dict[str, Any]:
    """What an entry states for all arguments of a maker; see `Tables.made`."""
    tables = Tables(make, entry, place)
    return {a.name: tables.made(a.name, scope) for a in arguments(make)}


def built(make: Make, entry: Any, scope: Scope, place: Place, **more: Any) -> Any:
    """What a maker makes of an entry, and of further arguments that no file states.

    Raises InputError at the entry where it does not fit.
    """
    with placed(place, unless_stated=True):
        return make(**stated_arguments(make, entry, scope, place), **more)


def _field(argument: Argument) -> Any:
    kind, default, key = form(argument.kind, argument.key), argument.default, argument.key
    if argument.off:
        kind = reduce(or_, [k for k in _members(kind) if k is not NoneType]) | Literal[False]
    if isinstance(default, tuple | Mapping):
        default = dict(default) if isinstance(default, Mapping) else list(default)
    elif is_dataclass(default) and not isinstance(default, type):
        default = {}  # validated, it is the table with its own defaults
    stated = ... if default is REQUIRED else default
    alias = argument.written if argument.written != argument.name else None
    examples = None if key.example is None else [key.example]
    more: dict[str, Any] = {"alias": alias, "description": key.says, "examples": examples}
    return (kind, Field(stated, validate_default=default == {}, **more))


def form(kind: Any, key: Key) -> Any:
    """The type of a key in a file."""
    if kind is float:
        return Annotated[Value, alone_as("value")] if key.unit and not key.beside else _number(key)
    if kind in (str, int) and key.choices:
        return Literal[key.choices]
    if kind is int:
        return Annotated[int, Field(ge=key.low, le=key.high)]
    if kind is str and key.least:
        return Annotated[str, Field(min_length=key.least)]
    if kind is str and key.is_unit:
        return unit_name(key.is_unit) if isinstance(key.is_unit, str) else UnitName
    if kind == str | int:
        return NameOrNumber
    if by := made(kind):
        bare = [_alone(a) for a in arguments(by.by) if a.key.alone]
        return Annotated[table(by.by), bare[0]] if bare else table(by.by)
    if is_dataclass(kind):
        return form(_first(kind), key)
    if _is_union(kind):
        members = get_args(kind)
        if bool in members and (by := next((m for m in map(made, members) if m), None)):
            tags = (Annotated[bool, Tag("flag")], Annotated[table(by.by), Tag("table")])
            either: Any = Annotated[reduce(or_, tags), Discriminator(_flag_or_table)]
            return either | None if NoneType in members else either
        if {str, int} <= {*members}:
            # Name or number is one form; apart, each would be tried with its strict type.
            members = (str | int, *(k for k in members if k not in (str, int)))
        return Union[tuple(form(k, key) for k in members)]  # noqa: UP007
    if get_origin(kind) is Mapping:
        key_kind, value_kind = get_args(kind)
        named = str if not key.choices else form(key_kind, key)
        inner = form(value_kind, replace(key, choices=(), least=0))
        return Annotated[dict[named, inner], Field(min_length=key.least or None)]  # type: ignore[valid-type]
    if get_origin(kind) in (tuple, Sequence):
        inner, *rest = get_args(kind)
        fixed = len(rest) + 1 if rest and rest[0] is not Ellipsis else None
        most = fixed or key.most
        return Annotated[
            list[form(inner, replace(key, least=0))],  # type: ignore[misc]
            Field(min_length=fixed or key.least or None, max_length=most),
        ]
    return kind


def _flag_or_table(value: Any) -> str:
    return "flag" if isinstance(value, bool) else "table"


def _alone(argument: Argument) -> OrPlain:
    kinds = [kind for kind in _members(argument.kind) if kind is not NoneType]
    key = argument.key
    return alone_as(argument.written, *kinds, example=key.example, positive=key.sd)


def _number(key: Key) -> Any:
    if key.sd:
        return Sd
    low = 0 if key.positive else None
    bounds = Field(gt=low, ge=key.low, le=key.high, lt=key.below, allow_inf_nan=False)
    return Annotated[float, bounds] if any((key.positive, key.below)) or key.low else Finite


@dataclass(frozen=True)
class _Reading:
    """The key that a value belongs to, of which entry, and where.

    decides: what gives the unit, the entry or in a mapping the key.
    """

    key: Key
    entry: Any
    decides: Any
    scope: Scope
    place: Place

    def number(self, number: float, stated: str | None, place: Place) -> float:
        unit, finite = self.key.unit, math.isfinite(number)
        si = unit(self.decides) if callable(unit) else self.scope.si if unit == CONTEXT else unit
        difference, units = self.key.sd or self.key.difference, self.scope.units
        value = float(in_si(number, stated, si or "1", place, units, difference=difference))
        # A finite number may overflow in SI.
        remedy = "give less" if finite and not math.isfinite(value) else ""
        if self.key.positive and not value > 0.0:
            remedy = "give more than 0"
        if remedy:
            raise InputError(
                f"{number!r} is given", code="invalid-value", place=str(self.place), remedy=remedy
            )
        return value

    def named(self, name: str, place: Place) -> Mapping[str, str]:
        with placed(place):
            return self.scope.names[self.key.names](name)


def _value(kind: Any, read: _Reading, stated: Any, off: bool = False) -> Any:
    """A value as the maker takes it."""
    if stated is None or (stated is False and off):
        return None
    if isinstance(stated, Value):
        return read.number(stated.value, stated.unit, read.place)
    if isinstance(stated, Model):
        return _made(kind, read, stated)
    if isinstance(stated, Mapping):
        return _mapping(get_args(kind)[1], read, stated)
    if isinstance(stated, list):
        return _listed(kind, read, stated)
    if read.key.beside and isinstance(stated, float):
        entry = read.entry
        at = Place(read.place.file, read.place.keys[:-1]).at("unit")
        return read.number(stated, entry.unit, at)
    if read.key.names and isinstance(stated, str):
        read.named(stated, read.place)
    return float(stated) if kind is float else stated


def _made(kind: Any, read: _Reading, stated: Model) -> Any:
    by = next((m for m in map(made, _members(kind)) if m), None)
    if by is None:
        return stated
    si = read.key.unit
    scope = replace(read.scope, si=si) if isinstance(si, str) and si != CONTEXT else read.scope
    if by.later:
        stated_only = stated_arguments(by.by, stated, scope, read.place).items()
        return {name: value for name, value in stated_only if value is not None}
    return built(by.by, stated, scope, read.place)


def _mapping(kind: Any, read: _Reading, stated: Mapping[Any, Any]) -> dict[Any, Any]:
    """By keys, or by the names that these stand for; later ones win."""
    by_name: dict[Any, Any] = {}
    for key, value in stated.items():
        at = replace(read, decides=key, place=read.place.at(key))
        if not read.key.names:
            by_name[key] = _value(kind, at, value)
            continue
        for name, si in read.named(key, at.place).items():
            by_name[name] = _value(kind, replace(at, scope=replace(at.scope, si=si)), value)
    return by_name


def _listed(kind: Any, read: _Reading, stated: list[Any]) -> Any:
    for bare in _members(kind):
        if is_dataclass(bare):
            return cast("Make", bare)(_listed(_first(bare), read, stated))
    (inner,) = (get_args(k)[0] for k in _members(kind) if get_origin(k) in (tuple, Sequence))
    if made(inner):
        places = (replace(read, place=read.place.at(i)) for i in range(len(stated)))
        return tuple(_value(inner, at, v) for at, v in zip(places, stated, strict=True))
    return tuple(_value(inner, read, v) for v in stated)


def _first(kind: Any) -> Any:
    """The type of a dataclass's first field, as which it is written."""
    return get_type_hints(kind)[fields(kind)[0].name]


def _is_union(kind: Any) -> bool:
    return get_origin(kind) in (Union, UnionType)


def _members(kind: Any) -> tuple[Any, ...]:
    return get_args(kind) if _is_union(kind) else (kind,)


@dataclass(frozen=True)
class ByType:
    """Annotates a table that is of one of several types.

    kinds: names of the types; model: the model of a type, or KeyError for what is none; named: the
    type of a table, where it is not what the key `type` says.
    """

    kinds: Callable[[], Iterable[str]]
    model: Callable[[str], type[BaseModel]]
    named: Callable[[Any], str] | None = None

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(self._validated)

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        tables: list[Any] = [Annotated[self.model(kind), Tag(kind)] for kind in self.kinds()]
        one_of: Any = reduce(or_, tables)
        adapter: Any = TypeAdapter(Annotated[one_of, Discriminator(self.named or "type")])
        return handler(adapter.core_schema)

    def _validated(self, table: Any) -> BaseModel:
        if not isinstance(table, Mapping):
            raise PydanticKnownError("dict_type")
        if self.named is None and "type" not in table:
            raise complaint("'type' is missing", 'add type = "..."', "missing-key")
        kind = str(self.named(table) if self.named else table["type"])
        try:
            model = self.model(kind)
        except KeyError:
            remedy = nearest(kind, self.kinds())
            raise complaint(f"the type {kind!r} is not known", remedy, "unknown-name") from None
        return model.model_validate(table)
