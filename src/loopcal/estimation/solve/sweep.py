"""One sweep over all poses at given parameters: linearise, whiten, add up.

A sweep is a function of parameters and corrections. It either evaluates each block once, or
closes the loops at these parameters first (Gauss-Newton per pose, with steps halved where the
linearisation did not hold), so that chi-squared is the true profile

    Phi(p) = min over corrections with f(reading + correction, p) = 0 of their weighted square.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.estimation.problem.patterns import Pattern, Poses
from loopcal.estimation.problem.problem import BLOCK, Problem
from loopcal.estimation.solve.block import Block, BlockNoise
from loopcal.estimation.solve.block_kernel import BlockKernel, Reduce, kernel_for
from loopcal.estimation.solve.gauss_newton import NEGLIGIBLE, Closed, Reduced
from loopcal.estimation.solve.kernel import unweighted, whiten
from loopcal.estimation.solve.loss import Loss
from loopcal.estimation.solve.merit import NAMED, NONE_FAILED, Evaluation, Failed
from loopcal.estimation.solve.reduction import Accumulator, overflowing
from loopcal.expressions.engine import Engine, LoopValues, Stage, engine_for
from loopcal.measurements.noise import CovarianceBlock, ReadingUncertainty

# Chosen, not derived: closing farther costs time, and a step is damped anyway.
NEAR = 0.1
"""On the way, loops count as closed when the next correction will be at most so many sds."""
_SEARCHED = 1024
"""Poses in a block when unmeasured quantities are searched."""
# docs/decisions/0023: poses of a stretched arm, whose loops close at several points.
_ASTRAY, _ANEW, _NEARER = 25.0, 256, 0.999
"""A pose whose corrections cost so many times those of the middle pose may close nearer; so many of
a block are tried; one does if it then costs at most this share."""
# Chosen, not derived: rounding is alike in all poses.
_SAMPLE = 64
"""Poses from which the rounding of loop values is estimated."""


class Sweeper:
    """Sweeps over the poses of one problem, reduced as its weighting asks.

    loss: None is the gaussian one; rounding:
    what rounding of the loop values does to whitened residuals, their length by pose, by default
    as the first sweep shows it.
    """

    def __init__(
        self,
        problem: Problem,
        *,
        loss: Loss | None = None,
        rounding: float | None = None,
    ) -> None:
        self.problem = problem
        self.loss = loss
        self.alike = problem.loops_alike
        self.reduce: Reduce = unweighted if self.alike else whiten
        self._engines = {
            pattern.loops: engine_for(problem.tape(pattern), problem.names, problem.block)
            for pattern in problem.patterns
        }
        self._by_pose = problem.uncertainty.by_pose
        self._noises: dict[tuple[tuple[int, ...], tuple[int, ...]], BlockNoise] = {}
        self._units = problem.units
        self._kernels = {loops: self._made(engine) for loops, engine in self._engines.items()}
        self._block = min((kernel.block for kernel in self._kernels.values()), default=BLOCK)
        # The basic method corrects nothing; only unmeasured quantities have to be found.
        self.corrects = not self.alike or any(p.unmeasured for p in problem.patterns)
        alike = [isinstance(pattern.poses, slice) for pattern in problem.patterns]
        self._alike = alike == [True]
        # What the only block brings is all corrections, which need not be copied.
        self._whole = self._alike and problem.count <= self._block
        self._only: Block | None = None
        self.evaluations = 0
        self.rounding = rounding

    @overflowing
    def sweep(
        self,
        parameters: Array,
        corrections: Array,
        *,
        triangular: bool = False,
        closing: float | None = None,
        contraction: float = 1.0,
        trial: bool = False,
    ) -> Evaluation[Array]:
        """One sweep at parameters (n_all,) from corrections (k, N).

        closing: first correct the readings until the next step will be at most this many sds;
        None: linearise where the corrections stand. contraction: of steps, as far as known.
        trial: of use only where all loops close: others are left where one cannot.
        """
        problem, asked = self.problem, closing
        closing = closing if self.corrects else None
        data = Accumulator(len(problem.free), triangular, self._units)
        whole = self._whole
        used = corrections if closing is None or whole else np.zeros(corrections.shape)
        kept = not self.corrects or whole
        proposal = corrections if kept else np.zeros(corrections.shape)
        steps, ratios = [0.0], [0.0]
        singular: list[NDArray[np.intp]] = []
        late: list[NDArray[np.intp]] = []
        surplus, swelling = 0.0, False
        summed = not triangular and self.loss is None
        for pattern, block in self.blocks(parameters, corrections, self._block):
            if self.rounding is None:
                self.rounding = self._rounding(pattern, block)
            start = None
            if closing is not None:
                start = self._close(pattern, block, closing, contraction, trial=trial)
                block = block.at(start.corrections)
                used = _with_part(used, start.corrections, block.poses)
            self.evaluations += block.count
            into = None if kept or not isinstance(block.poses, slice) else proposal[:, block.poses]
            reduced = self.kernel(pattern).equations(block, summed=summed, into=into)
            if self.loss is not None:
                held = len(pattern.loops) - len(pattern.unmeasured)
                surplus += _weigh(reduced, self.loss, held)
            if reduced.total is not None:
                data.add_total(reduced.total)
            elif reduced.rows is not None:
                data.add(reduced.rows)
            singular.append(block.positions(np.flatnonzero(reduced.singular)))
            if start is not None and start.failed:
                late.append(block.positions(np.flatnonzero(start.open)))
            if self.corrects:
                if into is None:
                    proposal = _with_part(proposal, reduced.correction, block.poses)
                steps.append(float(reduced.step.max()))
                if start is not None:
                    last = steps[-1] / start.step if start.step > 0.0 else 0.0
                    ratios.append(min(max(last, start.contraction), 1.0))
                    swelling |= start.contraction >= 1.0
                    swelling |= start.step > NEGLIGIBLE and last >= 1.0
        return Evaluation(
            data,
            used,
            proposal,
            max(steps),
            max(ratios) if closing is not None else 1.0,
            asked,
            self.rounding or 0.0,
            problem.equations,
            (problem.count,),
            self._failed(singular),
            self._failed(late),
            surplus,
            swelling,
        )

    @overflowing
    def singular(self, parameters: Array, corrections: Array) -> Failed:
        """The poses in which the noise of the readings cannot close some loop."""
        singular = []
        for pattern, block in self.blocks(parameters, corrections, self._block):
            reduced = self.kernel(pattern).corrected(block)
            singular.append(block.positions(np.flatnonzero(reduced.singular)))
        return self._failed(singular)

    @overflowing
    def close(
        self, parameters: Array, corrections: Array, tolerance: float, contraction: float
    ) -> Closed:
        """Corrections (k, N) that close all loops at parameters (n_all,), found from near ones.

        They are right to so many sds; contraction: of steps, as far as known.
        """
        if not self.corrects:
            return Closed(corrections, np.zeros(corrections.shape[1], dtype=bool))
        done = corrections if self._whole else np.zeros(corrections.shape)
        late = np.zeros(corrections.shape[1], dtype=bool)
        for pattern, block in self.blocks(parameters, corrections, self._block):
            closed = self._close(pattern, block, tolerance, contraction)
            late[block.poses] = closed.open
            done = _with_part(done, closed.corrections, block.poses)
        return Closed(done, late)

    @overflowing
    def nearer(self, parameters: Array, corrections: Array) -> Array | None:
        """Corrections (k, N) with the farthest poses closed by Newton's method from their readings.

        Loops of a stretched arm close at several points, and Gauss-Newton may stray to a far one.
        None where no pose closes nearer.
        """
        if self.alike or not self.corrects:
            return None
        done, improved = corrections.copy(), False
        for pattern, block in self.blocks(parameters, corrections):
            far = _far(block)
            if not far.size:
                continue
            part, tape = block.of(far), self.problem.tape(pattern)
            from loopcal.estimation.solve.newton import close_by_newton

            closed = close_by_newton(tape, part.read, NEGLIGIBLE, self.problem.names)
            before = self.misfit(pattern, part)
            after = self.misfit(pattern, part.at(closed.corrections))
            better = ~closed.open & (after < _NEARER * before)
            block_corrections = block.corrections.copy()
            block_corrections[:, far[better]] = closed.corrections[:, better]
            done = _with_part(done, block_corrections, block.poses)
            improved |= bool(better.any())
        return done if improved else None

    @overflowing
    def searched(self, pattern: Pattern, block: Block) -> Block:
        """The block with unmeasured quantities where they close the loops best."""
        rows, size = list(pattern.unmeasured), min(_SEARCHED, self.problem.block)
        corrections = block.corrections.copy()
        for begin in range(0, block.count, size):
            some = slice(begin, begin + size)
            corrections[rows, some] += self.kernel(pattern).search(block.of(some))
        return block.at(corrections)

    @overflowing
    def misfit(self, pattern: Pattern, block: Block) -> Array:
        """What loops linearised at the corrections of a block cost to close, |E|^2, (b,).

        Infinite where it is no number.
        """
        self.evaluations += block.count
        cost = np.square(self.kernel(pattern).corrected(block).E).sum(axis=0)
        return np.where(np.isfinite(cost), cost, np.inf)

    def loop_values(
        self, pattern: Pattern, block: Block, stage: Stage = Stage.BY_PARAMETER
    ) -> LoopValues:
        """The loops that hold in the poses of a pattern, at the corrected readings of a block."""
        engine = self._engines[pattern.loops]
        return engine.evaluate(block.parameters, block.corrected, block.pose_constants, stage)

    def kernel(self, pattern: Pattern) -> BlockKernel:
        """What reduces the poses of a pattern."""
        return self._kernels[pattern.loops]

    def _failed(self, positions: list[NDArray[np.intp]]) -> Failed:
        """Poses by the positions that some blocks have found."""
        some = np.concatenate([np.empty(0, dtype=np.intp), *positions])
        if not some.size:
            return NONE_FAILED
        return Failed(some.size, tuple(self.problem.pose(int(i)) for i in some[:NAMED]))

    def _made(self, engine: Engine) -> BlockKernel:
        return kernel_for(engine, self.reduce, alike=self.alike)

    def _rounding(self, pattern: Pattern, block: Block) -> float:
        """Root mean square of |L^-1 eps a|, a the size of the terms in a loop value."""
        E = self.kernel(pattern).rounding(block.of(slice(0, _SAMPLE)))
        return float(np.sqrt(np.square(E).sum() / E.shape[1]))

    def _close(
        self,
        pattern: Pattern,
        block: Block,
        tolerance: float,
        contraction: float,
        *,
        trial: bool = False,
    ) -> Closed:
        """Corrections that close the loops of a block, and the poses where that failed."""
        # Steps do not shrink below the rounding of loop values; a finer tolerance is never reached.
        tolerance = max(tolerance, 8.0 * (self.rounding or 0.0))
        closed = self.kernel(pattern).close(block, tolerance, contraction)
        self.evaluations += closed.evaluations
        if not closed.failed:
            return closed
        from loopcal.estimation.solve.newton import close_by_newton

        some = np.flatnonzero(closed.open)
        near, tape = block.at(closed.corrections).of(some), self.problem.tape(pattern)
        tolerance = min(tolerance, 1e-3)
        nearest = close_by_newton(tape, near, tolerance, self.problem.names, together=trial)
        closed.corrections[:, some], closed.open[some] = nearest.corrections, nearest.open
        # The ratios of Gauss-Newton steps do not hold for poses that Newton closed.
        return replace(closed, contraction=1.0)

    def blocks(
        self, parameters: Array, corrections: Array | None = None, most: int | None = None
    ) -> Iterator[tuple[Pattern, Block]]:
        """All poses in blocks at parameters (n_all,) and corrections (k, N), none if not given; a
        pose without any loop is in none."""
        if corrections is None:
            corrections = np.broadcast_to(0.0, self.problem.readings.shape)
        most = self.problem.most if most is None else most
        whole = self._alike and self.problem.count <= most
        if whole and self._only is not None:  # cut once for all sweeps
            yield (
                self.problem.patterns[0],
                self._only.at(corrections, parameters),
            )
            return
        for pattern, poses in self.problem.blocks(most):
            block = self.block(pattern, poses, parameters, corrections[:, poses])
            if whole:
                self._only = block
            yield pattern, block

    def block(self, pattern: Pattern, poses: Poses, parameters: Array, corrections: Array) -> Block:
        """Some poses of a pattern with corrections (k, b) of theirs."""
        readings, constants = self.problem.readings[:, poses], self.problem.pose_constants[:, poses]
        noise = self._noise(pattern, poses)
        return Block(poses, parameters, readings, corrections, constants, noise)

    def _noise(self, pattern: Pattern, poses: Poses) -> BlockNoise:
        """The uncertainty of some poses; what is in none of their loops counts as exact."""
        if self._by_pose:
            return _noise(self.problem.uncertainty.of(poses), pattern)
        key = pattern.loops, pattern.unmeasured
        if key not in self._noises:
            self._noises[key] = _noise(self.problem.uncertainty, pattern)
        return self._noises[key]


def _far(block: Block) -> NDArray[np.intp]:
    """The poses of a block whose corrections cost far more than the others', the farthest first."""
    sd = block.noise.sd
    usable = np.isfinite(sd) & (sd > 0.0)
    shares = np.where(usable, block.corrections / np.where(usable, sd, 1.0), 0.0)
    cost = np.square(shares).sum(axis=0)
    if cost.max() <= _ASTRAY:  # whatever the middle one is
        return np.empty(0, dtype=np.intp)
    far = np.flatnonzero(~(cost <= _ASTRAY * max(float(np.median(cost)), 1.0)))
    return np.asarray(far[np.argsort(-cost[far], kind="stable")[:_ANEW]])


