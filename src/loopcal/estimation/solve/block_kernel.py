"""The block kernel on the engine that was chosen: readings and corrections in, equations out.

`kernel.py` says what is computed. On NumPy it is done there; the compiled engine does the same,
tape, elimination, whitening and sums together, without arrays of derivatives in between.

Unmeasured quantities from the loops of each pose, the readings held as they are.

    minimise sum_j (f_j / s_j)^2 over the unmeasured quantities of a pose, s_j its sd,

by Levenberg's and Marquardt's method, every pose with a damping of its own. No more than a start:
readings are not corrected, and where loops disagree, what is found is a compromise of them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

import numpy as np

from loopcal.arrays import Array
from loopcal.estimation.solve.block import Block, BlockNoise
from loopcal.estimation.solve.gauss_newton import (
    UNMEASURED_SCALE,
    Closed,
    Reduced,
    close_by_gauss_newton,
)
from loopcal.estimation.solve.kernel import Whitened, eliminate
from loopcal.estimation.solve.scratch import scratch
from loopcal.expressions.compiled_engine import CompiledEngine, side_by_side
from loopcal.expressions.engine import Engine, LoopValues, Stage

Reduce = Callable[[LoopValues, Block], Whitened]


class BlockKernel(Protocol):
    """Reduces blocks of poses in which the same loops hold."""

    @property
    def block(self) -> int:
        """Poses in a block that it is fastest with, at most."""

    def corrected(self, block: Block) -> Reduced:
        """Without derivatives by parameters, at a third of the cost: of the rows E alone."""

    def equations(self, block: Block, *, summed: bool, into: Array | None = None) -> Reduced:
        """The equations in the parameters too: their total where summed, else their rows.

        into: (k, b) where the new corrections are to stand, if not in an array of their own.
        """

    def close(self, block: Block, tolerance: float, contraction: float) -> Closed:
        """Corrections that close the loops to so many sds (`gauss_newton.py`)."""

    def rounding(self, block: Block) -> Array:
        """L^-1 eps a, (r, b), a the size of a loop's terms: sum |J_x| (1 + |reading|)."""

    def search(self, block: Block) -> Array:
        """What unmeasured quantities (u, b) change by until loops close best (`searching.py`)."""


@dataclass(frozen=True)
class NumpyKernel:
    """Any engine, and what is done with the arrays of derivatives that it gives."""

    engine: Engine
    reduce: Reduce

    @property
    def block(self) -> int:
        return self.engine.size

    def corrected(self, block: Block) -> Reduced:
        return self._reduced(block, Stage.BY_QUANTITY)

    def equations(self, block: Block, *, summed: bool, into: Array | None = None) -> Reduced:
        reduced = self._reduced(block, Stage.BY_PARAMETER)
        if into is not None:
            into[:] = reduced.correction
        if not summed:
            return reduced
        assert reduced.rows is not None
        rows = reduced.rows.reshape(len(reduced.rows), -1)
        return Reduced(reduced.correction, reduced.step, reduced.singular, total=rows @ rows.T)

    def close(self, block: Block, tolerance: float, contraction: float) -> Closed:
        return close_by_gauss_newton(self.corrected, block, tolerance, contraction)

    def rounding(self, block: Block) -> Array:
        x = block.corrected
        slopes = self.engine.evaluate(
            block.parameters, x, block.pose_constants, Stage.BY_QUANTITY
        ).by_quantity
        sizes = np.einsum("kmb,kb->mb", np.abs(slopes), 1.0 + np.abs(block.readings))
        part = LoopValues(np.finfo(float).eps * sizes, slopes, np.empty((0, *slopes.shape[1:])))
        return self.reduce(part, block.at(np.zeros_like(x))).E

    def search(self, block: Block) -> Array:
        return search(self.engine, block)

    def _reduced(self, block: Block, stage: Stage) -> Reduced:
        x = np.add(block.readings, block.corrections, out=scratch("x", *block.readings.shape))
        whitened = self.reduce(
            self.engine.evaluate(block.parameters, x, block.pose_constants, stage), block
        )
        step = step_in_sds(whitened.correction - block.corrections, block.noise)
        return Reduced(whitened.correction, step, whitened.singular, whitened.rows)


