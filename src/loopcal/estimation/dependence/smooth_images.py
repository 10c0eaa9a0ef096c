"""What errors that stated poses share with their neighbours add where least squares took them as
exact.

The covariance of `image_errors` counts what all pixels of an image share, and takes images as
independent. The geometry of a robot makes errors of its poses that are alike in neighbouring ones,
which places and lens take up (docs/decisions/0161). With E_i = D_i dp + X_i u_i + v_i, u_i errors
of the stated pose along the base and v_i ~ N(0, s^2 I), the estimate has the covariance

    C (s^2 sum_i D_i^T D_i + sum_ij D_i^T X_i cov(u_i, u_j) X_j^T D_j) C,

averaged by restricted likelihood over a grid: as in `pose_errors`, with the share of positions in
what errors of poses do to the pixels besides. In units of that effect the variance is about 1. Of
the result only what exceeds the covariance of `image_errors` in a direction is added to it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from loopcal.arrays import Array
from loopcal.estimation.dependence.image_errors import ImageErrors
from loopcal.estimation.dependence.pose_errors import LENGTHS, Grid, along_base, scaled
from loopcal.estimation.dependence.seen import seen
from loopcal.estimation.dependence.stated_poses import QUANTITIES, StatedPoses
from loopcal.estimation.problem.pose_equations import PoseEquations
from loopcal.estimation.problem.problem import Problem

# Chosen, not derived: a factor of 3 between sds of positions and turns either way.
_POSITIONS = (0.1, 0.5, 0.9)
"""Shares of positions in the effect of errors of poses."""
_RANK = 1e-12


class SmoothPart(NamedTuple):
    """part (n, n) [SI] of the covariance, and the relative sd of its size."""

    part: Array
    spread: float


def smooth_part(
    problem: Problem, images: ImageErrors, equations: Sequence[PoseEquations], C: Array
) -> SmoothPart | None:
    """Of least squares with the covariance C (n, n) of equations of variance 1; equations: where
    the fit ended. None where no robot states the poses, or images show no error of them."""
    poses = StatedPoses.of(problem)
    if poses is None or not images.sd:
        return None
    white = [replace(b, E=b.E / images.sd, D=b.D / images.sd, X=b.X / images.sd) for b in equations]
    root, inverse = _roots(images.sd**2 * C)
    view = along_base(seen(problem, white, root, QUANTITIES), poses.R)
    read = view.read
    effect = view.M[read].diagonal(axis1=1, axis2=2).mean(axis=0)
    left = np.einsum(
        "nq,nqp,np->n", view.y, np.linalg.pinv(view.M, rcond=1e-9, hermitian=True), view.y
    )
    count = max(int(read.sum()), 1)
    power = float(left[read].mean()) - len(effect) + root.shape[1] / count
    # The mean of chi-squared of six over so many images: within two sds it is chance.
    if power <= 2.0 * math.sqrt(2.0 * len(effect) / count) or not (effect > 0.0).all():
        return None
    grids = []
    for share in _POSITIONS:
        units = np.repeat(
            [
                math.sqrt(share * power / effect[:3].sum()),
                math.sqrt((1.0 - share) * power / effect[3:].sum()),
            ],
            3,
        )
        grid = Grid.of(np.zeros(root.shape[1]), white, root, scaled(view, units), np.zeros(6))
        grids += [] if grid is None else [(units, grid.points(poses))]
    if not grids:
        return None
    least = min(float(points[:, 0].min()) for _, points in grids)
    weights = [np.exp(-0.5 * (points[:, 0] - least)) for _, points in grids]
    total = sum(float(w.sum()) for w in weights)
    model, moments = np.eye(root.shape[1]), np.zeros(2)
    for (units, points), weight in zip(grids, weights, strict=True):
        _, place, share, variance = points.T
        of_each = weight / total * variance
        A = scaled(view, units).A
        model += float(of_each @ (1.0 - share)) * np.einsum("nqi,nqj->ij", A, A)
        flat = A.reshape(len(A), -1)
        for i, length in enumerate(LENGTHS):
            size = float((of_each * share)[place == i].sum())
            along = (poses.alike(poses, length) @ flat).reshape(A.shape)
            model += size * np.einsum("nqi,nqj->ij", A, along)
        smooth = variance * share
        moments += [float(weight / total @ smooth), float(weight / total @ smooth**2)]
    spread = math.sqrt(max(moments[1] - moments[0] ** 2, 0.0)) / max(moments[0], 1e-300)
    values, vectors = np.linalg.eigh(
        0.5 * (model + model.T) - inverse @ images.covariance @ inverse.T
    )
    more = root @ (vectors * np.sqrt(np.maximum(values, 0.0)))
    return SmoothPart(np.asarray(more @ more.T), spread)


def _roots(C: Array) -> tuple[Array, Array]:
    """R (n, k) and its inverse (k, n), R R^T = C (n, n)."""
    scale = np.sqrt(np.maximum(np.diag(C), 1e-300))
    values, vectors = np.linalg.eigh(C / np.outer(scale, scale))
    kept = values > _RANK * values[-1]
    size, axes = np.sqrt(values[kept]), vectors[:, kept]
    return scale[:, None] * axes * size, (axes / size).T / scale
