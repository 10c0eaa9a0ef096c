"""Which joint's zero, or which parameter, changed since a calibration?

With S = 1 + A A^T the covariance of the whitened misclosures e at the held machine (`innovation`),
and u_j the column of candidate j, both less what the placement takes up, a change t_j is estimated
by generalised least squares,

    t = G^-1 g,   G = U^T S^-1 U,   g = U^T S^-1 e,

and tested by the likelihood ratio, z_j^2 = t_j^2 / (G^-1)_jj: chi-squared with one degree of
freedom, F where sds were learnt. The machine's own uncertainty, its learnt model error included, is
in S. The p-values are Holm's (1979) for as many candidates as the poses distinguish. The most
significant change is accepted, the equations are linearised there again, and the search goes on
with it free (forward selection) until nothing is significant. Where the misfit is gross and stays
so, the search ends with the change that lowers it by less than a tenth, and changes are named only
where together they leave less than a tenth of it.

Where the machine has an error that its model does not hold (learnt terms, or sds that chi-squared
rejected), misclosures may be larger elsewhere than the calibration says. Their variance is then
also taken from these poses: S is multiplied by what all candidates together leave of the innovation
over its degrees of freedom, where that is above 1. The test of the whole is that of all candidates
together by F: an error that no change of the machine explains is none.

Candidate k is reported as not distinguishable from an accepted j where, with k in its place, adding
j is not significant. A change is seen with probability P from (q + z_P) / sqrt(G_jj) on, q the
two-sided critical value of the smallest p-value.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import NoTrustworthyResult
from loopcal.small_samples import f_tail, t_quantile
from loopcal.statistics.another_day import Day
from loopcal.statistics.changed import LEVEL, POWER, Candidate, Change, WhatChanged
from loopcal.statistics.estimated import Estimated
from loopcal.statistics.innovation import Innovation, Linearised
from loopcal.statistics.possible_changes import BETWEEN_DAYS, possible, unit_of
from loopcal.statistics.replacing import ASTRAY, Replaced

Array = NDArray[np.float64]
# Record 0053.
_MOST = 3
"""Changes that are sought; with more the machine is calibrated anew."""
# Chosen, not derived: a cap, and a step that changes no p-value.
_ROUNDS, _SETTLED = 8, 1e-3
"""Linearisations of accepted changes, and the step [sds] that ends them."""
# Chosen, not derived: each candidate costs linearisations; the likeliest come first.
_TRIED = 3
# Chosen, not derived: a candidate that does not halve it is not the cause.
_HALVED = 0.5
"""What a linearisation leaves of the misfit, for the next one of a candidate that is compared."""
# Chosen, not derived: what helps less may be chance. `analyses.what_changed` counts what is named.
_HELPED, _EXPLAINED = 0.9, 0.1
"""What one change, and all together, leave at most of a misfit that stays gross."""
# Chosen, not derived: a variance from fewer is unsure by more than its half.
_ENOUGH = 5
"""Degrees of freedom from which the poses show their own variance."""
# A change of 1000 sds would show as one sd. Chosen, not derived.
_VISIBLE = 1e-6
"""Share of a column that the placement leaves, below which these poses do not show the change."""
# Chosen, not derived: far above rounding, far below two columns that differ.
_SAME = 1e-6
"""1 - |correlation| of two columns that are one."""
# Chosen, not derived: a few thousand times the rounding of a unit column.
_ROUNDING = 1e-12
"""Information along a direction of columns of length 1 that is rounding."""


def what_changed(day: Day, linear: Linearised) -> WhatChanged | None:
    """Search for changes; None where these poses have no redundancy.

    linear: the machine as calibrated, at these poses.
    """
    if linear.innovation().p_value is None:
        return None
    candidates = _candidates(linear.placement)
    begun = system = _System.of(day, candidates, linear, np.zeros(len(candidates)))
    chosen: tuple[int, ...] = ()
    p_values: dict[int, float] = {}
    for _ in range(_MOST):
        tests = system.tests(chosen)
        if not tests or min(tests.values()) >= LEVEL:
            break
        several = [(*chosen, j) for j in system.tried([*tests], chosen)]
        fits = [(one, system.settled(one, _HALVED)) for one in several]
        best, trial = min(fits, key=lambda fit: fit[1].present)
        if trial.astray and trial.present > _HELPED * system.present:
            break
        chosen, system = best, trial.settled(best)
        p_values[chosen[-1]] = tests[chosen[-1]]
        if kept := system.kept(chosen):
            chosen, system = kept, system.settled(kept)
    if system.astray and system.present > _EXPLAINED * begun.present:
        chosen, system = (), begun
    whole, left = begun.innovation(()), system.innovation(chosen).p_value
    changes = system.changes(chosen, [p_values[j] for j in chosen])
    verdict = _verdict(whole.p_value, changes, left)
    return WhatChanged(verdict, changes, begun.tested(), whole, begun.scale, left)


def _verdict(p_value: float | None, changes: Sequence[Change], left: float | None) -> str:
    if not changes and (p_value is None or p_value >= LEVEL):
        return "unchanged"
    explained = left is None or left >= LEVEL
    if changes and explained and all(change.zeros for change in changes):
        return "re-master"
    return "calibrate-anew"


def _candidates(placement: Replaced) -> tuple[Candidate, ...]:
    """What may have changed of all that is held."""
    problem = placement.problem
    anew = dict(zip(problem.mechanism.parameters.names, placement.anew, strict=True))
    return tuple(
        Candidate(name, one.kind, unit_of(problem, name))
        for one in possible(problem, BETWEEN_DAYS)
        for name in one.names
        if not anew.get(name)
    )


@dataclass(frozen=True, eq=False)
class _System:
    """The tests of m candidates at some changes t (m,): G (m, m), g (m,) as if nothing had changed.

    present: the innovation at t; value: that as if nothing had changed; visible: (m,); group: (m,)
    the first candidate with the same column; freedom: (m,) degrees of freedom of the variance of
    each change; linear: the equations at t; every: all candidates together; scale: of S, by these
    poses; scale_freedom: its degrees of freedom, None where the stated variances are taken.
    """

    day: Day
    candidates: tuple[Candidate, ...]
    G: Array
    g: Array
    t: Array
    present: float
    value: float
    visible: NDArray[np.bool_]
    group: NDArray[np.intp]
    freedom: Array
    linear: Linearised
    every: Estimated
    scale: float
    scale_freedom: float | None

    @classmethod
    def of(
        cls, day: Day, candidates: tuple[Candidate, ...], linear: Linearised, t: Array
    ) -> _System:
        """The tests where the machine has changed by t."""
        names = [one.name for one in candidates]
        raw = linear.placement.columns(names) / np.sqrt(linear.factor)
        U = raw - linear.F @ (linear.solve @ raw)
        visible = np.linalg.norm(U, axis=0) > _VISIBLE * np.linalg.norm(raw, axis=0)
        G, g = linear.weighed(U, U), linear.weighed(U, linear.left)
        if not (np.isfinite(G).all() and np.isfinite(g).all()):
            raise NoTrustworthyResult(
                "the readings are so far from the machine that no change can be estimated",
                code="not-verified",
                remedy="check that they belong to this machine, and their columns and units",
            )
        visible &= np.diag(G) > 0.0
        present = float(linear.weighed(linear.left, linear.left))
        # With e = e_0 - U t: |e_0|^2 = |e|^2 + 2 t^T g + t^T G t in the metric S^-1, g_0 = g + G t.
        value = present + float(t @ (2.0 * g + G @ t))
        g = g + G @ t
        scale = np.sqrt(np.where(visible, np.diag(G), 1.0))
        alike = G / scale / scale[:, None]
        same = np.abs(alike) > 1.0 - _SAME
        same[~visible], same[:, ~visible] = False, False
        np.fill_diagonal(same, True)
        group, freedom = same.argmax(axis=0), linear.freedom(raw)
        heads = np.unique(group[visible])
        ones = np.ones(len(heads))
        every = Estimated.of((g / scale)[heads], alike[np.ix_(heads, heads)], ones, _SAME)
        wider, wider_freedom = 1.0, None
        left = len(linear.e) - linear.rank - every.rank
        if (day.calibrated.carried or day.calibrated.rejected is not None) and left >= _ENOUGH:
            wider = max((value - every.gain) / left, 1.0)
            learnt = linear.denominator((U / scale)[:, heads] @ every.root) or np.inf
            # Relative variances 2 / nu of independent errors of a scale add up.
            wider_freedom = 1.0 / (1.0 / left + 1.0 / learnt)
            freedom = 1.0 / (1.0 / freedom + 1.0 / left)
        held = G, g, t, present, value, visible, group, freedom, linear, every
        return cls(day, candidates, *held, wider, wider_freedom)

    def estimated(self, chosen: Sequence[int]) -> Estimated:
        """The changes of these candidates together."""
        rows = list(chosen)
        G, g = self.G[np.ix_(rows, rows)], self.g[rows]
        length = np.sqrt(np.diag(G))
        scale = 1.0 / np.where(length > 0.0, length, 1.0)
        return Estimated.of(scale * g, G * np.outer(scale, scale), scale, _ROUNDING)

    def innovation(self, chosen: Sequence[int]) -> Innovation:
        """The innovation after these changes."""
        explained = self.estimated(chosen).gain
        if self.scale_freedom is not None:
            value = max((self.every.gain - explained) / self.scale, 0.0)
            return Innovation.of(value, self.every.rank - len(chosen), self.scale_freedom)
        total = self.linear.innovation().value
        return self.linear.innovation(total - self.value + explained, len(chosen))

    @property
    def astray(self) -> bool:
        """Whether the misfit is gross."""
        return self.present > ASTRAY * len(self.linear.e)

    def critical(self, i: int) -> float:
        """Of the most significant of all candidates [sds]."""
        groups = len(np.unique(self.group[self.visible]))
        return t_quantile(1.0 - LEVEL / max(groups, 1), self.freedom[i])

    def tests(self, chosen: Sequence[int]) -> dict[int, float]:
        """Adjusted p-values of the further candidates beside those that were accepted, one for each
        group, the most significant first."""
        G, g, rows = self.G, self.g, list(chosen)
        heads = [i for i in np.unique(self.group[self.visible]).tolist() if i not in rows]
        X = self.estimated(chosen).covariance @ G[rows]
        left = np.diag(G) - (G[:, rows] * X.T).sum(axis=1)
        seen = [i for i in heads if left[i] > _VISIBLE * G[i, i]]
        score = g - g[rows] @ X
        squares = np.square(score) / (self.scale * np.where(left > 0.0, left, 1.0))
        p = np.array([f_tail(float(squares[i]), 1, self.freedom[i]) for i in seen])
        order = np.argsort(p, kind="stable")
        # The smallest of m counts m times, the next m - 1; none falls below the one before.
        holm = np.maximum.accumulate(p[order] * (len(p) - np.arange(len(p))))
        adjusted = np.minimum(holm, 1.0).tolist()
        return {seen[i]: p_value for i, p_value in zip(order.tolist(), adjusted, strict=True)}

    def tried(self, order: Sequence[int], chosen: Sequence[int]) -> tuple[int, ...]:
        """The candidates whose fits are compared: the best one where the equations are linear.

        Where it leaves differences, changes may be too large for that: all zeros, and the best.
        """
        p_value = self.innovation((*chosen, order[0])).p_value
        if p_value is None or p_value >= LEVEL:
            return (order[0],)
        zeros = [i for i in order if self.candidates[i].kind == "zero"]
        return tuple(dict.fromkeys([*order[:_TRIED], *zeros]))

    def settled(self, chosen: Sequence[int], falling: float | None = None) -> _System:
        """Linearised where the accepted changes are the estimated ones.

        It ends where a change leaves more misfit than before, by more than noise does; falling: or
        more than this share of it.
        """
        system, rows = self, list(chosen)
        # Where changes are dropped, the system at hand fits better than the new one can.
        least = np.inf if np.delete(system.t, rows).any() else system.present
        for _ in range(_ROUNDS):
            t = np.zeros(len(system.t))
            t[rows] = system.estimated(chosen).size
            moved = np.abs(t - system.t) * np.sqrt(np.diag(system.G))
            if moved.max() < _SETTLED:
                break
            changes = {self.candidates[i].name: float(t[i]) for i in np.flatnonzero(t)}
            try:
                trial = _System.of(self.day, self.candidates, self.day.linearised(changes), t)
            except NoTrustworthyResult:
                break
            # 1: about what noise adds to a chi-squared by one degree of freedom.
            if trial.present > least + 1.0 or not trial.visible[rows].all():
                break
            before, least, system = least, trial.present, trial
            if falling is not None and least > falling * before:
                break
        return system

    def kept(self, chosen: Sequence[int]) -> tuple[int, ...]:
        """Those that are still significant beside the others; the last one is."""
        changes = self.estimated(chosen)
        z = np.abs(changes.size) / (np.sqrt(self.scale) * changes.sds)
        return tuple(j for j, size in zip(chosen, z, strict=True) if size >= self.critical(j))

    def changes(self, chosen: Sequence[int], p_values: Sequence[float]) -> tuple[Change, ...]:
        """The accepted changes, with what cannot be distinguished from each."""
        together, changes = self.estimated(chosen), list[Change]()
        sizes, sds = together.size.tolist(), (np.sqrt(self.scale) * together.sds).tolist()
        for j, size, sd, p in zip(chosen, sizes, sds, p_values, strict=True):
            one, half = self.candidates[j], t_quantile(0.95, self.freedom[j]) * sd
            alike, interval = self._alike(chosen, j), (size - half, size + half)
            changes.append(Change(one.name, one.kind, one.unit, size, sd, *interval, p, alike))
        return tuple(changes)

    def _alike(self, chosen: Sequence[int], j: int) -> tuple[Candidate, ...]:
        """The candidates in whose presence j adds nothing significant."""
        others = [i for i in chosen if i != j]
        limit = self.scale * self.critical(j) ** 2
        alike = []
        for k, one in enumerate(self.candidates):
            if k in chosen or not self.visible[k]:
                continue
            same = self.group[k] == self.group[j]
            if not same:
                with_k = [*others, k]
                both = self.G[np.ix_([*with_k, j], [*with_k, j])]
                # Of two columns that are nearly one, what either adds would be rounding.
                if np.linalg.cond(both / np.sqrt(np.outer(np.diag(both), np.diag(both)))) < 1e12:
                    gained = self.estimated([*with_k, j]).gain - self.estimated(with_k).gain
                    same = gained <= limit
            if same:
                alike.append(one)
        return tuple(alike)

    def tested(self) -> tuple[Candidate, ...]:
        """All candidates, with the smallest change that is seen with the stated power."""
        tests, tested = self.tests(()), []
        for i, one in enumerate(self.candidates):
            if self.visible[i]:
                reach = self.critical(i) + t_quantile(2.0 * POWER - 1.0, self.freedom[i])
                smallest = float(reach * np.sqrt(self.scale / self.G[i, i]))
                one = replace(one, p_value=tests[int(self.group[i])], smallest=smallest)
            tested.append(one)
        return tuple(tested)
