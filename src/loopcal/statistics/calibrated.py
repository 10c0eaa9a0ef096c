"""What a comparison knows of a calibration: from a result, or from what was written of it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loopcal.document.goodness_of_fit import ChiSquared
from loopcal.document.result_document import ResultDocument
from loopcal.estimation.result import Result
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.small_samples import LearntCovariance
from loopcal.statistics.stored_covariance import stored_covariance

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Calibrated:
    """A calibrated machine and how sure it is.

    mechanism: with the calibrated values; covariance: (n_all, n_all) [SI], zero for fixed
    parameters; undetermined: (n_all, d) steps [SI] that neither data nor prior limit; nominal,
    prior_sd: (n_all,) what was known before; poses: its readings; data: what tells the readings
    apart from others; factor: by which the covariance is larger than the stated sds
    say, because chi-squared rejects these; carried: whether parameters with learnt sds (terms)
    carry the error of the model.
    """

    name: str
    mechanism: Mechanism
    covariance: LearntCovariance
    undetermined: Array
    nominal: Array
    prior_sd: Array
    poses: Dataset | None
    data: str | None
    factor: float
    carried: bool

    @classmethod
    def of(cls, result: Result, name: str) -> Calibrated:
        """From a result."""
        system, parameters = result.spectrum, result.mechanism.parameters
        exact = result.fit.solver.exact
        loose = system.scale[:, None] * system.directions[:, ~system.kept]
        free, size = result.problem.free, len(parameters)
        factor = _factor(result.chi_squared, result.variance_factor_applied)
        return cls(
            name,
            result.calibrated,
            _spread(_allowing(result.learnt_covariance, factor, result.chi_squared), free, size),
            _rows(loose, free, size),
            np.array([p.nominal for p in parameters]),
            np.array([math.inf if exact else p.prior_sd for p in parameters]),
            result.dataset,
            result.dataset.source.sha256 or str(id(result.dataset)),
            factor,
            bool(result.terms),
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
        factor = _factor(document.chi_squared, document.variance_factor_applied)
        covariance = stored_covariance(document.covariance, determined)
        covariance = _allowing(covariance, factor, document.chi_squared)
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
            factor,
            bool(document.terms),
        )


def _factor(chi: ChiSquared | None, applied: bool) -> float:
    if chi is None or applied or not chi.too_large or chi.variance_factor is None:
        return 1.0
    return chi.variance_factor


def _allowing(
    covariance: LearntCovariance, factor: float, chi: ChiSquared | None
) -> LearntCovariance:
    """As large as the residuals are, where chi-squared rejects the stated sds."""
    if factor == 1.0 or chi is None:
        return covariance
    if len(covariance.slopes):
        return covariance.scaled_by(factor)
    return LearntCovariance.scaled(factor * covariance.matrix, chi.degrees_of_freedom)


def _spread(covariance: LearntCovariance, free: NDArray[np.intp], size: int) -> LearntCovariance:
    return covariance.through(np.eye(size)[:, free])


def _rows(part: Array, free: NDArray[np.intp], size: int) -> Array:
    whole = np.zeros((size, part.shape[1]))
    whole[free] = part
    return whole
