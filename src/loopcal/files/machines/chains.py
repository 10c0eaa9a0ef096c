"""Chains in mechanism files: joint origins, of a URDF or listed, and products of exponentials."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

from loopcal.errors import InputError
from loopcal.files.machines.attached import Instruments
from loopcal.files.machines.machine_type import ChainTable, MachineType, UrdfPath, looked_at
from loopcal.files.machines.mechanism_writer import SOURCE
from loopcal.files.machines.urdf import read_masses, read_urdf
from loopcal.files.outputs import expanded
from loopcal.files.toml.place import Place, Scope
from loopcal.keys import Key
from loopcal.mechanisms.chain import Triple
from loopcal.mechanisms.exponentials import NAME, ScrewJoint, exponentials
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.origins import LinkJoint, joint_chain


@dataclass(frozen=True)
class Urdf(ChainTable):
    """The chain of joints between two links of a robot, from its URDF or listed here."""

    name: Annotated[str | None, Key("Name of the machine.")] = None
    file: UrdfPath = None
    base: Annotated[str | None, Key("Link that does not move.")] = None
    tip: Annotated[str | None, Key("Link that carries what is measured.")] = None
    joint: Annotated[tuple[LinkJoint, ...] | None, Key("The chain itself, in place of a file.")] = (
        None
    )
    source: Annotated[
        str | None,
        Key(
            "Path of the URDF that listed joints were read from; `loopcal export` patches it.",
            example="robot.urdf",
        ),
    ] = None
    axes: Annotated[
        bool,
        Key(
            "Whether the joints' axes have parameters too, two tilts NAME_axis_rx, ...; the "
            "origins alone hold every geometry."
        ),
    ] = False
    instrument: Annotated[Instruments | None, Key("What is read of the machine's body.")] = None


@dataclass(frozen=True)
class HomePose:
    """The tool's frame in the base frame, all joints at zero."""

    xyz: Annotated[Triple, Key("Its origin.", unit="m")] = (0.0, 0.0, 0.0)
    rpy: Annotated[Triple, Key("Roll, pitch and yaw.", unit="rad")] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Exponentials(ChainTable):
    """A serial machine as a product of exponentials: exp([S_1] q_1) ... exp([S_n] q_n) M."""

    joint: Annotated[tuple[ScrewJoint, ...], Key("From the base to the tip.", least=1)] = field(
        kw_only=True
    )
    name: Annotated[str, Key("Name of the machine.")] = NAME
    home: Annotated[HomePose, Key("Where the tool is, all joints at zero.")] = field(
        default_factory=HomePose
    )
    instrument: Annotated[Instruments | None, Key("What is read of the machine's body.")] = None


def urdf(model: Urdf, entry: Any, scope: Scope, place: Place) -> Mechanism:
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
        _refuse_faulty(model.joint, entry, place)
        joints, name, source, masses = model.joint, model.name or "robot", model.source, ()
    else:
        joints, name, masses = _of_file(model, place)
        source = model.file
    machine = joint_chain(joints, axes=model.axes, name=name, masses=masses)
    if source is not None:
        path = expanded(source, Path(place.file).parent, place.at("source")).absolute()
        machine = replace(machine, description={**machine.description, SOURCE: str(path)})
    return looked_at(machine, model.instrument, scope, place)


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
    base, tip = str(model.base), str(model.tip)
    return read_urdf(path, base, tip), model.name or path.stem, read_masses(path, base, tip)


def exponential(model: Exponentials, entry: Any, scope: Scope, place: Place) -> Mechanism:
    """The machine of a table of the type "exponentials".

    Raises InputError at the key or joint that does not fit.
    """
    _refuse_faulty(model.joint, entry, place)
    home = (model.home.xyz, model.home.rpy)
    machine = exponentials(model.joint, home=home, name=model.name)
    return looked_at(machine, model.instrument, scope, place)


def _refuse_faulty(joints: Sequence[LinkJoint | ScrewJoint], entry: Any, place: Place) -> None:
    """Raise InputError at a joint that moves without an axis, and at limits out of order."""
    for i, (joint, stated) in enumerate(zip(joints, entry.joint, strict=True)):
        joint_place = place.at("joint", i)
        if joint.kind != "fixed" and "axis" not in stated.model_fields_set:
            raise InputError(
                f"the joint {joint.name!r} has no axis",
                code="missing-key",
                place=str(joint_place),
                remedy="give it in the joint's frame, as axis = [0, 0, 1]",
            )
        if joint.limits is not None and not joint.limits[0] < joint.limits[1]:
            low, high = (amount.value for amount in stated.limits)
            raise InputError(
                f"the limits run from {low:g} to {high:g}",
                code="invalid-value",
                place=str(joint_place.at("limits")),
                remedy="give the lower one first",
            )


TYPES = {
    "urdf": MachineType(Urdf, Urdf, urdf),
    "exponentials": MachineType(Exponentials, Exponentials, exponential),
}
