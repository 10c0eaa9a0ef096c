"""odrpack, explicit, with analytic derivatives: joints explain, the measured point responds.

Weights are divided by their largest: with 1/sd^2 as it stands ODRPACK's tests of convergence
cannot be trusted. Its interface checks the derivatives given against differences, some 340
evaluations of the model, and offers no way to leave that out; derivatives that are zero, as some
are in any arm, it calls "possibly not correct" for being zero.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import geometric_arm
import numpy as np
import odrpack
from numpy.typing import NDArray
from problems import Fit, Problem

from loopcal.expressions.engine import Stage, engine_for

Array = NDArray[np.float64]
Model = Callable[[Array, Array], Array]


@dataclass(frozen=True)
class Callbacks:
    """g(joints (6, N), parameters (27,)): (3, N); its derivatives (3, 6, N) and (3, 27, N)."""

    point: Model
    by_joint: Model
    by_parameter: Model


BY_HAND = Callbacks(geometric_arm.point, geometric_arm.by_joint, geometric_arm.by_parameter)


def on_tape(problem: Problem) -> Callbacks:
    """loopcal's own tape and engine as callbacks, each evaluating no more than it returns."""
    tape, poses = problem.mechanism.tape, problem.joints.shape[1]
    joints = engine_for(tape, (), poses, quantities=tape.quantities[:6])
    parameters = engine_for(tape, tape.parameters, poses, quantities=())
    x = np.zeros((9, poses))

    def point(at: Array, p: Array) -> Array:
        x[:6] = at
        joints.at(p)
        return np.array(joints.evaluate(x, stage=Stage.VALUES).f)

    def by_joint(at: Array, p: Array) -> Array:
        x[:6] = at
        joints.at(p)
        return np.array(joints.evaluate(x).by_quantity.transpose(1, 0, 2))

    def by_parameter(at: Array, p: Array) -> Array:
        x[:6] = at
        parameters.at(p)
        return np.array(parameters.evaluate(x).by_parameter.transpose(1, 0, 2))

    return Callbacks(point, by_joint, by_parameter)


def calibrate(problem: Problem, callbacks: Callbacks) -> Fit:
    """The fit; raises RuntimeError where ODRPACK does not converge."""
    weights_x, weights_y = problem.joint_sds**-2, problem.point_sds**-2
    scale = max(weights_x.max(), weights_y.max())
    found = odrpack.odr_fit(
        callbacks.point,
        problem.joints,
        problem.points,
        problem.nominal,
        weight_x=weights_x / scale,
        weight_y=weights_y / scale,
        jac_beta=callbacks.by_parameter,
        jac_x=callbacks.by_joint,
        maxit=100,
    )
    if found.info % 10 not in (1, 2, 3):  # its last digit tells of convergence
        raise RuntimeError(f"odrpack did not converge: {found.stopreason}")
    return Fit(found.beta, found.sum_square * scale, float(found.nfev + 2 * found.njev))
