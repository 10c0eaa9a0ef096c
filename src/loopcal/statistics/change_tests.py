"""What changed since a calibration: a joint's zero, a tool, a load, a dimension?

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

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.errors import NoTrustworthyResult
from loopcal.small_samples import f_limit, f_tail, t_quantile
from loopcal.statistics import changed
from loopcal.statistics.another_day import Day
from loopcal.statistics.changed import LEVEL, PLACED, POWER, Candidate, Change, WhatChanged
from loopcal.statistics.day_causes import Causes
from loopcal.statistics.estimated import Estimated
from loopcal.statistics.innovation import Innovation, Linearised
from loopcal.statistics.possible_changes import sd_of
from loopcal.statistics.replacing import ASTRAY

# Chosen, not derived: a cap, and a step that changes no p-value.
_ROUNDS, _SETTLED = 8, 1e-3
"""Linearisations of accepted changes, and the step [sds] that ends them."""
# Chosen, not derived: each round leaves less than half of what the one before has moved.
_ROUNDS_OF_GROWTH = 10
"""Of the growth of a machine, on which the prior of its tool's depends."""
# Chosen, not derived: each candidate costs linearisations; the likeliest come first.
_TRIED = 3
# Chosen, not derived: a candidate that does not halve it is not the cause.
_HALVED = 0.5
"""What a linearisation leaves of the misfit, for the next one of a candidate; and a delay alone."""
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
# As in `change_points`: a factor of e^7, about 1000, in the likelihood; chosen, not derived.
_ALIKE = 14.0
"""An alternative explains the change about as well if its innovation and the price of its parts are
within this of those of the change."""


@dataclass(frozen=True, eq=False)
class Explained:
    """What changed; linear: the equations after it; columns (R, d): of it; every (R, m): of all."""

    what: WhatChanged
    linear: Linearised
    columns: Array
    every: Array


def what_changed(day: Day, linear: Linearised) -> Explained | None:
    """Search for changes; None where these poses have no redundancy.

    linear: the machine as calibrated, at these poses.
    """
    if linear.innovation().p_value is None:
        return None
    causes = Causes.of(day, linear)
    begun = system = _System.of(day, causes, linear, np.zeros(len(causes.owner)))
    # What an unsound model lacks is as large in other poses, and looks like changes there.
    expected = changed.LARGER**2 * (len(linear.e) - linear.rank)
    sought = 0 if day.calibrated.rejected and begun.present < expected else changed.SOUGHT
    chosen: tuple[int, ...] = ()
    p_values: dict[int, float] = {}
    rivals: dict[int, tuple[int, ...]] = {}
    # What was given up is not tried again. Each round gives one up or leaves one more: it ends.
    given_up: set[int] = set()
    while len(chosen) < sought:
        tests = {i: p for i, p in system.tests(chosen).items() if i not in given_up}
        if not (likely := [i for i, p in tests.items() if p < LEVEL]):  # the likeliest first
            break
        several = [causes.joined(chosen, j) for j in system.tried(likely, chosen)]
        fits = [(one, system.settled(one, _HALVED)) for one in several]
        best, trial = min(fits, key=lambda fit: fit[1].cost(fit[0]))
        if trial.astray and trial.present > _HELPED * system.present:
            break
        settled = trial.settled(best)
        if far := settled.too_far(best):
            given_up |= {*far}
            chosen, system = _without(far, chosen, system, begun)
            continue
        given_up |= {*chosen} - {*best}  # one of them stands in best in more parts, or in fewer
        chosen, system = best, settled
        p_values[chosen[-1]] = tests[chosen[-1]]
        rivals[chosen[-1]] = settled.rivals(best, [fit for fit in fits if fit[0] != best])
        if (kept := system.kept(chosen)) != chosen:
            given_up |= {*chosen} - {*kept}
            chosen, system = kept, system.settled(kept)
            apart = {j: system.tests([i for i in kept if i != j]) for j in kept}
            p_values |= {j: tests[j] for j, tests in apart.items() if j in tests}
    unexplained = len(chosen) == changed.SOUGHT and not system.explained(chosen)
    if unexplained and (zeros := _all_zeros(begun)) is not None:
        chosen, system, p_values = zeros
        rivals = dict.fromkeys(chosen, ())
    halved = _HALVED if begun.spread > changed.LARGER**2 else np.inf
    if system.present > (_EXPLAINED if system.astray else halved) * begun.present:
        chosen, system = (), begun
    whole, left = begun.innovation(()), system.innovation(chosen).p_value
    if [causes.causes[i].kind for i in chosen[:1]] == ["delay"] and (left or 0.0) < LEVEL:
        # Between poses the way of a hand bends: what a straight one leaves is no other change.
        alone = begun.settled(chosen[:1])
        if alone.present < _HALVED * begun.present:
            chosen, system, left = chosen[:1], alone, alone.innovation(chosen[:1]).p_value
    changes = system.changes(chosen, p_values, rivals)
    verdict = changed.verdict_of(whole.p_value, changes, left) if sought else "unchanged"
    tested, moved = begun.tested(), causes.changes(system.t)
    what = WhatChanged(verdict, changes, tested, whole, begun.spread, left, moved)
    loads = [name for i in chosen for name in causes.causes[i].loaded]
    columns = system.linear.spanned(loads, system.columns(chosen))
    few = [i for i, one in enumerate(causes.causes) if one.of_few]
    return Explained(what, system.linear, columns, system.columns(few))


