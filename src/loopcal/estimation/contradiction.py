"""Readings stated as exact (sd 0) that contradict each other: loops that nothing may close."""

from __future__ import annotations

from typing import Final

import numpy as np

from loopcal.errors import Code, InputError, listed
from loopcal.estimation.fit import Fit
from loopcal.estimation.methods.registry import names_where
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.problem.starting import start_corrections
from loopcal.estimation.problem.weighting import Weighting
from loopcal.estimation.result import Result
from loopcal.estimation.solve.solver import solve
from loopcal.estimation.solve.sweep import Sweeper
from loopcal.measurements.dataset import Dataset
from loopcal.presentation.rounding import significant
from loopcal.presentation.shown import with_unit

CODE: Final[Code] = "exact-readings"
"""Of the error that names them."""


def refuse_contradiction(problem: Problem, data: Dataset) -> None:
    """Raise InputError where some loop has no reading with an sd above 0 that could close it.

    It names the readings stated as exact, and by how much the best fit misses them: by a
    method that weighs all loops alike.
    """
    exact = np.broadcast_to(problem.uncertainty.sd, problem.readings.shape) == 0.0
    if not exact.any():
        return
    sweeper = Sweeper(problem)
    failed = sweeper.sweep(problem.start, start_corrections(sweeper, problem.start)).singular
    if not failed:
        return
    tape = problem.mechanism.tape
    rows = [tape.quantities.index(q) for q in tape.quantities if q not in problem.mechanism.implied]
    names = [tape.quantities[i] for i in rows if exact[i].any()]
    poses = f"{failed.count} poses" if failed.count > 1 else "1 pose"
    raise InputError(
        f"{listed(names)} are stated as exact (sd 0), but the loops of {poses} cannot close, first "
        f"at pose {failed.poses[0]!r}: {_misfit(problem, data)}",
        code=CODE,
        remedy="state an sd above 0 for a reading of every loop equation, or leave out the sds and "
        f"use the method {' or '.join(names_where('exact'))}",
    )


def _misfit(problem: Problem, data: Dataset) -> str:
    """How far the best fit is from the readings, in words."""
    fit = Fit(method=names_where("exact")[0])
    alike = problem.weighted(Weighting.ALIKE)
    best = Result(fit, data, alike, solve(alike), alike)
    apart = best.accuracy_after
    if apart is not None:
        size = with_unit(apart.rms, apart.unit)
        return f"the best fit misses the measured outputs by {size} rms"
    return f"the best fit leaves loop values of {significant(best.closure_after.rms, 2)} rms"
