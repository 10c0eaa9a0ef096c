"""What was recorded by time while a robot went from pose to pose: a row for each time it stood.

Each column has separate time stamps. A row holds the medians of the readings taken while no joint
moved. The readings of a delayed instrument are taken later by its delay, estimated from the moves.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from io import BytesIO

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.errors import InputError
from loopcal.lazy import cached_property
from loopcal.presentation.shown import significant

STILL = 0.4
"""[s] for which a robot has to stand, and so long is a window."""
MARGIN = 0.1
"""[s] at both ends of a stand in which nothing is measured, beside the delay of an instrument."""
_SPREAD = 8.0
"""Sds that readings of a joint at rest span at most: of 400 normal readings 5.9 are expected."""
_SHARE = 0.2
"""Of its time a robot stands at least, so that this share of its smallest steps is noise."""
# A fifth of |z| lies below Phi^-1(0.6) = 0.2533, z standard normal.
_STEP = 0.358
"""[sd] that quantile of |a - b| of two normal readings: sqrt(2) * 0.2533."""
_LATE, _TICK = 1.0, 0.01
"""Delays [s] are sought up to the one, in steps of the other."""
_OFTEN = STILL / 4.0
"""[s] between readings of an instrument at most whose moves are seen."""
# Chosen, not derived: a recorded instrument has 0.9 and more, one that does not move 0.
_ALIKE = 0.5
"""Correlation of the speeds of joints and instrument from which their lag is a delay."""
_BOXES = 10
"""Ticks over which speeds are smoothed: an instrument reads ten times a second or faster."""


@dataclass(frozen=True, eq=False)
class Series:
    """Readings of joints or of one instrument: times (N,) [s], values (N, k), names of columns."""

    times: Array
    values: Array
    names: tuple[str, ...]

    @property
    def words(self) -> str:
        """How often it was read."""
        steps = np.diff(self.times)
        if not steps.size or not np.median(steps) > 0.0:
            return f"{len(self.times)} readings"
        rate, gap = 1.0 / float(np.median(steps)), float(steps.max())
        return (
            f"{len(self.times)} readings, {significant(rate, 3)} per s, largest gap "
            f"{significant(gap, 2)} s"
        )

    @property
    def often(self) -> bool:
        """Whether it was read so often that its moves are seen."""
        return len(self.times) > 2 and float(np.median(np.diff(self.times))) <= _OFTEN

    def speed(self, grid: Array) -> Array:
        """How far the values go per tick of a grid, smoothed; nothing where it was not read."""
        finite = np.isfinite(self.values).all(axis=1)
        times = self.times[finite]
        if len(times) < 2:
            return np.zeros(len(grid))
        values = self.values[finite][:, np.ptp(self.values[finite], axis=0) > 0.0]
        values = values / np.ptp(values, axis=0) if values.size else np.zeros((len(times), 1))
        at = np.stack([np.interp(grid, times, v) for v in values.T])
        boxes = np.ones(_BOXES) / _BOXES
        smooth = np.stack([np.convolve(v, boxes, mode="same") for v in at])
        way: Array = np.linalg.norm(np.gradient(smooth, axis=1), axis=0)
        ends = (grid < times[0] + _BOXES * _TICK) | (grid > times[-1] - _BOXES * _TICK)
        return np.where(ends, 0.0, way)


@dataclass(frozen=True, eq=False)
class Recording:
    """Joints and instruments by time: a table of the poses at which the robot stood.

    joints: by name; measured: by topic; left_out: topics that were not read, with their types;
    lag: topic -> median of receive minus header stamps [s]. `columns` and `recording[name]` give
    the table, so that `init` and `calibrate` take a recording as readings.
    """

    joints: Mapping[str, Series]
    measured: Mapping[str, Series]
    left_out: Mapping[str, str] = field(default_factory=dict)
    lag: Mapping[str, float] = field(default_factory=dict)

    @cached_property
    def stands(self) -> Array:
        """(N, 2) [s] begin and end of each time in which no joint moves."""
        series = self.joints.values()
        grid = max((one.times for one in series), key=len)
        still = np.ones(len(grid), dtype=bool)
        for one in series:
            last = np.searchsorted(one.times, grid, side="right") - 1
            still &= _still(one.times, one.values[:, 0])[last] & (last >= 0)
        edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(int), [0]])))
        # A window looks back by STILL: the stand begins where the first still window does.
        return np.column_stack([grid[edges[::2]] - STILL, grid[edges[1::2] - 1]])

    @cached_property
    def late(self) -> Mapping[str, float]:
        """Topic -> delay [s] of its instrument behind the joints, to a tick of 10 ms: the lag at
        which the speeds of both are most alike."""
        series = [*self.joints.values(), *self.measured.values()]
        begin, end = min(s.times[0] for s in series), max(s.times[-1] for s in series)
        grid = np.arange(begin, end, _TICK)
        joints = [one.speed(grid) for one in self.joints.values()]
        moving = np.sqrt(np.sum(np.square(joints), axis=0))
        lags = np.arange(-round(_LATE / _TICK), round(_LATE / _TICK) + 1)
        made = {}
        for topic, one in self.measured.items():
            if not one.often:
                made[topic] = 0.0
                continue
            speed = one.speed(grid)
            alike = [_alike(np.roll(moving, lag), speed) for lag in lags]
            best = int(np.argmax(alike))
            made[topic] = _TICK * float(lags[best]) if alike[best] > _ALIKE else 0.0
        return made

    @cached_property
    def table(self) -> Mapping[str, Array]:
        """Column -> (N,) medians, a row for each stand; NaN where a topic was silent."""
        columns = {"time [s]": self.stands[:, 0]}
        for name, one in self.joints.items():
            columns[name] = _medians(one, self.stands)[:, 0]
        margin = np.array([MARGIN, -MARGIN])
        for topic, one in self.measured.items():
            shifted = self.stands + self.late[topic] + margin
            columns |= dict(zip(one.names, _medians(one, shifted).T, strict=True))
        return columns

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns of the table."""
        return tuple(self.table)

    def __getitem__(self, name: str) -> Array:
        return self.table[name]

    def words(self) -> list[str]:
        """What was read and what was not, in sentences."""
        times = [one.times for one in self.joints.values()]
        rate = max(self.joints.values(), key=lambda one: len(one.times))
        duration = max(t[-1] for t in times) - min(t[0] for t in times)
        lines = [
            f"{len(self.stands)} poses at rest in {duration:.0f} s: {len(self.joints)} joints with "
            f"{rate.words}. At a pose no joint moves for {STILL:g} s; its readings are medians."
        ]
        for topic, one in self.measured.items():
            seen = int(np.isfinite(self.table[one.names[0]]).sum())
            lag = self.lag.get(topic)
            later = "" if lag is None else f"; received {significant(1e3 * lag, 2)} ms later"
            lines.append(f"{topic}: {one.words}{later}; {seen} poses.")
        if self.left_out:
            every = [f"{topic} ({kind})" for topic, kind in self.left_out.items()]
            more = f" and {len(every) - 8} more" if len(every) > 8 else ""
            lines.append(f"Not read: {', '.join(every[:8])}{more}.")
        return lines

    def __repr__(self) -> str:
        return (
            f"<Recording: {len(self.stands)} poses at rest, {len(self.joints)} joints, "
            f"{len(self.measured)} instruments>"
        )

    def refuse_unusable(self, place: str) -> None:
        """Raise InputError for stamps that are zero or do not rise, and without a stand."""
        for name, one in (*self.joints.items(), *self.measured.items()):
            if not one.times.any() or (np.diff(one.times) < 0.0).any():
                raise InputError(
                    f"the stamps of {name!r} are zero or do not rise",
                    code="invalid-value",
                    place=place,
                    remedy="record messages with header.stamp set by one clock, in order",
                )
        if not len(self.stands):
            raise InputError(
                f"the robot never stands still for {STILL:g} s",
                code="no-data",
                place=place,
                remedy="hold each pose for at least 1 s while recording",
            )


