"""Errors of joints that repeat where a joint stands the same, as of gears and encoders.

A fit of images learns them as noise of the joints. Noise averages out over images; an error that
follows the joint does not, and lens, mounting and geometry take up a part of it. In units of the
learnt sds the error of joint j in image i is

    u_ij = w_ij + sum_m b_jm cos(m q_ij) + c_jm sin(m q_ij),   m = 1, 2, 3,

w_ij ~ N(0, a_j), and b_jm, c_jm ~ N(0, r_j s_m) with s_m ~ 1 / m^2 of sum 1. With the whitened
equations E_i = D_i dp + X_i u_i + v_i and M_i = X_i^T X_i each image shows z_i = M_i^-1 X_i^T E_i,
of the covariance M_i^-1 - I + cov(u_i); what is left of E_i says nothing of u_i. Each a_j and r_j
is the sum of squares of its amplitudes, given the readings, over how many of these are determined,
until that changes nothing: a maximum of the restricted likelihood (MacKay 1992). One amplitude of
mean size is counted besides. The estimate stays; in directions z with D^T D + P = I its covariance
gains

    sum_i A_i^T (diag(a) - I) A_i + sum_j r_j G_j S G_j^T,   A_i = X_i^T D_i,

G_j the sum over images of row j of A_i times the waves there.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from loopcal.arrays import Array
from loopcal.estimation.dependence.pose_errors import PoseErrors
from loopcal.estimation.dependence.seen import Seen, seen
from loopcal.estimation.problem.pose_equations import PoseEquations
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.products import rows_times
from loopcal.mechanisms.mechanism import PIXELS

# docs/decisions/0168.
_ORDERS = np.arange(1.0, 4.0)
_SIZES = np.tile(_ORDERS**-2 / (_ORDERS**-2).sum(), 2)
"""s of the cosines and of the sines."""
_ROUNDS = 8
"""Chosen, not derived: sds then change by less than a hundredth."""
_COUNTED = 1.0
_LEAST = 1e-6
"""Of M: a direction of the joints that no corner shows. Of variances: none is nothing."""
_FEWEST = 3
"""Images."""


def joint_waves(
    problem: Problem, parameters: Array, equations: Sequence[PoseEquations], root: Array
) -> PoseErrors | None:
    """What they mean for the covariance of z.

    dp = root z, root^T (H + P) root = I; root: (n, k); parameters (n_all,), equations: where the
    fit ended. None without cameras and joints that turn, and beside a structured model error, which
    has terms for them.
    """
    mechanism = problem.mechanism
    names = mechanism.tape.quantities
    sd = np.broadcast_to(problem.uncertainty.sd, problem.readings.shape)
    joints = [
        q
        for q in mechanism.joints
        if q in names
        and mechanism.quantities[q] == "rad"
        and np.isfinite(row := sd[names.index(q)]).all()
        and (row > 0.0).all()
    ]
    images = any(f.form == PIXELS for f in mechanism.families)
    if not images or not joints or not equations or mechanism.structure is not None:
        return None
    view = seen(problem, equations, root, joints)
    if view.read.sum() < _FEWEST:
        return None
    away = problem.precision * (problem.nominal - parameters[problem.free])
    pushed = root.T @ np.where(problem.precision > 0.0, away, 0.0)
    for block in equations:
        pushed += np.einsum("brk,br->k", rows_times(block.D, root), block.E)
    q = problem.readings[[names.index(j) for j in joints]].T[:, :, None] * _ORDERS
    return _learnt(view, np.concatenate([np.cos(q), np.sin(q)], axis=2), pushed)


def _learnt(view: Seen, F: Array, pushed: Array) -> PoseErrors:
    """F: (N, q, f) waves; pushed: (k,) D^T E with the prior's."""
    values, vectors = np.linalg.eigh(view.M)
    inverse = (vectors / np.maximum(values, _LEAST)[:, None]) @ np.swapaxes(vectors, 1, 2)
    B = inverse @ view.A
    z = np.einsum("nij,nj->ni", inverse, view.y)
    (N, q, k), f = B.shape, F.shape[2]
    pixels = inverse - np.eye(q)
    H = np.eye(k) - np.einsum("nqi,nqj->ij", view.A, B, optimize=True)
    g = pushed - np.einsum("nqi,nq->i", view.A, z)
    columns = np.concatenate([B, np.zeros((N, q, q * f)), z[:, :, None]], axis=2)
    for j in range(q):
        columns[:, j, k + j * f : k + (j + 1) * f] = F[:, j]
    a, r = np.ones(q), np.full(q, 0.5)
    count = np.zeros(q)
    for _ in range(_ROUNDS):
        V = np.linalg.inv(pixels + np.diag(a))
        rows = (V @ columns).reshape(N * q, -1)
        scale = np.concatenate([np.ones(k), np.sqrt(np.multiply.outer(r, _SIZES)).ravel()])
        products = columns.reshape(N * q, -1).T @ rows
        total = products[:-1, :-1] * scale * scale[:, None]
        total[:k, :k] += H
        total[k:, k:] += np.eye(q * f)
        covariance = np.linalg.inv(total)
        x = scale * (products[:-1, -1])
        x[:k] += g
        x = covariance @ x
        # of w: its mean a V (z - fit), and what stays unknown of its variance
        by_fit = a[:, None] * rows.reshape(N, q, -1)
        by_fit[:, :, :-1] *= scale
        w = by_fit[:, :, -1] - by_fit[:, :, :-1] @ x
        flat = by_fit[:, :, :-1].reshape(N * q, -1)
        unknown = np.einsum("ni,ni->n", flat @ covariance, flat).reshape(N, q)
        unknown += a - a**2 * np.einsum("nii->ni", V)
        free = np.maximum(N - (unknown / a).sum(axis=0), 0.0)
        count = np.maximum(f - np.diag(covariance)[k:].reshape(q, f).sum(axis=1), 0.0)
        a = _shared(np.square(w).sum(axis=0), free)
        r = _shared(r * np.square(x[k:]).reshape(q, f).sum(axis=1), count)
    G = np.einsum("nqk,nqf->qkf", view.A, F, optimize=True)
    parts = r[:, None, None] * (G * _SIZES) @ np.swapaxes(G, 1, 2)
    waves = parts.sum(axis=0)
    # the sizes of different joints err independently
    sizes = np.trace(parts, axis1=1, axis2=2)
    unsure = np.linalg.norm(np.sqrt(2.0 / (count + _COUNTED)) * sizes)
    white = np.einsum("q,nqi,nqj->ij", a - 1.0, view.A, view.A, optimize=True)
    return PoseErrors(white + waves, unsure / max(sizes.sum(), _LEAST) * waves)


def _shared(squares: Array, counts: Array) -> Array:
    """Variances (q,) from sums of squares of so many amplitudes, and one of mean size."""
    mean = squares.sum() / max(float(counts.sum()), _LEAST)
    return np.asarray(np.maximum((squares + _COUNTED * mean) / (counts + _COUNTED), _LEAST))
