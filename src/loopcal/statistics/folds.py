"""Which poses are left out together: folds and hold-outs that depend on readings and seed alone.

The same data, stated noise and seed give the same folds for every method and model. Poses that
repeat one another are never split between fit and validation: their common error would be predicted
from itself.

Regions of the joint space, left out one by one: how a calibration does where it has not been.

Random folds leave out poses whose neighbours stay in the fit, so they say nothing of transfer. A
block is a cluster of the driven readings, found by k-means (MacQueen 1967; Lloyd 1982) on the
cosine and sine of angles, and on lengths over the largest range of any.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypedDict

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.errors import InputError
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise, NoiseLike, resolve_noise
from loopcal.mechanisms.mechanism import PIXELS, Mechanism

Index = NDArray[np.intp]
# Chosen, not derived: controllers return to a pose within less, people choose poses farther apart.
SAME = 1e-4
"""Driven readings that differ by no more than this share of their range are one pose, repeated."""
# Two readings of one pose differ by more than 4 sds in 0.5 % of the cases, by sqrt(2) in sd.
NOISY, MOST = 4.0, 0.01
"""The same holds for a difference of so many sds, but at most of this share of the range."""


# Chosen, not derived: a log of a machine at rest has as many neighbours of each pose as poses.
_ASKED, _AT_ONCE = 4_096, 64
"""Poses whose neighbours are sought together."""
# Chosen, not derived: as many comparisons of all rows cost less than loading the tree.
_NEIGHBOURS = 50
_WITHIN = 1.0 + 1e-12
"""In units of what is the same: rounding does not part two poses."""
_TRIED, _AGAIN = 64, 0.06
"""Poses that are asked for whether they are there again, and the share of them that has to be."""


class SchemeOptions(TypedDict, total=False):
    """The fields of `Scheme` as keyword arguments."""

    folds: int
    blocks: int | None
    hold_out: float | None
    other: Dataset | None
    other_noise: NoiseLike | None
    seed: int
    groups: Sequence[object] | None
    place_anew: bool


@dataclass(frozen=True, eq=False)
class Scheme:
    """Which poses take no part in a fit and are predicted by it.

    folds: in how many parts the poses are cut, each left out once; blocks: in how many regions of
    the joint space, left out one by one besides, 0 for none, None for none but 5 with a method that
    chooses; hold_out: instead leave out this share once; other: instead calibrate on all and
    predict these readings (other_noise: their noise where it is not the same); seed: of the choice;
    groups: one per pose, never split, by default poses with the same driven readings; place_anew:
    instead leave out each of these groups, such as the poses of one station or session, and place
    the instrument by the readings of the group that is predicted.
    """

    folds: int = 10
    blocks: int | None = None
    hold_out: float | None = None
    other: Dataset | None = None
    other_noise: NoiseLike | None = None
    seed: int = 0
    groups: Sequence[object] | None = None
    place_anew: bool = False

    def of(self, kept: Index) -> Scheme:
        """The scheme of the poses at these positions."""
        if self.groups is None:
            return self
        return replace(self, groups=[self.groups[i] for i in kept])


@dataclass(frozen=True, eq=False)
class Parts:
    """The parts of a data set that a scheme leaves out, and the scheme as stated and in words."""

    indices: tuple[Index, ...]
    stated: Mapping[str, Any]
    words: str


def parts_of(scheme: Scheme, data: Dataset, chosen: Index) -> Parts:
    """The parts that are left out of one data set; chosen: the group of each pose.

    Raises InputError for a choice that cannot be made.
    """
    if scheme.place_anew:
        return _whole_groups(scheme, data, chosen)
    if scheme.hold_out is not None:
        indices: tuple[Index, ...] = (held_out(chosen, scheme.hold_out, scheme.seed),)
        stated: dict[str, Any] = {"hold_out": scheme.hold_out, "seed": scheme.seed}
        words = f"{len(indices[0])} of {len(data)} poses held out"
    else:
        indices = folds(chosen, scheme.folds, scheme.seed)
        stated = {"folds": scheme.folds, "seed": scheme.seed}
        words = f"{scheme.folds} folds of {len(data)} poses"
    different = len(np.unique(chosen))
    if different < len(data):
        stated["groups"] = different
        words += f", {different} of them different"
    return Parts(indices, stated, words)


def _whole_groups(scheme: Scheme, data: Dataset, chosen: Index) -> Parts:
    whole_groups = np.unique(chosen)
    if scheme.groups is None or len(whole_groups) < 2:
        raise InputError(
            "place_anew leaves out whole groups, but there are no two of them",
            code="too-few-poses",
            remedy="give the station or session of every pose as groups",
        )
    indices = tuple(np.flatnonzero(chosen == group) for group in whole_groups)
    words = f"{len(whole_groups)} groups of {len(data)} poses left out one by one"
    return Parts(indices, {"groups": len(whole_groups), "place_anew": True}, words)


def driven(mechanism: Mechanism, data: Dataset) -> tuple[str, ...]:
    """The readings that say which pose it is.

    All but the outputs, what instruments read, passive sensors (quantities with a home) and known
    constants such as times and temperatures. A machine without any is driven by what is left.
    """
    read = {q for family in mechanism.families for q in family.readings}
    apart = {*read, *mechanism.outputs, *mechanism.disturbances, *mechanism.home}
    names = [q for q in mechanism.quantities if q in data.readings]
    driving = [q for q in names if q not in apart]
    others = [*names, *(q for q in mechanism.pose_constants if q in data.readings)]
    return tuple(driving or [q for q in others if q not in mechanism.outputs])


def stated_sds(noise: Noise | None, mechanism: Mechanism, data: Dataset) -> Mapping[str, float]:
    """Quantity -> stated sd of a reading [SI], the median; none where no noise is stated."""
    if noise is None:
        return {}
    names = tuple(mechanism.quantities)
    try:
        sds = resolve_noise(noise, data, names, mechanism.quantity_group).sd
    except InputError:
        return {}  # a method that takes the readings as exact need not understand its noise
    return {q: float(np.median(sd)) for q, sd in zip(names, sds, strict=True)}


def repeated(mechanism: Mechanism, data: Dataset, sds: Mapping[str, float] | None = None) -> Index:
    """A number for each pose, (N,), equal where the driven readings are the same.

    The same are readings that differ by no more than `SAME` of their range, or by no more than
    `NOISY` times their sd, but never by more than `MOST` of their range; sds: quantity -> sd of a
    reading [SI]. What is unread in one pose and read in another tells them apart.
    """
    points = _driven_points(mechanism, data, sds)
    if points is None:
        return np.arange(len(data))
    if not points.shape[1]:
        return np.zeros(len(data), dtype=np.intp)
    if _none_alike(points):
        return np.arange(len(data))
    from scipy.spatial import KDTree

    # the first pose of a group is its centre: dense paths are cut, not chained into one
    group = np.full(len(data), -1, dtype=np.intp)
    # The same pose is a cube of half width 1, the ball of the maximum norm.
    tree = KDTree(points)
    for begin in range(0, len(data), _ASKED):
        rows = begin + np.flatnonzero(group[begin : begin + _ASKED] < 0)
        nearest = tree.query(points[rows], k=2, p=np.inf, distance_upper_bound=_WITHIN)[0]
        alone = np.isinf(nearest[:, 1])  # as most poses are, where all others need not be sought
        group[rows[alone]] = rows[alone]
        others = rows[~alone]
        for part in range(0, len(others), _AT_ONCE):
            centres = others[part : part + _AT_ONCE]
            centres = centres[group[centres] < 0]
            near_by = tree.query_ball_point(points[centres], 1.0, p=np.inf)
            for i, near in zip(centres, near_by, strict=True):
                if group[i] < 0:
                    group[[j for j in near if group[j] < 0]] = i
    return np.unique(group, return_inverse=True)[1]


def _none_alike(points: Array) -> bool:
    """Whether no two of these points (N, n) are within 1 of each other by every coordinate; False
    where they are too dense to say without a tree."""
    # Seeded; points that are alike are neighbours along any direction.
    direction = np.random.default_rng(0).uniform(0.5, 1.0, points.shape[1:])
    order = np.argsort(points @ direction)
    points, along = points[order], (points @ direction)[order]
    for step in range(1, _NEIGHBOURS):
        near = np.flatnonzero(along[step:] - along[:-step] <= _WITHIN * direction.sum())
        if not near.size:
            return True
        if (np.abs(points[near + step] - points[near]) <= _WITHIN).all(axis=1).any():
            return False
    return False


def may_repeat(mechanism: Mechanism, data: Dataset, sds: Mapping[str, float]) -> bool:
    """Whether rows that follow each other repeat a pose, or a quarter of all rows may do.

    The first is exact; of the second some rows at random tell, which miss it once in 50,000 times.
    """
    points = _driven_points(mechanism, data, sds)
    if points is None or len(points) < 2:
        return False
    if (np.abs(np.diff(points, axis=0)) <= 1.0).all(axis=1).any():
        return True
    again, spread = 0, int(np.argmax(np.ptp(points, axis=0)))
    rows = np.random.Generator(np.random.PCG64(0)).permutation(len(points))[:_TRIED]
    for one in points[rows]:
        near = points[np.abs(points[:, spread] - one[spread]) <= 1.0]
        again += int((np.abs(near - one) <= 1.0).all(axis=1).sum() > 1)
    return again >= _AGAIN * len(rows)


def _driven_points(
    mechanism: Mechanism, data: Dataset, sds: Mapping[str, float] | None
) -> Array | None:
    """(N, n) the driven readings in units of what is the same; None where nothing is read."""
    gaps = {q: np.isnan(data.readings[q]) for q in driven(mechanism, data)}
    read = [q for q, gap in gaps.items() if not gap.all()]
    moving = []
    for q in read:
        span = float(np.nanmax(data.readings[q]) - np.nanmin(data.readings[q]))
        if gaps[q].any():
            moving.append(2.0 * gaps[q])
        if span > 0.0:
            near = min(max(SAME * span, NOISY * (sds or {}).get(q, 0.0)), MOST * span)
            moving.append(np.where(gaps[q], 0.0, data.readings[q] / near))
    if not read:
        return None
    return np.column_stack(moving) if moving else np.zeros((len(data), 0))


def grouped(
    mechanism: Mechanism,
    data: Dataset,
    groups: Sequence[object] | None = None,
    sds: Mapping[str, float] | None = None,
) -> Index:
    """The group of each pose (N,): those stated, or the repeated poses (`repeated`).

    Raises InputError where not every pose has a group.
    """
    if groups is None:
        return repeated(mechanism, data, sds)
    if len(groups) != len(data):
        raise InputError(
            f"{len(groups)} groups are stated for {len(data)} poses",
            code="wrong-shape",
            remedy="give one group for every pose",
        )
    codes = {group: code for code, group in enumerate(dict.fromkeys(map(str, groups)))}
    return np.array([codes[str(group)] for group in groups], dtype=np.intp)


def folds(groups: Index, number: int, seed: int) -> tuple[Index, ...]:
    """The positions left out in each fold: groups at random, larger ones first, evenly filled.

    Raises InputError for fewer than two folds or fewer groups than folds.
    """
    distinct, sizes = np.unique(groups, return_counts=True)
    _check_seed(seed)
    if number < 2 or number > len(distinct):
        raise InputError(
            f"folds is {number}, but there are {len(distinct)} different poses",
            code="too-few-poses",
            remedy=f"use 2 to {len(distinct)} folds",
        ).meaning(str(number), str(len(distinct)))
    # PCG64 by name: the default generator of NumPy may change, and the folds with it.
    order = np.random.Generator(np.random.PCG64(seed)).permutation(len(distinct))
    # Larger groups first, each to the emptiest fold, keeps the folds even (Graham 1969).
    order = order[np.argsort(-sizes[order], kind="stable")]
    filled = np.zeros(number, dtype=np.intp)
    fold_of = np.empty(len(distinct), dtype=np.intp)
    for group in order:
        fold_of[group] = np.argmin(filled)
        filled[fold_of[group]] += sizes[group]
    fold = fold_of[np.searchsorted(distinct, groups)]
    return tuple(np.flatnonzero(fold == i) for i in range(number))


def held_out(groups: Index, share: float, seed: int) -> Index:
    """The positions of a share of the poses: whole groups at random until it is reached.

    Raises InputError unless the share leaves poses on both sides.
    """
    _check_seed(seed)
    if not 0.0 < share < 1.0:
        raise InputError(
            f"a share of {share:g} of the poses cannot be held out",
            code="invalid-value",
            remedy="give a number between 0 and 1, say 0.3",
        )
    distinct, sizes = np.unique(groups, return_counts=True)
    order = np.random.Generator(np.random.PCG64(seed)).permutation(len(distinct))
    # Less half a pose: the nearest whole number of poses, not the next larger one.
    reached = np.searchsorted(np.cumsum(sizes[order]), share * len(groups) - 0.5) + 1
    chosen = distinct[order[:reached]]
    if len(chosen) == len(distinct):
        raise InputError(
            f"holding out {share:g} of {len(distinct)} different poses leaves none for the fit",
            code="too-few-poses",
            remedy="hold out less, or measure more poses",
        )
    return np.flatnonzero(np.isin(groups, chosen))


def _check_seed(seed: int) -> None:
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise InputError(
            f"the seed is {seed!r}", code="invalid-value", remedy="give a whole number, 0 or more"
        )


# Chosen, not derived: k-means ends at a local optimum, and more starts cost time.
_STARTS = 20
# Chosen, not derived: a region of few poses says little, and its rms counts as much.
_EACH = 5
"""Different poses of a region of the image, on average."""
_SMALLEST = 1 / 3
"""A clustering whose smallest block has less than this share of an even one is a poor choice."""


def blocks(mechanism: Mechanism, data: Dataset, groups: Index, number: int) -> tuple[Index, ...]:
    """The positions left out in each block, (n,) each; groups of poses (N,) stay together.

    The tightest clustering of several starts, those with a tiny block last. The same readings give
    the same blocks. Raises InputError for fewer than two blocks, and for too few different poses.
    """
    distinct, where = np.unique(groups, return_inverse=True)
    if number < 2 or number > len(distinct):
        raise InputError(
            f"blocks is {number}, but there are {len(distinct)} different poses",
            code="too-few-poses",
            remedy=f"use 2 to {len(distinct)} blocks",
        ).meaning(str(number), str(len(distinct)))
    return _regions(_features(mechanism, data), where, number)


def _regions(features: Array, where: Index, number: int) -> tuple[Index, ...]:
    """The positions of each cluster of features (f, N); where: the group of each pose."""
    counts = np.bincount(where)
    centres = np.array([np.bincount(where, row) for row in features]).T / counts[:, None]
    label = _clustered(centres, counts, number)[where]
    return tuple(np.flatnonzero(label == i) for i in range(number))


def image_regions(
    mechanism: Mechanism, data: Dataset, groups: Index, most: int = 5
) -> Parts | None:
    """Regions of the image, left out one by one: clusters of where cameras see their boards.

    As many as leave each `_EACH` different poses, at least two; None without cameras, and for
    fewer poses.
    """
    where = np.unique(groups, return_inverse=True)[1]
    number = min(most, (int(where.max(initial=-1)) + 1) // _EACH)
    middles = [*_middles(mechanism, data)]
    if number < 2 or not middles:
        return None
    words = f"{number} regions of the image of {len(data)} poses"
    indices = _regions(np.array(middles), where, number)
    return Parts(indices, {"blocks": number, "of": "image"}, words)


def _middles(mechanism: Mechanism, data: Dataset) -> Iterator[Array]:
    """u and v (N,) of the middle of what each camera sees, over the larger of their ranges."""
    for family in mechanism.families:
        if family.form != PIXELS:
            continue
        columns = [
            np.array([data.readings[q] for q in family.readings[axis::2] if q in data.readings])
            for axis in (0, 1)
        ]
        seen = np.isfinite(columns[0]).sum(axis=0)
        if not seen.any():
            continue
        both = np.array([np.nansum(column, axis=0) for column in columns]) / np.maximum(seen, 1)
        # An image of other cameras alone is as near to all.
        both[:, seen == 0] = both[:, seen > 0].mean(axis=1)[:, None]
        yield from both / (float(np.ptp(both, axis=1).max()) or 1.0)


def blocks_of(scheme: Scheme, mechanism: Mechanism, data: Dataset, groups: Index) -> Parts:
    """The regions that a scheme leaves out one by one."""
    indices = blocks(mechanism, data, groups, scheme.blocks or 0)
    space = "the joint space" if mechanism.joints else "space"
    words = f"{scheme.blocks} regions of {space} of {len(data)} poses"
    return Parts(indices, {"blocks": scheme.blocks}, words)


def _features(mechanism: Mechanism, data: Dataset) -> Array:
    """(f, N): cosine and sine of driven angles, driven lengths over the largest range.

    Joints that were not read in a pose, as those of another arm, are as near to all.
    """
    names = [q for q in driven(mechanism, data) if np.isfinite(data.readings[q]).any()]
    units = {**mechanism.quantities, **mechanism.pose_constants}
    rows: list[Array] = []
    for unit in dict.fromkeys(units[q] for q in names):
        columns = np.array([data.readings[q] for q in names if units[q] == unit])
        if unit == "rad":
            # On the circle, so that -179 and 179 degrees are near.
            rows += [*np.cos(columns), *np.sin(columns)]
        else:
            # One range for all: else a drive that hardly moves would count as much as the others.
            spread = np.nanmax(columns, axis=1) - np.nanmin(columns, axis=1)
            rows += [*(columns / (float(spread.max()) or 1.0))]
    features = np.array(rows).reshape(-1, len(data))
    unread = np.isnan(features)
    if unread.any():
        features = np.where(unread, np.nanmean(features, axis=1, keepdims=True), features)
    return features


def _clustered(points: Array, weights: Index, number: int) -> Index:
    """The cluster of each point (n, f), from the best of several starts."""
    from scipy.cluster.vq import ClusterError, kmeans2

    random = np.random.Generator(np.random.PCG64(0))
    best: tuple[bool, float] | None = None
    chosen = np.arange(len(points), dtype=np.intp) * number // len(points)
    for _ in range(_STARTS):
        try:
            centres, label = kmeans2(
                points, _spread(points, number, random), minit="matrix", missing="raise"
            )
        except ClusterError:
            continue  # a cluster ran empty
        sizes = np.bincount(label, weights, number)
        inertia = float((weights * np.square(points - centres[label]).sum(axis=1)).sum())
        key = bool(sizes.min() < _SMALLEST * sizes.mean()), inertia
        if best is None or key < best:
            best, chosen = key, label.astype(np.intp)
    return chosen


def _spread(points: Array, number: int, random: np.random.Generator) -> Array:
    """Centres to begin from, each at random by its squared distance from those before it.

    Source: Arthur and Vassilvitskii (2007), k-means++.
    """
    chosen = [int(random.integers(len(points)))]
    while len(chosen) < number:
        gaps = points[:, None] - points[chosen]
        near = np.square(gaps).sum(axis=2).min(axis=1)
        total = float(near.sum())
        chance = near / total if total > 0.0 else None
        chosen.append(int(random.choice(len(points), p=chance)))
    return points[chosen]
