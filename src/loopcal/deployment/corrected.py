"""Corrected targets: the joints at which the real machine has the pose that was programmed.

The controller computes with a model f_c of its own, the machine is f. Of a joint target q_0 the
pose T = f_c(q_0) was meant; of a Cartesian target T is stated, and q_0 is what the controller makes
of it. The corrected joints q solve f(q) = T; the corrected Cartesian target is f_c(q), which the
controller maps back to q. Source: pose redefinition, as in doi 10.1177/16878132221090094.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from loopcal.deployment.arms import Arms
from loopcal.deployment.inverse import least_gain, solve
from loopcal.deployment.reached import Reached, reached
from loopcal.deployment.refusals import Refusal
from loopcal.deployment.rigid import between
from loopcal.measurements.dataset import Dataset
from loopcal.statistics.prediction import predict
from loopcal.statistics.predictor import Predictor

Array = NDArray[np.float64]
_BETWEEN = 5


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
    known: Predictor,
    targets: Targets,
    bounds: CorrectionBounds,
    at: Mapping[str, float],
) -> Corrected:
    """The corrected targets, or why each is refused.

    at: constants of the programme, name -> value [SI].
    """
    count = len(targets.names)
    there = np.isfinite(targets.joints).all(axis=1) & np.isfinite(targets.poses).all(axis=(1, 2))
    q, q0 = np.full(targets.joints.shape, np.nan), targets.joints
    left, settled = np.full((count, 6), np.nan), np.zeros(count, dtype=bool)
    solved = solve(arms.machine, targets.poses[there], q0[there])
    q[there], left[there], settled[there] = solved.joints, solved.left, solved.settled
    before = np.full((count, 6), np.nan)
    before[there] = between(targets.poses[there], arms.machine(q0[there]))
    usable = np.where(settled[:, None], q, np.nan_to_num(q0))
    refused = tuple(
        _refusal(arms, targets, i, q[i], bool(settled[i]), bounds) for i in range(count)
    )
    readings = {name: usable[:, i] for i, name in enumerate(arms.joints)}
    constants = {name: np.full(count, value) for name, value in at.items()}
    seen = predict(known, Dataset.from_arrays(readings | constants))
    return Corrected(
        targets,
        q,
        arms.controller(usable),
        before,
        -left,
        reached(known, arms, usable, _rounding(arms, targets, usable)),
        seen.ratio,
        seen.extrapolated,
        refused,
    )


def _rounding(arms: Arms, targets: Targets, q: Array) -> Array:
    """(N, 6, 6) covariance of the last digits of the targets, each uniform."""
    J, _ = arms.machine.twists(q)
    n, out = q.shape[1], np.empty((len(q), 6, 6))
    for i, written in enumerate(targets.cartesian):
        variance = np.square(targets.step[i, : 6 if written else n]) / 12.0
        out[i] = np.diag(variance) if written else (J[i] * variance) @ J[i].T
    return out


def _refusal(
    arms: Arms, targets: Targets, i: int, q: Array, settled: bool, bounds: CorrectionBounds
) -> Refusal | None:
    """Why the target is refused, the first reason that holds."""
    if i in targets.missing:
        return targets.missing[i]
    q0 = targets.joints[i]
    way = q0 + np.linspace(0.0, 1.0, _BETWEEN)[:, None] * ((q if settled else q0) - q0)
    J, _ = arms.controller.twists(way)
    gains = least_gain(J if not settled else np.concatenate([J, arms.machine.twists(q[None])[0]]))
    if gains.min() < bounds.gain:
        return Refusal(
            "singular",
            f"near a singular pose: the smallest singular value is {gains.min():.2g}, below "
            f"{bounds.gain:.2g}",
        )
    if not settled:
        return Refusal("not-reached", "no joints of the calibrated machine give this pose")
    away = _beyond(arms, q) or _moved(arms, q - q0, bounds)
    if away is not None:
        return away
    if J.shape[2] == 6 and np.ptp(np.sign(np.linalg.det(J))) > 0:
        return Refusal("configuration-changed", "the corrected joints are in another configuration")
    return None


def _beyond(arms: Arms, q: Array) -> Refusal | None:
    for (name, unit), value, (low, high) in zip(arms.joints.items(), q, arms.spans(), strict=True):
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


def joint_targets(arms: Arms, names: Sequence[str], joints: Array, step: Array) -> Targets:
    """Targets that are written as joints (N, n), with last digits of `step` (N, n)."""
    none = np.zeros(len(joints), dtype=bool)
    return Targets(tuple(names), joints, arms.controller(joints), none, step)
