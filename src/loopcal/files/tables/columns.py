"""Which column of a table is which quantity, in which unit, with which sd."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from typing import Annotated, Any

from loopcal.errors import InputError, nearest, placed, unknown_name
from loopcal.files.tables.table import ROW, Table
from loopcal.keys import Key
from loopcal.units import convertible, unit


@dataclass(frozen=True)
class Column:
    """Where one quantity stands in a file, and in which unit."""

    column: Annotated[
        str | int,
        Key(
            "Name of the column, its number from 1 (the only way where there is no header), or 0: "
            "the number of the row.",
            alone=True,
        ),
    ]
    unit: Annotated[
        str | None, Key("Unit of the readings; without one SI (m, rad).", is_unit=True)
    ] = None
    sd_column: Annotated[str | int | None, Key("Column with the sd of each reading.")] = None
    sd_unit: Annotated[
        str | None, Key("Unit of the sd; without one, that of the readings.", is_unit=True)
    ] = None
    coverage: Annotated[
        float | None,
        Key(
            "Coverage factor of that column, where it holds an expanded uncertainty: 2 for k = 2. "
            "The sd is the column divided by it.",
            positive=True,
        ),
    ] = None
    check: Annotated[bool, Key("false: the values are right though strange.")] = True

    def entry(self) -> dict[str, Any]:
        """As a project states it."""
        return {key: value for key, value in asdict(self).items() if value is not None}


ColumnLike = str | int | Mapping[str, Any] | Column


def specified(columns: Mapping[str, ColumnLike], units: Mapping[str, str]) -> dict[str, Column]:
    """Quantity -> its column, with the unit from `units` where the column states none.

    Raises InputError for an unknown key or unit, and for two units of one quantity. Raises it
    also for a unit of a quantity that is absent, and for an sd in a unit of another dimension.
    """
    if not columns:
        raise InputError(
            "no column is requested",
            code="missing-column",
            remedy="map at least one quantity to a column",
        )
    for quantity in units:
        if quantity not in columns:
            raise InputError(
                f"a unit is given for {quantity!r}, which has no column",
                code="conflicting-keys",
                remedy=nearest(quantity, columns),
            )
    return {q: _checked(q, _column(q, stated), units.get(q)) for q, stated in columns.items()}


def wanted(columns: Mapping[str, Column], pose: str | int | None) -> frozenset[str | int]:
    """All columns that have to be read."""
    named = [c.column for c in columns.values()] + [c.sd_column for c in columns.values()]
    return frozenset(column for column in [*named, pose] if column not in (None, ROW))


def all_numeric(
    table: Table, pose: str | int | None, units: Mapping[str, str]
) -> dict[str, Column]:
    """Every column of numbers but the ids, under its own name, else "column_1", "column_2", ..."""
    aside = None if pose is None else table.position(pose)
    columns: dict[str, ColumnLike] = {}
    for i in table.numeric():
        if i != aside:
            name = table.names[i] if table.names else ""
            columns[name or f"column_{i + 1}"] = name or i + 1
    if not columns:
        raise InputError(
            "there is no column of numbers",
            code="missing-column",
            place=table.name,
            remedy="check the delimiter and the decimal mark, or name the columns to read",
        )
    return specified(columns, units)


def refuse_doubles(table: Table, columns: Mapping[str, Column]) -> None:
    """Raise InputError where two quantities, or a reading and an sd, stand in one column."""
    user: dict[int, str] = {}
    for quantity, column in columns.items():
        other = user.setdefault(table.position(column.column), quantity)
        if other != quantity:
            raise InputError(
                f"column {column.column!r} is mapped twice: to {other!r} and {quantity!r}",
                code="duplicate-column",
                place=table.name,
                remedy="map each quantity to a different column",
            )
    for quantity, column in columns.items():
        reads = column.sd_column is not None and user.get(table.position(column.sd_column))
        if reads:
            raise InputError(
                f"column {column.sd_column!r} is mapped as the readings of {reads!r} and as the "
                f"sd of {quantity!r}",
                code="duplicate-column",
                place=table.name,
                remedy="name the column that holds the sd",
            )


def _column(quantity: str, stated: ColumnLike) -> Column:
    if isinstance(stated, Mapping):
        keys = [field.name for field in fields(Column)]
        for key in stated:
            if key not in keys:
                raise unknown_name(
                    f"unknown key {key!r}", str(key), keys, f"column of {quantity!r}"
                )
        if "column" not in stated:
            raise InputError(
                "the column is not named",
                code="missing-column",
                place=f"column of {quantity!r}",
                remedy='give column = "its name" or its number',
            )
        stated = Column(**stated)
    column = stated if isinstance(stated, Column) else Column(stated)
    for key, value in asdict(column).items():
        if key in ("column", "sd_column") and isinstance(value, bool | float):
            raise InputError(
                f"{key} is {value!r}",
                code="invalid-value",
                place=f"column of {quantity!r}",
                remedy="give a name, or a whole number from 1",
            )
    return column


def _checked(quantity: str, column: Column, other_unit: str | None) -> Column:
    place = f"column of {quantity!r}"
    if other_unit and column.unit and unit(other_unit) != unit(column.unit):
        raise InputError(
            f"two units are stated, {column.unit} and {other_unit}",
            code="wrong-unit",
            place=place,
            remedy="state one of them",
        )
    readings_unit = column.unit or other_unit
    with placed(place):
        sd_unit = column.sd_unit or readings_unit
        fits = not (readings_unit and sd_unit) or convertible(readings_unit, sd_unit)
        for name in (readings_unit, sd_unit):
            if name:
                unit(name)
    if not fits:
        raise InputError(
            f"the sd is in {sd_unit}, the readings in {readings_unit}",
            code="wrong-unit",
            place=place,
            remedy=f"give the sd in a unit of {unit(readings_unit or '1').dimension}",
        )
    if column.coverage is not None and not (column.sd_column and column.coverage > 0):
        raise InputError(
            f"coverage is {column.coverage}"
            + ("" if column.sd_column else ", and no column of sds is named"),
            code="invalid-value" if column.sd_column else "conflicting-keys",
            place=place,
            remedy='name sd_column = "...", and give coverage = 2 where it holds two sds',
        )
    return replace(column, unit=readings_unit)
