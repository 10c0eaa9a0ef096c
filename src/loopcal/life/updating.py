"""A calibration of another day that begins from what is known already.

Yesterday's parameters p_0 with covariance C are the prior of today's fit, after a drift allowance
Q = diag(q_i^2): with K the contrasts that neither a moved instrument nor an undetermined direction
of yesterday touches, rows of unit variance under C + Q,

    minimise   Phi(p) + |K (p - p_0)|^2,

Phi the merit of the new poses (`loopcal.estimation.solve.merit`). Where the problem is linear and
nothing moved, the end is that of all poses fitted at once (Kalman 1960): yesterday's poses enter
by their sums.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError, nearest
from loopcal.estimation.calibrate import calibrate
from loopcal.estimation.fit import Fit
from loopcal.estimation.methods.method import Method
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.problem.unknowns import Unknowns
from loopcal.estimation.result import Result
from loopcal.estimation.solve.in_memory import InMemory
from loopcal.estimation.solve.loss import Loss
from loopcal.estimation.solve.merit import Evaluation
from loopcal.estimation.solve.scratch import one_blas_thread
from loopcal.estimation.solve.solution import Solution
from loopcal.estimation.solve.solver import Progress, solve_with
from loopcal.estimation.solve.sweep import Sweeper
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise, NoiseLike
from loopcal.statistics.calibrated import Calibrated
from loopcal.statistics.innovation import root_of
from loopcal.statistics.replacing import Freedom, Replaced, replaced
from loopcal.statistics.verification import as_learnt, day_problem, noise_of

Array = NDArray[np.float64]
KINDS = ("length", "angle", "mounting", "gain", "effect")
"""Kinds of parameters that may drift."""
LABEL = "implicit loop, updated"
"""Of the method, in the result of an update."""
_RANK = 1e-12


def update(
    calibration: Result | Calibrated,
    data: Dataset | Any,
    *,
    noise: NoiseLike | None = None,
    moved: bool = True,
    remounted: bool | Sequence[str] = False,
    drift: Mapping[str, float] | None = None,
) -> Result:
    """Calibrate with new readings and what a calibration already knows.

    data: readings [SI] as `calibrate` takes them; noise: their sds, else the calibration's; moved:
    whether instruments stand elsewhere, so that nothing is known of their placement; remounted: as
    in `verify`; drift: sd [SI] by which parameters may have changed since, by kind ("length",
    "angle", "mounting", "gain", "effect") or by name. The prior is the covariance of the
    calibration (Kalman 1960).

    Raises InputError for a calibration or readings without sds, and for a kind that is not there.
    """
    known = Calibrated.of(calibration, "") if isinstance(calibration, Result) else calibration
    data = data if isinstance(data, Dataset) else Dataset.from_arrays(data)
    stated = Noise.of(noise)
    if known.residual is not None and stated is None:
        raise InputError(
            "the calibration took its readings as exact, so their sds are unknown",
            code="missing-sd",
            remedy="give noise, or update a calibration by another method",
        )
    known = replace(known, residual=None)
    if stated is None:
        stated, data = noise_of(known), as_learnt(known, data)
    with one_blas_thread():
        problem = day_problem(known, data, stated)
        freedom = Freedom.of(known.mechanism, remounted)
        if not moved:
            freedom = _without_placement(known, freedom)
        here = replaced(problem, freedom)
        free = [i for i, p in enumerate(known.mechanism.parameters) if not p.fixed]
        prior = _Prior.of(known, here, np.array(free), _drifts(known, drift or {}))
    method = Method(
        name="implicit-loop",
        label=LABEL,
        description="Implicit loop: every sensor is uncertain, and an earlier calibration is the "
        "prior.",
        solve=partial(_solved, prior=prior),
    )
    names = known.mechanism.parameters.names
    begun = replace(known.mechanism, terms=()).with_nominal(
        dict(zip(names, here.parameters.tolist(), strict=True))
    )
    sds = {names[i]: float(sd) for i, sd in zip(free, prior.sds, strict=True)}
    begun = begun.with_parameters(begun.parameters.with_prior(sds))
    return calibrate(
        begun, data, noise=stated, fit=Fit(method=method, start="nominal"), trusted=True
    )


def _without_placement(known: Calibrated, freedom: Freedom) -> Freedom:
    """What else was mounted anew: the instruments stand where they stood."""
    standing = set(Freedom.of(known.mechanism).names)
    return Freedom(tuple(n for n in freedom.names if n not in standing))


def _drifts(known: Calibrated, drift: Mapping[str, float]) -> Array:
    """(n_all,) sds [SI] of the drift of each parameter."""
    parameters, kinds = known.mechanism.parameters, known.mechanism.kinds
    found = np.zeros(len(parameters))
    for key, sd in drift.items():
        if not sd >= 0.0:
            raise InputError(
                f"the drift of {key!r} is {sd!r}",
                code="invalid-value",
                remedy="give an sd above zero, or leave it out",
            )
        if key not in KINDS and key not in parameters.names:
            raise InputError(
                f"there is no parameter and no kind of parameter {key!r}",
                code="unknown-name",
                remedy=nearest(key, (*KINDS, *parameters.names)),
            )
        for i, name in enumerate(parameters.names):
            if name == key or (key in KINDS and kinds[name] == key):
                found[i] = sd
    return found


class _Prior:
    """What a calibration knows of the estimated parameters: |rows (p - centre)|^2.

    rows: (q, n) of unit variance; centre: (n,); sds: (n,) of single parameters, inf where they are
    found anew.
    """

    def __init__(self, rows: Array, centre: Array, sds: Array) -> None:
        self.rows, self.centre, self.sds = rows, centre, sds

    @classmethod
    def of(cls, known: Calibrated, here: Replaced, free: NDArray[np.intp], drifts: Array) -> _Prior:
        """The covariance with the drift, where the machine stands now."""
        held = ~here.anew[:, None]
        root = here.brought(np.hstack([root_of(known.covariance.matrix), np.diag(drifts)]) * held)
        C = (root @ root.T)[np.ix_(free, free)]
        loose = here.brought(known.undetermined * held)[free]
        whole = here.directions[:, : here.directions.shape[1] - int(here.anew.sum())][free]
        open_ = np.hstack([loose, whole, np.eye(len(C))[:, here.anew[free]]])
        sd = np.sqrt(np.maximum(np.diag(C), 0.0))
        scale = np.where(sd > 0.0, sd, 1.0)
        U, s, _ = np.linalg.svd(np.hstack([open_ / scale[:, None], np.zeros((len(C), 1))]))
        K = U[:, int((s > 1e-9 * max(s.max(), 1e-300)).sum()) :].T / scale
        values, vectors = np.linalg.eigh(K @ C @ K.T)
        kept = values > _RANK * max(float(values.max(initial=0.0)), 1e-300)
        rows = (vectors[:, kept] / np.sqrt(values[kept])).T @ K
        known_at_all = (np.abs(rows).max(axis=0, initial=0.0) > 0.0) & (sd > 0.0)
        return cls(rows, here.parameters[free], np.where(known_at_all, sd, np.inf))


class _WithPrior(InMemory):
    """The merit of poses in memory, and the prior as further equations."""

    def __init__(self, sweeper: Sweeper, prior: _Prior) -> None:
        super().__init__(sweeper)
        self.prior = prior
        self.unknowns: Unknowns = self.unknowns.without_prior()
        self.evaluate = self._evaluated

    def _evaluated(
        self,
        parameters: Array,
        corrections: Array,
        *,
        triangular: bool = False,
        closing: float | None = None,
        contraction: float = 1.0,
    ) -> Evaluation[Array]:
        how: dict[str, Any] = {"triangular": triangular, "closing": closing}
        found = self.sweeper.sweep(parameters, corrections, contraction=contraction, **how)
        rows, away = self.prior.rows, self.prior.centre - parameters[self.unknowns.free]
        found.data.add(np.vstack([rows.T, rows @ away])[:, :, None])
        return found


def _solved(
    problem: Problem,
    *,
    prior: _Prior,
    loss: Loss | None = None,
    max_iterations: int = 100,
    tolerance: float | None = None,
    progress: Progress | None = None,
) -> Solution:
    """The fit of these poses with the prior, whose own equations no loss weighs."""
    with one_blas_thread():
        return solve_with(
            _WithPrior(Sweeper(problem, loss=loss), prior),
            max_iterations=max_iterations,
            tolerance=tolerance,
            progress=progress,
        )
