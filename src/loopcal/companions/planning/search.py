"""The choice: greedy, then Fedorov's exchange, every candidate weighed at once.

Let C be the covariance in z, B (r, k) the rows of a candidate and S = I + B C B^T. Adding it leaves
C' = C - K K^T, K = C B^T S^-1/2 (Woodbury). Kept for every candidate are A = B C B^T and, for a
criterion tr(C G), Q = B C G C B^T; both follow C by products of the rows with K alone. Gains:

    D   log det(I + A) - log det(I + A_n),   n: of the nuisance parameters alone,
    I, A   tr[(I + A)^-1 Q],
    G   the fall of the largest variance over the test poses.

Fedorov (1972), Theory of Optimal Experiments; Miller and Nguyen (1994) for its exchange in turn.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.companions.planning.information import Information
from loopcal.execution.executor import Progress

Criterion = Literal["I", "G", "D", "A"]
_SUDDEN = 1e4
"""So large a fall of variance leaves A and Q without digits: they are computed anew."""
_SINGULAR = 1e-9
_BETTER = 1e-9
_PASSES = 20
"""Passes over the chosen poses, at most."""
_PROMISING = 1000
"""Candidates that are weighed at a time, where there are more than twice as many."""
_AT_ONCE = 5
_WORTH = 1e-3
"""Relative gain below which exchange among many ends: the certificate's bound is not closer."""
_SHORTLIST = 128
_PEAK = 8.0
"""The worst test poses weigh by this power of their variance in the shortlist of G."""
# A choice among few candidates takes milliseconds, and local optima are near: begun up to 20 times.
_EFFORT, _STARTS = 3e6, 20


class _System:
    """Covariance, A and Q of all candidates, as poses come and go."""

    def __init__(self, rows: Array, start: Array, aim: Array | None = None) -> None:
        self.rows, self.aim, self.total = rows, aim, start.copy()
        self.flat = rows.reshape(-1, rows.shape[2])
        self.refresh()

    def refresh(self) -> None:
        self.C = inverse(self.total)
        self.A = self._blocks(self.C)
        self.Q = None if self.aim is None else self._blocks(self.C @ self.aim @ self.C)

    def narrowed(self, some: NDArray[np.intp]) -> _System:
        """The same of some candidates alone."""
        less = copy(self)
        less.rows, less.A = self.rows[some], self.A[some]
        less.flat = less.rows.reshape(-1, self.rows.shape[2])
        less.Q = None if self.Q is None else self.Q[some]
        return less

    def _blocks(self, matrix: Array) -> Array:
        right = (self.flat @ matrix).reshape(self.rows.shape)
        return right @ self.rows.transpose(0, 2, 1)

    def change(self, some: Sequence[int], sign: float) -> None:
        """Add (sign 1) or remove (sign -1) candidates."""
        B = self.rows[list(some)].reshape(-1, self.rows.shape[2])
        self.total = self.total + sign * (B.T @ B)
        half = self.C @ B.T
        S = np.eye(len(B)) + sign * (B @ half)
        values, vectors = np.linalg.eigh(S)
        # Removing what alone determines a direction makes S singular: Woodbury has no digits left.
        if values.min() < _SINGULAR or values.max() > _SUDDEN:
            self.refresh()
            return
        # S^-1/2 from the eigenvectors of the test above: C' = C - sign K K^T.
        K = half @ vectors / np.sqrt(values)
        r = K.shape[1]
        N, rows_each = len(self.rows), self.rows.shape[1]
        if self.Q is None or self.aim is None:
            BK = (self.flat @ K).reshape(N, rows_each, r)
        else:
            V = self.C @ (self.aim @ K)
            both = (self.flat @ np.hstack([K, V])).reshape(N, rows_each, 2 * r)
            BK, BV = both[..., :r], both[..., r:]
            cross = BV @ BK.transpose(0, 2, 1)
            W = K.T @ (self.aim @ K)
            # Q' = B C' G C' B^T with C' = C - sign K K^T, multiplied out: terms of first and second
            # order in K.
            updated = self.Q - sign * (cross + cross.transpose(0, 2, 1))
            self.Q = updated + BK @ W @ BK.transpose(0, 2, 1)
        self.A = self.A - sign * (BK @ BK.transpose(0, 2, 1))
        self.C = self.C - sign * (K @ K.T)

    def log_gain(self) -> Array:
        """(N,) log det(I + A)."""
        gain: Array = np.linalg.slogdet(np.eye(self.A.shape[1]) + self.A)[1]
        return gain

    def linear_gain(self, Q: Array | None) -> Array:
        """(N,) tr[(I + A)^-1 Q]."""
        assert Q is not None
        solved = np.linalg.solve(np.eye(self.A.shape[1]) + self.A, Q)
        return np.asarray(np.trace(solved, axis1=1, axis2=2))


