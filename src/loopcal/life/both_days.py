"""Sds of sensors from the poses of both days.

Near the machine p of today the misclosures of the earlier poses and of the new ones are

    e_1 = J_1 (p - d) + F_1 a_1 + v_1,    e_2 = J_2 p + F_2 a_2 + v_2,    d ~ N(0, Q),

with what was placed anew (a_1, a_2) free on each day, d the drift, and the prior of the earlier
calibration as further rows. The covariances of v_1 and v_2 share the variances of the sensors,
which the restricted likelihood of both together estimates (Patterson and Thompson 1971): of one
model of all poses, so that no day's estimate has to be summed up by a curvature.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.document.fit import NoiseEntry
from loopcal.errors import NoTrustworthyResult
from loopcal.estimation.noise.estimation import judged
from loopcal.estimation.noise.learning import learnt_entry
from loopcal.estimation.noise.linear_model import LinearModel, ModelBlock, linear_model
from loopcal.estimation.noise.variance_components import Component, estimate_ratios
from loopcal.estimation.result import Result
from loopcal.life.earlier import Earlier, Sloped
from loopcal.statistics.another_day import day_problem, noise_of
from loopcal.statistics.calibrated import Calibrated

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Sds:
    """noise: the entries of all sensors, with new sds; change: largest logarithm of a ratio of
    variances of a sensor that has noise."""

    noise: tuple[NoiseEntry, ...]
    change: float


def learnt(
    calibrated: Calibrated, earlier: Earlier, result: Result, anew: NDArray[np.bool_], drifts: Array
) -> Sds | None:
    """The learnt sds of a calibration, learnt from its poses and those of an update.

    known: at the sds of the update; found: the update; anew: (n_all,) what was placed anew; drifts:
    (n_all,) sds. None where no sd was learnt, the earlier poses are not there, or the loops have no
    noise.
    """
    which = [i for i, entry in enumerate(calibrated.noise) if _begun(entry) is not None]
    if not which or earlier.problem is None:
        return None
    begun = {i: _begun(calibrated.noise[i]) or 0.0 for i in which}
    apart = tuple(
        replace(entry, sd=begun[i]) if i in begun else entry
        for i, entry in enumerate(calibrated.noise)
    )
    reference = replace(calibrated, noise=apart)
    names = result.problem.mechanism.tape.quantities
    components = [
        Component(", ".join(entry.quantities), tuple(names.index(q) for q in entry.quantities))
        for entry in (calibrated.noise[i] for i in which)
    ]
    model = _model(components, reference, result, earlier, anew, drifts)
    # Ratios are of variances to those at which the loadings are made.
    start = np.square([calibrated.noise[i].sd / begun[i] for i in which])
    try:
        estimate = estimate_ratios(model, start)
    except NoTrustworthyResult:
        return None
    noise = list(calibrated.noise)
    for j, i in enumerate(which):
        unsure = any(j in pair for pair in estimate.alike)
        learnt_sd = judged(model, estimate, j, components[j], unsure)
        noise[i] = replace(learnt_entry(noise[i], learnt_sd, begun[i]), slopes=())
    noisy = (start > 0.0) & (estimate.ratios > 0.0)
    change = np.abs(np.log(estimate.ratios[noisy] / start[noisy])).max(initial=0.0)
    vanished = bool(((start > 0.0) != (estimate.ratios > 0.0)).any())
    return Sds(tuple(noise), np.inf if vanished else float(change))


def _begun(entry: NoiseEntry) -> float | None:
    """The sd that a search begins at: of one that was learnt, else None."""
    if entry.source != "estimated":
        return None
    return entry.sd or entry.upper or None


def _model(
    components: Sequence[Component],
    reference: Calibrated,
    result: Result,
    earlier: Earlier,
    anew: NDArray[np.bool_],
    drifts: Array,
) -> LinearModel:
    """One model of all poses: steps of today's parameters, of what stood elsewhere, and drifts.

    reference: at the sds whose ratios are sought.
    """
    today = day_problem(reference, result.dataset, noise_of(reference))
    positions = [component.quantities for component in components]
    parameters = result.solution.parameters
    new = linear_model(today, parameters, result.solution.corrections, positions).blocks
    parameters_then = earlier.parameters_then(parameters, anew)
    old = earlier.linear(reference, parameters_then, positions)
    free = np.array([not p.fixed for p in result.mechanism.parameters])
    every = np.eye(len(parameters))
    shared, placed = every[:, free & ~anew], every[:, free & anew]
    drift = every[:, free & ~anew & (drifts > 0.0)]
    stood = every[:, free & anew & earlier.estimated]
    of_today = np.hstack([shared, placed, np.zeros_like(stood), np.zeros_like(drift)])
    # d = p - drift: the earlier poses saw the machine before it drifted.
    of_then = np.hstack([shared, np.zeros_like(placed), stood, -drift])
    n, prior = of_today.shape[1], earlier.prior(parameters_then)
    unit = np.hstack([np.zeros((drift.shape[1], n - drift.shape[1])), np.eye(drift.shape[1])])
    sds = drifts[free & ~anew & (drifts > 0.0)]
    blocks = (
        *(replace(block, J=block.J @ of_today) for block in new),
        *(replace(block, J=block.J @ of_then) for block in old),
        *_rows(Sloped(prior.values, prior.slopes @ of_then)),
        *_rows(Sloped(np.zeros(len(sds)), unit / sds[:, None])),
    )
    return LinearModel(blocks, np.zeros(n), np.zeros(n), len(components))


def _rows(prior: Sloped) -> tuple[ModelBlock, ...]:
    """Rows of unit variance, as poses whose covariance is known."""
    q = len(prior.values)
    none = np.zeros(0, dtype=np.intp)
    block = ModelBlock(
        prior.values[:, None], prior.slopes[:, None], np.ones((q, 1, 1)), np.zeros((q, 1, 0)), none
    )
    return (block,) if q else ()
