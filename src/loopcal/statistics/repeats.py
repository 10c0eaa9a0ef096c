"""Sensor sds from readings of one pose taken again and again.

Several series are pooled, each about its own mean. Drift is told apart from scatter by the
differences between successive readings, which a slow drift hardly changes (von Neumann 1941).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.chi_squared import quantile
from loopcal.errors import InputError
from loopcal.measurements.checks import lost_rows, refuse_lost
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.datasheet import rounding_sd
from loopcal.measurements.resolution import Grid, grid
from loopcal.statistics.separation import Separation
from loopcal.units import from_si, unit

# Chosen, not derived: two readings have a difference, and no scatter that could be judged.
FEWEST = 3
"""Readings a series must have."""
# Chosen, not derived: a few tests per file, so one file of a hundred is called coarse by chance.
CLEAR = 0.01
"""A p-value below this counts as found out."""


@dataclass(frozen=True)
class Scatter:
    """An sd with what is known of it: sd_of_sd, and a 95 % interval by chi-squared.

    degrees: of freedom, of a sum of successive differences those that match its variance.
    """

    sd: float
    sd_of_sd: float
    low: float
    high: float
    degrees: float


@dataclass(frozen=True)
class SensorScatter:
    """What repeated readings say of one sensor [SI].

    unit: as stated, "" where none was; about_mean: within series, drift included; without_drift:
    from successive differences; drift: per row, and its sd, of each series; drift_p_value: that
    there is no straight drift; slow_p_value: no slow change of any kind; alternating_p_value: no
    up and down from row to row; by_series: sds about the mean; homogeneity_p_value: that the
    series scatter alike, None for one series; grid: step of the readings and rounding_sd, what
    it leaves; parked: series left out because the sensor stood still in them; sd: what to put
    into [noise].
    """

    name: str
    unit: str
    about_mean: Scatter
    without_drift: Scatter
    drift: tuple[float, ...]
    sd_of_drift: tuple[float, ...]
    drift_p_value: float | None
    slow_p_value: float | None
    alternating_p_value: float | None
    by_series: tuple[float, ...]
    homogeneity_p_value: float | None
    resolution: float | None
    rounding_sd: float | None
    parked: int = 0

    @property
    def drifts(self) -> bool:
        """Whether the readings change with time beyond their scatter."""
        p_values = (self.drift_p_value, self.slow_p_value)
        return any(p is not None and p < CLEAR for p in p_values)

    @property
    def scatter(self) -> Scatter:
        """The scatter to believe: free of drift where there is one."""
        return self.without_drift if self.drifts else self.about_mean

    @property
    def sd(self) -> float:
        """The sd for [noise]: the scatter, but never less than rounding leaves."""
        return max(self.scatter.sd, self.rounding_sd or 0.0)


@dataclass(frozen=True)
class Correlation:
    """The correlation of two sensors within series, and the p-value that there is none."""

    sensors: tuple[str, str]
    value: float
    p_value: float


@dataclass(frozen=True)
class Repeats:
    """What repeated readings say of the sensors; series: (name, readings used) of each.

    correlations: of every pair that scatters; separation: joints and instrument
    distinguished by the loops of a mechanism, None without one.
    """

    series: tuple[tuple[str, int], ...]
    sensors: tuple[SensorScatter, ...]
    correlations: tuple[Correlation, ...]
    separation: Separation | None = None

    def __getitem__(self, name: str) -> SensorScatter:
        for sensor in self.sensors:
            if sensor.name == name:
                return sensor
        raise KeyError(name)

    @property
    def correlated(self) -> tuple[Correlation, ...]:
        """Correlations that are there, at 1 % over all pairs together (Bonferroni)."""
        bound = CLEAR / max(len(self.correlations), 1)
        return tuple(c for c in self.correlations if c.p_value < bound)


def repeated_readings(series: Dataset | Sequence[Dataset]) -> Repeats:
    """Sensor sds from one or several series of readings, each of one pose, in order of time.

    sd = sqrt(sum over series of (x - its mean)^2 / degrees of freedom); rows without one of the
    readings are left out for that sensor, and so are series in which it never changes although in
    others it scatters by more than its step: a joint was parked there.

    >>> still = Dataset.from_arrays({"a": [0.1, 0.3, 0.2, 0.1, 0.3]})
    >>> round(repeated_readings(still)["a"].sd, 3)
    0.1

    Raises InputError where series have different quantities or fewer than three readings, and for
    rows in which several quantities drop to 0 together.
    """
    every = [series] if isinstance(series, Dataset) else list(series)
    if not every:
        raise InputError(
            "there are no repeated readings", code="no-data", remedy="give at least one series"
        )
    names = every[0].quantities
    for one in every:
        if set(one.quantities) != set(names):
            raise InputError(
                f"the series have different quantities: {', '.join(names)} and "
                f"{', '.join(one.quantities)}",
                code="wrong-shape",
                place=one.source.name,
                remedy="name columns that all of them have",
            )
    for one in every:
        refuse_lost(one, *lost_rows(one), "or delete the rows")
    sensors = tuple(_sensor(name, every) for name in names)
    labels = tuple((s.source.name or f"series {i}", len(s)) for i, s in enumerate(every, 1))
    return Repeats(labels, sensors, _correlations(every, [s for s in sensors if s.about_mean.sd]))


def scatter(sum_of_squares: float, degrees: float) -> Scatter:
    """sqrt(S / nu), its sd by the chi distribution, and its 95 % interval.

    sd of sd = sd sqrt(1 - c4^2), c4 = sqrt(2/nu) Gamma((nu+1)/2) / Gamma(nu/2).
    """
    from scipy.special import gammaln

    sd = math.sqrt(sum_of_squares / degrees)
    c4 = math.sqrt(2.0 / degrees) * math.exp(gammaln((degrees + 1) / 2) - gammaln(degrees / 2))
    low, high = (sd * math.sqrt(degrees / quantile(tail, degrees)) for tail in (0.025, 0.975))
    return Scatter(sd, sd * math.sqrt(1.0 - c4 * c4), low, high, degrees)


def _sensor(name: str, every: Sequence[Dataset]) -> SensorScatter:
    read = [_read(one, name) for one in every]
    stated = every[0].source.stated.get(name, every[0].units.get(name, ""))
    step = _resolution([grid(from_si(v, stated or "1")) for v in read])
    si_step = None if step is None else step * unit(stated or "1").factor
    values = _moving(read, si_step or 0.0)
    counts = np.array([len(v) for v in values])
    N, S = int(counts.sum()), len(values)
    centred = _without_rounding_of_floats([v - v.mean() for v in values], values)
    square = sum(float(v @ v) for v in centred)
    difference = sum(float(np.square(np.diff(v)).sum()) for v in centred)
    # Var sum d^2 = 2 sigma^4 tr A^2 with tr A^2 = 6 n - 8 for each series
    # nu = 2 E^2 / Var, with E sum d^2 = 2 (N - S) sigma^2 (Satterthwaite 1946).
    matching = 2.0 * (N - S) ** 2 / (3 * N - 4 * S)
    lines = [_line(v) for v in centred]
    slow = slow_p_value(square, difference, counts)
    return SensorScatter(
        name,
        stated,
        scatter(square, N - S),
        scatter(difference * matching / (2.0 * (N - S)), matching),
        tuple(line.slope for line in lines),
        tuple(line.sd for line in lines),
        _drift_p_value(square, sum(line.left for line in lines), N, S),
        slow,
        None if slow is None else 1.0 - slow,
        tuple(float(v.std(ddof=1)) if np.ptp(v) else 0.0 for v in read),
        _homogeneity(values) if S > 1 and square > 0.0 else None,
        si_step,
        None if si_step is None else rounding_sd(si_step),
        len(read) - len(values),
    )


def _read(one: Dataset, name: str) -> Array:
    values = one[name]
    values = values[~np.isnan(values)]
    if len(values) < FEWEST:
        raise InputError(
            f"{name!r} was read {len(values)} times, too few to estimate its scatter",
            code="too-few-poses",
            place=one.source.name,
            remedy=f"read one pose at least {FEWEST} times, better 20, or name other columns",
        )
    return values


def _moving(values: list[Array], step: float) -> list[Array]:
    """The series in which the sensor moved; all, where standing still may be chance."""
    moving = [v for v in values if np.ptp(v)]
    return moving if moving and all(v.std(ddof=1) > step for v in moving) else values


def _without_rounding_of_floats(centred: list[Array], values: list[Array]) -> list[Array]:
    """A constant column is constant, although its mean may be off by the last bit."""
    return [
        np.zeros_like(c) if v.min() == v.max() else c for c, v in zip(centred, values, strict=True)
    ]


@dataclass(frozen=True)
class _Line:
    """A straight line through one series: slope per row, its sd, squares left about it."""

    slope: float
    sd: float
    left: float


def _line(centred: Array) -> _Line:
    n = len(centred)
    row = np.arange(n) - (n - 1) / 2.0
    slope = float(row @ centred) / float(row @ row)
    left = float(np.square(centred - slope * row).sum())
    return _Line(slope, math.sqrt(left / (n - 2) / float(row @ row)), left)


def _drift_p_value(square: float, left: float, N: int, S: int) -> float | None:
    """F test of straight drifts, one slope for each series; None where nothing scatters."""
    from scipy.special import fdtrc

    if not square > 0.0:
        return None
    # A line without residuals, as of a column that counts: F would divide by zero.
    if not left > 1e-12 * square:
        return 0.0
    return float(fdtrc(S, N - 2 * S, (square - left) / S / (left / (N - 2 * S))))


def slow_p_value(square: float, difference: float, counts: NDArray[np.int_]) -> float | None:
    """The p-value of C = 1 - sum d^2 / (2 S) against slow changes, which make it positive.

    Without drift E C = 0, Var C = (N - 2 s) / (nu (nu + 2)) for s series, |C| <= cos(pi / n);
    a symmetric beta distribution on that range (Young 1941) serves for series of any length.
    """
    from scipy.special import betainc

    if not square > 0.0:
        return None
    N, S = int(counts.sum()), len(counts)
    freedom = N - S
    bound = math.cos(math.pi / int(counts.max()))
    variance = (N - 2 * S) / (freedom * (freedom + 2.0))
    # A symmetric beta(a, a) on (-b, b) has the variance b^2 / (2 a + 1).
    shape = max((bound * bound / variance - 1.0) / 2.0, 0.5)
    C = 1.0 - difference / (2.0 * square)
    part = min(max((1.0 - C / bound) / 2.0, 0.0), 1.0)
    return float(betainc(shape, shape, part))


def _homogeneity(values: Sequence[Array]) -> float | None:
    """That the series scatter alike: Levene's test about medians (Brown and Forsythe 1974)."""
    from scipy.special import fdtrc

    away = [np.abs(v - np.median(v)) for v in values]
    means = np.array([a.mean() for a in away])
    counts = np.array([len(a) for a in away])
    grand = float(counts @ means) / int(counts.sum())
    between = float(counts @ np.square(means - grand))
    within = sum(float(np.square(a - a.mean()).sum()) for a in away)
    freedom = int(counts.sum()) - len(values)
    if not within > 0.0:
        return None
    return float(fdtrc(len(values) - 1, freedom, between / (len(values) - 1) / (within / freedom)))


