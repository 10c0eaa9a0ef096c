"""A table is declared once: model, schema and value follow from the annotated fields."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any

import jsonschema
import pytest

from loopcal.files.toml.place import Place, Scope
from loopcal.files.toml.tables import read_tables, table
from loopcal.keys import CONTEXT, Key, Made
from tests.refusals import refused


def doubled(
    value: Annotated[float, Key("A number.", unit=CONTEXT, beside=True, alone=True)],
    unit: Annotated[str | None, Key("Of the number.", is_unit=True)] = None,
) -> float:
    """Twice a number."""
    return 2.0 * value


@dataclass(frozen=True)
class Part:
    """A part."""

    name: Annotated[str, Key("Its name.")]
    from_: Annotated[float, Key("A word of Python as a key.", unit="m")] = 0.5


@dataclass(frozen=True)
class Sample:
    """One key of every kind."""

    share: Annotated[float, Key("Above 0, below 1.", positive=True, below=1)] = 0.5
    count: Annotated[int, Key("From 1 to 9.", low=1, high=9)] = 1
    sd: Annotated[float | None, Key("An sd.", sd=True)] = None
    kind: Annotated[str, Key("A choice.", choices=("a", "b"))] = "a"
    length: Annotated[float | None, Key("In any unit.", unit="m")] = None
    warmth: Annotated[float | None, Key("Has a zero.", unit="K")] = None
    spread: Annotated[float | None, Key("Has none.", unit="K", difference=True)] = None
    place: Annotated[Part | None, Key("Another table.")] = None
    parts: Annotated[tuple[Part, ...], Key("A list of tables.", most=2)] = ()
    column: Annotated[str | int | None, Key("Name or number.")] = None
    flag: Annotated[bool | Part | None, Key("A flag or a table.")] = None
    named: Annotated[
        Mapping[str, Annotated[float, Made(doubled)]], Key("By name.", names="reading")
    ] = field(default_factory=dict)
    later: Annotated[
        Annotated[Mapping[str, Any], Made(doubled, later=True)] | None, Key("Kept.")
    ] = None


def _readings(name: str) -> Mapping[str, str]:
    known = {"x": "m", "q": "rad"}
    return known if name == "*" else {name: known[name]}


SCOPE = Scope(units={"length": "mm"}, names={"reading": _readings}, si="m")
PLACE = Place("sample.toml")


def made(**stated: Any) -> Any:
    (key,) = stated
    return read_tables(Sample, stated, PLACE).made(key, SCOPE)


@pytest.mark.parametrize(
    ("stated", "value"),
    [
        ({"length": 5.0}, 0.005),
        ({"length": {"value": 5.0, "unit": "m"}}, 5.0),
        ({"warmth": {"value": 20.0, "unit": "degC"}}, 293.15),
        ({"spread": {"value": 20.0, "unit": "degC"}}, 20.0),
        ({"sd": math.inf}, math.inf),
        ({"place": {"name": "a", "from": 20.0}}, Part("a", 0.02)),
        ({"parts": [{"name": "a"}]}, (Part("a"),)),
        ({"flag": False}, False),
        ({"flag": {"name": "a"}}, Part("a")),
        (
            {"named": {"x": 1.0, "q": {"value": 180.0, "unit": "deg"}}},
            {"x": 2e-3, "q": 2 * math.pi},
        ),
        ({"named": {"*": 1.0, "x": 3.0}}, {"x": 6e-3, "q": 2.0}),
        ({"later": {"value": 5.0}}, {"value": 0.005}),
    ],
)
def test_a_value_is_si_whatever_its_table_says(stated: dict[str, Any], value: Any) -> None:
    assert made(**stated) == (pytest.approx(value) if isinstance(value, dict | float) else value)
    jsonschema.validate(stated, table(Sample).model_json_schema(by_alias=True))


@pytest.mark.parametrize(
    ("stated", "code", "place"),
    [
        ({"share": 1.0}, "invalid-value", "share"),
        ({"share": 0.0}, "invalid-value", "share"),
        ({"count": 10}, "invalid-value", "count"),
        ({"sd": -1.0}, "invalid-value", "sd"),
        ({"kind": "c"}, "unknown-name", "kind"),
        ({"place": {"from": 1.0}}, "missing-key", "place"),
        ({"place": {"name": "a", "to": 1.0}}, "unknown-name", "place.to"),
        ({"parts": [{"name": "a"}] * 3}, "invalid-value", "parts"),
        ({"column": 1.5}, "invalid-value", "column"),
        ({"flag": {"nam": "a"}}, "unknown-name", "flag.nam"),
    ],
)
def test_what_is_not_declared_is_refused_at_its_place(
    stated: dict[str, Any], code: Any, place: str
) -> None:
    with refused(code, f"sample.toml: {place}"):
        made(**stated)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(stated, table(Sample).model_json_schema(by_alias=True))


def test_a_unit_that_does_not_fit_is_refused_where_it_stands() -> None:
    with refused("wrong-unit", "sample.toml: named.x.unit", "angle"):
        made(named={"x": {"value": 1.0, "unit": "deg"}})
    with refused("wrong-unit", "sample.toml: place.from", "angle"):
        made(place={"name": "a", "from": {"value": 1.0, "unit": "deg"}})
