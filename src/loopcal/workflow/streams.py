"""Calibration of more poses than memory holds: chunk by chunk, resumed after an interruption."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from loopcal.errors import InputError, Unfinished
from loopcal.estimation.fit import Fit
from loopcal.estimation.result import FitResult
from loopcal.estimation.solve.solver import Progress
from loopcal.estimation.stream.calibrate import Parts, calibrate_stream, refuse_unstreamable
from loopcal.execution.executor import Executor
from loopcal.files.project.project_file import Project
from loopcal.files.project.stream import ParquetStream
from loopcal.files.result.pose_table import ResidualParts, residual_part
from loopcal.files.result.progress_file import ProgressFile
from loopcal.files.versions import versions

DROPPED = (
    "left by a run with another project, readings, method or version; starting from the beginning"
)


@dataclass(frozen=True, eq=False)
class StreamedRun:
    """A calibration from a stream whose files are not yet in place."""

    result: FitResult
    parts: ResidualParts
    progress: ProgressFile

    def finish(self) -> None:
        """Put the residuals of all poses in place, once the result is written."""
        self.parts.finish()
        # The checkpoint goes last: a run that dies ahead of this can still resume.
        self.progress.remove()

    def undo(self) -> None:
        """Remove the residuals; what was reached stays for the next run."""
        self.parts.undo()


def refuse_without_all_poses(project: Project, fit: Fit, asked: Mapping[str, Any]) -> None:
    """Raise InputError for what is asked of a stream and needs all its poses in memory.

    asked: what the user asked for beside the fit, by the words for it.
    """
    try:
        refuse_unstreamable(fit)
    except InputError as error:
        raise error.at(project.name) from None
    for words, wanted in asked.items():
        if wanted:
            raise InputError(
                f"{words} needs all poses in memory, but they are read as a stream",
                code="unsupported",
                place=project.name,
                remedy="leave it out, or thin the poses (data.every) and set stream = false",
            )


def run_stream(
    project: Project,
    stream: ParquetStream,
    folder: Path,
    *,
    fit: Fit,
    executor: Executor | None,
    progress: Progress | None,
    notice: Callable[[str], None] | None,
) -> StreamedRun:
    """Calibrate from readings that come in chunks.

    folder: of the result; executor: who reads the chunks and does their part of the work, whereas
    files are written here alone; notice: called with a message about where the run begins. Every
    iteration keeps a checkpoint there in unfinished.json. A run that finds one of the same project,
    readings and method resumes from it. The residuals of all poses are written as they come.
    """
    # Another version may take other steps: its checkpoint would lead elsewhere.
    task = {
        "project": project.inputs,
        "readings": stream.sha256,
        "method": fit.method.name,
        "loss": fit.loss,
        "loopcal": versions()["loopcal"],
    }
    kept = ProgressFile(folder, task)
    resume = kept.read()
    if notice and kept.present():
        resumed = resume and f"resuming after iteration {resume.iterations} of an interrupted run"
        notice(f"{kept.path}: {resumed or DROPPED}")
    parts = ResidualParts(folder)
    parts.begin()
    try:
        result = calibrate_stream(
            project.mechanism,
            stream,
            fit=fit,
            resume=resume,
            executor=executor,
            progress=progress,
            reached=kept.write,
            parts=Parts(residual_part, parts.add),
        )
    except InputError as error:
        parts.undo()
        if kept.present():  # what was reached stays for the next run
            raise Unfinished.of(error) from None
        raise
    except BaseException:
        parts.undo()
        raise
    return StreamedRun(result, parts, kept)
