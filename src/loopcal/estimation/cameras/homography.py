"""Homographies of planar boards, one per view, and the focal length that they agree on.

    (u, v, 1)^T ~ H (x, y, 1)^T

Normalised direct linear transform (Hartley and Zisserman 2004, section 4.4), weighted anew by the
residuals of each view so that wrong corners lose their weight. Of a camera with square pixels
H = K (r1 r2 t), so that omega = K^-T K^-1 gives two linear equations per view (Zhang 2000):

    h1^T omega h2 = 0,    h1^T omega h1 = h2^T omega h2.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.estimation.cameras.corners import Views

_ROUNDS = 8
"""Reweighting steps: with 10 % wrong corners the weights settle after five to seven."""


def robust_weights(views: Views, r: Array) -> Array:
    """(N,) Geman-McClure weights of distances r (N,), by the median distance of each view."""
    scale = 2.0 * views.medians(r) + 1e-9 * (1.0 + r.max(initial=0.0))
    return np.asarray(1.0 / (1.0 + (r / scale[views.of_corner]) ** 2) ** 2)


def homographies(views: Views, xy: Array, uv: Array) -> tuple[Array, Array]:
    """H (V, 3, 3) from board points xy to uv (both (N, 2)), and the final weights (N,).

    A view of fewer than four corners, or of corners on one line, gives a homography of no meaning:
    `spread` says which ones to trust.
    """
    weight = np.ones(len(xy))
    for _ in range(_ROUNDS):
        H, before = _direct(views, xy, uv, weight), weight
        weight = robust_weights(views, transfer_errors(views, H, xy, uv))
        if np.abs(weight - before).max(initial=0.0) < 0.05:
            break
    return H, weight


def transfer_errors(views: Views, H: Array, xy: Array, uv: Array) -> Array:
    """(N,) distances between uv and what H says."""
    mapped = (H[views.of_corner] @ np.column_stack([xy, np.ones(len(xy))])[:, :, None])[:, :, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = np.linalg.norm(mapped[:, :2] / mapped[:, 2:] - uv, axis=1)
    return np.asarray(np.nan_to_num(distance, nan=1e6, posinf=1e6))


def spread(views: Views, xy: Array) -> NDArray[np.bool_]:
    """(V,) whether a view has four corners that are not on one line."""
    centred = xy - (views.sums(xy) / views.sizes[:, None])[views.of_corner]
    low, high = np.linalg.eigvalsh(views.sums(centred[:, :, None] * centred[:, None, :])).T
    # Corners on two lines of a grid have a spread of 1 : (n / 2)^2, far above 1e-4.
    return np.asarray((views.sizes >= 4) & (low > 1e-4 * high))


def _direct(views: Views, xy: Array, uv: Array, weight: Array) -> Array:
    a, A = _normalised(views, xy, weight)
    b, B = _normalised(views, uv, weight)
    one, none = np.ones(len(a)), np.zeros((len(a), 3))
    p = np.column_stack([a, one])
    rows = np.stack(
        [np.hstack([p, none, -b[:, :1] * p]), np.hstack([none, p, -b[:, 1:] * p])], axis=1
    )
    H = np.linalg.eigh(views.products(np.sqrt(weight)[:, None, None] * rows))[1][:, :, 0].reshape(
        -1, 3, 3
    )
    return np.asarray(np.linalg.inv(B) @ H @ A)


def _normalised(views: Views, points: Array, weight: Array) -> tuple[Array, Array]:
    """Points about their mean with mean distance sqrt(2), and the (V, 3, 3) that makes them so."""
    total = views.sums(weight)
    mean = views.sums(weight[:, None] * points) / total[:, None]
    centred = points - mean[views.of_corner]
    distance = views.sums(weight * np.linalg.norm(centred, axis=1)) / total
    scale = np.sqrt(2.0) / np.maximum(distance, 1e-12)
    N = np.zeros((len(views), 3, 3))
    N[:, 0, 0] = N[:, 1, 1] = scale
    N[:, :2, 2], N[:, 2, 2] = -scale[:, None] * mean, 1.0
    return centred * scale[views.of_corner][:, None], N


def focal_length(H: Array, centre: Array) -> float | None:
    """f [px] of square pixels about a principal point, from homographies (V, 3, 3) in px.

    Each of the two equations of a view is linear in 1/f^2. They are solved by the weighted median
    of single answers, so that wrong views do not decide. None where no view is tilted enough.
    """
    shift = np.eye(3)
    shift[:2, 2] = -centre
    h1, h2 = np.moveaxis((shift @ H)[:, :, :2], 2, 0)
    length = 0.5 * (np.linalg.norm(h1[:, :2], axis=1) + np.linalg.norm(h2[:, :2], axis=1))
    h1, h2 = h1 / length[:, None], h2 / length[:, None]
    a = np.append((h1 * h2)[:, :2].sum(axis=1), (h1[:, :2] ** 2 - h2[:, :2] ** 2).sum(axis=1) / 2.0)
    b = -np.append(h1[:, 2] * h2[:, 2], (h1[:, 2] ** 2 - h2[:, 2] ** 2) / 2.0)
    # a / f^2 = b: of a board that is not tilted both vanish, and noise alone decides.
    usable = (a * b > 0.0) & np.isfinite(a) & np.isfinite(b)
    if usable.sum() < 3:
        return None
    f = np.sqrt(a[usable] / b[usable])
    weight = np.abs(b[usable]) * f
    order = np.argsort(f)
    half = np.searchsorted(np.cumsum(weight[order]), 0.5 * weight.sum())
    return float(f[order][half])
