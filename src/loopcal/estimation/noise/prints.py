"""Where the points of a board truly are: a term with a learnt sd, eliminated from the fit.

Prints are not exact and paper is not flat: a point is off by the same d in all images, in the plane
of the board and out of it. With d ~ N(0, s^2), one s for each of both, and e = D dp + O d + v the
whitened equations of all images, the sums over them say s and d (`term_scales`). An image touches
few of the d and each of its rows three, so that with Q the orthonormal columns of what the rows
share

    O^T V^-1 O = sum of o o^T by point - (Q^T O)^T (Q^T O),

at a cost that is linear in the points of an image. The fit holds d; fit, sds and d take turns. What
d leaves open adds to the covariance of the parameters by the Schur complement, exactly. What of d
is a shift, turn, size or bend of the board is parted from these parameters by the priors of both.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.document.choice import DECISIVE, TermEntry, TermPart
from loopcal.document.findings import PrintedEntry
from loopcal.estimation.noise.term_parts import gain, idle, term_entries
from loopcal.estimation.noise.term_scales import (
    Sums,
    TermVariances,
    learn_scales,
    searched,
    term_system,
)
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.solve.kernel import TurnedImages
from loopcal.estimation.solve.sweep import Sweeper
from loopcal.expressions.engine import Stage
from loopcal.lazy import cached_property
from loopcal.mechanisms.instruments.camera import all_cameras
from loopcal.mechanisms.mechanism import PIXELS, Mechanism
from loopcal.mechanisms.terms import Term
from loopcal.presentation.shown import with_unit

if TYPE_CHECKING:
    from loopcal.estimation.solve.reduction import Spectrum
    from loopcal.estimation.solve.solution import End

AXES = "xyz"
SDS = {"points": 1e-4, "heights": 1e-4}
"""Medians of the learnt sds [m]: lines of a printer, and paper that lies flat. Chosen."""
_WORDS = {
    "points": "points of the board {board!r} are off by {{scale}} in its plane",
    "heights": "points of the board {board!r} are off by {{scale}} out of its plane",
}
LEVEL, FEWEST = 1e-3, 8
"""Probability that any point of a board is called displaced where all are good; points of a board
from which the scatter of the others is known."""
_STEP = 1e-5
"""By which points are moved for derivatives [m]: so central differences are right to nine digits
where the board is a metre away."""
_NONE = 19.0
"""Odds that a print has no offsets, as far as the images do not ask for them (0166)."""
# Chosen, not derived: some six ways are left, which a file can hold.
_SHARED = 0.02
"""Ways in which points err together count from this share of what each errs alone."""
_LINE = 3
"""Fewest points of a row or column whose mean is reported."""


def _is_height(term: Term) -> bool:
    """Whether it is of offsets out of the plane."""
    return term.parameters[0].endswith("_z")


@dataclass(frozen=True, eq=False)
class Layout:
    """The offsets of points: names (m,), the term of each, and what loop is of which point.

    points: (m / 3,) their ids; places: (m / 3, 3) where they are as printed [m];
    by_loop: loop -> position of the x offset of its point.
    """

    names: tuple[str, ...]
    owner: NDArray[np.intp]
    terms: tuple[Term, ...]
    points: tuple[str, ...]
    places: Array
    by_loop: Mapping[str, int]

    @classmethod
    def of(cls, mechanism: Mechanism) -> Layout | None:
        """Of the boards whose print is estimated; None without any."""
        items = {p.name: p for p in mechanism.parameters}
        free = {p.owner for p in items.values() if p.role == "print" and not p.fixed}
        names: list[str] = []
        points: list[str] = []
        by_loop: dict[str, int] = {}
        first: dict[str, int] = {}
        for family in mechanism.families:
            if family.form != PIXELS:
                continue
            for loop, reading in zip(family.loops, family.readings, strict=True):
                _, board, point, _ = reading.split(":")
                key = f"{board}_{point}"
                some = [f"{key}_{axis}" for axis in AXES]
                if board not in free or any(n not in items for n in some):
                    continue
                if any(items[n].role != "corner" or not items[n].fixed for n in some):
                    continue
                if key not in first:
                    first[key] = len(names)
                    names += some
                    points.append(point)
                by_loop[loop] = first[key]
        if not names:
            return None
        of_board = [items[n].owner for n in names]
        kinds = ["heights" if i % 3 == 2 else "points" for i in range(len(names))]
        owners = list(dict.fromkeys(zip(of_board, kinds, strict=True)))
        several = len({*of_board}) > 1
        terms = tuple(
            Term(
                f"{kind}_{board}" if several else kind,
                tuple(n for n, b, k in zip(names, of_board, kinds, strict=True) if (b, k) == one),
                SDS[kind],
                words=_WORDS[kind].format(board=board),
            )
            for one in owners
            for board, kind in [one]
        )
        owner = [owners.index(one) for one in zip(of_board, kinds, strict=True)]
        printed = {
            (c.board.name, k): xyz
            for c in all_cameras(mechanism)
            for k, xyz in c.board.points.items()
        }
        nowhere = (np.nan,) * 3
        places = [printed.get((b, k), nowhere) for b, k in zip(of_board[::3], points, strict=True)]
        return cls(
            tuple(names),
            np.array(owner),
            terms,
            tuple(points),
            np.array(places),
            by_loop,
        )


@dataclass(frozen=True, eq=False)
class Prints:
    """Offsets [m] of points, and what is known of them where the loops were linearised.

    values: (m,); scales: (terms,) sds, 0 of those that the images do not ask for; freedom: how
    many equations they use up; learnt: what the sums say of all terms; sums: (n + m + 1, n + m + 1)
    of [D O e] of so many equations, precision: (n,) of the priors beside it; covariance: of the
    offsets that are kept; step: the largest change by the last step, in sds.
    """

    layout: Layout
    index: NDArray[np.intp]
    values: Array
    scales: Array
    freedom: float = 0.0
    learnt: TermVariances | None = None
    sums: Array | None = None
    precision: Array | None = None
    covariance: Array | None = None
    step: float = 0.0
    equations: int = 0

    @classmethod
    def of(cls, problem: Problem, *, near: bool = False) -> Prints | None:
        """None where a problem has no such points. They begin where the problem does; near: a fit
        of nearly the same readings ended there."""
        layout = Layout.of(problem.mechanism)
        if layout is None or problem.loops_alike:
            return None
        names = problem.mechanism.parameters.names
        place = {name: i for i, name in enumerate(names)}
        index = np.array([place[n] for n in layout.names])
        values = problem.start[index]
        off = np.square(values - _nominal(problem)[index])
        count = np.bincount(layout.owner)
        scales = np.sqrt(np.bincount(layout.owner, off) / count)
        # Of a part of the images nothing is asked that all of them did not show.
        return None if near and not scales.any() else cls(layout, index, values, scales)

    def entries(self, mechanism: Mechanism) -> tuple[TermEntry, ...]:
        """The terms that the images ask for, as a document holds them."""
        if self.learnt is None:
            return ()
        every = term_entries(mechanism, self.learnt)
        return tuple(entry for entry, kept in zip(every, self.kept, strict=True) if kept)

    @property
    def kept(self) -> NDArray[np.bool_]:
        """(terms,) whether the images asked for them."""
        return self.scales > 0.0

    def due(self, *, ended: bool, roughly: bool) -> bool:
        """Whether to look for offsets: where sds are roughly right, and where all has settled."""
        return ended or bool(self.kept.any()) or (roughly and self.learnt is None)

    def held(self, start: Array) -> Array:
        """Parameters (n_all,) with the offsets."""
        start = start.copy()
        start[self.index] = self.values
        return start

    def updated(
        self, problem: Problem, end: End[Array], *, common: bool, asking: bool = True
    ) -> Prints:
        """The offsets and their sds by the sums where a fit ended; problem: at its sds.

        common: whether all noise is learnt; asking: whether terms may come that are not kept yet.
        """
        layout, n, m = self.layout, len(problem.free), len(self.index)
        total = summed(problem, end.parameters, end.corrections, layout, self.index)
        nominal = _nominal(problem)
        prior_sd = np.concatenate([problem.prior_sd, np.ones(m)])
        present = end.parameters[self.index]
        offset = np.concatenate(
            [problem.unknowns.offset(end.parameters), nominal[self.index] - present]
        )
        owner = np.concatenate([np.full(n, -1), layout.owner])
        system = term_system(
            Sums(total, False, end.equations), prior_sd, offset, owner, layout.terms
        )
        begun = np.where(self.scales > 0.0, self.scales, [term.sd for term in layout.terms])
        learnt = learn_scales(system, begun, common=common)
        kept = self.kept
        if asking and not kept.all():
            gone = idle(learnt, DECISIVE, gain)
            kept |= np.array([term.name not in gone for term in layout.terms])
        scales = np.where(kept, learnt.scales, 0.0)
        sds = scales[layout.owner]
        used = np.flatnonzero(sds > 0.0)
        values, step, freedom = nominal[self.index].copy(), 0.0, 0.0
        which = np.concatenate([np.arange(n), n + used])
        precision = np.concatenate([problem.precision, 1.0 / np.square(sds[used])])
        H = total[np.ix_(which, which)] + np.diag(precision)
        right = total[which, -1] + precision * offset[which]
        covariance = _inverse(H)
        if used.size:
            of_used = covariance[n:, n:]
            change = (covariance @ right)[n:]
            values[used] = present[used] + change
            freedom = float(used.size - np.trace(of_used / np.square(sds[used])[:, None]))
            step = float(np.abs(change / np.sqrt(np.diag(of_used))).max())
        if (kept & ~self.kept).any():
            step = np.inf
        return replace(
            self,
            values=values,
            scales=scales,
            freedom=freedom,
            learnt=learnt,
            sums=total,
            precision=problem.precision,
            covariance=covariance[n:, n:],
            step=step,
            equations=end.equations,
        )

    def parts(self) -> dict[str, list[TermPart]]:
        """By term the line of the print that is farthest off, where there are lines, and points
        that are farther off than the others let expect."""
        return {
            term.name: [*self._displaced(i), *self._lines(i)]
            for i, term in enumerate(self.layout.terms)
            if self.scales[i] > 0.0
        }

    def _displaced(self, term: int) -> list[TermPart]:
        """Points displaced by more than chance lets one of so many, by the scatter of the rest."""
        from scipy.special import fdtrc

        rows = np.flatnonzero(self.layout.owner == term)
        points = rows.reshape(-1, 1 if _is_height(self.layout.terms[term]) else 2)
        squares = np.square(self.values[points]).sum(axis=1)
        size, count = points.shape[1], len(points)
        if count < FEWEST:
            return []
        others = (squares.sum() - squares) / (size * (count - 1))
        p = count * fdtrc(size, size * (count - 1), squares / size / np.maximum(others, 1e-30))
        parts = []
        for k in np.flatnonzero(p < LEVEL)[np.argsort(-squares[p < LEVEL])]:
            off, sd = float(np.sqrt(squares[k])), float(self.sd[points[k]].max())
            name = self.layout.points[int(points[k, 0]) // 3]
            words = f"the point {name} stands {with_unit(off, 'm', 2, fine=True)} from its place"
            parts.append(TermPart((name,), "m", off, sd, None, words))
        return parts

    def _lines(self, term: int) -> list[TermPart]:
        """The row or column of a print of which all points are off the most, in one direction."""
        if _is_height(self.layout.terms[term]):
            return []
        rows = np.flatnonzero(self.layout.owner == term)
        best: TermPart | None = None
        for axis, what in enumerate(("column", "row")):
            along = rows[rows % 3 == axis]
            at = np.round(self.layout.places[along // 3, axis], 6)
            for place in np.unique(at):
                line = along[at == place]
                if len(line) < _LINE:
                    continue
                off = float(self.values[line].mean())
                sd = float(np.sqrt(np.square(self.sd[line]).mean() / len(line)))
                if best is None or abs(off) > best.size:
                    size = with_unit(abs(off), "m", 2, fine=True)
                    mm = with_unit(float(place), "m", 4)
                    words = f"the {what} at {'xy'[axis]} = {mm} is off by {size} in the mean"
                    best = TermPart((f"{what} {place:g}",), "m", abs(off), sd, None, words)
        return [] if best is None else [best]

    @property
    def sd(self) -> Array:
        """(m,) of the offsets [m], 0 of those that are none."""
        used, sd = np.flatnonzero(self.scales[self.layout.owner] > 0.0), np.zeros(len(self.index))
        if self.covariance is not None:
            sd[used] = np.sqrt(np.diag(self.covariance))
        return sd

    @cached_property
    def expected(self) -> Array:
        """(terms,) sds [m]: the learnt ones, and of terms that are not kept those that the images
        leave possible, by the odds that there is none and by what the likelihood gains."""
        if self.learnt is None or self.kept.all():
            return self.scales
        every = np.ones(len(self.learnt.at.x), dtype=bool)
        present = searched(self.learnt.system, self.learnt.at.x, every)
        against = [_NONE * math.exp(-0.5 * gain(present, i)) for i in range(len(self.scales))]
        return np.where(self.kept, self.scales, present.scales / np.sqrt(np.add(1.0, against)))

    def left(self) -> PrintedEntry | None:
        """What the offsets leave open beside the estimated parameters p; None without any.

        With H the sums and the priors, d errs by -H_dd^-1 H_dp dp, and by N(0, H_dd^-1) besides.
        """
        sds = self.expected[self.layout.owner]
        used = np.flatnonzero(sds > 0.0)
        if self.sums is None or not used.size:
            return None
        n = len(self.sums) - 1 - len(self.index)
        H = self.sums[np.ix_(n + used, n + used)] + np.diag(1.0 / np.square(sds[used]))
        covariance = _inverse(H)
        U, V = _shared_and_alone(H, covariance, used)
        return PrintedEntry(
            tuple(self.layout.names[i] for i in used),
            tuple(np.sqrt(np.diag(covariance)).tolist()),
            _rows(-covariance @ self.sums[n + used, :n]),
            _rows(U.T),
            _rows(V),
            tuple(sds[used].tolist()),
        )

    def gained(self, root: Array) -> Array | None:
        """(k, k) what the covariance of z gains by what the offsets leave open, dp = root z.

        All from the same sums: offsets take up so much of a shift of their board that sds which
        differ a little leave less than nothing.
        """
        sds = self.expected[self.layout.owner]
        used = np.flatnonzero(sds > 0.0)
        if self.sums is None or self.precision is None or not used.size:
            return None
        n = len(root)
        alone = root.T @ (self.sums[:n, :n] + np.diag(self.precision)) @ root
        B = root.T @ self.sums[:n, n + used]
        S = self.sums[np.ix_(n + used, n + used)] + np.diag(1.0 / np.square(sds[used]))
        left = alone - B @ np.linalg.solve(S, B.T)
        return np.asarray(np.linalg.inv(0.5 * (left + left.T)) - np.linalg.inv(alone))


def weighed(prints: Prints | None, system: Spectrum) -> Array:
    """(n, n) the covariance by which a fit weighed its prior: at the sds that it used, with what
    the points of prints leave open."""
    plain, root = system.covariance(), system.root
    gained = None if prints is None else prints.gained(root)
    return plain if gained is None else np.asarray(plain + root @ gained @ root.T)


def _nominal(problem: Problem) -> Array:
    """(n_all,) of all parameters."""
    return np.array([p.nominal for p in problem.mechanism.parameters])


def _rows(matrix: Array) -> tuple[tuple[float, ...], ...]:
    return tuple(map(tuple, matrix.tolist()))


def _shared_and_alone(H: Array, C: Array, used: NDArray[np.intp]) -> tuple[Array, Array]:
    """U (m, k) and V (m, 3) with C = H^-1 = U U^T + V V^T within each point, nearly.

    Images part a shift, turn or bend of all points from errors of joints by the priors alone: U
    holds the few ways in which points err together. used: number of each offset, x, y and z by
    point.
    """
    point, axis = used // 3, used % 3
    same = np.equal.outer(point, point)
    L = np.linalg.cholesky(np.linalg.inv(np.where(same, H, 0.0)))
    white = np.linalg.solve(L, np.linalg.solve(L, C).T) - np.eye(len(H))
    values, vectors = np.linalg.eigh(0.5 * (white + white.T))
    kept = values > _SHARED
    U = L @ (vectors[:, kept] * np.sqrt(values[kept]))
    alone = np.where(same, C - U @ U.T, 0.0)
    V = np.zeros((len(H), 3))
    for one in np.unique(point):
        rows = np.flatnonzero(point == one)
        values, vectors = np.linalg.eigh(alone[np.ix_(rows, rows)])
        V[np.ix_(rows, axis[rows])] = vectors * np.sqrt(np.maximum(values, 0.0))
    return U, V


def _inverse(H: Array) -> Array:
    """H^-1 over the directions that are determined."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(H), 1e-300))
    return np.asarray(np.linalg.pinv(H * np.outer(scale, scale), hermitian=True)) * np.outer(
        scale, scale
    )


