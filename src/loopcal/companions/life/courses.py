"""What a parameter did over its calibrations: nothing, a step, a drift, or scatter beyond its sds.

n values y with sds s at times t. Beside a mean that may have steps, each way to change is a further
covariance t_c C: of a step C = h h^T with h = 1 from one calibration on; of a steady drift
C = t t^T; of a wandering one C_ij = min(t_i, t_j) - t_1; of scatter C = diag(s^2). The restricted
likelihood ratio of each to no change is averaged over sizes, over the positions of the step, and
over the ways. Without a change its expectation is 1, so that it exceeds 20 m with a probability of
at most 1 / (20 m) (Ville 1939; Vovk and Wang 2021): over m parameters, 5 % of machines that do not
change are called changed, whatever the correlation of their parameters. Shares of the average are
the probabilities of ways and positions, all ways being as likely beforehand.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from loopcal.arrays import Array
from loopcal.small_samples import t_quantile

LEVEL = 0.95
"""Of intervals, of the way that is named, and of the two calibrations around a step."""
# By the false alarms above: 1 / (1 - LEVEL).
_ODDS = 20.0
# From changes as large as their own sd to those of 16 sds; larger ones need no finer prior.
_RATIOS = 2.0 ** np.arange(1, 9)
"""Variance with a change over that without, for which the likelihood is averaged."""
# Powers of two, four to an octave: from a drift that no readings show to one that hides them all.
_GRID = np.linspace(-16.0, 8.0, 97)
Way = Literal["step", "drift", "wander", "scatter", "open"]


@dataclass(frozen=True, eq=False)
class Course:
    """times: (n,) rising, in any unit; values, sds: (n,); events: the numbers of the calibrations
    from 0 before which something happened."""

    times: Array
    values: Array
    sds: Array
    events: frozenset[int] = frozenset()

    def __len__(self) -> int:
        return len(self.values)


@dataclass(frozen=True)
class Change:
    """way: "open" where a step and other ways are as likely. size: of a step, or of a drift over
    all times; of wandering its sd over all times; of scatter that over the stated sds. half: of its
    95 % interval, None for sds. after, before: the calibrations between which a step lies with
    95 %; at: the likeliest place, before this one; None without a step."""

    way: Way
    size: float
    half: float | None
    after: int
    before: int
    at: int | None = None


@dataclass(frozen=True, eq=False)
class _Weights:
    """Log of the averaged likelihood ratio; shares of the ways, and of the positions of a step."""

    total: float
    shares: Mapping[Way, float]
    positions: Array


@dataclass(frozen=True, eq=False)
class _Model:
    """steps: calibrations from 0 before which a step lies; drift: whether the mean drifts as well;
    rest: "wander" or "scatter" where the sds do not explain what is left."""

    steps: tuple[int, ...] = ()
    drift: bool = False
    rest: Way | None = None

    def columns(self, course: Course) -> Array:
        """(n, p) of the mean."""
        number = np.arange(len(course))
        columns = [np.ones(len(course)), *((number >= k).astype(float) for k in self.steps)]
        return np.column_stack([*columns, *([_from_begin(course)] if self.drift else [])])


def changes(course: Course, parameters: int) -> tuple[Change, ...]:
    """The changes of one of so many parameters, steps first; none where nothing shows one."""
    model, still_open = _Model(), None
    steps: dict[int, _Weights] = {}
    weights = _weights(course, model)
    while weights is not None and weights.total > np.log(_ODDS * parameters):
        shares, position = weights.shares, int(np.argmax(weights.positions))
        gradual = shares["drift"] + shares["wander"]
        if shares["step"] >= LEVEL:
            steps[position] = weights
            model = replace(model, steps=(*model.steps, position))
        elif gradual >= LEVEL and not model.drift:
            model = replace(model, drift=True)
        elif gradual >= LEVEL or shares["scatter"] >= LEVEL:
            model = replace(model, rest="wander" if gradual >= LEVEL else "scatter")
            break
        else:
            # The best step gives its size, whatever it is.
            still_open = position, weights
            model = replace(model, steps=(*model.steps, position))
            break
        weights = _weights(course, model)
    return _described(course, model, steps, still_open)


def _described(
    course: Course,
    model: _Model,
    steps: Mapping[int, _Weights],
    still_open: tuple[int, _Weights] | None,
) -> tuple[Change, ...]:
    if still_open is not None:
        model = replace(model, drift=False)  # no rate beside what is not understood
    sizes, halves, variance = _estimated(course, model)
    if model.drift and abs(sizes[-1]) <= halves[-1]:
        # It is no steady one, or the steps that were found after it explain it.
        model = replace(model, drift=False, rest="wander" if variance > 0.0 else model.rest)
        sizes, halves, variance = _estimated(course, model)
    described = []
    for i, position in enumerate(model.steps, 1):
        weights = steps[position] if position in steps else still_open[1] if still_open else None
        assert weights is not None
        after, before = _between(weights.positions)
        way: Way = "step" if position in steps else "open"
        described.append(Change(way, sizes[i], halves[i], after, before, position))
    last = len(course) - 1
    if model.drift:
        described.append(Change("drift", sizes[-1], halves[-1], 0, last))
    if model.rest is not None:
        described.append(Change(model.rest, float(np.sqrt(variance)), None, 0, last))
    return tuple(described)


def _from_begin(course: Course) -> Array:
    """(n,) the share of the time that has passed."""
    t = course.times - course.times[0]
    scaled: Array = t / t[-1]
    return scaled


def _wandering(course: Course) -> Array:
    t = _from_begin(course)
    K: Array = np.minimum.outer(t, t)
    return K


def _weights(course: Course, model: _Model) -> _Weights | None:
    """Likelihood ratios of one more change to a model; None where no value is left to show it."""
    X = model.columns(course) / course.sds[:, None]
    n, p = X.shape
    if n <= p:
        return None
    contrasts = np.linalg.qr(X, mode="complete")[0][:, p:]
    u = contrasts.T @ (course.values / course.sds)

    def of_columns(columns: Array) -> Array:
        """(k,) log ratios of effects that are columns (n, k)."""
        d = contrasts.T @ (columns / course.sds[:, None])
        squares = np.square(d).sum(axis=0)
        seen = squares > 1e-9 * np.square(columns / course.sds[:, None]).sum(axis=0)
        gain = np.square(u @ d) / np.where(seen, squares, 1.0)
        log = 0.5 * (gain[:, None] * (1.0 - 1.0 / _RATIOS) - np.log(_RATIOS))
        return np.where(seen, _log_mean(log), -np.inf)

    def of_covariance(C: Array) -> float:
        """Log ratio of an effect with a covariance (n, n), up to its size."""
        whitened = contrasts.T @ (C / np.outer(course.sds, course.sds)) @ contrasts
        values, vectors = np.linalg.eigh(whitened)
        ratios = 1.0 + np.outer(_RATIOS - 1.0, np.maximum(values, 0.0) / values.mean())
        squares = np.square(vectors.T @ u)
        log = 0.5 * (squares * (1.0 - 1.0 / ratios) - np.log(ratios)).sum(axis=1)
        return float(_log_mean(log))

    lower = np.tri(n, n, -1)[:, : n - 1]  # column k: a step before the calibration k + 1
    by_position = of_columns(lower)
    prior = np.full(n - 1, 1.0 / (n - 1))
    if course.events:
        # A step is as likely at one of the events as anywhere.
        prior *= 0.5
        prior[[k - 1 for k in course.events]] += 0.5 / len(course.events)
    positions = by_position + np.log(prior)
    drift = -np.inf if model.drift else float(of_columns(_from_begin(course)[:, None])[0])
    # A drift is steady or wanders, with the same probability.
    ways: dict[Way, float] = {
        "step": _log_sum(positions),
        "drift": drift - np.log(2.0),
        "wander": of_covariance(_wandering(course)) - (0.0 if model.drift else np.log(2.0)),
        "scatter": of_covariance(np.diag(np.square(course.sds))),
    }
    total = _log_sum(np.array([*ways.values()]))
    shares = {way: float(np.exp(log - total)) for way, log in ways.items()}
    within = np.concatenate([[0.0], np.exp(positions - _log_sum(positions))])
    return _Weights(total - float(np.log(3.0)), shares, within)


def _log_mean(log: Array) -> Array:
    top = log.max(axis=-1, keepdims=True)
    mean: Array = np.log(np.exp(log - top).mean(axis=-1)) + top[..., 0]
    return mean


def _log_sum(log: Array) -> float:
    top = float(log.max())
    return top if top == -np.inf else float(np.log(np.exp(log - top).sum())) + top


def _between(positions: Array) -> tuple[int, int]:
    """The calibrations before and after a step, with 95 %; positions: (n,) shares."""
    order = np.argsort(-positions)
    enough = int(np.searchsorted(np.cumsum(positions[order]), LEVEL)) + 1
    likely = order[:enough]
    return int(likely.min()) - 1, int(likely.max())


def _estimated(course: Course, model: _Model) -> tuple[list[float], list[float], float]:
    """The coefficients of the mean, halves of their 95 % intervals, and the variance of the rest:
    of the wander over all times, or of scatter over the stated one."""
    X, S = model.columns(course), np.diag(np.square(course.sds))
    freedom, variance, V = np.inf, 0.0, S
    # The interval of a rate holds for a drift that is not quite steady too.
    if model.rest == "wander" or (model.drift and model.rest is None):
        K = _wandering(course)
        variance = _walk(course, X, K)
        V = S + variance * K
    elif model.rest == "scatter":
        variance = _rest(S, X, course.values)[0] / max(len(course) - X.shape[1], 1)
        V = variance * S
    if variance > 0.0:
        freedom = max(float(len(course) - X.shape[1]), 1.0)
    L = np.linalg.cholesky(V)
    whitened = np.linalg.solve(L, np.column_stack([X, course.values]))
    beta = np.linalg.lstsq(whitened[:, :-1], whitened[:, -1], rcond=None)[0]
    covariance = np.linalg.pinv(whitened[:, :-1].T @ whitened[:, :-1])
    half = t_quantile(LEVEL, freedom) * np.sqrt(np.diag(covariance))
    return beta.tolist(), half.tolist(), variance


def walk_variance(course: Course, steps: Collection[int] = ()) -> float:
    """The variance by which a random walk with steps grows in a unit of time; 0 where nothing
    shows it. By restricted likelihood (Patterson and Thompson 1971)."""
    X = _Model(tuple(sorted(steps))).columns(course)
    K = np.minimum.outer(course.times, course.times) - course.times[0]
    return _walk(course, X, K)


def _walk(course: Course, X: Array, K: Array) -> float:
    S = np.diag(np.square(course.sds))
    scale = float(np.square(course.sds).mean()) / max(float(K[-1, -1]), 1e-12)
    rates = np.concatenate([[0.0], scale * 2.0**_GRID])
    criteria = []
    for q in rates:
        square, volume = _rest(S + q * K, X, course.values)
        criteria.append(square + volume)
    return float(rates[int(np.argmin(criteria))])


def _rest(V: Array, X: Array, y: Array) -> tuple[float, float]:
    """The weighted square of what a mean leaves, and the log volume of -2 log of the restricted
    likelihood."""
    L = np.linalg.cholesky(V)
    whitened = np.linalg.solve(L, np.column_stack([X, y]))
    Q, R = np.linalg.qr(whitened[:, :-1])
    rest = whitened[:, -1] - Q @ (Q.T @ whitened[:, -1])
    volume = 2.0 * float(np.log(np.diag(L)).sum() + np.log(np.abs(np.diag(R))).sum())
    return float(rest @ rest), volume


def events_before(days: Sequence[float], events: Sequence[float]) -> frozenset[int]:
    """The numbers of the calibrations on these days, rising, between which and the one before an
    event lies; of an event on the day of a calibration, which came first is not known."""
    return frozenset(
        k for k in range(1, len(days)) if any(days[k - 1] <= day <= days[k] for day in events)
    )
