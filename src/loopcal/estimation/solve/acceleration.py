"""Steps that converge slowly, accelerated: Anderson's mixing of Gauss-Newton steps.

Gauss-Newton leaves out the curvature of the loops. Along directions that the poses hardly determine
that curvature may be a good part of all there is: its steps then shrink by a constant factor, with
one sign or alternating ones, and a fit takes a hundred of them to gain what it gains elsewhere in
three. What the last steps s_j and moves d_j show of that curvature is used here,

    step = s - sum_j gamma_j (d_j + s_{j+1} - s_j),

with the gamma that leave least of s - sum_j gamma_j (s_{j+1} - s_j) in the metric of the system.
The solver takes it only where the merit falls as it does for a step of its own. Anderson, Iterative
procedures for nonlinear integral equations (1965); Walker and Ni (2011).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from loopcal.estimation.solve.reduction import Spectrum, overflowing

Array = NDArray[np.float64]
# docs/decisions/0002.
MOST = 4
"""Steps that are remembered: so many directions may converge slowly."""
# Chosen, not derived: a longer one leaves what four steps have shown.
_LONGEST = 100.0
"""An accelerated step is at most so many times as long as the step itself."""


def remembered(recent: Array | None, step: Array, move: Array) -> Array:
    """The last steps and moves, (h, 2, n) [SI], with one more of each."""
    last = np.array([[step, move]])
    return last if recent is None else np.concatenate([recent, last])[-MOST:]


@overflowing
def accelerated(recent: Array, system: Spectrum) -> Array | None:
    """The step (n,) [SI] that the last ones suggest; None where they say nothing.

    recent: (h, 2, n) steps and moves [SI] that led to where the system was made.
    """
    step = system.step()
    scale = system.scale[:, None]
    steps = np.column_stack([*recent[:, 0], step]) / scale
    changes, moves = np.diff(steps), recent[:, 1].T / scale
    turned = system.equations.times(changes)
    # The products square the condition: 1e-8 drops changes below 1e-4 of the largest one.
    gamma = np.linalg.lstsq(changes.T @ turned, turned.T @ steps[:, -1], rcond=1e-8)[0]
    scaled_step = steps[:, -1] - (moves + changes) @ gamma
    length = float(scaled_step @ system.equations.times(scaled_step))
    if not length <= _LONGEST**2 * system.decrement:
        return None
    result: Array = system.scale * scaled_step
    return result
