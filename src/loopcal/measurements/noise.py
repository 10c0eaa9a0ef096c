"""How uncertain the readings are: an sd for each quantity or reading, or full covariances.

The sd decides a quantity's role: sd > 0 measured, sd = 0 exact (never corrected), sd = inf
unmeasured (its reading is only a starting guess). A missing reading is unmeasured in its pose.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.errors import InputError, unknown_name
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.datasheet import DatasheetSd, Tracker

Entries = Mapping[Any, Any]
"""Keys are names or tuples of names; a narrower type would refuse a dict of one kind only."""


Estimates = Mapping[str, str] | Mapping[tuple[str, ...], str] | Mapping[str | tuple[str, ...], str]
MODEL = "model"
"""The key of the machine model's own sd."""
ESTIMATES = ("each", "group")


def _no_mapping(noise: object) -> InputError:
    return InputError(
        f"the noise is {type(noise).__name__} {noise!s:.40}",
        code="invalid-value",
        remedy='give Noise({"theta_*": 1e-4}), or a dict of sds by quantity',
    )


class Noise:
    """What is stated about the sensors: sd [SI] by quantity, glob or group; later entries win.

    A value is one sd, or an array (N,) with one sd per reading. For several quantities together,
    keyed by a tuple of names, it is a covariance (b, b) or one per pose (N, b, b) [SI squared]. Or
    it is a `Tracker`, which gives each reading the covariance of the place where it was taken.

    >>> Noise({"theta_*": 5e-5, ("x", "y", "z"): 1e-10 * np.eye(3)})
    Noise({'theta_*': 5e-05, ('x', 'y', 'z'): covariance (3, 3)})

    Readings that come with an sd of their own (`Dataset.sds`) keep it; an entry here serves the
    readings that have none.

    The key "model" states the sd of the machine model itself: what no sensor is to blame for. It is
    isotropic at the end point, or of every loop equation where a mechanism has no outputs.

    estimate: for a name, glob, group, tuple of names, or "model": "each" or "group". Its sds are
    not taken as given but learnt from the calibration, one factor for each quantity, or one for
    all of them. The sds stated are where the search begins.

    Raises InputError for an sd that is negative or not a number, and for a matrix that is no
    covariance.
    """

    def __init__(self, entries: Entries, *, estimate: Estimates | None = None) -> None:
        if not isinstance(entries, Mapping):
            raise _no_mapping(entries)
        self.entries: dict[str | tuple[str, ...], Any] = {}  # of arrays and trackers
        for key, value in entries.items():
            _check_key(key)
            self.entries[key] = _checked_entry(key, value)
        self.by_maker = frozenset(
            key for key, value in entries.items() if isinstance(value, Tracker | DatasheetSd)
        )
        """Keys of the entries that follow from a maker's figure."""
        self.estimate: dict[str | tuple[str, ...], str] = dict((estimate or {}).items())
        for key, how in self.estimate.items():
            _check_key(key)
            if how not in ESTIMATES:
                raise unknown_name(f"estimate of {key!r} is {how!r}", how, ESTIMATES)

    @classmethod
    def of(cls, noise: NoiseLike | None) -> Noise | None:
        """The noise itself, or one made of a mapping of sds.

        Raises InputError for anything else.
        """
        if noise is None or isinstance(noise, Noise):
            return noise
        return cls(noise)

    def with_learnt(self, key: str, sd: float) -> Noise:
        """The same noise with one further sd, which is learnt; sd: where its search begins."""
        more = copy(self)
        more.entries = {**self.entries, key: _checked_entry(key, sd)}
        more.estimate = {**self.estimate, key: "group"}
        return more

    def with_exact(self, key: str) -> Noise:
        """The same noise with nothing of one further error."""
        more = copy(self)
        more.entries = {**self.entries, key: _checked_entry(key, 0.0)}
        return more

    def refuse_other_poses(self, poses: int) -> None:
        """Raise InputError where something is stated for another number of poses."""
        for key, value in self.entries.items():
            if _by_pose(key, value):
                _check_length(key, value, poses, value.ndim)

    def take(self, index: NDArray[np.intp]) -> Noise:
        """The noise of the poses at these positions."""
        return self._with_poses(lambda key: self.entries[key][index])

    def before(self, others: Sequence[Noise]) -> Noise:
        """The noise of these poses and then of others, of which the same is stated."""
        every = (self, *others)
        return self._with_poses(lambda key: np.concatenate([one.entries[key] for one in every]))

    def _with_poses(self, stated: Callable[[Any], Array]) -> Noise:
        """The same noise with something else for what is stated pose by pose."""
        part = copy(self)
        part.entries = {
            key: stated(key) if _by_pose(key, value) else value
            for key, value in self.entries.items()
        }
        return part

    def __repr__(self) -> str:
        def text(value: Any) -> str:
            if isinstance(value, Tracker):
                return repr(value)
            if value.ndim == 0:
                return f"{float(value):.6g}"
            return f"{'sd' if value.ndim == 1 else 'covariance'} {value.shape}"

        inner = ", ".join(f"{key!r}: {text(value)}" for key, value in self.entries.items())
        learnt = f", estimate={self.estimate!r}" if self.estimate else ""
        return f"Noise({{{inner}}}{learnt})"

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, Noise)
            and self.estimate == other.estimate
            and list(self.entries) == list(other.entries)
            and all(np.array_equal(v, other.entries[k]) for k, v in self.entries.items())
        )

    __hash__ = None  # type: ignore[assignment]


