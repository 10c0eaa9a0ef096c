"""From a project file to written results: the one path behind the command line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from shlex import quote
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from loopcal.errors import InputError, NoTrustworthyResult, UsageError, nearest
from loopcal.estimation.calibrate import METHODS, calibrate
from loopcal.estimation.result import Result
from loopcal.estimation.solver import Progress
from loopcal.files import result_file
from loopcal.files.atomic import write_files
from loopcal.files.new_project import write_new_project
from loopcal.files.new_readings import read_new_readings
from loopcal.files.project_data import LoadedData, load_dataset
from loopcal.files.project_file import Project, read_project
from loopcal.files.python_function import load_function
from loopcal.files.readings_file import readings_tables
from loopcal.files.result_file import WrittenResult
from loopcal.files.result_folder import read_result_folder
from loopcal.files.table_writer import check_ending, table_bytes
from loopcal.files.templates import TEMPLATES
from loopcal.files.truth_file import read_truth, truth_json
from loopcal.files.validation_entries import ValidationSpec, validation_arguments
from loopcal.measurements.noise import Noise, resolve_noise
from loopcal.report.page import page_of
from loopcal.simulation.simulate import Simulation, simulate
from loopcal.statistics.check import Check, check
from loopcal.statistics.findings import Findings, findings
from loopcal.statistics.intervals import intervals
from loopcal.statistics.models import compare_models
from loopcal.statistics.prediction import Prediction, predict
from loopcal.statistics.predictor import predictor_of
from loopcal.statistics.validation import validate

if TYPE_CHECKING:
    from loopcal.statistics.repeats import Repeats

SCHEMAS = ("project", "result")


@dataclass(frozen=True, eq=False)
class Calibration:
    """A calibration that was run and written.

    written: where, and the content of result.json; findings: what its equations tell beyond the
    parameters; warnings: about the readings; objection: why the result cannot be trusted, None
    where it can.
    """

    result: Result
    findings: Findings
    written: WrittenResult
    warnings: tuple[str, ...]
    objection: str | None


@dataclass(frozen=True, eq=False)
class Simulated:
    """Readings that were simulated and written, their truth beside them."""

    simulation: Simulation
    file: Path
    truth_file: Path


def run_calibration(
    project: str | Path,
    *,
    method: str | None = None,
    truth: str | Path | None = None,
    out: str | Path | None = None,
    function: str | None = None,
    require_identifiable: bool = False,
    folds: int | None = None,
    profile: Sequence[str] = (),
    compare: bool = False,
    report: bool = False,
    progress: Progress | None = None,
) -> Calibration:
    """Calibrate as a project file says, and write result.json, residuals.csv, mechanism.toml.

    project: its path, "-" for standard input; method: instead of the project's; truth: a file
    of true parameters, whose errors are added; out: the folder to write to, by default
    NAME-result beside the project NAME.toml; function: FILE.py:NAME of the loops;
    require_identifiable: whether every parameter must be determined, as the project may ask;
    folds: of a validation, instead of the project's; profile: parameters that get a profile
    interval, beside those of the project; compare: whether the project's models are compared,
    and the result is that of the one recommended; report: whether report.html is written as well.

    The files are written, all or none, also where the fit did not converge: `objection` tells.
    Raises InputError for what cannot be used and UsageError for a method that is none.
    """
    if method is not None and method not in METHODS:
        raise UsageError(f"there is no method {method!r}", remedy=nearest(method, METHODS))
    read = _project(project, function)
    loaded = load_dataset(read)
    true = None if truth is None else read_truth(truth, read.mechanism)
    how: dict[str, Any] = {
        "noise": loaded.noise,
        "method": method or read.fit.method,
        "loss": read.fit.loss,
        "start": read.fit.start,
        "max_iterations": read.fit.max_iterations,
    }
    asked_for = read.fit.validation if folds is None else ValidationSpec(folds=folds)
    try:
        if compare:
            result = _compared(read, loaded, how, asked_for or ValidationSpec(folds=10))
        else:
            result = calibrate(read.mechanism, loaded.dataset, **how, progress=progress)
            if asked_for is not None and result.status.converged:
                result = _validated(result, read, loaded, how, asked_for)
        patterns = (*read.fit.profile, *profile)
        if patterns and result.status.converged:
            result = replace(result, intervals=intervals(result, patterns))
        if read.fit.apply_variance_factor:
            result = result.with_variance_factor()
    except InputError as error:
        raise error.at(read.name) from None
    if true is not None:
        errors = {name: value - result.value[name] for name, value in true.items()}
        result = replace(result, errors=MappingProxyType(errors))
    warnings = tuple(str(warning) for warning in loaded.warnings)
    told = findings(result)
    written = write_result(
        result,
        default_folder(read) if out is None else out,
        title=read.title,
        inputs=read.inputs,
        warnings=warnings,
        found=told,
        report=report,
    )
    asked = require_identifiable or read.fit.require_identifiable
    return Calibration(result, told, written, warnings, _objection(result, told, asked))


def _validated(
    result: Result,
    project: Project,
    loaded: LoadedData,
    how: Mapping[str, Any],
    asked_for: ValidationSpec,
) -> Result:
    parts = validation_arguments(project, asked_for)
    try:
        found = validate(project.mechanism, loaded.dataset, **how, **parts, full=result)
        return replace(result, validation=found)
    except NoTrustworthyResult as error:
        return replace(result, warnings=(*result.warnings, f"Not validated: {error}"))


def _compared(
    project: Project, loaded: LoadedData, how: Mapping[str, Any], asked_for: ValidationSpec
) -> Result:
    """The calibration with the recommended one of the project's models."""
    parts = validation_arguments(project, asked_for)
    found = compare_models(project.mechanism, loaded.dataset, project.compare, **how, **parts)
    chosen = next(m for m in found.models if m.name == found.recommended)
    return replace(found.result, models=found, validation=chosen.validation)