@dataclass(frozen=True)
class Chosen:
    """Positions of the chosen candidates and the criterion, the less the better."""

    poses: tuple[int, ...]
    value: float


class Search:
    """The state of a choice under one criterion, averaged over draws of the parameters."""

    def __init__(self, draws: Sequence[Information], criterion: Criterion) -> None:
        self.draws, self.criterion = draws, criterion
        self.systems = [_System(d.rows, d.start, linear_aim(d, criterion)) for d in draws]
        self.without: list[_System | None] = [
            _System(d.rows @ d.nuisance, d.nuisance.T @ d.start @ d.nuisance)
            if criterion == "D" and d.nuisance.shape[1]
            else None
            for d in draws
        ]
        self.chosen: list[int] = []

    def add(self, i: int) -> None:
        """Choose a candidate."""
        self._change([i], 1.0)
        self.chosen.append(i)

    def remove(self, i: int) -> None:
        """Let a chosen candidate go."""
        self._change([i], -1.0)
        self.chosen.remove(i)

    def copied(self) -> Search:
        """A second choice that begins as this one is."""
        same = copy(self)
        same.systems = [copy(system) for system in self.systems]
        same.without = [copy(system) for system in self.without]
        same.chosen = list(self.chosen)
        return same

    def narrowed(self, some: NDArray[np.intp]) -> Search:
        """The same choice among some candidates, those chosen included; positions are theirs."""
        less = copy(self)
        less.draws = [replace(draw, rows=draw.rows[some]) for draw in self.draws]
        less.systems = [system.narrowed(some) for system in self.systems]
        less.without = [s if s is None else s.narrowed(some) for s in self.without]
        less.chosen = np.searchsorted(some, self.chosen).tolist()
        return less

    def _change(self, some: Sequence[int], sign: float) -> None:
        for system in (*self.systems, *self.without):
            if system is not None and some:
                system.change(some, sign)

    def gains(self, also: int | None = None) -> Array:
        """(N,) by how much each candidate would lower the criterion; -inf for those chosen.

        also: a candidate that is weighed in any case; under G others may be left out.
        """
        if self.criterion == "D":
            parts = [
                system.log_gain() - (0.0 if less is None else less.log_gain())
                for system, less in zip(self.systems, self.without, strict=True)
            ]
        elif self.criterion == "G":
            parts = [
                _worst_gains(s, d, also) for s, d in zip(self.systems, self.draws, strict=True)
            ]
        else:
            parts = [system.linear_gain(system.Q) for system in self.systems]
        total: Array = np.mean(parts, axis=0)
        total[self.chosen] = -np.inf
        return total

    def become(self, chosen: Sequence[int]) -> None:
        """Choose these instead."""
        self._change([i for i in self.chosen if i not in chosen], -1.0)
        self._change([i for i in chosen if i not in self.chosen], 1.0)
        self.chosen = list(chosen)

    def promising(self) -> NDArray[np.intp]:
        """Ascending positions of those that promise most, and of those chosen."""
        gains = self.gains()
        most: NDArray[np.intp] = np.argpartition(-gains, _PROMISING)[:_PROMISING]
        return np.union1d(most, self.chosen).astype(np.intp)

    def scale(self) -> float:
        """Of the criterion, for relative changes."""
        if self.criterion == "D":
            return float(self.draws[0].root.shape[1])
        return self.value()

    def value(self) -> float:
        """The criterion of what is chosen."""
        values = [
            criterion_value(d, s.total, self.criterion)
            for d, s in zip(self.draws, self.systems, strict=True)
        ]
        return float(np.mean(values))


def linear_aim(draw: Information, criterion: Criterion) -> Array | None:
    """G (k, k) of a criterion tr(C G), None for one that has none."""
    if criterion in ("I", "G"):
        return draw.mean_test
    return draw.relative if criterion == "A" else None


def criterion_value(draw: Information, total: Array, criterion: Criterion) -> float:
    """The criterion of an information (k, k): a variance, or a log determinant."""
    if criterion == "D":
        V = draw.nuisance
        inner = np.linalg.slogdet(V.T @ total @ V)[1] if V.shape[1] else 0.0
        return float(inner - np.linalg.slogdet(total)[1])
    C = inverse(total)
    if criterion == "G":
        return float(test_variances(draw, C).max())
    aim = linear_aim(draw, criterion)
    assert aim is not None
    return float((C * aim).sum())


def test_variances(draw: Information, C: Array) -> Array:
    """(T,) variance of the end point at the test poses [SI]."""
    flat = draw.tests.reshape(-1, draw.tests.shape[2])
    each = np.einsum("ij,ij->i", flat @ C, flat)
    variances: Array = each.reshape(len(draw.tests), -1).sum(axis=1)
    return variances


