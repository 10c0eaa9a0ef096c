"""What least squares leaves in images: an error that all pixels of an image share, and their noise.

Least squares takes the poses that a robot states as exact. What these err by, and what the machine
model lacks, moves all pixels of an image together. In the equations of image i,

    E_i = D_i dp + X_i u_i + v_i,   u_i ~ N(0, U),   v_i ~ N(0, s^2 I),

X_i holds the modes of `image_modes`, shifts and linear stretches, six for each camera. The estimate
stays. Its covariance is the sandwich

    C (sum_i D_i^T V_i D_i) C,   V_i = X_i R X_i^T + s^2 (I - X_i M_i^-1 X_i^T),   M_i = X_i^T X_i,

with C = (sum_i D_i^T D_i)^-1 and R the mean of u_i u_i^T by the residuals, freed of what the fit
took from them (Bell and McCaffrey 2002: CR2),

    e_i = (I - D_i C D_i^T)^(-1/2) E_i,   u_i = M_i^-1 X_i^T e_i.

s^2 is the mean square of what the modes leave of e. R holds the noise of the pixels, so that where
nothing is shared the sds stay as they are on average. U = R - s^2 mean of M_i^-1, without its
negative eigenvalues, is what predicted images share. Of q modes that N images show n parameters
take n / q images, so nu = N - n / q degrees of freedom are left.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from loopcal.arrays import Array
from loopcal.estimation.problem.error_modes import image_modes
from loopcal.estimation.problem.pose_equations import PoseEquations
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.products import rows_times
from loopcal.estimation.solve.solution import Solution

# An image that alone determines a direction has redundancy 0 there, and its root no bound.
_LEAST = 1e-6
# Chosen, not derived: a few corners in one place show no stretch of an image.
_SHOWN = 1e-2
"""Modes that the corners of an image show by less than this share of the best one do not count."""
# Below 2 degrees of freedom the mean of a square of Student's t has no bound.
_FEWEST = 2.2


@dataclass(frozen=True, eq=False)
class ImageErrors:
    """factor (k, q) [px] by reading: F u of u ~ N(0, I) is the error that an image shares; sd [px]
    of a pixel beside it; covariance (n, n) [SI] of the estimate, known with `freedom` degrees."""

    factor: Array
    sd: float
    covariance: Array
    freedom: float

    def shared(self, block: PoseEquations) -> Array:
        """(b, r, r) the covariance of the shared part of the equations of images, which must keep
        the modes of `factor`."""
        X = block.X @ self.factor
        return np.asarray(X @ np.swapaxes(X, 1, 2))


def image_errors(
    problem: Problem, solution: Solution, equations: Sequence[PoseEquations]
) -> ImageErrors | None:
    """Of images beside poses that were read; None where joints or nothing but the images say where
    a board is, and where images are too few.

    equations: where the fit ended, all loops weighted alike.
    """
    images = all(p.predicted and not p.unmeasured for p in problem.patterns)
    modes, C = image_modes(problem), solution.spectrum.covariance()
    q = modes.shape[1]
    if not q or not images or problem.mechanism.joints:
        return None
    freedom = problem.count - solution.spectrum.rank / q
    if freedom < _FEWEST:
        return None
    squares, count, gathered = 0.0, 0, []
    products, noise, pairs = np.zeros((3, q, q))
    for block in equations:
        e, X = _freed(block, C), block.X @ modes
        turned = np.swapaxes(X, 1, 2)
        M = turned @ X
        inverse = np.linalg.pinv(M, rcond=_SHOWN, hermitian=True)
        u = (inverse @ turned @ e[:, :, None])[:, :, 0]
        read = (np.einsum("bqq->bq", M) > 0.0).astype(float)
        squares += float(np.square(e).sum() - np.einsum("bq,bqp,bp->", u, M, u))
        count += int(block.count.sum() - read.sum())
        products, noise, pairs = (
            products + u.T @ u,
            noise + inverse.sum(axis=0),
            pairs + read.T @ read,
        )
        gathered.append((turned @ block.D, inverse))
    variance, pairs = max(squares, 0.0) / max(count, 1), np.maximum(pairs, 1.0)
    values, vectors = np.linalg.eigh((products - variance * noise) / pairs)
    meat = variance * solution.data.products[:-1, :-1]
    for A, inverse in gathered:
        meat += (np.swapaxes(A, 1, 2) @ (products / pairs - variance * inverse) @ A).sum(axis=0)
    factor = modes @ (vectors * np.sqrt(np.maximum(values, 0.0)))
    return ImageErrors(factor, math.sqrt(variance), C @ meat @ C, freedom)


def _freed(block: PoseEquations, C: Array) -> Array:
    """(b, r) the residuals freed of what the fit took from them."""
    taken = rows_times(block.D, C) @ np.swapaxes(block.D, 1, 2)
    values, vectors = np.linalg.eigh(np.eye(taken.shape[1]) - taken)
    along = np.swapaxes(vectors, 1, 2) @ block.E[:, :, None]
    root = vectors / np.sqrt(np.maximum(values, _LEAST))[:, None, :]
    return np.asarray((root @ along)[:, :, 0])
