"""How large an error of the machine model would explain what the sensors do not."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from loopcal.estimation.noise.linear_model import linear_model
from loopcal.estimation.noise.variance_components import estimate_ratios
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.solve.solution import Solution
from loopcal.measurements.noise import ReadingUncertainty
from loopcal.mechanisms.model_error import disturbances, with_model_error

# Chosen, not derived: time and memory of whitening all poses, for a single number.
_MOST_POSES = 20_000
# Any value serves, because its ratio is estimated; 0.1 mm keeps this ratio near 1.
_START = 1e-4


def model_discrepancy(problem: Problem, solution: Solution) -> float | None:
    """The sd [unit of the outputs] of an isotropic error at the end point, beside the sensors.

    Restricted maximum likelihood of one further variance component at the loops as linearised by
    the fit. The fit is not repeated: it is an indication, where chi-squared is too large. None
    where the mechanism has no outputs or such an error already, or for more poses than are worth
    it.
    """
    mechanism = problem.mechanism
    names = disturbances(mechanism)
    units = {mechanism.quantities[q] for q in mechanism.outputs}
    if len(units) != 1 or mechanism.disturbances or len(problem.poses) > _MOST_POSES:
        return None
    rows = np.zeros((len(names), len(problem.poses)))
    uncertainty = problem.uncertainty
    # A unit only: what is learnt is the ratio to it.
    sd = np.vstack([uncertainty.sd, np.full((len(names), uncertainty.sd.shape[1]), _START)])
    disturbed = replace(
        problem.where_closed,
        mechanism=with_model_error(mechanism),
        readings=np.vstack([problem.readings, rows]),
        uncertainty=ReadingUncertainty(
            sd, uncertainty.blocks, (*uncertainty.sources, *("given",) * len(names))
        ),
    )
    positions = range(len(problem.readings), len(problem.readings) + len(names))
    corrections = np.vstack([solution.corrections, rows])
    model = linear_model(disturbed, solution.parameters, corrections, [list(positions)])
    return _START * math.sqrt(float(estimate_ratios(model).ratios[0]))
