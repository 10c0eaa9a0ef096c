"""What a machine's history shows: parameters, accuracy and events over time.

Time is that of the measurement (`Entry.day`). How a parameter changed, by steps or by drift, is in
`courses`. The chart of the accuracy is exponentially weighted (Roberts 1959): z_i = w x_i +
(1 - w) z_(i-1), with limits m +- 3 s sqrt(w / (2 - w) (1 - (1 - w)^(2 i))), s by moving ranges.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from loopcal.arrays import Array
from loopcal.companions.life.courses import (
    Change,
    Course,
    Way,
    changes,
    events_before,
    walk_variance,
)
from loopcal.companions.life.history_folder import Entries, Entry, Skipped
from loopcal.lazy import cached_property
from loopcal.presentation.shown import by_sd, columns, p_words, size, unit_shown, with_unit, wrapped

# [s] A Julian year: drift rates need no finer one.
_DAY = 86400.0
_YEAR = 365.25 * _DAY
# Chosen, not derived: a rate is then at most twice the change that was seen.
_LEAST_SPAN = 0.5 * _YEAR
"""[s] of measurements from which a change in a year is stated."""
FEWEST = 5
"""Results from which a drift rate is learnt."""
# Fewer say nothing of dates: with two of them only one difference is dated.
_FEWEST_DATED = 3
# Squares of double precision keep it: (1e-7)^2 is some 50 times the smallest relative step.
_DIGITS = 1e-7
_WORDS: Mapping[Way, str] = {
    "step": "step",
    "drift": "drift",
    "wander": "unsteady drift",
    "scatter": "scatter beyond its sds",
    "open": "step or drift",
}


@dataclass(frozen=True)
class TrendChange:
    """A change of a parameter, see `courses.Change`.

    size, half: [unit of the trend], of scatter a factor; after, before, at: numbers of the
    entries; event: what happened there; days: from the first measurement to the last; year,
    year_half: the change in a year. Both only where the measurements are dated, and far enough
    apart.
    """

    way: Way
    size: float
    half: float | None
    after: int
    before: int
    at: int | None = None
    event: str | None = None
    days: float | None = None
    year: float | None = None
    year_half: float | None = None

    def row(self, trend: Trend) -> list[str]:
        """Parameter, what it did, by how much, when, in a year, event."""
        shown = unit_shown(trend.unit)
        if self.way == "scatter":
            return [trend.name, _WORDS[self.way], f"{self.size:.2g} sds", "", "", ""]
        if self.half is None:
            changed = f"sd {with_unit(self.size, trend.unit, 2)}"
        else:
            changed = f"{_plus_minus(self.size, self.half, trend.unit)} {shown}"
        when = f"between {self.after} and {self.before}"
        if self.days is not None:
            when = f"in {self.days:.0f} days"
        yearly = ""
        if self.year is not None and self.year_half is not None:
            yearly = f"{_plus_minus(self.year, self.year_half, trend.unit)} {shown}"
        return [trend.name, _WORDS[self.way], changed, when, yearly, self.event or ""]


def _plus_minus(value: float, half: float, unit: str) -> str:
    return f"{by_sd(value, half, unit, sign=True)} ± {size(half, unit, 2)}"


CHANGE_HEAD = ("parameter", "change", "size", "entries or time", "in a year", "event")


@dataclass(frozen=True)
class Trend:
    """A parameter over time: its values and sds [unit] at the calibrations that determined it.

    numbers: of their entries; times: of the measurements, where these are known; dated: whether
    they are; rate: sd of its drift in a year, without its steps, None for fewer than five dated
    calibrations over half a year; changes: its steps and drift.
    """

    name: str
    unit: str
    numbers: tuple[int, ...]
    times: tuple[str, ...]
    values: tuple[float, ...]
    sds: tuple[float, ...]
    dated: bool
    rate: float | None
    changes: tuple[TrendChange, ...]


@dataclass(frozen=True, eq=False)
class History:
    """The history of a machine: `loopcal.history`.

    entries: as they were read, with the files that were skipped.
    """

    entries: Entries

    @cached_property
    def shown(self) -> tuple[Entry, ...]:
        """The entries by the day of their measurement."""
        return tuple(sorted(self.entries.whole, key=lambda e: (e.day.date(), e.sequence)))

    @property
    def undated(self) -> tuple[Entry, ...]:
        """The entries whose day of measurement is unknown."""
        return tuple(entry for entry in self.shown if not entry.dated)

    @cached_property
    def trends(self) -> tuple[Trend, ...]:
        """Of the parameters of all calibrations."""
        points: dict[str, list[tuple[Entry, float, float]]] = {}
        units: dict[str, str] = {}
        for entry in self.of_kind("calibration"):
            for name, parameter in entry.content["parameters"].items():
                units[name] = parameter["unit"]
                point = entry, parameter["value"], parameter["sd"]
                points.setdefault(name, []).append(point)
        tested = sum(len(series) > 1 for series in points.values())
        events = self.of_kind("event")
        return tuple(
            _trend(name, units[name], series, events, tested) for name, series in points.items()
        )

    @property
    def changed(self) -> tuple[tuple[Trend, TrendChange], ...]:
        """The changes of all parameters."""
        return tuple((trend, change) for trend in self.trends for change in trend.changes)

    @property
    def accuracy(self) -> tuple[float, ...]:
        """Rms [m, or the unit of the outputs] of calibrations and verifications that have one."""
        return tuple(entry.content["rms"] for entry in self.measured)

    @property
    def measured(self) -> tuple[Entry, ...]:
        """The entries with an accuracy."""
        return tuple(e for e in self.shown if e.content.get("rms") is not None)

    @cached_property
    def chart(self) -> Chart | None:
        """Of the accuracy; None for fewer than three."""
        return chart(self.accuracy)

    def of_kind(self, kind: str) -> tuple[Entry, ...]:
        """The entries of a kind."""
        return tuple(entry for entry in self.shown if entry.kind == kind)

    def marks(self, entry: Entry) -> str:
        """What stands out at an entry: a step, an event, an accuracy beyond its limits."""
        marks = ["event"] if entry.kind == "event" else []
        if self.chart is not None and entry in self.measured:
            at = self.measured.index(entry)
            marks += ["beyond limits"] if self.chart.beyond[at] else []
        stepped = [t.name for t, c in self.changed if c.at == entry.sequence]
        if stepped:
            more = f" (+{len(stepped) - 3})" if stepped[3:] else ""
            marks.append(f"changed: {', '.join(stepped[:3])}{more}")
        return "; ".join(marks)

    def drift(self, until: datetime | None = None) -> dict[str, float]:
        """The sds [SI] by which parameters have changed since the last calibration, by their rates.

        Until now, or another time; empty where no rate is learnt. `update` takes it.
        """
        done = self.of_kind("calibration")
        if not done:
            return {}
        since = (until or datetime.now(UTC)) - done[-1].day
        years = max(since.total_seconds() / _YEAR, 0.0)
        return {one.name: one.rate * years**0.5 for one in self.trends if one.rate}

    @classmethod
    def from_document(cls, document: Mapping[str, Any]) -> History:
        """From `document`."""
        whole = (
            Entry(**{**one, "time": datetime.fromisoformat(one["time"])})
            for one in document["entries"]
        )
        skipped = (Skipped(**one) for one in document["skipped"])
        return cls(Entries(Path(document["folder"]), tuple(whole), tuple(skipped)))

    def document(self) -> dict[str, Any]:
        """As one JSON document: SI."""
        return {
            "folder": str(self.entries.folder),
            "entries": [{**asdict(e), "time": e.time.isoformat()} for e in self.entries.whole],
            "skipped": [asdict(one) for one in self.entries.skipped],
            "trends": [asdict(one) for one in self.trends],
            "chart": None if self.chart is None else asdict(self.chart),
        }

    def words(self) -> list[str]:
        """What the reader must know of the entries, a sentence or two each."""
        words = []
        if self.chart is not None and self.chart.outside:
            words.append("The accuracy is outside its limits (EWMA). Verify the machine.")
        if self.undated:
            numbers = ", ".join(str(entry.sequence) for entry in self.undated)
            words.append(
                f"Date of measurement unknown: entry {numbers}, dated by the day of processing "
                "('by'). No rate is computed from it. State --date or [record] date."
            )
        series = [trend for trend in self.trends if len(trend.values) > 1]
        if series and not self.changed:
            words.append(f"No change is seen: parameters of several calibrations: {len(series)}.")
        elif not series:
            words.append("Changes are sought from two calibrations on.")
        return words

    def rows(self) -> list[tuple[str, ...]]:
        """Number, day, kind, rms, result and marks of each entry."""
        return [
            (
                str(e.sequence),
                f"{e.day:%Y-%m-%d}" if e.dated else f"by {e.time:%Y-%m-%d}",
                e.kind,
                _rms(e.content),
                e.content["words"],
                self.marks(e),
            )
            for e in self.shown
        ]

    def __str__(self) -> str:
        rows = [ENTRY_HEAD, *self.rows()]
        lines = columns(rows) if len(rows) > 1 else ["no entry yet"]
        lines += [f"SKIPPED  {one.file}: {one.reason}" for one in self.entries.skipped]
        if self.entries.skipped:
            lines.append("Restore skipped entries from a backup, or delete their files.")
        if self.changed:
            changed = [change.row(trend) for trend, change in self.changed]
            lines += ["", *columns([CHANGE_HEAD, *changed]), "(±: 95 % interval)"]
        for words in self.words() if len(rows) > 1 else ():
            lines += ["", *wrapped(words)]
        return "\n".join(lines)


ENTRY_HEAD = ("number", "day", "entry", "rms", "result", "marks")


def _trend(
    name: str,
    unit: str,
    points: list[tuple[Entry, float, float]],
    events: Sequence[Entry],
    tested: int,
) -> Trend:
    """By the dated calibrations where there are enough of them, else in the order of entries."""
    dated = [point for point in points if point[0].dated]
    span = (dated[-1][0].day - dated[0][0].day).total_seconds() if dated else 0.0
    # Within a day the order is all that is known.
    by_day = len(dated) >= _FEWEST_DATED and span >= _DAY
    points = dated if by_day else sorted(points, key=lambda point: point[0].sequence)
    entries = [entry for entry, _, _ in points]
    values, sds = tuple(v for _, v, _ in points), tuple(s for _, _, s in points)
    place = _days_of if by_day else _order_of
    times = np.array([place(entry) for entry in entries])
    at_events = events_before(times.tolist(), [place(event) for event in events])
    rate, described = None, list[TrendChange]()
    if len(points) > 1 and _comparable(values, sds):
        course = Course(times, np.array(values, float) - values[0], np.array(sds, float), at_events)
        seen = changes(course, tested)
        steps = {*at_events, *(change.at for change in seen if change.at is not None)}
        # Three calibrations beyond the steps: two of them would fit any rate.
        if by_day and span >= _LEAST_SPAN and len(points) >= max(FEWEST, len(steps) + 4):
            rate = math.sqrt(walk_variance(course, steps) * 365.25)
        described = [_change(one, entries, at_events, events, place) for one in seen]
        if by_day:
            described = [_over(change, span) for change in described]
    stamps = tuple(entry.day.isoformat() for entry in entries)
    numbers = tuple(entry.sequence for entry in entries)
    return Trend(name, unit, numbers, stamps, values, sds, by_day, rate, tuple(described))


def _comparable(values: Sequence[float], sds: Sequence[float]) -> bool:
    """Whether the values can be weighed by their sds in double precision."""
    largest = max(sds)
    return min(sds) > _DIGITS * largest and max(values) - min(values) < largest / _DIGITS**2


def _change(
    change: Change,
    entries: Sequence[Entry],
    at_events: Collection[int],
    events: Sequence[Entry],
    place: Callable[[Entry], float],
) -> TrendChange:
    """As the entries have it, with what happened there."""
    after, before = entries[change.after].sequence, entries[change.before].sequence
    event, at = None, None
    if change.at is not None:
        at = entries[change.at].sequence
        if change.at in at_events:
            low, high = (place(entries[i]) for i in (change.at - 1, change.at))
            event = ", ".join(e.content["words"] for e in events if low <= place(e) <= high)
    return TrendChange(change.way, change.size, change.half, after, before, at, event)


def _over(change: TrendChange, span: float) -> TrendChange:
    """A drift with its time [s], and with its rate where that is long enough."""
    if change.way not in ("drift", "wander"):
        return change
    change = replace(change, days=span / _DAY)
    if change.half is None or span < _LEAST_SPAN:
        return change
    per_year = _YEAR / span
    return replace(change, year=change.size * per_year, year_half=change.half * per_year)


def _days_of(entry: Entry) -> float:
    return entry.day.timestamp() // _DAY


def _order_of(entry: Entry) -> float:
    return float(entry.sequence)


def _rms(content: Mapping[str, Any]) -> str:
    rms = content.get("rms")
    return "–" if rms is None else with_unit(rms, content["unit"])


def verification_words(code: str, p_value: float | None) -> str:
    """A verification in a few words."""
    return f"{code}, {p_words(p_value)}"


Values = Sequence[float] | Array
# Usually 0.2 to 0.3 (Hunter 1986); the largest follows few calibrations soonest.
WEIGHT = 0.3
# Shewhart's three sds, as in the formula above.
_LIMIT = 3.0
_RANGE = 1.128
"""Mean range of two normal values, in sds."""


@dataclass(frozen=True)
class Chart:
    """x: (n,) values; smooth, low, high: (n,) the weighted mean and its limits."""

    smooth: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]

    @property
    def outside(self) -> bool:
        """Whether the last value is beyond its limits."""
        return self.beyond[-1]

    @property
    def beyond(self) -> tuple[bool, ...]:
        """Of each value whether it is beyond its limits."""
        each = zip(self.low, self.smooth, self.high, strict=True)
        return tuple(not low <= smooth <= high for low, smooth, high in each)


def chart(values: Values) -> Chart | None:
    """The chart of some values; None for fewer than three."""
    if len(values) < 3:
        return None
    x = np.asarray(values)
    mean, sd = float(x.mean()), float(np.abs(np.diff(x)).mean()) / _RANGE
    smooth, low, high, z = [], [], [], mean
    for i, value in enumerate(x.tolist(), 1):
        z = WEIGHT * value + (1.0 - WEIGHT) * z
        share = WEIGHT / (2.0 - WEIGHT) * (1.0 - (1.0 - WEIGHT) ** (2 * i))
        half = _LIMIT * sd * float(np.sqrt(share))
        smooth.append(z)
        low.append(mean - half)
        high.append(mean + half)
    return Chart(tuple(smooth), tuple(low), tuple(high))