def _worst_gains(system: _System, draw: Information, also: int | None) -> Array:
    """(N,) fall of the largest test variance; of those alone that promise most."""
    before = test_variances(draw, system.C)
    worst = float(before.max())
    N = len(system.rows)
    some = np.arange(N)
    if N > 2 * _SHORTLIST:
        # The max-norm of the variances by a p-norm, whose gradient is one linear criterion.
        weight = np.power(before / worst, _PEAK)
        pull = np.einsum("t,tok,tol->kl", weight, draw.tests, draw.tests, optimize=True)
        promised = system.linear_gain(system._blocks(system.C @ pull @ system.C))
        some = np.argpartition(-promised, _SHORTLIST)[:_SHORTLIST]
        some = some if also is None else np.union1d(some, [also])
    gains = np.full(N, -np.inf)
    half = system.C @ system.rows[some].transpose(0, 2, 1)
    S = np.eye(half.shape[2]) + system.A[some]
    flat = draw.tests.reshape(-1, draw.tests.shape[2])
    for at, h, s in zip(some, half, S, strict=True):
        seen = flat @ h
        fall = np.einsum("ij,ij->i", seen, np.linalg.solve(s, seen.T).T)
        after = before - fall.reshape(before.size, -1).sum(axis=1)
        gains[at] = worst - float(after.max())
    return gains


def choose(
    draws: Sequence[Information],
    number: int,
    criterion: Criterion,
    *,
    progress: Progress | None = None,
) -> Chosen:
    """The best `number` candidates that greedy choice and exchange find, in order of choice.

    Small problems are begun several times: the best end is kept.
    """
    size = draws[0].rows.size * len(draws)
    starts = int(np.clip(_EFFORT / max(size * number, 1), 1, _STARTS))
    rng = np.random.default_rng(0)
    many = len(draws[0].rows) > 2 * _PROMISING and criterion != "G"
    best: Chosen | None = None
    for start in range(starts):
        search, counter = Search(draws, criterion), _ProgressCounter(progress, number)
        if start:
            search.become(rng.permutation(len(draws[0].rows))[:number].tolist())
        elif many:
            _begun_among_many(search, number, counter)
        else:
            for _ in range(number):
                search.add(int(np.argmax(search.gains())))
                counter.chose()
        search = (_exchanged_among_many if many else _exchanged)(search, counter)
        chosen = Chosen(tuple(search.chosen), search.value())
        if best is None or chosen.value < best.value:
            best = chosen
    assert best is not None
    return best


@dataclass
class _ProgressCounter:
    """Counts the poses chosen or tried for exchange, and reports them."""

    progress: Progress | None
    number: int
    chosen: int = 0
    tried: int = 0

    def chose(self) -> None:
        """One more pose was chosen."""
        self.chosen += 1
        if self.progress is not None:
            self.progress(self.chosen, self.number)

    def exchanged(self) -> None:
        """One more pose was tried for exchange."""
        self.tried += 1
        if self.progress is not None:
            passes = 2 + self.tried // self.number
            self.progress(self.number + self.tried, self.number * passes)


def _begun_among_many(search: Search, number: int, counter: _ProgressCounter) -> None:
    """Greedy choice, some poses at a time among the candidates that promise most."""
    while len(search.chosen) < number:
        some = search.promising()
        less = search.narrowed(some)
        for _ in range(min(_AT_ONCE, number - len(search.chosen))):
            less.add(int(np.argmax(less.gains())))
            counter.chose()
        search.become(some[less.chosen].tolist())


def _exchanged_among_many(search: Search, counter: _ProgressCounter) -> Search:
    """Exchange among the candidates that promise most, chosen anew until that gains little."""
    for _ in range(_PASSES):
        value, some = search.value(), search.promising()
        less = _exchanged(search.narrowed(some), counter, _WORTH * search.scale())
        search.become(some[less.chosen].tolist())
        if value - search.value() <= _WORTH * search.scale():
            break
    return search


def _exchanged(search: Search, counter: _ProgressCounter, least: float = 0.0) -> Search:
    """Exchange each chosen pose in turn for the best candidate, until a pass exchanges none or
    gains no more than the least."""
    for _ in range(_PASSES):
        before = search
        search = _passed(search, counter)
        if search is before or before.value() - search.value() <= least:
            break
    return search


def _passed(search: Search, counter: _ProgressCounter) -> Search:
    """Each chosen pose exchanged for the best candidate, if that is better."""
    for old in list(search.chosen):
        without = search.copied()
        without.remove(old)
        gains = without.gains(old)
        new, kept = int(np.argmax(gains)), float(gains[old])
        if new != old and gains[new] > kept + _BETTER * abs(kept):
            without.add(new)
            search = without
        counter.exchanged()
    return search


def inverse(matrix: Array) -> Array:
    """Of a symmetric positive definite matrix, scaled first."""
    scale = 1.0 / np.sqrt(np.diag(matrix))
    inverted: Array = np.linalg.inv(matrix * scale * scale[:, None]) * scale * scale[:, None]
    return 0.5 * (inverted + inverted.T)