def _by_pose(key: object, value: object) -> bool:
    return isinstance(value, np.ndarray) and value.ndim == (3 if isinstance(key, tuple) else 1)


NoiseLike = Noise | Entries
"""A noise, or the mapping that makes one."""


@dataclass(frozen=True)
class CovarianceBlock:
    """The joint covariance of some quantities: indices (b,), factor (b, b) or (N, b, b).

    factor is a square root: factor @ factor.T is the covariance [SI squared].
    """

    indices: tuple[int, ...]
    factor: Array

    def of(self, chosen: NDArray[np.intp] | slice) -> CovarianceBlock:
        """The covariance in some poses, by their positions."""
        by_pose = self.factor.ndim > 2
        return CovarianceBlock(self.indices, self.factor[chosen]) if by_pose else self


@dataclass(frozen=True)
class ReadingUncertainty:
    """The uncertainty of every reading of a data set, resolved.

    sd: (k, 1) where it is the same in all poses, else (k, N) [SI]; inf is unmeasured, 0 exact;
    blocks: quantities with a full covariance (their sd here is the square root of its diagonal);
    sources: for each quantity "given", "reading" or "datasheet".
    """

    sd: Array
    blocks: tuple[CovarianceBlock, ...] = ()
    sources: tuple[str, ...] = ()

    @property
    def by_pose(self) -> bool:
        """Whether it differs from pose to pose."""
        return self.sd.shape[1] > 1 or any(block.factor.ndim > 2 for block in self.blocks)

    def of_means(self, counts: Array) -> ReadingUncertainty:
        """The uncertainty of means of so many independent readings, (k, N)."""
        return self.times(1.0 / np.sqrt(counts))

    def times(self, factors: Array) -> ReadingUncertainty:
        """With so many times the sds, (k, 1) or (k, N); of a covariance the largest factor."""
        blocks = []
        for b in self.blocks:
            by = factors[list(b.indices)].max(axis=0)
            by = by[:, None, None] if len(by) > 1 else by[0]
            blocks.append(CovarianceBlock(b.indices, b.factor * by))
        return ReadingUncertainty(self.sd * factors, tuple(blocks), self.sources)

    def of(self, chosen: NDArray[np.intp] | slice) -> ReadingUncertainty:
        """The uncertainty in some poses, by their positions."""
        if not self.by_pose:
            return self
        sd = self.sd if self.sd.shape[1] == 1 else self.sd[:, chosen]
        return ReadingUncertainty(sd, tuple(b.of(chosen) for b in self.blocks), self.sources)

    @property
    def of_read(self) -> ReadingUncertainty:
        """The same with missing readings as exact: for loops from which they were taken."""
        return replace(self, sd=np.where(np.isinf(self.sd), 0.0, self.sd))

    def through(self, S: Array) -> Array:
        """(N, o, k) a square root of the covariance of S (N, o, k) times the readings; what is
        unmeasured causes none."""
        sd = np.where(np.isinf(self.sd), 0.0, self.sd)
        G: Array = S * sd.T[:, None, :]
        for block in self.blocks:
            G[:, :, block.indices] = S[:, :, block.indices] @ block.factor
        return G


