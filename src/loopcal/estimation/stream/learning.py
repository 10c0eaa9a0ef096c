"""The sds of terms learnt from a stream: the sums over its chunks say everything, round by round.

Sds by pose would need all poses at once, so of the sensors one common factor can be learnt, as
least squares does with model error.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from loopcal.errors import InputError
from loopcal.estimation.fit import Fit
from loopcal.estimation.model_error import noise_told, weighed
from loopcal.estimation.noise.estimation import NEAR, ROUGH, NoiseEstimate, scaled
from loopcal.estimation.noise.learning import components
from loopcal.estimation.noise.variances import (
    Variances,
    begun_with,
    by_common_factor,
    scales_of,
    with_scales,
)
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.solve.solution import End, Solution
from loopcal.estimation.stream.chunks import Chunk, Derived
from loopcal.measurements.noise import Noise

_MOST = 30
"""Rounds."""


@dataclass(frozen=True, eq=False)
class Weighed(Derived):
    """A stream with the noise that a fit uses; factor: of the sds that it learns."""

    fit: Fit
    factor: float = 1.0

    def chunk(self, number: int) -> Chunk:
        chunk = self.stream.chunk(number)
        noise = self.told(chunk)
        data = weighed(self.fit, chunk.data)
        return Chunk(data, noise.learnt_at(self.factor) if self.fit.method.exact else noise)

    def told(self, chunk: Chunk) -> Noise:
        """The noise of a chunk, with what is to be learnt of it."""
        noise = noise_told(self.fit, self.mechanism, chunk.data, chunk.noise)
        assert noise is not None
        return noise


@dataclass(frozen=True)
class Learnt:
    """What was learnt: problem: of the first chunk at the learnt sds; factor: of the noise."""

    problem: Problem
    factor: float
    end: End[bool]
    variances: Variances
    settled: bool

    def estimate(self, stated: Problem, noise: Noise, solution: Solution) -> NoiseEstimate:
        """As a result has it; stated: its problem at the sds where the search began."""
        found = components(stated, noise)
        present = scaled(stated, [c.quantities for c in found], np.full(len(found), self.factor**2))
        present = with_scales(replace(present, prior_sd=self.problem.prior_sd))
        return NoiseEstimate(present, solution, found, stated, self.variances, self.settled)


def refuse_several(fit: Fit, noise: Noise) -> None:
    """Raise InputError where the sensors have several sds to learn."""
    if len(noise.estimate) > (1 if fit.method.exact else 0):
        raise InputError(
            "several sds of sensors cannot be learnt from a stream: that needs all poses in memory",
            code="unsupported",
            remedy='use method = "least-squares" with an instrument that reads in one unit, or '
            "thin the poses (data.every) and set stream = false",
        )


def learn(
    fit: Fit, problem: Problem, solved: Callable[[Problem, float, float | None], End[bool]]
) -> Learnt:
    """Fits and sds in turn.

    problem: of the first chunk; solved: a fit of all chunks from a problem's start with its prior,
    the noise multiplied by a factor, to a tolerance [sds], None is the fit's own.
    """
    scales, factor, rough, iterations = scales_of(problem), 1.0, ROUGH, 0
    tolerance: float | None = rough
    settled = False
    for _ in range(_MOST):
        problem = begun_with(problem, scales)
        end = solved(problem, factor, tolerance)
        iterations += end.status.iterations
        ratio = factor**2 if fit.method.exact else None
        variances = by_common_factor(problem, end, ratio)
        assert variances.terms is not None
        changes = [np.log(variances.terms.scales / scales)]
        if ratio is not None:
            changes.append(np.log(variances.ratios / ratio))
        change = 2.0 * float(np.abs(np.concatenate(changes)).max(initial=0.0))
        settled = tolerance is None and change <= NEAR
        if settled or (tolerance is None and not end.status.converged):
            break
        problem = replace(problem, start=end.parameters)
        scales = variances.terms.scales
        factor = factor if ratio is None else float(np.sqrt(variances.ratios[0]))
        tolerance = None if change <= NEAR else min(rough, 0.1 * change)
    status = replace(end.status, iterations=iterations)
    return Learnt(problem, factor, replace(end, status=status), variances, settled)
