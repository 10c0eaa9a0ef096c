"""The course of a search: how far the next step may go.

Damping follows the steps taken (Levenberg 1944, Marquardt 1963).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.estimation.solve.acceleration import remembered
from loopcal.estimation.solve.reduction import Spectrum

Array = NDArray[np.float64]
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
            damping = max(2.0 * self.damping, 0.1 * _weakest(system))
        else:
            damping = self.damping / (10.0 if gain > _GOOD else 3.0)
            # It then shortens no step by more than a thousandth, and without it a step costs less.
            damping = damping if damping and damping > 1e-3 * _weakest(system) else 0.0
        return Course(damping, recent=remembered(self.recent, system.step(), move))

    def rejected(self, system: Spectrum) -> Course:
        """After a step that was not taken."""
        # A tenth of the weakest s^2 is the least that counts: s^2 / (s^2 + damping) = 0.91 there.
        damping = max(self.raised * self.damping, 0.1 * _weakest(system))
        raised = min(self.raised * _RAISED, _RAISED_MOST)
        return replace(self, damping=damping, raised=raised)

    def unaccelerated(self) -> Course:
        """Where the last steps have misled: they are forgotten."""
        return replace(self, recent=None)

    def returned(self) -> Course:
        """Back at the lowest point."""
        return Course(self.damping if self.damping < MOST_DAMPING else 0.0)


def _weakest(system: Spectrum) -> float:
    return float(np.square(system.singular_values[system.kept].min(initial=1.0)))
