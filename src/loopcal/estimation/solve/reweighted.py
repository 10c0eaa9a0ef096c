"""Reweighted least squares: parameters from the readings as they are, weighed by their noise.

The loop values at the readings are w = c - f(reading, p), c the curvature that the corrections
add, with the covariance W = J_x Sigma J_x^T. For fixed W and c the weighted squares
w^T W^-1 w are minimised over p; W and c are then taken at the new point, until nothing moves
(iteratively reweighted least squares; generalised least squares with propagated covariance).

It differs from maximum likelihood in one term. There W(p) itself depends on the parameters, and
a machine whose levers make the noise larger explains the same misclosure at a smaller cost; that
term is what makes maximum likelihood unbiased where readings scatter about a true value. It is
harmful where the sds are guessed and the poses alike. Here W says how much each pose counts, and
nothing about the parameters: right to first order for a machine that is driven to its readings
(Berkson 1950), and safe where the data determine little (Carroll and Ruppert, Transformation and
Weighting in Regression, 1988, chapter 2).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from loopcal.arrays import Array
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.problem.starting import start_corrections
from loopcal.estimation.solve.block import Block
from loopcal.estimation.solve.block_kernel import BlockKernel, NumpyKernel
from loopcal.estimation.solve.gauss_newton import NEGLIGIBLE
from loopcal.estimation.solve.in_memory import InMemory
from loopcal.estimation.solve.kernel import Whitened
from loopcal.estimation.solve.loss import Loss
from loopcal.estimation.solve.merit import without_state
from loopcal.estimation.solve.reduction import overflowing
from loopcal.estimation.solve.scratch import one_blas_thread, scratch
from loopcal.estimation.solve.solution import MOST_ITERATIONS, Solution, Status
from loopcal.estimation.solve.solver import Progress, solve_with
from loopcal.estimation.solve.sweep import NEAR, Sweeper
from loopcal.expressions.engine import Engine, LoopValues, Stage

_STEP = 1e-7
"""Converged when a round moves no parameter by more sds, unless the user says otherwise."""
# These and _LOOSE: docs/decisions/0006.
_NO_LONGER, _ROUNDING = 0.5, 1e-5
"""A round that moves by this share of the one before, and by so few sds, is moved by rounding."""
_LOOSE = 1e-2
"""A round is solved to this share of what the round before has moved."""


@dataclass(frozen=True)
class Weights:
    """What is held while p moves: c (m, N), and T (m, m, N) with T W T^T = 1 but for rows of zero.

    Unmeasured quantities are projected out by T.
    """

    T: Array
    c: Array

    def reduced(self, values: LoopValues, block: Block) -> Whitened:
        """The rows T (c - f) of a block at its readings."""
        T, c = self.T[:, :, block.poses], self.c[:, block.poses]
        D, (m, b) = values.by_parameter, values.f.shape
        T, c = T[:, :m], c[:m]
        rows = scratch("rows", len(D) + 1, len(T), b)
        np.einsum("rmb,nmb->nrb", T, D, out=rows[:-1])
        np.einsum("rmb,mb->rb", T, c - values.f, out=rows[-1])
        return Whitened(rows, np.zeros((len(T), 0, b)), block.corrections, np.zeros(b, dtype=bool))


def solve_reweighted(
    problem: Problem,
    *,
    loss: Loss | None = None,
    max_iterations: int = MOST_ITERATIONS,
    tolerance: float | None = None,
    progress: Progress | None = None,
) -> Solution:
    """The fixed point of reweighting, from the problem's start.

    max_iterations: of all rounds together; tolerance: converged when a round moves no parameter by
    more sds than this, _STEP if None. The steps of a round are no finer than it needs.

    Its covariance is (sum D^T D + prior)^-1 with D taken at the readings. chi_squared is that of
    the corrections that close the loops at the end point.

    Raises InputError as `solve` does.
    """
    least = _STEP if tolerance is None else tolerance
    with one_blas_thread():
        likelihood = Sweeper(problem, loss=loss)
        corrections = start_corrections(likelihood, problem.start)
        corrections = likelihood.sweep(problem.start, corrections, closing=NEAR).proposal
        parameters, iterations, moved = problem.start, 0, 1.0
        while True:
            weights = _weights(likelihood, parameters, corrections)
            held = _held(problem, parameters, corrections)
            inner = InMemory(_Reweighted(held, weights, likelihood.rounding, loss))
            inner_end = solve_with(
                inner,
                max_iterations=max(max_iterations - iterations, 0),
                tolerance=max(_LOOSE * min(moved, 1.0), 0.1 * least),
                progress=progress,
            )
            iterations += inner_end.status.iterations
            step = inner_end.parameters - parameters
            parameters = inner_end.parameters
            corrections = likelihood.close(parameters, corrections, NEGLIGIBLE, 1.0).corrections
            sds = np.sqrt(np.maximum(np.diag(inner_end.spectrum.covariance()), 1e-300))
            before, moved = moved, float(np.abs(step[problem.free] / sds).max())
            stuck = _NO_LONGER * before <= moved <= _ROUNDING
            ended = moved <= least or stuck or iterations >= max_iterations
            if ended or not inner_end.status.converged:
                break
        end = likelihood.sweep(parameters, corrections)
        reason = inner_end.status.reason
        if inner_end.status.converged and moved > least and not stuck:
            reason = "max_iterations"
        status = Status.of(reason, iterations, likelihood.evaluations / len(problem.poses))
        prior = problem.unknowns.prior_square(parameters)
        return Solution(
            parameters, corrections, without_state(end), inner_end.spectrum, prior, status
        )


def _held(problem: Problem, parameters: Array, corrections: Array) -> Problem:
    """The problem with unmeasured quantities held where the loops are closed, and sought there."""
    readings = problem.readings
    if any(pattern.unmeasured for pattern in problem.patterns):
        readings = readings.copy()
        for pattern in problem.patterns:
            for row in pattern.unmeasured:
                readings[row, pattern.poses] += corrections[row, pattern.poses]
    closed = np.zeros(readings.shape)
    return replace(problem, readings=readings, start=parameters, first_corrections=closed)


@overflowing
def _weights(sweeper: Sweeper, parameters: Array, corrections: Array) -> Weights:
    problem = sweeper.problem
    m, N = len(problem.mechanism.tape.loops), len(problem.poses)
    T, c = np.zeros((m, m, N)), np.zeros((m, N))
    for pattern, block in sweeper.blocks(parameters, corrections):
        held, poses = len(pattern.loops), block.poses
        as_read = sweeper.loop_values(pattern, block.read, Stage.VALUES).f.copy()
        values = sweeper.loop_values(pattern, block, Stage.BY_QUANTITY)
        identity = np.repeat(np.eye(held)[:, :, None], block.count, axis=2)
        measured = list(block.noise.measured)
        start = block.corrections[measured]
        lever = np.einsum("kmb,kb->mb", values.by_quantity[measured], start)
        # c - f(reading) is then J correction - f(corrected), the misclosure of the likelihood.
        c[:held, poses] = lever - values.f + as_read
        whitened = sweeper.reduce(replace(values, by_parameter=identity), block)
        r = whitened.rows.shape[1]
        for i in range(r):
            T[i][:held, poses] = whitened.D[:, i]
    return Weights(T, c)


class _Reweighted(Sweeper):
    """Sweeps of plain least squares over T (c - f) at the readings."""

    def __init__(
        self, problem: Problem, weights: Weights, rounding: float | None, loss: Loss | None
    ) -> None:
        self.weights = weights
        # the likelihood's rounding: c, which is no rounding, stays out
        super().__init__(problem, loss=loss, rounding=rounding)
        self.corrects = False

    def _made(self, engine: Engine) -> BlockKernel:
        return NumpyKernel(engine, self.weights.reduced)
