"""Does what a calibration leaves follow a joint, as if a parameter of the machine changed with it?

A wrist whose coupling is wrong turns a joint by a share of the one before it, and a pedestal tips
where the arm swings over an edge. No term holds such errors; they are learnt as noise of the model,
and a part of them as geometry, which is wrong where the joint was not measured. So for each
parameter p of the geometry, of what is mounted and of the placement, with its column d_i in the
whitened equations of pose i, and for each joint q, the columns

    d_i cos q_i,  d_i sin q_i    (of a slide, its range as half a turn)

stand beside all that was fitted. Their gain is chi-squared with their rank where errors are
independent. The largest of all pairs counts, with Bonferroni's correction for their number.
"""

from __future__ import annotations

import math

import numpy as np

from loopcal.arrays import Array
from loopcal.document.findings import JointErrorEntry
from loopcal.estimation.dependence.dependence import joint_rows
from loopcal.mechanisms.mechanism import PIXELS
from loopcal.mechanisms.parameters import GEOMETRY
from loopcal.statistics.ordered_system import Fitted

_ROLES = GEOMETRY | {"mounting", "placement"}
# Chosen, not derived. In 13 simulated machines without such an error the most was 0.08.
_LEAST = 0.1
"""The least share of what is left that an error explains."""


def joint_error(fit: Fitted, level: float) -> JointErrorEntry | None:
    """The likeliest error of a calibration that follows a joint; None where it explains little, or
    may be chance at this level."""
    system = fit.system
    problem, mechanism = system.problem, system.problem.mechanism
    if any(family.form == PIXELS for family in mechanism.families):
        return None
    parameters = {p.name: p for p in mechanism.parameters}
    names = [n for n in problem.names if n in parameters and parameters[n].role in _ROLES]
    if not names:
        return None
    waves: dict[int, Array] = {}
    for row in joint_rows(problem):
        q = problem.readings[row, system.order]
        if not np.isfinite(q).all() or not np.ptp(q):
            continue
        slides = mechanism.quantities[mechanism.tape.quantities[row]] != "rad"
        phase = math.pi * (q - q.min()) / np.ptp(q) if slides else q
        waves[row] = np.column_stack([np.cos(phase), np.sin(phase)])
    pairs = [
        (one.log_p(fit.spare), one.before(fit.spare) / fit.spare, name, row)
        for name in (names if waves else ())
        for row, one in zip(
            waves, fit.steps(system.columns([name])[:, :, 0], [*waves.values()]), strict=True
        )
    ]
    log_p, share, name, row = min(pairs, default=(0.0, 0.0, "", 0))
    p_value = min(1.0, math.exp(log_p) * len(pairs))
    if share < _LEAST or p_value >= level:
        return None
    low, high = float(problem.readings[row].min()), float(problem.readings[row].max())
    return JointErrorEntry(mechanism.tape.quantities[row], name, low, high, share, p_value)
