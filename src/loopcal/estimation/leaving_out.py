"""Where a fit without some of its poses will end, nearly: one step from the fit of all.

The sums over all poses less those of the poses that are left out, both linearised where the fit of
all ended, give the scales of the terms and one Gauss-Newton step. The fit of the rest begins there
instead of at the fit of all, and converges as it would from anywhere.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError
from loopcal.estimation.problem.problem import taken
from loopcal.estimation.result import FitResult
from loopcal.estimation.solve.reduction import Accumulator, spectrum
from loopcal.estimation.solve.scratch import one_blas_thread
from loopcal.estimation.solve.sweep import Sweeper
from loopcal.mechanisms.mechanism import Mechanism

# Chosen, not derived: far above the rounding of sums, far below a share that counts.
_LITTLE = 1e-9
"""Share of a parameter's information that rounding may leave where only the poses left out have
any: those of a station, of where it stands."""


@dataclass(frozen=True)
class Beginning:
    """Where a fit begins.

    values: of all parameters [SI]; mechanism: with the sds of its terms as its priors; factor: of
    the sds of all noise, beside those of the fit of all poses.
    """

    values: Mapping[str, float]
    mechanism: Mechanism
    factor: float = 1.0


def leaving_out(whole: FitResult, index: NDArray[np.intp]) -> Beginning | None:
    """Where the fit of all other poses begins; None where these say nothing of a parameter.

    whole: the fit of all poses; index: positions of those left out.
    """
    problem, end = whole.problem, whole.solution
    with one_blas_thread():
        try:
            part = Sweeper(taken(problem, index))
            gone = part.sweep(end.parameters, end.corrections[:, index])
        except InputError:
            return None
        rest = Accumulator(len(problem.free), False, problem.units)
        # Sums of products can be subtracted; the digits that this loses do not matter for a start.
        rest.add_total(end.data.products - gone.data.total)
        left, all_ = (
            np.diag(sums)[: len(problem.free)] for sums in (rest.total, end.data.products)
        )
        if (left < _LITTLE * all_).any():
            return None
        factor = 1.0
        if problem.mechanism.learnt_terms:
            from loopcal.estimation.noise.term_scales import Sums
            from loopcal.estimation.noise.variances import (
                all_learnt,
                begun_with,
                learnt_terms,
                with_scales,
            )

            sums = Sums(rest.total, False, end.equations - gone.equations)
            learnt = whole.estimate.stated if whole.estimate else ()
            positions = [component.quantities for component in learnt]
            offset = problem.unknowns.offset(end.parameters)
            common = all_learnt(problem, positions)
            terms = learnt_terms(problem, sums, offset, common=common)
            problem, factor = with_scales(begun_with(problem, terms.scales)), terms.at.factor
            # The sums are whitened at the fit's sds; noise larger by this factor weighs them less.
            rest.total /= factor
        unknowns = problem.unknowns
        system = spectrum(rest, unknowns.offset(end.parameters), unknowns.prior_sd)
        after = unknowns.moved(end.parameters, system.step())
    if not np.isfinite(after).all():
        return None
    names = problem.mechanism.parameters.names
    values = dict(zip(names, after.tolist(), strict=True))
    return Beginning(values, problem.mechanism, math.sqrt(factor))
