"""The equations of a fit in the order of the poses, ready to be searched for steps.

Rows are the whitened equations E = Z z + v of each pose. Z holds the parameters and, where these
have none, smooth functions of the joints along each instrument's readings
(`mechanisms.structure.smooth`), whose variance is learnt by restricted likelihood: an arm that
bends must not look like steps where neighbouring poses are measured one after the other. The rows
are scaled by their own scatter, in every direction, and poses that fit badly count less (Huber), so
that neither an error of the model nor one outlier passes for a step.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.chi_squared import tail
from loopcal.estimation.dependence.dependence import joint_rows, pose_order
from loopcal.estimation.dependence.seen import Errors, instruments
from loopcal.estimation.problem.pose_equations import rounding_left
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.products import rows_times
from loopcal.estimation.result import FitResult
from loopcal.lazy import cached_property
from loopcal.mechanisms.structure.smooth import DISCREPANCY, Smooth
from loopcal.statistics.estimated import Estimated
from loopcal.statistics.possible_changes import held_station
from loopcal.statistics.replacing import IN_PROPORTION

# Chosen, not derived: from two sds on a pose counts less, in so many rounds of weights.
_HUBER, _ROUNDS = 2.0, 3
# By decades: over all sizes at first, then beside the last one. Chosen, not derived.
_RATIOS, _BESIDE = 10.0 ** np.arange(-4.0, 5.0), 10.0 ** np.arange(-1.0, 2.0)
# An sd from ten values is sure to 1 / sqrt(20) = 22 %: chosen, not derived.
_ENOUGH = 10
"""Poses for each equation of a pose, from which their scatter is taken as it is."""
_ABSORBED = 1e-4
"""A step that the fit takes up but for this share cannot be told from it: columns stand at the
corrected readings, which follow the errors, and what is left of them may be these alone."""

_HELD = 1e6
"""Precision of what is held, over that which the readings give it."""
# Chosen, not derived: large enough for the products to be fast.
_PART = 256
"""Poses whose columns are made at a time, for an array of all is large."""


@dataclass(frozen=True, eq=False)
class OrderedSystem:
    """N poses in order with up to R equations each, missing ones zero.

    E: (N, R); Z: (N, R, m); D, X: (N, R, n), (N, R, k) of parameters and readings; precision: (m,)
    of z, pull: (m,) precision (nominal - present); patterns: (N,) poses with the same equations,
    negative for images, each of which is turned by itself; rows: (N, R) which are there; count:
    (N,) equations, those with them that an image leaves out; smooth: the last so many columns of Z
    whose variance is learnt; rounding: mean square that rounding leaves in a row, below which no
    scatter is taken.
    """

    problem: Problem
    order: NDArray[np.intp]
    E: Array
    Z: Array
    D: Array
    X: Array
    precision: Array
    pull: Array
    patterns: NDArray[np.intp]
    rows: NDArray[np.bool_]
    count: NDArray[np.intp]
    smooth: int
    rounding: float

    def in_order(self) -> OrderedSystem:
        """With smooth columns, and the poses as they were measured."""
        order = pose_order(self.problem)
        # Poses as they were measured are the rule: their columns are large, and no copy is made.
        at = slice(None) if np.array_equal(order, self.order) else order
        X, Z = self.X[at], self.Z[at]
        smooth = _smooth_columns(self.problem, X, order)
        more = sum(B.shape[2] for B in smooth)
        if smooth:
            Z = np.concatenate([Z, *smooth], axis=2)
        return replace(
            self,
            order=order,
            E=self.E[at],
            Z=Z,
            D=Z[:, :, : self.D.shape[2]] if self.Z is self.D else self.D[at],
            X=X,
            precision=np.pad(self.precision, (0, more)),
            pull=np.pad(self.pull, (0, more)),
            patterns=self.patterns[at],
            rows=self.rows[at],
            count=self.count[at],
            smooth=more,
        )

    def columns(self, names: Sequence[str]) -> Array:
        """(N, R, d) of a change of these parameters, zeros of readings or readings in proportion by
        one [SI]: of a joint what its true value exceeds the reading by, of an instrument what the
        reading exceeds its true value by."""
        quantities, joints = self.problem.mechanism.tape.quantities, joint_rows(self.problem)
        changes = []
        for n in names:
            if (stem := n.removesuffix(IN_PROPORTION)) != n:
                i = quantities.index(stem)
                read = self.problem.readings[i, self.order]
                changes.append(self.X[:, :, i] * read[:, None])
            elif n in quantities:
                i = quantities.index(n)
                changes.append(self.X[:, :, i] * (1.0 if i in joints else -1.0))
            elif n in self.problem.names:
                changes.append(self.D[:, :, self.problem.names.index(n)])
            else:
                changes.append(self._held_station[n])
        return np.stack(changes, axis=2)

    @cached_property
    def _held_station(self) -> dict[str, Array]:
        """Columns (N, R) of a station that is not estimated.

        A small motion moves a point p by t + w x p, as zeros of its readings.
        """
        mechanism = self.problem.mechanism
        (family,) = mechanism.families
        rows = [mechanism.tape.quantities.index(q) for q in family.readings]
        p = np.nan_to_num(self.problem.readings[rows][:, self.order].T)
        along, axes = self.columns(family.readings), np.eye(3)
        # Turns last axis first, as a station orders its parameters.
        motions = [*(np.broadcast_to(t, p.shape) for t in axes)]
        motions += [np.cross(w, p) for w in axes[::-1]]
        each = [np.einsum("nri,ni->nr", along, motion) for motion in motions]
        return dict(zip(held_station(self.problem), each, strict=True))

    def waves(self, count: int) -> list[Array]:
        """(N, R, q) each: slow cosines over the run along the readings of the instruments."""
        N = len(self.E)
        readings = [q for family in instruments(self.problem) for q in family.readings]
        along = self.columns(readings) @ Errors.of(self.problem, readings).modes
        # The cosines of DCT-II: orthogonal to each other and to a constant over the poses.
        phase = np.pi * (np.arange(N) + 0.5) / N
        return [np.cos(j * phase)[:, None, None] * along for j in range(1, count + 1)]

    def play(self) -> Array:
        """(N, R, j) of play in each joint: half of it behind the way from the pose before."""
        rows = joint_rows(self.problem)
        ways = np.sign(np.diff(self.problem.readings[rows][:, self.order], prepend=np.nan))
        ways = np.nan_to_num(ways).T
        return np.asarray(self.X[:, :, rows] * ways[:, None, :])

    @cached_property
    def equations(self) -> NDArray[np.intp]:
        """(N,) rows of each pose, at least 1."""
        return np.asarray(np.maximum(self.count, 1), dtype=np.intp)

    def fitted(self) -> Fitted:
        """The system scaled by what its fit leaves."""
        alike = np.ones(len(self.E))
        T = self.whitening(self.E, alike, float(self.count.sum()))
        fit = _scaled(self, self.Z[:, :, :0], T, alike, _RATIOS)
        for _ in range(_ROUNDS - 1):
            fit = fit.again()
        return fit

    def whitening(self, left: Array, weights: Array, spare: float) -> Array:
        """(N, R, R) S^(-1/2) of each pose, S the scatter of what is left in poses like it.

        spare: degrees of freedom that are left.
        """
        T = np.zeros((*left.shape, left.shape[1]))
        count = float(self.count.sum())
        freedom = spare / count
        alone = float(np.square(weights[:, None] * left).sum() / count) / freedom
        for pattern in np.unique(self.patterns):
            alike = self.patterns == pattern
            loops = np.flatnonzero(self.rows[alike][0])
            if not loops.size:  # poses in which no loop holds
                continue
            S = alone * np.eye(len(loops))
            poses, few = int(alike.sum()), _ENOUGH * len(loops)
            # The scatter of few poses has directions that are nearly zero by chance.
            if pattern > 0 and poses > 2 * len(loops):
                weighted = weights[alike, None] * left[np.ix_(alike, loops)]
                # of few poses partly as if the rows were alike: their scatter is unsure itself
                share = min(1.0, poses / few)
                S = share * weighted.T @ weighted / poses / freedom + (1.0 - share) * S
            values, vectors = np.linalg.eigh(S)
            least = max(1e-12 * float(values.max(initial=0.0)), self.rounding)
            values = np.maximum(values, least or 1.0)  # where nothing is left, any scale will do
            root = (vectors / np.sqrt(values)) @ vectors.T
            T[np.ix_(alike, loops, loops)] = root
        return T


@dataclass(frozen=True, eq=False)
class Fitted:
    """A fit of an ordered system with further columns, its rows scaled.

    more: (N, R, d) the further columns, which stand before those of the system in Z (N, R, m); T:
    (N, R, R) what scales the rows; weights: (N,) the poses' part in it; ratio: the variance of
    smooth columns over that of a row; precision, pull: (m,) of z; products: (m, m) of T Z. Neither
    Z nor T Z is kept, each of which is as large as all else.
    """

    system: OrderedSystem
    more: Array
    T: Array
    weights: Array
    ratio: float
    precision: Array
    pull: Array
    products: Array

    @cached_property
    def z(self) -> Array:
        """(m,) where the fit ends."""
        return self._factor.solved(self._drawn)

    @cached_property
    def _drawn(self) -> Array:
        """(m,) H z."""
        back = np.einsum("nsr,ns->nr", self.T, self.E)
        return np.asarray(self._onto(back[:, :, None])[:, 0] + self.pull)

    @property
    def further(self) -> int:
        """How many columns there are beside those of the system."""
        return int(self.more.shape[2])

    @cached_property
    def E(self) -> Array:
        """(N, R) scaled."""
        return np.asarray(np.einsum("nrs,ns->nr", self.T, self.system.E))

    @cached_property
    def left(self) -> Array:
        """(N, R) what the fit leaves, scaled."""
        return np.asarray(np.einsum("nrs,ns->nr", self.T, self._unscaled))

    @cached_property
    def _unscaled(self) -> Array:
        """(N, R) what the fit leaves of E."""
        d = self.further
        return np.asarray(self.system.E - self.more @ self.z[:d] - self.system.Z @ self.z[d:])

    def _onto(self, rows: Array) -> Array:
        """(m, k) Z^T rows over all poses, rows (N, R, k)."""
        both = ((0, 1), (0, 1))
        return np.concatenate([np.tensordot(Z, rows, both) for Z in (self.more, self.system.Z)])

    @property
    def criterion(self) -> float:
        """The restricted likelihood of the smooth columns' variance, times -2."""
        # -2 log of it but for E^T E, which no ratio changes: log|H| - log|P| - z^T H z.
        smooth = self.precision[len(self.pull) - self.system.smooth :]
        return (
            self._factor.log_determinant - float(self.z @ self._drawn) - float(np.log(smooth).sum())
        )

    @cached_property
    def spare(self) -> float:
        """Degrees of freedom that are left."""
        count = float(self.system.count.sum())
        # tr(H^-1 (H - P)) = rank - tr(H^-1 P); a tenth at least, for few spare rows show no scale.
        used = len(self._factor.values) - float(self._factor.variances @ self.precision)
        return max(count - used, 0.1 * count)

    @cached_property
    def squares(self) -> float:
        """What the fit leaves, with what it costs to move from what is known beforehand."""
        known = self.precision > 0.0
        away = np.sqrt(self.precision[known]) * self.z[known]
        away -= self.pull[known] / np.sqrt(self.precision[known])
        return float(np.square(self.left).sum() + np.square(away).sum())

    @property
    def p_values(self) -> Array:
        """(N,) of what is left of each pose."""
        count = self.system.equations
        return tail(np.square(self._away) * count, count)

    def again(self) -> Fitted:
        """The same columns, the rows scaled by what this fit leaves."""
        # Huber's weight is one of squares: its root weighs the rows.
        weights = np.sqrt(np.minimum(1.0, _HUBER / np.maximum(self._away, 1e-300)))
        T = self.system.whitening(self._unscaled, weights, self.spare)
        return _scaled(self.system, self.more, T, weights, self.ratio * _BESIDE)

    def beside(self, columns: Array) -> Fitted:
        """The fit with further columns (N, R, d) before the others, rows scaled as they are."""
        # Only the border of the products is summed over the poses (record 0061).
        d = columns.shape[2]
        C = self.T @ columns
        U = self._onto(self.T.transpose(0, 2, 1) @ C).T
        Q = np.tensordot(C, C, axes=((0, 1), (0, 1)))
        return replace(
            self,
            more=np.concatenate([columns, self.more], axis=2),
            precision=np.pad(self.precision, (d, 0)),
            pull=np.pad(self.pull, (d, 0)),
            products=np.block([[Q, U], [U.T, self.products]]),
        )

    def held(self, names: Sequence[str]) -> Fitted:
        """The fit with these parameters at their nominal values, rows scaled as they are."""
        if not names:
            return self
        at = self.further + np.array([self.system.problem.names.index(n) for n in names])
        precision, pull = self.precision.copy(), self.pull.copy()
        precision[at] = np.maximum(_HELD * np.diag(self.products)[at], precision[at])
        pull[at] *= precision[at] / self.precision[at]
        return replace(self, precision=precision, pull=pull)

    def without(self, first: int, count: int) -> Fitted:
        """The fit without some of its further columns, rows scaled as they are."""
        gone = np.s_[first : first + count]
        return replace(
            self,
            more=np.delete(self.more, gone, axis=2),
            precision=np.delete(self.precision, gone),
            pull=np.delete(self.pull, gone),
            products=np.delete(np.delete(self.products, gone, axis=0), gone, axis=1),
        )

    def gains(self, columns: Array) -> tuple[Array, NDArray[np.intp]]:
        """The gain (N,) of a step of these columns (N, R, d) from each pose on, and its rank."""
        C, _ = self._alike(columns)
        turned = C.transpose(0, 2, 1)
        u = np.cumsum(np.einsum("ndr,nr->nd", turned, self.left)[::-1], axis=0)[::-1]
        Q = np.cumsum((turned @ C)[::-1], axis=0)[::-1]
        taken, carried = np.empty(Q.shape), np.zeros(())
        for part in reversed(_parts(len(C))):
            W = turned[part] @ self._absorbing[part]
            W[-1] += carried
            for after, row in zip(W[:0:-1], W[-2::-1], strict=True):  # sooner than np.cumsum
                row += after
            taken[part], carried = W @ W.transpose(0, 2, 1), W[0]
        values, vectors = np.linalg.eigh(Q - taken)
        kept = values > _ABSORBED * np.maximum(np.einsum("ndd->n", Q), 1e-300)[:, None]
        along = np.einsum("nij,ni->nj", vectors, u)
        gains = np.where(kept, np.square(along) / np.where(kept, values, 1.0), 0.0).sum(axis=1)
        return gains, kept.sum(axis=1)

    def step(self, columns: Array, absorbed: float = _ABSORBED) -> Estimated:
        """What these columns (N, R, d) explain; absorbed: share that all else must leave."""
        C, scale = self._alike(columns)
        flat = C.reshape(-1, C.shape[2])
        Q, W = flat.T @ flat, self._onto(self.T.transpose(0, 2, 1) @ C).T @ self._factor.root
        least = absorbed * max(float(np.trace(Q)), 1e-300)
        return Estimated.of(flat.T @ self.left.ravel(), Q - W @ W.T, scale, least)

    def steps(self, column: Array, waves: Sequence[Array]) -> list[Estimated]:
        """As `step` of a column (N, R) times each of these functions (N, d) of the pose."""
        c = (self.T @ column[:, :, None])[:, :, 0]
        turned = np.einsum("nsr,ns->nr", self.T, c)[:, None, :]
        onto = np.concatenate([(turned @ Z)[:, 0] for Z in (self.more, self.system.Z)], axis=1)
        along, squares = (c * self.left).sum(axis=1), np.square(c).sum(axis=1)
        W = np.concatenate(waves, axis=1).T @ onto @ self._factor.root
        made, first = [], 0
        for wave in waves:
            length = np.sqrt(squares @ np.square(wave))
            scale = 1.0 / np.where(length > 0.0, length, 1.0)
            Q = (wave * scale).T @ (squares[:, None] * wave * scale)
            taken = scale[:, None] * W[first : first + len(scale)]
            first += len(scale)
            least = _ABSORBED * max(float(np.trace(Q)), 1e-300)
            score = scale * (along @ wave)
            made.append(Estimated.of(score, Q - taken @ taken.T, scale, least))
        return made

    def by_pose(self, column: Array) -> tuple[Array, Array]:
        """(N,) each: the products with what is left, and with itself, of what all else leaves of a
        column (N, R, 1)."""
        C = (self.T @ column)[:, :, 0]
        C = C - self._absorbing @ np.einsum("nrk,nr->k", self._absorbing, C)
        return np.einsum("nr,nr->n", C, self.left), np.square(C).sum(axis=1)

    def kept_by(self, column: Array, priors: Sequence[int]) -> float:
        """How much of the information on a column (N, R, 1) is of the priors of these parameters:
        sum p_i d_i^2, d = -H^-1 Z^T T^T T C what all of them do where the column is one."""
        turned = self.T.transpose(0, 2, 1)
        moved = self._factor.solved(self._onto(turned @ (self.T @ column))[:, 0])
        at = self.further + np.asarray(priors)
        return float(self.precision[at] @ np.square(moved[at]))

    @cached_property
    def _factor(self) -> _Factor:
        """Of the products and the precision."""
        return _Factor.of(self.products, self.precision)

    @cached_property
    def _absorbing(self) -> Array:
        """(N, R, k) V with T Z H^-1 Z^T T^T = V V^T."""
        root = self._factor.root
        V = np.empty((*self.E.shape, root.shape[1]))
        for part, scaled in _in_parts(self.system, self.more, self.T):
            V[part] = rows_times(scaled, root)
        return V

    @cached_property
    def _away(self) -> Array:
        """(N,) root mean square that is left of each pose, as if it had its whole weight."""
        squares = np.square(self.left).sum(axis=1) / self.system.equations
        return np.asarray(np.sqrt(squares) / self.weights)

    def _alike(self, columns: Array) -> tuple[Array, Array]:
        """Scaled columns of unit length, and what made them so (d,)."""
        C = self.T @ columns
        # Metres and radians side by side: the share _ABSORBED has a meaning for columns alike.
        length = np.sqrt(np.square(C).sum(axis=(0, 1)))
        scale = 1.0 / np.where(length > 0.0, length, 1.0)
        return C * scale, scale