def write_result(
    result: Result,
    folder: str | Path,
    *,
    title: str | None = None,
    inputs: Mapping[str, Any] | None = None,
    warnings: tuple[str, ...] = (),
    found: Findings | None = None,
    report: bool = False,
) -> WrittenResult:
    """Write result.json, residuals.csv and mechanism.toml (calibrated), all or none.

    The folder is made if need be; title, inputs (the project as it was read) and warnings go to
    result.json, with what `findings` tells, or `found`; report: whether report.html comes with
    them. Raises InputError, naming the file, the reason and a remedy, where they cannot be written.
    """
    fields = (found or findings(result)).document()
    page = page_of(result, folder) if report else None
    return result_file.write_result(
        result, folder, title=title, inputs=inputs, warnings=warnings, findings=fields, report=page
    )


def default_folder(project: Project) -> Path:
    """Where results go when nobody says: NAME-result beside the project NAME.toml."""
    name = "loopcal" if project.path is None else project.path.stem
    return project.folder / f"{name}-result"


def _objection(result: Result, told: Findings, require_identifiable: bool) -> str | None:
    """Why the result must not be used, where that is so."""
    if told.outliers.columns:
        faults = "; ".join(str(fault) for fault in told.outliers.columns)
        return f"the file has columns at fault: {faults}. Put them right in the file or in [data]"
    if not result.status.converged:
        return f"the fit did not converge ({result.status.reason}): {result.status.message}"
    loose = result.identifiability.not_identifiable
    if require_identifiable and loose:
        return "not every parameter is identifiable: " + "; ".join(u.words for u in loose)
    return None


@dataclass(frozen=True, eq=False)
class Checked:
    """A project that was looked at before any fit; warnings: about its readings."""

    check: Check
    title: str
    warnings: tuple[str, ...]


def run_check(project: str | Path, *, function: str | None = None) -> Checked:
    """What a project's readings can determine; nothing is fitted and nothing written.

    Raises InputError for what cannot be used.
    """
    read = _project(project, function)
    loaded = load_dataset(read)
    noise: Noise | None = loaded.noise
    if read.fit.method == "least-squares" and not loaded.noise.entries:
        noise = None
    try:
        done = check(read.mechanism, loaded.dataset, noise=noise, start=read.fit.start)
    except InputError as error:
        raise error.at(read.name) from None
    return Checked(done, read.title, tuple(str(warning) for warning in loaded.warnings))


def run_prediction(
    result: str | Path, readings: str | Path, *, out: str | Path | None, function: str | None = None
) -> Prediction:
    """Predict outputs from a result on the disk and readings in the columns of its project.

    out: a table to write (.csv, .tsv or .parquet). Raises InputError for what cannot be used.
    """
    if out is not None:
        check_ending(out)
    loops = None if function is None else load_function(function)
    read = read_result_folder(result, function=loops)
    try:
        known = predictor_of(read.document, read.mechanism)
    except InputError as error:
        raise error.at(str(read.path)) from None
    data = read_new_readings(readings, read.document["inputs"], read.mechanism)
    done = predict(known, data)
    if out is not None:
        path = Path(out)
        write_files(path.parent, {path.name: table_bytes(done.columns(), path.suffix)})
    return done


def prediction_table(prediction: Prediction) -> str:
    """The table that `run_prediction` writes, as CSV text."""
    return table_bytes(prediction.columns()).decode("utf-8")


