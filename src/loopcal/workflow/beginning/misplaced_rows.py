"""Rows that are not what they stand for: held readings, mixed targets, points in another order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.errors import InputError
from loopcal.estimation.faults.search import not_read_again, repeating
from loopcal.estimation.mounted import Bodies, exchanged_targets, see_points, two_targets
from loopcal.estimation.problem.alignment import align
from loopcal.files.recognition.fields import Field, names_of
from loopcal.files.recognition.meanings import Meaning
from loopcal.presentation.shown import significant, with_unit
from loopcal.workflow.beginning.searching import CLEARLY, PLAUSIBLE, Understood

ONE_POSE = 5e-3
"""A body that moves less than this [m] stands in one pose."""
# Chosen, not derived: of more rows than this share the instrument holds still, not the log.
_MOST_HELD = 0.3


def _about_a_point(bodies: Bodies, rows: NDArray[np.intp]) -> bool:
    """Whether a point t of the body stays from the row before: o + R t is the same in both."""
    R, o = (values[rows] - values[rows - 1] for values in (bodies.rotations, bodies.origins))
    t, *_ = np.linalg.lstsq(R.reshape(-1, 3), -o.ravel(), rcond=None)
    return bool(np.linalg.norm(o + R @ t, axis=1).max() < ONE_POSE)


def held_readings(ways: Sequence[Understood], poses: Sequence[str]) -> InputError | None:
    """The refusal of rows in which points stay to the last digit while the machine moves; None
    where there are none, or where the machine turns about the point, as about the tip of a tool.
    Joints that stay are no fault: two targets may be seen in one pose.

    ways: to read the columns, the best first; the others count where none fits.
    """
    fits = bool(ways) and ways[0].share <= PLAUSIBLE
    return next(
        filter(None, (_held(way, poses, fits) for way in ways[: 1 if fits else None])), None
    )


def _held(way: Understood, poses: Sequence[str], fits: bool) -> InputError | None:
    rows: set[int] = set()
    read: dict[str, Field] = {}
    for meaning in way.seen:
        points = meaning.position
        if points.ndim < 2 or len(points) < 2:
            continue
        some = repeating(way.bodies.origins.T, points.T, ONE_POSE)
        most = _MOST_HELD * len(points) if fits else len(points) - 2  # at least two points differ
        if 0 < len(some) <= most and not _about_a_point(way.bodies, some):
            rows |= {*some.tolist()}
            read |= {field.label: field for field in meaning.seen.position}
    if not rows:
        return None
    held = [poses[i] for i in sorted(rows)]
    error = InputError(
        not_read_again([*read], held, len(poses)),
        code="implausible-readings",
        remedy="leave these poses out, or correct their rows",
    )
    return error.offering("--exclude", ",".join(held))


# Rows of two tools or reflectors under one name, or each under the name of the other.


# Chosen, not derived: a joint that slips once or twice moves the tool as well, but not in turn.
_IN_TURN = 4
"""The rows change from one target to the other more often than this."""


def swapped_targets(way: Understood) -> InputError | None:
    """The refusal of two targets that stand in each other's columns in some rows; None where none
    do."""
    for one, other in combinations(_points_of(way), 2):
        rows = np.flatnonzero(exchanged_targets(way.bodies, one.position, other.position)) + 1
        if len(rows):
            return InputError(
                f"{names_of(one.seen.position)} and {names_of(other.seen.position)}, of two "
                f"targets, are swapped in {len(rows)} of {len(one.position)} rows "
                f"({', '.join(map(str, rows))})",
                code="implausible-readings",
                remedy="swap them in these rows, or leave the rows out",
            )
    return None


def _points_of(way: Understood) -> list[Meaning]:
    """The targets that are seen as points from where the station stands."""
    return [m for m in way.seen if m.in_space and m.turns is None and not m.inverted]


def mixed_targets(way: Understood) -> InputError | None:
    """The refusal of points of which some are those of another target; None where none are."""
    for meaning in _points_of(way):
        two = two_targets(way.bodies, meaning.position)
        if two is None or CLEARLY * two.share > meaning.share:
            continue
        if np.count_nonzero(np.diff(two.second.astype(np.intp))) <= _IN_TURN:
            continue
        rows = np.flatnonzero(two.second) + 1
        return InputError(
            f"{names_of(meaning.seen.position)} are of two targets in turn, "
            f"{with_unit(two.apart, 'm', 3)} apart, such as two tools: {len(rows)} of "
            f"{len(two.second)} rows are of the second ({', '.join(map(str, rows))}). So the "
            f"nominal machine misses the readings by {significant(100.0 * two.share, 2)} % of "
            f"their spread, and by {significant(100.0 * meaning.share, 2)} % as of one target",
            code="implausible-readings",
            remedy="write the rows of each target to a separate file, and begin with one of them",
        )
    return None


# Points and joints that are of the same poses, and not row by row.
#
# No order and no placement of an instrument changes the distances between points. The place of the
# target on the body that makes those of the nominal machine most like the measured ones is where
# the search begins. Then points and poses are assigned to each other (Kuhn 1955) and placement and
# target fitted, in turn (Besl and McKay 1992), from each way to lay the main axes of both sets
# together.


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
    whole = meaning.in_space and np.isfinite(points).all() and bodies.complete.all()
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
