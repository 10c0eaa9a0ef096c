"""One calibration as one value: what result.json holds, and what all that reads it consumes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from loopcal.document import tables
from loopcal.document.accuracy import AccuracyEntry, Distances, ModelEntry, ValidationEntry
from loopcal.document.change_points import ChangePoints, Dependence, Reliability, Shifts
from loopcal.document.choice import Candidate, Chosen, TermEntry
from loopcal.document.findings import (
    CheckEntry,
    ColumnFault,
    ConflictEntry,
    DelayEntry,
    HalvesEntry,
    Identifiability,
    JointErrorEntry,
    LensErrorEntry,
    Observability,
    OtherOptimum,
    Outlier,
    OutlierTests,
    PredictionEntry,
    RegionEntry,
    RepeatsEntry,
    ScaleEntry,
)
from loopcal.document.fit import (
    ChiSquared,
    ClosureEntry,
    CovarianceEntry,
    IntervalEntry,
    NoiseCovarianceEntry,
    NoiseEntry,
    ParameterEntry,
    StatusEntry,
)
from loopcal.document.plain import Count, Size
from loopcal.document.verdict import Finding, Verdict
from loopcal.measurements.days import Days
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.structure.structured import unstated_mountings
from loopcal.presentation.shown import (
    brief,
    columns,
    p_words,
    percent,
    significant,
    with_unit,
    wrapped,
)

UPDATED = "implicit loop, updated"
"""Label of the method, in the result of an update."""
SCHEMA: Literal[3] = 3


@dataclass(frozen=True)
class JoinedFile:
    """A file whose readings were joined by pose id."""

    file: str | None
    sha256: str | None
    """Of the bytes of the file."""


@dataclass(frozen=True)
class CoarseReadings:
    """Quantities recorded in steps that are not small against their sd."""

    quantities: tuple[str, ...]
    unit: str
    step: Size
    """[SI unit]"""
    sd: Size
    """Of the rounding alone: step over the root of 12."""

    def __str__(self) -> str:
        step, sd = with_unit(self.step, self.unit, 2), with_unit(self.sd, self.unit, 2)
        return f"{', '.join(self.quantities)} in steps of {step}, which alone is an sd of {sd}"


@dataclass(frozen=True)
class DataEntry:
    """Which readings were used."""

    file: str | None
    sha256: str | None
    """Of the bytes of the file."""
    poses: Count
    """Poses in the file."""
    used: Count
    """Poses used; residuals.csv lists their ids."""
    excluded: tuple[str, ...]
    """Ids of the poses left out on request."""
    every: Count
    """The 1st, (every + 1)th ... was kept."""
    quantities: tuple[str, ...]
    """Quantities that were read."""
    joined: tuple[JoinedFile, ...] = ()
    """Further files of the same poses, joined by pose id."""
    copied: tuple[str, ...] = ()
    """Ids of the poses left out because their rows copy others in every column."""
    discarded: tuple[str, ...] = ()
    """Ids of the outliers that the method "auto" left out of the fit and of its accuracy."""
    coarse: tuple[CoarseReadings, ...] = ()
    """Readings recorded in steps that are not small against their sds."""
    agreeing: tuple[str, ...] = ()
    """Ids of poses whose rows equal others, as rows of such coarse readings may by chance: used."""
    measured: Days | None = None
    """Days of the measurement, by a column of dates in the readings; null: there is none."""
    averaged: tuple[str, ...] = ()
    """Ids of repeats of an earlier pose: they share its error, so it counts once, with their
    mean."""

    def warnings(self) -> tuple[str, ...]:
        """What the reader must know of the rows."""
        lines = []
        if number := len(self.copied):
            rows = f"{number} rows copy others" if number > 1 else "1 row copies another"
            named = _first(self.copied)
            lines.append(f"{rows} in every column (pose {named}): each measurement counts once.")
        if number := len(self.agreeing):
            rows = f"{number} rows equal others" if number > 1 else "1 row equals another"
            lines.append(
                f"{rows} in every column (pose {_first(self.agreeing)}). Readings as coarse as "
                "these may agree by chance, so every row counts."
            )
        if number := len(self.averaged):
            rows = f"{number} rows repeat" if number > 1 else "1 row repeats"
            lines.append(
                f"{rows} an earlier pose (pose {_first(self.averaged)}) and agree better with it "
                "than independent errors would: each pose counts once, with the mean of its "
                "readings."
            )
        if number := len(self.discarded):
            poses = f"{number} poses do" if number > 1 else "1 pose does"
            lines.append(
                f"{poses} not fit the others (pose {_first(self.discarded)}): discarded from the "
                "fit and from every accuracy. Inspect the readings."
            )
        return tuple(lines)


def _first(poses: tuple[str, ...]) -> str:
    return ", ".join(poses[:5]) + (", ..." if len(poses) > 5 else "")


@dataclass(frozen=True)
class MechanismEntry:
    """The names and SI units that residuals.csv speaks of."""

    __repr__ = brief

    name: str
    loops: tuple[str, ...]
    quantities: Mapping[str, str]
    """Quantity -> SI unit."""
    known: Mapping[str, str]
    """Known constant of each pose -> SI unit."""
    outputs: tuple[str, ...]
    """What the loops predict from the other readings."""
    compared: tuple[str, ...]
    """Outputs, and small turns between computed and measured orientations."""
    remarks: tuple[str, ...]
    """What a user should know of it, such as why a parameter is fixed."""
    unstated: tuple[tuple[str, ...], ...] = ()
    """The parameters of each thing on a body without a stated place: all free and flat, at 0 or
    begun where readings suggest."""

    @classmethod
    def of(cls, mechanism: Mechanism) -> MechanismEntry:
        """The names and units of a mechanism."""
        return cls(
            mechanism.name,
            mechanism.tape.loops,
            dict(mechanism.quantities),
            dict(mechanism.pose_constants),
            mechanism.outputs,
            mechanism.compared,
            mechanism.remarks,
            unstated_mountings(mechanism),
        )


@dataclass(frozen=True, kw_only=True)
class ResultDocument:
    """result.json of loopcal: one calibration.

    Numbers are SI unless a unit stands beside them. Unknown is null; NaN and infinity never occur.
    """

    __repr__ = brief

    # how pydantic reads this and all that it holds, where result.json is read
    __pydantic_config__ = {  # noqa: RUF012
        "extra": "forbid",
        "strict": True,
        "allow_inf_nan": False,
    }

    schema: Literal[3]
    loopcal: str
    """Version of loopcal that wrote this file."""
    title: str | None
    mechanism: MechanismEntry | None = None
    """Null: written by an earlier version."""
    method: str
    method_label: str = ""
    """The method in a few words; empty: written by an earlier version."""
    chosen: Chosen | None = None
    """What the method "auto" chose; null: the method was stated."""
    culprits: tuple[Candidate, ...] = ()
    """Of images: the machine as stated, with robot, lens and board freed one by one, and as chosen,
    on poses not used. `difference` is to the first; empty: no cameras, or not validated."""
    halves: tuple[HalvesEntry, ...] = ()
    """The lenses by two halves of the images, fitted apart; empty: no lens was estimated, or a half
    could not be fitted."""
    lens_errors: tuple[LensErrorEntry, ...] = ()
    """What lenses leave, whose size covariance and sds contain; empty: no lens was estimated."""
    loss: str = "gaussian"
    status: StatusEntry
    parameters: tuple[ParameterEntry, ...]
    covariance: CovarianceEntry
    noise: tuple[NoiseEntry, ...]
    """Empty for least squares, which knows none."""
    noise_covariances: tuple[NoiseCovarianceEntry, ...] = ()
    """Of the quantities whose covariance was stated."""
    terms: tuple[TermEntry, ...] = ()
    """What was learnt of the model error; empty: nothing was to be learnt."""
    sds_settled: bool | None = None
    """Whether the learnt sds converged; null: none were learnt."""
    model_discrepancy: Size | None = None
    """sd [SI, of the outputs] of an error of the machine model at the end point that would explain
    a chi-squared too large for the stated sds."""
    variance_factor_applied: bool = False
    """Whether covariance and sds contain the variance factor."""
    restricted_criterion: float | None = None
    """-2 log of the restricted likelihood up to a constant of the readings, where sds were
    estimated: compare models of the same readings by its difference."""
    chi_squared: ChiSquared | None
    """Null: least squares, or a robust loss."""
    closure: ClosureEntry
    accuracy: AccuracyEntry | None
    """Null: the mechanism has no outputs, or no pose has readings for an output and its inputs."""
    validation: ValidationEntry | None
    """Null: no validation was made."""
    verdict: Verdict | None = None
    """Null: not judged."""
    findings: tuple[Finding, ...] = ()
    """All that was found out, the gravest first; empty: not judged, or by an earlier version."""
    models: tuple[ModelEntry, ...] | None = None
    """Models that were compared; null: none were."""
    dependence: Dependence | None = None
    """Whether residuals depend on pose order or place; null: not tested."""
    change_points: ChangePoints | None = None
    """What moved along the run; null: not sought."""
    identifiability: Identifiability
    observability: Observability | None
    """Null: not computed."""
    prediction: PredictionEntry | None
    """Null where the mechanism has no outputs, or it was not computed."""
    outliers: tuple[Outlier, ...] | None
    """Worst first. Null: no reading was tested."""
    reliability: Reliability | None = None
    """What single readings can hide; null: not computed."""
    outlier_tests: OutlierTests | None = None
    """How outliers were found; null: no reading was tested."""
    column_faults: tuple[ColumnFault, ...] | None = None
    """Columns exchanged, reversed or in another unit, rows displaced, another machine; where there
    are any, single poses are not tested."""
    other_optima: tuple[OtherOptimum, ...] | None = None
    """Optima that fit about as well; null: not sought."""
    scales: tuple[ScaleEntry, ...] | None = None
    """Scales of what was measured; null: none could be compared."""
    delay: DelayEntry | None = None
    """What was read of the poses beside their neighbours; null: no delay explains
    half of what is left along the motions."""
    joint_error: JointErrorEntry | None = None
    """The error of a joint that explains most of what the fit leaves; null: none explains a tenth
    of it."""
    conflicts: tuple[ConflictEntry, ...] | None = None
    """Each observation beside all others; null: there is but one."""
    repeats: RepeatsEntry | None = None
    """Repeats of a pose beside different poses, where they share an error that a stated method
    takes as independent; null: they do not, or are counted once."""
    check: CheckEntry | None = None
    """Of an update, where its readings differ from the calibration by more than it follows; null:
    they do not, or this is none."""
    data: DataEntry
    warnings: tuple[str, ...]
    """What the summary warns of."""
    inputs: Mapping[str, Any]
    """The project as it was read; infinite sds are the text "inf"."""
    versions: Mapping[str, str]
    """Versions of Python and of the libraries."""
    files: Mapping[str, str] = field(default_factory=dict)
    """SHA-256 of the files of this result beside it, by name; empty: written by an earlier
    version."""

    @property
    def measured(self) -> Days | None:
        """Days of the measurement: by the readings, else [record] date; None where unknown."""
        stated = (self.inputs.get("record") or {}).get("date")
        return self.data.measured or (None if stated is None else Days.of_text(str(stated)))

    @property
    def region(self) -> RegionEntry | None:
        """The working region; None where it is not known."""
        return None if self.prediction is None else self.prediction.region

    @property
    def updated(self) -> bool:
        """Whether it is an update of an earlier calibration."""
        return self.method_label == UPDATED

    @property
    def sensors_exact(self) -> bool:
        """Whether the method takes the sensors as exact: it then knows no noise."""
        return not self.noise

    @property
    def why_no_accuracy(self) -> str:
        """Why `accuracy` is null."""
        if self.mechanism is not None and not self.mechanism.outputs:
            return "the mechanism has no outputs to predict"
        return "no pose has readings of outputs and of all that predicts them"

    def __str__(self) -> str:
        """The summary: the verdict, then accuracy, warnings, state, sensors, parameters."""
        loss = "" if self.loss == "gaussian" else f", loss {self.loss}"
        name = self.mechanism.name if self.mechanism else self.title
        lines = [f"{name}: {self.method_label or self.method}{loss}", ""]
        if self.verdict is not None:
            lines += [*self.verdict.lines(), ""]
        lines += [*_ended(self), "", *_accuracy(self)]
        for warning in self.warnings:
            lines += ["", *wrapped(warning, "WARNING  ", "         ")]
        lines += ["", *_state(self)]
        p_value = 1.0 if self.chi_squared is None else self.chi_squared.p_value
        rejected = p_value is not None and p_value < 0.01
        if rejected or any(entry.source == "estimated" for entry in self.noise):
            lines += ["", *tables.sensor_table(self.noise)]
        if self.terms:
            lines += ["", *tables.term_table(self.terms)]
        shown = tables.shown_parameters(self.parameters, self.terms)
        lines += ["", *tables.parameter_table(shown)]
        if rest := len(self.parameters) - len(shown):
            lines.append(f"(and {rest} parameters of the model error: result.json)")
        if self.variance_factor_applied:
            lines.append("(sds multiplied by the root of chi-squared per degree of freedom)")
        if any(p.error is not None for p in self.parameters):
            lines.append("(error: true minus estimate)")
        if any(p.interval is not None for p in self.parameters):
            lines += ["", *tables.interval_table(self.parameters)]
        if self.models is not None:
            unit = self.accuracy.unit if self.accuracy else ""
            scheme = self.validation.words if self.validation else ""
            lines += ["", *tables.model_table(self.models, unit, scheme)]
        return "\n".join(lines)


@dataclass(frozen=True, eq=False)
class WrittenResult:
    """The files of a result: their folder, their names, and the content of result.json."""

    folder: Path
    files: tuple[str, ...]
    document: ResultDocument


def _ended(document: ResultDocument) -> list[str]:
    status, data = document.status, document.data
    head = "converged" if status.converged else f"NOT CONVERGED ({status.reason})"
    steps = f"{status.iterations} iteration{'s' if status.iterations != 1 else ''}"
    poses = (
        f"{data.used} poses" if data.poses == data.used else f"{data.used} of {data.poses} poses"
    )
    lines = [f"FILE AT FAULT  {fault}" for fault in document.column_faults or ()]
    lines.append(f"{head} in {steps} on {poses}")
    return lines if status.converged else [*lines, f"  {status.message}"]


def _state(document: ResultDocument) -> list[str]:
    lines = list[str]()
    if document.chosen is not None:
        lines += wrapped(document.chosen.words, "chosen: ", "        ")
    chi = document.chi_squared
    if chi is not None and chi.variance_factor is not None:
        probability = "no p: all sds were learnt" if chi.p_value is None else p_words(chi.p_value)
        lines.append(
            f"chi-squared {significant(chi.value, 5)} at {chi.degrees_of_freedom} degrees of "
            f"freedom (per degree {significant(chi.variance_factor, 3)}, {probability})"
        )
    information = document.identifiability
    condition = information.condition_number
    determined = f"{information.rank} of {information.parameters} parameters determined"
    lines.append(
        determined + (f", condition number {significant(condition, 3)}" if condition else "")
    )
    if remarks := len(document.mechanism.remarks) if document.mechanism else 0:
        lines.append(
            f"{remarks} remark{'s' if remarks > 1 else ''} on the mechanism, such as why a "
            "parameter is fixed: see loopcal check"
        )
    before, after = (
        "unknown" if closure.rms is None else f"{closure.rms:.3g}"
        for closure in (document.closure.before, document.closure.after)
    )
    closed = "" if document.sensors_exact else " (closed by correcting the readings)"
    lines.append(f"loop equations: rms {before} before, {after} after{closed}")
    return lines


def _accuracy(document: ResultDocument) -> list[str]:
    accuracy, validation = document.accuracy, document.validation
    if accuracy is None:
        return [f"accuracy unknown: {document.why_no_accuracy}"]
    note = "(computed from the other readings minus measured, on the poses used for the fit"
    if validation is not None and validation.accuracy is not None:
        note += f"; poses not used: {validation.words}"
        elsewhere = (validation.blocked, validation.images)
        note += "".join(f"; {one.words}" for one in elsewhere if one is not None)
    lines = tables.accuracy_table(accuracy, validation, document.updated)
    lines += [f"{note})", *_coverage(validation)]
    if validation is not None and validation.log_likelihood is not None:
        value = significant(validation.log_likelihood, 6)
        lines.append(f"log-likelihood of poses not used: {value} (only differences count)")
    if (places := tables.place_table(accuracy, validation, document.region)) is not None:
        lines += ["", *columns([places.head, *places.rows])]
        lines.append("(by the images less by the machine, rms; 95 % and max in space)")
    lines += _at_boards(accuracy, validation)
    if (faults := tables.culprit_table(document.culprits, accuracy.unit)) is not None:
        lines += ["", *columns([faults.head, *faults.rows])]
        lines += wrapped(tables.culprit_words(document.culprits, accuracy.unit), "", "")
    return lines


def _at_boards(accuracy: AccuracyEntry, validation: ValidationEntry | None) -> list[str]:
    """What pixels are at the boards, in lengths."""
    lines = []
    unused = None if validation is None else validation.accuracy
    by_camera = (
        {} if validation is None else {one.instrument: one.position for one in validation.by}
    )
    for pixel in accuracy.pixels:
        rms = by_camera.get(pixel.instrument) or unused or accuracy.after
        where = "poses not used" if unused else "the poses used"
        lines.append(
            f"at the board a pixel of {pixel.instrument} is {with_unit(pixel.size, 'm')}: "
            f"{with_unit(rms.rms * pixel.size, 'm')} rms on {where}"
        )
    return lines


def _coverage(validation: ValidationEntry | None) -> list[str]:
    """How often the stated regions hold."""
    if validation is None or validation.coverage is None:
        return []
    held = validation.coverage
    which = "poses" if held.poses == validation.poses else f"{held.poses} different poses"
    words = (
        f"stated {percent(held.level)} regions hold {percent(held.share, 1)} of the {which} not "
        "used"
    )
    if validation.blocked is not None and validation.blocked.coverage is not None:
        words += f", {percent(validation.blocked.coverage.share, 1)} in regions not used"
    if validation.silent:
        stating = validation.parts - len(validation.failed) - len(validation.silent)
        words += f"; {stating} of {validation.parts} folds state regions"
    return [words]


# What a document holds beside a fit, and how it is judged: one explicit value.


@dataclass(frozen=True, kw_only=True)
class Parts:
    """What was stated, chosen, validated and compared beside a fit.

    title, inputs: of the project; about_readings, notes: warnings ahead of those of the fit, and
    behind them; errors: true minus estimated value [SI] of the parameters whose truth is known;
    method: as it was asked for, where the choice made another one of it; nominal, noise_floor: of
    the choice; culprits: what it says of robot, lens and board; halves: of the lens by two halves
    of the images; change_points, discarded: what it modelled, and the outliers that it left out;
    shifts: what it saw along the run where it modelled nothing;
    intervals: profile intervals by parameter; tolerance [SI], region: what the verdict judges;
    files: names of project and result, for command lines; None where there are no names;
    scales: those that an update follows; check: of an update, by which readings differ.
    """

    title: str | None = None
    inputs: Mapping[str, Any] | None = None
    about_readings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    errors: Mapping[str, float] | None = None
    method: str | None = None
    chosen: Chosen | None = None
    culprits: tuple[Candidate, ...] = ()
    halves: tuple[HalvesEntry, ...] = ()
    nominal: Distances | None = None
    noise_floor: float | None = None
    change_points: ChangePoints | None = None
    discarded: tuple[Outlier, ...] = ()
    shifts: Shifts | None = None
    validation: ValidationEntry | None = None
    models: tuple[ModelEntry, ...] | None = None
    intervals: Mapping[str, IntervalEntry] = field(default_factory=dict)
    tolerance: float | None = None
    region: Mapping[str, tuple[float, float]] | None = None
    files: Mapping[str, str] | None = None
    scales: tuple[ScaleEntry, ...] = ()
    check: CheckEntry | None = None
