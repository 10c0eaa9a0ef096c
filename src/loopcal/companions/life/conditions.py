"""What changed on a whole machine since its calibration, as random steps of learnt sizes.

Warmth, another load or wear change many parameters by a little. No parameter alone says so, and
what an update then keeps of the calibration is less certain than its covariance says. With what the
placement takes up removed from the whitened misclosures e of the new poses,

    e ~ N(0, phi + A A^T + sum_g s_g^2 B_g B_g^T),

A the machine's covariance as these poses see it, B_g the columns of the parameters of group g, each
times a unit step. The groups are the lengths, the angles and what lies beyond geometry, whose steps
are their prior sds. The restricted likelihood (Patterson and Thompson 1971) gives the scales s_g,
and phi >= 1, by how much more the readings of that day scatter than stated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.stats import binom, chi2

from loopcal.mechanisms.parameters import BEYOND
from loopcal.statistics.another_day import Day

Array = NDArray[np.float64]
CONDITIONS = (
    "These poses differ from the calibration as if the conditions had changed, such as warmth or a "
    "load. The update lets the whole machine drift by as much as they show."
)
_STEPS = {"length": 1e-3, "angle": 1e-3}
"""Unit steps [SI] by dimension: the usual errors of machining, so that scales are near 1."""
_NONE, _LARGEST = 1e-4, 1e2
"""Scales in unit steps: so little is no change, and more is another machine."""
_BEGINS = (1e-2, 1e-1)
"""Scales at which a search begins, for there may be more than one end."""
# Chosen, not derived: a drift that did not happen costs little, for its learnt size is small.
_UNLIKELY = 0.05
"""p-value of an unchanged machine below which it drifts."""
_SCATTER = 5.0
"""By how much the sd of the readings may exceed the stated one. It is no smaller, for with few
poses a drift of every parameter would take the place of noise."""


def drift_of_conditions(day: Day) -> Array:
    """(n_all, k) steps [SI] of one sd of each parameter; none where the readings show no drift.

    day: at a calibration whose covariance has the drift that is stated.
    """
    linear = day.linearised()
    J = linear.placement.J / np.sqrt(linear.factor)
    groups = [np.diag(steps)[:, steps > 0.0] for steps in _steps(day, linear.placement.anew)]
    none = np.zeros((J.shape[1], 0))
    seen = [linear.A, *(J @ steps for steps in groups)]
    freedom = len(linear.e) - linear.rank
    if not groups or freedom <= len(seen):
        return none
    columns = np.hstack([*seen, linear.e[:, None]])
    columns = columns - linear.F @ (linear.solve @ columns)
    owner = np.repeat(np.arange(len(seen)), [column.shape[1] for column in seen])
    likelihood = RestrictedLikelihood(columns.T @ columns, owner, freedom)
    scaled = zip(likelihood.scales(), groups, strict=True)
    return np.hstack([none, *(scale * steps for scale, steps in scaled if scale > 0.0)])


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


@dataclass(frozen=True, eq=False)
class RestrictedLikelihood:
    """-2 log of the restricted likelihood, of products of all columns.

    products: of [A B_1 ... e] with themselves; owner: of each column but the last, 0 for A;
    freedom: of what the placement leaves of e.
    """

    products: Array
    owner: NDArray[np.intp]
    freedom: int

    def __call__(self, logs: Array) -> tuple[float, Array]:
        """With its gradient; logs: of the sd of the readings over the stated one, and of scales.

        With D the scales of the columns over that sd, M = 1 + D products D and x = M^-1 D B^T e,
        a log scale of group g changes it by 2 (sum_g (1 - (M^-1)_ii) - |x_g|^2).
        """
        sd, scales = np.exp(logs[0]), np.append(1.0, np.exp(logs[1:]))
        d = scales[self.owner] / sd
        M = d[:, None] * self.products[:-1, :-1] * d + np.eye(len(d))
        e, whole = d * self.products[:-1, -1] / sd, self.products[-1, -1] / sd**2
        root = np.linalg.inv(np.linalg.cholesky(M))
        x = root.T @ (root @ e)
        change = 2.0 * (1.0 - np.square(root).sum(axis=0) - np.square(x))
        by_scale = np.bincount(self.owner, change, minlength=len(scales))[1:]
        by_sd = 2.0 * (self.freedom - whole + e @ x) - change.sum()
        log_det = -2.0 * np.log(np.diag(root)).sum() + 2.0 * self.freedom * logs[0]
        return float(whole - e @ x + log_det), np.append(by_sd, by_scale)

    def scales(self) -> Array:
        """(g,) of the groups; zeros where the readings show none of them."""
        groups = int(self.owner.max())
        scatter = (0.0, np.log(_SCATTER))
        size = (np.log(_NONE), np.log(_LARGEST))
        still = [scatter, *[(size[0], size[0])] * groups]
        least = self._least([0.0, *[size[0]] * groups], still)
        ends = [
            self._least([0.0, *[np.log(begin)] * groups], [scatter, *[size] * groups])
            for begin in _BEGINS
        ]
        best = min(ends, key=lambda end: end[0])
        # Unchanged, a scale ends at zero in half of the draws (Self and Liang 1987).
        k = np.arange(groups + 1)
        p_value = binom.pmf(k, groups, 0.5) @ chi2.sf(least[0] - best[0], np.maximum(k, 1e-9))
        if p_value > _UNLIKELY:
            return np.zeros(groups)
        scales = np.exp(best[1][1:])
        return np.where(scales > 10.0 * _NONE, scales, 0.0)

    def _least(self, begin: list[float], bounds: list[tuple[float, float]]) -> tuple[float, Array]:
        end = minimize(self, begin, jac=True, bounds=bounds, method="L-BFGS-B")
        return float(end.fun), np.asarray(end.x)
