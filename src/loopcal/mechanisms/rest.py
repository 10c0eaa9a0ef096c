"""A chain of joints as one rigid transform ahead of each joint: what every robot format holds.

    T_base_tip(q) = B_1 J_1(q) B_2 J_2(q) ... B_n J_n(q) T

B_i places the frame of joint i in the frame behind joint i-1, all joints at zero; J_i turns about
or moves along an axis of that frame by factor * reading; T is the tip behind the last joint.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from loopcal.arrays import Array
from loopcal.mechanisms.chain import Step, matrix, product
from loopcal.mechanisms.placement import rigid, yaw_pitch_roll
from loopcal.mechanisms.rotations import quaternions, rotation_by


@dataclass(frozen=True, eq=False)
class RestJoint:
    """A joint of a chain.

    name: unique; reads: the quantity that moves it; kind: "revolute" or "prismatic"; axis: unit
    vector in its frame; factor: of the reading, 1 or -1, another where it follows another joint;
    before: (4, 4) its frame in that of the joint before, at rest.
    """

    name: str
    reads: str
    kind: str
    axis: tuple[float, float, float]
    factor: float
    before: Array

    def motion(self, reading: float) -> Array:
        """J: (4, 4) at a reading [m or rad]."""
        amount = self.factor * reading
        if self.kind == "prismatic":
            return rigid(np.eye(3), amount * np.array(self.axis))
        return rigid(rotation(self.axis, amount), np.zeros(3))


@dataclass(frozen=True, eq=False)
class RestChain:
    """Joints from the base to the tip, and the tip (4, 4) in the frame of the last joint."""

    joints: tuple[RestJoint, ...]
    tip: Array

    def pose(self, readings: Mapping[str, float]) -> Array:
        """T_base_tip (4, 4) at readings by quantity [m or rad]."""
        T = np.eye(4)
        for joint in self.joints:
            T = T @ joint.before @ joint.motion(readings[joint.reads])
        return T @ self.tip

    @property
    def along_z(self) -> RestChain:
        """The same chain with every joint's axis along the z of its frame, and a factor above 0."""
        made, ahead = [], np.eye(4)
        for joint in self.joints:
            axis = np.array(joint.axis) * math.copysign(1.0, joint.factor)
            turn = rigid(onto_z(axis), np.zeros(3))
            before = ahead @ joint.before @ turn
            ahead = turn.T
            made.append(
                RestJoint(joint.name, joint.reads, joint.kind, _Z, abs(joint.factor), before)
            )
        return RestChain(tuple(made), ahead @ self.tip)


_Z = (0.0, 0.0, 1.0)


def rest_chain(steps: Sequence[Step], values: Mapping[str, float]) -> RestChain:
    """The rest transforms of elementary steps at parameter values [SI].

    A joint that several steps read (one follows the other) is named NAME_2, NAME_3, ... there.
    """
    joints: list[RestJoint] = []
    T, seen = np.eye(4), dict[str, int]()
    for step in steps:
        still = Step(step.motion, step.parameter, None, 1, step.constant, step.sign)
        T = T @ product([still], {}, values)
        if step.joint is None:
            continue
        number = seen[step.joint] = seen.get(step.joint, 0) + 1
        axis = tuple(float(letter == step.motion[1]) for letter in "xyz")
        name = step.joint if number == 1 else f"{step.joint}_{number}"
        kind = "prismatic" if step.motion[0] == "t" else "revolute"
        x, y, z = axis
        joints.append(RestJoint(name, step.joint, kind, (x, y, z), float(step.direction), T))
        T = np.eye(4)
    return RestChain(tuple(joints), T)


def rotation(axis: Sequence[float], angle: float) -> Array:
    """(3, 3) turn by an angle [rad] about a unit vector."""
    if sorted(map(abs, axis)) == [0.0, 0.0, 1.0]:
        i = int(np.argmax(np.abs(axis)))
        return matrix(Step("r" + "xyz"[i]), float(axis[i]) * angle)[:3, :3]
    return rotation_by(angle * np.array(axis))


def onto_z(axis: Array) -> Array:
    """(3, 3) rotation R with R z = axis; permutations of the axes where the axis is one of them."""
    i = int(np.argmax(np.abs(axis)))
    z = axis / np.linalg.norm(axis)
    if i == 2 and z[2] > 0.0:
        x = np.array([1.0, 0.0, 0.0])
    else:
        x = np.eye(3)[(i + 1) % 3]
    x = x - z * (z @ x)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def roll_pitch_yaw(R: Array, near: Sequence[float] = (0.0, 0.0, 0.0)) -> tuple[float, ...]:
    """Of the triples with Rz(yaw) Ry(pitch) Rx(roll) = R [rad] the one nearest to another.

    Roll and yaw turn about one axis where the pitch is a right angle; the roll is kept there.
    """
    old = np.asarray(near, dtype=float)
    if math.hypot(R[0, 0], R[1, 0]) < _LEVEL:
        M = R @ rotation((1.0, 0.0, 0.0), -old[0])
        triples = [(old[0], math.atan2(-M[2, 0], M[2, 2]), math.atan2(-M[0, 1], M[1, 1]))]
    else:
        yaw, pitch, roll = yaw_pitch_roll(R)
        triples = [(roll, pitch, yaw), (roll + math.pi, math.pi - pitch, yaw + math.pi)]
    turn = 2.0 * math.pi
    nearest = [np.array(t) + turn * np.round((old - np.array(t)) / turn) for t in triples]
    best = min(nearest, key=lambda t: float(np.abs(t - old).sum()))
    return tuple(map(float, best))


_LEVEL = 1e-12
"""Cosine of a pitch that counts as a right angle: its roll and yaw are then indistinguishable."""


def quaternion(R: Array) -> tuple[float, float, float, float]:
    """Unit quaternion w, x, y, z of a rotation, w >= 0."""
    w, x, y, z = quaternions(R).tolist()
    return (w, x, y, z)
