"""Whole solves side by side: loopcal, odrpack, and the seed's program pose by pose."""

from __future__ import annotations

import gc
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import odrpack_explicit
import ours
import seed_program
from measuring import DisagreementError, Times, in_turns
from problems import Fit, Problem, six_axis

SOLVE, CALL = "loopcal, solve", "loopcal, calibrate() as a whole"
ONE, NUMPY = "loopcal, solve on one thread", "loopcal, solve on the NumPy engine"
ODR, ODR_TAPE = "odrpack explicit, NumPy by hand", "odrpack explicit, on loopcal's tape"
SEED = "the seed's program, pose by pose"
DEMANDED = {ODR: 150.0, SEED: 400.0}
"""How many times faster than these loopcal's solve has to be."""
AGREED = 1e-6
"""Largest difference between two programs' parameters, in sds."""


@dataclass(frozen=True)
class Comparison:
    """What was measured at one number of poses: times by program, and how far results differ."""

    poses: int
    times: dict[str, Times]
    evaluations: dict[str, float]
    disagreement: float

    def ratio(self, program: str) -> float:
        """Median time of a program beside that of loopcal's solve."""
        return self.times[program].median / self.times[SOLVE].median


def compare(poses: int, rounds: int) -> Comparison:
    """Every program at so many poses; raises DisagreementError before any time is told."""
    problem = six_axis(poses)
    programs: dict[str, Callable[[], Fit]] = {
        SOLVE: ours.on_engine(ours.BEST, ours.solver(problem)),
        ONE: ours.on_engine(ours.BEST, ours.solver(problem), threads=1),
        NUMPY: ours.on_engine("numpy", ours.solver(problem)),
        CALL: ours.on_engine(ours.BEST, ours.calibrator(problem)),
        ODR: partial(odrpack_explicit.calibrate, problem, odrpack_explicit.BY_HAND),
        ODR_TAPE: partial(odrpack_explicit.calibrate, problem, odrpack_explicit.on_tape(problem)),
        SEED: partial(seed_program.calibrate, problem),
    }
    fits = {name: program() for name, program in programs.items()}
    disagreement = _checked(problem, fits)
    gc.collect()
    times = in_turns(programs, rounds=rounds, often=(SOLVE, ONE, NUMPY, CALL))
    evaluations = {name: fit.evaluations for name, fit in fits.items()}
    return Comparison(poses, times, evaluations, disagreement)


def _checked(problem: Problem, fits: dict[str, Fit]) -> float:
    sds = ours.sds(problem)
    reference = fits[SOLVE]
    worst = 0.0
    for name, fit in fits.items():
        apart = float(np.abs((fit.parameters - reference.parameters) / sds).max())
        merit = abs(fit.chi_squared / reference.chi_squared - 1.0)
        if not (apart <= AGREED and merit <= 1e-9):
            raise DisagreementError(
                f"{name} differs from {SOLVE} by {apart:.2g} sds in a parameter and by "
                f"{merit:.2g} in chi-squared: no times are told of programs that disagree"
            )
        worst = max(worst, apart)
    return worst
