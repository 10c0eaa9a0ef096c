"""The course of a search: how far the next step may go, and whether it may rise.

Damping follows the steps taken (Levenberg 1944, Marquardt 1963). Where poses are alike, the merit
has long, narrow, curved valleys, which a search that must descend at every step follows in hundreds
of tiny steps. A step that keeps the direction of the one before may therefore raise the merit,
because the next step leads back to the floor of the valley (Transtrum and Sethna 2012).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.estimation.solve.acceleration import remembered
from loopcal.estimation.solve.reduction import Spectrum

Array = NDArray[np.float64]
MOST_DAMPING = 1e8
_RAISED, _RAISED_MOST = 2.0, 10.0
"""A rejected step raises the damping twofold, the next one fourfold, and so on up to tenfold."""
_POOR, _GOOD = 0.0, 0.75
"""The damping rises when the merit rose, falls threefold when it fell, and tenfold when it fell by
this share of what was predicted."""


@dataclass(frozen=True)
class Course:
    """How the search goes on.

    damping: in scaled parameters; last_step: (n,) [SI], None where there is none; descend: whether
    every step must lower the merit; raised: by what the next rejection multiplies the damping;
    recent: (h, 2, n) [SI] the last undamped steps and the moves made of them, None where the last
    one was damped.
    """

    damping: float = 0.0
    last_step: Array | None = None
    descend: bool = False
    raised: float = _RAISED
    recent: Array | None = None

    def accepted(self, system: Spectrum, step: Array, gain: float) -> Course:
        """After a step that changed the merit by a share of what was predicted."""
        if gain < _POOR:
            damping = max(2.0 * self.damping, 0.1 * _weakest(system))
        else:
            damping = self.damping / (10.0 if gain > _GOOD else 3.0)
            damping = damping if damping and damping > 1e-3 * _weakest(system) else 0.0
        undamped = not self.damping and not gain < _POOR
        recent = remembered(self.recent, system.step(), step) if undamped else None
        return Course(damping, step, self.descend, recent=recent)

    def rejected(self, system: Spectrum) -> Course:
        """After a step that was not taken."""
        damping = max(self.raised * self.damping, 0.1 * _weakest(system))
        raised = min(self.raised * _RAISED, _RAISED_MOST)
        return replace(self, damping=damping, raised=raised, recent=None)

    def unaccelerated(self) -> Course:
        """Where the last steps have misled: they are forgotten."""
        return replace(self, recent=None)

    def returned(self) -> Course:
        """Back at the lowest point: from there every step must descend."""
        return Course(self.damping if self.damping < MOST_DAMPING else 0.0, descend=True)

    def may_rise(self, scale: Array, step: Array) -> float:
        """The share of the merit after a step that must not exceed the merit before it.

        It is one minus the cosine between the step and the one before, in scaled parameters.
        """
        if self.descend or self.last_step is None:
            return 1.0
        one, two = step / scale, self.last_step / scale
        return 1.0 - float(one @ two) / max(math.sqrt((one @ one) * (two @ two)), 1e-300)


def _weakest(system: Spectrum) -> float:
    return float(np.square(system.singular_values[system.kept].min(initial=1.0)))
