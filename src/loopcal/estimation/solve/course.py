"""The course of a search: how far the next step may go.

Damping follows the steps taken (Levenberg 1944, Marquardt 1963).

Steps that converge slowly, accelerated: Anderson's mixing of Gauss-Newton steps.

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

from dataclasses import dataclass, replace

import numpy as np

from loopcal.arrays import Array
from loopcal.estimation.solve.reduction import Spectrum, overflowing

# Unit columns have s^2 <= n, so this much divides every step by 1e8 / n at least.
MOST_DAMPING = 1e8
_RAISED, _RAISED_MOST = 2.0, 10.0
"""A rejected step raises the damping twofold, the next one fourfold, and so on up to tenfold."""
# Chosen, not derived: 0.75 as in many trust-region methods, and every fall counts.
_POOR, _GOOD = 0.0, 0.75
"""The damping rises when the merit rose, falls threefold when it fell, and tenfold when it fell by
this share of what was predicted."""


@dataclass(frozen=True)
class Course:
    """How the search goes on.

    damping: in scaled parameters; raised: by what the next rejection multiplies the damping;
    recent: (h, 2, n) [SI] what the last steps would have been undamped, and the moves made.
    """

    damping: float = 0.0
    raised: float = _RAISED
    recent: Array | None = None

    def accepted(self, system: Spectrum, move: Array, gain: float) -> Course:
        """After a move that changed the merit by a share of what was predicted."""
        if gain < _POOR:
            damping = max(2.0 * self.damping, 0.1 * system.weakest)
        else:
            damping = self.damping / (10.0 if gain > _GOOD else 3.0)
            # It then shortens no step by more than a thousandth, and without it a step costs less.
            damping = damping if damping and damping > 1e-3 * system.weakest else 0.0
        return Course(damping, recent=remembered(self.recent, system.step(), move))

    def rejected(self, system: Spectrum) -> Course:
        """After a step that was not taken."""
        # A tenth of the weakest s^2 is the least that counts: s^2 / (s^2 + damping) = 0.91 there.
        damping = max(self.raised * self.damping, 0.1 * system.weakest)
        raised = min(self.raised * _RAISED, _RAISED_MOST)
        return replace(self, damping=damping, raised=raised)

    def unaccelerated(self) -> Course:
        """Where the last steps have misled: they are forgotten."""
        return replace(self, recent=None)

    def returned(self) -> Course:
        """Back at the lowest point."""
        return Course(self.damping if self.damping < MOST_DAMPING else 0.0)


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
    return system.scale * scaled_step
