"""Corrected targets: the joints at which the real machine has the pose that was programmed.

The controller computes with its model f_c, and the machine is f. Of a joint target q_0 the
pose T = f_c(q_0) was meant; of a Cartesian target T is stated, and q_0 is what the controller makes
of it. The corrected joints q solve f(q) = T; the corrected Cartesian target is f_c(q), which the
controller maps back to q. Source: pose redefinition, as in doi 10.1177/16878132221090094.

How sure the pose is that a machine reaches at corrected joints.

    C = J_p C_p J_p^T + J_q Sigma_q J_q^T + model error + J_r Sigma_r J_r^T

C_p: the parameters, those of the instrument's placement among them; Sigma_q: the joints' readings;
Sigma_r: the last digit of the target file, uniform. Propagation is of first order (JCGM 102:2011).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.chi_squared import quantile
from loopcal.companions.robot.arms import Arms
from loopcal.companions.robot.inverse import least_gain, solve
from loopcal.companions.robot.rigid import Tool, between, turning
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.model_error import disturbances
from loopcal.mechanisms.outputs import POLAR
from loopcal.small_samples import LearntCovariance, f_limit, t_quantile
from loopcal.statistics.prediction import predict
from loopcal.statistics.predictor import Predictor, by_further_waves, by_parameters

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


LEVEL = 0.95


@dataclass(frozen=True, eq=False)
class Reached:
    """Uncertainty of N poses in the base of the arm.

    covariance: of shift [m] and turn [rad] (N, 6, 6), inf where nothing limits it; readings:
    whether the sds of the joints' readings are known, and so included.
    """

    covariance: LearntCovariance
    readings: bool

    @property
    def half_widths(self) -> Array:
        """(N, 6) U95 of x, y, z [m] and of the turns about them [rad]."""
        freedom = self.covariance.freedom
        factor = np.array([[t_quantile(LEVEL, f) for f in row] for row in freedom.tolist()])
        sd = np.sqrt(np.einsum("nii->ni", self.covariance.matrix))
        half: Array = factor.reshape(sd.shape) * sd
        return half

    def radial(self, first: int) -> Array:
        """(N,) U95 of the length of the shift (first 0) [m], or of the angle of the turn (3)."""
        part = self.covariance.of(np.arange(first, first + 3))
        finite = np.isfinite(np.einsum("nii->ni", part.matrix)).all(axis=1)
        eigenvalues = np.linalg.eigvalsh(np.where(finite[:, None, None], part.matrix, 0.0))
        eigenvalues = np.maximum(eigenvalues, 0.0)
        k1, k2, k3 = (
            eigenvalues.sum(axis=1),
            2 * (eigenvalues**2).sum(axis=1),
            8 * (eigenvalues**3).sum(axis=1),
        )
        # the sum of weighted chi-squareds by its first three moments (Hall 1983, Buckley 1988)
        freedom = np.where(k3 > 0.0, 8.0 * k2**3 / np.where(k3 > 0.0, k3, 1.0) ** 2, 1.0)
        limit = np.array([quantile(1.0 - LEVEL, float(f)) for f in freedom])
        square = k1 + np.sqrt(k2 / (2.0 * freedom)) * (limit - freedom)
        certain = quantile(1.0 - LEVEL, 3)
        # What learnt sds add to the limit of a fixed covariance, here as a factor.
        learnt = f_limit(LEVEL, 3, part.denominator) / certain
        return np.where(finite, np.sqrt(np.maximum(square * learnt, 0.0)), math.inf)

    def region(self) -> Array:
        """(N,) the limit of d^T covariance^-1 d for the shifts d of 95 % of the poses."""
        return f_limit(LEVEL, 3, self.covariance.of(np.arange(3)).denominator)


def reached(predictor: Predictor, arms: Arms, q: Array, rounding: Array) -> Reached:
    """The uncertainty at joints q (N, n); rounding (N, 6, 6): of targets as they are written."""
    J, S = arms.machine.twists(q, predictor.names)
    S = S + _tool_turns(predictor.names, arms, q)
    total = predictor.covariance.through(S)
    loose = ~np.isfinite(by_parameters(predictor, S))
    waves = by_further_waves(predictor, S, S, dict(zip(arms.joints, q.T, strict=True)))
    total = replace(total, matrix=total.matrix + waves)
    for part in (_by_readings(predictor, arms, J), _model_error(predictor, arms, len(q))):
        total = total.plus(part)
    none = np.zeros((len(total.slopes), *rounding.shape))
    total = total.plus(LearntCovariance(rounding, rounding, none))
    total = LearntCovariance(
        np.where(loose, np.inf, total.matrix), np.where(loose, np.inf, total.plain), total.slopes
    )
    sds = predictor.readings.sds
    return Reached(total, all(joint in sds for joint in arms.joints))


def _tool_turns(names: tuple[str, ...], arms: Arms, q: Array) -> Array:
    """(N, 6, p) the turns by the parameters that say how the tool sits on the body."""
    tool: Tool = arms.tool
    by = np.zeros((len(q), 6, len(names)))
    if tool.turns:
        R = arms.machine(q)[:, :3, :3] @ arms.machine.tool.T
        tool_turns = R @ turning(tool)
        for i, name in enumerate(tool.turns):
            if name in names:
                by[:, 3:, names.index(name)] = tool_turns[:, :, i]
    return by


def _slopes(predictor: Predictor, name: str) -> Array:
    """Relative changes (a,) of the variance of a quantity along the slopes of the parameters'."""
    return np.array(predictor.readings.slopes.get(name, np.zeros(len(predictor.covariance.slopes))))


