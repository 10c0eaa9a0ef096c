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

from loopcal.estimation.solve.block import Block, BlockNoise
from loopcal.estimation.solve.gauss_newton import UNMEASURED_SCALE
from loopcal.estimation.solve.reduced import Closed
from loopcal.expressions.derivative import lagrangian_gradient
from loopcal.expressions.engine import Engine, Stage, engine_for
from loopcal.expressions.tape import Tape

Array = NDArray[np.float64]
_MOST, _HALVINGS = 60, 25
_SHORTEST = 0.75 * 0.5 ** (_HALVINGS - 1)
"""A length below has been halved as often as allowed."""


def close_by_newton(
    tape: Tape, parameters: Array, block: Block, tolerance: float, estimated: tuple[str, ...] = ()
) -> Closed:
    """The nearest closed points of a block's poses, until steps are at most so many sds.

    estimated: parameters by which an engine of these loops has derivatives already: it serves here.
    """
    first = engine_for(tape, estimated, 256)
    second = engine_for(lagrangian_gradient(tape), (), 256)
    first.at(parameters)
    second.at(parameters)
    costs = np.ones(len(block.readings))
    costs[list(block.noise.unmeasured)] = 0.0
    done, late = block.corrections.copy(), np.zeros(block.count, dtype=bool)
    for begin in range(0, block.count, 256):
        some = slice(begin, begin + 256)
        part = block.of(some)
        scaling = _scaling(part.noise)
        T = np.broadcast_to(scaling, (part.count, *scaling.shape[1:]))
        problem = _Poses(first, second, part.readings, part.known, T, costs)
        done[:, some], late[some] = problem.run(part.corrections, tolerance)
    return Closed(done, late)


def _scaling(noise: BlockNoise) -> Array:
    """T, (1, k, k) or (b, k, k): columns of unmeasured quantities are scaled units."""
    sd = np.where(np.isinf(noise.sd), UNMEASURED_SCALE, noise.sd)
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
    readings: Array
    known: Array
    T: Array
    costs: Array

    def of(self, chosen: NDArray[np.intp] | NDArray[np.bool_]) -> _Poses:
        """Some of these poses."""
        readings, known = self.readings[:, chosen], self.known[:, chosen]
        return replace(self, readings=readings, known=known, T=self.T[chosen])

    def run(self, corrections: Array, tolerance: float) -> tuple[Array, NDArray[np.bool_]]:
        """Corrections (k, b), and the poses (b,) that stay open; closed poses are left alone."""
        y = (np.linalg.pinv(self.T) @ corrections.T[:, :, None])[:, :, 0]
        active, poses = np.arange(len(y)), self
        open_ = np.ones(len(y), dtype=bool)
        for _ in range(_MOST):
            at = y[active]
            here = poses._linearise(at)
            step, multipliers = poses._step(at, here)
            length = poses._length(at, here, step, multipliers)
            y[active] = at + length[:, None] * step
            done = np.abs(step).max(axis=1) <= tolerance
            open_[active[done]] = False
            rest = ~done & (length >= _SHORTEST)  # where no part of a step helps, none will
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
        return self.first.evaluate(x, self.known, Stage.VALUES).f.T.copy()

    def _linearise(self, y: Array) -> _Local:
        x = self.readings + self._corrections(y)
        values = self.first.evaluate(x, self.known, Stage.BY_QUANTITY)
        with np.errstate(invalid="ignore", over="ignore"):  # such poses are set aside below
            A = values.by_quantity.transpose(2, 1, 0) @ self.T
        f = values.f.T.copy()
        good = np.isfinite(A).all(axis=(1, 2)) & np.isfinite(f).all(axis=1)
        A[~good] = 0.0
        U, s, Vt = np.linalg.svd(A)
        return _Local(f, U, s, Vt)

    def _step(self, y: Array, here: _Local) -> tuple[Array, Array]:
        """Normal plus tangential step, (b, k), and the scaled multipliers (b, m)."""
        m = here.f.shape[1]
        rows, null = here.Vt[:, :m], here.Vt[:, m:]
        gradient = self.costs * y
        scaled = -np.einsum("bik,bk->bi", rows, gradient)  # U^T-turned, times singular values
        safe = np.where(here.s > 1e-13, here.s, np.inf)
        multipliers = np.einsum("bmi,bi->bm", here.U, scaled / safe)
        H = np.diag(self.costs) + self._curvature(y, multipliers)
        normal = -np.einsum("bik,bi->bk", rows, here.closure(here.f))
        reduced = null @ H @ np.swapaxes(null, 1, 2)
        values, vectors = np.linalg.eigh(reduced)
        values = np.maximum(np.abs(values), 1e-8)
        right = np.einsum("bik,bk->bi", null, gradient + np.einsum("bij,bj->bi", H, normal))
        inner = np.einsum("bij,bi->bj", vectors, right) / values
        tangential = -np.einsum("bik,bij,bj->bk", null, vectors, inner)
        return normal + tangential, scaled

    def _curvature(self, y: Array, multipliers: Array) -> Array:
        x = self.readings + self._corrections(y)
        known = np.vstack([self.known, multipliers.T])
        hessian = self.second.evaluate(x, known).by_quantity.transpose(2, 1, 0)
        hessian = np.where(np.isfinite(hessian), hessian, 0.0)
        curvature: Array = np.swapaxes(self.T, 1, 2) @ hessian @ self.T
        return curvature

    def _length(self, y: Array, here: _Local, step: Array, scaled: Array) -> Array:
        """The longest of the halved steps (b,) that lowers |M y|^2 / 2 + weight |closure|."""
        weight = 2.0 * np.abs(scaled).max(axis=1) + 1.0
        before = self._merit(y, here, weight)
        length = np.ones(len(y))
        worse, poses = np.arange(len(y)), self
        for _ in range(_HALVINGS):
            at = y[worse] + length[worse, None] * step[worse]
            merit = poses._merit(at, here.of(worse), weight[worse])
            still = ~(merit <= before[worse] * (1 + 1e-12) + 1e-12)
            if not still.all():
                worse, poses = worse[still], poses.of(still)
            if not len(worse):
                break
            length[worse] /= 2
        return length

    def _merit(self, y: Array, here: _Local, weight: Array) -> Array:
        closure = np.abs(here.closure(self._values(y))).sum(axis=1)
        merit: Array = 0.5 * (self.costs * y * y).sum(axis=1) + weight * closure
        return merit
