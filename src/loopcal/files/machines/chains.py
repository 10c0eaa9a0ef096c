"""Chains in mechanism files: joint origins, of a URDF or listed, and products of exponentials."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field

from loopcal.errors import InputError
from loopcal.files.machines.entries import built, table
from loopcal.files.machines.instruments import Instruments
from loopcal.files.machines.machine_type import ChainModel, MachineType, looked_at
from loopcal.files.machines.parameter_entries import in_si
from loopcal.files.machines.urdf import read_urdf
from loopcal.files.paths import expanded
from loopcal.files.toml.model import Finite, Model
from loopcal.files.toml.place import Place
from loopcal.mechanisms.exponentials import NAME, ScrewJoint, exponentials
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.origins import LinkJoint, joint_chain

Three = Annotated[list[Finite], Field(min_length=3, max_length=3)]
if TYPE_CHECKING:
    LinkJoints = list[Any]
    ScrewJoints = list[Any]
else:
    LinkJoints = list[table(LinkJoint)]
    ScrewJoints = list[table(ScrewJoint)]


class Urdf(ChainModel):
    """The chain of joints between two links of a robot, from its URDF or listed here."""

    type: Literal["urdf"]
    name: str | None = None
    file: str | None = Field(
        default=None,
        description="Path of the URDF, relative to this file; ${NAME} is replaced by the "
        "environment variable NAME.",
        examples=["robot.urdf"],
    )
    base: str | None = Field(default=None, description="Link that does not move.")
    tip: str | None = Field(default=None, description="Link that carries what is measured.")
    joint: LinkJoints | None = Field(
        default=None, description="The chain itself, in place of a file."
    )
    axes: bool = Field(
        default=False,
        description="Whether the joints' axes have parameters too, two tilts NAME_axis_rx, ...; "
        "the origins alone hold every geometry.",
    )
    instrument: Instruments | None = None


class HomePose(Model):
    """The tool's frame in the base frame, all joints at zero."""

    xyz: Three = Field(default=[0.0, 0.0, 0.0])
    rpy: Three = Field(default=[0.0, 0.0, 0.0], description="Roll, pitch and yaw.")


class Exponentials(ChainModel):
    """A serial machine as a product of exponentials: exp([S_1] q_1) ... exp([S_n] q_n) M."""

    type: Literal["exponentials"]
    name: str = NAME
    joint: ScrewJoints = Field(min_length=1, description="From the base to the tip.")
    home: HomePose = HomePose()
    instrument: Instruments | None = None


def urdf(model: Urdf, units: Mapping[str, str], place: Place) -> Mechanism:
    """The robot of a table of the type "urdf".

    Raises InputError at the key, joint or line of the URDF that does not fit.
    """
    if (model.file is None) == (model.joint is None):
        words = "neither a file nor joints are" if model.file is None else "a file and joints are"
        raise InputError(
            f"{words} given, but exactly one of the two must describe the robot",
            code="conflicting-keys",
            place=str(place.at("joint" if model.joint else "file")),
            remedy='name the robot: file = "robot.urdf", with its links base and tip',
        )
    if model.joint is not None:
        joints = _joints(LinkJoint, model.joint, units, place)
        name = model.name or "robot"
    else:
        joints, name = _of_file(model, place)
    machine = joint_chain(joints, axes=model.axes, name=name)
    return looked_at(machine, model.instrument, units, place)


def _of_file(model: Urdf, place: Place) -> Any:
    for key in ("base", "tip"):
        if getattr(model, key) is None:
            raise InputError(
                f"no link is named as {key!r}",
                code="missing-key",
                place=str(place),
                remedy=f'name a link of the robot: {key} = "..."; the joints from base to tip are '
                "calibrated",
            )
    assert model.file is not None
    at = place.at("file")
    path = expanded(model.file, Path(place.file).parent, at)
    joints = read_urdf(path, str(model.base), str(model.tip))
    return joints, model.name or path.stem


def exponential(model: Exponentials, units: Mapping[str, str], place: Place) -> Mechanism:
    """The machine of a table of the type "exponentials".

    Raises InputError at the key or joint that does not fit.
    """
    joints = _joints(ScrewJoint, model.joint, units, place)
    xyz, rpy = model.home.xyz, model.home.rpy
    home = (_three(xyz, "m", units, place), _three(rpy, "rad", units, place))
    machine = exponentials(joints, home=home, name=model.name)
    return looked_at(machine, model.instrument, units, place)


def _joints(make: Any, entries: Sequence[Any], units: Mapping[str, str], place: Place) -> list[Any]:
    """The joints of a chain.

    Raises InputError at the joint that does not fit.
    """
    joints = []
    for i, entry in enumerate(entries):
        here = place.at("joint", i)
        if entry.kind != "fixed" and "axis" not in entry.model_fields_set:
            raise InputError(
                f"the joint {entry.name!r} has no axis",
                code="missing-key",
                place=str(here),
                remedy="give it in the joint's frame, as axis = [0, 0, 1]",
            )
        joint = built(make, entry, units, here)
        if joint.limits is not None and not joint.limits[0] < joint.limits[1]:
            low, high = (amount.value for amount in entry.limits)
            raise InputError(
                f"the limits run from {low:g} to {high:g}",
                code="invalid-value",
                place=str(here.at("limits")),
                remedy="give the lower one first",
            )
        joints.append(joint)
    return joints


def _three(
    values: Sequence[float], si: str, units: Mapping[str, str], place: Place
) -> tuple[float, float, float]:
    x, y, z = (in_si(float(v), None, si, place, units) for v in values)
    return (x, y, z)


TYPES = {"urdf": MachineType(Urdf, urdf), "exponentials": MachineType(Exponentials, exponential)}