def resolve_noise(
    noise: Noise,
    dataset: Dataset,
    quantities: Sequence[str],
    expand: Callable[[str], tuple[str, ...]],
) -> ReadingUncertainty:
    """The uncertainty of every reading of the given quantities.

    expand turns a name, glob or group into quantities. Raises InputError for a quantity that
    has no sd from anywhere, and for arrays that do not have one value per pose.
    """
    poses = len(dataset)
    sds: dict[str, Array] = {}
    in_block: dict[str, tuple[str, ...]] = {}
    blocks: dict[tuple[str, ...], Array] = {}
    sources: dict[str, str] = {}
    for key, value in noise.entries.items():
        names = key if isinstance(key, tuple) else expand(key)
        for name in names:
            if names is key:
                expand(name)  # a tuple may name a quantity that is not there
            # A later entry takes its quantity out of an earlier covariance, whose block then has no
            # meaning.
            blocks.pop(in_block.pop(name, ()), None)
            sources[name] = "datasheet" if key in noise.by_maker else "given"
        if isinstance(value, Tracker):
            value = _where_taken(value, names, dataset)
        if isinstance(key, tuple):
            _check_length(key, value, poses, 3)
            blocks[names] = value
            in_block |= dict.fromkeys(names, names)
            value = np.sqrt(np.einsum("...ii->...i", value)).T
            sds |= {name: value[i] for i, name in enumerate(names)}
        else:
            _check_length(key, value, poses, 1)
            sds |= dict.fromkeys(names, value)
    for name in quantities:
        # A covariance is stated for readings together, so sds of single readings do not replace it.
        if name in dataset.sds and name not in in_block:
            stated_sds = dataset.sds[name]
            sds[name] = np.where(np.isnan(stated_sds), sds.get(name, np.nan), stated_sds)
            sources[name] = "reading"
    rows = [_row(name, sds, dataset) for name in quantities]
    varying = any(row.ndim for row in rows)
    return ReadingUncertainty(
        np.array([np.broadcast_to(row, (poses,)) for row in rows])
        if varying
        else np.array(rows).reshape(len(rows), 1),
        tuple(
            CovarianceBlock(tuple(quantities.index(n) for n in names), _factor(value))
            for names, value in blocks.items()
        ),
        tuple(sources[name] for name in quantities),
    )


def _where_taken(tracker: Tracker, names: Sequence[str], dataset: Dataset) -> Array:
    """Covariances (N, b, b) of a tracker's readings; any will do for what was not read."""
    nothing = np.full(len(dataset), np.nan)
    points = np.array([dataset.readings.get(name, nothing) for name in names]).T
    whole = ~np.isnan(points).any(axis=1)
    if not whole.any():
        return np.broadcast_to(np.eye(len(names)), (len(dataset), len(names), len(names)))
    lost = tracker.at_station(points[whole])
    if lost.size:
        raise InputError(
            f"{', '.join(names)} were read at the tracker itself",
            code="lost-reflector",
            place=dataset.place(int(np.flatnonzero(whole)[lost[0]])),
            remedy="exclude that pose (a tracker writes 0, 0, 0 for a lost reflector), or give "
            "the tracker's station in the frame of its readings",
        )
    points[~whole] = points[whole][0]
    return tracker.covariance(points)


def _row(name: str, sds: Mapping[str, Array], dataset: Dataset) -> Array:
    remedy = f"give an sd for {name!r}: 0 if it is exact, inf if it is not measured"
    if name not in sds:
        raise InputError(
            f"no sd is stated for the quantity {name!r}", code="missing-sd", remedy=remedy
        )
    row = np.asarray(sds[name], dtype=float)
    if row.ndim and np.isnan(row).any():
        without = np.flatnonzero(np.isnan(row))
        raise InputError(
            f"{len(without)} readings of {name!r} have no sd, first at pose "
            f"{dataset.poses[without[0]]!r}",
            code="missing-sd",
            remedy=remedy,
        )
    missing = np.isnan(dataset.readings[name]) if name in dataset.readings else None
    if missing is None:  # a quantity without any column can only be unmeasured
        if not np.all(np.isinf(row)):
            raise InputError(
                f"the data have no readings of the quantity {name!r}",
                code="missing-reading",
                remedy=f"name its column, or give it the sd inf if {name!r} is not measured",
            )
        return np.asarray(np.inf)
    return np.where(missing, np.inf, row) if missing.any() else row


