"""What poses promise: the sds of the end point and of every parameter, by their number."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from loopcal.planning.information import Information
from loopcal.planning.planned import Expected, RandomSets
from loopcal.planning.search import (
    Criterion,
    Search,
    criterion_value,
    inverse,
    test_variances,
)

Array = NDArray[np.float64]
SHARE = 0.2
"""Of the chosen poses, to validate."""
_LOOSE = 1e3
"""Times the ridge: directions with less information are not determined."""
# Twelve sets, up to five times as many poses, at sixteen sizes: a curve to compare with.
_SETS, _TIMES, _SIZES = 12, 5.0, 16


def expected_of(draw: Information, names: Sequence[str], total: Array, poses: int) -> Expected:
    """What an information (k, k) promises."""
    values, vectors = np.linalg.eigh(total)
    loose = values < _LOOSE * draw.ridge
    C = inverse(total)
    sds = np.sqrt(np.maximum(np.einsum("nk,kl,nl->n", draw.root, C, draw.root), 0.0))
    # a parameter is loose where most of its variance lies along loose directions
    along = np.square(draw.root @ (vectors[:, loose] / np.sqrt(values[loose]))).sum(axis=1)
    bad = along > 0.5 * np.square(sds)
    parameters = {
        n: None if b or not s > 0.0 else float(s)
        for n, s, b in zip(names, sds.tolist(), bad.tolist(), strict=True)
    }
    end_point = largest = None
    if len(draw.tests):
        v = test_variances(draw, C)
        seen = draw.tests.reshape(-1, draw.tests.shape[2]) @ vectors[:, loose]
        lost = np.square(seen / np.sqrt(values[loose])).sum() / len(v)
        if lost <= 0.5 * v.mean():
            end_point, largest = float(np.sqrt(v.mean())), float(np.sqrt(v.max()))
    return Expected(poses, end_point, largest, parameters)


def expected_curve(
    draw: Information, names: Sequence[str], chosen: Sequence[int], how: Criterion
) -> tuple[Expected, ...]:
    """After 1, 2, ... of the chosen poses, the one that lowers the criterion most always next."""
    sub = replace(draw, rows=draw.rows[list(chosen)])
    search = Search([sub], how)
    curve = []
    for count in range(1, len(chosen) + 1):
        search.add(int(np.argmax(search.gains())))
        total = sub.of(search.chosen)
        curve.append(expected_of(draw, names, total, count))
    return tuple(curve)


def to_validate(
    draws: Sequence[Information], chosen: Sequence[int], how: Criterion
) -> frozenset[int]:
    """About a fifth of the chosen poses: those without which the others promise most.

    None where the others would not determine the parameters.
    """
    marked: list[int] = []
    subs = [replace(d, rows=d.rows[list(chosen)]) for d in draws]
    left = list(range(len(chosen)))
    for _ in range(round(SHARE * len(chosen))):
        costs = [
            np.mean([criterion_value(d, d.of([j for j in left if j != i]), how) for d in subs])
            for i in left
        ]
        best = left[int(np.argmin(costs))]
        left.remove(best)
        marked.append(chosen[best])
    return frozenset(marked)


def random_sets(
    draw: Information, names: Sequence[str], even: NDArray[np.intp], plan: Expected
) -> RandomSets | None:
    """Rms sds of growing random sets of the candidates at `even`, in the mean over several."""
    N, number = len(even), plan.poses
    most = min(N, math.ceil(_TIMES * number))
    if most <= number or plan.end_point is None:
        return None
    sizes = np.unique(np.geomspace(max(number // 3, 1), most, _SIZES).round().astype(int))
    sizes = np.unique(np.append(sizes, number))
    rng = np.random.default_rng(1)
    squares: dict[int, list[float]] = {int(s): [] for s in sizes}
    for _ in range(_SETS):
        order = rng.permutation(even)
        for size in squares:
            sd = expected_of(draw, names, draw.of(order[:size]), size).end_point
            squares[size].append(math.inf if sd is None else sd**2)
    means = [math.sqrt(float(np.mean(squares[int(s)]))) for s in sizes]
    shown = tuple(m if math.isfinite(m) else None for m in means)
    return RandomSets(
        tuple(int(s) for s in sizes), shown, _equivalent(sizes, means, plan.end_point)
    )


def _equivalent(sizes: Array, means: list[float], target: float) -> int | None:
    """The size at which random sets promise the same, between sizes by a power law."""
    for i, mean in enumerate(means):
        if mean <= target:
            if i == 0 or not math.isfinite(means[i - 1]):
                return int(sizes[i])
            # Sds fall as a power of the number of poses, nearly n^-1/2: linear in the logarithms.
            share = math.log(means[i - 1] / target) / math.log(means[i - 1] / mean)
            return round(float(sizes[i - 1] * (sizes[i] / sizes[i - 1]) ** share))
    return None
