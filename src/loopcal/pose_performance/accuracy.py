"""Pose accuracy AP, before and after the base frame is fitted, with its covariance.

AP = |p - p_c|, p the mean measured position and p_c the commanded one. Of all poses together the
means have the covariance

    C = diag(S_g / n_g) + common errors of each point + J F J^T,

S_g the sample covariance of group g, F = diag(shift^2 I, turn^2 I) of the frame and J its effect.
The base frame is fitted to the means by least squares (Umeyama 1991, without a scale); to first
order the offsets then have the covariance M C M^T, M = I - J (J^T W J)^-1 J^T W, W the numbers of
cycles. Errors of the frame vanish by it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError
from loopcal.pose_performance.instrument import MeasuringErrors
from loopcal.pose_performance.intervals import Estimate, length_interval

Array = NDArray[np.float64]
COLLINEAR = 1e-6
"""Poses within this share of their extent of one line determine no frame."""
SCALE = 0.1
"""A fitted scale so far from one is a wrong unit, not a robot."""


@dataclass(frozen=True, eq=False)
class Group:
    """Readings of one pose from one direction: indices of its rows."""

    pose: str
    direction: str | None
    rows: NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Means:
    """Means of G groups: positions, commanded ones (G, 3); scatter (G, 3, 3) of each mean [m^2];
    cycles (G,); covariance (3G, 3G) of all means, without the frame; frame: what that adds."""

    positions: Array
    commanded: Array
    scatter: Array
    cycles: Array
    covariance: Array
    frame: Array

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
        cycles = np.array([float(len(g.rows)) for g in groups])
        scatter = np.array([covariance_of_mean(measured[g.rows]) for g in groups])
        n = len(groups)
        C = np.zeros((n, 3, n, 3))
        shared: dict[str, Array] = {}
        for i, group in enumerate(groups):
            C[i, :, i] += scatter[i]
            shared.setdefault(group.pose, errors.of_point(positions[i]))
            for k, other in enumerate(groups):
                if other.pose == group.pose:
                    C[i, :, k] += shared[group.pose]
        J = frame_effect(asked)
        F = np.repeat(np.square([errors.frame.length or 0.0, errors.frame.angle or 0.0]), 3)
        return cls(positions, asked, scatter, cycles, C.reshape(3 * n, 3 * n), (J * F) @ J.T)

    def accuracy(self, i: int) -> Estimate:
        """AP of group i as measured."""
        at = slice(3 * i, 3 * i + 3)
        return length_interval(
            self.positions[i] - self.commanded[i],
            self.covariance[at, at] + self.frame[at, at],
            self.scatter[i],
            self.cycles[i] - 1.0,
        )


@dataclass(frozen=True, eq=False)
class FittedBase:
    """The base frame fitted to the means: fitted = rotation @ measured + shift.

    offsets (G, 3), their covariance and the scatter in it (3G, 3G) after it; turn (3, 3):
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
        at = slice(3 * i, 3 * i + 3)
        return length_interval(
            self.offsets[i],
            self.covariance[at, at],
            self.scatter[at, at],
            means.cycles[i] - 1.0,
        )


def fitted_base(means: Means) -> FittedBase | str:
    """The base frame that fits the means best, or why the poses determine none.

    Raises InputError where measured and commanded positions differ in scale, as by a wrong unit.
    """
    weight = means.cycles / means.cycles.sum()
    centre, asked = weight @ means.positions, weight @ means.commanded
    P, Q = means.positions - centre, means.commanded - asked
    spread = np.linalg.svd(Q, compute_uv=False)
    if len(np.unique(means.commanded, axis=0)) < 3 or spread[1] <= COLLINEAR * spread[0]:
        return "the base frame is not fitted: it takes three poses that are not on one line"
    _refuse_scale(P, Q)
    U, _, V = np.linalg.svd((weight[:, None] * Q).T @ P)
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ V)]) @ V
    J = frame_effect(means.commanded)
    W = np.repeat(means.cycles, 3)
    solve = np.linalg.solve(J.T @ (W[:, None] * J), J.T * W)
    M = np.eye(len(W)) - J @ solve
    turned = np.kron(np.eye(len(P)), R)
    own = turned @ means.covariance @ turned.T
    n = len(P)
    scatter = np.zeros((n, 3, n, 3))
    scatter[range(n), :, range(n)] = R @ means.scatter @ R.T
    return FittedBase(
        R,
        asked - R @ centre,
        P @ R.T - Q,
        M @ own @ M.T,
        M @ scatter.reshape(3 * n, 3 * n) @ M.T,
        (solve @ own @ solve.T)[3:, 3:],
    )


def covariance_of_mean(readings: Array) -> Array:
    """Sample covariance (d, d) of the mean of readings (n, d); zero for one reading."""
    n = len(readings)
    if n < 2:
        return np.zeros((readings.shape[1], readings.shape[1]))
    return np.atleast_2d(np.cov(readings.T)) / n


def frame_effect(points: Array) -> Array:
    """J (3G, 6): what a shift and a small turn of the frame do to points (G, 3)."""
    J = np.zeros((len(points), 3, 6))
    J[:, :, :3] = np.eye(3)
    for axis in range(3):
        J[:, :, 3 + axis] = np.cross(np.eye(3)[axis], points)
    return J.reshape(-1, 6)


def _refuse_scale(P: Array, Q: Array) -> None:
    scale = float(np.linalg.norm(P) / np.linalg.norm(Q))
    if not 1.0 - SCALE < scale < 1.0 + SCALE:
        raise InputError(
            f"measured distances are {scale:.4g} times the commanded ones",
            code="implausible-unit",
            remedy="check the units of the measured and of the commanded columns, and that the "
            "rows belong to these poses",
        )
