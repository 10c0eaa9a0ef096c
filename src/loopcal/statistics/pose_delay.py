"""Whether what was read of a pose is on the way to the next one, or still on that from the last.

A robot that states its pose before it stands, or a camera that takes its image later, reads
x_i + s m_i where the instrument saw x_i. The motion m_i leads to the next pose, or to the last one;
s is the same share of it in all poses. Its column in the whitened equations is c_i = sum_q m_iq C_q
of the readings q of the machine. An error of the machine is a function of x_i alone, and backlash
one of the sign of m_i. So beside the parameters stand, for each q, columns of x_i and of sign(m_i);
in an order that the joints tell, m_i is a function of x_i, and nothing is sought. With what all of
these leave, r_i of the equations and d_i of c_i,

    s = sum_i u_i / sum_i g_i,  u_i = d_i^T r_i,  g_i = d_i^T d_i,
    sd(s)^2 = N / f sum_i (u_i - s g_i)^2 / (sum_i g_i)^2,

which holds whatever the equations of one pose share (White 1980); s / sd is Student's t with
f = N - 1 less the columns. All other columns of the fit count in poses: so many as they have
numbers of the machine. An image of 100 corners says no more of its pose than those.
"""

from __future__ import annotations

import math

import numpy as np

from loopcal.arrays import Array
from loopcal.document.findings import DelayEntry
from loopcal.estimation.dependence.dependence import joint_rows
from loopcal.small_samples import f_tail
from loopcal.statistics.ordered_system import Fitted
from loopcal.statistics.run_order import motions, told_by_joints

# Chosen, not derived: a poorer explanation may be one of something else.
_SHARE = 0.5
"""The least share of what is left along the motions that a delay explains."""


def pose_delay(fit: Fitted) -> DelayEntry | None:
    """The likelier of both delays of a calibration; None where it explains little, where the joints
    tell the order, and of few poses."""
    system = fit.system
    rows, order = joint_rows(system.problem), system.order
    at = motions(system.problem, rows, order)
    if not rows or told_by_joints(at) is not None:
        return None
    names = [system.problem.mechanism.tape.quantities[i] for i in rows]
    along, i = -system.columns(names), np.arange(len(at))  # what the readings exceed
    entries = []
    for step in (1, -1):
        to = order[np.clip(i + step, 0, len(at) - 1)]
        entry = _entry(fit, along, at, motions(system.problem, rows, to, order), step > 0)
        entries += [] if entry is None else [entry]
    return min(entries, key=lambda one: one.p_value, default=None)


def _entry(fit: Fitted, along: Array, at: Array, motion: Array, ahead: bool) -> DelayEntry | None:
    """One of both delays; at, motion: (N, q) of the readings whose columns are along (N, R, q)."""
    beside = fit.beside(along * at[:, None]).beside(along * np.sign(motion)[:, None])
    u, g = beside.by_pose(np.einsum("nrq,nq->nr", along, motion)[:, :, None])
    system = fit.system
    used = float(system.count.sum()) - fit.spare
    numbers = np.minimum(system.equations, at.shape[1]).mean()
    freedom = len(u) - 1 - 2 * at.shape[1] - math.ceil(used / numbers)
    if freedom < 1 or not g.sum() > 0.0:
        return None
    share = float(u.sum() / g.sum())
    sd = math.sqrt(float(np.square(u - share * g).sum()) * len(u) / freedom) / float(g.sum())
    moving = g > 0.0
    explained = share * float(u.sum()) / float((np.square(u[moving]) / g[moving]).sum())
    if explained < _SHARE or not sd:
        return None
    # both are tried
    return DelayEntry(ahead, share, sd, min(1.0, 2.0 * f_tail((share / sd) ** 2, 1, freedom)))
