"""What a mechanism file may say of the instruments that look at a machine, type by type."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from loopcal.files.model import Model

Station = Annotated[
    str | Literal[False],
    Field(
        description="Name of where the instrument stands: six parameters NAME_x, _y, _z, _rz, _ry, "
        "_rx, in a plane NAME_x, _y, _rz. Instruments that stand at one place name the same. "
        "false: coordinates are those of the machine's base."
    ),
]
Target = Annotated[
    str | list[str],
    Field(
        description="Name of the point of the body that is looked at: parameters NAME_x, _y, _z; "
        "or the names of its coordinates."
    ),
]


class PointInstrument(Model):
    """Coordinates of a point of the body, in the frame of a station."""

    type: Literal["point"]
    name: str = "point"
    readings: list[str] | None = Field(
        default=None, description="Names of the coordinates; x, y, z (in a plane x, y)."
    )
    station: Station = "base"
    target: Target = "tool"


AnyInstrument = PointInstrument
Instruments = Annotated[
    list[AnyInstrument],
    Field(
        description="What is read of the machine's body. An empty list: nothing is, and the "
        "machine's own redundant sensors must do."
    ),
]
