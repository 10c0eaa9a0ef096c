"""What a calibration found, and how far it can be believed: small frozen values."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError
from loopcal.estimation.on_request import Interval, ModelComparison, Validation
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.solve.reduction import Accumulator, Spectrum
from loopcal.estimation.solve.status import Status
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.mechanism import Mechanism

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ChiSquared:
    """The weighted square of all corrections and of the parameters' distance from their nominal.

    With the right sds it follows a chi-squared distribution with that many degrees of freedom
    (loop equations + finite priors - determined parameters). variance_factor is their ratio.
    p_value: probability of a value at least this large if model and sds are right.
    """

    value: float
    degrees_of_freedom: int
    p_value: float | None
    variance_factor: float | None


@dataclass(frozen=True)
class Closure:
    """Size of the loop equations' values [SI] over all poses."""

    rms: float
    max: float


@dataclass(frozen=True)
class Accuracy:
    """Distances between computed and measured outputs [unit] where both are there.

    The computed output comes from the other readings alone, without corrections.
    """

    unit: str
    mean: float
    rms: float
    p95: float
    max: float
    poses: int

    @classmethod
    def of(cls, distances: Array, unit: str) -> Accuracy | None:
        """From distances of any shape; missing ones (NaN) do not count."""
        distances = distances[np.isfinite(distances)]
        if not distances.size:
            return None
        return cls(
            unit,
            float(distances.mean()),
            float(np.sqrt(np.square(distances).mean())),
            float(np.percentile(distances, 95)),
            float(distances.max()),
            int(distances.size),
        )


@dataclass(frozen=True)
class NoiseEntry:
    """The sd [SI unit] used for one or several quantities; median where it differs by reading.

    source: "given", "reading", "datasheet" or "estimated". Of an estimated one: sd_of_sd, how
    sure it is; upper: 95 % bound, where it is zero or unsure; likelihood_ratio: by how much
    -2 log of the restricted likelihood rises without it (None where the loops need it), p_value:
    of such a rise if there were no such noise.
    """

    quantities: tuple[str, ...]
    unit: str
    sd: float
    sd_of_sd: float | None
    source: str
    upper: float | None = None
    likelihood_ratio: float | None = None
    p_value: float | None = None


@dataclass(frozen=True)
class Undetermined:
    """A direction in which neither data nor prior say anything: {parameter: share}, and words."""

    combination: Mapping[str, float]
    words: str


@dataclass(frozen=True)
class Identifiability:
    """What can be told from these poses.

    rank: directions determined by data and prior, of `parameters` estimated ones; data_rank: by
    the data alone; condition_number: largest over smallest singular value of the column-scaled
    system, None if singular.
    """

    rank: int
    parameters: int
    data_rank: int
    condition_number: float | None
    not_identifiable: tuple[Undetermined, ...]