def _scaled(system: OrderedSystem, more: Array, T: Array, weights: Array, ratios: Array) -> Fitted:
    """The fit of unit variance; the smooth columns' variance by restricted likelihood."""
    d, smooth = more.shape[2], system.smooth
    stated, pull = np.pad(system.precision, (d, 0)), np.pad(system.pull, (d, 0))
    m, T = len(pull), weights[:, None, None] * T
    products = np.zeros((m, m))
    for _, scaled in _in_parts(system, more, T):
        flat = scaled.reshape(-1, m)
        products += flat.T @ flat
    fit = Fitted(system, more, T, weights, 1.0, stated, pull, products)
    size = np.trace(products[m - smooth :, m - smooth :]) / max(int(system.count.sum()) * smooth, 1)

    def with_ratio(ratio: float) -> Fitted:
        precision = stated.copy()
        precision[m - smooth :] += max(size, 1e-300) / ratio
        return replace(fit, ratio=ratio, precision=precision)

    # One after the other: each holds several matrices of all columns.
    tried = map(with_ratio, ratios.tolist() if smooth else [])
    return min(tried, key=lambda one: one.criterion, default=fit)


def _in_parts(system: OrderedSystem, more: Array, T: Array) -> Iterator[tuple[slice, Array]]:
    """Some poses after others, with their T Z."""
    for part in _parts(len(T)):
        yield part, T[part] @ np.concatenate([more[part], system.Z[part]], axis=2)


