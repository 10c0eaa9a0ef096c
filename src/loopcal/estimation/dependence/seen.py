"""What each instrument sees of the residuals: the equations of a fit along its own readings.

With the whitened equations E = D dp + v of each pose and X = the effect of the instrument's
readings in units of their sds, an error u_i of these readings in pose i moves E by X_i u_i. So

    y_i = X_i^T E_i,   A_i = X_i^T D_i,   M_i = X_i^T X_i

hold all that the readings of pose i say about u_i. They are zero where the instrument read nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.estimation.problem.error_modes import image_modes, units_of
from loopcal.estimation.problem.pose_equations import PoseEquations
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.products import rows_times
from loopcal.mechanisms.mechanism import PIXELS, Family


@dataclass(frozen=True)
class Seen:
    """N poses as q readings see them: y (N, q), A (N, q, k), M (N, q, q)."""

    y: Array
    A: Array
    M: Array

    def take(self, order: NDArray[np.intp]) -> Seen:
        """The poses at these positions, in this order."""
        return Seen(self.y[order], self.A[order], self.M[order])

    @property
    def read(self) -> NDArray[np.bool_]:
        """(N,) the poses in which anything was read."""
        return np.asarray(np.einsum("nqq->n", self.M) > 0.0)


def instruments(problem: Problem) -> tuple[Family, ...]:
    """The instruments that read some pose, whose readings may depend on each other; the whole loop
    without any."""
    mechanism = problem.mechanism
    sd = np.broadcast_to(problem.uncertainty.sd, problem.readings.shape)
    read = {
        q for q, row in zip(mechanism.tape.quantities, sd, strict=True) if np.isfinite(row).any()
    }
    families = tuple(f for f in mechanism.families if f.form != "closure")
    if families:
        return tuple(f for f in families if not read.isdisjoint(f.readings))
    readings = mechanism.outputs or mechanism.tape.quantities
    return (Family(mechanism.name, mechanism.tape.loops, tuple(readings)),)


def seen(
    problem: Problem, equations: Sequence[PoseEquations], root: Array, readings: Sequence[str]
) -> Seen:
    """The poses as these readings see them; root: (n, k) directions of the parameters [SI]."""
    errors = Errors.of(problem, readings)
    N, q, k = len(problem.poses), errors.modes.shape[1], root.shape[1]
    view = Seen(np.zeros((N, q)), np.zeros((N, q, k)), np.zeros((N, q, q)))
    for block in equations:
        X = errors.effects(problem, block)
        turned = X.transpose(0, 2, 1)
        view.y[block.poses] = np.einsum("bqr,br->bq", turned, block.E)
        view.A[block.poses] = turned @ rows_times(block.D, root)
        view.M[block.poses] = turned @ X
    return view


@dataclass(frozen=True)
class Errors:
    """How readings err together: rows, their positions (R,); modes (R, q), columns in units of
    their sds. Every reading errs by itself; those of an image, shifted and stretched as a whole.
    """

    rows: list[int]
    modes: Array

    @classmethod
    def of(cls, problem: Problem, readings: Sequence[str]) -> Errors:
        """Of these readings, in the units of the sds of a fit."""
        rows = [problem.mechanism.tape.quantities.index(q) for q in readings]
        image = {q for f in problem.mechanism.families if f.form == PIXELS for q in f.readings}
        single = [i for i, q in enumerate(readings) if q not in image]
        columns = [
            np.eye(len(rows))[i] * u
            for i, u in zip(single, units_of(problem, rows)[single], strict=True)
        ]
        columns += [mode for mode in image_modes(problem)[rows].T if mode.any()]
        modes = np.array(columns).reshape(-1, len(rows)).T
        return cls(rows, modes)

    def effects(self, problem: Problem, block: PoseEquations) -> Array:
        """(b, r, q) what they do to the equations of some poses of a problem; nothing where a
        reading is missing."""
        sd = np.broadcast_to(problem.uncertainty.sd, problem.readings.shape)[self.rows]
        missing = np.isinf(sd).T[block.poses]
        return np.asarray((block.X[:, :, self.rows] * ~missing[:, None, :]) @ self.modes)
