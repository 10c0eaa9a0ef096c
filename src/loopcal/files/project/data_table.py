"""The [data] table of a project: the files of readings, and which column is which quantity."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, TypeVar

from loopcal.errors import InputError, listed, nearest
from loopcal.files.machines.parameter_entries import Units, by_dimension, in_si
from loopcal.files.project.names import QUANTITY
from loopcal.files.project.noise_table import Noises
from loopcal.files.tables.reader import Layout
from loopcal.files.tables.readers import Column
from loopcal.files.toml.place import Place
from loopcal.keys import Key
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.units import unit


@dataclass(frozen=True)
class DataColumn(Column):
    """Where the readings of a quantity stand."""

    sd_at_least: Annotated[
        float | None,
        Key(
            "Smallest sd to believe, in the unit of the sds: for columns that were rounded, where "
            "0 would call a reading exact.",
            sd=True,
        ),
    ] = None


@dataclass(frozen=True)
class _NamedColumns:
    """A file of readings, and the quantity of each column."""

    file: Annotated[
        str,
        Key(
            "One of the files of readings, by the ending of its name, or a folder of Parquet files "
            "or of a ROS bag; relative to the project; ${NAME} is replaced by the environment "
            "variable NAME.",
            example="poses.csv",
        ),
    ]
    pose: Annotated[
        str | int | None,
        Key(
            "Column of the pose ids; 0: the numbers of the rows, by which files are joined row by "
            "row. Without it poses count 1, 2, ..."
        ),
    ] = None
    units: Annotated[Units, Key("Units of the columns that state none; without it m and rad.")] = (
        field(default_factory=Units)
    )
    columns: Annotated[
        Mapping[str, DataColumn],
        Key(
            "Quantity = its column: a name, a number from 1, 0 for the number of the row, or a "
            "table; a quantity that is absent has the column of the same name.",
            names=QUANTITY,
            example={"theta_1": {"column": "S", "unit": "deg"}, "x": "x_tracker"},
        ),
    ] = field(default_factory=dict)


@dataclass(frozen=True)
class FileTable(Layout, _NamedColumns):
    """A file of readings, the quantity of each column, and how it is written."""

    @property
    def options(self) -> dict[str, Any]:
        """What `read_dataset` takes beside the columns."""
        return {"pose": self.pose, **self.keywords}

    def column(self, quantity: str, si: str) -> DataColumn:
        """The column of this name, in the unit of the file."""
        return DataColumn(quantity, by_dimension(self.units).get(unit(si).dimension))


@dataclass(frozen=True)
class JoinTable(FileTable):
    """One of several files. Pose ids join the files of `[[data.join]]`; each file of
    `[[data.file]]` has other poses."""

    instrument: Annotated[
        tuple[str, ...],
        Key(
            "Instruments without readings of their own (a ball in a socket, a probe on a plane) "
            "that were used in the poses of this file, and in no others."
        ),
    ] = ()
    where: Annotated[
        Mapping[str, str],
        Key(
            "Column = value of the rows that count; * stands for any letters.",
            example={"set": "upper*"},
        ),
    ] = field(default_factory=dict)


@dataclass(frozen=True)
class DataTable(FileTable):
    """Where the readings are, and which poses are left out.

    Either one file, to which pose ids may join others, or several files with different poses.
    """

    file: Annotated[  # type: ignore[assignment]
        str | tuple[JoinTable, ...],
        Key(
            "One of the files of readings, by the ending of its name, or a folder of Parquet files "
            "or of a ROS bag; relative to the project; ${NAME} is replaced by the environment "
            "variable NAME. Or tables of several files, each with its own poses.",
            example="poses.csv",
        ),
    ]
    exclude: Annotated[tuple[str | int, ...], Key("Ids of poses to leave out.")] = ()
    every: Annotated[int, Key("Keep the 1st, (every + 1)th, ... row.", low=1)] = 1
    stream: Annotated[
        bool | None,
        Key(
            "Parquet: whether poses are read in chunks, sweep by sweep, instead of being held in "
            "memory; by default from two million rows on, and for a folder of files."
        ),
    ] = None
    join: Annotated[
        tuple[JoinTable, ...], Key("Further files with readings of the same poses.")
    ] = ()
    source: Annotated[
        SourceTable | None,
        Key("How files in the layout of the user's first ones are read on later days."),
    ] = None
    flange: Annotated[
        tuple[str, ...],
        Key(
            "How `init` read the poses of the flange beside images, by which those of later days "
            "are read.",
            example=["inverted", "positions in mm"],
        ),
    ] = ()
    observe: Annotated[
        tuple[str, ...],
        Key(
            "Of a whole robot, its observations as `init` took them, by which files of later days "
            "are read.",
            example=["point name=tracker on=left_hand columns=x,y,z"],
        ),
    ] = ()

    @property
    def parts(self) -> tuple[FileTable, ...]:
        """This file and those joined to it, or all files with poses of their own."""
        return (self, *self.join) if isinstance(self.file, str) else self.file

    @property
    def apart(self) -> bool:
        """Whether there are several files with different poses."""
        return not isinstance(self.file, str)

    def columns_of(
        self, part: FileTable, labels: tuple[str, ...], mechanism: Mechanism
    ) -> FileTable:
        """One of the files with its columns that are named as quantities, beside those stated.

        Files with poses of their own may hold the same quantities, also in columns that are stated
        for all; of joined ones each has what no other is stated to hold.
        """
        if not self.apart:
            elsewhere = {q for other in self.parts for q in other.columns}
            return _named_columns(part, labels, mechanism, elsewhere)
        shared = {q: c for q, c in self.columns.items() if c.column in labels}
        part = replace(part, columns={**shared, **part.columns}, pose=part.pose or self.pose)
        return _named_columns(part, labels, mechanism, ())

    @property
    def options(self) -> dict[str, Any]:
        """What `read_dataset` takes beside the columns."""
        return {**super().options, "exclude": self.exclude, "every": self.every}


T = TypeVar("T", bound=FileTable)


def data_files(
    table: DataTable | None, mechanism: Mechanism, noise: Noises, place: Place
) -> DataTable | None:
    """The files with the columns of all quantities that are read, and their units.

    Quantities of sd inf, and implied ones, may have no column. Raises InputError for a unit that
    does not fit and for an instrument that is not there.
    """
    if table is None:
        return None
    units = mechanism.units
    main = _with_units(table, units, place)
    joins = _several(table.join, mechanism, place.at("join"))
    if not isinstance(table.file, str):
        if not table.file:
            raise InputError(
                "no file is named",
                code="missing-key",
                place=str(place.at("file")),
                remedy='name the file of readings: file = "poses.csv"',
            )
        if joins:
            raise InputError(
                "files with poses of their own and joined ones are named",
                code="conflicting-keys",
                place=str(place.at("join")),
                remedy="name all in [[data.file]], or join all to one: [data] file",
            )
        usual = [t if t.units != Units() else replace(t, units=table.units) for t in table.file]
        return replace(main, file=_several(usual, mechanism, place.at("file")))
    main = replace(main, join=joins)
    # Of several files only their headers show which one holds a quantity.
    if joins:
        return main
    unread = {q for q in units if noise.sd_of(q) == math.inf} | set(mechanism.implied)
    absent = [q for q in units if q not in unread and q not in main.columns]
    by_name = {q: main.column(q, units[q]) for q in absent}
    return replace(main, columns={**main.columns, **by_name})


def _several(
    tables: Sequence[JoinTable], mechanism: Mechanism, place: Place
) -> tuple[JoinTable, ...]:
    """Several files with the units of their columns.

    Raises InputError for an instrument that is not there, or reads something.
    """
    units = mechanism.units
    for i, other in enumerate(tables):
        for name in other.instrument:
            silent = [f.name for f in mechanism.families if implied_by(mechanism, f.name)]
            if name not in silent:
                raise InputError(
                    f"there is no instrument {name!r} without readings",
                    code="unknown-name",
                    place=str(place.at(i, "instrument")),
                    remedy=nearest(name, silent) if silent else "remove instrument",
                )
    return tuple(_with_units(table, units, place.at(i)) for i, table in enumerate(tables))


def refuse_unread(
    read: Collection[str],
    mechanism: Mechanism,
    noise: Noises,
    place: Place,
    labels: Collection[str] = (),
) -> None:
    """Raise InputError for a quantity that has to be read and is not.

    labels: of the file's columns.
    """
    for quantity in (*mechanism.quantities, *mechanism.pose_constants):
        if quantity in read or quantity in mechanism.implied:
            continue
        of = f", one of {listed(labels, 40)}" if labels else ""
        remedy = f'add {quantity} = "its column"{of}'
        if quantity in mechanism.pose_constants:
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


def _named_columns(
    table: T, labels: tuple[str, ...], mechanism: Mechanism, elsewhere: Collection[str]
) -> T:
    """The file with its columns that are named as quantities, beside those stated.

    elsewhere: quantities that another file is stated to hold.
    """
    units = mechanism.units
    named = [q for q in units if q in labels and q not in elsewhere]
    by_name = {q: table.column(q, units[q]) for q in named}
    return replace(table, columns={**by_name, **table.columns})


def _with_units(table: T, units: Mapping[str, str], place: Place) -> T:
    """The file with the units of its columns, and its smallest sds in SI."""
    columns = {}
    for quantity, column in table.columns.items():
        at, si = place.at("columns", quantity), units[quantity]
        for key in ("unit", "sd_unit"):
            # Converted only to refuse a unit that does not fit.
            in_si(1.0, getattr(column, key), si, at.at(key))
        of_sds = (column.sd_unit, column.sd_at_least, column.coverage)
        if column.sd_column is None and any(stated is not None for stated in of_sds):
            raise InputError(
                "sd_unit, sd_at_least and coverage need a column of sds",
                code="conflicting-keys",
                place=str(at),
                remedy='name the column: sd_column = "..."',
            )
        stated, least = column.unit or table.column(quantity, si).unit, column.sd_at_least
        if least is not None:
            least = in_si(least, column.sd_unit or stated, si, at, difference=True)
        columns[quantity] = replace(column, unit=stated, sd_at_least=least)
    return replace(table, columns=columns)


# The [data.source] table: how the files of a user become the quantities of the project.


_COLUMNS = "by header, or by number from 1 through the columns of numbers of all files"


@dataclass(frozen=True)
class SourceColumn:
    """A column of a joint, or of a known constant of each pose."""

    column: Annotated[str | int, Key(f"The column, {_COLUMNS}.")]
    unit: Annotated[str, Key("Its unit, where its header states none.", is_unit=True)]


@dataclass(frozen=True)
class SourceInstrument:
    """An instrument in one place, as the files hold its readings."""

    readings: Annotated[
        tuple[str, ...], Key("Quantities of the project that its columns become.", least=1)
    ]
    columns: Annotated[
        tuple[str | int, ...],
        Key(f"Columns of its point, its length or its range and angles, {_COLUMNS}.", least=1),
    ]
    unit: Annotated[str, Key("Unit of the lengths.", is_unit=True)]
    turns: Annotated[
        tuple[str | int, ...], Key("Columns of its orientation, in the order of the form.")
    ] = ()
    angle: Annotated[str | None, Key("Unit of the angles.", is_unit=True)] = None
    form: Annotated[
        str,
        Key(
            "Of an orientation: quaternion (w first), matrix (row by row), rotation-vector or an "
            "order of turns; of a range and two angles: zenith, clockwise or both.",
            example="rz ry rx",
        ),
    ] = ""
    inverted: Annotated[
        bool, Key("true: the pose is that of the station seen from the target.")
    ] = False
    station: Annotated[
        str | None, Key("Its label in the column of stations: other rows are not its own.")
    ] = None
    sd: Annotated[tuple[str | int, ...], Key("Columns of the sds of a point or length.")] = ()
    sd_unit: Annotated[str | None, Key("Unit of those sds; default: unit.", is_unit=True)] = None
    coverage: Annotated[
        float,
        Key(
            "Coverage factor of those columns, where they hold expanded uncertainties.",
            positive=True,
        ),
    ] = 1.0


@dataclass(frozen=True)
class SourceTable:
    """How files in the layout of the user's first ones become quantities."""

    columns: Annotated[
        Mapping[str, SourceColumn],
        Key(
            "Quantity of a joint, or known constant = its column, with its unit.",
            names=QUANTITY,
            example={"theta_1": {"column": "J1", "unit": "deg"}},
        ),
    ]
    instrument: Annotated[
        tuple[SourceInstrument, ...], Key("Instruments, each in one place.", least=1)
    ]
    stations: Annotated[str | int | None, Key("Column that says where the instrument stood.")] = (
        None
    )
    sheet: Annotated[
        str | None, Key("Sheet of a workbook, or variable of a MATLAB file; default: the largest.")
    ] = None
