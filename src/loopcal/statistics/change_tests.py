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

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import NoTrustworthyResult
from loopcal.mechanisms.parameters import GEOMETRY
from loopcal.mechanisms.structure.structured import driven_joints
from loopcal.statistics.changed import LEVEL, POWER, Candidate, Change, WhatChanged
from loopcal.statistics.innovation import Innovation, Linearised
from loopcal.statistics.replacing import ASTRAY, Replaced, zero_columns

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
_TESTED = {*GEOMETRY, "mounting"}

At = Callable[[Mapping[str, float], Mapping[str, float]], Replaced]
"""The poses placed anew after changes of parameters, and of zeros of joints, by name [SI]."""


@dataclass(frozen=True)
class _Named:
    name: str
    kind: str
    unit: str


def what_changed(
    placement: Replaced,
    linear: Linearised,
    at: At,
    linearised: Callable[[Replaced], Linearised],
    beyond: bool,
) -> WhatChanged | None:
    """Search for changes; None where these poses have no redundancy.

    placement, linear: the machine as calibrated; at: places it anew with changes; linearised: its
    equations there; beyond: whether the machine has an error that its model does not hold.
    """
    if linear.innovation().p_value is None:
        return None
    search = _Search(_candidates(placement), at, linearised, beyond)
    begun = search.system(placement, linear)
    innovation = begun.innovation(())
    tests = search.tests(begun, ())
    chosen: tuple[int, ...] = ()
    system = begun
    p_values: dict[int, float] = {}
    for _ in range(_MOST):
        step_tests = search.tests(system, chosen)
        if not step_tests.order or step_tests.adjusted[step_tests.order[0]] >= LEVEL:
            break
        several = [(*chosen, j) for j in search.tried(system, step_tests, chosen)]
        fits = [(one, search.settled(system, one, _HALVED)) for one in several]
        best, trial = min(fits, key=lambda fit: fit[1].present)
        if trial.astray and trial.present > _HELPED * system.present:
            break
        chosen, system = best, search.settled(trial, best)
        p_values[chosen[-1]] = float(step_tests.adjusted[chosen[-1]])
        if kept := search.kept(system, chosen):
            chosen, system = kept, search.settled(system, kept)
    if system.astray and system.present > _EXPLAINED * begun.present:
        chosen, system = (), begun
    changes = search.changes(system, chosen, [p_values[j] for j in chosen])
    left = system.innovation(chosen).p_value
    return WhatChanged(
        _verdict(innovation.p_value, changes, left),
        changes,
        search.tested(begun, tests),
        innovation,
        begun.scale,
        left,
    )


def _verdict(p_value: float | None, changes: Sequence[Change], left: float | None) -> str:
    if not changes and (p_value is None or p_value >= LEVEL):
        return "unchanged"
    explained = left is None or left >= LEVEL
    if changes and explained and all(change.zeros for change in changes):
        return "re-master"
    return "calibrate-anew"


def _candidates(placement: Replaced) -> tuple[_Named, ...]:
    """Of candidates that do the same the first speaks: zeros of joints, then mountings."""
    mechanism = placement.problem.mechanism
    zeros = [_Named(q, "zero", mechanism.quantities[q]) for q in driven_joints(mechanism)]
    anew = dict(zip(mechanism.parameters.names, placement.anew, strict=True))
    held = [p for p in mechanism.parameters if p.role in _TESTED and not anew[p.name]]
    held.sort(key=lambda p: p.role != "mounting")
    return (*zeros, *(_Named(p.name, p.dimension or p.role, p.unit) for p in held))


@dataclass(frozen=True)
class _Spread:
    """By how much S is larger than stated, and the degrees of freedom of that."""

    scale: float
    freedom: float


@dataclass(frozen=True, eq=False)
class _System:
    """The tests at some changes t (m,): G (m, m), g (m,) as if nothing had changed yet.

    present: the innovation at t; value: that as if nothing had changed; visible: (m,); group: (m,)
    the first candidate with the same column; freedom: (m,) degrees of freedom of the variance of
    each change; linear: the equations at t; every, rank: what all candidates explain of the
    innovation, and how many they are; spread: of these poses, None where the stated one is taken.
    """

    G: Array
    g: Array
    t: Array
    present: float
    value: float
    visible: NDArray[np.bool_]
    group: NDArray[np.intp]
    freedom: Array
    linear: Linearised
    every: float
    rank: int
    spread: _Spread | None

    def solved(self, chosen: Sequence[int]) -> Array:
        """The changes of these candidates, estimated together."""
        rows = list(chosen)
        return np.asarray(_inverse(self.G[np.ix_(rows, rows)]) @ self.g[rows])

    def explained(self, chosen: Sequence[int]) -> float:
        """By how much these changes lower the innovation."""
        return float(self.g[list(chosen)] @ self.solved(chosen)) if chosen else 0.0

    def innovation(self, chosen: Sequence[int]) -> Innovation:
        """The innovation after these changes."""
        if self.spread is not None:
            value = (self.every - self.explained(chosen)) / self.spread.scale
            return Innovation.of(max(value, 0.0), self.rank - len(chosen), self.spread.freedom)
        total = self.linear.innovation().value
        return self.linear.innovation(total - self.value + self.explained(chosen), len(chosen))

    @property
    def astray(self) -> bool:
        """Whether the misfit is gross."""
        return self.present > ASTRAY * len(self.linear.e)

    @property
    def scale(self) -> float:
        """Of S."""
        return 1.0 if self.spread is None else self.spread.scale

    def tail(self, z: float, i: int) -> float:
        """p-value of a change of so many sds, either way."""
        from scipy.special import ndtr, stdtr

        nu = self.freedom[i]
        return 2.0 * float(ndtr(-z) if np.isinf(nu) else stdtr(nu, -z))

    def quantile(self, chance: float, i: int) -> float:
        """How many sds a change exceeds with this probability, one way."""
        from scipy.special import ndtri, stdtrit

        nu = self.freedom[i]
        return -float(ndtri(chance) if np.isinf(nu) else stdtrit(nu, chance))

    def critical(self, i: int) -> float:
        """Of the most significant of all candidates [sds]."""
        groups = len(np.unique(self.group[self.visible]))
        return self.quantile(0.5 * LEVEL / max(groups, 1), i)


