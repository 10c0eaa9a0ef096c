"""Chains as mechanism files describe them: joint origins, of a URDF or listed, and exponentials."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from loopcal.errors import InputError
from loopcal.files.machines.instrument_entries import instruments
from loopcal.files.machines.parameter_entries import in_si
from loopcal.files.machines.urdf import read_urdf
from loopcal.files.paths import expanded
from loopcal.files.toml.place import Place
from loopcal.mechanisms.exponentials import ScrewJoint, exponentials
from loopcal.mechanisms.instruments.point import point
from loopcal.mechanisms.machine import Instrument, Machine, assemble
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.origins import LinkJoint, Mimic, joint_chain

if TYPE_CHECKING:
    from loopcal.files.machines.chain_schema import Exponentials, LinkJointEntry, MimicEntry, Urdf


def urdf(model: Urdf, units: Mapping[str, str], place: Place) -> Mechanism:
    """The robot of a table of the type "urdf".

    Raises InputError at the key, joint or line of the URDF that does not fit.
    """
    if (model.file is None) == (model.joint is None):
        words = "neither a file nor joints are" if model.file is None else "a file and joints are"
        raise InputError(
            f"{words} given, and one of the two says what the robot is",
            place=str(place.at("joint" if model.joint else "file")),
            remedy='name the robot: file = "robot.urdf", with its links base and tip',
        )
    if model.joint is not None:
        listed = enumerate(model.joint)
        joints = tuple(_link_joint(entry, units, place.at("joint", i)) for i, entry in listed)
        name = model.name or "robot"
    else:
        joints, name = _of_file(model, place)
    return _seen(joint_chain(joints, axes=model.axes, name=name), model, units, place)


def _of_file(model: Urdf, place: Place) -> Any:
    for key in ("base", "tip"):
        if getattr(model, key) is None:
            raise InputError(
                f"the link {key!r} is not named",
                place=str(place),
                remedy=f'name a link of the robot: {key} = "..."; what is calibrated are the '
                "joints from base to tip",
            )
    assert model.file is not None
    at = place.at("file")
    path = expanded(model.file, Path(place.file).parent, at)
    joints = read_urdf(path, str(model.base), str(model.tip))
    return joints, model.name or path.stem


def _link_joint(entry: LinkJointEntry, units: Mapping[str, str], place: Place) -> LinkJoint:
    if entry.axis is None and entry.kind != "fixed":
        raise InputError(
            f"the joint {entry.name!r} has no axis",
            place=str(place),
            remedy="give it in the joint's frame, as axis = [0, 0, 1]",
        )
    moves = "m" if entry.kind == "prismatic" else "rad"
    try:
        return LinkJoint(
            entry.name,
            entry.kind,
            _three(entry.xyz, "m", units, place),
            _three(entry.rpy, "rad", units, place),
            _three(entry.axis or [1.0, 0.0, 0.0], "1", units, place),
            _limits(entry.limits, moves, units, place.at("limits")),
            _mimic(entry.mimic),
        )
    except InputError as error:
        raise error if error.place else error.at(str(place)) from None


def _mimic(entry: MimicEntry | None) -> Mimic | None:
    return None if entry is None else Mimic(**entry.model_dump())


def exponential(model: Exponentials, units: Mapping[str, str], place: Place) -> Mechanism:
    """The machine of a table of the type "exponentials".

    Raises InputError at the key or joint that does not fit.
    """
    joints = []
    for i, entry in enumerate(model.joint):
        here = place.at("joint", i)
        moves = "m" if entry.kind == "prismatic" else "rad"
        limits = _limits(entry.limits, moves, units, here.at("limits"))
        axis, at = _three(entry.axis, "1", units, here), _three(entry.point, "m", units, here)
        try:
            joints.append(ScrewJoint(entry.name, axis, at, entry.kind, limits))
        except InputError as error:
            raise error.at(str(here)) from None
    xyz, rpy = model.home.xyz, model.home.rpy
    home = (_three(xyz, "m", units, place), _three(rpy, "rad", units, place))
    return _seen(exponentials(joints, home=home, name=model.name), model, units, place)


def _seen(
    machine: Machine, model: Urdf | Exponentials, units: Mapping[str, str], place: Place
) -> Mechanism:
    """The machine and what looks at it."""
    looking: list[Instrument] = [point()]
    if model.instrument is not None:
        looking = instruments(model.instrument, machine, units, place.at("instrument"))
    try:
        return assemble(machine, looking)
    except InputError as error:
        raise error.at(str(place.at("instrument"))) from None


def _three(
    values: Sequence[float], si: str, units: Mapping[str, str], place: Place
) -> tuple[float, float, float]:
    x, y, z = (in_si(float(v), None, si, place, units) for v in values)
    return (x, y, z)


def _limits(
    given: Sequence[float] | None, si: str, units: Mapping[str, str], place: Place
) -> tuple[float, float] | None:
    if given is None:
        return None
    low, high = (in_si(float(v), None, si, place, units) for v in given)
    if not low < high:
        raise InputError(
            f"the limits run from {given[0]:g} to {given[1]:g}",
            place=str(place),
            remedy="give the lower one first",
        )
    return low, high
