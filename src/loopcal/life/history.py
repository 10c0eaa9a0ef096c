"""What a machine's history shows: parameters, accuracy and events over time.

How a machine changes over its life: drift rates, and a chart of its accuracy.

A parameter that was found as y_i with sd s_i at times t_i and that drifts as a random walk has

    y ~ N(m 1, diag(s_i^2) + q K),   K_ij = min(t_i, t_j) - t_1,

q its variance per year, learnt by restricted likelihood (Patterson and Thompson 1971). The
results count as independent. The chart is exponentially weighted (Roberts 1959): z_i = w x_i +
(1 - w) z_(i-1), with limits m +- 3 s sqrt(w / (2 - w) (1 - (1 - w)^(2 i))), s by moving ranges.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.files.history.folder import Entries, Entry, Skipped
from loopcal.lazy import cached_property
from loopcal.presentation.shown import by_sd, chance, columns, size, unit_shown, with_unit

# [s] A Julian year: drift rates need no finer one.
_YEAR = 365.25 * 86400.0


@dataclass(frozen=True)
class Trend:
    """A parameter over time: its values and sds [unit] at the calibrations that determined it.

    rate: sd of its drift in a year, None for fewer than five calibrations.
    """

    name: str
    unit: str
    times: tuple[str, ...]
    values: tuple[float, ...]
    sds: tuple[float, ...]
    rate: float | None


@dataclass(frozen=True, eq=False)
class History:
    """The history of a machine: `loopcal.history`.

    entries: as they were read, with the files that were skipped.
    """

    entries: Entries

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
        return tuple(_trend(name, units[name], series) for name, series in points.items())

    @property
    def accuracy(self) -> tuple[float, ...]:
        """Rms [m, or the unit of the outputs] of calibrations and verifications that have one."""
        return tuple(entry.content["rms"] for entry in self.measured)

    @property
    def measured(self) -> tuple[Entry, ...]:
        """The entries with an accuracy."""
        return tuple(e for e in self.entries.whole if e.content.get("rms") is not None)

    @cached_property
    def chart(self) -> Chart | None:
        """Of the accuracy; None for fewer than three."""
        return chart(self.accuracy)

    def of_kind(self, kind: str) -> tuple[Entry, ...]:
        """The entries of a kind."""
        return tuple(entry for entry in self.entries.whole if entry.kind == kind)

    def drift(self, until: datetime | None = None) -> dict[str, float]:
        """The sds [SI] by which parameters have changed since the last calibration, by their rates.

        Until now, or another time; empty for fewer than five calibrations. `update` takes it.
        """
        done = self.of_kind("calibration")
        if not done:
            return {}
        since = (until or datetime.now(UTC)) - done[-1].time
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

    def __str__(self) -> str:
        rows = [["number", "day", "entry", "rms", "result"]]
        rows += [
            [str(e.sequence), f"{e.time:%Y-%m-%d}", e.kind, _rms(e.content), e.content["words"]]
            for e in self.entries.whole
        ]
        lines = columns(rows) if len(rows) > 1 else ["no entry yet"]
        lines += [f"SKIPPED  {one.file}: {one.reason}" for one in self.entries.skipped]
        if self.entries.skipped:
            lines.append("Restore skipped entries from a backup, or delete their files.")
        if self.chart is not None and self.chart.outside:
            lines += ["", "WARNING  The accuracy is outside its limits (EWMA). Verify the machine."]
        rated = [trend for trend in self.trends if trend.rate is not None]
        if rated:
            lines += ["", *columns(_rates(rated))]
        elif number := len(self.of_kind("calibration")):
            lines += ["", f"drift rates: from {FEWEST} calibrations on, {number} so far"]
        return "\n".join(lines)


def _trend(name: str, unit: str, points: list[tuple[Entry, float, float]]) -> Trend:
    begin = points[0][0].time
    years = [(entry.time - begin).total_seconds() / _YEAR for entry, _, _ in points]
    values, sds = tuple(v for _, v, _ in points), tuple(s for _, _, s in points)
    enough = len(points) >= FEWEST and max(years) > 0.0
    rate = drift_rate(years, values, sds) if enough else None
    return Trend(name, unit, tuple(e.time.isoformat() for e, _, _ in points), values, sds, rate)


def _rates(trends: list[Trend]) -> list[list[str]]:
    rows = [["parameter", "first", "last", "sd", "drift in a year", "unit"]]
    for one in trends:
        rate = size(one.rate, one.unit, 2)
        first, last = (by_sd(v, s, one.unit) for v, s in _ends(one))
        sd = size(one.sds[-1], one.unit, 2)
        rows.append([one.name, first, last, sd, rate, unit_shown(one.unit)])
    return rows


def _ends(one: Trend) -> list[tuple[float, float]]:
    return [(one.values[i], one.sds[i]) for i in (0, -1)]


def _rms(content: Mapping[str, Any]) -> str:
    rms = content.get("rms")
    return "–" if rms is None else with_unit(rms, content["unit"])


def verification_words(code: str, p_value: float | None) -> str:
    """A verification in a few words."""
    return f"{code}, p = {chance(p_value)}"


Array = NDArray[np.float64]
Values = Sequence[float] | Array
FEWEST = 5
"""Results from which a drift rate is learnt."""
# Usually 0.2 to 0.3 (Hunter 1986); the largest follows few calibrations soonest.
WEIGHT = 0.3
# Shewhart's three sds, as in the formula above.
_LIMIT = 3.0
_RANGE = 1.128
"""Mean range of two normal values, in sds."""
# Powers of two, four to an octave: from a drift that no readings show to one that hides them all.
_GRID = np.linspace(-16.0, 8.0, 97)


@dataclass(frozen=True)
class Chart:
    """x: (n,) values; smooth, low, high: (n,) the weighted mean and its limits."""

    smooth: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]

    @property
    def outside(self) -> bool:
        """Whether the last value is beyond its limits."""
        return not self.low[-1] <= self.smooth[-1] <= self.high[-1]


def drift_rate(years: Values, values: Values, sds: Values) -> float:
    """The sd by which a parameter drifts in a year [its unit]; 0 where nothing shows it."""
    t, y, s = np.asarray(years), np.asarray(values), np.asarray(sds)
    K = np.minimum.outer(t, t) - t.min()
    scale = float(np.square(s).mean()) / max(float(np.ptp(t)), 1e-9)
    rates = np.concatenate([[0.0], scale * 2.0**_GRID])
    criteria = [_criterion(np.diag(np.square(s)) + q * K, y) for q in rates]
    return float(np.sqrt(rates[int(np.argmin(criteria))]))


def _criterion(V: Array, y: Array) -> float:
    """-2 log of the restricted likelihood of a constant mean, up to a constant."""
    L = np.linalg.cholesky(V)
    one, z = np.linalg.solve(L, np.column_stack([np.ones(len(y)), y])).T
    information = float(one @ one)
    rest = z - one * float(one @ z) / information
    volume = 2.0 * float(np.log(np.diag(L)).sum()) + float(np.log(information))
    return volume + float(rest @ rest)


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