@dataclass(frozen=True)
class _Tests:
    """Of single candidates: order by p-value, adjusted p-values (m,), NaN where not tested."""

    order: tuple[int, ...]
    adjusted: Array


@dataclass(frozen=True)
class _Search:
    named: tuple[_Named, ...]
    at: At
    linearised: Callable[[Replaced], Linearised]
    beyond: bool

    def system(self, placement: Replaced, linear: Linearised, t: Array | None = None) -> _System:
        """The tests where the machine has changed by t."""
        names = placement.problem.mechanism.parameters.names
        joints = [one.name for one in self.named if one.kind == "zero"]
        indices = [names.index(one.name) for one in self.named if one.kind != "zero"]
        columns = [zero_columns(placement, joints), placement.J[:, indices]]
        raw = np.hstack(columns) / np.sqrt(linear.factor)
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
        t = np.zeros(len(self.named)) if t is None else t
        present = float(linear.weighed(linear.left, linear.left))
        # With e = e_0 - U t: |e_0|^2 = |e|^2 + 2 t^T g + t^T G t in the metric S^-1, g_0 = g + G t.
        value = present + float(t @ (2.0 * g + G @ t))
        scale = np.sqrt(np.where(visible, np.diag(G), 1.0))
        same = np.abs(G / scale / scale[:, None]) > 1.0 - _SAME
        same[~visible], same[:, ~visible] = False, False
        np.fill_diagonal(same, True)
        group, freedom = same.argmax(axis=0), linear.freedom(raw)
        heads = np.unique(group[visible])
        sizes, vectors = np.linalg.eigh((G / scale / scale[:, None])[np.ix_(heads, heads)])
        along = vectors.T @ ((g + G @ t) / scale)[heads]
        kept = sizes > _SAME
        every, rank = float((np.square(along[kept]) / sizes[kept]).sum()), int(kept.sum())
        spread, left = None, len(linear.e) - linear.rank - rank
        if self.beyond and left >= _ENOUGH:
            wider = max((value - every) / left, 1.0)
            axes = (U / scale)[:, heads] @ (vectors[:, kept] / np.sqrt(sizes[kept]))
            learnt = linear.denominator(axes) or np.inf
            # Relative variances 2 / nu of independent errors of a scale add up.
            spread = _Spread(wider, 1.0 / (1.0 / left + 1.0 / learnt))
            freedom = 1.0 / (1.0 / freedom + 1.0 / left)
        return _System(
            G, g + G @ t, t, present, value, visible, group, freedom, linear, every, rank, spread
        )

    def tests(self, system: _System, chosen: Sequence[int]) -> _Tests:
        """Each further candidate beside those that were accepted, one for each group."""
        G, g, rows = system.G, system.g, list(chosen)
        heads = [i for i in np.unique(system.group[system.visible]).tolist() if i not in rows]
        X = _inverse(G[np.ix_(rows, rows)]) @ G[rows]
        left = np.diag(G) - (G[:, rows] * X.T).sum(axis=1)
        seen = [i for i in heads if left[i] > _VISIBLE * G[i, i]]
        score = g - (g[rows] @ X if rows else 0.0)
        p = np.array(
            [system.tail(abs(score[i]) / np.sqrt(system.scale * left[i]), i) for i in seen]
        )
        order = np.argsort(p, kind="stable")
        # The smallest of m counts m times, the next m - 1; none falls below the one before.
        holm = np.maximum.accumulate(p[order] * (len(p) - np.arange(len(p))))
        adjusted = np.full(len(g), np.nan)
        for place, i in enumerate(order.tolist()):
            adjusted[seen[i]] = min(float(holm[place]), 1.0)
        return _Tests(tuple(seen[i] for i in order.tolist()), adjusted)

    def tried(self, system: _System, tests: _Tests, chosen: Sequence[int]) -> tuple[int, ...]:
        """The candidates whose fits are compared: the best one where the equations are linear.

        Where it leaves differences, changes may be too large for that: all zeros, and the best.
        """
        best = tests.order[0]
        p_value = system.innovation((*chosen, best)).p_value
        if p_value is None or p_value >= LEVEL:
            return (best,)
        zeros = [i for i in tests.order if self.named[i].kind == "zero"]
        return tuple(dict.fromkeys([*tests.order[:_TRIED], *zeros]))

    def settled(
        self, system: _System, chosen: Sequence[int], falling: float | None = None
    ) -> _System:
        """Linearised where the accepted changes are the estimated ones.

        It ends where a change leaves more misfit than before, by more than noise does; falling: or
        more than this share of it.
        """
        rows = list(chosen)
        # Where changes are dropped, the system at hand fits better than the new one can.
        least = np.inf if np.delete(system.t, rows).any() else system.present
        for _ in range(_ROUNDS):
            t = np.zeros(len(self.named))
            t[rows] = system.solved(chosen)
            moved = np.abs(t - system.t) * np.sqrt(np.diag(system.G))
            if moved.max() < _SETTLED:
                break
            try:
                placement = self.at(self._by_name(t, zero=False), self._by_name(t, zero=True))
                trial = self.system(placement, self.linearised(placement), t)
            except NoTrustworthyResult:
                break
            # 1: about what noise adds to a chi-squared by one degree of freedom.
            if trial.present > least + 1.0 or not trial.visible[rows].all():
                break
            before, least, system = least, trial.present, trial
            if falling is not None and least > falling * before:
                break
        return system

    def _by_name(self, t: Array, *, zero: bool) -> dict[str, float]:
        return {
            one.name: float(v)
            for one, v in zip(self.named, t, strict=True)
            if v and (one.kind == "zero") == zero
        }

    def kept(self, system: _System, chosen: Sequence[int]) -> tuple[int, ...]:
        """Those that are still significant beside the others; the last one is."""
        rows = list(chosen)
        sds = np.sqrt(system.scale * np.diag(_inverse(system.G[np.ix_(rows, rows)])))
        z = np.abs(system.solved(chosen)) / sds
        return tuple(j for j, size in zip(chosen, z, strict=True) if size >= system.critical(j))

    def changes(
        self, system: _System, chosen: Sequence[int], p_values: Sequence[float]
    ) -> tuple[Change, ...]:
        """The accepted changes, with what cannot be distinguished from each."""
        if not chosen:
            return ()
        rows = list(chosen)
        estimates = system.solved(chosen)
        wide = [system.quantile(0.025, j) for j in rows]
        sds = np.sqrt(system.scale * np.diag(_inverse(system.G[np.ix_(rows, rows)])))
        return tuple(
            Change(
                self.named[j].name,
                self.named[j].kind,
                self.named[j].unit,
                float(t),
                float(sd),
                float(t - w * sd),
                float(t + w * sd),
                p,
                self._alike(system, chosen, j),
            )
            for j, t, sd, w, p in zip(rows, estimates, sds, wide, p_values, strict=True)
        )

    def _alike(self, system: _System, chosen: Sequence[int], j: int) -> tuple[Candidate, ...]:
        """The candidates in whose presence j adds nothing significant."""
        others = [i for i in chosen if i != j]
        limit = system.scale * system.critical(j) ** 2
        alike = []
        for k, one in enumerate(self.named):
            if k in chosen or not system.visible[k]:
                continue
            same = system.group[k] == system.group[j]
            if not same:
                with_k = [*others, k]
                both = system.G[np.ix_([*with_k, j], [*with_k, j])]
                # Of two columns that are nearly one, what either adds would be rounding.
                if np.linalg.cond(both / np.sqrt(np.outer(np.diag(both), np.diag(both)))) < 1e12:
                    gained = system.explained([*with_k, j]) - system.explained(with_k)
                    same = gained <= limit
            if same:
                alike.append(Candidate(one.name, one.kind, one.unit, None, None))
        return tuple(alike)

    def tested(self, system: _System, tests: _Tests) -> tuple[Candidate, ...]:
        """All candidates, with the smallest change that is seen with the stated power."""
        reach = [
            system.critical(i) + system.quantile(1.0 - POWER, i) for i in range(len(self.named))
        ]
        return tuple(
            Candidate(
                one.name,
                one.kind,
                one.unit,
                float(tests.adjusted[system.group[i]]) if system.visible[i] else None,
                float(reach[i] * np.sqrt(system.scale / system.G[i, i]))
                if system.visible[i]
                else None,
            )
            for i, one in enumerate(self.named)
        )


def _inverse(G: Array) -> Array:
    """Of a covariance's inverse (m, m), scaled first; along what it does not tell 0."""
    scale = np.sqrt(np.diag(G))
    scale = np.where(scale > 0.0, scale, 1.0)
    scaled = np.linalg.pinv(G / np.outer(scale, scale), rcond=1e-12, hermitian=True)
    inverse: Array = scaled / np.outer(scale, scale)
    return inverse