def _all_zeros(begun: _System) -> tuple[tuple[int, ...], _System, dict[int, float]] | None:
    """The zeros of all joints that moved, as after a flat battery of the encoders, with the p-value
    of each; None where these do not explain the poses."""
    causes = begun.causes.causes
    zeros = tuple(i for i in begun.heads if causes[i].kind == "zero")
    end = begun.settled(zeros) if zeros else begun
    if not end.explained(zeros) or len(kept := end.kept(zeros)) < changed.SOUGHT:
        return None
    end = end.settled(kept)
    apart = {j: end.tests([i for i in kept if i != j]).get(j, 1.0) for j in kept}
    return (kept, end, apart) if end.explained(kept) and not end.too_far(kept) else None


def _without(
    far: Sequence[int], chosen: tuple[int, ...], system: _System, begun: _System
) -> tuple[tuple[int, ...], _System]:
    """The changes accepted so far, without those that no machine can have."""
    kept = tuple(i for i in chosen if i not in far)
    return (chosen, system) if kept == chosen else (kept, begun.settled(kept) if kept else begun)


@dataclass(frozen=True, eq=False)
class _System:
    """The tests of causes at some changes t (m,): G (m, m), g (m,) as if nothing had changed.

    present: the innovation at t; value: that as if nothing had changed; U: (R, m) the directions,
    less what the placement takes up; visible: (m,); group: of each cause the first with the same
    column; freedom: (m,) degrees of freedom of the variance of each direction; linear: the
    equations at t; every: all causes together (`of_few`); scale: of S, by these poses;
    scale_freedom: its degrees of freedom, None if as stated; spread: `changed.larger` of it.
    """

    day: Day
    causes: Causes
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
    spread: float

    @classmethod
    def of(cls, day: Day, causes: Causes, linear: Linearised, t: Array) -> _System:
        """The tests where the machine has changed by t."""
        raw = causes.columns(linear.placement) / np.sqrt(linear.factor)
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
        group, freedom = _groups(causes, alike, visible), linear.freedom(raw)
        few = np.array([one.of_few for one in causes.causes])
        rows = np.flatnonzero(visible & (group[causes.owner] == causes.owner) & few[causes.owner])
        unit = np.ones(len(rows))
        every = Estimated.of((g / scale)[rows], alike[np.ix_(rows, rows)], unit, _SAME)
        wider, wider_freedom, spread = 1.0, None, 1.0
        left = len(linear.e) - linear.rank - every.rank
        if (day.calibrated.carried or day.calibrated.rejected is not None) and left >= _ENOUGH:
            wider = max((value - every.gain) / left, 1.0)
            learnt = linear.denominator((U / scale)[:, rows] @ every.root) or np.inf
            # Relative variances 2 / nu of independent errors of a scale add up.
            wider_freedom = 1.0 / (1.0 / left + 1.0 / learnt)
            spread = changed.larger(wider, left, learnt)
            freedom = 1.0 / (1.0 / freedom + 1.0 / left)
        held = G, g, t, present, value, visible, group, freedom, linear, every
        return cls(day, causes, *held, wider, wider_freedom, spread)

    def _rows(self, *chosen: int) -> NDArray[np.intp]:
        """The visible directions of these causes."""
        every = np.concatenate([np.zeros(0, dtype=np.intp), *map(self.causes.rows, chosen)])
        return np.asarray(every[self.visible[every]])

    def unit(self, i: int) -> str:
        """That in which a cause is stated: of its first direction that these poses show."""
        return str(self.causes.units[[*self._rows(i), *self.causes.rows(i)][0]])

    def in_unit(self, i: int, rows: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Which of these directions of a cause are in its unit."""
        return np.asarray(self.causes.units[rows] == self.unit(i))

    def candidate(self, i: int) -> Candidate:
        """As it is reported."""
        one = self.causes.causes[i]
        return Candidate(*one.called, self.unit(i), label=one.described)

    def columns(self, chosen: Sequence[int]) -> Array:
        """(R, d) of these causes, in the equations as they are linearised."""
        raw = self.causes.columns(self.linear.placement) / np.sqrt(self.linear.factor)
        return np.asarray(raw[:, self._rows(*chosen)])

    @property
    def heads(self) -> list[int]:
        """The causes that these poses show, one of each group."""
        shown = np.unique(self.causes.owner[self.visible])
        return [int(i) for i in shown if self.group[i] == i]

    def estimated(self, chosen: Sequence[int]) -> Estimated:
        """These changes together."""
        rows = self._rows(*chosen)
        G, g = self.G[np.ix_(rows, rows)], self.g[rows]
        length = np.sqrt(np.diag(G))
        scale = 1.0 / np.where(length > 0.0, length, 1.0)
        return Estimated.of(scale * g, G * np.outer(scale, scale), scale, _ROUNDING)

    def beside(self, i: int, chosen: Sequence[int]) -> Estimated:
        """What one further change explains beside those that were accepted."""
        rows, others = self._rows(i), self._rows(*chosen)
        G, g = self.G[np.ix_(rows, rows)], self.g[rows]
        scale = 1.0 / np.sqrt(np.diag(G))
        if others.size:
            X = self.estimated(chosen).covariance @ self.G[np.ix_(others, rows)]
            G, g = G - self.G[np.ix_(rows, others)] @ X, g - X.T @ self.g[others]
        # `_VISIBLE` is a share of lengths, here of columns of length 1.
        return Estimated.of(scale * g, G * np.outer(scale, scale), scale, _VISIBLE)

    def innovation(self, chosen: Sequence[int]) -> Innovation:
        """The innovation after these changes."""
        together = self.estimated(chosen)
        if self.scale_freedom is not None:
            value = max((self.every.gain - together.gain) / self.scale, 0.0)
            return Innovation.of(value, self.every.rank - together.rank, self.scale_freedom)
        total = self.linear.innovation().value
        return self.linear.innovation(total - self.value + together.gain, together.rank)

    def explained(self, chosen: Sequence[int]) -> bool:
        """Whether nothing significant is left after these changes."""
        left = self.innovation(chosen).p_value
        return left is None or left >= LEVEL

    @property
    def astray(self) -> bool:
        """Whether the misfit is gross."""
        return self.present > ASTRAY * len(self.linear.e)

    def cost(self, chosen: Sequence[int]) -> float:
        """What it leaves, and how unlikely the sizes of the changes are."""
        rows, together = self._rows(*chosen), self.estimated(chosen)
        sizes, covariance, unlikely = together.size, together.covariance, 0.0
        for i in chosen:
            part = np.flatnonzero(self.causes.owner[rows] == i)
            unlikely += self._unlikely(i, sizes[part], covariance[np.ix_(part, part)])
        return self.unexplained(chosen) + 2.0 * unlikely

    def unexplained(self, chosen: Sequence[int]) -> float:
        """The innovation there, and what each part of a change costs (Schwarz 1978)."""
        return self.present / self.scale + len(self._rows(*chosen)) * self._charge

    def rivals(
        self, chosen: Sequence[int], fits: Sequence[tuple[tuple[int, ...], _System]]
    ) -> tuple[int, ...]:
        """The last of each of these other choices that explain about as much, where each has its
        end: of changes so large that no line shows it."""
        gross = [(one, fit) for one, fit in fits if fit.present < _EXPLAINED * self.value]
        ends = [(one, fit.settled(one)) for one, fit in gross]
        most = self.unexplained(chosen) + _ALIKE
        return tuple(
            one[-1] for one, end in ends if end.unexplained(one) < most and not end.too_far(one)
        )

    def _unlikely(self, i: int, sizes: Array, covariance: Array) -> float:
        units = self.causes.units[self._rows(i)].tolist()
        return self.causes.causes[i].unlikely(sizes, self.scale * covariance, units)

    @property
    def _charge(self) -> float:
        return math.log(max(len(self.linear.e), 2))

    def _freedom(self, i: int) -> float:
        """Degrees of freedom of the variance of a change."""
        return float(self.freedom[self._rows(i)].min(initial=np.inf))

    def critical(self, i: int, rank: int = 1) -> float:
        """Of the most significant of all causes, the square of so many parts [sds squared]."""
        level = 1.0 - LEVEL / max(len(self.heads), 1)
        return float(f_limit(level, rank, np.array([self._freedom(i)]))[0])

    def tests(self, chosen: Sequence[int]) -> dict[int, float]:
        """Adjusted p-values of further causes beside those that were accepted, the likeliest first.

        Not of a cause whose smallest visible change is larger than a machine can have.
        """
        seen, p, costs = list[int](), list[float](), list[float]()
        for i in self.heads:
            if i in chosen or not self.smallest(i) <= self.causes.causes[i].most:
                continue
            part = self.beside(i, chosen)
            if part.rank:
                gain, freedom = part.gain / self.scale, self._freedom(i)
                seen.append(i)
                p.append(f_tail(gain, part.rank, freedom))
                unlikely = self._unlikely(i, part.size, part.covariance)
                costs.append(len(self._rows(i)) * self._charge - gain + 2.0 * unlikely)
        order = np.argsort(p, kind="stable")
        # The smallest of m counts m times, the next m - 1; none falls below the one before.
        holm = np.maximum.accumulate(np.array(p)[order] * (len(p) - np.arange(len(p))))
        adjusted = dict(zip(order.tolist(), np.minimum(holm, 1.0).tolist(), strict=True))
        return {seen[i]: adjusted[i] for i in np.argsort(costs, kind="stable").tolist()}

    def tried(self, order: Sequence[int], chosen: Sequence[int]) -> tuple[int, ...]:
        """The causes whose fits are compared: the best one where the equations are linear.

        Where it leaves differences, changes may be too large for that: all zeros and mountings, and
        the best. Of a large change those of them that leave little of it.
        """
        p_value = self.innovation((*chosen, order[0])).p_value
        likely = [i for i in order if self.causes.causes[i].often]
        if p_value is None or p_value >= LEVEL:
            little = (1.0 - _EXPLAINED) * self.present
            large = [i for i in likely if self.beside(i, chosen).gain > little]
            return tuple(dict.fromkeys([order[0], *large]))
        return tuple(dict.fromkeys([*order[:_TRIED], *likely]))

    def settled(self, chosen: Sequence[int], falling: float | None = None) -> _System:
        """Linearised where the accepted changes are the estimated ones.

        It ends where a change leaves more misfit than before, by more than noise does; falling: or
        more than this share of it.
        """
        system, rows = self, self._rows(*chosen)
        # Where changes are dropped, the system at hand fits better than the new one can.
        least = np.inf if np.delete(system.t, rows).any() else system.present
        for _ in range(_ROUNDS):
            t = np.zeros(len(system.t))
            t[rows] = system.estimated(chosen).size
            if (np.abs(t - system.t) * np.sqrt(np.diag(system.G))).max() < _SETTLED:
                break
            try:
                linear = self.day.linearised(self.causes.changes(t))
                trial = _System.of(self.day, self.causes, linear, t)
            except NoTrustworthyResult:
                break
            # 1: about what noise adds to a chi-squared by one degree of freedom.
            if trial.present > least + 1.0 or not trial.visible[rows].all():
                break
            before, least, system = least, trial.present, trial
            if falling is not None and least > falling * before:
                break
        return system

    def too_far(self, chosen: Sequence[int]) -> tuple[int, ...]:
        """Those that are larger than a machine can have; or than it usually has, where these poses
        do not see them with the stated power, as chance."""
        far = list[int]()
        for i in chosen:
            size, cause = abs(self._size(i, chosen)[0]), self.causes.causes[i]
            part = self.beside(i, [j for j in chosen if j != i])
            seen = part.gain >= self.scale * self._reach(i, part.rank) ** 2
            if size > cause.most or (size > cause.usual(self.unit(i)) and not seen):
                far.append(i)
        return tuple(far)

    def _reach(self, i: int, rank: int) -> float:
        """The size [sds] of a cause of such a rank that is seen with the stated power."""
        power = t_quantile(2.0 * POWER - 1.0, self._freedom(i))
        return math.sqrt(self.critical(i, max(rank, 1))) + power

    def kept(self, chosen: Sequence[int]) -> tuple[int, ...]:
        """Those that are still significant beside the others; the least one leaves first, since
        of two that do the same neither is."""
        shares = dict[int, float]()  # of what is significant
        for j in chosen:
            part = self.beside(j, [i for i in chosen if i != j])
            limit = self.scale * self.critical(j, part.rank) if part.rank else math.inf
            shares[j] = part.gain / limit
        if min(shares.values()) >= 1.0 or len(chosen) == 1:
            return tuple(chosen)
        return self.kept([i for i in chosen if i != min(shares, key=shares.__getitem__)])

    def changes(
        self,
        chosen: Sequence[int],
        p_values: Mapping[int, float],
        rivals: Mapping[int, tuple[int, ...]],
    ) -> tuple[Change, ...]:
        """The accepted changes, with what cannot be distinguished from each: where their equations
        are linear, and of rivals."""
        changes = []
        for j in chosen:
            one, cause = self.candidate(j), self.causes.causes[j]
            size, sd, t = self._size(j, chosen)
            if one.kind == "expansion":
                size, sd = self._with_tools(j, chosen)
            half = t_quantile(0.95, self._freedom(j)) * (sd := sd_of(size, sd, one.unit))
            parts: dict[str, float] = {}
            turn: tuple[float, float] | None = None
            if cause.parts and "rad" in cause.units:
                angle, angle_sd, _ = self._size(j, chosen, turn=True)
                turn = angle, t_quantile(0.95, self._freedom(j)) * angle_sd
            hidden: tuple[str, ...] = ()
            if one.kind in (*PLACED, "lens") and len(cause.names) > 1 and not cause.parts:
                rows = self.causes.rows(j)
                among = np.flatnonzero(self.in_unit(j, rows) | ~self.visible[rows])
                names = [cause.names[k] for k in among]
                parts = self.causes.changes(t)
                hidden = tuple(name for name in names if name not in parts)
            named, span = (one.name, one.kind, one.unit), (size, sd, size - half, size + half)
            alike, p = self._alike(chosen, j, rivals[j]), p_values[j]
            changes.append(Change(*named, *span, p, alike, parts, hidden, turn, one.label))
        return tuple(changes)

    def _size(
        self, j: int, chosen: Sequence[int], *, turn: bool = False
    ) -> tuple[float, float, Array]:
        """The size of an accepted change [unit] and its sd, and its parts (m,); turn: of its parts
        in another unit.

        Of several parts the length of those in the unit of the cause, but for parts that may be
        larger than the largest that is sure.
        """
        rows, together = self._rows(*chosen), self.estimated(chosen)
        part = np.flatnonzero(self.causes.owner[rows] == j)
        t, covariance = np.zeros(len(self.t)), self.scale * together.covariance
        if len(part) == 1:
            (at,) = part
            t[rows[at]] = together.size[at]
            return float(together.size[at]), float(np.sqrt(covariance[at, at])), t
        part = part[self.in_unit(j, rows[part]) ^ turn]
        sizes = np.abs(together.size[part])
        halves = t_quantile(0.95, self._freedom(j)) * np.sqrt(np.diag(covariance)[part])
        if (sure := halves <= sizes).any():
            part = part[halves <= sizes[sure].max()]
        t[rows[part]] = together.size[part]
        length = float(np.linalg.norm(together.size[part]))
        along = together.size[part] / (length or 1.0)
        return length, float(np.sqrt(along @ covariance[np.ix_(part, part)] @ along)), t

    def _with_tools(self, j: int, chosen: Sequence[int]) -> tuple[float, float]:
        """The growth s of the machine and its sd, whether or not what it carries has grown as well.

        A tool may be colder. Its own growth is as likely 0 as s: its prior has the mean and the sd
        of these two, s / 2 both.
        """
        placement, rows = self.linear.placement, self._rows(*chosen)
        nominal = {
            p.name: p.nominal
            for p, anew in zip(placement.problem.mechanism.parameters, placement.anew, strict=True)
            if (p.role, p.unit) == ("mounting", "m") and not anew
        }
        (at,) = np.flatnonzero(self.causes.owner[rows] == j)
        tool = placement.columns(tuple(nominal)) @ np.array([*nominal.values()], dtype=float)
        columns = np.column_stack([self.columns(chosen), tool / np.sqrt(self.linear.factor)])
        columns = columns - self.linear.F @ (self.linear.solve @ columns)
        G = self.linear.weighed(columns, columns) / self.scale
        left = self.linear.weighed(columns, self.linear.left[:, None])[:, 0] / self.scale
        g = left + G[:, :-1] @ self.t[rows]
        size, covariance, known = float(self.estimated(chosen).size[at]), G, np.zeros(len(g))
        for _ in range(_ROUNDS_OF_GROWTH):
            known[-1] = 4.0 / np.square(size)
            covariance = np.asarray(np.linalg.inv(G + np.diag(known)))
            size = float((covariance @ (g + 0.5 * size * known))[at])
        return size, float(np.sqrt(covariance[at, at]))

    def _alike(self, chosen: Sequence[int], j: int, rivals: Sequence[int]) -> tuple[Candidate, ...]:
        """About as simple causes beside which j adds nothing significant; and these rivals."""
        others, alike = [i for i in chosen if i != j], []
        cost = len(self._rows(j)) * self._charge - self.beside(j, others).gain / self.scale
        for k in range(len(self.causes.causes)):
            within = self.causes.causes[j].within(self.causes.causes[k])
            if k in chosen or not self._rows(k).size or within:
                continue
            same = self.group[k] == self.group[j] or k in rivals
            if not same and self.smallest(k) <= self.causes.causes[k].most:
                part, added = self.beside(k, others), self.beside(j, [*others, k])
                limit = self.scale * self.critical(j, max(added.rank, 1))
                price = len(self._rows(k)) * self._charge - part.gain / self.scale
                possible_size = np.abs(part.size).max(initial=0.0) <= self.causes.causes[k].most
                same = added.gain <= limit and price < cost + _ALIKE and bool(possible_size)
            if same:
                alike.append(self.candidate(k))
        return tuple(dict.fromkeys(alike))

    def smallest(self, i: int) -> float:
        """The smallest that is seen with the stated power, in the direction shown worst."""
        part = self.beside(i, ())
        if not part.rank:
            return math.inf
        alike = self.in_unit(i, self._rows(i))
        worst = np.linalg.eigvalsh(part.covariance[np.ix_(alike, alike)])[-1]
        return float(self._reach(i, part.rank) * np.sqrt(self.scale * worst))

    def tested(self) -> tuple[Candidate, ...]:
        """All causes, with the smallest change that is seen with the stated power."""
        tests, tested = self.tests(()), dict[tuple[str, str], Candidate]()
        for i in range(len(self.causes.causes)):
            one = self.candidate(i)
            if self._rows(i).size and (p := tests.get(int(self.group[i]))) is not None:
                one = replace(one, p_value=p, smallest=self.smallest(i))
            tested.setdefault(self.causes.causes[i].called, one)
        return tuple(tested.values())


def _groups(causes: Causes, alike: Array, visible: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Of each cause the first that does the same: of one direction, with the same column."""
    count = np.bincount(causes.owner, minlength=len(causes.causes))
    single = visible & (count[causes.owner] == 1)
    same = (np.abs(alike) > 1.0 - _SAME) & single & single[:, None]
    np.fill_diagonal(same, True)
    first = causes.owner[same.argmax(axis=0)]
    group = np.arange(len(causes.causes))
    group[causes.owner[single]] = first[single]
    return group
