"""ODRPACK as an oracle: the same fit as explicit orthogonal distance regression, flat priors.

The joints are the explanatory variables, the point the response. ODRPACK accepts a step only if
the sum of squares falls by more than its rounding, so it may stop 1e-7 sds before the optimum;
here it is restarted until its own Newton step, from its own solution, is negligible.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.expressions.engine import engine_for
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.mechanism import Mechanism

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Regression:
    """beta, sd: (n,) of the parameters; merit: weighted sum of squares.

    remaining: largest step, in sds, that Newton's method would still take from here.
    """

    beta: Array
    sd: Array
    merit: float
    remaining: float


class ExplicitArm:
    """An arm whose loops are reached minus measured point, as y = g(joints; parameters)."""

    def __init__(self, arm: Mechanism, data: Dataset, sds: Mapping[str, float]) -> None:
        names = arm.tape.quantities
        self.joints = [i for i, name in enumerate(names) if name not in arm.outputs]
        self.quantities = len(names)
        self.engine = engine_for(arm.tape, arm.tape.parameters, len(data))
        self.x = np.array([data[names[i]] for i in self.joints])
        self.y = np.array([data[name] for name in arm.outputs])
        weights = np.array([1 / sds[names[i]] ** 2 for i in self.joints])
        weights_y = np.array([1 / sds[name] ** 2 for name in arm.outputs])
        # weights of order one: with 1/sd^2 ODRPACK's tests of convergence are not to be trusted
        self.scale = max(weights.max(), weights_y.max())
        self.weight_x, self.weight_y = weights / self.scale, weights_y / self.scale

    def _at(self, x: Array, beta: Array) -> Any:
        full = np.zeros((self.quantities, x.shape[1]))
        full[self.joints] = x
        return self.engine.evaluate(beta, full)

    def point(self, x: Array, beta: Array) -> Array:
        """g (3, N)."""
        return np.array(self._at(x, beta).f)

    def by_parameter(self, x: Array, beta: Array) -> Array:
        """(3, n, N)."""
        return np.array(self._at(x, beta).by_parameter.transpose(1, 0, 2))

    def by_joint(self, x: Array, beta: Array) -> Array:
        """(3, joints, N)."""
        return np.array(self._at(x, beta).by_quantity[self.joints].transpose(1, 0, 2))

    def _fit(self, odrpack: Any, beta: Array) -> Regression:
        found = odrpack.odr_fit(
            self.point,
            self.x,
            self.y,
            beta,
            weight_x=self.weight_x,
            weight_y=self.weight_y,
            jac_beta=self.by_parameter,
            jac_x=self.by_joint,
            maxit=200,
            sstol=1e-16,
            partol=1e-16,
        )
        # the last digit tells convergence; those ahead of it doubt derivatives where they vanish
        assert found.info % 10 in (1, 2, 3), found.stopreason
        # odrpack multiplies by the residual variance; ours are the sds that were stated
        covariance = found.cov_beta / self.scale
        misfit = self.point(self.x + found.delta, found.beta) - self.y
        slopes = self.by_parameter(self.x + found.delta, found.beta)
        gradient = np.einsum("qpn,q,qn->p", slopes, self.weight_y * self.scale, misfit)
        sd = np.sqrt(np.diag(covariance))
        remaining = float(abs(covariance @ gradient / sd).max())
        return Regression(found.beta, sd, found.sum_square * self.scale, remaining)

    def solve(self, odrpack: Any, start: Array, enough: float, restarts: int = 25) -> Regression:
        """The best of several runs, each from near the last one's solution."""
        rng = np.random.default_rng(0)
        best = current = self._fit(odrpack, start)
        for _ in range(restarts):
            if best.remaining <= enough:
                break
            nearby = current.beta + 1e-2 * current.sd * rng.normal(size=len(start))
            current = self._fit(odrpack, nearby)
            best = min(best, current, key=lambda run: run.remaining)
        return best
