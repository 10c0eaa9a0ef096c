"""Moving a machine rigidly, in terms of its own parameters.

An instrument may stand anywhere, so a calibration starts by moving the nominal machine to where
the instrument sees it. Where a station's parameters hold the placement, only they change (see
`station`). The seed's minimal transitions have none: there the joint axes are moved as lines, and
every transition's parameters are found again from where its axis pierces its plane. That moves the
geometry alone: what else is stated in the frames of its joints or of the instrument, such as sag,
does not follow. A calibrated arm is therefore moved by a station before it (see `stationed`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from loopcal.arrays import Array
from loopcal.errors import InputError
from loopcal.expressions.vectors import PLANES
from loopcal.mechanisms.chain import Step, matrix, product
from loopcal.mechanisms.mechanism import Placement

FLAT = 0.3
"""Sine of the angle between an axis and its plane below which a transition is a poor choice."""
_NO_JOINTS: Mapping[str, float] = {}


def rigid(rotation: Array, shift: Array) -> Array:
    """(..., 4, 4) of p -> rotation @ p + shift."""
    T = np.zeros((*shift.shape[:-1], 4, 4))
    T[..., :3, :3], T[..., :3, 3], T[..., 3, 3] = rotation, shift, 1.0
    return T


def inverse(T: Array) -> Array:
    """The inverse motions (..., 4, 4)."""
    R = np.swapaxes(T[..., :3, :3], -1, -2)
    return rigid(R, -(R @ T[..., :3, 3, None])[..., 0])


def yaw_pitch_roll(rotation: Array) -> tuple[float, float, float]:
    """Angles [rad] with Rz(yaw) Ry(pitch) Rx(roll) = rotation, pitch within +-pi/2."""
    # Pitch and roll are read behind the yaw found, so that they make good its rounding where
    # yaw and roll turn about nearly the same axis.
    yaw = math.atan2(rotation[1, 0], rotation[0, 0])
    cosine, sine = math.cos(yaw), math.sin(yaw)
    along = cosine * rotation[0] + sine * rotation[1]
    across = cosine * rotation[1] - sine * rotation[0]
    return yaw, math.atan2(-rotation[2, 0], along[0]), math.atan2(-across[2], across[1])


@dataclass(frozen=True)
class ChainPlacement:
    """Placement of a chain of transitions.

    parameters: those that only say where it stands; station: what is moved in its place, of an arm
    that is looked at from a station.
    """

    steps: tuple[Step, ...]
    tool: tuple[str, str, str]
    parameters: tuple[str, ...]
    station: Placement | None = None

    @classmethod
    def of(cls, steps: Sequence[Step], tool: tuple[str, str, str]) -> ChainPlacement | None:
        """The placement of a chain, None where its parameters cannot express a rigid motion."""
        if len([s for s in steps if s.joint]) < 2:
            return None
        # A rigid motion has six freedoms.
        # six of the first two transitions' eight: the other two are the machine's own
        names = tuple(s.parameter for s in steps if s.parameter)[:8]
        second = names[4:]
        return cls(tuple(steps), tool, (*names[:4], second[1], second[3]))

    def moved(self, values: Mapping[str, float], rotation: Array, shift: Array) -> dict[str, float]:
        """The parameters of the chain moved by p -> rotation @ p + shift, both in 3D."""
        if self.station is not None:
            return self.station.moved(values, rotation, shift)
        return self._moved_transitions(values, rigid(rotation, shift))

    def advice(self, values: Mapping[str, float]) -> tuple[str, ...]:
        """Warns of transitions whose axis meets its plane at a flat angle."""
        transition: list[Step] = []
        words = []
        for step in self.steps:
            if step.joint is None and step.parameter is not None:
                transition.append(step)
            elif step.joint is not None:
                steepness = abs(
                    math.prod(math.cos(values[str(s.parameter)]) for s in transition[2:])
                )
                if steepness < FLAT:
                    words.append(_flat_words(step, transition, steepness))
                transition = []
        return tuple(words)

    def _moved_transitions(self, values: Mapping[str, float], T: Array) -> dict[str, float]:
        frame_old, frame_new, new = T, np.eye(4), dict(values)
        zeros = {step.joint: 0.0 for step in self.steps if step.joint}
        transition: list[Step] = []
        for step in self.steps:
            if step.parameter is None and step.joint is None:
                fixed = matrix(step, step.constant)
                frame_old, frame_new = frame_old @ fixed, frame_new @ fixed
                continue
            # The joint axes are lines of the body, so at zero readings they determine the whole
            # chain.
            frame_old = frame_old @ matrix(step, float(step.amount(zeros, values)))
            if step.joint is None:
                transition.append(step)
                continue
            between = np.asarray(np.linalg.solve(frame_new, frame_old), dtype=np.float64)
            parameters = _transition(between, transition, step.motion[1])
            new |= parameters
            frame_new = frame_new @ product(transition, _NO_JOINTS, parameters)
            transition = []
        tip = np.array([*(values[t] for t in self.tool), 1.0])
        return new | dict(
            zip(self.tool, map(float, np.linalg.solve(frame_new, frame_old @ tip)[:3]), strict=True)
        )


def _flat_words(step: Step, transition: Sequence[Step], steepness: float) -> str:
    names = [repr(s.parameter) for s in transition]
    return (
        f"The axis of {step.joint!r} meets the plane it should pierce at only "
        f"{math.degrees(math.asin(steepness)):.0f} degrees, so {names[0]} and {names[1]} grow out "
        "of proportion and the fit is ill-conditioned. Give the first joint a fixed motion, as "
        "before = { rz = 90 } in degrees, or describe the arm with a base."
    )


def _transition(T: Array, steps: Sequence[Step], axis: str) -> dict[str, float]:
    """The four parameters that bring the axis of a frame onto that of T, all in the first frame.

    The turns are about the plane's axes a, then b. Rb alone tilts the joint axis c within the
    plane of a and c. So the component of c along a gives the second angle, the rest the first.
    """
    a, b = (step.motion[1] for step in steps[:2])
    i, j, k = ("xyz".index(letter) for letter in (a, b, axis))
    point, direction = T[:3, 3], T[:3, k]
    if abs(direction[k]) < 1e-9:
        raise InputError(
            f"the {axis} axis after {steps[0].parameter!r} is parallel to the plane it must "
            f"intersect",
            code="unsupported",
            remedy="turn the instrument's frame by about 90 degrees (a fixed motion `before` the "
            "first joint), so that the axis meets its plane",
        )
    # The line point + t * direction meets the plane where its component k vanishes.
    pierced = point - direction * (point[k] / direction[k])
    turned = _along(b, a, axis) * direction[i]
    second = math.asin(max(-1.0, min(1.0, float(turned))))
    rest = np.array([direction[j], direction[k]])
    first = math.atan2(_along(a, b, axis) * rest[0], rest[1])
    if abs(first) > math.pi / 2:  # the other branch: half a turn less about a
        first -= math.copysign(math.pi, first)
        second = math.copysign(math.pi, second) - second
    names = [step.parameter for step in steps]
    numbers = (pierced[i], pierced[j], first, second)
    return {str(n): float(v) for n, v in zip(names, numbers, strict=True)}


def _along(turn: str, onto: str, of: str) -> float:
    """Sign of the component along `onto` of the axis `of` turned a little about `turn`."""
    first, second = PLANES[turn]
    moved, target = "xyz".index(of), "xyz".index(onto)
    return float(((moved, target) == (first, second)) - ((moved, target) == (second, first)))
