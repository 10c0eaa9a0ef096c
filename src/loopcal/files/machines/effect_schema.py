"""What a mechanism file may say of effects beyond geometry, type by type."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Discriminator, Field

from loopcal.files.machines.mechanism_parts import Amount
from loopcal.files.toml.model import Finite, Model, UnitName

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Joints = Annotated[list[str], Field(min_length=1, description="Joints by names or globs.")]
Changing = Annotated[list[str], Field(min_length=1, description="Parameters by names or globs.")]
Triple = Annotated[list[Finite], Field(min_length=3, max_length=3)]


class HarmonicsEffect(Model):
    """Gears and encoders that are not round: JOINT_cosK cos(K theta) + JOINT_sinK sin(K theta)."""

    type: Literal["harmonics"]
    name: str = "harmonics"
    joints: Joints = Field(default=["*"])
    orders: list[Positive] = Field(default=[1, 2], description="K, for each turn of the joint.")


class ScaleEffect(Model):
    """Joints whose readings have a scale of their own: 1 + JOINT_scale."""

    type: Literal["scale"]
    name: str = "scale"
    joints: Joints = Field(default=["*"])


class LoadEntry(Model):
    """A point of the arm that weighs something."""

    name: str
    joint: str = Field(description="The joint that it moves with.")
    point: Annotated[list[Amount], Field(min_length=3, max_length=3)] | None = Field(
        default=None, description="In the frame directly behind that joint's motion; its origin."
    )
    mass: Amount | None = Field(
        default=None, description="[kg]; without any, masses are estimated with the compliance."
    )


class ComplianceEffect(Model):
    """An arm that yields under its weight: joints, and parameters such as the tilt of an axis."""

    type: Literal["compliance"]
    name: str = "compliance"
    loads: list[LoadEntry] = Field(min_length=1)
    yielding: list[str] = Field(
        default=["*"],
        description="Joints and parameters by names or globs; alone, * means all turning joints.",
    )
    gravity: Triple = Field(
        default=[0, 0, -1],
        description="Where it pulls, in the base of the arm (of transitions: the instrument's).",
    )


class BacklashEffect(Model):
    """Play of a joint: the reading less JOINT_backlash times the direction of approach."""

    type: Literal["backlash"]
    name: str = "backlash"
    joints: Joints = Field(default=["*"])
    direction: str = Field(
        default="{joint}_direction",
        description="Known constant of each pose, +1, 0 or -1; {joint} is the joint's name.",
    )


class DriftEffect(Model):
    """Parameters that change in proportion to a known constant: P_drift over a span of it."""

    type: Literal["drift"]
    name: str = "drift"
    changing: Changing = Field(default=["base_*"])
    column: str = Field(default="t", description="The known constant, say a time or temperature.")
    unit: UnitName = Field(default="1", description="Of since and over.")
    since: Finite = Field(default=0, description="Where the drift is zero.")
    over: Positive = Field(default=1, description="The span in which it grows to P_drift.")


class ShiftEffect(Model):
    """Parameters that change at once: P_fromA from where a known constant reaches A."""

    type: Literal["shift"]
    name: str = "shift"
    changing: Changing
    at: list[Finite] = Field(min_length=1, description="Where each new segment begins, rising.")
    column: str = Field(default="pose", description="The known constant, say the pose's number.")
    unit: UnitName = Field(default="1", description="Of the segments' beginnings.")


AnyEffect = (
    HarmonicsEffect | ScaleEffect | ComplianceEffect | BacklashEffect | DriftEffect | ShiftEffect
)
Effects = Annotated[
    list[Annotated[AnyEffect, Discriminator("type")]],
    Field(description="What geometry does not explain; their parameters are zero where it does."),
]


class MechanismModel(Model):
    """What mechanisms of all types may say."""

    effect: Effects = Field(default=[])