def _check_key(key: Any) -> None:
    names = key if isinstance(key, tuple) else (key,)
    if not all(isinstance(name, str) for name in names):
        raise InputError(
            f"the noise names {key!r:.60}, which is not the name of a quantity",
            code="invalid-value",
            remedy='name a quantity, glob or group ("theta_*"), or several in a tuple '
            '(("x", "y", "z"))',
        )


def _checked_entry(key: str | tuple[str, ...], value: Any) -> Any:
    if isinstance(value, Tracker):
        size = len(key) if isinstance(key, tuple) else 1
        if size not in (2, 3) or len(value.station or key) != size:
            raise InputError(
                f"a tracker measures points, but {key!r} are not coordinates of a point"
                if value.station is None or size not in (2, 3)
                else f"the tracker's station has {len(value.station)} coordinates, {key!r} {size}",
                code="wrong-shape",
                remedy="name the coordinates in order, say (x, y, z)",
            )
        return value
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError):
        raise InputError(
            f"the noise of {key!r} is {value!r}",
            code="invalid-value",
            remedy="give an sd in SI units",
        ) from None
    size = len(key) if isinstance(key, tuple) else 0
    if size:
        if array.ndim not in (2, 3) or array.shape[-2:] != (size, size):
            raise InputError(
                f"the covariance of {key!r} has the shape {array.shape}",
                code="invalid-covariance",
                remedy=f"give ({size}, {size}), or (N, {size}, {size}) with one per pose",
            )
        _check_covariance(key, array)
    elif array.ndim > 1:
        raise InputError(
            f"the sd of {key!r} has the shape {array.shape}",
            code="wrong-shape",
            remedy="give one sd, or one per reading; a covariance belongs to a tuple of names",
        )
    elif np.any(array < 0) or (array.ndim == 0 and np.isnan(array)):
        worst = float(np.min(array))
        raise InputError(
            f"the sd of {key!r} is {worst:.6g}; an sd cannot be negative or NaN",
            code="invalid-value",
            remedy="give 0 for an exact sensor, inf for a quantity that is not measured",
        )
    array.setflags(write=False)
    return array


def _check_covariance(key: Any, array: Array) -> None:
    scale = np.abs(array).max() or 1.0
    if not np.all(np.isfinite(array)):
        raise InputError(
            f"the covariance of {key!r} contains a value that is not finite",
            code="invalid-covariance",
            remedy="list a quantity that is not measured with the sd inf instead",
        )
    # Covariances that went through text are symmetric to the digits written, not to the last bit.
    if np.abs(array - np.swapaxes(array, -1, -2)).max() > 1e-9 * scale:
        raise InputError(
            f"the covariance of {key!r} is not symmetric",
            code="invalid-covariance",
            remedy="make it symmetric",
        )
    smallest = float(np.linalg.eigvalsh(array).min())
    if smallest < -1e-9 * scale:
        raise InputError(
            f"the covariance of {key!r} has the negative eigenvalue {smallest:.6g}",
            code="invalid-covariance",
            remedy="check signs and units; a covariance has no negative eigenvalue",
        )


def _check_length(key: Any, value: Array, poses: int, dimensions: int) -> None:
    if value.ndim == dimensions and value.shape[0] != poses:
        raise InputError(
            f"the noise of {key!r} has {value.shape[0]} entries, the data have {poses} poses",
            code="wrong-shape",
            remedy="give one entry for every pose that is used, or one for all",
        )


def _factor(covariance: Array) -> Array:
    """A square root of covariances, also of singular ones."""
    # Not Cholesky: a covariance of common errors alone is singular.
    values, vectors = np.linalg.eigh(covariance)
    root: Array = vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :]
    return root
