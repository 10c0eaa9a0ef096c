"""The [data.source] table: how the files of a user become the quantities of the project."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

from loopcal.files.project.names import QUANTITY
from loopcal.keys import Key

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
