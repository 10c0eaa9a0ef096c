"""Which poses are left out together: folds and hold-outs that depend on readings and seed alone.

The same data and seed give the same folds for every method and model. Poses that repeat one
another are never split between fit and validation: their common error would be predicted from
itself.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypedDict

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import NoiseLike
from loopcal.mechanisms.mechanism import Mechanism

Index = NDArray[np.intp]
SAME = 1e-4
"""Driven readings that differ by no more than this share of their range are one pose, repeated."""


class SchemeOptions(TypedDict, total=False):
    """The fields of `Scheme` as keyword arguments."""

    folds: int
    hold_out: float | None
    other: Dataset | None
    other_noise: NoiseLike | None
    seed: int
    groups: Sequence[object] | None


@dataclass(frozen=True, eq=False)
class Scheme:
    """Which poses take no part in a fit and are predicted by it.

    folds: in how many parts the poses are cut, each left out once; hold_out: instead leave out
    this share once; other: instead calibrate on all and predict these readings (other_noise:
    their noise where it is not the same); seed: of the choice; groups: one per pose, never split,
    by default poses with the same driven readings.
    """

    folds: int = 10
    hold_out: float | None = None
    other: Dataset | None = None
    other_noise: NoiseLike | None = None
    seed: int = 0
    groups: Sequence[object] | None = None


@dataclass(frozen=True, eq=False)
class Parts:
    """The parts of a data set that a scheme leaves out, and the scheme as stated and in words."""

    indices: tuple[Index, ...]
    stated: Mapping[str, Any]
    words: str


def parts_of(scheme: Scheme, mechanism: Mechanism, data: Dataset) -> Parts:
    """The parts that are left out of one data set.

    Raises InputError for a choice that cannot be made.
    """
    chosen = grouped(mechanism, data, scheme.groups)
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


def repeated(mechanism: Mechanism, data: Dataset) -> Index:
    """A number for each pose, (N,), equal where the driven readings are the same.

    Driven is every quantity that is not an output. Columns with gaps do not count.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import KDTree

    driven = [
        data.readings[q]
        for q in (*mechanism.quantities, *mechanism.known)
        if q not in mechanism.outputs and q in data.readings
    ]
    complete = [v for v in driven if not np.isnan(v).any()]
    if not complete:
        return np.arange(len(data))
    spans = [float(np.ptp(v)) for v in complete]
    moving = [v / s for v, s in zip(complete, spans, strict=True) if s > 0.0]
    if not moving:
        return np.zeros(len(data), dtype=np.intp)
    pairs = KDTree(np.column_stack(moving)).query_pairs(SAME, p=np.inf, output_type="ndarray")
    links = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(data),) * 2)
    return np.asarray(connected_components(links, directed=False)[1], dtype=np.intp)


def grouped(mechanism: Mechanism, data: Dataset, groups: Sequence[object] | None = None) -> Index:
    """The group of each pose (N,): those stated, or the repeated poses.

    Raises InputError where not every pose has a group.
    """
    if groups is None:
        return repeated(mechanism, data)
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
    found, sizes = np.unique(groups, return_counts=True)
    _check_seed(seed)
    if number < 2 or number > len(found):
        raise InputError(
            f"folds is {number}, but there are {len(found)} different poses",
            code="too-few-poses",
            remedy=f"use 2 to {len(found)} folds",
        )
    order = np.random.Generator(np.random.PCG64(seed)).permutation(len(found))
    order = order[np.argsort(-sizes[order], kind="stable")]
    filled = np.zeros(number, dtype=np.intp)
    fold_of = np.empty(len(found), dtype=np.intp)
    for group in order:
        fold_of[group] = np.argmin(filled)
        filled[fold_of[group]] += sizes[group]
    fold = fold_of[np.searchsorted(found, groups)]
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
    found, sizes = np.unique(groups, return_counts=True)
    order = np.random.Generator(np.random.PCG64(seed)).permutation(len(found))
    reached = np.searchsorted(np.cumsum(sizes[order]), share * len(groups) - 0.5) + 1
    chosen = found[order[:reached]]
    if len(chosen) == len(found):
        raise InputError(
            f"holding out {share:g} of {len(found)} different poses leaves none for the fit",
            code="too-few-poses",
            remedy="hold out less, or measure more poses",
        )
    return np.flatnonzero(np.isin(groups, chosen))


def _check_seed(seed: int) -> None:
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise InputError(
            f"the seed is {seed!r}", code="invalid-value", remedy="give a whole number, 0 or more"
        )
