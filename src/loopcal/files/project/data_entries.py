"""The [data] table of a project: the files of readings, and which column is which quantity."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from loopcal.errors import InputError, listed, nearest
from loopcal.files.machines.parameter_entries import in_si
from loopcal.files.project.noise_entries import NoiseSpec
from loopcal.files.tables.columns import Column
from loopcal.files.toml.place import Place
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.units import unit

if TYPE_CHECKING:
    from loopcal.files.project.project_schema import DataEntry, FileEntry

_OPTIONS = ("pose", "sheet", "header", "delimiter", "decimal", "encoding", "variable")


@dataclass(frozen=True)
class DataSpec:
    """Where the readings are; see `project_data.load_dataset`.

    file: as written, relative to the project's folder; columns: quantity -> its column;
    sd_at_least: quantity -> smallest sd [SI] to believe; options: of `read_dataset`; joins:
    further files of the same poses; instruments: those without readings of their own that were
    used in this file.
    """

    file: str
    columns: Mapping[str, Column]
    sd_at_least: Mapping[str, float] = field(default_factory=dict)
    options: Mapping[str, Any] = field(default_factory=dict)
    joins: tuple[DataSpec, ...] = ()
    instruments: tuple[str, ...] = ()
    file_units: Mapping[str, str] = field(default_factory=dict)
    """Dimension -> unit of the columns that state none."""
    stream: bool | None = None
    """Whether to read in chunks; None: if the file is large."""


def data_files(entry: DataEntry, mechanism: Mechanism, noise: NoiseSpec, place: Place) -> DataSpec:
    """The files of readings; quantities of sd inf, and implied ones, may have no column.

    Raises InputError for a quantity that is none, a unit that does not fit, a quantity without a
    column and an instrument that is not there.
    """
    units = {**mechanism.quantities, **mechanism.known}
    joins = []
    for i, other in enumerate(entry.join):
        here = place.at("join", i)
        for name in other.instrument:
            known = [f.name for f in mechanism.families if implied_by(mechanism, f.name)]
            if name not in known:
                raise InputError(
                    f"there is no instrument {name!r} without readings",
                    code="unknown-name",
                    place=str(here.at("instrument")),
                    remedy=nearest(name, known) if known else "remove instrument",
                )
        joins.append(_file(other, units, here, instruments=tuple(other.instrument)))
    main = _file(entry, units, place, joins=tuple(joins))
    options = {**main.options, "exclude": entry.exclude, "every": entry.every}
    if not joins:
        unread = {q for q in units if noise.sd_of(q) == math.inf} | set(mechanism.implied)
        named = {q: Column(q, _unit(None, units[q], main.file_units)) for q in units}
        absent = {q: c for q, c in named.items() if q not in unread and q not in main.columns}
        main = replace(main, columns={**main.columns, **absent})
    return replace(main, options=options, stream=entry.stream)


def refuse_unread(
    read: Collection[str],
    mechanism: Mechanism,
    noise: NoiseSpec,
    place: Place,
    there: Collection[str] = (),
) -> None:
    """Raise InputError for a quantity that has to be read and is not; there: the file's columns."""
    for quantity in (*mechanism.quantities, *mechanism.known):
        if quantity in read or quantity in mechanism.implied:
            continue
        of = f", one of {listed(there, 40)}" if there else ""
        remedy = f'add {quantity} = "its column"{of}'
        if quantity in mechanism.known:
            raise InputError(
                f"no column is named for the known constant {quantity!r}",
                code="missing-column",
                place=str(place),
                remedy=f"{remedy}; every pose needs its value",
            )
        if noise.sd_of(quantity) != math.inf:
            raise InputError(
                f"no column is named for the quantity {quantity!r}",
                code="missing-column",
                place=str(place),
                remedy=f"{remedy}; if it is not measured, write "
                f"{quantity} = {{ sd = inf }} in [noise]",
            )


def implied_by(mechanism: Mechanism, instrument: str) -> tuple[str, ...]:
    """The readings that using an instrument implies; none where it reads something."""
    for family in mechanism.families:
        if family.name == instrument and set(family.readings) <= set(mechanism.implied):
            return family.readings
    return ()


def named_columns(
    spec: DataSpec, labels: tuple[str, ...], mechanism: Mechanism, elsewhere: Collection[str] = ()
) -> DataSpec:
    """The file with its columns that are named as quantities, beside those stated.

    elsewhere: quantities that another file is stated to hold.
    """
    units = {**mechanism.quantities, **mechanism.known}
    found = {q: Column(q, _unit(None, units[q], spec.file_units)) for q in units if q in labels}
    found = {q: column for q, column in found.items() if q not in elsewhere}
    return replace(spec, columns={**found, **spec.columns})


def _file(
    entry: FileEntry,
    units: Mapping[str, str],
    place: Place,
    *,
    joins: tuple[DataSpec, ...] = (),
    instruments: tuple[str, ...] = (),
) -> DataSpec:
    here = place.at("columns")
    file_wide = entry.units.by_dimension()
    columns: dict[str, Column] = {}
    least: dict[str, float] = {}
    for quantity, given in (entry.columns or {}).items():
        if quantity not in units:
            raise InputError(
                f"the mechanism has no quantity {quantity!r}",
                code="unknown-name",
                place=str(here.at(quantity)),
                remedy=nearest(quantity, units),
            )
        at = here.at(quantity)
        for key in ("unit", "sd_unit"):
            in_si(1.0, getattr(given, key), units[quantity], at.at(key))
        of_sds = (given.sd_unit, given.sd_at_least, given.coverage)
        if given.sd_column is None and any(stated is not None for stated in of_sds):
            raise InputError(
                "sd_unit, sd_at_least and coverage need a column of sds",
                code="conflicting-keys",
                place=str(at),
                remedy='name the column: sd_column = "..."',
            )
        stated = _unit(given.unit, units[quantity], file_wide)
        columns[quantity] = Column(
            given.column, stated, given.sd_column, given.sd_unit, given.coverage, given.check
        )
        if given.sd_at_least is not None:
            sd_unit = given.sd_unit or stated
            least[quantity] = in_si(
                given.sd_at_least, sd_unit, units[quantity], at, difference=True
            )
    return DataSpec(
        entry.file,
        columns,
        least,
        {key: getattr(entry, key) for key in _OPTIONS},
        joins,
        instruments,
        file_wide,
    )


def _unit(stated: str | None, si: str, file_wide: Mapping[str, str]) -> str | None:
    return stated or file_wide.get(unit(si).dimension)
