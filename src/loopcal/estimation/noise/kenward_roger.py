"""What learning the variances adds to the covariance of the parameters.

Phi = H^-1, H = sum J^T V^-1 J + prior, is the covariance of the parameters at known variances. At
variance ratios learnt from the same readings, with the covariance W,

    Phi + 2 Lambda,   Lambda = sum_ij W_ij X_i^T P X_j,   X_j = V_j V^-1 J Phi,
    P = V^-1 - V^-1 J Phi J^T V^-1

(Kenward and Roger 1997): the estimates move with the ratios, by Lambda, and Phi at the estimated
ratios is too small on average, by Lambda again. Prior terms are further rows of J, so parameters
with a prior take part as random effects. dPhi/ds_j = Phi M_j Phi with M_j = J^T V^-1 V_j V^-1 J
are the slopes that Student's t needs (`loopcal.small_samples`).

W is the inverse of the information, ratios at zero included: there by chance, they are as unsure
as others. No ratio is more unsure than the whole noise would be, were it all this component's.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loopcal.estimation.noise.linear_model import LinearModel, Whitened, whitened
from loopcal.estimation.noise.variance_components import Estimate
from loopcal.small_samples import LearntCovariance

Array = NDArray[np.float64]
_WIDEST = 3.0
"""Sd of a ratio, at most, in units of the one that would explain all noise."""


@dataclass(frozen=True, eq=False)
class LearntParameters:
    """Covariance of the parameters, and the errors of the ratios that its slopes stand for.

    errors: (c, a) change of each variance ratio along each of `covariance.slopes`.
    """

    covariance: LearntCovariance
    errors: Array


def learnt_parameters(model: LinearModel, found: Estimate) -> LearntParameters:
    """The covariance of the parameters at learnt variance ratios.

    Over the directions that data and prior determine.
    """
    at = whitened(model, found.ratios)
    assert at is not None  # the estimate was made there
    errors = ratio_errors(found)
    slopes = _slopes(at, errors)
    plain = at.root @ at.root.T
    total = plain + 2.0 * _moves(at, errors, slopes, np.sqrt(model.precision))
    return LearntParameters(LearntCovariance(total, plain, slopes), errors)


def ratio_errors(found: Estimate) -> Array:
    """A root (c, c) of the covariance W of the ratios."""
    information = found.at.information
    size = np.sqrt(np.maximum(np.diag(information), 0.0))
    shown = size > 0.0
    scale = np.where(shown, size, 1.0)
    widest = _WIDEST * max(float((found.ratios * size).sum()), 1.0)
    own = information / np.outer(scale, scale) + np.eye(len(size)) / widest**2
    values, vectors = np.linalg.eigh(own)
    errors: Array = np.where(shown, 1.0 / scale, 0.0)[:, None] * vectors / np.sqrt(values)
    return errors


def _slopes(at: Whitened, errors: Array) -> Array:
    """Phi M_a Phi, (a, n, n)."""
    rank, count = at.root.shape[1], len(errors)
    by_component = np.zeros((count, rank, rank))
    for J, W, owner in at.blocks:
        Y = W.transpose(0, 2, 1) @ (J @ at.root)
        for j in range(count):
            own = Y[:, owner == j].reshape(-1, rank)
            by_component[j] += own.T @ own
    inner = np.einsum("ja,jkl->akl", errors, by_component)
    slopes: Array = at.root @ inner @ at.root.T
    return slopes


def _moves(at: Whitened, errors: Array, slopes: Array, prior: Array) -> Array:
    """Lambda (n, n), as a sum of squares; prior: (n,) roots of its precision."""
    n = len(prior)
    total = np.zeros((n, n))
    for along, slope in zip(errors.T, slopes, strict=True):
        rest = prior[:, None] * slope
        total += rest.T @ rest
        for J, W, owner in at.blocks:
            own = along[owner][:, None] * (W.transpose(0, 2, 1) @ (J @ at.root) @ at.root.T)
            moved = (W @ own - J @ slope).reshape(-1, n)
            total += moved.T @ moved
    return total