def _parts(poses: int) -> list[slice]:
    return [slice(begin, begin + _PART) for begin in range(0, poses, _PART)]


@dataclass(frozen=True, eq=False)
class _Factor:
    """H = L L^T, its rows and columns scaled, or its eigenvectors where a direction is not
    determined.

    By NumPy alone: the search for changes runs in every calibration, and is over before SciPy is
    loaded.
    """

    H: Array
    scale: Array
    L: Array | None
    values: Array
    vectors: Array

    @classmethod
    def of(cls, products: Array, precision: Array) -> _Factor:
        """Of H = products + precision."""
        H = products.copy()
        H.reshape(-1)[:: len(H) + 1] += precision
        # A diagonal of ones frees factor and limits from the units of the parameters.
        scale = 1.0 / np.sqrt(np.maximum(np.diag(H), 1e-300))
        H *= scale * scale[:, None]
        try:
            L = np.asarray(np.linalg.cholesky(H), dtype=np.float64)
            # Cholesky accepts pivots that are rounding alone, whose inverse would be noise.
            if float(np.diag(L).min()) > _ABSORBED * float(np.diag(L).max()):
                return cls(H, scale, L, np.diag(L), np.zeros((0, 0)))
        except np.linalg.LinAlgError:
            pass
        values, vectors = np.linalg.eigh(H)
        kept = values > 1e-11 * values[-1]
        return cls(H, scale, None, np.sqrt(values[kept]), vectors[:, kept])

    @property
    def log_determinant(self) -> float:
        """Of H, along what is determined."""
        return 2.0 * float(np.log(self.values).sum() - np.log(self.scale).sum())

    @cached_property
    def root(self) -> Array:
        """(m, k) with H^-1 = root root^T."""
        if self.L is None:
            return np.asarray(self.scale[:, None] * (self.vectors / self.values))
        return np.asarray(self.scale[:, None] * np.linalg.inv(self.L.T))

    @property
    def variances(self) -> Array:
        """(m,) the diagonal of H^-1."""
        return np.asarray(np.square(self.root).sum(axis=1))

    def solved(self, g: Array) -> Array:
        """H^-1 g."""
        if self.L is None:
            return np.asarray(self.root @ (self.root.T @ g))
        return np.asarray(self.scale * np.linalg.solve(self.H, self.scale * g))


