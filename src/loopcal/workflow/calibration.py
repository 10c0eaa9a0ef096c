"""From a project file to written results: the one path behind the command line."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from loopcal.document.result_document import ResultDocument, WrittenResult
from loopcal.document.verdict import QUESTIONS
from loopcal.errors import InputError, NoTrustworthyResult, UsageError, nearest
from loopcal.estimation.fit import Fit
from loopcal.estimation.methods.registry import METHODS
from loopcal.estimation.plausible import refuse_other_units
from loopcal.estimation.result import FitResult
from loopcal.estimation.solve.scratch import one_blas_thread
from loopcal.estimation.solve.solver import Progress
from loopcal.execution.executor import Executor
from loopcal.files.outputs import refuse_foreign
from loopcal.files.project.fit_table import Validation
from loopcal.files.project.project_data import LoadedData, load_dataset, validation_arguments
from loopcal.files.project.project_file import Project
from loopcal.files.project.stream import ParquetStream, project_stream
from loopcal.files.result import result_file
from loopcal.files.result.pose_table import NAME as RESIDUALS
from loopcal.lazy import cached_property
from loopcal.measurements.checks import DataWarning
from loopcal.statistics.verdict import judged, refuses
from loopcal.workflow.keeping import Keeper
from loopcal.workflow.projects import named_project, project_files, refuse_tolerance, stored_files
from loopcal.workflow.result import Result, save_result

Pieces = Callable[[str, int, int], None]
"""Called with what is done in pieces, how many of them are done, and how many there are."""
_UNCONVERGED = "the fit of all poses did not converge"


@dataclass(frozen=True, eq=False)
class Calibration:
    """A calibration that was run and written.

    written: where, and the content of result.json; objection: why the result cannot be trusted,
    None where it can; typed: the document with commands as they are typed in this folder, where
    those of result.json are typed in the project's.
    """

    result: Result
    written: WrittenResult
    objection: str | None
    typed: ResultDocument


@dataclass(frozen=True)
class Request:
    """What is asked of a calibration beyond its project file.

    method: instead of the project's; truth: a file of true parameters, whose errors are added;
    require_identifiable: whether every parameter must be determined, as the project may ask;
    require: questions of the verdict that must be answered with yes, beside "sound"; folds: of a
    validation, instead of the project's; profile: parameters that get a profile interval, beside
    those of the project; compare: whether the project's models are compared, and the result is
    that of the one recommended; report: whether report.html is written as well; keeper: keeps the
    result too; tolerance: distance [m] that 95 % of poses shall keep, instead of the project's.
    """

    method: str | None = None
    truth: str | Path | None = None
    require_identifiable: bool = False
    require: Sequence[str] = ()
    folds: int | None = None
    profile: Sequence[str] = ()
    compare: bool = False
    report: bool = False
    keeper: Keeper | None = None
    tolerance: float | None = None


@dataclass(frozen=True, eq=False)
class Listeners:
    """Who is told what happens during a calibration.

    sharing: called with the executor once it is clear that there is work for it; progress: at
    every iteration; pieces: when a fold or a profile is done; notice: with what an earlier run
    has left to resume from; warn: with what is odd about the readings, before any fit.
    """

    sharing: Callable[[Executor], None] | None = None
    progress: Progress | None = None
    fitted: Callable[[FitResult], None] | None = None
    pieces: Pieces | None = None
    notice: Callable[[str], None] | None = None
    warn: Callable[[str], None] | None = None


def run_calibration(
    project: str | Path,
    request: Request = Request(),
    *,
    out: str | Path | None = None,
    function: str | None = None,
    executor: Executor | None = None,
    listeners: Listeners = Listeners(),
) -> Calibration:
    """Calibrate as a project file says, and write result.json, residuals.csv, mechanism.toml.

    project: its path, "-" for standard input; out: the folder to write to, by default NAME-result
    beside the project NAME.toml; function: FILE.py:NAME of the loops; executor: who does the fits
    of the folds and the profiles, or the chunks of a stream, by default this process.

    The files are written, all or none, also where the fit did not converge: `objection` tells.
    Raises InputError for what cannot be used, and UsageError for an unknown method or an executor
    without work.
    """
    if request.method is not None and request.method not in METHODS:
        raise UsageError(
            f"there is no method {request.method!r}",
            code="unknown-name",
            remedy=nearest(request.method, METHODS),
        )
    for name in request.require:
        if name not in QUESTIONS:
            raise UsageError(
                f"the verdict has no question {name!r}",
                code="unknown-name",
                remedy=nearest(name, QUESTIONS),
            )
    run = _Run(named_project(project, function), request, out, executor, listeners, function)
    refuse_tolerance(run.project.mechanism, request.tolerance, at_boards=True)
    stream = project_stream(run.project)
    folded = run.fit.method.choice or (run.validation is not None and run.validation.folds)
    if executor and not (folded or stream or run.patterns or request.compare):
        raise UsageError(
            "a single fit in memory cannot use --workers or --cluster",
            remedy="add --folds N or --profile GLOB, or leave out --workers and --cluster",
        )
    return run.in_memory() if stream is None else run.streamed(stream)


@dataclass(frozen=True, eq=False)
class _Run:
    """One run: a project, what is asked of it, where results go, who does the fits and listens."""

    project: Project
    request: Request
    out: str | Path | None
    executor: Executor | None
    listeners: Listeners
    function: str | None = None

    @cached_property
    def truth(self) -> Mapping[str, float] | None:
        """The true parameters."""
        if self.request.truth is None:
            return None
        from loopcal.files.result.truth_file import read_truth

        return read_truth(self.request.truth, self.project.mechanism)

    @cached_property
    def fit(self) -> Fit:
        """The settings of the project, with the method asked for."""
        settings = self.project.fit.settings
        if self.request.method is None:
            return settings
        try:
            return settings.changed(method=self.request.method)
        except InputError as error:
            raise error.at(self.project.name) from None

    @cached_property
    def validation(self) -> Validation | None:
        """The validation asked for."""
        if self.request.folds is None:
            return self.project.fit.validation
        return Validation(folds=self.request.folds)

    @property
    def patterns(self) -> tuple[str, ...]:
        """Parameters that get a profile interval."""
        return (*self.project.fit.profile, *self.request.profile)

    @property
    def folder(self) -> Path:
        """Where results go."""
        return default_folder(self.project) if self.out is None else Path(self.out)

    # Blocks of a pose are small: two threads double the processor time for no gain (`scratch`).
    @one_blas_thread()
    def in_memory(self) -> Calibration:
        """Calibrate from poses that are all in memory, and write the result."""
        return self._written(self.finished())

    def finished(self) -> Result:
        """Calibrate from poses that are all in memory."""
        self._begin()
        loaded = load_dataset(self.project)
        self._warn(loaded.warnings)
        try:
            refuse_other_units(self.project.mechanism, loaded.dataset, loaded.noise)
            fitted = self._compared(loaded) if self.request.compare else self._calibrated(loaded)
            if self.patterns:
                fitted = self._profiled(fitted)
        except InputError as error:
            raise error.at(self.project.name) from None
        return self._finished(fitted, loaded.warnings)

    def streamed(self, stream: ParquetStream) -> Calibration:
        """Calibrate from poses that come as a stream."""
        from loopcal.workflow.streams import refuse_without_all_poses, run_stream

        others = {
            "a validation": self.validation is not None,
            "a profile interval": self.patterns,
            "a comparison of models": self.request.compare,
        }
        refuse_without_all_poses(self.project, self.fit, others)
        self._begin()
        self._warn(stream.warnings)
        run = run_stream(
            self.project,
            stream,
            self.folder,
            fit=self.fit,
            executor=self.executor,
            progress=self.listeners.progress,
            notice=self.listeners.notice,
        )
        try:
            result = self._finished(run.result, stream.warnings)
            _ = result.document  # the searches come before the check
            # Before result.json: another run may have removed the residuals of this one.
            run.parts.check()
            done = self._written(result)
            # After it: a run that dies in between can still resume.
            run.finish()
        except BaseException:
            run.undo()
            raise
        files = (*done.written.files, f"{RESIDUALS}/")
        return replace(done, written=replace(done.written, files=files))

    def _begin(self) -> None:
        """Meet what is wrong with the request before any work, then tell who shares in it."""
        # Cached properties: their refusals come now, not after an hour of fitting.
        _ = self.truth, self.fit
        refuse_foreign(*(self.folder / name for name in (*result_file.NAMES, "report.html")))
        if self.request.keeper is not None:
            self.request.keeper.refuse()
        if self.executor and self.listeners.sharing:
            self.listeners.sharing(self.executor)

    def _warn(self, warnings: Sequence[DataWarning]) -> None:
        for warning in warnings if self.listeners.warn else ():
            assert self.listeners.warn
            self.listeners.warn(str(warning))

    def _shared(self, what: str) -> dict[str, Any]:
        pieces = self.listeners.pieces
        return {"executor": self.executor, "progress": pieces and partial(pieces, what)}

    def _calibrated(self, loaded: LoadedData) -> FitResult:
        """By a stated method or by the one that poses not used choose, validated where asked."""
        from loopcal.statistics.case import Case

        case = Case(self.project.mechanism, loaded.dataset, loaded.noise, self.fit)
        progress, scheme = self.listeners.progress, None
        if self.validation is not None:
            from loopcal.statistics.folds import Scheme

            poses = loaded.dataset.poses
            scheme = Scheme(**validation_arguments(self.project, self.validation, poses))
        if self.fit.method.choice:
            from loopcal.statistics.choice import choose

            result = choose(case, scheme, **self._shared("fits"), iterated=progress).result
        else:
            result = case.calibrated(progress=progress)
        if self.listeners.fitted is not None:
            self.listeners.fitted(result)
        if self.fit.method.choice or scheme is None:
            return result
        if not result.status.converged:
            return result.noted(f"Not validated: {_UNCONVERGED}.")
        from loopcal.statistics.validation import validated

        try:
            validation = validated(case, result, scheme, **self._shared("folds"))
        except NoTrustworthyResult as error:
            # A fold that fails leaves the calibration of all poses as it is.
            return result.noted(f"Not validated: {error}")
        return result.with_parts(validation=validation.entry)

    def _compared(self, loaded: LoadedData) -> FitResult:
        """The calibration with the recommended one of the project's models."""
        from loopcal.statistics.models import compare_models

        project = self.project
        options: dict[str, Any] = {"noise": loaded.noise, "fit": self.fit}
        # On poses not used a model with more parameters has no advantage by them.
        asked = self.validation or Validation(folds=10)
        options |= validation_arguments(project, asked, loaded.dataset.poses)
        options |= self._shared("folds")
        return compare_models(project.mechanism, loaded.dataset, project.compare, **options).result

    def _profiled(self, result: FitResult) -> FitResult:
        from loopcal.statistics.intervals import interval_entries, intervals

        if not result.status.converged:
            return result.noted(f"No profile intervals: {_UNCONVERGED}.")
        profiles = intervals(result, self.patterns, **self._shared("intervals"))
        return result.with_parts(intervals=interval_entries(profiles))

    def _finished(self, fitted: FitResult, warnings: Sequence[DataWarning]) -> Result:
        """The result with everything that its files tell."""
        if self.project.fit.apply_variance_factor:
            try:
                fitted = fitted.with_variance_factor()
            except InputError as error:
                raise error.at(self.project.name) from None
        errors = None
        if self.truth is not None:
            errors = {name: value - fitted.value[name] for name, value in self.truth.items()}
        return Result.of(
            fitted,
            title=self.project.title,
            inputs=dict(self.project.inputs),
            about_readings=tuple(str(warning) for warning in warnings),
            errors=errors,
            tolerance=self._tolerance,
            region=self.project.verdict.region,
            files=stored_files(self.project, self.function, self.folder),
        )

    def _written(self, result: Result) -> Calibration:
        """The result and its files."""
        request = self.request
        written = save_result(result, self.folder, report=request.report, keeper=request.keeper)
        typed, files = written.document, project_files(self.project, self.function)
        if files:
            typed = judged(typed, self._tolerance, {**files, "result": str(self.folder)})
        return Calibration(result, written, self._objection(written.document), typed)

    @property
    def _tolerance(self) -> float | None:
        asked = self.request.tolerance
        return self.project.verdict.tolerance if asked is None else asked

    def _objection(self, document: ResultDocument) -> str | None:
        """Why the result must not be used, where that is so."""
        verdict = document.verdict
        assert verdict is not None
        required = {"sound", *self.project.verdict.require, *self.request.require}
        asked = [(name, answer) for name, answer in verdict.answers.items() if name in required]
        failed = [name for name, answer in asked if refuses(name, answer)]
        if failed:
            return f"the verdict says why ({', '.join(failed)}: not answered yes)"
        loose = document.identifiability.not_identifiable
        if loose and (self.request.require_identifiable or self.project.fit.require_identifiable):
            return "not every parameter is identifiable: " + "; ".join(u.words for u in loose)
        return None


def calibrated(project: Project) -> Result:
    """The result of a project as `run_calibration` finds it; nothing is written.

    Raises InputError for what cannot be used, and for a stream.
    """
    if project_stream(project) is not None:
        raise InputError(
            "the project streams its readings",
            code="unsupported",
            place=project.name,
            remedy="use loopcal calibrate, which keeps its progress in a folder",
        )
    return _Run(project, Request(), None, None, Listeners()).finished()


def default_folder(project: Project) -> Path:
    """Where results go when nobody says: NAME-result beside the project NAME.toml."""
    name = "loopcal" if project.path is None else project.path.stem
    return project.folder / f"{name}-result"
