"""Joints and poses as programs write them: degrees and millimetres, quaternions or three turns."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from loopcal.arrays import Array
from loopcal.errors import InputError
from loopcal.files.tables.readers import Column
from loopcal.mechanisms.placement import rigid, yaw_pitch_roll
from loopcal.mechanisms.rest import quaternion
from loopcal.mechanisms.station import pose_of


def pose_of_turns(numbers: Sequence[float]) -> Array:
    """(4, 4) of x, y, z [mm] and rz, ry, rx [deg]: Tx Ty Tz Rz Ry Rx; NaN of infinite numbers."""
    if not all(map(math.isfinite, numbers)):
        return np.full((4, 4), np.nan)
    return pose_of([*(1e-3 * v for v in numbers[:3]), *map(math.radians, numbers[3:6])])


def turns_of_pose(T: Array) -> list[float]:
    """x, y, z [mm] and rz, ry, rx [deg] of a pose."""
    return [*(1e3 * T[:3, 3]).tolist(), *map(math.degrees, yaw_pitch_roll(T[:3, :3]))]


def pose_of_quaternion(numbers: Sequence[float], place: str) -> Array:
    """(4, 4) of x, y, z [mm] and w, x, y, z of a quaternion, which is normalised.

    Raises InputError for numbers whose squares do not sum to nearly 1.
    """
    q = np.array(numbers[3:7], dtype=float)
    length = float(np.linalg.norm(q))
    # Components with two decimals change the length by at most 0.005 * sqrt(4) = 0.01.
    if not 0.99 < length < 1.01:
        raise InputError(
            f"the quaternion has the length {length:.3f}",
            code="invalid-number",
            place=place,
            remedy="write a unit quaternion, w first",
        )
    w, *v = (q / length).tolist()
    K = np.cross(np.eye(3), v)  # p -> v x p
    return rigid(np.eye(3) + 2.0 * (w * K + K @ K), 1e-3 * np.array(numbers[:3]))


def quaternion_of_pose(T: Array, like: Sequence[float]) -> list[float]:
    """x, y, z [mm] and the quaternion, w first, of the sign that `like` has."""
    q = np.array(quaternion(T[:3, :3]))
    if float(q @ np.array(like[3:7])) < 0.0:
        q = -q
    return [*(1e3 * T[:3, 3]).tolist(), *q.tolist()]


# The joints of an arm as programs write them: degrees and millimetres.


@dataclass(frozen=True, eq=False)
class JointAxes:
    """joints: name -> SI unit, from base to tip; columns: of tables, by joint; pose: the column of
    ids, if any; pulses: per degree or millimetre of each joint, for programs in pulses."""

    joints: Mapping[str, str]
    columns: Mapping[str, Column] = field(default_factory=dict)
    pose: str | int | None = "pose"
    pulses: tuple[float, ...] = ()

    @property
    def scale(self) -> Array:
        """(n,) SI per degree or millimetre."""
        return np.array([1e-3 if u == "m" else math.radians(1.0) for u in self.joints.values()])

    def pulses_each(self, name: str) -> Array:
        """(n,) pulses per degree or millimetre. Raises InputError, naming the program, where not
        every joint has them."""
        n, stated = len(self.joints), np.array(self.pulses, dtype=float)
        if len(stated) != n or not np.isfinite(stated).all() or (stated == 0.0).any():
            raise InputError(
                f"positions are in pulses, and {len(stated)} numbers of pulses are stated",
                code="missing-key",
                place=name,
                remedy=f"state those of all {n} joints, per degree: --pulses-per-degree N,N,...",
            )
        return stated
