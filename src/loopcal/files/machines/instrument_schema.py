"""What a mechanism file may say of the instruments that look at a machine, type by type."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from loopcal.files.toml.model import Finite, Model

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


class SphericalInstrument(Model):
    """A tracker in its native readings: range, azimuth and elevation, in a plane without it."""

    type: Literal["spherical"]
    name: str = "tracker"
    readings: list[str] | None = Field(
        default=None, description="Their names; NAME_range, NAME_azimuth, NAME_elevation."
    )
    station: str | None = Field(
        default=None,
        description="Name of where it stands: six parameters STATION_x, _y, _z, _rz, _ry, _rx, in "
        "a plane _x, _y, _rz. Reflectors seen from one station name the same. By default that of "
        "the instrument.",
    )
    target: Target = "tool"
    offsets: bool = Field(
        default=False,
        description="Whether STATION_range_offset and STATION_elevation_offset are estimated.",
    )


class PoseInstrument(Model):
    """Where a frame fixed to the body is and how it is turned."""

    type: Literal["pose"]
    name: str = "pose"
    readings: list[str] | None = Field(
        default=None, description="Names of the coordinates; x, y, z (in a plane x, y)."
    )
    turns: list[str] | None = Field(
        default=None,
        description="Names of the small turns that the orientation is off by, whose sds are its "
        "noise; NAME_wx, NAME_wy, NAME_wz, read as 0. In a plane the name of the one angle that "
        "is read; NAME_phi.",
    )
    orientation: str = Field(
        default="quaternion",
        description='How the orientation is written: "quaternion" with w first, "rotation-vector", '
        'or three turns about moving axes such as "rz ry rx" for Rz Ry Rx.',
    )
    columns: list[str] | None = Field(
        default=None,
        description="Names of its numbers, which are known constants of each pose; qw, qx, qy, qz "
        "or rvx, rvy, rvz or those of the turns.",
    )
    station: Station = "base"
    target: Target = Field(
        default="tool",
        description="Name of the frame: six parameters TARGET_x, _y, _z, _rz, _ry, _rx; an empty "
        "list for the body's own frame.",
    )


Reading = Annotated[
    str | None, Field(description="Name of the reading; by default that of the instrument.")
]
Anchor = Annotated[
    str | None,
    Field(
        description="Name of the point fixed in the machine's base: parameters ANCHOR_x, _y, _z. "
        "By default that of the instrument."
    ),
]
Gap = Annotated[
    str | None,
    Field(description="Name of the gap, read as 0 unless the data have a column; NAME_gap."),
]


class DistanceInstrument(Model):
    """The distance of a point of the body from a point fixed in the base."""

    type: Literal["distance"]
    name: str = "distance"
    reading: Reading = None
    anchor: Anchor = None
    target: Target = "tool"
    offset: bool = Field(default=False, description="Whether NAME_offset is estimated.")


class DrawWire(Model):
    """A wire drawn from a point fixed in the base; NAME_offset is its unknown zero."""

    type: Literal["draw-wire"]
    name: str = "wire"
    reading: Reading = None
    anchor: Anchor = None
    target: Target = "tool"


class RelativeDistance(Model):
    """The distance of a point of the body from itself in another pose of the same row."""

    type: Literal["relative-distance"]
    name: str = "span"
    reading: Reading = None
    target: Target = "tool"


class BallBar(Model):
    """A bar of one length NAME_length between a ball in the base and one on the body."""

    type: Literal["ball-bar"]
    name: str = "bar"
    gap: Gap = None
    centre: Anchor = None
    target: Target = "tool"


class Sphere(Model):
    """Contact with a sphere of unknown place and radius NAME_radius."""

    type: Literal["sphere"]
    name: str = "sphere"
    gap: Gap = None
    centre: Anchor = None
    target: Target = "tool"


class Plane(Model):
    """Contact with a plane of unknown place: NAME_tilt_1, NAME_tilt_2, NAME_distance."""

    type: Literal["plane"]
    name: str = "plane"
    gap: Gap = None
    normal: Annotated[list[Finite], Field(min_length=3, max_length=3)] = Field(
        default=[0.0, 0.0, 1.0], description="Nominal direction of the normal, of any length."
    )
    target: Target = "tool"


class Socket(Model):
    """A ball on the body in a socket of unknown place: the same point NAME_x, _y, _z."""

    type: Literal["socket"]
    name: str = "socket"
    gaps: list[str] | None = Field(
        default=None, description="Names of the gaps, read as 0; NAME_gap_x, _y, _z."
    )
    target: Target = "tool"


AnyInstrument = Annotated[
    PointInstrument
    | SphericalInstrument
    | PoseInstrument
    | DistanceInstrument
    | DrawWire
    | RelativeDistance
    | BallBar
    | Sphere
    | Plane
    | Socket,
    Field(discriminator="type"),
]
Instruments = Annotated[
    list[AnyInstrument],
    Field(
        description="What is read of the machine's body. An empty list: nothing is, and the "
        "machine's own redundant sensors must do."
    ),
]
