"""The equations of a fit in the order of the poses, ready to be searched for steps.

Rows are the whitened equations E = Z z + v of each pose. Z holds the parameters and, where these
have none, smooth functions of the joints along each instrument's readings
(`mechanisms.structure.smooth`), whose variance is learnt by restricted likelihood: an arm that
bends must not look like steps where neighbouring poses are measured one after the other. The rows
are scaled by their own scatter, in every direction, and poses that fit badly count less (Huber), so
that neither an error of the model nor one outlier passes for a step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loopcal.chi_squared import tail
from loopcal.estimation.dependence.dependence import joint_rows, pose_order
from loopcal.estimation.dependence.seen import instruments, units_of
from loopcal.estimation.problem.pose_equations import rounding_left
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.result import Result
from loopcal.lazy import cached_property
from loopcal.mechanisms.structure.smooth import Smooth
from loopcal.mechanisms.structure.structured import DISCREPANCY

Array = NDArray[np.float64]
_HUBER, _ROUNDS = 2.0, 3
_RATIOS, _BESIDE = 10.0 ** np.arange(-4.0, 5.0), 10.0 ** np.arange(-1.0, 2.0)
_ENOUGH = 10
"""Poses for each equation of a pose, from which their scatter is taken as it is."""
_ABSORBED = 1e-6
"""What else the fit determines to less than this share cannot be told from a step."""


@dataclass(frozen=True, eq=False)
class OrderedSystem:
    """N poses in order with up to R equations each, missing ones zero.

    E: (N, R); Z: (N, R, m); D, X: (N, R, n), (N, R, k) of parameters and readings; P: (m, m) the
    precision of z, pull: (m,) P (nominal - present); patterns: (N,) poses with the same equations;
    rows: (N, R) which are there; smooth: the last so many columns of Z whose variance is learnt;
    rounding: mean square that rounding leaves in a row, below which no scatter is taken.
    """

    problem: Problem
    order: NDArray[np.intp]
    E: Array
    Z: Array
    D: Array
    X: Array
    P: Array
    pull: Array
    patterns: NDArray[np.intp]
    rows: NDArray[np.bool_]
    smooth: int
    rounding: float

    def columns(self, names: Sequence[str]) -> Array:
        """(N, R, d) of a change of these parameters or zeros of readings by one [SI]."""
        quantities = self.problem.mechanism.tape.quantities
        found = [
            -self.X[:, :, quantities.index(n)]
            if n in quantities
            else self.D[:, :, self.problem.names.index(n)]
            for n in names
        ]
        return np.stack(found, axis=2)

    def waves(self, count: int) -> list[Array]:
        """(N, R, q) each: slow cosines over the run along the readings of the instruments."""
        N, names = len(self.E), self.problem.mechanism.tape.quantities
        readings = [q for family in instruments(self.problem) for q in family.readings]
        along = self.columns(readings) * units_of(self.problem, [names.index(q) for q in readings])
        phase = np.pi * (np.arange(N) + 0.5) / N
        return [np.cos(j * phase)[:, None, None] * along for j in range(1, count + 1)]

    def fitted_with(self, steps: Sequence[Array]) -> Fitted:
        """The system with further columns (N, R, d) each, scaled by what it leaves."""
        Z = np.concatenate([*steps, self.Z], axis=2)
        more = Z.shape[2] - self.Z.shape[2]
        P, pull = np.pad(self.P, ((more, 0), (more, 0))), np.pad(self.pull, (more, 0))
        left, weights, used, ratios = self.E, np.ones(len(Z)), 0.0, _RATIOS
        for _ in range(_ROUNDS):
            T = weights[:, None, None] * self._whitening(left, weights, used)
            E, scaled = np.einsum("nrs,ns->nr", T, self.E), T @ Z
            fit = _ridge(E, scaled, P, pull, self.smooth, ratios)
            left, used = self.E - Z @ fit.z, fit.used
            ratios = fit.ratio * _BESIDE
            away = np.square(np.einsum("nrs,ns->nr", T, left)).sum(axis=1)
            away = np.sqrt(away / np.maximum(self.rows.sum(axis=1), 1)) / weights
            weights = np.sqrt(np.minimum(1.0, _HUBER / np.maximum(away, 1e-300)))
        count = np.maximum(self.rows.sum(axis=1), 1)
        p_values = tail(np.square(away) * count, count)
        return Fitted(T, E - scaled @ fit.z, scaled, fit.root, p_values)

    def _whitening(self, left: Array, weights: Array, used: float) -> Array:
        """(N, R, R) S^(-1/2) of each pose, S the scatter of what is left in poses like it."""
        T = np.zeros((*left.shape, left.shape[1]))
        count = float(self.rows.sum())
        freedom = max(count - used, 0.1 * count) / count
        alone = float(np.square(weights[:, None] * left).sum() / count) / freedom
        for pattern in np.unique(self.patterns):
            here = self.patterns == pattern
            there = np.flatnonzero(self.rows[here][0])
            if not there.size:  # poses in which no loop holds
                continue
            S = alone * np.eye(len(there))
            poses, few = int(here.sum()), _ENOUGH * len(there)
            if poses > 2 * len(there):
                own = weights[here, None] * left[np.ix_(here, there)]
                # of few poses partly as if the rows were alike: their scatter is unsure itself
                share = min(1.0, poses / few)
                S = share * own.T @ own / poses / freedom + (1.0 - share) * S
            values, vectors = np.linalg.eigh(S)
            least = max(1e-12 * float(values.max(initial=0.0)), self.rounding)
            values = np.maximum(values, least or 1.0)  # where nothing is left, any scale will do
            root = (vectors / np.sqrt(values)) @ vectors.T
            T[np.ix_(here, there, there)] = root
        return T


@dataclass(frozen=True, eq=False)
class Fitted:
    """A fit of an ordered system: T (N, R, R) scales the rows; left (N, R) and Z (N, R, m) are
    scaled; root (m, k): H^-1 = root root^T; p_values: (N,) of what is left of each pose."""

    T: Array
    left: Array
    Z: Array
    root: Array
    p_values: Array

    def gains(self, columns: Array) -> tuple[Array, NDArray[np.intp]]:
        """The gain (N,) of a step of these columns (N, R, d) from each pose on, and its rank."""
        C, _ = self._scaled(columns)
        u, A, own = self._sums(*(np.cumsum(part[::-1], axis=0)[::-1] for part in self._products(C)))
        values, vectors = np.linalg.eigh(A)
        kept = values > _ABSORBED * np.maximum(own, 1e-300)[:, None]
        along = np.einsum("nij,ni->nj", vectors, u)
        gains = np.where(kept, np.square(along) / np.where(kept, values, 1.0), 0.0).sum(axis=1)
        return gains, kept.sum(axis=1)

    def step(self, columns: Array) -> Step:
        """What these columns (N, R, d) explain."""
        C, scale = self._scaled(columns)
        u, A, own = self._sums(*(part.sum(axis=0)[None] for part in self._products(C)))
        values, vectors = np.linalg.eigh(A[0])
        kept = values > _ABSORBED * max(float(own[0]), 1e-300)
        root = vectors[:, kept] / np.sqrt(values[kept])
        along = root.T @ u[0]
        root = scale[:, None] * root
        return Step(float(along @ along), int(kept.sum()), root @ along, root @ root.T)

    def _scaled(self, columns: Array) -> tuple[Array, Array]:
        C = self.T @ columns
        length = np.sqrt(np.square(C).sum(axis=(0, 1)))
        scale = 1.0 / np.where(length > 0.0, length, 1.0)
        return C * scale, scale

    def _products(self, C: Array) -> tuple[Array, Array, Array]:
        turned = C.transpose(0, 2, 1)
        return np.einsum("ndr,nr->nd", turned, self.left), turned @ C, turned @ self.Z

    def _sums(self, u: Array, Q: Array, U: Array) -> tuple[Array, Array, Array]:
        W = (U.reshape(-1, U.shape[2]) @ self.root).reshape(*U.shape[:2], -1)
        return u, Q - W @ W.transpose(0, 2, 1), np.einsum("ndd->n", Q)


@dataclass(frozen=True)
class Step:
    """A step: gain in chi-squared, rank, size (d,) and covariance (d, d) [SI]."""

    gain: float
    rank: int
    size: Array
    covariance: Array


@dataclass(frozen=True)
class _Ridge:
    """z (m,), the degrees of freedom that the fit uses, the variance of smooth columns over that of
    a row, and the factor of H, whose rows and columns are scaled."""

    z: Array
    used: float
    ratio: float
    factor: _Factor
    scale: Array

    @property
    def root(self) -> Array:
        """(m, k) with H^-1 = root root^T."""
        return self.scale[:, None] * self.factor.root


def _ridge(E: Array, Z: Array, P: Array, pull: Array, smooth: int, ratios: Array) -> _Ridge:
    """The fit of unit variance; the smooth columns' variance by restricted likelihood."""
    m = Z.shape[2]
    flat, e = Z.reshape(-1, m), E.ravel()
    ZZ, g = flat.T @ flat, flat.T @ e + pull
    scale = 1.0 / np.sqrt(np.maximum(np.diag(ZZ) + np.diag(P), 1e-300))
    size = np.trace(ZZ[m - smooth :, m - smooth :]) / max(len(e) * smooth, 1)
    scaled = (ZZ + P) * scale * scale[:, None]
    best, least, at = None, np.inf, 1.0
    for ratio in ratios.tolist() if smooth else (1.0,):
        precision = np.zeros(m)
        precision[m - smooth :] = max(size, 1e-300) / ratio
        H = scaled.copy()
        H.reshape(-1)[:: m + 1] += precision * np.square(scale)
        factor = _Factor.of(H)
        z = factor.solved(scale * g)
        criterion = factor.log_determinant - float(z @ (scale * g))
        criterion -= float(np.log(precision[m - smooth :]).sum())
        if criterion < least:
            best, least, at, found, added = factor, criterion, ratio, z, precision
    assert best is not None
    held = (np.diag(P) + added) * np.square(scale)  # P is diagonal
    used = len(best.values) - float(best.variances @ held)
    return _Ridge(scale * found, used, at, best, scale)


