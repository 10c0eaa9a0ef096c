"""How sure the pose is that a machine reaches at corrected joints.

    C = J_p C_p J_p^T + J_q Sigma_q J_q^T + model error + J_r Sigma_r J_r^T

C_p: the parameters, those of the instrument's placement among them; Sigma_q: the joints' readings;
Sigma_r: the last digit of the target file, uniform. Propagation is of first order (JCGM 102:2011).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loopcal.chi_squared import quantile
from loopcal.deployment.arms import Arms
from loopcal.deployment.tool import Tool, turning
from loopcal.mechanisms.model_error import disturbances
from loopcal.mechanisms.outputs import POLAR
from loopcal.small_samples import LearntCovariance, f_limit, t_quantile
from loopcal.statistics.predictor import Predictor, by_parameters

Array = NDArray[np.float64]
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
    matrix = by_parameters(predictor, S)
    loose = ~np.isfinite(matrix)
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
