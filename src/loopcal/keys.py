"""Keys of tables in files that people write: the annotated arguments of what makes a value.

Each table is declared once, as a frozen dataclass or a function. Arguments annotated with a `Key`
are the keys of its table, with their types and defaults. An instrument, effect or machine has a
`type`, its name with hyphens. Reader, writer, JSON Schema and reference page follow from that
declaration.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass
from functools import cache
from types import NoneType
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import numpy as np

REQUIRED = inspect.Parameter.empty
CONTEXT = "context"
"""The unit of a number that follows from where it is: that of the quantity or parameter named."""


@dataclass(frozen=True)
class Key:
    """What a key says, and what its type leaves open.

    unit: SI unit of its numbers, for which a file may state another, or what gives it: for an
    entry, in a mapping for a key; or `CONTEXT`. beside: the file states the unit
    in the key `unit` of the same table. names: what the keys of a mapping name, by name or glob:
    what the reader knows under this word.

    least, most: entries of a list, least also of a mapping, or characters of a text; positive:
    numbers are larger than 0; low, high: bounds that a number may reach, below: one that it may
    not; sd: an sd, 0 or more, perhaps infinite; difference: a number without a zero, such as a
    step. choices: all that a text or whole number (in a mapping a key) can be; is_unit: the text is
    the name of a unit, perhaps of one dimension; alone: a table may be written as this value
    alone; example: for the schema.
    """

    says: str
    unit: str | Callable[[Any], str] | None = None
    beside: bool = False
    names: str = ""
    least: int = 0
    most: int | None = None
    positive: bool = False
    low: float | None = None
    high: float | None = None
    below: float | None = None
    sd: bool = False
    difference: bool = False
    choices: tuple[str | int, ...] = ()
    is_unit: bool | str = False
    alone: bool = False
    example: Any = None


@dataclass(frozen=True)
class Made:
    """Annotates a value that files state as the table of the function's keys that makes it.

    later: the value is the function's arguments, for callers who add others.
    """

    by: Callable[..., Any]
    later: bool = False


@dataclass(frozen=True)
class Argument:
    """An argument that is a key: its name, plain type, default (or `REQUIRED`), and its `Key`."""

    name: str
    kind: Any
    default: Any
    key: Key

    @property
    def written(self) -> str:
        """The name in files, where it may be a word of Python."""
        return self.name.removesuffix("_")

    @property
    def off(self) -> bool:
        """Whether files write `false` for None, because leaving the key out means the default."""
        kinds = get_args(self.kind)
        return NoneType in kinds and bool not in kinds and self.default is not None


@cache
def arguments(make: Callable[..., Any]) -> tuple[Argument, ...]:
    """The keys of what a function or dataclass makes, in their order."""
    hints = get_type_hints(make, include_extras=True)
    defaults = {n: p.default for n, p in inspect.signature(make).parameters.items()}
    for field in fields(make) if is_dataclass(make) else ():
        if field.default_factory is not MISSING:
            defaults[field.name] = field.default_factory()
    return tuple(
        Argument(name, _kind(kind, extras), default, key)
        for name, default in defaults.items()
        if get_origin(hints[name]) is Annotated
        for kind, *extras in [get_args(hints[name])]
        for key in extras
        if isinstance(key, Key)
    )


def _kind(kind: Any, extras: Iterable[Any]) -> Any:
    """The type with other annotations, which Python's nested ones put beside the key."""
    others = [extra for extra in extras if not isinstance(extra, Key)]
    for other in others:
        kind = Annotated[kind, other]
    return kind


def made(kind: Any) -> Made | None:
    """What makes a value of this type from a table of keys; None where no table states it."""
    if get_origin(kind) is Annotated:
        return next((extra for extra in get_args(kind) if isinstance(extra, Made)), None)
    return Made(kind) if isinstance(kind, type) and _has_keys(kind) else None


def _has_keys(kind: type) -> bool:
    return is_dataclass(kind) and bool(arguments(kind))


def type_name(make: Callable[..., Any]) -> str:
    """What files call the type: `draw_wire` is "draw-wire", `StationScales` "station-scales".

    >>> type_name(type_name)
    'type-name'
    """
    words = re.sub(r"(?<=[a-z])(?=[A-Z])", "-", make.__name__)
    return words.lower().replace("_", "-")


def by_type(makers: Iterable[Callable[..., Any]]) -> dict[str, Callable[..., Any]]:
    """The types of a registry by the names that files use."""
    return {type_name(make): make for make in makers}


def summary(make: Callable[..., Any]) -> str:
    """The first paragraph of a docstring, in one line."""
    paragraph = (inspect.getdoc(make) or "").split("\n\n")[0]
    return re.sub(r"\s+", " ", paragraph)


def described(make: Callable[..., Any], values: Mapping[str, Any]) -> dict[str, Any]:
    """The table of a mechanism file that makes the same with these arguments."""
    return {"type": type_name(make), **_table(make, values)}


def description(value: Any) -> dict[str, Any]:
    """The table of a mechanism file that makes this value, an instance of a dataclass."""
    return {"type": type_name(type(value)), **plain(value)}


def _table(make: Callable[..., Any], values: Mapping[str, Any]) -> dict[str, Any]:
    """Keys with their values as TOML has them; None is false or absent."""
    table = {}
    for argument in arguments(make):
        value = values.get(argument.name, REQUIRED)
        value = argument.default if value is REQUIRED else value
        if value is not None or argument.off:
            table[argument.name] = False if value is None else plain(value)
    return table


def plain(value: Any) -> Any:
    """A value as TOML has it: a dataclass is the table of its keys, or its first field."""
    # A dataclass without keys, such as `Target`, stands for its first field.
    if is_dataclass(value) and not isinstance(value, type):
        entries = {field.name: getattr(value, field.name) for field in fields(value)}
        return (
            _table(type(value), entries)
            if arguments(type(value))
            else plain(next(iter(entries.values())))
        )
    if isinstance(value, Mapping):
        return {key: plain(inner) for key, inner in value.items()}
    if isinstance(value, Sequence | np.ndarray) and not isinstance(value, str):
        return [plain(inner) for inner in value]
    return float(value) if isinstance(value, float) else value
