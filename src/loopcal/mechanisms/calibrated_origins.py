"""The origins of a chain of joints as calibrated, and the part of them that is a joint's zero.

    T_parent_child(q) = Origin J(q),   Origin = T(xyz) R_rpy Rz Ry Rx

A turn of the origin about the joint's axis (of a slide, a shift along it) is what a zero offset
does: Origin J(q) = Origin' J(q + offset). It stands in the origin, or apart
for the controller to add, never in both. The offset is the twist of the new rotation against the
drawing's about the axis.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.mechanisms.axes import AxisFrame, Triple, fixed_frame, unit_direction
from loopcal.mechanisms.chain import product
from loopcal.mechanisms.origins import LinkJoint
from loopcal.mechanisms.placement import rigid
from loopcal.mechanisms.rest import quaternion, rotation

Array = NDArray[np.float64]


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
