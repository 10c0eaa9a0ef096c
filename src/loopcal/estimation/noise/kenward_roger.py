"""What learning the variances adds to the covariance of the parameters.

Phi = H^-1, H = sum J^T V^-1 J + prior, is the covariance of the parameters at known variances. At
variance ratios learnt from the same readings, with the covariance W,

    Phi + 2 Lambda,   Lambda = sum_ij W_ij X_i^T P X_j,   X_j = V_j V^-1 J Phi,
    P = V^-1 - V^-1 J Phi J^T V^-1

(Kenward and Roger 1997): the estimates move with the ratios, by Lambda, and Phi at the estimated
ratios is too small on average, by Lambda again. Prior terms are further rows of J, so parameters
with a prior take part as random effects. dPhi/ds_j = Phi M_j Phi with M_j = J^T V^-1 V_j V^-1 J
are the slopes that Student's t needs (`loopcal.small_samples`).

The rows of a term's parameters in the prior are loadings of the term's variance. W is the inverse
of the information, ratios at zero included: there by chance, they are as unsure as others. No ratio
is more unsure than the whole noise would be, were it all this component's.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from loopcal.estimation.noise.linear_model import WhitenedModel, whitened_model
from loopcal.estimation.noise.variances import owners
from loopcal.small_samples import LearntCovariance

if TYPE_CHECKING:
    from collections.abc import Sequence

    from loopcal.estimation.noise.estimation import NoiseEstimate
    from loopcal.estimation.noise.variance_components import Estimate

Array = NDArray[np.float64]
_WIDEST = 3.0
"""Sd of a ratio, at most, in units of the one that would explain all noise."""
_RIDGE = 1e-6
_CERTAIN = 0.03
"""A change of no variance by more than this share leaves thousands of degrees of freedom."""


@dataclass(frozen=True, eq=False)
class LearntParameters:
    """Covariance of the parameters, and the errors of the ratios that its slopes stand for.

    errors: (c, a) change of each sensor's variance ratio along each of `covariance.slopes`.
    """

    covariance: LearntCovariance
    errors: Array


@dataclass(frozen=True, eq=False)
class _Term:
    """The estimated parameters of a term, and what is known beforehand of its log variance."""

    index: NDArray[np.intp]
    precision: float


def learnt_parameters(estimate: NoiseEstimate) -> LearntParameters:
    """The covariance of the parameters at learnt variances of sensors and terms.

    Over the directions that data and prior determine.
    """
    model, found = estimate.model, estimate.found
    at = whitened_model(model, found.ratios)
    assert at is not None  # the estimate was made there
    prior = np.sqrt(model.precision)
    own, stated = owners(estimate.problem), estimate.problem.mechanism.terms
    terms = [
        _Term(np.flatnonzero(own == i), 0.25 / term.spread**2)
        for i, term in enumerate(stated)
        if (own == i).any()
    ]
    inner = _inner(at, prior, terms, len(found.ratios))
    errors = _errors(found, inner, terms)
    along = np.einsum("ja,jkl->akl", errors, inner)
    matters = np.abs(np.linalg.eigvalsh(along)).max(axis=1, initial=0.0) > _CERTAIN
    errors, slopes = errors[:, matters], at.root @ along[matters] @ at.root.T
    plain = at.root @ at.root.T
    total = plain + 2.0 * _moves(at, errors, slopes, prior, terms)
    return LearntParameters(LearntCovariance(total, plain, slopes), errors[: len(found.ratios)])


def _inner(at: WhitenedModel, prior: Array, terms: Sequence[_Term], components: int) -> Array:
    """root^T M_j root of the sensors, then by the log variance of each term, (c + t, k, k)."""
    rank = at.root.shape[1]
    inner = np.zeros((components + len(terms), rank, rank))
    for J, W, owner in at.blocks:
        Y = W.transpose(0, 2, 1) @ (J @ at.root)
        for j in range(components):
            own = Y[:, owner == j].reshape(-1, rank)
            inner[j] += own.T @ own
    for j, term in enumerate(terms):
        U = prior[term.index, None] * at.root[term.index]
        inner[components + j] = U.T @ U
    return inner


def _errors(found: Estimate, inner: Array, terms: Sequence[_Term]) -> Array:
    """A root (c + t, c + t) of the covariance W of ratios and log variances of terms."""
    c = len(found.ratios)
    flat = inner.reshape(len(inner), -1)
    information = 0.5 * flat @ flat.T
    information[:c, :c] = found.at.information
    for j, term in enumerate(terms, c):
        own = 0.5 * (len(term.index) - 2.0 * np.trace(inner[j]))
        information[j, j] += own + term.precision
    size = np.sqrt(np.maximum(np.diag(information), 0.0))
    shown = size > 0.0
    scale = np.where(shown, size, 1.0)
    widest = _WIDEST * max(float((found.ratios * size[:c]).sum()), 1.0)
    flattest = np.where(np.arange(len(size)) < c, widest**-2, 0.0)
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale) + np.diag(flattest))
    root = vectors / np.sqrt(np.maximum(values, _RIDGE))
    errors: Array = np.where(shown, 1.0 / scale, 0.0)[:, None] * root
    return errors


def _moves(
    at: WhitenedModel, errors: Array, slopes: Array, prior: Array, terms: Sequence[_Term]
) -> Array:
    """Lambda (n, n), as a sum of squares; prior: (n,) roots of its precision."""
    n, c = len(prior), len(errors) - len(terms)
    total = np.zeros((n, n))
    plain = at.root @ at.root.T
    for along, slope in zip(errors.T, slopes, strict=True):
        rest = -prior[:, None] * slope
        for change, term in zip(along[c:], terms, strict=True):
            rest[term.index] += change * prior[term.index, None] * plain[term.index]
        total += rest.T @ rest
        for J, W, owner in at.blocks:
            own = along[owner][:, None] * (W.transpose(0, 2, 1) @ (J @ at.root) @ at.root.T)
            moved = (W @ own - J @ slope).reshape(-1, n)
            total += moved.T @ moved
    return total
