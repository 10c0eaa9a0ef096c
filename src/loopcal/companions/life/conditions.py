"""What changed on a whole machine since its calibration, as random steps of learnt sizes.

Warmth, another load or wear change many parameters by a little. No parameter alone says so, and
what an update then keeps of the calibration is less certain than its covariance says. With what the
placement takes up removed from the whitened misclosures e of the new poses,

    e ~ N(0, phi + A A^T + sum_g s_g^2 B_g B_g^T),

A the machine's covariance as these poses see it, B_g the columns of the parameters of group g, each
times a unit step. The groups are the lengths, the angles and what lies beyond geometry, whose steps
are their prior sds. The scales s_g are learnt as those of the terms of a calibration are
(`estimation.noise.term_scales`), without a prior; phi >= 1 is by how much more the readings of that
day scatter than stated.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom, chi2

from loopcal.arrays import Array
from loopcal.estimation.noise.search import Bounds, search
from loopcal.estimation.noise.term_scales import Sums, TermFit, evaluate, term_system
from loopcal.mechanisms.parameters import BEYOND
from loopcal.mechanisms.terms import Term
from loopcal.statistics.another_day import Day
from loopcal.statistics.innovation import Linearised

CONDITIONS = (
    "These poses differ from the calibration as if the conditions had changed, such as warmth or a "
    "load. The update lets the whole machine drift by as much as they show."
)
_STEPS = {"length": 1e-3, "angle": 1e-3}
"""Unit steps [SI] by dimension: the usual errors of machining, so that scales are near 1."""
_ANY = 1e6
"""Sd of the logarithm of a scale of which nothing is known."""
_NONE = 1e-4
"""A scale in unit steps: so little is no change."""
_BEGINS = (1e-2, 1e-1)
"""Scales at which a search begins, for there may be more than one end."""
# Chosen, not derived, and uncritical: with a drift in every case the true errors of updates after
# no change, a zero, a bend and warmth (six machines drawn anew) change by 1 % at most on average.
_UNLIKELY = 0.05
"""p-value of an unchanged machine below which it drifts."""
# A factor of e in the sd: chosen, not derived.
_FARTHEST = 2.0
"""No logarithm of a variance changes by more in one step."""


def drift_of_conditions(day: Day) -> Array:
    """(n_all, k) steps [SI] of one sd of each parameter; none where the readings show no drift.

    day: at a calibration whose covariance has the drift that is stated.
    """
    linear = day.linearised()
    J = linear.placement.J / np.sqrt(linear.factor)
    groups = [np.diag(steps)[:, steps > 0.0] for steps in _steps(day, linear.placement.anew)]
    none = np.zeros((J.shape[1], 0))
    freedom = len(linear.e) - linear.rank
    if not groups or freedom <= len(groups) + 1:
        return none
    scales = _scales(linear, [J @ steps for steps in groups])
    scaled = zip(scales.tolist(), groups, strict=True)
    return np.hstack([none, *(scale * steps for scale, steps in scaled if scale > 0.0)])


def _scales(linear: Linearised, groups: Sequence[Array]) -> Array:
    """(g,) of the groups of columns; zeros where the readings show none of them."""
    g, parts = len(groups), [linear.F, linear.A, *groups]
    rows = np.hstack([*parts, linear.e[:, None]])
    sums = Sums(np.asarray(np.linalg.qr(rows, mode="r")), True, len(rows))
    sizes = [part.shape[1] for part in parts]
    prior_sd = np.repeat([np.inf, *np.ones(g + 1)], sizes)
    owner = np.repeat(np.arange(-2, g).clip(-1), sizes)
    terms = [Term(f"group {i}", (f"group {i}",), 1.0, _ANY) for i in range(g)]
    system = term_system(sums, prior_sd, np.zeros(len(owner)), owner, terms)

    def least(begin: float, *, changed: bool) -> TermFit:
        x = np.append(0.0, np.full(g, 2.0 * np.log(begin)))
        lowest = np.append(0.0, np.full(g, 2.0 * np.log(_NONE)))
        free = np.append(True, np.full(g, changed))
        likelihood = partial(evaluate, system)
        return search(likelihood, evaluate(system, x), Bounds(lowest, free, _FARTHEST)).at

    still = least(_NONE, changed=False)
    best = min((least(begin, changed=True) for begin in _BEGINS), key=lambda at: at.criterion)
    # Unchanged, a scale ends at zero in half of the draws (Self and Liang 1987).
    k = np.arange(g + 1)
    gain = still.criterion - best.criterion
    if binom.pmf(k, g, 0.5) @ chi2.sf(gain, np.maximum(k, 1e-9)) > _UNLIKELY:
        return np.zeros(g)
    return np.where(best.scales > 10.0 * _NONE, best.scales, 0.0)


def _steps(day: Day, anew: NDArray[np.bool_]) -> list[Array]:
    """(n_all,) unit steps of each group, 0 of all other parameters."""
    calibrated = day.calibrated
    held = calibrated.estimated & ~anew
    parameters, groups = list(calibrated.mechanism.parameters), []
    for dimension, step in _STEPS.items():
        groups.append(held * [step * (p.dimension == dimension) for p in parameters])
    beyond = held & np.array([p.role in BEYOND for p in parameters])
    # Without a prior sd nothing says how large its changes may be.
    groups.append(np.where(beyond & np.isfinite(calibrated.prior_sd), calibrated.prior_sd, 0.0))
    return [group for group in groups if group.any()]
