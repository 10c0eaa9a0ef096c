"""By how much the readings of another day scatter more than stated, joints and instruments apart.

A robot that still swings when an image is taken errs by another amount in each pose, and corners of
a blurred image scatter. The calibration knows neither, so that any change of the machine which
resembles them looks sure. So let all sds of joints, or of the poses that a robot states, be a times
and all others b times as large. In the whitened misclosures of pose i (`innovation`),

    e_i = X_i t + A_i h + v_i,   h ~ N(0, 1),   v_i ~ N(0, a^2 P_i + b^2 (1 - P_i)),

X the columns of what is placed anew and of changes, P_i = B_i B_i^T what the noise of the joints
makes of e_i. With P_i = U_i diag(l) U_i^T all is diagonal, and the restricted likelihood (Patterson
and Thompson 1971) is largest at a and b. A factor counts where the likelihood ratio to 1 is beyond
chance. Of many equations of an image few see where the hand is: a scale of all would be that of the
corners.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from loopcal.arrays import Array, span
from loopcal.chi_squared import tail
from loopcal.estimation.dependence.dependence import joint_rows
from loopcal.estimation.problem.problem import Problem
from loopcal.small_samples import f_tail
from loopcal.statistics.changed import LARGER
from loopcal.statistics.innovation import Linearised
from loopcal.statistics.judged_readings import RARE

# Chosen, not derived: readings that err so much do not belong to these poses.
_MOST = 100.0
"""A factor from which on nothing scatters."""
# Chosen, not derived: the last values differ by a fiftieth, far less than the sd of a factor.
_ROUNDS, _VALUES, _CLOSER = 6, 17, 0.45
"""Rounds of so many values of one factor and then of the other, in a range that gets closer."""
# Chosen, not derived: a variance from fewer is unsure by more than its half.
_ENOUGH = 5
"""Equations that changes must leave, at least."""
# Chosen, not derived: far above rounding, far below a direction that poses show.
_SHOWN = 1e-6


@dataclass(frozen=True)
class DayNoise:
    """joints, others: how many times as large as stated the sds are, 1 where a larger one may be
    chance; freedom: degrees of freedom of the less sure of the variances that are larger."""

    joints: float = 1.0
    others: float = 1.0
    freedom: float = math.inf

    @classmethod
    def of(
        cls, linear: Linearised, changes: Array, learnt: Sequence[float] = (math.inf, math.inf)
    ) -> DayNoise:
        """Beside changes with these columns (R, m); learnt: degrees of freedom of the stated
        variances of joints and of all others."""
        rotated = _Rotated.of(linear, np.hstack([linear.F, changes]))
        if len(linear.e) - rotated.X.shape[1] < _ENOUGH or not rotated.scatters:
            return cls()
        _, least = rotated.likeliest(0, 1)
        without = [rotated.likeliest(1 - axis)[1] for axis in (0, 1)]
        sure = [axis for axis in (0, 1) if tail(max(without[axis] - least, 0.0), 1) < RARE]
        best, _ = rotated.likeliest(*sure)
        freedoms, larger = rotated.freedoms(best), np.exp(2.0 * best)
        chance = [f_tail(larger[i] * freedoms[i], freedoms[i], learnt[i]) for i in sure]
        sure = [axis for axis, p in zip(sure, chance, strict=True) if p < RARE]
        best, _ = rotated.likeliest(*sure)
        if best.max() >= math.log(_MOST):
            return cls()
        joints, others = np.exp(best).tolist()
        return cls(joints, others, float(rotated.freedoms(best)[sure].min(initial=math.inf)))

    @property
    def larger(self) -> dict[str, float]:
        """The sds of joints and of readings that are clearly larger than stated."""
        both = {"joints": self.joints, "readings": self.others}
        return {name: times for name, times in both.items() if times > LARGER}

    def within(self, problem: Problem) -> Problem:
        """The readings with these sds."""
        factors = np.full((len(problem.readings), 1), self.others)
        factors[joint_rows(problem)] = self.joints
        return replace(problem, uncertainty=problem.uncertainty.times(factors))


AS_STATED = DayNoise()


@dataclass(frozen=True, eq=False)
class _Rotated:
    """The equations of all poses along the axes of P_i: e (R, 1), X (R, m) with columns of length
    1, A (R, r), share (R,) of the noise of joints; more: equations without any such noise, which
    are most of those of images, beyond those that stand for them (below 0: so many stand for
    nothing)."""

    e: Array
    X: Array
    A: Array
    share: Array
    more: int

    @classmethod
    def of(cls, linear: Linearised, X: Array) -> _Rotated:
        placement = linear.placement
        problem, rows = placement.problem, joint_rows(placement.problem)
        quantities = problem.mechanism.tape.quantities
        sd = np.broadcast_to(problem.uncertainty.sd, problem.readings.shape)[rows]
        B = placement.columns([quantities[i] for i in rows]) * sd.T[placement.row_poses]
        X = span(X, _SHOWN)
        every = np.hstack([linear.e[:, None], X, linear.A])
        of_joints, shares, others, begin, free = [], [], [], 0, 0
        for block in placement.rows:
            b, r = block.e.shape
            part = slice(begin, begin + b * r)
            U, s, _ = np.linalg.svd(B[part].reshape(b, r, len(rows)), full_matrices=False)
            equations = every[part].reshape(b, r, -1)
            along = U.transpose(0, 2, 1) @ equations
            of_joints.append(along.reshape(s.size, every.shape[1]))
            shares.append(np.minimum(np.square(s), 1.0).ravel())
            across = equations - U @ along if r > s.shape[1] else equations[:0]
            others.append(across.reshape(-1, every.shape[1]))
            begin, free = begin + b * r, free + b * r - s.size
        alike = np.linalg.qr(np.concatenate(others), mode="r")
        rest = np.vstack([*of_joints, alike])
        share = np.concatenate([*shares, np.zeros(len(alike))])
        e, X, A = np.split(rest, [1, 1 + X.shape[1]], axis=1)
        return cls(e, X, A, share, free - len(alike))

    @property
    def scatters(self) -> bool:
        """Whether clearly larger sds of joints, or of all others, are likelier than as stated."""
        larger = [self.unlikely(LARGER**2, 1.0), self.unlikely(1.0, LARGER**2)]
        return min(larger) < self.unlikely(1.0, 1.0)

    def likeliest(self, *axes: int) -> tuple[Array, float]:
        """Logs of both factors of sds where those of these axes are likeliest and the other is 0,
        and `unlikely` there."""
        best, half = np.zeros(2), math.log(_MOST)
        for _ in range(_ROUNDS):
            for axis in axes:
                logs = np.repeat(best[None], _VALUES, axis=0)
                values = best[axis] + np.linspace(-half, half, _VALUES)
                logs[:, axis] = np.clip(values, 0.0, math.log(_MOST))
                best = logs[np.argmin([self.unlikely(*np.exp(2.0 * one)) for one in logs])]
            half *= _CLOSER
        return best, self.unlikely(*np.exp(2.0 * best))

    def freedoms(self, logs: Array) -> Array:
        """(2,) degrees of freedom of both variances at these logs (2,) of the factors: the sum of
        the squares of their shares in the variance of each equation."""
        parts = np.exp(2.0 * logs)[:, None] * np.array([self.share, 1.0 - self.share])
        squares = np.square(parts / parts.sum(axis=0)).sum(axis=1)
        return np.asarray(squares + np.array([0.0, self.more]))

    def unlikely(self, joints: float, others: float) -> float:
        """-2 log of the restricted likelihood at these factors of variances, but for a constant."""
        d = joints * self.share + others * (1.0 - self.share)
        rows = np.hstack([self.X, self.A, self.e]) / np.sqrt(d)[:, None]
        r, m = self.A.shape[1], self.X.shape[1]
        prior = np.hstack([np.zeros((r, m)), np.eye(r), np.zeros((r, 1))])
        # With h ~ N(0, 1) as rows, the squares of the diagonal are the determinants of 1 + A^T A
        # and X^T S^-1 X, and the last one is what X leaves of e.
        R = np.abs(np.diag(np.linalg.qr(np.vstack([rows, prior]), mode="r")))
        logs = np.log(d).sum() + self.more * np.log(others) + 2.0 * np.log(R[:-1]).sum()
        return float(logs + R[-1] ** 2)
