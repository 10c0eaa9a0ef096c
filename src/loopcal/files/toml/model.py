"""What files may say, as pydantic models, and pydantic's complaints in the words of this program.

A model forbids unknown keys and takes values as TOML typed them. `validated` turns the first
complaint into an InputError at its place in the file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, defer_build=True)

    @model_validator(mode="before")
    @classmethod
    def _refuse_unknown_keys(cls, data: Any) -> Any:
        known = [field.alias or name for name, field in cls.model_fields.items()]
        for key in data if isinstance(data, Mapping) else ():
            if key not in known:
                words = {"key": key, "words": f"unknown key {key!r}", "remedy": nearest(key, known)}
                raise PydanticCustomError("unknown_key", "{words}", words)
        return data


def complaint(words: str, remedy: str, code: Code = "invalid-value") -> PydanticCustomError:
    """An error for validators to raise, with its remedy and code."""
    said = {"words": words, "remedy": remedy, "code": code}
    return PydanticCustomError("complaint", "{words}", said)


def _known_unit(name: str) -> str:
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


@dataclass(frozen=True)
class OneOf:
    """Annotates a text that is one of these names."""

    names: tuple[str, ...]

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> CoreSchema:
        return core_schema.literal_schema([*self.names])


UnitName = Annotated[str, AfterValidator(_known_unit), Field(examples=["m", "mm", "rad", "deg"])]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Sd = Annotated[float, Field(ge=0), BeforeValidator(_sd)]
NameOrNumber = Annotated[str | int, BeforeValidator(_name_or_number)]


def plain_number_as(key: str, model: type[BaseModel]) -> BeforeValidator:
    """A validator that takes a bare number for a table of that model with this one key."""

    def table(value: Any) -> Any:
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if not number and not isinstance(value, Mapping | BaseModel):
            remedy = f'give a number, or a table such as {{ {key} = 1.0, unit = "mm" }}'
            raise complaint(f"{_short(value)} is given", remedy)
        return {key: value} if number else value

    return BeforeValidator(table, json_schema_input_type=(Sd if key == "sd" else float) | model)


def validated(model: type[Kind], data: Any, place: Place) -> Kind:
    """The data as that model.

    Raises InputError at the place of the first complaint, naming the others.
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
"""Of pydantic's kinds of complaints; all others are about a value."""


def input_error(details: Sequence[ErrorDetails], data: Any, place: Place) -> InputError:
    """pydantic's complaints about data, the first in full, at their place in the file."""
    paths = [_path(detail, data) for detail in details]
    message, remedy = _words(details[0], paths[0])
    others = [toml_path((*place.keys, *p)) for p in dict.fromkeys(paths) if p != paths[0]]
    if others:
        more = f" and {len(others) - 3} more" if len(others) > 3 else ""
        message += f" (also wrong: {', '.join(others[:3])}{more})"
    code: Code | None = details[0].get("ctx", {}).get("code") or _CODES.get(details[0]["type"])
    return InputError(message, code=code, place=str(place.at(*paths[0])), remedy=remedy)


def _path(detail: ErrorDetails, data: Any) -> tuple[str | int, ...]:
    """The keys of a complaint, without what pydantic adds for the members of a union."""
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
    """What is wrong, and what to do."""
    context, given = detail.get("ctx", {}), detail.get("input")
    match detail["type"]:
        case "unknown_key" | "complaint":
            return context["words"], context["remedy"]
        case "missing":
            return f"{str(detail['loc'][-1])!r} is missing", f"add {detail['loc'][-1]} = ..."
        case "literal_error":
            known = context["expected"].replace(" or ", ", ").replace("'", "").split(", ")
            return f"{given!r} is given", nearest(str(given), known)
        case "greater_than_equal" | "greater_than":
            least = context.get("ge", context.get("gt"))
            than = f"{least:g} or more" if "ge" in context else f"more than {least:g}"
            return f"{_short(given)} is given, which is too small", f"give {than}"
        case "less_than_equal" | "less_than":
            most = context.get("le", context.get("lt"))
            than = f"{most:,} or less" if "le" in context else f"less than {most:,}"
            return f"{_short(given)} is given, which is too large", f"give {than}"
        case "too_short":
            return f"{_short(given)} has too few entries", f"give {context['min_length']} or more"
        case "too_long":
            return f"{_short(given)} has too many entries", f"give {context['max_length']} or fewer"
    expected = _EXPECTED.get(detail["type"])
    if expected is None:
        return f"{_short(given)} is given: {detail['msg']}", "see `loopcal schema project`"
    return f"{_short(given)} is given, where {expected} is needed", f"give {expected}"


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