@dataclass(frozen=True, eq=False)
class _Factor:
    """H = L L^T, or its eigenvectors where a direction is not determined.

    By NumPy alone: the search for changes runs in every calibration, and is over before SciPy is
    loaded.
    """

    H: Array
    L: Array | None
    values: Array
    vectors: Array

    @classmethod
    def of(cls, H: Array) -> _Factor:
        none = np.zeros((0, 0))
        try:
            L = np.asarray(np.linalg.cholesky(H), dtype=np.float64)
            if float(np.diag(L).min()) > _ABSORBED * float(np.diag(L).max()):
                return cls(H, L, np.diag(L), none)
        except np.linalg.LinAlgError:
            pass
        values, vectors = np.linalg.eigh(H)
        kept = values > 1e-11 * values[-1]
        return cls(H, None, np.sqrt(values[kept]), vectors[:, kept])

    @property
    def log_determinant(self) -> float:
        return 2.0 * float(np.log(self.values).sum())

    @cached_property
    def root(self) -> Array:
        """(m, k) with H^-1 = root root^T."""
        if self.L is None:
            return self.vectors / self.values
        return np.asarray(np.linalg.inv(self.L.T))

    @property
    def variances(self) -> Array:
        """(m,) the diagonal of H^-1."""
        return np.asarray(np.square(self.root).sum(axis=1))

    def solved(self, g: Array) -> Array:
        """H^-1 g."""
        if self.L is None:
            return np.asarray(self.root @ (self.root.T @ g))
        return np.asarray(np.linalg.solve(self.H, g))


