"""Serial arms in mechanism files: joints, base, tool, and instruments."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag

from loopcal.errors import InputError
from loopcal.files.machines.entries import given, table
from loopcal.files.machines.instruments import Instruments
from loopcal.files.machines.machine_type import ChainModel, MachineType, looked_at
from loopcal.files.machines.mechanism_parts import Amount, Value
from loopcal.files.machines.parameter_entries import in_si
from loopcal.files.toml.model import Model
from loopcal.files.toml.place import Place
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.serial import (
    NAME,
    Joint,
    base_names,
    parameter_keys,
    serial_arm,
    serial_machine,
    tool_names,
)
from loopcal.mechanisms.serial import parameter_name as serial_name


class BasePlacement(Model):
    """Where the instrument sees the base: Tx Ty Tz Rz Ry Rx, six parameters base_x ... base_rx."""

    x: Amount | None = None
    y: Amount | None = None
    z: Amount | None = None
    rz: Amount | None = None
    ry: Amount | None = None
    rx: Amount | None = None


class ToolPoint(Model):
    """The measured point in the last joint's frame."""

    x: Amount | None = None
    y: Amount | None = None
    z: Amount | None = None


class NominalJoint(Model):
    """A joint, with the nominal values that its form has; absent ones are 0."""

    a: Amount | None = None
    d: Amount | None = None
    alpha: Amount | None = None
    beta: Amount | None = None
    offset: Amount | None = None
    x: Amount | None = None
    y: Amount | None = None
    z: Amount | None = None
    phix: Amount | None = None
    phiy: Amount | None = None
    phiz: Amount | None = None

    def nominal(self) -> dict[str, Value]:
        """The nominal values given, by key."""
        values = {key: getattr(self, key) for key in NominalJoint.model_fields}
        return {key: value for key, value in values.items() if value is not None}


def _base_form(value: Any) -> str:
    return "flag" if isinstance(value, bool) else "placement"


if TYPE_CHECKING:
    Joints = list[Any]
else:
    Joints = list[table(Joint, base=NominalJoint)]


class Serial(ChainModel):
    """A serial arm: a chain of joints, its tool point measured in the instrument's frame."""

    type: Literal["serial"]
    name: str = NAME
    base: (
        Annotated[
            Annotated[bool, Tag("flag")] | Annotated[BasePlacement, Tag("placement")],
            Discriminator(_base_form),
        ]
        | None
    ) = Field(
        default=None,
        description="Whether six parameters place the base in the instrument's frame, or their "
        "nominal values; by default they do unless all joints are transitions.",
    )
    tool: ToolPoint = ToolPoint()
    point: Annotated[list[str], Field(min_length=3, max_length=3)] = Field(
        default=["x", "y", "z"], description="Names of the measured coordinates."
    )
    joint: Joints = Field(min_length=1, description="From the base to the tip.")
    fix_redundant: bool = Field(
        default=False, description="As of a chain of joint origins, where it is asked for."
    )
    instrument: Instruments | None = None


def serial(model: Serial, units: Mapping[str, str], place: Place) -> Mechanism:
    """The arm of a table of the type "serial".

    Raises InputError at the joint, key or value that does not fit.
    """
    _refuse_repeated([joint.name for joint in model.joint], model.point, place)
    joints, nominal = [], {}
    for i, entry in enumerate(model.joint):
        here = place.at("joint", i)
        joints.append(Joint(**given(Joint, entry, units, here)))
        keys = parameter_keys(entry.form)
        for key, value in entry.nominal().items():
            if key not in keys:
                raise InputError(
                    f"a joint of the form {entry.form!r} has no {key!r}",
                    code="missing-key",
                    place=str(here.at(key)),
                    remedy=f"its nominal values are {', '.join(keys)}",
                )
            si = "rad" if key in ("alpha", "beta", "offset") or key.startswith("phi") else "m"
            nominal[serial_name(entry.form, key, i + 1)] = _si(value, si, units, here.at(key))
    tool = dict(zip("xyz", tool_names(joints), strict=True))
    for axis, name in tool.items():
        stated = getattr(model.tool, axis)
        if stated is not None:
            nominal[name] = _si(stated, "m", units, place.at("tool", axis))
    if model.instrument is not None:
        _refuse_own_point(model, place)
        machine = serial_machine(joints, name=model.name)
        return looked_at(machine, model.instrument, units, place, nominal)
    base = model.base if isinstance(model.base, bool | None) else True
    if not isinstance(model.base, bool | None):
        nominal |= _base(model.base, units, place.at("base"))
    x, y, z = model.point
    try:
        return serial_arm(joints, nominal, base=base, point=(x, y, z), name=model.name)
    except InputError as error:
        raise error.at(str(place)) from None


def _refuse_own_point(model: Serial, place: Place) -> None:
    for key in ("base", "point"):
        if key in model.model_fields_set:
            raise InputError(
                f"{key!r} is only for a file without [[instrument]]",
                code="conflicting-keys",
                place=str(place.at(key)),
                remedy="give it to an instrument (station, readings), with nominal values in "
                "[parameters]",
            )


def _base(given: BasePlacement, units: Mapping[str, str], place: Place) -> dict[str, float]:
    found = {}
    for name in base_names():
        key = name.removeprefix("base_")
        value = getattr(given, key)
        if value is not None:
            found[name] = _si(value, "rad" if key.startswith("r") else "m", units, place.at(key))
    return found


def _si(value: Value, si: str, units: Mapping[str, str], place: Place) -> float:
    number = in_si(value.value, value.unit, si, place, units)
    if not math.isfinite(number):
        raise InputError(
            f"{value.value!r} is given", code="invalid-value", place=str(place), remedy="give less"
        )
    return number


def _refuse_repeated(joints: list[str], point: list[str], place: Place) -> None:
    seen: set[str] = set()
    for i, name in enumerate([*joints, *point]):
        if name in seen:
            here = place.at("joint", i, "name") if i < len(joints) else place.at("point")
            raise InputError(
                f"two quantities are named {name!r}",
                code="duplicate-name",
                place=str(here),
                remedy="give each a unique name",
            )
        seen.add(name)


TYPES = {
    "serial": MachineType(Serial, serial),
}
