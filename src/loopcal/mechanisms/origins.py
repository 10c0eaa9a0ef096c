"""Machines from joint origins, as URDF describes robots: each joint's frame seen in its parent's.

    T_parent_child = Tx Ty Tz  Rz(yaw) Ry(pitch) Rx(roll)  Rz Ry Rx  J(q)

x, y, z are the origin's own; the turns Rz Ry Rx stand behind its nominal rotation, in the joint's
frame, and are nominally 0: real robots have origins pitched by 90 degrees, where yaw and roll
turn about one axis and could not express every small rotation. J turns about or moves along the
joint's axis; a fixed joint has none, one that mimics another moves with that one's reading.

The origins of a chain of joints as calibrated, and the part of them that is a joint's zero.

    T_parent_child(q) = Origin J(q),   Origin = T(xyz) R_rpy Rz Ry Rx

A turn of the origin about the joint's axis (of a slide, a shift along it) is what a zero offset
does: Origin J(q) = Origin' J(q + offset). It stands in the origin, or apart
for the controller to add, never in both. The offset is the twist of the new rotation against the
drawing's about the axis.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from loopcal.arrays import Array
from loopcal.errors import InputError, unknown_name
from loopcal.keys import Key
from loopcal.mechanisms.chain import (
    AxisFrame,
    JointName,
    Limits,
    Step,
    Triple,
    axis_parameters,
    check_joints,
    fixed_frame,
    product,
    unit_direction,
    zero_of,
)
from loopcal.mechanisms.effects.gravity import Load
from loopcal.mechanisms.frame import ChainFrame
from loopcal.mechanisms.machine import Machine
from loopcal.mechanisms.parameters import Parameter
from loopcal.mechanisms.placement import rigid
from loopcal.mechanisms.rest import quaternion, rotation
from loopcal.mechanisms.tree import Tree

MOVING = ("revolute", "continuous", "prismatic")
KINDS = (*MOVING, "fixed")
ORIGIN = ("tx", "ty", "tz", "rz", "ry", "rx")


@dataclass(frozen=True)
class Mimic:
    """A joint that follows another: q = multiplier * q_followed + offset.

    kind: that of the joint followed, which is the one that is read.
    """

    joint: Annotated[str, Key("The joint that is read.")]
    multiplier: Annotated[float, Key("In m and rad.")] = 1.0
    offset: Annotated[float, Key("In m or rad.")] = 0.0
    kind: Annotated[str, Key("Kind of the joint that is read.", choices=MOVING)] = "revolute"


@dataclass(frozen=True)
class LinkJoint:
    """One joint between two links.

    name: the quantity that is read; kind: "revolute", "continuous", "prismatic" or "fixed";
    xyz [m], rpy [rad]: origin of the joint in the frame of its parent; axis: unit vector in the
    joint's frame; limits: of the reading [m or rad], where known.
    """

    name: JointName
    kind: Annotated[str, Key("How the joint moves.", choices=KINDS)] = "revolute"
    xyz: Annotated[Triple, Key("Origin in the frame of the parent.", unit="m")] = (0.0, 0.0, 0.0)
    rpy: Annotated[Triple, Key("Roll, pitch and yaw of the origin.", unit="rad")] = (0.0, 0.0, 0.0)
    axis: Annotated[Triple, Key("Unit vector in the frame of the joint.")] = (1.0, 0.0, 0.0)
    limits: Limits = None
    mimic: Annotated[Mimic | None, Key("The joint that this one follows.")] = None

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise unknown_name(
                f"the joint {self.name!r} is of the kind {self.kind!r}", self.kind, KINDS
            )
        if self.kind != "fixed":
            AxisFrame.of(self.axis, self.name)

    @property
    def reads(self) -> tuple[str, str] | None:
        """The quantity that moves it and that quantity's unit, None for a fixed joint."""
        if self.kind == "fixed":
            return None
        name, kind = (self.mimic.joint, self.mimic.kind) if self.mimic else (self.name, self.kind)
        return name, "m" if kind == "prismatic" else "rad"

    @property
    def origin_steps(self) -> tuple[Step, ...]:
        """The steps of its origin's parameters: NAME_x, _y, _z, and the turns NAME_rz, _ry, _rx."""
        return tuple(Step(m, f"{self.name}_{m.removeprefix('t')}") for m in ORIGIN)

    @property
    def origin(self) -> tuple[Parameter, ...]:
        """The six parameters of the origin, nominally at its xyz and rpy."""
        nominal = (*self.xyz, 0.0, 0.0, 0.0)
        made = axis_parameters(self.name, self.origin_steps).values()
        along = ""
        if self.kind != "fixed":
            # The origin's freedom along or about the joint's axis is what a zero of its reading
            # does.
            along = ("t" if self.kind == "prismatic" else "r") + AxisFrame.of(
                self.axis, self.name
            ).letters[2]
        return tuple(
            replace(p, nominal=float(v)).of("zero", meaning=zero_of(self.name))
            if motion == along
            else replace(p, nominal=float(v))
            for p, v, motion in zip(made, nominal, ORIGIN, strict=True)
        )

    @property
    def tilts(self) -> tuple[Step, ...]:
        """Two turns NAME_axis_r. of the axis, about the two directions normal to it."""
        if self.kind == "fixed":
            return ()
        letters = AxisFrame.of(self.axis, self.name).letters
        return tuple(Step(f"r{a}", f"{self.name}_axis_r{a}") for a in letters[:2])

    def steps(self, *, axes: bool = False) -> Iterator[Step]:
        """Its elementary steps; axes: whether its axis has parameters of its own."""
        yield from self.origin_steps[:3]
        yield from fixed_frame((0.0, 0.0, 0.0), self.rpy)
        yield from self.origin_steps[3:]
        if self.reads is not None:
            follows = self.mimic or Mimic(self.name)
            yield from AxisFrame.of(self.axis, self.name).moving(
                follows.joint,
                self.kind,
                self.tilts if axes else (),
                follows.multiplier,
                follows.offset,
            )


