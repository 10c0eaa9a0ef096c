"""What mechanism files may say of chains: URDF and joint origins, products of exponentials."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from loopcal.files.machines.effect_schema import MechanismModel
from loopcal.files.machines.instrument_schema import Instruments
from loopcal.files.machines.mechanism_parts import ParameterEntries, Units
from loopcal.files.toml.model import Finite, Model

Three = Annotated[list[Finite], Field(min_length=3, max_length=3)]
Two = Annotated[list[Finite], Field(min_length=2, max_length=2)]
Limits = Annotated[
    Two | None,
    Field(description="Of the reading, to look within them for what can be identified."),
]


class ChainModel(MechanismModel):
    """What chains of all types may say."""

    fix_redundant: bool = Field(
        default=True,
        description="Whether parameters are fixed whose effect on the readings others have "
        "already, chosen from the geometry; `loopcal check` says why each is.",
    )
    remarks: list[str] = Field(
        default=[], description="What `loopcal check` tells of it, as why a parameter is fixed."
    )


class MimicEntry(Model):
    """A joint that follows another: multiplier * reading + offset, in m and rad."""

    joint: str = Field(description="The quantity that is read.")
    multiplier: Finite = 1.0
    offset: Finite = 0.0
    kind: Literal["revolute", "continuous", "prismatic"] = Field(
        default="revolute", description="Of the joint that is read."
    )


class LinkJointEntry(Model):
    """A joint between two links: its origin in its parent's frame, and its axis."""

    name: str = Field(description="The quantity that is read; begins its parameters' names.")
    kind: Literal["revolute", "continuous", "prismatic", "fixed"] = "revolute"
    xyz: Three = Field(default=[0.0, 0.0, 0.0], description="Origin in the parent's frame.")
    rpy: Three = Field(default=[0.0, 0.0, 0.0], description="Roll, pitch and yaw of the origin.")
    axis: Three | None = Field(default=None, description="Unit vector in the joint's frame.")
    limits: Limits = None
    mimic: MimicEntry | None = None


class Urdf(ChainModel):
    """The chain of joints between two links of a robot, from its URDF or listed here."""

    type: Literal["urdf"]
    name: str | None = None
    units: Units = Field(default=Units(), description="Of the joints listed here.")
    file: str | None = Field(
        default=None,
        description="Path of the URDF, relative to this file; ${NAME} is replaced by the "
        "environment variable NAME.",
        examples=["robot.urdf"],
    )
    base: str | None = Field(default=None, description="Link that does not move.")
    tip: str | None = Field(default=None, description="Link that carries what is measured.")
    joint: list[LinkJointEntry] | None = Field(
        default=None, description="The chain itself, in place of a file."
    )
    axes: bool = Field(
        default=False,
        description="Whether the joints' axes have parameters too, two tilts NAME_axis_rx, ...; "
        "the origins alone hold every geometry.",
    )
    instrument: Instruments | None = None
    parameters: ParameterEntries = Field(default={})


class ScrewEntry(Model):
    """A joint by its axis in the base frame, all joints at zero."""

    name: str = Field(description="The quantity that is read; begins its parameters' names.")
    kind: Literal["revolute", "prismatic"] = "revolute"
    axis: Three = Field(description="Unit vector.")
    point: Three = Field(default=[0.0, 0.0, 0.0], description="A point on the axis.")
    limits: Limits = None


class HomePose(Model):
    """The tool's frame in the base frame, all joints at zero."""

    xyz: Three = Field(default=[0.0, 0.0, 0.0])
    rpy: Three = Field(default=[0.0, 0.0, 0.0], description="Roll, pitch and yaw.")


class Exponentials(ChainModel):
    """A serial machine as a product of exponentials: exp([S_1] q_1) ... exp([S_n] q_n) M."""

    type: Literal["exponentials"]
    name: str = "product of exponentials"
    units: Units = Units()
    joint: list[ScrewEntry] = Field(min_length=1, description="From the base to the tip.")
    home: HomePose = HomePose()
    instrument: Instruments | None = None
    parameters: ParameterEntries = Field(default={})