def summed(
    problem: Problem,
    parameters: Array,
    corrections: Array,
    layout: Layout,
    index: NDArray[np.intp],
) -> Array:
    """[D O e]^T V^-1 [D O e] of all images, (n + m + 1, n + m + 1)."""
    sweeper, n, m = Sweeper(problem), len(problem.free), len(layout.names)
    total = np.zeros((n + m + 1, n + m + 1))
    loops = problem.mechanism.tape.loops
    for pattern, block in sweeper.blocks(parameters, corrections):
        values = sweeper.loop_values(pattern, block)
        turned = TurnedImages.of(values, block, exact=False)
        names = [loops[i] for i in pattern.loops]
        rows = [i for i, name in enumerate(names) if name in layout.by_loop]
        o = np.zeros((3, len(names), block.count))
        first = np.zeros(len(names), dtype=np.intp)
        first[rows] = [layout.by_loop[names[i]] for i in rows]
        for axis in range(3):
            ends = []
            for way in (1.0, -1.0):
                moved = block.parameters.copy()
                moved[index[axis::3]] += way * _STEP
                at = block.at(block.corrections, moved)
                ends.append(sweeper.loop_values(pattern, at, Stage.VALUES).f.copy())
            # each loop depends on the offsets of one point only, so that all points move at once
            o[axis] = (ends[0] - ends[1]) / (2.0 * _STEP)
        total += _of_block(values.by_parameter, turned, o, first, rows, m)
    return total


