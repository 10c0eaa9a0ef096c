"""The seed's own iteration, step by step and undamped, for study: equations (3.24) to (3.30)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.solve.in_memory import outside_domain
from loopcal.estimation.solve.kernel import unload
from loopcal.estimation.solve.loss import Loss
from loopcal.estimation.solve.merit import without_state
from loopcal.estimation.solve.reduction import Accumulator, overflowing, spectrum
from loopcal.estimation.solve.solution import Solution
from loopcal.estimation.solve.solver import Progress
from loopcal.estimation.solve.status import MOST_ITERATIONS, Status
from loopcal.estimation.solve.sweep import Sweeper

Array = NDArray[np.float64]
TOLERANCE = 1e-10
"""Converged when no normalised parameter or correction moves by more than this many sds."""


def iterate_undamped(
    problem: Problem,
    *,
    loss: Loss | None = None,
    max_iterations: int = MOST_ITERATIONS,
    tolerance: float | None = None,
    progress: Progress | None = None,
) -> Solution:
    """Full steps in parameters and corrections together, as the seed writes them.

    D_i = R_i^-T J_q,i and E_i = Q_i^T y_i - R_i^-T f_i; [D; I] dq = [E; -q] in least squares;
    y_i <- Q_i (E_i - D_i dq), q <- q + dq, until neither moves. Nothing keeps a step from making
    things worse: the status then says "max_iterations" or "diverged", and the point is whatever
    was reached. Needs finite memory for all D_i at once, and every quantity measured or exact.
    It knows no loss, which `Fit` refuses, and reports no progress.

    Raises InputError if a quantity is unmeasured.
    """
    if any(pattern.unmeasured for pattern in problem.patterns):
        raise InputError(
            "the undamped iteration of the thesis cannot handle unmeasured quantities",
            code="unsupported",
            remedy='use method = "implicit-loop"',
        )
    least = TOLERANCE if tolerance is None else tolerance
    sweeper = Sweeper(problem)
    parameters = problem.start.copy()
    corrections = np.zeros_like(problem.readings)
    reason, iteration, first = "max_iterations", 0, np.inf
    before = parameters, corrections
    while reason == "max_iterations" and iteration < max_iterations:
        iteration += 1
        offset = problem.nominal - parameters[problem.free]
        data, steps, proposals = _linearised(sweeper, parameters, corrections)
        if not np.all(np.isfinite(data.total)):
            if iteration == 1:
                raise outside_domain(problem, parameters)
            reason, (parameters, corrections) = "diverged", before
            break
        before = parameters.copy(), corrections
        if iteration == 1:
            first = data.chi_squared + float(np.square(offset / problem.prior_sd).sum())
        system = spectrum(data, offset, problem.prior_sd)
        step = system.step()
        new = proposals - np.einsum("nkb,n->kb", steps, step)
        parameters[problem.free] += step
        moved = np.abs(step / np.sqrt(np.maximum(np.diag(system.covariance()), 1e-300))).max()
        sd = np.where(problem.uncertainty.sd > 0, problem.uncertainty.sd, np.inf)
        shifted = (np.abs(new - corrections) / sd).max()
        corrections = new
        if max(moved, shifted) <= least * max(1.0, np.abs(corrections / sd).max()):
            reason = "converged"
    sweep = sweeper.sweep(parameters, corrections)
    end = spectrum(sweep.data, problem.unknowns.offset(parameters), problem.prior_sd)
    prior = problem.unknowns.prior_square(parameters)
    if reason == "max_iterations" and not sweep.data.chi_squared + prior <= first:
        reason = "diverged"
    status = Status.of(reason, iteration, sweeper.evaluations / len(problem.poses))
    return Solution(parameters, corrections, without_state(sweep), end, prior, status)


@overflowing
def _linearised(
    sweeper: Sweeper, parameters: Array, corrections: Array
) -> tuple[Accumulator, Array, Array]:
    """The parameter system; S Q D, (n, k, N), which turns dq into corrections; and S Q E."""
    problem = sweeper.problem
    data = Accumulator(len(problem.free), True, problem.units)
    steps = np.zeros((len(problem.free), *corrections.shape))
    proposals = np.zeros_like(corrections)
    for pattern, block in sweeper.blocks(parameters, corrections):
        values = sweeper.loop_values(pattern, block)
        sweeper.evaluations += block.count
        whitened = sweeper.reduce(values, block)
        data.add(whitened.rows)
        proposals[:, block.poses] = whitened.correction
        for j, column in enumerate(whitened.D):
            steps[j][:, block.poses] = unload(whitened.G, column, block.noise)
    return data, steps, proposals
