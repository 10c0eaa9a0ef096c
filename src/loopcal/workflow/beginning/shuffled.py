"""Points and joints that are of the same poses, and not row by row.

No order and no placement of an instrument changes the distances between points. The place of the
target on the body that makes those of the nominal machine most like the measured ones is where the
search begins. Then points and poses are assigned to each other (Kuhn 1955) and placement and target
fitted, in turn (Besl and McKay 1992), from each way to lay the main axes of both sets together.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from loopcal.arrays import Array
from loopcal.estimation.mounted import Bodies, see_points
from loopcal.estimation.problem.alignment import align
from loopcal.files.recognition.meanings import Meaning

# Chosen, not derived: fewer points lie near any others, more take seconds to assign.
_FEWEST, _MOST = 20, 300
# Chosen, not derived: caps of searches that end by themselves, for their time.
_TRIALS, _ROUNDS = 200, 20
_AROUND = 0.1
"""Steps [m] with which the search for the target begins."""
_FEW, _QUANTILES = 100, np.linspace(0.05, 0.95, 19)
# Chosen, not derived: twice the scatter of quantiles of so many points.
_SAME = 0.1
"""Sets whose distances differ by a larger share are not of the same points."""


def reordered(bodies: Bodies, meaning: Meaning) -> Meaning:
    """The points in the order in which the nominal machine misses them least, with that fit.

    As they are where there are too few or too many, or one is missing.
    """
    points = meaning.position
    count = len(points)
    whole = points.ndim == 2 and np.isfinite(points).all() and bodies.complete.all()
    if not (whole and _FEWEST <= count <= _MOST):
        return meaning
    from scipy.optimize import linear_sum_assignment

    best, target = meaning, _target(bodies, points)
    for start in () if target is None else _laid(bodies.at(target), points):
        placed, order = start, np.arange(count)
        for _ in range(_ROUNDS):
            before = order
            gaps = np.square(placed[:, None] - points[None]).sum(axis=2)
            order = linear_sum_assignment(gaps)[1]
            if (order == before).all():
                break
            seen = bodies.at(see_points(bodies, points[order][None], 1).targets[0])
            motion = align(seen.T, points[order].T)
            placed = seen @ motion.rotation.T + motion.shift
        turns = None if meaning.turns is None else meaning.turns[order]
        other = replace(meaning, position=points[order], turns=turns).fitted(bodies)
        best = min(best, other, key=lambda one: one.share)
    return best


def _target(bodies: Bodies, points: Array) -> Array | None:
    """The place (3,) on the body whose points have distances most like those of the points; None
    where these are of another unit or machine."""
    from scipy.optimize import minimize

    few = np.unique(np.linspace(0, len(points) - 1, _FEW).astype(np.intp))
    some = Bodies(bodies.rotations[few], bodies.origins[few])
    stated = _distances(points[few])
    nearest = minimize(
        lambda u: np.abs(_distances(some.at(u)) - stated).max() / stated.max(),
        np.zeros(3),
        method="Nelder-Mead",
        options={"maxfev": _TRIALS, "initial_simplex": _AROUND * np.eye(4, 3, -1)},
    )
    return np.asarray(nearest.x) if nearest.fun < _SAME else None


def _distances(points: Array) -> Array:
    """Quantiles of the distances between the points."""
    first, second = np.triu_indices(len(points), 1)
    distances = np.linalg.norm(points[first] - points[second], axis=1)
    return np.asarray(np.quantile(distances, _QUANTILES))


def _laid(points: Array, onto: Array) -> list[Array]:
    """Points (N, 3) with their main axes on those of others, each way that is a rotation."""
    A, B = (np.linalg.svd(p - p.mean(axis=0), full_matrices=False)[2].T for p in (points, onto))
    turned = [B @ np.diag(signs) @ A.T for signs in product((1.0, -1.0), repeat=3)]
    off = points - points.mean(axis=0)
    return [off @ R.T + onto.mean(axis=0) for R in turned if np.linalg.det(R) > 0.0]
