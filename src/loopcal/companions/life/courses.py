"""What a machine did over its calibrations: nothing, a step, a drift, or scatter beyond its sds.

A calibration at the time t says p_t = p + v g_t + e, e ~ N(0, C_t): C_t the joint covariance of the
parameters, v (n, d) what one cause changes, such as the zero of a joint. Whitened, all calibrations
are y = X b + D g + N(0, 1): X b the mean with the accepted changes, D g the effect of one more. A
way to change is a covariance of g, up to its size: of a step h h^T with h = 1 from one calibration
on; of a steady drift t t^T; of a wandering one min(t_i, t_j) - t_1; of scatter the variances of g
by the single calibrations. The restricted likelihood ratio of each to no change is averaged over
sizes, over the positions of the step, over the ways and over the causes. Without a change its
expectation is 1, so that it exceeds 20 with a probability of at most 1 / 20 (Ville 1939; Vovk and
Wang 2021): 5 % of machines that do not change are called changed, whatever number and correlation
their parameters have. Shares of the average are the probabilities of ways, positions and causes.
All ways are as likely beforehand, and so are zeros of joints together and all else.

Calibrations that chose other terms of the model error differ by an offset of each choice, which is
no change. No change is so a mixture: nothing, or such offsets along one cause, as likely. The
average of the changes is compared with 20 times that of the mixture, so the bound holds for both.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array, span
from loopcal.lazy import cached_property
from loopcal.small_samples import t_quantile

LEVEL = 0.95
"""Of intervals, of the way and the causes that are named, and of the calibrations at a step."""
# By the false alarms above: 1 / (1 - LEVEL).
_ODDS = 20.0
# From changes of twice their own sd to those of a thousand sds; larger ones need no finer prior.
_RATIOS = 4.0 ** np.arange(1, 11)
"""Variance with a change over that without, for which the likelihood is averaged."""
# Powers of two, four to an octave: from a drift that no readings show to one that hides them all.
_GRID = 2.0 ** np.linspace(-16.0, 20.0, 145)
# Squares of double precision keep it; columns are scaled first.
_UNSEEN = 1e-9
"""Share of its square that the mean leaves of an effect, below which nothing shows it."""
_SINGULAR = 1e-12
"""Eigenvalue of a correlation below which it is rounding."""
# Chosen, not derived: more than a user follows up.
_MOST = 16
"""Changes of one machine, and causes along which models differ."""
Way = Literal["step", "drift", "wander", "scatter", "open"]
_MODEL: Literal["model"] = "model"
"""No change: with other terms of the model error a calibration moves its parameters."""
_GRADUAL: tuple[Way, ...] = ("drift", "wander")
_HALF = float(np.log(2.0))


@dataclass(frozen=True, eq=False)
class Cause:
    """unit: [SI] of its parts; directions: (n, d) what these change of the parameters; often:
    whether it is the zero of a joint, as machines are mastered more often than bent; together:
    whether it stands for all that no single cause does, and its scatter for that of all values."""

    name: str
    unit: str
    directions: Array
    often: bool = False
    together: bool = False


@dataclass(frozen=True, eq=False)
class Said:
    """What one calibration says of n parameters: values = rows p + N(0, 1), (r,) and (r, n)."""

    values: Array
    rows: Array

    @classmethod
    def of(cls, values: Array, covariance: Array, at: NDArray[np.intp], size: int) -> Said:
        """Of those `at` these positions; nothing of the others, and of what rounding hides."""
        sd = np.sqrt(np.diag(covariance))
        w, U = np.linalg.eigh(covariance / np.outer(sd, sd))
        kept = w > _SINGULAR * w.max(initial=0.0)
        root = (U[:, kept] / np.sqrt(w[kept])).T / sd
        rows = np.zeros((len(root), size))
        rows[:, at] = root
        return cls(root @ values, rows)


@dataclass(frozen=True, eq=False)
class Course:
    """times: (k,) rising, in any unit; said: by k calibrations; events: the numbers of the
    calibrations from 0 before which something happened; models: a number for the terms that each
    calibration chose, none where all chose the same."""

    times: Array
    said: tuple[Said, ...]
    causes: tuple[Cause, ...]
    events: frozenset[int] = frozenset()
    models: tuple[int, ...] = ()

    @classmethod
    def of_one(
        cls, times: Array, values: Array, sds: Array, events: Collection[int] = ()
    ) -> Course:
        """Of one parameter, (k,)."""
        said = tuple(Said(np.array([v]), np.eye(1)) for v in values / sds)
        said = tuple(replace(one, rows=one.rows / s) for one, s in zip(said, sds, strict=True))
        return cls(times, said, (Cause("", "", np.eye(1)),), frozenset(events))

    def __len__(self) -> int:
        return len(self.said)

    @cached_property
    def y(self) -> Array:
        """(N,) all values."""
        return np.concatenate([one.values for one in self.said])

    def columns(self, shape: Array, directions: Array) -> Array:
        """(N, r d) of effects along directions (n, d) that go over the calibrations as (k, r)."""
        each = zip(self.said, shape, strict=True)
        return np.vstack([np.kron(over[None], one.rows @ directions) for one, over in each])

    @cached_property
    def passed(self) -> Array:
        """(k,) the share of the time."""
        t = self.times - self.times[0]
        scaled: Array = t / t[-1]
        return scaled

    @cached_property
    def chosen(self) -> Array:
        """(k, g) which of g models each calibration has; none where all have the same."""
        every = sorted({*self.models})
        return np.array(
            [[float(one == m) for m in every[len(every) == 1 :]] for one in self.models]
        )

    @cached_property
    def walk(self) -> Array:
        """(k, k - 1) a root of min(t_i, t_j)."""
        t = self.passed
        return np.asarray(np.tri(len(t), len(t) - 1, -1) * np.sqrt(np.diff(t)))


@dataclass(frozen=True, eq=False)
class Change:
    """way: "open" where a step and other ways are as likely; causes: the numbers of those that
    explain it with 95 %, the likeliest first. parts: (d,) of a step, or of a drift over all times,
    along each direction of the first cause; of wandering their sds over all times; of scatter the
    sd over the stated one. covariance: (d, d) of parts, of wandering that of the change; None of
    scatter; freedom: degrees of freedom of it. after, before: the calibrations between which a step
    lies with 95 %; at: the likeliest place, before this one; None without a step."""

    way: Way
    causes: tuple[int, ...]
    parts: Array
    covariance: Array | None
    freedom: float
    after: int
    before: int
    at: int | None = None

    @property
    def size(self) -> float:
        """The change of one part; the length of several."""
        return float(self.parts[0] if len(self.parts) == 1 else np.linalg.norm(self.parts))

    @property
    def half(self) -> float | None:
        """Of the 95 % interval of the size; None for sds."""
        if self.covariance is None or self.way == "wander":
            return None
        along = self.parts / max(abs(self.size), 1e-300)
        sd = float(np.sqrt(along @ self.covariance @ along))
        return float(t_quantile(LEVEL, self.freedom) * sd)

    @property
    def square(self) -> Array:
        """(d, d) the product of the parts, of wandering its expectation."""
        wanders = self.way == "wander" and self.covariance is not None
        return np.asarray(self.covariance if wanders else np.outer(self.parts, self.parts))


@dataclass(frozen=True, eq=False)
class _Accepted:
    """One change of the mean."""

    way: Way | Literal["model"]
    causes: tuple[int, ...]
    after: int = 0
    before: int = 0
    at: int | None = None

    @property
    def free(self) -> bool:
        """Whether each calibration may differ: what then varies says nothing."""
        return self.way in ("wander", "scatter")

    def columns(self, course: Course) -> Array:
        number = np.arange(len(course))
        shape = course.passed if self.at is None else (number >= self.at).astype(float)
        over = np.eye(len(course)) if self.free else shape[:, None]
        over = course.chosen if self.way == _MODEL else over
        return course.columns(over, course.causes[self.causes[0]].directions)


def changes(course: Course) -> tuple[Change, ...]:
    """The changes of a machine, steps first; none where nothing shows one."""
    accepted: list[_Accepted] = []
    while len(accepted) < _MOST:
        weights = _weights(course, accepted)
        if weights is None:
            break
        if weights.total - weights.unchanged > np.log(_ODDS):
            accepted.append(weights.accepted)
        elif weights.unchanged > np.log(_ODDS):
            accepted.append(_Accepted(_MODEL, (int(np.argmax(weights.models)),)))
        else:
            break
        if accepted[-1].way == "open":
            break
    described = (_described(course, accepted, i) for i in range(len(accepted)))
    seen = [one for one in described if one is not None]
    return tuple(sorted(seen, key=lambda one: one.at is None))


@dataclass(frozen=True, eq=False)
class _Left:
    """What the mean leaves: an orthonormal basis (N, p) of it and the rest of y."""

    basis: Array
    rest: Array

    @classmethod
    def of(cls, course: Course, accepted: Sequence[_Accepted]) -> _Left:
        n = course.said[0].rows.shape[1]
        mean = course.columns(np.ones((len(course), 1)), np.eye(n))
        X = np.hstack([mean, *(one.columns(course) for one in accepted)])
        basis = span(X, 1e-10)
        return cls(basis, course.y - basis @ (basis.T @ course.y))

    @property
    def square(self) -> tuple[float, int]:
        """Of the rest, with its degrees of freedom."""
        return float(self.rest @ self.rest), len(self.rest) - self.basis.shape[1]

    def of_cause(self, course: Course, cause: Cause) -> _Seen:
        D = course.columns(np.eye(len(course)), cause.directions)
        left = D - self.basis @ (self.basis.T @ D)
        d = cause.directions.shape[1]
        return _Seen(left.T @ left, left.T @ self.rest, D.T @ D, d)


@dataclass(frozen=True, eq=False)
class _Seen:
    """Of one cause, of d parts at k calibrations (k d each): what the mean leaves of its
    information, its score, and the information with a known mean."""

    information: Array
    score: Array
    whole: Array
    d: int

    @cached_property
    def by_calibration(self) -> Array:
        """(k, d, d) the information with a known mean."""
        k = len(self.whole) // self.d
        return np.asarray(np.einsum("iaib->iab", self.whole.reshape(k, self.d, k, self.d)))

    @cached_property
    def part(self) -> Array:
        """(d, d) a root of a covariance by which parts are as likely to change as they are
        unsure."""
        return _inverse_root(self.by_calibration.mean(axis=0))

    @cached_property
    def scattering(self) -> Array:
        """(k d, k d) a root of the covariance of the parts by single calibrations."""
        k = len(self.by_calibration)
        scattering = np.zeros((k, self.d, k, self.d))
        scattering[range(k), :, range(k)] = [_inverse_root(one) for one in self.by_calibration]
        return scattering.reshape(k * self.d, k * self.d)

    def spectrum(self, root: Array) -> tuple[Array, Array]:
        """Of g = root N(0, 1): the information along its axes, and the squares there."""
        G, whole = root.T @ self.information @ root, root.T @ self.whole @ root
        values, axes = np.linalg.eigh(G)
        seen = values > _UNSEEN * np.trace(whole)
        squares = np.square(axes[:, seen].T @ (root.T @ self.score)) / values[seen]
        return values[seen], squares

    def log_ratio(self, root: Array) -> float:
        """Of an effect with this root (k d, m), up to its size."""
        values, squares = self.spectrum(root)
        if not len(values):
            return -np.inf
        ratios = 1.0 + np.outer(_RATIOS - 1.0, values / values.mean())
        return _averaged(0.5 * (squares * (1.0 - 1.0 / ratios) - np.log(ratios)).sum(axis=1))

    def log_ratios(self, shapes: Array) -> Array:
        """(m,) of effects whose parts go over the calibrations as (k, m)."""
        if self.d > 1:
            return np.array([self.log_ratio(_kron(h[:, None], self.part)) for h in shapes.T])
        left, whole = (
            np.einsum("km,kl,lm->m", shapes, A, shapes) for A in (self.information, self.whole)
        )
        seen = left > _UNSEEN * whole
        gain = np.square(shapes.T @ self.score) / np.where(seen, left, 1.0)
        log = 0.5 * (gain[:, None] * (1.0 - 1.0 / _RATIOS) - np.log(_RATIOS))
        top = log.max(axis=1)
        mean = top + np.log(np.exp(log - top[:, None]).mean(axis=1))
        return np.where(seen, mean, -np.inf)


@dataclass(frozen=True, eq=False)
class _Weights:
    """Log of the averaged likelihood ratio; shares by way (c,) of each cause, of a step (c, k - 1)
    of each cause and position; models: (c,) log ratios of what other models do along each cause.
    """

    total: float
    shares: Mapping[Way, Array]
    models: Array

    @property
    def unchanged(self) -> float:
        """Log of that of no change, half of which is that of other models."""
        return _log_sum(np.array([0.0, _log_sum(self.models)])) - _HALF

    @property
    def accepted(self) -> _Accepted:
        """The way that is shown, with its place and its causes."""
        by_way = {way: float(share.sum()) for way, share in self.shares.items()}
        positions, last = self.shares["step"], self.shares["step"].shape[1]
        gradual = sum(by_way[way] for way in _GRADUAL)
        if by_way["step"] >= LEVEL:
            way: Way = "step"
        elif max(gradual, by_way["scatter"]) >= LEVEL:
            # What is not quite steady is a drift as well, unless that is accepted already.
            way = "scatter" if gradual < LEVEL else "drift" if by_way["drift"] > 0.0 else "wander"
        else:
            # The best step gives its size, whatever it is.
            every = np.sum([s for w, s in self.shares.items() if w != "step"], axis=0)
            causes = _likely(every + positions.sum(axis=1))
            place = positions[causes[0]] if positions[causes[0]].any() else positions.sum(axis=0)
            return _Accepted("open", causes, *_between(place), int(np.argmax(place)) + 1)
        if way != "step":
            every = self.shares[way] + (self.shares["wander"] if way == "drift" else 0.0)
            return _Accepted(way, _likely(every), 0, last)
        place = positions.sum(axis=0)
        at = int(np.argmax(place)) + 1
        return _Accepted("step", _likely(positions.sum(axis=1)), *_between(place), at)


def _weights(course: Course, accepted: Sequence[_Accepted]) -> _Weights | None:
    """Likelihood ratios of one more change; None where no value is left to show it."""
    left, k = _Left.of(course, accepted), len(course)
    if len(left.rest) <= left.basis.shape[1]:
        return None
    steps = np.tri(k, k, -1)[:, : k - 1]  # column j: a step before the calibration j + 1
    positions = np.full(k - 1, 1.0 / (k - 1))
    if course.events:
        # A step is as likely at one of the events as anywhere.
        positions *= 0.5
        positions[[j - 1 for j in course.events]] += 0.5 / len(course.events)
    often = np.array([cause.often for cause in course.causes])
    prior = np.where(often, 1.0 / max(often.sum(), 1), 1.0 / max((~often).sum(), 1))
    prior /= prior.sum()
    logs: dict[Way, list[Array]] = {"step": [], "drift": [], "wander": [], "scatter": []}
    models = np.full(len(course.causes), -np.inf)
    for i, cause in enumerate(course.causes):
        seen = left.of_cause(course, cause)
        if course.chosen.size:
            models[i] = seen.log_ratio(_kron(course.chosen, seen.part))
        drifts = any(one.way == "drift" and i in one.causes for one in accepted)
        steps_log, drift = seen.log_ratios(steps) + np.log(positions), -np.inf
        if not drifts:
            drift = float(seen.log_ratios(course.passed[:, None])[0])
        if cause.together:
            square, freedom = left.square
            wander = -np.inf
            scatter = _averaged(0.5 * (square * (1.0 - 1.0 / _RATIOS) - freedom * np.log(_RATIOS)))
        else:
            wander = seen.log_ratio(_kron(course.walk, seen.part))
            scatter = seen.log_ratio(seen.scattering)
            # A drift is steady or wanders, with the same probability.
            drift, wander = drift - _HALF, wander - (0.0 if drifts else _HALF)
        each: dict[Way, Array | float] = {"step": steps_log, "drift": drift}
        each |= {"wander": wander, "scatter": scatter}
        for way, log in each.items():
            logs[way].append(np.asarray(log))
    weighed = {
        way: np.array(log) + np.log(prior)[(..., *[None] * log[0].ndim)]
        for way, log in logs.items()
    }
    total = _log_sum(np.concatenate([one.ravel() for one in weighed.values()]))
    if total == -np.inf:
        return None
    shares = {way: np.exp(log - total) for way, log in weighed.items()}
    return _Weights(total - float(np.log(3.0)), shares, models + np.log(prior))


def _averaged(log: Array) -> float:
    return _log_sum(log) - float(np.log(len(log)))


def _kron(over: Array, part: Array) -> Array:
    return np.asarray(np.kron(over, part), dtype=float)


def _inverse_root(A: Array) -> Array:
    """B with B B^T the inverse of A (d, d), zero along what A does not show."""
    w, U = np.linalg.eigh(A)
    kept = w > _SINGULAR * max(float(w.max(initial=0.0)), 1e-300)
    return np.asarray((U * np.where(kept, 1.0 / np.sqrt(np.where(kept, w, 1.0)), 0.0)) @ U.T)


def _log_sum(log: Array) -> float:
    top = float(log.max())
    return top if top == -np.inf else float(np.log(np.exp(log - top).sum())) + top


def _likely(shares: Array) -> tuple[int, ...]:
    """The fewest with 95 % of all, the likeliest first."""
    order = np.argsort(-shares, kind="stable")
    enough = int(np.searchsorted(np.cumsum(shares[order]), LEVEL * shares.sum())) + 1
    return tuple(order[:enough].tolist())


def _between(positions: Array) -> tuple[int, int]:
    """The calibrations before and after a step, with 95 %; positions: (k - 1,) shares."""
    likely = _likely(positions)
    return min(likely), max(likely) + 1


def _described(course: Course, accepted: Sequence[_Accepted], i: int) -> Change | None:
    """One change beside the others; None for a drift that they explain, and where only the model is
    another."""
    one = accepted[i]
    if one.way == _MODEL:
        return None
    cause, span = course.causes[one.causes[0]], (one.after, one.before, one.at)
    others = [other for j, other in enumerate(accepted) if j != i]
    free = [other.way for other in others if other.free and other.causes[0] == one.causes[0]]
    # What varies along the same cause makes the change unsure, and does not hide it.
    others = [other for other in others if not other.free or other.causes[0] != one.causes[0]]
    left = _Left.of(course, others)
    seen = left.of_cause(course, cause)
    if one.way == "scatter":
        values, squares = seen.spectrum(seen.scattering)
        square, number = left.square if cause.together else (float(squares.sum()), len(values))
        size = np.array([np.sqrt(square / max(number, 1))])
        return Change(one.way, one.causes, size, None, np.inf, *span)
    if one.way == "wander":
        return _wandering(course, one, seen)
    variance, d = 0.0, seen.d
    root = seen.scattering if "scatter" in free else _kron(course.walk, np.eye(d))
    if one.way == "drift" or free:
        # The interval of a rate holds for a drift that is not quite steady too.
        variance = _variance(_Left.of(course, [*others, one]).of_cause(course, cause), root)
    columns, effect = one.columns(course), course.columns(np.eye(len(course)), cause.directions)
    columns = columns - left.basis @ (left.basis.T @ columns)
    effect = effect @ root * np.sqrt(variance)
    effect = effect - left.basis @ (left.basis.T @ effect)
    S = np.linalg.inv(np.eye(effect.shape[1]) + effect.T @ effect)
    weighed = columns - effect @ (S @ (effect.T @ columns))
    covariance = np.linalg.pinv(columns.T @ weighed, rcond=1e-13, hermitian=True)
    freedom = np.inf if variance == 0.0 else max(len(course) - 2.0, 1.0)
    parts = covariance @ (weighed.T @ left.rest)
    change = Change(one.way, one.causes, parts, covariance, freedom, *span)
    if one.way == "drift" and d == 1 and abs(change.size) <= (change.half or 0.0):
        # It is no steady one, or the steps that were found after it explain it.
        return _wandering(course, one, seen) if variance > 0.0 and "wander" not in free else None
    return change


def _wandering(course: Course, one: _Accepted, seen: _Seen) -> Change:
    variance = _variance(seen, _kron(course.walk, seen.part))
    covariance = variance * seen.part @ seen.part.T
    sds = np.sqrt(np.diag(covariance))
    return Change("wander", one.causes, sds, covariance, np.inf, one.after, one.before)


def _variance(seen: _Seen, root: Array) -> float:
    """By which an effect of this root varies; 0 where nothing shows it. By restricted likelihood
    (Patterson and Thompson 1971)."""
    values, squares = seen.spectrum(root)
    if not len(values):
        return 0.0
    sizes = np.concatenate([[0.0], _GRID]) / values.mean()
    ratios = 1.0 + np.outer(sizes, values)
    criteria = (np.log(ratios) + squares / ratios).sum(axis=1)
    return float(sizes[int(np.argmin(criteria))])


def walk_variance(course: Course, steps: Collection[int] = ()) -> float:
    """The variance by which a random walk of one parameter, with steps, grows in a unit of time; 0
    where nothing shows it."""
    accepted = [_Accepted("step", (0,), k - 1, k, k) for k in sorted(steps)]
    seen = _Left.of(course, accepted).of_cause(course, course.causes[0])
    return _variance(seen, course.walk) / float(course.times[-1] - course.times[0])


def events_before(days: Sequence[float], events: Sequence[float]) -> frozenset[int]:
    """The numbers of the calibrations on these days, rising, between which and the one before an
    event lies; of an event on the day of a calibration, which came first is not known."""
    return frozenset(
        k for k in range(1, len(days)) if any(days[k - 1] <= day <= days[k] for day in events)
    )
