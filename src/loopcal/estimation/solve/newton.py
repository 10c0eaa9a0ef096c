"""Closing stubborn loops: the nearest closed point of a pose by Newton's method.

Gauss-Newton leaves out the curvature of the loops. Where a pose is far from closing, or stretched,
that curvature outweighs everything and Gauss-Newton circles. Here, for each pose,

    minimise |M y|^2 / 2  subject to  f(reading + T y) = 0

with second derivatives from the tape: T scales to sds (unmeasured quantities, which cost nothing
and have no row in M, to a millimetre or milliradian), steps split into a normal part that closes
the linearised loops and a tangential part through the reduced Hessian of the Lagrangian, whose
eigenvalues are made positive, and a line search keeps the exact penalty function falling.
Nocedal and Wright, Numerical Optimization, 2nd ed. (2006), chapter 18.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.estimation.solve.block import Block, BlockNoise
from loopcal.estimation.solve.gauss_newton import UNMEASURED_SCALE, Closed
from loopcal.expressions.derivative import lagrangian_gradient
from loopcal.expressions.engine import Engine, Stage, engine_for
from loopcal.expressions.tape import Tape

# Chosen, not derived: a cap of the iterations, and poses whose second derivatives fit the cache.
_MOST, _BLOCK = 60, 256
_MISSING = 1e6
"""Of a missing reading, as its sd [SI]: so far off it costs nothing beside the others."""
_LENGTHS = tuple(0.5 ** np.arange(*some) for some in ((0, 1), (1, 5), (5, 25)))
"""Shares of a step that are tried, those of a group at once: evaluations cost by their number."""
_SHORTEST = 0.75 * 0.5**24
"""A length below has been halved as often as allowed."""


def close_by_newton(
    tape: Tape,
    block: Block,
    tolerance: float,
    estimated: tuple[str, ...] = (),
    *,
    together: bool = False,
) -> Closed:
    """The nearest closed points of a block's poses, until steps are at most so many sds.

    estimated: parameters by which an engine of these loops has derivatives already: it serves here.
    together: closed poses are of use only together, so all are left where one cannot be closed.
    """
    first = engine_for(tape, estimated, _BLOCK)
    second = engine_for(lagrangian_gradient(tape), (), _BLOCK)
    costs = np.ones(len(block.readings))
    costs[list(block.noise.unmeasured)] = 0.0
    done, late = block.corrections.copy(), np.zeros(block.count, dtype=bool)
    for begin in range(0, block.count, _BLOCK):
        some = slice(begin, begin + _BLOCK)
        part = block.of(some)
        scaling = _scaling(part.noise)
        T = np.broadcast_to(scaling, (part.count, *scaling.shape[1:]))
        problem = _Poses(
            first, second, part.parameters, part.readings, part.pose_constants, T, costs
        )
        done[:, some], late[some] = problem.run(part.corrections, tolerance, together)
        if together and late[some].any():
            break
    return Closed(done, late)


def _scaling(noise: BlockNoise) -> Array:
    """T, (1, k, k) or (b, k, k): columns of unmeasured quantities are scaled units."""
    sd = np.where(np.isinf(noise.sd), _MISSING if noise.predicted else UNMEASURED_SCALE, noise.sd)
    sd[list(noise.unmeasured)] = UNMEASURED_SCALE
    T = sd.T[:, :, None] * np.eye(len(sd))
    for covariance in noise.blocks:
        rows, factor = np.array(covariance.indices), covariance.factor
        if factor.ndim == 3 and len(T) == 1:
            T = np.repeat(T, len(factor), axis=0)
        T[:, rows[:, None], rows] = factor
    return T


@dataclass(frozen=True)
class _Local:
    """The loops at some y: f (b, m) and the singular value decomposition of f_x T."""

    f: Array
    U: Array
    s: Array
    Vt: Array

    def of(self, chosen: NDArray[np.intp]) -> _Local:
        """Some of these poses."""
        return _Local(self.f[chosen], self.U[chosen], self.s[chosen], self.Vt[chosen])

    def closure(self, f: Array) -> Array:
        """Loop values f (b, m) in the metric of this Jacobian, (b, m): how far y must move."""
        turned = np.einsum("bmi,bm->bi", self.U, f)
        return np.where(self.s > 1e-13, turned / np.maximum(self.s, 1e-300), 0.0)


@dataclass(frozen=True)
class _Poses:
    """Some poses with their engines: the iteration itself.

    costs: (k,) 1 for measured quantities, 0 for those that cost nothing.
    """

    first: Engine
    second: Engine
    parameters: Array
    readings: Array
    pose_constants: Array
    T: Array
    costs: Array

    def of(self, chosen: NDArray[np.intp] | NDArray[np.bool_]) -> _Poses:
        """Some of these poses."""
        readings, constants = self.readings[:, chosen], self.pose_constants[:, chosen]
        return replace(self, readings=readings, pose_constants=constants, T=self.T[chosen])

    def run(
        self, corrections: Array, tolerance: float, together: bool
    ) -> tuple[Array, NDArray[np.bool_]]:
        """Corrections (k, b), and the poses (b,) that stay open; closed poses are left alone.

        together: stop where one cannot be closed.
        """
        # A reading with sd 0 has a column of zeros in T, which then has no inverse.
        y = (np.linalg.pinv(self.T) @ corrections.T[:, :, None])[:, :, 0]
        active, poses = np.arange(len(y)), self
        open_ = np.ones(len(y), dtype=bool)
        for _ in range(_MOST):
            at = y[active]
            local = poses._linearise(at)
            step, multipliers = poses._step(at, local)
            length = poses._length(at, local, step, multipliers)
            y[active] = at + length[:, None] * step
            done = np.abs(step).max(axis=1) <= tolerance
            open_[active[done]] = False
            lost = ~done & (length < _SHORTEST)  # where no part of a step helps, none will
            if together and lost.any():
                break
            rest = ~done & ~lost
            if not rest.all():
                active, poses = active[rest], poses.of(rest)
            if not len(active):
                break
        return self._corrections(y), open_

    def _corrections(self, y: Array) -> Array:
        corrections: Array = np.einsum("bij,bj->ib", self.T, y)
        return corrections

    def _values(self, y: Array) -> Array:
        x = self.readings + self._corrections(y)
        parts = [slice(begin, begin + _BLOCK) for begin in range(0, len(y), _BLOCK)]
        evaluate, p = self.first.evaluate, self.parameters
        values = [
            evaluate(p, x[:, some], self.pose_constants[:, some], Stage.VALUES).f.T.copy()
            for some in parts
        ]
        return np.concatenate(values)

    def _linearise(self, y: Array) -> _Local:
        x = self.readings + self._corrections(y)
        values = self.first.evaluate(self.parameters, x, self.pose_constants, Stage.BY_QUANTITY)
        A = values.by_quantity.transpose(2, 1, 0) @ self.T
        f = values.f.T.copy()
        good = np.isfinite(A).all(axis=(1, 2)) & np.isfinite(f).all(axis=1)
        # NumPy raises LinAlgError for a stack with one NaN: the search would end for all poses.
        A[~good] = 0.0
        U, s, Vt = np.linalg.svd(A)
        return _Local(f, U, s, Vt)

    def _step(self, y: Array, local: _Local) -> tuple[Array, Array]:
        """Normal plus tangential step, (b, k), and the scaled multipliers (b, m)."""
        m = local.f.shape[1]
        rows, null = local.Vt[:, :m], local.Vt[:, m:]
        gradient = self.costs * y
        scaled = -np.einsum("bik,bk->bi", rows, gradient)  # U^T-turned, times singular values
        safe = np.where(local.s > 1e-13, local.s, np.inf)
        # Least-squares multipliers: A^T lambda = -gradient with A = U s V^T.
        multipliers = np.einsum("bmi,bi->bm", local.U, scaled / safe)
        H = np.diag(self.costs) + self._curvature(y, multipliers)
        normal = -np.einsum("bik,bi->bk", rows, local.closure(local.f))
        reduced = null @ H @ np.swapaxes(null, 1, 2)
        values, vectors = np.linalg.eigh(reduced)
        # A negative one would lead up to a maximum, one near zero without end.
        values = np.maximum(np.abs(values), 1e-8)
        right = np.einsum("bik,bk->bi", null, gradient + np.einsum("bij,bj->bi", H, normal))
        inner = np.einsum("bij,bi->bj", vectors, right) / values
        tangential = -np.einsum("bik,bij,bj->bk", null, vectors, inner)
        return normal + tangential, scaled

    def _curvature(self, y: Array, multipliers: Array) -> Array:
        x = self.readings + self._corrections(y)
        constants = np.vstack([self.pose_constants, multipliers.T])
        hessian = self.second.evaluate(self.parameters, x, constants).by_quantity.transpose(2, 1, 0)
        hessian = np.where(np.isfinite(hessian), hessian, 0.0)
        return np.swapaxes(self.T, 1, 2) @ hessian @ self.T

    def _length(self, y: Array, local: _Local, step: Array, scaled: Array) -> Array:
        """The longest of the halved steps (b,) that lowers |M y|^2 / 2 + weight |closure|."""
        # The penalty |closure| is exact if its weight exceeds every multiplier (Nocedal and Wright
        # 2006, chapter 17).
        weight = 2.0 * np.abs(scaled).max(axis=1) + 1.0
        before = self._merit(y, local, weight)
        length = np.full(len(y), 0.5 * _LENGTHS[-1][-1])
        worse = np.arange(len(y))
        for lengths in _LENGTHS:
            count = len(lengths)
            each = np.repeat(worse, count)
            at = y[each] + np.tile(lengths, len(worse))[:, None] * step[each]
            merit = self.of(each)._merit(at, local.of(each), weight[each]).reshape(-1, count)
            # Near the end a step changes the merit by less than rounding, which must do as well.
            good = merit <= (before[worse] * (1 + 1e-12) + 1e-12)[:, None]
            better = good.any(axis=1)
            length[worse[better]] = lengths[good.argmax(axis=1)[better]]
            worse = worse[~better]
            if not len(worse):
                break
        return length

    def _merit(self, y: Array, local: _Local, weight: Array) -> Array:
        closure = np.abs(local.closure(self._values(y))).sum(axis=1)
        merit: Array = 0.5 * (self.costs * y * y).sum(axis=1) + weight * closure
        return merit
