"""The merit of poses in memory: sweeps over them, from corrections that are kept in between."""

from __future__ import annotations

from loopcal.arrays import Array
from loopcal.errors import InputError
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.problem.starting import start_corrections
from loopcal.estimation.solve.gauss_newton import NEGLIGIBLE
from loopcal.estimation.solve.merit import Evaluation, Failed
from loopcal.estimation.solve.sweep import NEAR, Sweeper
from loopcal.expressions.domain import explain_domain


class InMemory:
    """The merit over the poses of a sweeper; its state is their corrections (k, N) [SI]."""

    def __init__(self, sweeper: Sweeper) -> None:
        self.sweeper = sweeper
        self.unknowns = sweeper.problem.unknowns
        self.evaluate, self.nearer = sweeper.sweep, sweeper.nearer

    @property
    def evaluations(self) -> int:
        """Loop evaluations so far, summed over poses."""
        return self.sweeper.evaluations

    def first(self, parameters: Array) -> Evaluation[Array]:
        """The evaluation to begin from, where unmeasured quantities are searched first.

        With closed loops where a fit of nearly these readings ended, because it may end there too.
        Raises InputError (DomainError) where a loop has no value or cannot be corrected.
        """
        problem = self.sweeper.problem
        corrections = start_corrections(self.sweeper, parameters)
        closing = NEAR if any(pattern.unmeasured for pattern in problem.patterns) else None
        if problem.first_corrections is not None:
            closing = NEGLIGIBLE
        evaluation = self.evaluate(parameters, corrections, closing=closing)
        if not evaluation.finite:
            raise outside_domain(problem, parameters)
        if evaluation.singular:
            raise cannot_close(evaluation.singular)
        return evaluation

    def close(
        self, parameters: Array, state: Array, tolerance: float, contraction: float
    ) -> Array | None:
        """Corrections that close all loops to so many sds; None where some stay open."""
        closed = self.sweeper.close(parameters, state, tolerance, contraction)
        return None if closed.failed else closed.corrections


def outside_domain(problem: Problem, parameters: Array) -> InputError:
    """What to report of loops that have no value at the readings."""
    tape, remedies = problem.mechanism.tape, problem.mechanism.remedies
    return explain_domain(
        tape, problem.readings, problem.pose_constants, parameters, problem.poses, remedies
    )


def cannot_close(singular: Failed) -> InputError:
    """What to report of poses in which a loop equation has nothing that could be corrected."""
    return InputError(
        f"the loops of {singular.count} poses cannot close, first at pose "
        f"{singular.poses[0]!r}: one equation contains no uncertain quantity",
        code="open-loops",
        remedy="give at least one quantity of every loop equation an sd above zero",
    )