def joint_chain(
    joints: Sequence[LinkJoint],
    *,
    axes: bool = False,
    name: str = "robot",
    masses: Sequence[Load] = (),
) -> Machine:
    """The machine of a chain of joints from the base to the tip.

    axes: whether the joints' axes have parameters too, NAME_axis_rx and so on; the origins alone
    hold every geometry that a robot of these kinds of joints can have. masses: known ones of its
    links.

    Raises InputError for a chain in which nothing moves, or two joints of one name.
    """
    joints = tuple(joints)
    check_joints([joint.name for joint in joints])
    reads = [read for joint in joints if (read := joint.reads)]
    if not reads:
        raise InputError(
            "all joints between the base and the tip are fixed",
            code="missing-key",
            remedy="name a base and a tip with moving joints between them",
        )
    steps = tuple(step for joint in joints for step in joint.steps(axes=axes))
    stated = {"type": "urdf", "fix_redundant": False, "axes": axes, "joints": list(joints)}
    stated |= {"mass": list(masses)} if masses else {}
    tilts = [p for j in joints for p in axis_parameters(j.name, j.tilts).values()]
    parameters = [*(tilts if axes else ()), *(p for joint in joints for p in joint.origin)]
    return Machine(
        name,
        dict(reads),
        {p.name: p for p in parameters},
        lambda x, p: ChainFrame(steps, x, p),
        tree=Tree.chain(steps),
        masses=tuple(masses),
        description=stated,
    )


@dataclass(frozen=True, eq=False)
class CalibratedOrigin:
    """A joint's origin.

    joint: as drawn; T: (4, 4) calibrated origin in the parent's frame; axis: unit vector in the
    joint's frame, calibrated where axes have parameters; offset: to be added to the joint's reading
    [rad or m], 0 where the origin holds it.
    """

    joint: LinkJoint
    T: Array
    axis: Triple
    offset: float = 0.0

    @property
    def drawn(self) -> Array:
        """(4, 4) the drawing's origin."""
        return product(fixed_frame(self.joint.xyz, self.joint.rpy), {}, {})

    @property
    def along(self) -> Array:
        """(3,) unit vector of the axis, whose digits may have been rounded where it was written."""
        return np.array(unit_direction(self.axis, self.joint.name))


def calibrated_origins(
    joints: Sequence[LinkJoint], values: Mapping[str, float], *, axes: bool, apart: bool
) -> tuple[CalibratedOrigin, ...]:
    """The origins at parameter values [SI]; axes: whether the axes have parameters; apart: whether
    zero offsets stand beside the origins instead of in them."""
    origins = [_of(joint, values, axes) for joint in joints]
    if not apart:
        return tuple(origins)
    offsets = {
        one.joint.name: _zero(one)
        for one in origins
        if one.joint.reads is not None and one.joint.mimic is None
    }
    return tuple(_without(one, offsets) for one in origins)


def _of(joint: LinkJoint, values: Mapping[str, float], axes: bool) -> CalibratedOrigin:
    origin_steps = joint.origin_steps
    steps = [*origin_steps[:3], *fixed_frame((0.0, 0.0, 0.0), joint.rpy), *origin_steps[3:]]
    T = product(steps, {}, values)
    axis = joint.axis
    if axes and joint.tilts and any(values[str(s.parameter)] for s in joint.tilts):
        # The tilt is stated in the axis frame A: in the joint's frame it is A tilt A^T.
        turns = AxisFrame.of(axis, joint.name).turns
        A = product(turns, {}, {})[:3, :3]
        tilt = product(joint.tilts, {}, values)[:3, :3]
        x, y, z = A @ tilt @ A.T @ np.array(axis)
        axis = (float(x), float(y), float(z))
    return CalibratedOrigin(joint, T, axis)


def _zero(one: CalibratedOrigin) -> float:
    """The offset [rad or m] that is part of an origin."""
    drawn, axis = one.drawn, one.along
    if one.joint.kind == "prismatic":
        return float((one.T[:3, 3] - drawn[:3, 3]) @ (one.T[:3, :3] @ axis))
    # Swing and twist: of the quaternion (w, v) of R, the twist t has tan(t/2) = v . axis / w.
    w, *vector = quaternion(drawn[:3, :3].T @ one.T[:3, :3])
    return 2.0 * math.atan2(float(np.array(vector) @ axis), w)


def _without(one: CalibratedOrigin, offsets: Mapping[str, float]) -> CalibratedOrigin:
    """The origin with its offset, or that of the joint it follows, taken out."""
    joint = one.joint
    if joint.reads is None:
        return one
    if joint.mimic is None:
        zero, offset = offsets[joint.name], offsets[joint.name]
    else:
        zero, offset = joint.mimic.multiplier * offsets.get(joint.mimic.joint, 0.0), 0.0
    if joint.kind == "prismatic":
        back = rigid(np.eye(3), -zero * one.along)
    else:
        back = rigid(rotation(one.along.tolist(), -zero), np.zeros(3))
    return replace(one, T=one.T @ back, offset=offset)