@dataclass(frozen=True)
class CompiledKernel:
    """The compiled engine's own kernel; alike: loops count alike and nothing is whitened."""

    engine: CompiledEngine
    alike: bool
    block: int = 32768  # enough for threads to share

    def corrected(self, block: Block) -> Reduced:
        return self._reduced(block, by_parameter=False, rows=self._misclosure(block))

    def equations(self, block: Block, *, summed: bool, into: Array | None = None) -> Reduced:
        n = self.engine.parameters + 1
        if summed:
            total = np.empty((n, n))
            return self._reduced(block, total=total, into=into)
        r = self.engine.loops - len(block.noise.unmeasured)
        return self._reduced(block, rows=scratch("rows", n, r, block.count), into=into)

    def close(self, block: Block, tolerance: float, contraction: float) -> Closed:
        corrections, count = np.empty(block.readings.shape), block.count
        sizes = np.empty((2, count))  # of last steps, and their ratios to the ones before
        rounds, late = np.empty(count, dtype=np.int32), np.empty(count, dtype=np.bool_)
        self.engine.native(block.parameters).close(
            *_native(block),
            self.alike,
            tolerance,
            contraction,
            corrections,
            sizes[0],
            sizes[1],
            rounds,
            late.view(np.uint8),
        )
        step, ratio = sizes.max(axis=1, initial=0.0).tolist()
        return Closed(corrections, late, step, ratio, int(rounds.sum()))

    def rounding(self, block: Block) -> Array:
        rows = self._misclosure(block)
        return self._reduced(block, by_parameter=False, rounding=True, rows=rows).E

    def search(self, block: Block) -> Array:
        change = np.empty((len(block.noise.unmeasured), block.count))
        self.engine.native(block.parameters).search(*_native(block), change)
        return change

    def _misclosure(self, block: Block) -> Array:
        """Where E is to stand, (1, r, b)."""
        return np.empty((1, self.engine.loops - len(block.noise.unmeasured), block.count))

    def _reduced(
        self,
        block: Block,
        *,
        by_parameter: bool = True,
        rounding: bool = False,
        rows: Array | None = None,
        total: Array | None = None,
        into: Array | None = None,
    ) -> Reduced:
        correction = np.empty(block.readings.shape) if into is None else into
        step = np.empty(block.count)
        singular = np.empty(block.count, dtype=np.uint8)
        self.engine.native(block.parameters).reduce(
            *_native(block),
            self.alike,
            by_parameter,
            rounding,
            correction,
            step,
            singular,
            rows,
            total,
        )
        return Reduced(correction, step, singular.view(np.bool_), rows, total)


def _native(block: Block) -> tuple[Array, Array, Array, Any]:
    """Readings, corrections, known values and noise as the compiled engine takes them."""
    return (
        side_by_side(block.readings),
        side_by_side(block.corrections),
        side_by_side(block.pose_constants),
        block.noise.native,
    )


def kernel_for(engine: Engine, reduce: Reduce, *, alike: bool) -> BlockKernel:
    """The kernel that goes with an engine; reduce: what it does, written in NumPy."""
    if isinstance(engine, CompiledEngine):
        return CompiledKernel(engine, alike)
    return NumpyKernel(engine, reduce)


def step_in_sds(step: Array, noise: BlockNoise) -> Array:
    """Largest step of each pose in sds, (b,); exact quantities do not move."""
    sd = np.where(noise.sd > 0.0, noise.sd, 1.0)
    if noise.unmeasured:
        sd[list(noise.unmeasured)] = UNMEASURED_SCALE
    size = np.abs(step, out=scratch("step", *step.shape))
    size /= sd
    result: Array = size.max(axis=0)
    return result


