"""Serial arms in mechanism files: joints, base, tool, and instruments."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Annotated, Any

from loopcal.errors import InputError, placed, refuse_repeated
from loopcal.files.machines.attached import Instruments
from loopcal.files.machines.machine_type import ChainTable, MachineType, looked_at
from loopcal.files.toml.place import Place, Scope
from loopcal.keys import Key
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.serial import (
    NAME,
    Joint,
    base_names,
    parameter_keys,
    parameter_name,
    serial_arm,
    serial_machine,
    tool_names,
)

Length = Annotated[float | None, Key("Nominal length.", unit="m")]
Angle = Annotated[float | None, Key("Nominal angle.", unit="rad")]


@dataclass(frozen=True)
class ToolPoint:
    """The measured point in the last joint's frame."""

    x: Length = None
    y: Length = None
    z: Length = None


@dataclass(frozen=True)
class BasePlacement(ToolPoint):
    """Where the instrument sees the base: Tx Ty Tz Rz Ry Rx, six parameters base_x ... base_rx."""

    rz: Angle = None
    ry: Angle = None
    rx: Angle = None


@dataclass(frozen=True)
class NominalJoint(Joint):
    """A joint, with the nominal values that its form has; absent ones are 0."""

    a: Length = None
    d: Length = None
    alpha: Angle = None
    beta: Angle = None
    offset: Angle = None
    x: Length = None
    y: Length = None
    z: Length = None
    phix: Angle = None
    phiy: Angle = None
    phiz: Angle = None

    @property
    def joint(self) -> Joint:
        """The joint alone."""
        return Joint(**{one.name: getattr(self, one.name) for one in fields(Joint)})

    def nominal(self, number: int | str, place: Place) -> dict[str, float]:
        """Nominal values by parameter of the joint of this number, from 1, or of this body.

        Raises InputError for a value that its form does not have.
        """
        keys, stated = parameter_keys(self.form), _stated(self)
        for key in stated:
            if key not in keys:
                raise InputError(
                    f"a joint of the form {self.form!r} has no {key!r}",
                    code="missing-key",
                    place=str(place.at(key)),
                    remedy=f"its nominal values are {', '.join(keys)}",
                )
        return {parameter_name(self.form, key, number): value for key, value in stated.items()}


@dataclass(frozen=True)
class Serial(ChainTable):
    """A serial arm: a chain of joints, its tool point measured in the instrument's frame."""

    joint: Annotated[tuple[NominalJoint, ...], Key("From the base to the tip.", least=1)] = field(
        kw_only=True
    )
    name: Annotated[str, Key("Name of the machine.")] = NAME
    base: Annotated[
        bool | BasePlacement | None,
        Key(
            "Whether six parameters place the base in the instrument's frame, or their nominal "
            "values; by default they do unless all joints are transitions."
        ),
    ] = None
    tool: Annotated[ToolPoint, Key("The measured point in the last joint's frame.")] = field(
        default_factory=ToolPoint
    )
    point: Annotated[
        tuple[str, str, str] | None, Key("Names of the measured coordinates. Default: x, y, z.")
    ] = None
    fix_redundant: Annotated[bool, Key("As of a chain of joint origins, where asked for.")] = False
    instrument: Annotated[Instruments | None, Key("What is read of the machine's body.")] = None


def serial(stated: Serial, _: Any, scope: Scope, place: Place) -> Mechanism:
    """The arm of a table of the type "serial".

    Raises InputError at the joint, key or value that does not fit.
    """
    point = stated.point or ("x", "y", "z")
    refuse_repeated(
        [*(joint.name for joint in stated.joint), *point],
        "two quantities are named {!r}",
        place=lambda i: place.at(*(("joint", i, "name") if i < len(stated.joint) else ("point",))),
    )
    joints = [joint.joint for joint in stated.joint]
    nominal: dict[str, float] = {}
    for i, joint in enumerate(stated.joint):
        nominal |= joint.nominal(i + 1, place.at("joint", i))
    tool = dict(zip("xyz", tool_names(joints), strict=True))
    nominal |= {tool[axis]: value for axis, value in _stated(stated.tool).items()}
    if stated.instrument is not None:
        _refuse_base_and_point(stated, place)
        machine = serial_machine(joints, name=stated.name)
        return looked_at(machine, stated.instrument, scope, place, nominal)
    base = stated.base
    if isinstance(base, BasePlacement):
        values = _stated(base)
        names = {name: name.removeprefix("base_") for name in base_names()}
        nominal |= {name: values[key] for name, key in names.items() if key in values}
        base = True
    with placed(place):
        return serial_arm(joints, nominal, base=base, point=point, name=stated.name)


def _stated(value: NominalJoint | ToolPoint) -> dict[str, float]:
    """The nominal values that are stated, by key."""
    inherited = {one.name for one in fields(Joint)}
    keys = [one.name for one in fields(value) if one.name not in inherited]
    return {key: getattr(value, key) for key in keys if getattr(value, key) is not None}


def _refuse_base_and_point(stated: Serial, place: Place) -> None:
    for key in ("base", "point"):
        if getattr(stated, key) is not None:
            raise InputError(
                f"{key!r} is only for a file without [[instrument]]",
                code="conflicting-keys",
                place=str(place.at(key)),
                remedy="give it to an instrument (station, readings), with nominal values in "
                "[parameters]",
            )


TYPES = {"serial": MachineType(Serial, Serial, serial)}
