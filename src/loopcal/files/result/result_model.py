"""What result.json says, field by field: checked on reading, published as a JSON Schema.

Numbers are SI unless a unit stands beside them. Unknown is null; NaN and infinity never occur.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from loopcal.files.project.fit_schema import MethodName
from loopcal.files.toml.model import Finite, Model

Count = Annotated[int, Field(ge=0)]
Sd = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Probability = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]


class StatusEntry(Model):
    """How the fit ended."""

    converged: bool = Field(description="Whether the point found is the optimum.")
    reason: str = Field(description="Why the fit stopped, in one word.")
    message: str = Field(description="Cause and remedy.")
    iterations: Count = Field(description="Parameter steps tried.")


class IntervalEntry(Model):
    """Confidence interval of a parameter: from its covariance, and by profile likelihood."""

    level: Probability
    covariance: list[Finite] = Field(description="Lower and upper end.")
    profile: list[Finite | None] = Field(description="The same; null: chi-squared never rises.")
    differs: bool = Field(description="By more than a tenth of the half width at an end.")


class ParameterEntry(Model):
    """One parameter of the mechanism."""

    name: str
    unit: str = Field(description="SI unit of all numbers of this parameter.")
    nominal: Finite = Field(
        description="Value before the fit, after the machine was moved to where the instrument "
        "sees it."
    )
    value: Finite = Field(description="Calibrated value; the nominal one where fixed.")
    sd: Sd | None = Field(description="Null where fixed or not identifiable.")
    prior_sd: Sd | None = Field(description="How well the nominal was known; null: flat.")
    fixed: bool = Field(description="Whether it was held at its nominal value.")
    identifiable: bool | None = Field(description="By data and prior; null where fixed.")
    error: Finite | None = Field(
        description="True minus estimate, where the truth of a simulation was given."
    )
    interval: IntervalEntry | None = Field(
        default=None, description="Null where it was not asked for, or nothing bounds it."
    )


class CovarianceEntry(Model):
    """Covariance of the estimated parameters."""

    names: list[str] = Field(description="Parameters in the order of rows and columns.")
    unit: Literal["SI"]
    matrix: list[list[Finite | None]] = Field(
        description="Products of the parameters' SI units; null where one is not identifiable."
    )


class NoiseEntryOfFile(Model):
    """The sd that the readings of some quantities were given."""

    quantities: list[str]
    unit: str
    sd: Sd = Field(description="The median where it differs from reading to reading.")
    sd_of_sd: Sd | None = Field(description="How sure the sd itself is, where that is known.")
    source: Literal["given", "estimated", "reading", "repeats", "datasheet"]
    upper: Sd | None = Field(
        default=None, description="95 % upper bound of an estimated sd that is zero or unsure."
    )
    likelihood_ratio: Finite | None = Field(
        default=None,
        description="By how much -2 log of the restricted likelihood rises without this noise; "
        "null where it was not estimated, or the loops could not close without it.",
    )
    p_value: Finite | None = Field(
        default=None, description="Of so large a rise if there were no such noise."
    )


class ChiSquaredEntry(Model):
    """Weighted squares of all corrections and of the distance from informative nominal values."""

    value: Finite
    degrees_of_freedom: int
    p_value: Probability | None = Field(
        description="Probability of a value at least this large if model and sds are right."
    )
    variance_factor: Sd | None = Field(description="Value per degree of freedom.")


class ClosureSize(Model):
    """Size of the loop equations' values over all poses [SI]."""

    rms: Sd | None
    max: Sd | None


class ClosureEntry(Model):
    """The loop equations before and after. That a loop closes is no accuracy."""

    before: ClosureSize = Field(description="At the readings and the nominal parameters.")
    after: ClosureSize = Field(description="At the corrected readings, calibrated parameters.")


class Distances(Model):
    """Distances between computed and measured outputs over the poses that have both."""

    mean: Sd
    rms: Sd
    p95: Sd = Field(description="95 % of the poses are at most so far off.")
    max: Sd


class AccuracyEntry(Model):
    """Computed minus measured outputs; the readings it is computed from are not corrected."""

    unit: str
    before: Distances = Field(description="With the nominal parameters.")
    after: Distances = Field(description="With the calibrated parameters.")


class FailedPartEntry(Model):
    """A part of a validation that could not be predicted."""

    number: Annotated[int, Field(ge=1)]
    poses: Count
    reason: str


