"""The base of the pydantic models of files, and pydantic's errors as errors of loopcal.

A model refuses unknown keys and does not convert types. `validated` turns the first error into an
InputError with its place in the file.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, TypeVar

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    model_validator,
)
from pydantic_core import CoreSchema, ErrorDetails, PydanticCustomError, core_schema

from loopcal.errors import Code, InputError, nearest, short
from loopcal.files.toml.place import Place, toml_path
from loopcal.units import unit

Kind = TypeVar("Kind", bound=BaseModel)


class Model(BaseModel):
    """A table of a file."""

    # Built at first use: the start of a command counts, and it needs few of the tables.
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, defer_build=True)

    @model_validator(mode="before")
    @classmethod
    def _refuse_unknown_keys(cls, data: Any) -> Any:
        # pydantic's refusal of a key does not name the nearest one.
        keys = [field.alias or name for name, field in cls.model_fields.items()]
        for key in data if isinstance(data, Mapping) else ():
            if key not in keys:
                words = {"key": key, "words": f"unknown key {key!r}", "remedy": nearest(key, keys)}
                raise PydanticCustomError("unknown_key", "{words}", words)
        return data


def complaint(words: str, remedy: str, code: Code = "invalid-value") -> PydanticCustomError:
    """The error that a validator raises, with its remedy and code."""
    said = {"words": words, "remedy": remedy, "code": code}
    return PydanticCustomError("complaint", "{words}", said)


def _canonical_unit(name: str) -> str:
    try:
        return unit(name).name
    except InputError as error:
        raise complaint(error.message, error.remedy or "", error.code) from None


def _name_or_number(value: Any) -> Any:
    if isinstance(value, bool) or not isinstance(value, str | int):
        raise complaint(f"{_short(value)} is given", "give a name, or a whole number")
    return value


def _sd(value: Any) -> Any:
    if isinstance(value, int | float) and not value >= 0:
        words = f"the sd is {value}; an sd cannot be negative or NaN"
        raise complaint(words, "give 0 for exact, inf for unknown")
    return value


UnitName = Annotated[
    str, AfterValidator(_canonical_unit), Field(examples=["m", "mm", "rad", "deg"])
]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Sd = Annotated[float, Field(ge=0), BeforeValidator(_sd)]
NameOrNumber = Annotated[str | int, BeforeValidator(_name_or_number)]


def unit_name(dimension: str) -> Any:
    """The type of the name of a unit of this dimension."""

    def check(name: str) -> str:
        if unit(name).dimension != dimension:
            words = f"{name!r} is a unit of {unit(name).dimension}"
            raise complaint(words, f"give a unit of {dimension}")
        return name

    return Annotated[UnitName, AfterValidator(check)]


@dataclass(frozen=True)
class OrPlain:
    """Annotates a table that a file may also write as a plain value.

    as_table: converts a plain value to its table and returns a table unchanged; plain: the JSON
    types of plain values; positive: whether numbers must be 0 or more. (pydantic's own
    `json_schema_input_type` names the table's model twice, which fails in pydantic 2.10 and 2.11.)
    """

    as_table: Callable[[Any], Any]
    plain: tuple[str, ...]
    positive: bool = False

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> CoreSchema:
        return core_schema.no_info_before_validator_function(self.as_table, handler(source))

    def __get_pydantic_json_schema__(self, schema: Any, handler: Any) -> dict[str, Any]:
        least = {"minimum": 0} if self.positive else {}
        return {"anyOf": [*({**least, "type": kind} for kind in self.plain), handler(schema)]}


_KINDS = {float: "number", str: "string", int: "integer"}


def alone_as(key: str, *kinds: type, example: object = None, positive: bool = False) -> OrPlain:
    """Annotates a table that may be written as the bare value of this one key.

    kinds: of bare values, by default numbers; example: for messages.
    """
    bare = tuple(kinds) if kinds and float not in kinds else (int, float)
    such = f'such as {{{{ {key} = 1.0, unit = "mm" }}}}' if float in bare else f"with {key}"

    def table(value: Any) -> Any:
        if isinstance(value, bare) and not isinstance(value, bool):
            return {key: value}
        if not isinstance(value, Mapping | BaseModel):
            word = "a number" if float in bare else f"a name, say {example!r}"
            raise complaint(f"{_short(value)} is given", f"give {word}, or a table {such}")
        return value

    return OrPlain(table, tuple(_KINDS[kind] for kind in kinds or (float,)), positive)


class Value(Model):
    """A number with its unit."""

    value: Finite
    unit: UnitName | None = None


def validated(model: type[Kind], data: Any, place: Place) -> Kind:
    """Validate data as an instance of a model.

    Raises InputError at the place of the first error; its message names the places of others.
    """
    try:
        return model.model_validate(data)
    except ValidationError as error:
        details = error.errors(include_url=False)
        raise input_error(details, data, place) from None
    except RecursionError:
        raise InputError(
            "the tables are nested too deeply",
            code="invalid-syntax",
            place=str(place),
            remedy="flatten them",
        ) from None


_CODES: dict[str, Code] = {
    "unknown_key": "unknown-name",
    "missing": "missing-key",
    "literal_error": "unknown-name",
}
"""Codes of pydantic's types of errors; all others are `invalid-value`."""


def input_error(details: Sequence[ErrorDetails], data: Any, place: Place) -> InputError:
    """Convert pydantic's errors: the first in full, the places of up to three others."""
    paths = [_path(detail, data) for detail in details]
    message, remedy = _words(details[0], paths[0])
    others = [toml_path((*place.keys, *p)) for p in dict.fromkeys(paths) if p != paths[0]]
    if others:
        more = f" and {len(others) - 3} more" if len(others) > 3 else ""
        message += f" (also wrong: {', '.join(others[:3])}{more})"
    code: Code | None = details[0].get("ctx", {}).get("code") or _CODES.get(details[0]["type"])
    return InputError(message, code=code, place=str(place.at(*paths[0])), remedy=remedy)


def _path(detail: ErrorDetails, data: Any) -> tuple[str | int, ...]:
    """The keys that lead to an error, without those that pydantic adds for members of a union."""
    path: list[str | int] = []
    for key in detail["loc"]:
        inside = isinstance(data, Mapping) and key in data
        inside = inside or (isinstance(data, list) and isinstance(key, int) and key < len(data))
        if inside:
            path.append(key)
            data = data[key]
    if detail["type"] == "unknown_key":
        path.append(detail["ctx"]["key"])
    return tuple(path)


def _words(detail: ErrorDetails, path: Sequence[str | int]) -> tuple[str, str]:
    """The message and the remedy."""
    context, value = detail.get("ctx", {}), detail.get("input")
    match detail["type"]:
        case "unknown_key" | "complaint":
            return context["words"], context["remedy"]
        case "missing":
            return f"{str(detail['loc'][-1])!r} is missing", f"add {detail['loc'][-1]} = ..."
        case "literal_error":
            # pydantic writes choices as 'a', 'b' or 'c'.
            choices = context["expected"].replace(" or ", ", ").replace("'", "").split(", ")
            return f"{value!r} is given", nearest(str(value), choices)
        case "greater_than_equal" | "greater_than":
            least = context.get("ge", context.get("gt"))
            than = f"{least:g} or more" if "ge" in context else f"more than {least:g}"
            return f"{_short(value)} is given, which is too small", f"give {than}"
        case "less_than_equal" | "less_than":
            most = context.get("le", context.get("lt"))
            than = f"{most:,} or less" if "le" in context else f"less than {most:,}"
            return f"{_short(value)} is given, which is too large", f"give {than}"
        case "too_short":
            return f"{_short(value)} has too few entries", f"give {context['min_length']} or more"
        case "too_long":
            return f"{_short(value)} has too many entries", f"give {context['max_length']} or fewer"
    expected = _EXPECTED.get(detail["type"])
    if expected is None:
        return f"{_short(value)} is given: {detail['msg']}", "see `loopcal schema project`"
    return f"{_short(value)} is given, where {expected} is needed", f"give {expected}"


_EXPECTED = {
    "string_type": 'a text in quotes, "like this"',
    "float_type": "a number",
    "finite_number": "a finite number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "bool_type": "true or false",
    "list_type": "a list [ ... ]",
    "dict_type": "a table",
    "model_type": "a table",
    "dataclass_type": "a table",
    "tuple_type": "a list [ ... ]",
    "model_attributes_type": "a table",
    "mapping_type": "a table",
}


def _short(value: Any) -> str:
    return short(repr(value))
