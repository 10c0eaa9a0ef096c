"""One sweep over all poses at given parameters: linearise, whiten, add up.

A sweep is a function of parameters and corrections. It either evaluates each block once, or
closes the loops at these parameters first (Gauss-Newton per pose, with steps halved where the
linearisation did not hold), so that chi-squared is the true profile

    Phi(p) = min over corrections with f(reading + correction, p) = 0 of their weighted square.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loopcal.estimation.closing import UNMEASURED_SCALE, close_by_newton
from loopcal.estimation.kernel import BlockNoise, Whitened, unweighted, whiten
from loopcal.estimation.problem import BLOCK, Problem
from loopcal.estimation.reduction import Accumulator
from loopcal.expressions.engine import LoopValues, engine_for
from loopcal.measurements.noise import CovarianceBlock

Array = NDArray[np.float64]
MOST_CLOSINGS = 8
"""What Gauss-Newton has not closed by then is left to Newton, who knows the curvature."""
_NEGLIGIBLE = 1e-6
"""A step of so many sds leaves a next one that only rounding sees."""

Reduce = Callable[[LoopValues, Array, BlockNoise], Whitened]


@dataclass(frozen=True)
class Sweep:
    """What one sweep found.

    data: the parameter system; corrections: (k, N) where the loops were linearised; proposal:
    (k, N) the corrections that close the linearised loops; closure_rms, closure_max: of the loop
    values at `corrections` [SI]; singular, open_poses: poses whose loops cannot close at all, or
    did not within the iterations allowed.
    """

    data: Accumulator
    corrections: Array
    proposal: Array
    closure_rms: float
    closure_max: float
    singular: NDArray[np.intp]
    open_poses: NDArray[np.intp]

    @property
    def finite(self) -> bool:
        """Whether every loop could be evaluated."""
        return bool(np.all(np.isfinite(self.data.total)))


@dataclass(frozen=True)
class _BlockFindings:
    square: float
    largest: float
    singular: NDArray[np.intp]
    late: NDArray[np.intp]


class Sweeper:
    """Sweeps over the poses of one problem, with one of the two reductions.

    exact: treat the sensors as exact (the basic method).
    """

    def __init__(self, problem: Problem, *, exact: bool = False) -> None:
        self.problem = problem
        self.reduce: Reduce = unweighted if exact else whiten
        tape, size = problem.mechanism.tape, min(BLOCK, len(problem.poses))
        self.engine = engine_for(tape, problem.names, size)
        self.closing_engine = engine_for(tape, (), size)
        # The basic method corrects nothing; only unmeasured quantities have to be found.
        self.corrects = not exact or any(p.unmeasured for p in problem.patterns)
        self.parameters = problem.start
        self.evaluations = 0

    def sweep(
        self,
        parameters: Array,
        corrections: Array,
        *,
        triangular: bool = False,
        closing: float | None = None,
    ) -> Sweep:
        """One sweep at parameters (n_all,) from corrections (k, N).

        closing: first correct the readings until a step of at most this many sds was taken (the
        next would be of second order); None: linearise where the corrections stand.
        """
        problem = self.problem
        closing = closing if self.corrects else None
        self.engine.at(parameters)
        self.parameters = parameters
        if closing is not None:
            self.closing_engine.at(parameters)
        data = Accumulator(len(problem.free), triangular)
        used = corrections if closing is None else np.empty_like(corrections)
        proposal = np.empty_like(corrections) if self.corrects else corrections
        found: list[_BlockFindings] = []
        for unmeasured, poses in problem.blocks():
            noise = self.noise(unmeasured, poses)
            readings, known = problem.readings[:, poses], problem.known[:, poses]
            start = corrections[:, poses]
            late = np.zeros(readings.shape[1], dtype=bool)
            if closing is not None:
                start, late = self._close(readings, known, start, noise, closing)
                used[:, poses] = start
            values = self.engine.evaluate(readings + start, known)
            self.evaluations += readings.shape[1]
            whitened = self.reduce(values, start, noise)
            data.add(whitened)
            if self.corrects:
                proposal[:, poses] = whitened.correction
            numbers = np.arange(len(problem.poses), dtype=np.intp)[poses]
            found.append(
                _BlockFindings(
                    float(np.square(values.f).sum()),
                    float(np.abs(values.f).max()),
                    numbers[whitened.singular],
                    numbers[late],
                )
            )
        count = len(problem.mechanism.tape.loops) * len(problem.poses)
        return Sweep(
            data,
            used,
            proposal,
            float(np.sqrt(sum(f.square for f in found) / count)),
            max(f.largest for f in found),
            np.concatenate([f.singular for f in found]),
            np.concatenate([f.late for f in found]),
        )

    def _close(
        self, readings: Array, known: Array, start: Array, noise: BlockNoise, tolerance: float
    ) -> tuple[Array, NDArray[np.bool_]]:
        """Corrections that close the loops of a block, and the poses where that failed."""
        count = readings.shape[1]
        done, late = start.copy(), np.zeros(count, dtype=bool)
        active: NDArray[np.intp] | None = None  # None: all poses, without copying them
        base, step, length = start, np.zeros_like(start), np.ones(count)
        expected = np.full(count, np.inf)
        for _ in range(MOST_CLOSINGS):
            at = base + length * step if active is not None or step.any() else base
            values = self.closing_engine.evaluate(
                readings + at if active is None else readings[:, active] + at,
                known if active is None else known[:, active],
            )
            self.evaluations += at.shape[1]
            part = noise if active is None else _select(noise, active)
            correction = self.reduce(values, at, part).correction
            move = correction - at
            size = _step_in_sds(move, part)
            # A step larger than the one before, or one that is no number, overshot: halve it.
            allowed = np.maximum(2.0 * expected, max(tolerance, _NEGLIGIBLE))
            overshot = ~(size <= allowed) & (length > 1e-3)
            finished = ~overshot & ((size <= tolerance) | (expected <= _NEGLIGIBLE))
            if active is None and finished.all():
                return correction, late
            active = np.arange(count) if active is None else active
            done[:, active[finished]] = correction[:, finished]
            rest = ~finished
            if not rest.any():
                return done, late
            base = np.where(overshot, base, at)[:, rest]
            step = np.where(overshot, step, move)[:, rest]
            length = np.where(overshot, 0.5 * length, 1.0)[rest]
            expected = np.where(overshot, expected, size)[rest]
            active = active[rest]
        assert active is not None
        closed = close_by_newton(
            self.problem.mechanism.tape,
            self.parameters,
            readings[:, active],
            known[:, active],
            np.where(np.isfinite(base), base, start[:, active]),
            _select(noise, active),
            min(tolerance, 1e-3),
        )
        done[:, active], late[active] = closed.corrections, closed.open
        return done, late

    def noise(self, unmeasured: tuple[int, ...], poses: slice | NDArray[np.intp]) -> BlockNoise:
        """The uncertainty of one block of poses."""
        uncertainty = self.problem.uncertainty
        everything = range(len(self.problem.readings))
        measured = tuple(i for i in everything if i not in unmeasured)
        sd = uncertainty.sd if uncertainty.sd.shape[1] == 1 else uncertainty.sd[:, poses]
        blocks = tuple(
            CovarianceBlock(b.indices, b.factor if b.factor.ndim == 2 else b.factor[poses])
            for b in uncertainty.blocks
            if not set(b.indices) & set(unmeasured)
        )
        split = [b for b in uncertainty.blocks if set(b.indices) & set(unmeasured)]
        blocks += tuple(p for b in split if (p := _without(b, unmeasured, poses)) is not None)
        return BlockNoise(sd, blocks, unmeasured, measured)


def _without(
    block: CovarianceBlock, unmeasured: tuple[int, ...], poses: slice | NDArray[np.intp]
) -> CovarianceBlock | None:
    """The covariance of the part of a block that was measured: rows of its square root."""
    keep = [i for i, index in enumerate(block.indices) if index not in unmeasured]
    if not keep:
        return None
    factor = block.factor if block.factor.ndim == 2 else block.factor[poses]
    covariance = factor @ np.swapaxes(factor, -1, -2)
    values, vectors = np.linalg.eigh(covariance[..., keep, :][..., keep])
    root = vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :]
    return CovarianceBlock(tuple(block.indices[i] for i in keep), root)


def _select(noise: BlockNoise, chosen: NDArray[np.intp]) -> BlockNoise:
    """The noise of some poses of a block."""
    sd = noise.sd if noise.sd.shape[1] == 1 else noise.sd[:, chosen]
    blocks = tuple(
        b if b.factor.ndim == 2 else CovarianceBlock(b.indices, b.factor[chosen])
        for b in noise.blocks
    )
    return BlockNoise(sd, blocks, noise.unmeasured, noise.measured)


def _step_in_sds(step: Array, noise: BlockNoise) -> Array:
    """Largest step of each pose in sds, (b,); exact quantities do not move."""
    sd = np.where(noise.sd > 0.0, noise.sd, 1.0)
    if noise.unmeasured:
        sd[list(noise.unmeasured)] = UNMEASURED_SCALE
    result: Array = (np.abs(step) / sd).max(axis=0)
    return result