def _of_block(
    D: Array, turned: TurnedImages, o: Array, first: NDArray[np.intp], rows: list[int], m: int
) -> Array:
    """The sums of a block; o: (3, rows, b) derivatives by the offsets of a row's point."""
    weight = turned.weight
    q, b = turned.unmeasured + turned.shared, weight.shape[1]
    above = np.zeros((q, len(weight) + turned.shared, b))
    above[np.arange(q), np.arange(q)] = 1.0
    Q = turned.reflections.undo(above)[:, : len(weight)]
    A = np.concatenate([D, turned.misclosure[None]]) * weight
    o = o * weight
    incidence = np.zeros((m // 3, len(weight)))
    incidence[first[rows] // 3, rows] = 1.0

    def by_point(columns: Array) -> Array:
        """(c, m, b) sums over the rows of each point, of columns (c, rows, b)."""
        parts = [np.einsum("pr,crb->cpb", incidence, columns * one, optimize=True) for one in o]
        return np.stack(parts, axis=2).reshape(len(columns), m, b)

    QA = np.einsum("qrb,crb->qcb", Q, A, optimize=True)
    QO = by_point(Q)
    AO = np.stack([np.einsum("crb,rb->cr", A, one) @ incidence.T for one in o], axis=2)
    AO = AO.reshape(len(A), m) - np.tensordot(QA, QO, ((0, 2), (0, 2)))
    flat_A = A.reshape(len(A), -1)
    AA = flat_A @ flat_A.T - np.tensordot(QA, QA, ((0, 2), (0, 2)))
    OO = -np.tensordot(QO, QO, ((0, 2), (0, 2)))
    squares = np.einsum("arb,crb->acr", o, o) @ incidence.T
    place = 3 * np.arange(m // 3)
    for i in range(3):
        for j in range(3):
            OO[place + i, place + j] += squares[i, j]
    n = len(D)
    total = np.zeros((n + m + 1, n + m + 1))
    total[:n, :n], total[n : n + m, n : n + m] = AA[:n, :n], OO
    total[:n, -1] = total[-1, :n] = AA[:n, n]
    total[-1, -1] = AA[n, n]
    total[:n, n : n + m], total[n : n + m, :n] = AO[:n], AO[:n].T
    total[n : n + m, -1] = total[-1, n : n + m] = AO[n]
    return total