def ordered_system(result: Result) -> OrderedSystem:
    """The system of a calibration in memory."""
    problem, solution = result.problem, result.solution
    exact, equations = result.fit.solver.exact, result.pose_equations()
    N, n, k = len(problem.poses), len(problem.free), len(problem.readings)
    R = max((block.E.shape[1] for block in equations), default=0)
    E, D, X = np.zeros((N, R)), np.zeros((N, R, n)), np.zeros((N, R, k))
    rows, patterns = np.zeros((N, R), dtype=bool), np.zeros(N, dtype=np.intp)
    for block in equations:
        r, here = block.E.shape[1], block.poses
        E[here, :r], D[here, :r], X[here, :r], rows[here, :r] = block.E, block.D, block.X, True
        patterns[here] = r
    X[
        np.isinf(np.broadcast_to(problem.uncertainty.sd, problem.readings.shape))
        .T[:, None, :]
        .repeat(R, 1)
    ] = 0.0
    B = _smooth_columns(problem, X)
    m = n + B.shape[2]
    precision = np.zeros(n) if exact else 1.0 / np.square(problem.prior_sd)
    pull = np.where(
        precision > 0.0, precision * (problem.nominal - solution.parameters[problem.free]), 0.0
    )
    order = pose_order(problem)
    Z = np.concatenate([D, B], axis=2)
    P = np.zeros((m, m))
    P[np.arange(n), np.arange(n)] = precision
    return OrderedSystem(
        problem,
        order,
        E[order],
        Z[order],
        D[order],
        X[order],
        P,
        np.pad(pull, (0, m - n)),
        patterns[order],
        rows[order],
        B.shape[2],
        rounding_left(problem, equations),
    )


def _smooth_columns(problem: Problem, X: Array) -> Array:
    """(N, R, m) smooth functions of the joints along the readings of each instrument."""
    mechanism, names = problem.mechanism, problem.mechanism.tape.quantities
    joints = joint_rows(problem)
    if not joints or DISCREPANCY in {term.name for term in mechanism.learnt_terms}:
        return np.zeros((*X.shape[:2], 0))
    smooth = Smooth.of([(names[i], mechanism.quantities[names[i]]) for i in joints], {})
    features = np.array(smooth.features({names[i]: problem.readings[i] for i in joints}))
    columns = []
    for family in instruments(problem):
        rows = [names.index(q) for q in family.readings]
        along = X[:, :, rows] * units_of(problem, rows)
        columns.append(along[:, :, :, None] * features.T[:, None, None, :])
    return np.concatenate([c.reshape(*X.shape[:2], -1) for c in columns], axis=2)