class ValidationEntry(Model):
    """How well poses were predicted that took no part in the fit."""

    scheme: dict[str, Any] = Field(description="What was left out, as the project asks for it.")
    words: str
    poses: Count = Field(description="Poses that were predicted.")
    accuracy: Distances | None = Field(description="In the unit of `accuracy`; null: no outputs.")
    log_likelihood: Finite | None = Field(
        description="Predictive, summed over the poses; null where the method has none."
    )
    parts: Count = Field(default=1, description="How many parts were to be predicted.")
    failed: list[FailedPartEntry] = Field(
        default=[], description="Parts whose fit failed; their poses do not count."
    )


class UndeterminedEntry(Model):
    """A direction in which neither data nor prior say anything."""

    combination: dict[str, Finite] = Field(description="Parameter -> its share, the largest 1.")
    words: str


class LearnedEntry(Model):
    """A parameter that had a prior: what the data added to it."""

    parameter: str
    ratio: Sd = Field(description="Its sd over its prior sd; near 1: the data say nothing.")
    words: str


class WeakEntry(Model):
    """A direction in which these poses hardly tell parameters apart."""

    combination: dict[str, Finite] = Field(
        description="Leading parameters -> share in scaled units, the largest 1."
    )
    one_sd: dict[str, Finite] = Field(
        description="The same -> change [SI] that the data allow within one sd; empty: any."
    )
    condition: Sd | None = Field(
        description="Largest singular value over that of this direction; null: not determined."
    )
    words: str


class IndexEntry(Model):
    """Calibration index of Hollerbach and Wampler, summed over the poses."""

    value: int = Field(description="Sensed minus mobility: equations that the poses give.")
    sensed: Count
    mobility: int


class ModelEntry(Model):
    """One of the models that were compared on the same poses, none of them used for its fit."""

    name: str
    effects: list[str] = Field(description="Effects beyond geometry that were switched on.")
    fixed: list[str] = Field(description="Parameters that it did not estimate, names or globs.")
    parameters: Count = Field(description="Number of estimated parameters.")
    accuracy: Distances | None
    log_likelihood: Finite | None
    behind: Sd | None = Field(description="log_likelihood less than that of the best model by.")
    sd_of_behind: Sd | None = Field(description="Standard error of it, from its scatter by pose.")
    recommended: bool = Field(description="This document is the calibration with this model.")
    failed: str | None = Field(description="Why it could not be judged.")


class IdentifiabilityEntry(Model):
    """What can be told from these poses."""

    rank: Count = Field(description="Directions determined by data and prior together.")
    parameters: Count = Field(description="Number of estimated parameters.")
    data_rank: Count = Field(description="Directions determined by the data alone.")
    condition_number: Sd | None = Field(
        description="Largest over smallest singular value of the column-scaled whitened "
        "parameter Jacobian; null where it is singular."
    )
    not_identifiable: list[UndeterminedEntry]
    data_condition_number: Sd | None = Field(
        description="The same without the prior; null where singular, or not computed."
    )
    data_versus_prior: list[LearnedEntry] | None = Field(
        description="What the data added to the prior; null: not computed."
    )
    weak_directions: list[WeakEntry] | None = Field(
        description="By the data alone, the worst first; null: not computed."
    )
    calibration_index: IndexEntry | None = Field(description="Null: not computed.")


class ObservabilityEntry(Model):
    """Indices of the singular values s_1 >= ... >= s_n of the whitened parameter Jacobian.

    Its columns are divided by their lengths; N poses. All are zero where it is singular.
    """

    O1: Sd = Field(description="(s_1 ... s_n)^(1/n) / sqrt(N).")
    O2: Sd = Field(description="s_n / s_1.")
    O3: Sd = Field(description="s_n.")
    O4: Sd = Field(description="s_n^2 / s_1.")
    O5: Sd = Field(description="1 / (1/s_1 + ... + 1/s_n).")


class PredictionEntry(Model):
    """What `loopcal predict` needs beside the covariance and the calibrated mechanism."""

    sd_at_poses: dict[str, Sd] = Field(
        description="SI unit of outputs -> the sd that the parameters cause in all outputs of "
        "that unit together, not exceeded at 95 % of the calibration poses."
    )
    typical: dict[str, Finite] = Field(description="Quantity -> median reading [SI].")
    covariance: list[list[Finite]] | None = Field(
        description="Of the estimated parameters over the determined directions; null: the same "
        "as `covariance`."
    )
    undetermined: list[list[Finite]] = Field(
        description="Parameter steps [SI] that neither data nor prior limit."
    )


