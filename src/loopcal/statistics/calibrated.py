"""What a comparison knows of a calibration: from a result, or from what was written of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loopcal.document.fit import NoiseEntry
from loopcal.document.goodness_of_fit import ChiSquared
from loopcal.document.result_document import ResultDocument
from loopcal.estimation.result import Result
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.small_samples import LearntCovariance
from loopcal.statistics.stored_covariance import stored_covariance

Array = NDArray[np.float64]
_SHOWS = 0.05
"""Probability of a learnt error of the model by chance, below which it is there."""


@dataclass(frozen=True, eq=False)
class Calibrated:
    """A calibrated machine and how sure it is.

    mechanism: with the calibrated values; covariance: (n_all, n_all) [SI], zero for fixed
    parameters; undetermined: (n_all, d) steps [SI] that neither data nor prior limit; nominal,
    prior_sd: (n_all,) what was known before; poses: its readings; data: what tells the readings
    apart from others; misfit: how many times its covariance counts, because the model
    has an error that may be the same in all its poses; 1 where none shows.
    """

    name: str
    mechanism: Mechanism
    covariance: LearntCovariance
    undetermined: Array
    nominal: Array
    prior_sd: Array
    poses: Dataset | None
    data: str | None
    misfit: float

    @classmethod
    def of(cls, result: Result, name: str) -> Calibrated:
        """From a result."""
        system, parameters = result.spectrum, result.mechanism.parameters
        exact = result.fit.method.exact
        loose = system.scale[:, None] * system.directions[:, ~system.kept]
        free = result.problem.free
        return cls(
            name,
            result.calibrated,
            _spread(result.learnt_covariance, free, len(parameters)),
            _rows(loose, free, len(parameters)),
            np.array([p.nominal for p in parameters]),
            np.array([math.inf if exact else p.prior_sd for p in parameters]),
            result.dataset,
            result.dataset.source.sha256 or str(id(result.dataset)),
            _misfit(result.chi_squared, result.noise, result.solution.poses),
        )

    @classmethod
    def from_document(
        cls, document: ResultDocument, mechanism: Mechanism, poses: Dataset | None, name: str
    ) -> Calibrated:
        """From the content of result.json and the calibrated mechanism beside it."""
        names = mechanism.parameters.names
        entries = {entry.name: entry for entry in document.parameters}
        estimated = document.covariance.names
        free = np.array([names.index(n) for n in estimated], dtype=np.intp)
        stored = document.prediction
        if stored is not None and stored.covariance is not None:
            determined = stored.covariance
            loose = np.array(stored.undetermined, dtype=float).reshape(-1, len(free)).T
        else:
            # a parameter without covariance is one that nothing limits
            matrix = np.array(document.covariance.matrix, dtype=float).reshape((len(free),) * 2)
            determined, loose = None, np.eye(len(free))[:, np.isnan(np.diag(matrix))]
        covariance = stored_covariance(document.covariance, determined)
        prior = [entries[n].prior_sd for n in names]
        exact = document.sensors_exact
        return cls(
            name,
            mechanism.with_nominal({n: entries[n].value for n in names}),
            _spread(covariance, free, len(names)),
            _rows(loose, free, len(names)),
            np.array([entries[n].nominal for n in names]),
            np.array([math.inf if exact or sd is None else sd for sd in prior]),
            poses,
            document.data.sha256,
            _misfit(document.chi_squared, document.noise, document.data.used),
        )


def _misfit(chi: ChiSquared | None, noise: Sequence[NoiseEntry], poses: int) -> float:
    """N times the variance factor, where the model does not fit its readings; else 1.

    An error of the model is alike in neighbouring poses. At worst it is the same in all, and N
    poses say no more of it than one.
    """
    if chi is not None and chi.too_large and chi.variance_factor is not None:
        return poses * chi.variance_factor
    shown = [e for e in noise if e.role == "disturbance" and e.source == "estimated" and e.sd]
    if any(e.p_value is None or e.p_value < _SHOWS for e in shown):
        return float(poses)
    return 1.0


def _spread(covariance: LearntCovariance, free: NDArray[np.intp], size: int) -> LearntCovariance:
    return covariance.through(np.eye(size)[:, free])


def _rows(part: Array, free: NDArray[np.intp], size: int) -> Array:
    whole = np.zeros((size, part.shape[1]))
    whole[free] = part
    return whole
