"""odrpack, explicit, with analytic derivatives: joints explain, the measured point responds.

Weights are divided by their largest: with 1/sd^2 as it stands ODRPACK's tests of convergence
cannot be trusted. Its interface checks the derivatives given against differences, some 340
evaluations of the model, and offers no way to leave that out; derivatives that are zero, as some
are in any arm, it calls "possibly not correct" for being zero.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import odrpack
from numpy.typing import NDArray
from problems import Fit, Problem

from loopcal.expressions.engine import Stage, engine_for

Array = NDArray[np.float64]


def on_tape(problem: Problem) -> Problem:
    """The same problem, its model loopcal's own tape: each evaluates what it returns."""
    tape, (J, poses) = problem.mechanism.tape, problem.joints.shape
    names = problem.quantities[:J]
    joints = engine_for(tape, (), poses, quantities=names)
    parameters = engine_for(tape, tape.parameters, poses, quantities=())
    rows = [tape.quantities.index(name) for name in names]
    x = np.zeros((len(tape.quantities), poses))

    def point(at: Array, p: Array) -> Array:
        x[rows] = at
        return np.array(joints.evaluate(p, x, stage=Stage.VALUES).f)

    def by_joint(at: Array, p: Array) -> Array:
        x[rows] = at
        return np.array(joints.evaluate(p, x).by_quantity.transpose(1, 0, 2))

    def by_parameter(at: Array, p: Array) -> Array:
        x[rows] = at
        return np.array(parameters.evaluate(p, x).by_parameter.transpose(1, 0, 2))

    model = replace(problem.model, point=point, by_joint=by_joint, by_parameter=by_parameter)
    return replace(problem, model=model)


def calibrate(problem: Problem) -> Fit:
    """The fit; raises RuntimeError where ODRPACK does not converge."""
    weights_x, weights_y = problem.joint_sds**-2, problem.point_sds**-2
    scale = max(weights_x.max(), weights_y.max())
    found = odrpack.odr_fit(
        problem.model.point,
        problem.joints,
        problem.points,
        problem.nominal,
        weight_x=weights_x / scale,
        weight_y=weights_y / scale,
        jac_beta=problem.model.by_parameter,
        jac_x=problem.model.by_joint,
        maxit=100,
    )
    if found.info % 10 not in (1, 2, 3):  # its last digit tells of convergence
        raise RuntimeError(f"odrpack did not converge: {found.stopreason}")
    return Fit(found.beta, found.sum_square * scale, float(found.nfev + 2 * found.njev))
