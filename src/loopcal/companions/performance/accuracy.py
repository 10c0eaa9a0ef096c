"""Pose accuracy AP, before and after the base frame is fitted, with its covariance.

AP = |p - p_c|, p the mean measured position and p_c the commanded one. Of all poses together the
means have the covariance

    C = diag(S_g / n_g) + common errors of each point + J F J^T,

S_g the sample covariance of group g, F = diag(shift^2 I, turn^2 I) of the frame and J its effect.
The base frame is fitted to the means by least squares (Umeyama 1991, without a scale). The offsets
then have the covariance M C M^T to first order, M = I - J (J^T W J)^-1 J^T W. W holds the numbers
of cycles. Errors of the frame vanish by the fit. In a plane the frame has two shifts and the turn
about z.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.companions.performance.instrument import MeasuringErrors
from loopcal.companions.performance.intervals import Estimate, length_interval
from loopcal.errors import InputError
from loopcal.mechanisms.rotations import nearest_rotation

COLLINEAR = 1e-6
"""Poses within this share of their extent of one line determine no frame."""
_IN_PLANE = [0, 1, 5]
"""Shifts along x and y and the turn about z, of those of a frame."""
SCALE = 0.1
"""A fitted scale so far from one is a wrong unit, not a robot."""


@dataclass(frozen=True, eq=False)
class Group:
    """Readings of one pose from one direction: indices of its rows."""

    pose: str
    direction: str | None
    rows: NDArray[np.intp]

    @property
    def name(self) -> str:
        """The pose, and its direction where there are several."""
        return self.pose if self.direction is None else f"{self.pose}, {self.direction}"


@dataclass(frozen=True, eq=False)
class Means:
    """Means of G groups: positions and commanded ones (G, 3); cycles (G,).

    scatter (G, 3, 3): covariance of each mean by its readings [m^2]; shared (G, 3, 3): of what all
    readings of its point share; pose (G,): number of that point; frame (G, 3, 3): what the frame
    adds; planar: whether z was not measured, and is 0.
    """

    positions: Array
    commanded: Array
    cycles: Array
    scatter: Array
    shared: Array
    pose: NDArray[np.intp]
    frame: Array
    planar: bool = False

    @classmethod
    def of(
        cls,
        groups: Sequence[Group],
        measured: Array,
        commanded: Array,
        errors: MeasuringErrors,
    ) -> Means:
        """The means of groups of rows of measured and commanded positions (N, 3) [m]."""
        positions = np.array([measured[g.rows].mean(axis=0) for g in groups])
        asked = np.array([commanded[g.rows[0]] for g in groups])
        numbers: dict[str, int] = {}
        pose = np.array([numbers.setdefault(g.pose, len(numbers)) for g in groups])
        first = [positions[int(np.argmax(pose == n))] for n in range(len(numbers))]
        J = frame_effect(asked, errors.planar)
        F = np.repeat(np.square([errors.frame.length or 0.0, errors.frame.angle or 0.0]), 3)
        F = F[_IN_PLANE] if errors.planar else F
        return cls(
            positions,
            asked,
            np.array([float(len(g.rows)) for g in groups]),
            np.array([covariance_of_mean(measured[g.rows]) for g in groups]),
            np.array([errors.of_point(point) for point in first])[pose],
            pose,
            (J * F) @ J.transpose(0, 2, 1),
            errors.planar,
        )

    def accuracy(self, i: int) -> Estimate:
        """AP of group i as measured."""
        return length_interval(
            self.positions[i] - self.commanded[i],
            self.scatter[i] + self.shared[i] + self.frame[i],
            self.scatter[i],
            self.cycles[i] - 1.0,
        )


@dataclass(frozen=True, eq=False)
class FittedBase:
    """The base frame fitted to the means: fitted = rotation @ measured + shift.

    offsets (G, 3), their covariances and the scatter in these (G, 3, 3) after it; turn (3, 3):
    covariance of the rotation by everything but the frame itself [rad^2].
    """

    rotation: Array
    shift: Array
    offsets: Array
    covariance: Array
    scatter: Array
    turn: Array

    def accuracy(self, i: int, means: Means) -> Estimate:
        """AP of group i after the fit."""
        return length_interval(
            self.offsets[i], self.covariance[i], self.scatter[i], means.cycles[i] - 1.0
        )


def fitted_base(means: Means) -> FittedBase | str:
    """The base frame that fits the means best, or why the poses determine none.

    Raises InputError where measured and commanded positions differ in scale, as by a wrong unit.
    """
    weight = means.cycles / means.cycles.sum()
    centre, asked = weight @ means.positions, weight @ means.commanded
    P, Q = means.positions - centre, means.commanded - asked
    spread, different = np.linalg.svd(Q, compute_uv=False), len(np.unique(means.commanded, axis=0))
    if means.planar and different < 2:
        return "the base frame is not fitted: it takes two poses"
    if not means.planar and (different < 3 or spread[1] <= COLLINEAR * spread[0]):
        return "the base frame is not fitted: it takes three poses that are not on one line"
    _refuse_scale(P, Q)
    d, R = 2 if means.planar else 3, np.eye(3)
    R[:d, :d] = nearest_rotation(((weight[:, None] * Q).T @ P)[:d, :d])
    scatter, shared = (R @ C @ R.T for C in (means.scatter, means.shared))
    J = frame_effect(means.commanded, means.planar)
    whole = _after_fit(J, means, scatter, shared)
    # The scatter of the cycles alone has few degrees of freedom; what a data sheet states has none.
    alone = _after_fit(J, means, scatter, np.zeros_like(shared))
    turn = np.zeros((3, 3))
    turn[-1:, -1:] = whole.frame[-1:, -1:]
    turn = turn if means.planar else whole.frame[3:, 3:]
    return FittedBase(R, asked - R @ centre, P @ R.T - Q, whole.offsets, alone.offsets, turn)


@dataclass(frozen=True, eq=False)
class _AfterFit:
    """Covariances of the offsets (G, 3, 3), and of the fitted frame (6, 6)."""

    offsets: Array
    frame: Array


def _after_fit(J: Array, means: Means, scatter: Array, shared: Array) -> _AfterFit:
    """The blocks of M C M^T on its diagonal, C = diag(scatter) + what groups of a pose share.

    With S = (J^T W J)^-1 J^T W: block = C_gg - J_g (S C)_g - its transpose + J_g S C S^T J_g^T.
    """
    weighted = means.cycles[:, None, None] * J
    normal = np.einsum("gij,gik->jk", weighted, J)
    S = np.linalg.solve(normal, weighted.transpose(0, 2, 1))  # (G, 6, 3)
    # Groups of one pose share its tracker errors, so S is added up over the groups of a pose.
    of_pose = np.zeros((int(means.pose.max()) + 1, *S.shape[1:]))
    np.add.at(of_pose, means.pose, S)
    SC = S @ scatter + of_pose[means.pose] @ shared
    frame = np.einsum("gij,gkj->ik", SC, S)
    crossed = J @ SC
    direct = scatter + shared + J @ frame @ J.transpose(0, 2, 1)
    return _AfterFit(direct - crossed - crossed.transpose(0, 2, 1), frame)


def covariance_of_mean(readings: Array) -> Array:
    """Sample covariance (d, d) of the mean of readings (n, d); zero for one reading."""
    n = len(readings)
    if n < 2:
        return np.zeros((readings.shape[1], readings.shape[1]))
    return np.atleast_2d(np.cov(readings.T)) / n


def frame_effect(points: Array, planar: bool = False) -> Array:
    """J (G, 3, 6), in a plane (G, 3, 3): what a shift and a small turn of the frame do to points
    (G, 3)."""
    J = np.zeros((len(points), 3, 6))
    J[:, :, :3] = np.eye(3)
    for axis in range(3):
        J[:, :, 3 + axis] = np.cross(np.eye(3)[axis], points)
    return J[:, :, _IN_PLANE] if planar else J


def _refuse_scale(P: Array, Q: Array) -> None:
    scale = float(np.linalg.norm(P) / np.linalg.norm(Q))
    if not 1.0 - SCALE < scale < 1.0 + SCALE:
        raise InputError(
            f"measured distances are {scale:.4g} times the commanded ones",
            code="implausible-unit",
            remedy="check the units of the measured and of the commanded columns, and that the "
            "rows belong to these poses",
        )
