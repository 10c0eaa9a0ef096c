"""Corrected targets: the joints at which the real machine has the pose that was programmed.

The controller computes with a model f_c of its own, the machine is f. Of a joint target q_0 the
pose T = f_c(q_0) was meant; of a Cartesian target T is stated, and q_0 is what the controller makes
of it. The corrected joints q solve f(q) = T; the corrected Cartesian target is f_c(q), which the
controller maps back to q. Source: pose redefinition, as in doi 10.1177/16878132221090094.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from loopcal.deployment.arms import Arms
from loopcal.deployment.inverse import least_gain, solve
from loopcal.deployment.reached import Reached, reached
from loopcal.deployment.rigid import between
from loopcal.measurements.dataset import Dataset
from loopcal.statistics.prediction import predict
from loopcal.statistics.predictor import Predictor

Array = NDArray[np.float64]
# Poses on the way to the corrected joints, at which the controller's Jacobian is looked at.
_BETWEEN = 5
_BLOCK = 4096
"""Targets at a time."""
Reason = Literal[
    "configuration-changed",
    "configuration-missing",
    "moved-too-far",
    "not-reached",
    "not-stated",
    "outside-limits",
    "singular",
]


@dataclass(frozen=True)
class Refusal:
    """Why a target stays as it is, in words for a user."""

    reason: Reason
    words: str


@dataclass(frozen=True)
class CorrectionBounds:
    """What a target may need at most: turn [rad] and slide [m] of a joint; least singular value.

    line: error [m] in the middle of a straight move above which targets are inserted; None: none.
    """

    turn: float = math.radians(5.0)
    slide: float = 0.05
    gain: float = 0.005
    line: float | None = None


@dataclass(frozen=True, eq=False)
class Targets:
    """N poses that a program asks for, in the base of the arm.

    names: of each; joints: (N, n) [rad, m] that the controller takes there, NaN where unknown;
    poses: (N, 4, 4) f_c of them, or as stated; cartesian: (N,) whether a pose is written, not
    joints; missing: why joints are unknown; rounding: (N, n) last digit of written joints [rad,
    m], or (N, 6) of poses.
    """

    names: tuple[str, ...]
    joints: Array
    poses: Array
    cartesian: NDArray[np.bool_]
    step: Array
    missing: Mapping[int, Refusal] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Corrected:
    """Targets with what was found for each.

    joints: (N, n) corrected; poses: (N, 4, 4) f_c of them, the corrected Cartesian target; before,
    after: (N, 6) error of the pose that the machine is expected to reach, shift [m] and turn
    [rad], in the base; reached: how sure that is; ratio: (N,) the parameters' part of the sd over
    the usual one at the calibration poses; refused: (N,) None where it is corrected.
    """

    targets: Targets
    joints: Array
    poses: Array
    before: Array
    after: Array
    reached: Reached
    ratio: Array
    extrapolated: NDArray[np.bool_]
    refused: tuple[Refusal | None, ...]

    @property
    def done(self) -> NDArray[np.bool_]:
        """(N,) which targets are corrected."""
        return np.array([refusal is None for refusal in self.refused], dtype=bool)


def corrected(
    arms: Arms,
    predictor: Predictor,
    targets: Targets,
    bounds: CorrectionBounds,
    at: Mapping[str, float],
) -> Corrected:
    """The corrected targets, or why each is refused.

    at: constants of the programme, name -> value [SI].
    """
    count = len(targets.names)
    solvable = np.isfinite(targets.joints).all(axis=1) & np.isfinite(targets.poses).all(axis=(1, 2))
    q, q0 = np.full(targets.joints.shape, np.nan), targets.joints
    left, settled = np.full((count, 6), np.nan), np.zeros(count, dtype=bool)
    solved = solve(arms.machine, targets.poses[solvable], q0[solvable])
    q[solvable], left[solvable], settled[solvable] = solved.joints, solved.left, solved.settled
    before = np.full((count, 6), np.nan)
    before[solvable] = between(targets.poses[solvable], arms.machine(q0[solvable]))
    usable = np.where(settled[:, None], q, np.nan_to_num(q0))
    ways = _ways(arms, q0, q, settled)
    refused = tuple(_refusal(arms, targets, i, q[i], ways[i], bounds) for i in range(count))
    readings = {name: usable[:, i] for i, name in enumerate(arms.joints)}
    constants = {name: np.full(count, value) for name, value in at.items()}
    seen = predict(predictor, Dataset.from_arrays(readings | constants))
    return Corrected(
        targets,
        q,
        arms.controller(usable),
        before,
        -left,
        reached(predictor, arms, usable, _rounding(arms, targets, usable)),
        seen.ratio,
        seen.extrapolated,
        refused,
    )


def _rounding(arms: Arms, targets: Targets, q: Array) -> Array:
    """(N, 6, 6) covariance of the last digits of the targets, each uniform."""
    J, _ = arms.machine.twists(q)
    n, out = q.shape[1], np.empty((len(q), 6, 6))
    for i, written in enumerate(targets.cartesian):
        # Rounding to a step is uniform: variance step^2 / 12.
        variance = np.square(targets.step[i, : 6 if written else n]) / 12.0
        out[i] = np.diag(variance) if written else (J[i] * variance) @ J[i].T
    return out


class _Way(NamedTuple):
    """From the joints that a controller takes to the corrected ones.

    settled: whether there are such; gain: smallest singular value on the way; changed: whether it
    leads through a singular pose into another configuration.
    """

    settled: bool
    gain: float
    changed: bool


def _ways(arms: Arms, q0: Array, q: Array, settled: NDArray[np.bool_]) -> list[_Way]:
    """The ways of joints (N, n)."""
    n, ways = q0.shape[1], list[_Way]()
    for begin in range(0, len(q0), _BLOCK):
        part = slice(begin, begin + _BLOCK)
        solved, begun = settled[part], q0[part]
        end = np.where(solved[:, None], q[part], begun)
        way = begun[:, None] + np.linspace(0.0, 1.0, _BETWEEN)[:, None] * (end - begun)[:, None]
        J, _ = arms.controller.twists(way.reshape(-1, n))
        last, _ = arms.machine.twists(end)
        J = np.concatenate([J.reshape(-1, _BETWEEN, 6, n), last[:, None]], axis=1)
        gains = least_gain(J.reshape(-1, 6, n)).reshape(len(begun), -1)
        gain = np.where(solved, gains.min(axis=1), gains[:, :-1].min(axis=1))
        with np.errstate(invalid="ignore"):
            sides = np.sign(np.linalg.det(J)) if n == 6 else np.ones(gains.shape)
        changed = np.ptp(sides, axis=1) > 0
        ways += map(_Way, solved.tolist(), gain.tolist(), changed.tolist())
    return ways


def _refusal(
    arms: Arms, targets: Targets, i: int, q: Array, way: _Way, bounds: CorrectionBounds
) -> Refusal | None:
    """Why the target is refused, the first reason that holds."""
    if i in targets.missing:
        return targets.missing[i]
    if way.gain < bounds.gain:
        return Refusal(
            "singular",
            f"near a singular pose: the smallest singular value is {way.gain:.2g}, below "
            f"{bounds.gain:.2g}",
        )
    if not way.settled:
        return Refusal("not-reached", "no joints of the calibrated machine give this pose")
    away = _beyond(arms, q) or _moved(arms, q - targets.joints[i], bounds)
    if away is not None:
        return away
    if way.changed:
        return Refusal("configuration-changed", "the corrected joints are in another configuration")
    return None


def _beyond(arms: Arms, q: Array) -> Refusal | None:
    for (name, unit), value, (low, high) in zip(arms.joints.items(), q, arms.spans, strict=True):
        if not low <= value <= high:
            return Refusal(
                "outside-limits",
                f"joint {name!r} would be at {shown(value, unit)}, outside its limits "
                f"{shown(low, unit)} to {shown(high, unit)}",
            )
    return None


def _moved(arms: Arms, step: Array, bounds: CorrectionBounds) -> Refusal | None:
    for (name, unit), value in zip(arms.joints.items(), step, strict=True):
        bound = bounds.slide if unit == "m" else bounds.turn
        if abs(value) > bound:
            return Refusal(
                "moved-too-far",
                f"joint {name!r} would move by {shown(value, unit)}, more than "
                f"{shown(bound, unit)}",
            )
    return None


def shown(value: float, unit: str) -> str:
    """A joint's reading for people: degrees or millimetres."""
    return f"{1e3 * value:.3f} mm" if unit == "m" else f"{math.degrees(value):.3f} deg"