def _by_readings(predictor: Predictor, arms: Arms, J: Array) -> LearntCovariance:
    """J Sigma_q J^T (N, 6, 6); joints with unknown sds contribute nothing."""
    sds, joints = predictor.readings.sds, list(arms.joints)
    Sigma = np.diag([sds.get(q, 0.0) ** 2 for q in joints])
    for names, matrix in predictor.readings.joint.items():
        inside = [(i, joints.index(n)) for i, n in enumerate(names) if n in joints]
        for i, row in inside:
            for k, column in inside:
                Sigma[row, column] = matrix[i, k]
    relative = np.array([_slopes(predictor, q) for q in joints]).T
    # An off-diagonal element follows both sds: the geometric mean of their relative changes.
    changes = np.sqrt(np.abs(relative))[:, :, None] * np.sqrt(np.abs(relative))[:, None, :]
    turned = J.transpose(0, 2, 1)
    covariance = J @ Sigma @ turned
    each = np.sign(relative)[:, :, None] * changes * Sigma
    return LearntCovariance(covariance, covariance, J @ each[:, None] @ turned)


def _model_error(predictor: Predictor, arms: Arms, count: int) -> LearntCovariance:
    """What no sensor is to blame for: alike in x, y and z.

    Where the calibration took the joints as exact, errors of joints and machine show in the sds of
    the outputs, with those of the instrument.
    """
    sds, mechanism = predictor.readings.sds, predictor.mechanism
    names = [q for q in disturbances(mechanism) if sds.get(q)]
    if not names and not any(sds.get(joint) for joint in arms.joints):
        names = [q for q in mechanism.outputs if sds.get(q)]
    variances = [_variance(predictor, q) for q in names]
    variance = float(np.mean(variances)) if variances else 0.0
    slopes = np.zeros(len(predictor.covariance.slopes))
    for value, name in zip(variances, names, strict=True):
        slopes = slopes + value * _slopes(predictor, name) / len(names)
    one = np.diag([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
    each = np.broadcast_to(slopes[:, None, None, None] * one, (len(slopes), count, 6, 6))
    covariance = np.broadcast_to(variance * one, (count, 6, 6))
    return LearntCovariance(covariance, covariance, each)


def _variance(predictor: Predictor, quantity: str) -> float:
    """[m^2] of one coordinate; of an angle at the distance of the usual reading."""
    mechanism, sd = predictor.mechanism, predictor.readings.sds[quantity]
    if mechanism.quantities.get(quantity, "m") == "m":
        return sd**2
    family = next((f for f in mechanism.families if quantity in f.readings), None)
    if family is None or family.form not in POLAR:
        return 0.0
    return float((sd * predictor.typical.get(family.readings[0], 0.0)) ** 2)