def _noise(uncertainty: ReadingUncertainty, pattern: Pattern) -> BlockNoise:
    """The uncertainty of poses of a pattern."""
    measured = tuple(i for i in range(len(uncertainty.sd)) if i not in pattern.unmeasured)
    sd = uncertainty.sd
    if pattern.absent:
        sd = sd.copy()
        sd[list(pattern.absent)] = 0.0
    gone = {*pattern.unmeasured, *pattern.absent}
    whole = tuple(b for b in uncertainty.blocks if not gone.intersection(b.indices))
    split = [b for b in uncertainty.blocks if gone.intersection(b.indices)]
    parts = tuple(part for b in split if (part := _without(b, gone)) is not None)
    aside = {*pattern.predicted, *pattern.absent}
    shared = tuple(i for i in measured if i not in aside) if pattern.predicted else ()
    noise = ReadingUncertainty(sd, whole + parts)
    return BlockNoise(noise, pattern.unmeasured, measured, pattern.predicted, shared)


def _weigh(block: Reduced, loss: Loss, equations: int) -> float:
    """Scale the rows of each pose by the root of its weight; what the loss is above them."""
    if not equations:
        return 0.0  # its loops find what is unmeasured, and say no more
    s = np.einsum("rb,rb->b", block.E, block.E)
    weight = loss.weight(s, equations)
    surplus = float((loss.rho(s, equations) - weight * s).sum())
    rows = block.rows
    assert rows is not None
    rows *= np.sqrt(weight)
    return surplus


def _without(block: CovarianceBlock, gone: Collection[int]) -> CovarianceBlock | None:
    """The covariance of the part of a block that was measured: rows of its square root."""
    keep = [i for i, index in enumerate(block.indices) if index not in gone]
    if not keep:
        return None
    covariance = block.factor @ np.swapaxes(block.factor, -1, -2)
    # Not by Cholesky, which fails where a covariance is only semidefinite.
    values, vectors = np.linalg.eigh(covariance[..., keep, :][..., keep])
    root = vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :]
    return CovarianceBlock(tuple(block.indices[i] for i in keep), root)


def _with_part(array: Array, part: Array, poses: Poses) -> Array:
    """The array (k, N) with a part in the columns of its poses; the part where it is all."""
    if part.shape == array.shape:
        return part
    array[:, poses] = part
    return array