def packed(recording: Recording) -> bytes:
    """A recording as bytes for `unpacked`, without any code."""
    arrays: dict[str, Array] = {}
    head: list[tuple[str, str, tuple[str, ...]]] = []
    for kind in ("joints", "measured"):
        for key, one in getattr(recording, kind).items():
            number = len(head)
            arrays |= {f"t{number}": one.times, f"v{number}": one.values}
            head.append((kind, key, one.names))
    about = [head, dict(recording.left_out), dict(recording.lag)]
    buffer = BytesIO()
    words = np.frombuffer(json.dumps(about).encode(), np.uint8)
    np.savez(buffer, about=words, **arrays)  # type: ignore[arg-type]
    return buffer.getvalue()


def unpacked(content: bytes) -> Recording:
    """The recording out of its bytes."""
    with np.load(BytesIO(content), allow_pickle=False) as arrays:
        head, left_out, lag = json.loads(arrays["about"].tobytes())
        series: dict[str, dict[str, Series]] = {"joints": {}, "measured": {}}
        for number, (kind, key, names) in enumerate(head):
            one = Series(arrays[f"t{number}"], arrays[f"v{number}"], tuple(names))
            series[kind][key] = one
    return Recording(series["joints"], series["measured"], left_out, lag)


def _alike(a: Array, b: Array) -> float:
    """Correlation of two speeds; 0 where one of them stands."""
    size = float(np.linalg.norm(a - a.mean()) * np.linalg.norm(b - b.mean()))
    return float((a - a.mean()) @ (b - b.mean())) / size if size > 0.0 else 0.0


def _still(times: Array, readings: Array) -> NDArray[np.bool_]:
    """(N,) whether the readings of the window up to each one are alike but for their noise."""
    still = np.zeros(len(times), dtype=bool)
    steps = np.abs(np.diff(readings))
    if not steps.size:
        return still
    count = 1 + int(np.ceil(STILL / max(float(np.median(np.diff(times))), 1e-6)))
    if count > len(times):
        return still
    smallest = steps[steps > 0.0].min(initial=np.inf)
    # Of rounded readings at rest the last digit may change: 1.5 admits one step and no second.
    allowed = max(_SPREAD * float(np.quantile(steps, _SHARE)) / _STEP, 1.5 * smallest)
    windows = np.lib.stride_tricks.sliding_window_view(readings, count)
    still[count - 1 :] = np.ptp(windows, axis=1) <= allowed
    return still


def _medians(series: Series, stands: Array) -> Array:
    """(N, k) medians of the readings within each stand; NaN where there is none."""
    medians = np.full((len(stands), series.values.shape[1]), np.nan)
    for i, (first, last) in enumerate(np.searchsorted(series.times, stands)):
        inside = series.values[first:last].copy()
        inside = inside[np.isfinite(inside).all(axis=1)]
        if len(inside):
            if _turned(series.names):  # q and -q are one orientation
                inside[:, 3:] *= np.where(inside[:, 3:] @ inside[0, 3:] < 0.0, -1.0, 1.0)[:, None]
            medians[i] = np.median(inside, axis=0)
    return medians


def _turned(names: Sequence[str]) -> bool:
    """Whether these are the columns of a pose of a bag."""
    return len(names) == 7 and names[3].endswith("qw")
