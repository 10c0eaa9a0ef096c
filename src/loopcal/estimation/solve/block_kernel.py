"""The block kernel on the engine that was chosen: readings and corrections in, equations out.

`kernel.py` says what is computed. On NumPy it is done there; the compiled engine does the same,
tape, elimination, whitening and sums together, without arrays of derivatives in between.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from loopcal.estimation.solve.block import Block, BlockNoise
from loopcal.estimation.solve.gauss_newton import UNMEASURED_SCALE, close_by_gauss_newton
from loopcal.estimation.solve.kernel import Whitened
from loopcal.estimation.solve.reduced import Closed, Reduced
from loopcal.estimation.solve.scratch import scratch
from loopcal.estimation.solve.searching import search
from loopcal.expressions.compiled_engine import CompiledEngine, side_by_side
from loopcal.expressions.engine import Engine, LoopValues, Stage

Array = NDArray[np.float64]
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
    block: int = 4096  # enough for NumPy's overhead to vanish, small enough for the cache

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
