"""What the poses of a fit determine: its rank, and the directions in which nothing does."""

from __future__ import annotations

import numpy as np

from loopcal.document.findings import Identifiability, Undetermined
from loopcal.document.plain import finite
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.solve.reduction import spectrum, undetermined
from loopcal.estimation.solve.solution import Solution


def identifiability(problem: Problem, solution: Solution) -> Identifiability:
    """At a solution, by its parameter system with and without the prior."""
    system = alone = solution.spectrum
    count = len(problem.free)
    if np.isfinite(problem.prior_sd).any():
        # Rank and directions do not depend on the offset, so zeros will do.
        alone = spectrum(solution.data, np.zeros(count), np.full(count, np.inf))
    return Identifiability(
        system.rank,
        count,
        alone.rank,
        finite(system.condition) if system.rank == count else None,
        tuple(Undetermined.of(c) for c in undetermined(system, problem.names)),
    )