class OutlierEntry(Model):
    """A pose that does not fit the others."""

    pose: str
    quantity: str | None = Field(
        description="The reading to blame; null where no single one explains the pose."
    )
    statistic: Finite | None = Field(
        description="Normal deviate of the reading, chi-squared of the pose where quantity is "
        "null; null: beyond all bounds."
    )
    p_value: Probability = Field(description="Of one at least so large in good data.")
    pose_statistic: Finite | None = Field(description="Chi-squared of the pose.")
    size: Finite | None = Field(description="Reading minus its value as the rest has it [unit].")
    unit: str | None
    indistinct: list[str] = Field(description="Readings that would explain the pose as well.")
    cause: str | None = Field(description="What probably happened.")
    verified: bool = Field(description="Whether putting it right made the pose unremarkable.")


class OutlierTests(Model):
    """How poses and readings were tested."""

    level: Probability = Field(description="Of naming anything where every reading is good.")
    poses: Count = Field(description="Poses that could be tested.")
    scale: Sd = Field(description="Factor on the stated sds that the tests used.")
    by_residuals: bool = Field(description="Whether that factor comes from the residuals.")


class ColumnFaultEntry(Model):
    """A fault of whole columns, verified by fits with it and without."""

    quantities: list[str]
    words: str
    before: Sd | None = Field(description="Misfit [SI] as read: of machine or fit.")
    after: Sd = Field(description="The same with the fault put right.")


class OtherOptimumEntry(Model):
    """Another optimum of the same readings."""

    parameters: dict[str, float] = Field(description="Those that differ [SI].")
    chi_squared: float
    words: str


class JoinedFile(Model):
    """A file whose readings were joined by pose id."""

    file: str | None
    sha256: str | None = Field(description="Of the bytes of the file.")


class DataEntry(Model):
    """Which readings were used."""

    file: str | None
    sha256: str | None = Field(description="Of the bytes of the file.")
    poses: Count = Field(description="Poses in the file.")
    used: Count = Field(description="Poses used; residuals.csv lists their ids.")
    excluded: list[str] = Field(description="Ids of the poses left out on request.")
    every: Annotated[int, Field(ge=1)] = Field(description="The 1st, (every + 1)th ... was kept.")
    joined: list[JoinedFile] = Field(
        default=[], description="Further files of the same poses, joined by pose id."
    )
    quantities: list[str] = Field(description="Quantities that were read.")


class ResultDocument(Model):
    """result.json of loopcal: one calibration."""

    schema_: Literal[1] = Field(alias="schema")
    loopcal: str = Field(description="Version of loopcal that wrote this file.")
    title: str | None
    method: MethodName
    loss: Literal["gaussian", "huber", "student-t"] = "gaussian"
    status: StatusEntry
    parameters: list[ParameterEntry]
    covariance: CovarianceEntry
    noise: list[NoiseEntryOfFile] = Field(description="Empty for least squares, which knows none.")
    model_discrepancy: Sd | None = Field(
        default=None,
        description="sd [SI, of the outputs] of an error of the machine model at the end point "
        "that would explain a chi-squared too large for the stated sds.",
    )
    variance_factor_applied: bool = Field(
        default=False, description="Whether covariance and sds contain the variance factor."
    )
    restricted_criterion: Finite | None = Field(
        default=None,
        description="-2 log of the restricted likelihood up to a constant of the readings, where "
        "sds were estimated: compare models of the same readings by its difference.",
    )
    chi_squared: ChiSquaredEntry | None = Field(
        description="Null: least squares, or a robust loss."
    )
    closure: ClosureEntry
    accuracy: AccuracyEntry | None = Field(
        description="Null where the mechanism has no outputs, or outputs of several units."
    )
    validation: ValidationEntry | None = Field(description="Null: no validation was made.")
    models: list[ModelEntry] | None = Field(
        default=None, description="Models that were compared; null: none were."
    )
    identifiability: IdentifiabilityEntry
    observability: ObservabilityEntry | None = Field(description="Null: not computed.")
    prediction: PredictionEntry | None = Field(
        description="Null where the mechanism has no outputs, or it was not computed."
    )
    outliers: list[OutlierEntry] | None = Field(
        description="Worst first. Null: no reading was tested."
    )
    outlier_tests: OutlierTests | None = Field(
        default=None, description="How outliers were found; null: no reading was tested."
    )
    column_faults: list[ColumnFaultEntry] | None = Field(
        default=None,
        description="Columns that are exchanged, in another unit or counted the other way round; "
        "where there are any, single poses are not tested.",
    )
    other_optima: list[OtherOptimumEntry] | None = Field(
        default=None, description="Optima that fit about as well; null: not sought."
    )
    data: DataEntry
    warnings: list[str] = Field(description="What the summary warns of.")
    inputs: dict[str, Any] = Field(
        description='The project as it was read; infinite sds are the text "inf".'
    )
    versions: dict[str, str] = Field(description="Versions of Python and of the libraries.")