@dataclass(frozen=True, eq=False)
class Result:
    """The result of a calibration. Values are SI; mappings go by name.

    mechanism: the nominal one, placed where the instrument sees it; value, sd: of every
    parameter (sd None if fixed, inf if not identifiable); covariance: (n, n) of the estimated
    ones in the order of `estimated`; corrections: quantity -> (N,) estimated true value minus
    reading; residuals_before, residuals_after: loop -> (N,) values of the loop equations;
    differences_before, differences_after: output -> (N,) computed from the readings of the rest
    minus measured, at nominal and at calibrated parameters; accuracy sums them up and is None where
    the mechanism has no outputs, or outputs of several units. problem, spectrum and information
    (the parameter system with and without the prior) are what further statistics start from.
    """

    method: str
    status: Status
    mechanism: Mechanism
    value: Mapping[str, float]
    sd: Mapping[str, float | None]
    estimated: tuple[str, ...]
    covariance: Array
    chi_squared: ChiSquared | None
    noise: tuple[NoiseEntry, ...]
    corrections: Mapping[str, Array]
    reading_sds: Mapping[str, Array]
    residuals_before: Mapping[str, Array]
    residuals_after: Mapping[str, Array]
    differences_before: Mapping[str, Array]
    differences_after: Mapping[str, Array]
    accuracy_before: Accuracy | None
    accuracy_after: Accuracy | None
    identifiability: Identifiability
    dataset: Dataset
    problem: Problem
    spectrum: Spectrum
    information: Accumulator
    loss: str = "gaussian"
    warnings: tuple[str, ...] = ()
    model_discrepancy: float | None = None
    """sd [unit of the outputs] of an error of the machine model at the end point that would explain
    a chi-squared which is too large for the stated sds; None where it is not."""
    variance_factor_applied: bool = False
    """Whether covariance and sds were multiplied by the variance factor, on request."""
    restricted_criterion: float | None = None
    """-2 log of the restricted likelihood, up to a constant of the readings, where sds were
    estimated: the difference between two models of the same readings is what counts."""
    errors: Mapping[str, float] | None = None
    validation: Validation | None = None
    """Accuracy on poses that were not used, where it was asked for."""
    models: ModelComparison | None = None
    """Models this one was chosen from, where it was asked for."""
    intervals: Mapping[str, Interval | None] = field(default_factory=dict)
    """Confidence intervals of the parameters that were asked for."""

    def with_variance_factor(self) -> Result:
        """The same result with its covariance multiplied by the variance factor.

        For those who trust the proportions of the stated sds but not their size: the corrections
        then say how large they are. The covariances are absolute otherwise. Raises InputError
        where there is no variance factor: least squares scales by the residuals anyway, and
        under a robust loss there is no chi-squared.
        """
        factor = None if self.chi_squared is None else self.chi_squared.variance_factor
        if factor is None:
            raise InputError(
                f"the method {self.method!r} with the loss {self.loss!r} has no variance factor",
                code="unsupported",
                remedy="use it with the implicit loop or reweighted, and the gaussian loss",
            )
        if self.variance_factor_applied:
            return self
        sds = {n: None if sd is None else sd * math.sqrt(factor) for n, sd in self.sd.items()}
        return replace(
            self,
            covariance=self.covariance * factor,
            sd=MappingProxyType(sds),
            variance_factor_applied=True,
        )

    @property
    def chi_squared_shares(self) -> Mapping[str, float]:
        """What the corrections of each quantity contribute to chi-squared; they add up to 1.

        A sensor that takes far more than its sd deserves is worse than stated, or takes the blame
        for what the machine model lacks.
        """
        squares = {}
        for quantity, corrections in self.corrections.items():
            sds = self.reading_sds[quantity]
            weighed = np.isfinite(sds) & (sds > 0.0)
            squares[quantity] = float(np.square(corrections[weighed] / sds[weighed]).sum())
        total = sum(squares.values()) or 1.0
        return {quantity: square / total for quantity, square in squares.items()}

    @property
    def calibrated(self) -> Mechanism:
        """The mechanism with the calibrated values as its nominal ones."""
        return self.mechanism.with_nominal(self.value)

    @property
    def closure_before(self) -> Closure:
        """Loop values at the readings and the start parameters."""
        return _closure(self.residuals_before)

    @property
    def closure_after(self) -> Closure:
        """Loop values at the corrected readings and the calibrated parameters."""
        return _closure(self.residuals_after)

    def __str__(self) -> str:
        from loopcal.estimation.summary import summary

        return summary(self)

    def _repr_html_(self) -> str:
        from html import escape

        return f"<pre>{escape(str(self))}</pre>"

    def __repr__(self) -> str:
        state = "converged" if self.status.converged else self.status.reason
        return f"<Result: {self.method}, {state}, {len(self.estimated)} parameters>"


def _closure(residuals: Mapping[str, Array]) -> Closure:
    values = np.array(list(residuals.values()))
    values = values[np.isfinite(values)]
    return Closure(float(np.sqrt(np.square(values).mean())), float(np.abs(values).max()))


def frozen(values: Mapping[str, Array]) -> Mapping[str, Array]:
    """A read-only mapping of read-only arrays."""
    for array in values.values():
        array.setflags(write=False)
    return MappingProxyType(dict(values))