def ordered_system(result: FitResult) -> OrderedSystem:
    """The system of a calibration in memory."""
    problem, solution = result.problem, result.solution
    equations, precision = result.pose_equations(bare=True), problem.precision
    N, n, k = len(problem.poses), len(problem.free), len(problem.readings)
    R = max((block.E.shape[1] for block in equations), default=0)
    E, D, X = np.zeros((N, R)), np.zeros((N, R, n)), np.zeros((N, R, k))
    rows, patterns = np.zeros((N, R), dtype=bool), np.zeros(N, dtype=np.intp)
    count = np.zeros(N, dtype=np.intp)
    for block in equations:
        r, poses = block.E.shape[1], block.poses
        E[poses, :r], D[poses, :r], X[poses, :r], rows[poses, :r] = block.E, block.D, block.X, True
        patterns[poses], count[poses] = r, r
        if block.beside is not None:
            patterns[poses], count[poses] = -r, block.count
    X[
        np.isinf(np.broadcast_to(problem.uncertainty.sd, problem.readings.shape))
        .T[:, None, :]
        .repeat(R, 1)
    ] = 0.0
    pull = np.where(
        precision > 0.0, precision * (problem.nominal - solution.parameters[problem.free]), 0.0
    )
    rounding = rounding_left(problem, equations)
    del equations, block  # as large as what was made of them
    as_read = np.arange(N)
    made = OrderedSystem(
        problem, as_read, E, D, D, X, precision, pull, patterns, rows, count, 0, rounding
    )
    return made.in_order()


def _smooth_columns(problem: Problem, X: Array, order: NDArray[np.intp]) -> list[Array]:
    """(N, R, m) each: smooth functions of the joints along the readings of an instrument; X: of
    the poses in this order."""
    mechanism, names = problem.mechanism, problem.mechanism.tape.quantities
    joints = joint_rows(problem)
    # The discrepancy of a structured fit is among the parameters already (record 0046).
    if not joints or DISCREPANCY in {term.name for term in mechanism.learnt_terms}:
        return []
    smooth = Smooth.of([(names[i], mechanism.quantities[names[i]]) for i in joints], {})
    features = np.array(smooth.features({names[i]: problem.readings[i, order] for i in joints}))
    columns = []
    for family in instruments(problem):
        errors = Errors.of(problem, family.readings)
        along = X[:, :, errors.rows] @ errors.modes
        each = along[:, :, :, None] * features.T[:, None, None, :]
        columns.append(each.reshape(*X.shape[:2], -1))
    return columns
