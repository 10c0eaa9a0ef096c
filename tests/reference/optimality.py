"""How far a result is from where the gradient of the Lagrangian vanishes, from the result alone.

Stationary means: every loop closes, and there are multipliers l_i with c_i = -Sigma_i J_x^T l_i
and sum J_p^T l_i + W (p - nominal) = 0. J_x, J_p by the complex step at the corrected readings.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.estimation.result import FitResult
from tests.reference.plain_tape import complex_step, loop_values

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Optimality:
    """What keeps a result from being stationary, each a number that should be nought.

    closure: largest loop value [SI]; corrections: largest deviation from -Sigma J_x^T l [sds];
    parameters: root of the decrement g^T C g that the gradient g promises [sds]; chi_squared:
    recomputed from corrections and parameters.
    """

    closure: float
    corrections: float
    parameters: float
    chi_squared: float


def optimality(
    result: FitResult, covariances: Array, prior: dict[str, float] | None = None
) -> Optimality:
    """covariances: (N, k, k) of the readings, all finite; prior: sds by name."""
    machine = result.mechanism
    tape, names = machine.tape, machine.tape.quantities
    c = np.array([result.corrections[q] for q in names])
    x = c + np.array([result.dataset[q] for q in names])
    p = np.array([result.value[n] for n in machine.parameters.names])
    known = np.array([result.dataset[q] for q in tape.pose_constants])
    f = loop_values(tape, x, np.broadcast_to(p[:, None], (len(p), x.shape[1])), known)
    slopes = complex_step(tape, x, p, known)
    free = [machine.parameters.names.index(n) for n in result.estimated]
    nominal = np.array([machine.parameters[n].nominal for n in result.estimated])
    precision = np.array([(prior or {}).get(n, np.inf) for n in result.estimated]) ** -2.0
    gradient = precision * (p[free] - nominal)
    deviation, square = 0.0, 0.0
    for b, Sigma in enumerate(covariances):
        J = slopes.by_quantity[:, :, b].T
        multipliers = np.linalg.solve(J @ Sigma @ J.T, -J @ c[:, b])
        sd = np.sqrt(np.diag(Sigma))
        off = c[:, b] + Sigma @ J.T @ multipliers
        deviation = max(deviation, float(abs(off[sd > 0] / sd[sd > 0]).max()))
        square -= float(multipliers @ J @ c[:, b])  # c^T Sigma^-1 c = -l^T J c
        gradient = gradient + slopes.by_parameter[free][:, :, b] @ multipliers
    merit = square + float(precision @ np.square(p[free] - nominal))
    decrement = float(gradient @ result.covariance @ gradient)
    return Optimality(float(abs(f).max()), deviation, max(decrement, 0.0) ** 0.5, merit)


def diagonal(result: FitResult, sds: dict[str, Any]) -> Array:
    """Covariances (N, k, k) from sds by quantity."""
    names = result.mechanism.tape.quantities
    poses = len(result.dataset)
    stacked = np.array([np.broadcast_to(sds[q], poses) for q in names], dtype=float)
    diagonal: Array = np.einsum("ib,ij->bij", stacked**2, np.eye(len(names)))
    return diagonal
