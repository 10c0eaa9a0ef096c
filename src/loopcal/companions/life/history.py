"""What a machine's history shows: parameters, accuracy and events over time.

Time is that of the measurement (`Entry.day`). How the machine changed, by steps or by drift, is in
`courses`. The chart of the accuracy is exponentially weighted (Roberts 1959): z_i = w x_i +
(1 - w) z_(i-1), with limits m +- 3 s sqrt(w / (2 - w) (1 - (1 - w)^(2 i))), s by moving ranges.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from typing import Any

import numpy as np

from loopcal.arrays import Array
from loopcal.companions.life.courses import (
    LEVEL,
    Cause,
    Change,
    Course,
    Said,
    Way,
    changes,
    events_before,
    walk_variance,
)
from loopcal.companions.life.history_folder import Entries, Entry
from loopcal.companions.life.joint_entry import Joint, causes
from loopcal.document.plain import rebuilt
from loopcal.document.result_document import UPDATED
from loopcal.lazy import cached_property
from loopcal.presentation.shown import by_sd, columns, p_words, size, unit_shown, with_unit, wrapped
from loopcal.small_samples import t_quantile

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
# Chosen, not derived: what fits a line.
_MOST_NAMED = 4
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
class MachineChange:
    """A change of the machine, see `courses.Change`.

    causes: what explains it with 95 %, the likeliest first; size, half: [unit] of the first, of
    scatter a factor; moved, moved_half: by how much it moves the measured points, the root mean
    square over the poses [m], where these are known; after, before, at: numbers of the entries;
    event: what happened there; days: from the first measurement to the last; year, year_half: the
    change in a year. Both only where the measurements are dated, and far enough apart.
    """

    way: Way
    causes: tuple[str, ...]
    unit: str
    size: float
    half: float | None
    moved: float | None
    moved_half: float | None
    after: int
    before: int
    at: int | None = None
    event: str | None = None
    days: float | None = None
    year: float | None = None
    year_half: float | None = None

    @property
    def name(self) -> str:
        """What changed, in words."""
        more = len(self.causes) - _MOST_NAMED
        last = [f"one of {more} more"] if more > 0 else []
        return " or ".join([*self.causes[:_MOST_NAMED], *last])

    def row(self) -> list[str]:
        """What changed, how, by how much, what it moves, when, in a year, event."""
        shown = unit_shown(self.unit)
        if self.way == "scatter":
            return [self.name, _WORDS[self.way], f"{self.size:.2g} sds", "", "", "", ""]
        moved = ""
        if self.moved is not None:
            moved = with_unit(self.moved, "m", 2)
            if self.moved_half is not None:
                half = size(self.moved_half, "m", 2)
                moved = f"{by_sd(self.moved, self.moved_half, 'm')} ± {half} {unit_shown('m')}"
        if self.half is None:
            changed = f"sd {with_unit(self.size, self.unit, 2)}"
        else:
            changed = f"{_plus_minus(self.size, self.half, self.unit)} {shown}"
        when = f"between {self.after} and {self.before}"
        if self.days is not None:
            when = f"in {self.days:.0f} days"
        yearly = ""
        if self.year is not None and self.year_half is not None:
            yearly = f"{_plus_minus(self.year, self.year_half, self.unit)} {shown}"
        return [self.name, _WORDS[self.way], changed, moved, when, yearly, self.event or ""]


def _plus_minus(value: float, half: float, unit: str) -> str:
    return f"{by_sd(value, half, unit, sign=True)} ± {size(half, unit, 2)}"


CHANGE_HEAD = ("what", "change", "size", "moves", "entries or time", "in a year", "event")


@dataclass(frozen=True)
class Trend:
    """A parameter over time: its values and sds [unit] at the calibrations that determined it.

    numbers: of their entries; times: of the measurements, where these are known; dated: whether
    they are; rate: sd of its drift in a year, without the steps of the machine, None for fewer than
    five dated calibrations over half a year.
    """

    name: str
    unit: str
    numbers: tuple[int, ...]
    times: tuple[str, ...]
    values: tuple[float, ...]
    sds: tuple[float, ...]
    dated: bool
    rate: float | None


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
        events = self.of_kind("event")
        points = _points(self.of_kind("calibration"))
        return tuple(_trend(name, each, events, self.changes) for name, each in points.items())

    @cached_property
    def changes(self) -> tuple[MachineChange, ...]:
        """Steps and drifts of the machine, by all parameters together."""
        entries, by_day = _in_order(self.of_kind("calibration"))
        points = _points(entries)
        names = [
            name
            for name, each in points.items()
            if len(each) > 1 and _comparable([v for _, v, _ in each], [sd for *_, sd in each])
        ]
        if not names:
            return ()
        joints = [Joint.of_content(entry.content).among(names) for entry in entries]
        begin = {name: points[name][0][1] for name in names}
        said = []
        for entry, joint in zip(entries, joints, strict=True):
            estimates = entry.content["parameters"]
            values = np.array([estimates[n]["value"] - begin[n] for n in joint.names])
            at = np.array([names.index(n) for n in joint.names], dtype=np.intp)
            said.append(Said.of(values, joint.covariance, at, len(names)))
        last = joints[-1]
        place, events = _days_of if by_day else _order_of, self.of_kind("event")
        times = [place(entry) for entry in entries]
        at_events = events_before(times, [place(event) for event in events])
        described = {n: p for entry in entries for n, p in entry.content["parameters"].items()}
        possible = causes(last, names, described)
        models = _models(entries)
        numbered = tuple(models.index(one) for one in models)
        course = Course(np.array(times), tuple(said), possible, at_events, numbered)
        span = (entries[-1].day - entries[0].day).total_seconds() if by_day else 0.0
        M = _embedded(last, names)
        return tuple(
            _over(_change(one, possible, M, entries, events, place), span)
            for one in changes(course)
        )

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
        stepped = [change.name for change in self.changes if change.at == entry.sequence]
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
        return cls(rebuilt(Entries, {**document, "whole": document["entries"]}))

    def document(self) -> dict[str, Any]:
        """As one JSON document: SI."""
        return {
            "folder": str(self.entries.folder),
            "entries": [{**asdict(e), "time": e.time.isoformat()} for e in self.entries.whole],
            "skipped": [asdict(one) for one in self.entries.skipped],
            "trends": [asdict(one) for one in self.trends],
            "changes": [asdict(one) for one in self.changes],
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
        if len({*_models(self.of_kind("calibration"))}) > 1:
            words.append(
                "The calibrations chose different terms of the model error. What such a choice "
                "moves counts as no change."
            )
        series = [trend for trend in self.trends if len(trend.values) > 1]
        if series and not self.changes:
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
        if self.changes:
            changed = [change.row() for change in self.changes]
            lines += ["", *columns([CHANGE_HEAD, *changed]), "(±: 95 % interval)"]
        for words in self.words() if len(rows) > 1 else ():
            lines += ["", *wrapped(words)]
        return "\n".join(lines)


ENTRY_HEAD = ("number", "day", "entry", "rms", "result", "marks")


Point = tuple[Entry, float, float]
"""A calibration, and what it has of one parameter: value and sd."""


def _points(entries: Sequence[Entry]) -> dict[str, list[Point]]:
    """Of each parameter, the calibrations that determined it."""
    points: dict[str, list[Point]] = {}
    for entry in entries:
        for name, parameter in entry.content["parameters"].items():
            points.setdefault(name, []).append((entry, parameter["value"], parameter["sd"]))
    return points


def _models(entries: Sequence[Entry]) -> list[tuple[str, ...]]:
    """Method and terms of the model error of each calibration. An update has those of the
    calibration before it."""
    models: list[tuple[str, ...]] = []
    for entry in entries:
        label, *terms = entry.content.get("model") or [""]
        if label == UPDATED:
            label = next((one[0] for one in reversed(models) if [*one[1:]] == terms), label)
        models.append((label, *terms))
    return models


def _in_order(entries: Sequence[Entry]) -> tuple[list[Entry], bool]:
    """Those that are dated, by day, where there are enough of them, else all in their order."""
    dated = [entry for entry in entries if entry.dated]
    span = (dated[-1].day - dated[0].day).total_seconds() if dated else 0.0
    # Within a day the order is all that is known.
    by_day = len(dated) >= _FEWEST_DATED and span >= _DAY
    return (dated if by_day else sorted(entries, key=lambda one: one.sequence)), by_day


def _trend(
    name: str,
    points: Sequence[Point],
    events: Sequence[Entry],
    seen: Sequence[MachineChange],
) -> Trend:
    entries, by_day = _in_order([entry for entry, _, _ in points])
    unit = points[-1][0].content["parameters"][name]["unit"]
    each = {entry.sequence: (value, sd) for entry, value, sd in points}
    values, sds = zip(*(each[entry.sequence] for entry in entries), strict=True)
    rate = None
    span = (entries[-1].day - entries[0].day).total_seconds()
    if by_day and span >= _LEAST_SPAN and _comparable(values, sds):
        days = [_days_of(entry) for entry in entries]
        numbers = [entry.sequence for entry in entries]
        steps = events_before(days, [_days_of(event) for event in events])
        steps |= {numbers.index(one.at) for one in seen if one.at in numbers[1:]}
        # Three calibrations beyond the steps: two of them would fit any rate.
        if len(entries) >= max(FEWEST, len(steps) + 4):
            y = np.array(values, float) - values[0]
            course = Course.of_one(np.array(days), y, np.array(sds, float))
            rate = math.sqrt(walk_variance(course, steps) * 365.25)
    stamps = tuple(entry.day.isoformat() for entry in entries)
    return Trend(name, unit, tuple(e.sequence for e in entries), stamps, values, sds, by_day, rate)


def _embedded(last: Joint, names: Sequence[str]) -> Array | None:
    """M of `Joint` for these names."""
    if last.moves is None:
        return None
    M, at = np.zeros((len(names),) * 2), [names.index(name) for name in last.names]
    M[np.ix_(at, at)] = last.moves
    return M


def _comparable(values: Sequence[float], sds: Sequence[float]) -> bool:
    """Whether the values can be weighed by their sds in double precision."""
    largest = max(sds)
    return min(sds) > _DIGITS * largest and max(values) - min(values) < largest / _DIGITS**2


def _change(
    change: Change,
    possible: Sequence[Cause],
    M: Array | None,
    entries: Sequence[Entry],
    events: Sequence[Entry],
    place: Callable[[Entry], float],
) -> MachineChange:
    """As the entries have it, with what it moves and what happened there."""
    after, before = entries[change.after].sequence, entries[change.before].sequence
    event, at = None, None
    if change.at is not None:
        at = entries[change.at].sequence
        low, high = (place(entries[i]) for i in (change.at - 1, change.at))
        between = [e.content["words"] for e in events if low <= place(e) <= high]
        event = ", ".join(between) or None
    named, cause = tuple(possible[i].name for i in change.causes), possible[change.causes[0]]
    G = None if M is None else cause.directions.T @ M @ cause.directions
    size, half = change.size, change.half
    moved, moved_half = None, None
    if G is not None and change.way != "scatter":
        moved = float(np.sqrt(max(np.trace(G @ change.square), 0.0)))
        if half is not None and change.covariance is not None:
            along = G @ change.parts / max(moved, 1e-300)
            sd = float(np.sqrt(along @ change.covariance @ along))
            moved_half = t_quantile(LEVEL, change.freedom) * sd
    unit = cause.unit
    if len(change.parts) > 1 and moved is not None:
        unit, size, half = "m", moved, moved_half
    sizes = size, half, moved, moved_half
    return MachineChange(change.way, named, unit, *sizes, after, before, at, event)


def _over(change: MachineChange, span: float) -> MachineChange:
    """A drift with its time [s], and with its rate where that is long enough."""
    if change.way not in ("drift", "wander") or not span:
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
