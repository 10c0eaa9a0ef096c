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
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError, nearest
from loopcal.estimation.calibrate import LEARNT, calibrate
from loopcal.estimation.fit import Fit
from loopcal.estimation.inherited import UPDATED, Inherited
from loopcal.estimation.methods.method import Method
from loopcal.estimation.problem.constants import with_latest
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
from loopcal.life.both_days import learnt
from loopcal.life.earlier import Around, Coordinates, Earlier
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise, NoiseLike
from loopcal.statistics.calibrated import Calibrated
from loopcal.statistics.replacing import Freedom, Replaced, replaced
from loopcal.statistics.verification import as_learnt, day_problem, noise_of, verify
from loopcal.statistics.verified import Verification

Array = NDArray[np.float64]
KINDS = ("length", "angle", "mounting", "gain", "effect")
"""Kinds of parameters that may drift."""
_MIXED = "The update mixes both machines. Calibrate anew, or state the drift that is expected."
_RANK = 1e-12
_ROUNDS, _SETTLED = 12, 2e-2
"""Fits, each near the end of the last, until they end within so many sds, at sds that settle."""


@dataclass(frozen=True)
class Since:
    """What may have changed since a calibration, as `update` takes it."""

    moved: bool = True
    remounted: bool | Sequence[str] = False
    drift: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Updated:
    """An update. check: whether the new readings are of the machine that was calibrated, after the
    stated drift."""

    result: Result
    check: Verification

    @property
    def mixed(self) -> str | None:
        """Why the update mixes two machines; None where it does not."""
        answer = self.check.verdict["consistent"]
        return f"{answer.words} {_MIXED}" if answer.passed is False else None


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
    calibration (Kalman 1960), near the end of the update as its poses say (Bell 1994). A warning of
    the result says where the readings are of another machine (`verify`).

    Raises InputError for a calibration or readings without sds, and for a kind that is not there.
    """
    return updated(calibration, data, Since(moved, remounted, drift or {}), noise).result


def updated(
    calibration: Result | Calibrated, data: Dataset | Any, since: Since, noise: NoiseLike | None
) -> Updated:
    """`update`, with the check of the machine."""
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
    drifts = _drifts(known, since.drift)
    check = verify(known.drifted(drifts), data, noise=stated, remounted=since.remounted)
    held = stated is not None
    if stated is None:
        stated, data = noise_of(known), as_learnt(known, data)
    data = with_latest(known.mechanism, data)
    with one_blas_thread():
        problem = day_problem(known, data, stated)
        freedom = Freedom.of(known.mechanism, since.remounted)
        if not since.moved:
            freedom = _without_placement(known, freedom)
        here = replaced(problem, freedom)
        earlier = Earlier.of(known, with_poses=not freedom.whole)
    found: Result | None = None
    for _ in range(_ROUNDS):
        before = found
        with one_blas_thread():
            prior = _Prior.of(known, here, drifts, earlier, before)
        found = _fitted(known, here, prior, data, stated, before)
        with one_blas_thread():
            sds = None if held else learnt(known, earlier, found, here.anew, drifts)
        if sds is not None:
            known = replace(known, noise=sds.noise)
            stated, earlier = noise_of(known), earlier.at_sds(known)
        settled = sds is None or sds.change < _SETTLED
        if before is not None and settled and _apart(found, before) < _SETTLED:
            break
    assert found is not None
    with one_blas_thread():
        terms = calibration.told_terms() if isinstance(calibration, Result) else known.terms
        noted = () if held else known.noise
        found = replace(found, inherited=Inherited(prior.widened(found), terms, noted))
    done = Updated(found, check)
    return done if done.mixed is None else replace(done, result=found.noted(done.mixed))


def _fitted(
    known: Calibrated,
    here: Replaced,
    prior: _Prior,
    data: Dataset,
    noise: Noise,
    before: Result | None,
) -> Result:
    """The fit of these readings with the prior, begun where the machine stands or where it ended
    before."""
    method = Method(
        name="implicit-loop",
        label=UPDATED,
        description="Implicit loop: every sensor is uncertain, and an earlier calibration is the "
        "prior.",
        solve=partial(_solved, prior=prior),
    )
    names = known.mechanism.parameters.names
    begun = replace(known.mechanism, terms=()).with_nominal(
        dict(zip(names, here.parameters.tolist(), strict=True))
    )
    sds = {names[i]: float(sd) for i, sd in zip(prior.free, prior.sds, strict=True)}
    begun = begun.with_parameters(begun.parameters.with_prior(sds))
    start = "nominal" if before is None else before.value
    near = dict(zip(here.problem.mechanism.tape.quantities, here.corrections, strict=True))
    how = Fit(method=method, start=start, tolerance=LEARNT)
    return calibrate(begun, data, noise=noise, fit=how, near=near, trusted=True)


def _apart(a: Result, b: Result) -> float:
    """The largest difference of two fits [sds]."""
    sd = np.sqrt(np.diag(a.spectrum.covariance()))
    away = np.abs(a.solution.parameters - b.solution.parameters)[a.problem.free]
    return float((away / np.where(sd > 0.0, sd, np.inf)).max(initial=0.0))


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


@dataclass(frozen=True, eq=False)
class _Prior:
    """What a calibration knows of the estimated parameters: |rows (phi(p) - m)|^2.

    rows: (q, n) of unit variance; centre: (n_all,) where m stands; free: (n,) positions; sds: (n,)
    of single parameters, inf where they are found anew; wider: (q, q) by how much the covariance of
    the rows is larger than the information of the calibration says; around, follows: phi.
    """

    rows: Array
    centre: Array
    free: NDArray[np.intp]
    sds: Array
    wider: Array
    around: Around
    follows: Array

    @classmethod
    def of(
        cls,
        known: Calibrated,
        here: Replaced,
        drifts: Array,
        earlier: Earlier,
        before: Result | None,
    ) -> _Prior:
        """The covariance with the drift, where the machine stands now.

        before: a fit whose end is near that of the next one.
        """
        free = np.flatnonzero([not p.fixed for p in known.mechanism.parameters])
        around = earlier.around(earlier.begin)
        if before is not None:
            around = earlier.beside(before.solution.parameters, here.anew)
        held = ~here.anew[:, None]
        root = here.brought(around.root * held)[free]
        drift = here.brought(np.diag(drifts) * held)[free]
        C = root @ root.T + drift @ drift.T
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
        carried = rows @ here.brought(around.carried * held)[free]
        known_at_all = (np.abs(rows).max(axis=0, initial=0.0) > 0.0) & (sd > 0.0)
        centre = np.where(here.anew, here.parameters, around.mean)
        return cls(
            rows,
            here.parameters if around.seen is None and before is None else centre,
            free,
            np.where(known_at_all, sd, np.inf),
            carried @ earlier.wider(known) @ carried.T,
            around,
            around.follows(here.anew),
        )

    def at(self, parameters: Array) -> Coordinates:
        """The rows (q,) and their derivatives (q, n)."""
        around, free = self.around, self.free
        if around.seen is None:
            return Coordinates(self.rows @ (parameters - self.centre)[free], self.rows)
        there = around.mean + self.follows @ (parameters - around.mean)
        found = around.seen.at(there)
        away = found.values - (around.mean - around.centre)
        slopes = (found.slopes @ self.follows)[np.ix_(free, free)]
        return Coordinates(self.rows @ away[free], self.rows @ slopes)

    def widened(self, found: Result) -> Array:
        """(n, n) what the covariance of a fit gains: G wider G^T, G its change with the rows."""
        gain = found.spectrum.covariance() @ self.at(found.solution.parameters).slopes.T
        wider: Array = gain @ self.wider @ gain.T
        return wider


class _WithPrior(InMemory):
    """The merit of poses in memory, and the prior as further equations."""

    def __init__(self, sweeper: Sweeper, prior: _Prior) -> None:
        super().__init__(sweeper)
        self.unknowns: Unknowns = self.unknowns.without_prior()
        self.evaluate = partial(_evaluated, sweeper, prior)


def _evaluated(
    sweeper: Sweeper,
    prior: _Prior,
    parameters: Array,
    corrections: Array,
    *,
    triangular: bool = False,
    closing: float | None = None,
    contraction: float = 1.0,
) -> Evaluation[Array]:
    """A sweep over the new poses, to which the prior is added."""
    how: dict[str, Any] = {"triangular": triangular, "closing": closing}
    found = sweeper.sweep(parameters, corrections, contraction=contraction, **how)
    there = prior.at(parameters)
    found.data.add(np.vstack([there.slopes.T, -there.values])[:, :, None])
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
