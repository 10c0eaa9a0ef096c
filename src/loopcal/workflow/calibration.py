"""From a project file to written results: the one path behind the command line."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from loopcal.document.result_document import ResultDocument
from loopcal.errors import InputError, NoTrustworthyResult, UsageError, nearest
from loopcal.estimation.calibrate import METHODS, calibrate
from loopcal.estimation.result import Result
from loopcal.estimation.solve.solver import Progress
from loopcal.execution.executor import Executor
from loopcal.files.project.project_data import LoadedData, load_dataset
from loopcal.files.project.project_file import Project
from loopcal.files.project.stream import project_stream
from loopcal.files.project.validation_entries import ValidationSpec, validation_arguments
from loopcal.files.result import result_file
from loopcal.files.result.residual_parts import NAME as RESIDUALS
from loopcal.files.result.result_file import WrittenResult
from loopcal.files.result.truth_file import read_truth
from loopcal.files.versions import versions as known_versions
from loopcal.measurements.checks import DataWarning
from loopcal.statistics.findings import Findings, findings
from loopcal.workflow.projects import named_project

if TYPE_CHECKING:
    from loopcal.statistics.models import ModelComparison
    from loopcal.statistics.validation import Validation

Addition = Callable[[ResultDocument], ResultDocument]
"""Adds to the document of a result what was asked for beside the fit."""
Pieces = Callable[[str, int, int], None]
"""Called with what is done in pieces, how many of them are done, and how many there are."""


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
    executor: Executor | None = None,
    sharing: Callable[[Executor], None] | None = None,
    progress: Progress | None = None,
    pieces: Pieces | None = None,
    notice: Callable[[str], None] | None = None,
    warn: Callable[[str], None] | None = None,
) -> Calibration:
    """Calibrate as a project file says, and write result.json, residuals.csv, mechanism.toml.

    project: its path, "-" for standard input; method: instead of the project's; truth: a file
    of true parameters, whose errors are added; out: the folder to write to, by default
    NAME-result beside the project NAME.toml; function: FILE.py:NAME of the loops;
    require_identifiable: whether every parameter must be determined, as the project may ask;
    folds: of a validation, instead of the project's; profile: parameters that get a profile
    interval, beside those of the project; compare: whether the project's models are compared,
    and the result is that of the one recommended; report: whether report.html is written as well;
    executor: who does the fits of the folds and the profiles, or the chunks of a stream, by default
    this process; sharing: called with the executor once it is clear that there is work for it;
    progress: called at every iteration, pieces: when a fold or a profile is done, notice: with
    what an earlier run has left to go on from, warn: with what is odd about the readings, before
    any fit.

    The files are written, all or none, also where the fit did not converge: `objection` tells.
    Raises InputError for what cannot be used and UsageError for a method that is none, or for an
    executor without work.
    """
    if method is not None and method not in METHODS:
        raise UsageError(f"there is no method {method!r}", remedy=nearest(method, METHODS))
    read = named_project(project, function)
    folder = default_folder(read) if out is None else Path(out)
    true = None if truth is None else read_truth(truth, read.mechanism)
    asked = require_identifiable or read.fit.require_identifiable
    asked_for = read.fit.validation if folds is None else ValidationSpec(folds=folds)
    patterns = (*read.fit.profile, *profile)
    stream = project_stream(read)
    divisible = stream is not None or patterns or compare or (asked_for and asked_for.folds)
    if executor and not divisible:
        raise UsageError(
            "one fit of poses in memory is not shared out, and nothing else is asked for",
            remedy="add --folds N or --profile GLOB, or leave out --workers and --cluster",
        )
    if stream is not None:
        from loopcal.workflow.streams import refuse_without_all_poses, run_stream

        others = {
            "a validation": asked_for is not None,
            "a profile interval": patterns,
            "a comparison of models": compare,
        }
        refuse_without_all_poses(read, others)
    if executor and sharing:
        sharing(executor)
    if stream is not None:
        _tell(stream.warnings, warn)
        run = run_stream(
            read,
            stream,
            folder,
            method=method or read.fit.method,
            executor=executor,
            progress=progress,
            notice=notice,
        )
        try:
            done = _written(
                run.result, read, folder, stream.warnings, true, asked=asked, report=report
            )
            run.finish()
        except BaseException:
            run.undo()
            raise
        files = (*done.written.files, f"{RESIDUALS}/")
        return replace(done, written=replace(done.written, files=files))
    loaded = load_dataset(read)
    _tell(loaded.warnings, warn)
    how: dict[str, Any] = {
        "noise": loaded.noise,
        "method": method or read.fit.method,
        "loss": read.fit.loss,
        "start": read.fit.start,
        "max_iterations": read.fit.max_iterations,
    }
    add: list[Addition] = []
    try:
        folded = how | _shared("folds", executor, pieces)
        if compare:
            models = _compared(read, loaded, folded, asked_for or ValidationSpec(folds=10))
            result = models.result
            add.append(models.added_to)
        else:
            result = calibrate(read.mechanism, loaded.dataset, **how, progress=progress)
            if asked_for is not None and result.status.converged:
                try:
                    add.append(_validated(result, read, loaded, folded, asked_for).added_to)
                except NoTrustworthyResult as error:
                    result = result.noted(f"Not validated: {error}")
        if patterns and result.status.converged:
            from loopcal.statistics.intervals import intervals, with_intervals

            shared = _shared("intervals", executor, pieces)
            found = intervals(result, patterns, **shared)
            add.append(partial(with_intervals, intervals=found))
    except InputError as error:
        raise error.at(read.name) from None
    return _written(
        result, read, folder, loaded.warnings, true, add=add, asked=asked, report=report
    )


def _tell(warnings: Sequence[DataWarning], warn: Callable[[str], None] | None) -> None:
    if warn:
        for warning in warnings:
            warn(str(warning))


def _shared(what: str, executor: Executor | None, pieces: Pieces | None) -> dict[str, Any]:
    return {"executor": executor, "progress": pieces and partial(pieces, what)}


def _written(
    result: Result,
    project: Project,
    folder: Path,
    warnings: Sequence[DataWarning],
    truth: Mapping[str, float] | None,
    *,
    add: Sequence[Addition] = (),
    asked: bool,
    report: bool,
) -> Calibration:
    """The result in its files; add: what else goes to the document; asked: whether every parameter
    must be determined."""
    if project.fit.apply_variance_factor:
        try:
            result = result.with_variance_factor()
        except InputError as error:
            raise error.at(project.name) from None
    if truth is not None:
        errors = {name: value - result.value[name] for name, value in truth.items()}
        result = replace(result, errors=MappingProxyType(errors))
    told = findings(result)
    words = tuple(str(warning) for warning in warnings)
    document = told.added_to(result.document)
    for addition in add:
        document = addition(document)
    written = write_result(
        result,
        folder,
        title=project.title,
        inputs=project.inputs,
        warnings=words,
        document=document,
        report=report,
    )
    return Calibration(result, told, written, words, _objection(result, told, asked))


def _validated(
    result: Result,
    project: Project,
    loaded: LoadedData,
    how: Mapping[str, Any],
    asked_for: ValidationSpec,
) -> Validation:
    from loopcal.statistics.validation import validate

    parts = validation_arguments(project, asked_for)
    return validate(project.mechanism, loaded.dataset, **how, **parts, full=result)


def _compared(
    project: Project, loaded: LoadedData, how: Mapping[str, Any], asked_for: ValidationSpec
) -> ModelComparison:
    """The project's models, with the calibration by the recommended one."""
    from loopcal.statistics.models import compare_models

    parts = validation_arguments(project, asked_for)
    return compare_models(project.mechanism, loaded.dataset, project.compare, **how, **parts)


def write_result(
    result: Result,
    folder: str | Path,
    *,
    title: str | None = None,
    inputs: Mapping[str, Any] | None = None,
    warnings: tuple[str, ...] = (),
    document: ResultDocument | None = None,
    report: bool = False,
) -> WrittenResult:
    """Write result.json, residuals.csv and mechanism.toml (calibrated), all or none.

    The folder is made if need be. title, inputs (the project as it was read) and warnings go to
    result.json; document: that of the result with what was added to it, by default its `findings`;
    report: whether report.html comes with them. Raises InputError, naming the file, the reason and
    a remedy, where they cannot be written.
    """
    told = document or findings(result).added_to(result.document)
    versions = known_versions()
    told = replace(
        told,
        loopcal=versions["loopcal"],
        title=title,
        warnings=(*warnings, *told.warnings),
        inputs=result_file.finite_only(inputs or {}),
        versions=versions,
    )
    page = None
    if report:
        from loopcal.report.page import page_of

        page = page_of(result, folder)
    return result_file.write_result(result, told, folder, report=page)


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