Evaluate = Callable[[Array, Array], LoopValues]
# Chosen, not derived: a cap; many starts are searched, so each has little time.
_MOST = 40
# Chosen, not derived: within it, closing the loops converges by itself.
_SETTLED = 1e-6
"""A step this small [m, rad] ends the search; closing the loops goes on from there."""
# Factors of ten as Marquardt (1963); damping of 1e8 leaves 1e-8 of a step.
_FIRST, _SOFTER, _HARDER, _STUCK = 1e-3, 0.1, 10.0, 1e8
"""Damping beside the squared length of a column: at first, after good and bad steps, given up."""


def search(engine: Engine, block: Block) -> Array:
    """What the unmeasured quantities (u, b) change by until they close the loops best.

    The engine gives derivatives by all quantities.
    """
    rows, x, constants = list(block.noise.unmeasured), block.corrected, block.pose_constants
    evaluate = partial(engine.evaluate, block.parameters, stage=Stage.BY_QUANTITY)
    weight = _weights(evaluate, x, constants, block.noise)
    first = x[rows]
    done, active = first.copy(), np.arange(x.shape[1])
    damping = np.full(x.shape[1], _FIRST)
    f, J = _weighted(evaluate, x, constants, rows, weight)
    cost = np.square(f).sum(axis=0)
    for _ in range(_MOST):
        step = _step(f, J, damping)
        trial = x.copy()
        trial[rows] += step
        f_new, J_new = _weighted(evaluate, trial, constants, rows, weight)
        cost_new = np.square(f_new).sum(axis=0)
        better = cost_new <= cost  # false where either is no number
        x, f = np.where(better, trial, x), np.where(better, f_new, f)
        J, cost = np.where(better, J_new, J), np.where(better, cost_new, cost)
        damping = np.where(better, _SOFTER * damping, _HARDER * damping)
        done[:, active] = x[rows]
        rest = ~((np.abs(step).max(axis=0) <= _SETTLED) | (damping > _STUCK))
        if not rest.any():
            break
        active, damping, cost = active[rest], damping[rest], cost[rest]
        x, constants, weight = x[:, rest], constants[:, rest], weight[:, rest]
        f, J = f[:, rest], J[:, :, rest]
    change: Array = done - first
    return change


def _weights(evaluate: Evaluate, x: Array, constants: Array, noise: BlockNoise) -> Array:
    """1 / the sd of each loop (m, b) that the sds of measured quantities give it.

    A loop of exact readings holds at least as well as any other of its pose; 1 where none has
    an sd.
    """
    sure = np.where(np.isinf(noise.sd), 0.0, noise.sd)
    slopes = evaluate(x, constants).by_quantity
    spread = np.sqrt(np.square(slopes * sure[:, None]).sum(axis=0))
    usable = np.isfinite(spread) & (spread > 0.0)
    weight = np.where(usable, 1.0 / np.where(usable, spread, 1.0), 0.0)
    weight = np.where(usable, weight, np.where(usable.any(axis=0), weight.max(axis=0), 1.0))
    if noise.predicted:  # what is missing says nothing
        weight[np.broadcast_to(np.isinf(noise.sd[list(noise.predicted)]), weight.shape)] = 0.0
    return weight


def _weighted(
    evaluate: Evaluate, x: Array, constants: Array, rows: list[int], weight: Array
) -> tuple[Array, Array]:
    """Loop values (m, b) and derivatives (u, m, b), in sds."""
    values = evaluate(x, constants)
    return values.f * weight, values.by_quantity[rows] * weight


def _step(f: Array, J: Array, damping: Array) -> Array:
    """The damped step (u, b) of least squares; none where derivatives are no numbers."""
    u = len(J)
    length = np.sqrt(np.square(J).sum(axis=1))
    # Damping by the length of each column, so that metres and radians need no common unit
    # (Marquardt 1963).
    below = np.eye(u)[:, :, None] * (np.sqrt(damping) * length)[:, None, :]
    reflections = eliminate(np.concatenate([J, below], axis=1))
    right = np.concatenate([f, np.zeros((u, f.shape[1]))])
    step = -reflections.solve(reflections.apply(right)[:u])
    return np.where(np.isfinite(step).all(axis=0), step, 0.0)