def run_simulation(
    project: str | Path, *, out: str | Path, seed: int, function: str | None = None
) -> Simulated:
    """Make readings as the [simulation] of a project says, with the noise of a seed.

    Writes the readings to `out` (.csv, .tsv or .parquet) under the column names and units in
    which the project reads them, and the truth beside them: NAME.truth.json for NAME.csv.
    Raises InputError for what cannot be used.
    """
    out = Path(out)
    check_ending(out)
    read = _project(project, function)
    if read.simulation is None:
        raise InputError(
            "the project does not say what to simulate",
            place=read.name,
            remedy="add [simulation.ranges], one line for every quantity that is driven",
        )
    noise = read.simulation.noise.noise()
    try:
        made = simulate(
            read.mechanism,
            read.simulation.driven(seed),
            noise=noise,
            seed=seed,
            truth=read.simulation.machine(read.mechanism.parameters, seed),
        )
    except InputError as error:
        raise error.at(read.name) from None
    quantities = read.mechanism.tape.quantities
    known = resolve_noise(noise, made.dataset, quantities, read.mechanism.quantity_group)
    shape = (len(quantities), len(made.dataset))
    sds = dict(zip(quantities, np.broadcast_to(known.sd, shape), strict=True))
    truth_file = out.with_name(f"{out.stem}.truth.json")
    write_files(
        out.parent,
        {
            **readings_tables(made.dataset, read.data, sds, out),
            truth_file.name: truth_json(made, read.mechanism),
        },
    )
    return Simulated(made, out, truth_file)


@dataclass(frozen=True)
class NewProject:
    """A project to start from: its files, the project file, and what to type next."""

    files: tuple[Path, ...]
    project: Path
    commands: tuple[str, ...]


def new_project(name: str, kind: str) -> NewProject:
    """Write a commented project with a mechanism of some type into a folder of this name.

    Raises UsageError for a type that is none, InputError where files are in the way.
    """
    if kind not in TEMPLATES:
        raise UsageError(f"there is no mechanism type {kind!r}", remedy=nearest(kind, TEMPLATES))
    files = write_new_project(name, kind)
    project = Path(name) / "project.toml"
    code = [path for path in files if path.suffix == ".py"]
    loops = f" --mechanism {quote(f'{code[0]}:loops')}" if code else ""
    at, poses = quote(str(project)), Path(name) / "poses.csv"
    truth = quote(str(poses.with_name("poses.truth.json")))
    commands = (
        f"loopcal simulate {at}{loops} --out {quote(str(poses))} --seed 1",
        f"loopcal calibrate {at}{loops} --truth {truth}",
    )
    return NewProject(files, project, commands)


@dataclass(frozen=True, eq=False)
class SensorNoise:
    """What repeated readings say of the sensors; text and document tell it, SI in the latter."""

    repeats: Repeats
    text: str
    document: dict[str, Any]


def sensor_noise(
    files: Sequence[str | Path],
    *,
    project: str | Path | None = None,
    columns: str | None = None,
    pose: str | None = None,
    function: str | None = None,
) -> SensorNoise:
    """Sensor sds from files of repeated readings, one pose each.

    project: whose columns, units and loops are used, to tell joints from instrument; columns:
    "S=rad,x=m" instead, else every column of numbers; pose: column of the ids.
    Raises InputError for what cannot be read or used, UsageError for options that clash.
    """
    from loopcal.files.repeats_files import read_repeats
    from loopcal.statistics import repeats_summary
    from loopcal.statistics.repeats import repeated_readings, with_separation
    from loopcal.statistics.separation import separate

    read = None if project is None else _project(project, function)
    series = read_repeats(files, project=read, columns=columns, pose=pose)
    found = repeated_readings(series)
    if read is not None:
        try:
            elsewhere = load_dataset(read).dataset if read.fit.start != "nominal" else None
        except InputError:
            elsewhere = None  # its readings are not here; the series may place the machine
        raw = {sensor.name: sensor.about_mean.sd for sensor in found.sensors}
        try:
            apart = separate(read.mechanism, series, raw, elsewhere=elsewhere)
        except InputError as error:
            raise error.at(read.name) from None
        found = with_separation(found, apart)
    return SensorNoise(found, repeats_summary.summary(found), repeats_summary.document(found))


def schema(name: str) -> dict[str, Any]:
    """The JSON Schema of "project" files or of "result" files."""
    if name == "project":
        from loopcal.files.project_schema import project_schema

        return project_schema()
    if name == "result":
        return result_file.result_schema()
    raise UsageError(f"there is no schema {name!r}", remedy=nearest(name, SCHEMAS))


def _project(path: str | Path, function: str | None) -> Project:
    return read_project(path, mechanism=None if function is None else load_function(function))
