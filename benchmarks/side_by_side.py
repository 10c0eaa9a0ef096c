"""Every program on one problem: first that they find the same, then how long they take."""

from __future__ import annotations

import gc
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import ours
from measuring import DisagreementError, Times, in_turns, rounds_for, taken
from numpy.typing import NDArray
from problems import Fit, Problem
from programs import Program, Run
from threadpoolctl import threadpool_limits

APART, MERIT_APART = 1e-5, 1e-9
"""Largest difference between two programs' parameters, in sds, and of chi-squared, relative.

Every program keeps its own test of convergence; ODRPACK's, a relative change of chi-squared below
1.5e-8, leaves some 1e-6 sds.
"""


@dataclass(frozen=True)
class Comparison:
    """What was measured of one problem at one number of poses, by program; the first is loopcal.

    disagreement: the largest of parameters [sds]; evaluations: per pose.
    """

    problem: str
    poses: int
    times: dict[str, Times]
    evaluations: dict[str, float]
    disagreement: float

    def ratio(self, program: str) -> float:
        """Median time of a program beside that of the first."""
        return self.times[program].median / next(iter(self.times.values())).median


def compare(problem: Problem, programs: Sequence[Program], most_rounds: int) -> Comparison:
    """Programs in turns; raises DisagreementError unless all of them find the same."""
    poses = problem.joints.shape[1]
    runs = {p.name: p.prepare(problem) for p in programs if p.installed and poses <= p.most}
    with threadpool_limits(1, user_api="blas"):  # of what is loaded by now, for all alike
        fits, first = _once(runs)
        disagreement = _checked(problem, fits)
        gc.collect()
        rounds = {name: min(rounds_for(seconds), most_rounds) for name, seconds in first.items()}
        times = in_turns(runs, rounds)
    times = {name: t if t.seconds else Times((first[name],)) for name, t in times.items()}
    evaluations = {name: fit.evaluations for name, fit in fits.items()}
    return Comparison(problem.name, poses, times, evaluations, disagreement)


def _once(runs: Mapping[str, Run]) -> tuple[dict[str, Fit], dict[str, float]]:
    """What every program finds, and the time of its first run [s]."""
    fits, seconds = {}, {}
    for name, run in runs.items():
        begin = time.perf_counter()
        try:
            fits[name] = run()
        except RuntimeError as error:
            raise DisagreementError(f"{name} finds nothing: {error}") from error
        seconds[name] = taken(begin, fits[name])
    return fits, seconds


def _checked(problem: Problem, fits: dict[str, Fit]) -> float:
    """The largest difference of parameters from those of the first fit, in sds."""
    sds, (reference, *_) = ours.sds(problem), fits
    worst = 0.0
    for name, fit in fits.items():
        apart = _apart(fit, fits[reference], sds)
        merit = abs(fit.chi_squared / fits[reference].chi_squared - 1.0)
        if not (apart <= APART and merit <= MERIT_APART):
            raise DisagreementError(
                f"{problem.name}, {problem.joints.shape[1]:,} poses: {name} differs from "
                f"{reference} by {apart:.2g} sds in a parameter and by {merit:.2g} in "
                "chi-squared: no times are told of programs that disagree"
            )
        worst = max(worst, apart)
    return worst


def _apart(fit: Fit, reference: Fit, sds: NDArray[np.float64]) -> float:
    return float((np.abs(fit.parameters - reference.parameters) / sds).max())