def _resolution(grids: Sequence[Grid]) -> float | None:
    """The finest grid of counts that a series shows; else that of the decimals."""
    counts = [g.step for g in grids if g.step is not None and g.step != g.decimals]
    decimals = [g.decimals for g in grids if g.decimals is not None]
    if counts:
        return min(counts)
    return min(decimals) if len(decimals) == len(grids) else None


def _correlations(
    every: Sequence[Dataset], sensors: Sequence[SensorScatter]
) -> tuple[Correlation, ...]:
    names = [sensor.name for sensor in sensors]
    # Each series takes its mean, the line between the two sensors one more.
    parts, freedom = [], -1
    for one in every:
        rows = np.array([one[name] for name in names]).reshape(len(names), len(one))
        rows = rows[:, ~np.isnan(rows).any(axis=0)]
        if rows.shape[1] > 1:
            parts.append(rows - rows.mean(axis=1, keepdims=True))
            freedom += rows.shape[1] - 1
    if len(names) < 2 or freedom < 1:
        return ()
    together = np.concatenate(parts, axis=1)
    length = np.sqrt(np.einsum("ij,ij->i", together, together))
    usable = length > 0.0
    R = (
        (together @ together.T)
        / np.where(usable, length, 1.0)
        / np.where(usable, length, 1.0)[:, None]
    )
    return tuple(
        Correlation((names[i], names[j]), float(R[i, j]), _no_correlation(float(R[i, j]), freedom))
        for i in range(len(names))
        for j in range(i + 1, len(names))
        if usable[i] and usable[j]
    )


def _no_correlation(r: float, freedom: int) -> float:
    """Two-sided p-value of r if the sensors are independent: Student's t with nu - 1 degrees."""
    from scipy.special import betainc

    # With t^2 = nu r^2 / (1 - r^2), nu / (nu + t^2) = 1 - r^2.
    return float(betainc(freedom / 2.0, 0.5, max(1.0 - r * r, 0.0)))
