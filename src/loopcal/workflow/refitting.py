"""A quick look at a changed project: its fit from where the last result ended, nothing judged."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from loopcal.document.accuracy import Distances
from loopcal.document.result_document import ResultDocument
from loopcal.errors import InputError
from loopcal.estimation.solve.scratch import one_blas_thread
from loopcal.files.project.project_data import load_dataset
from loopcal.files.project.stream import project_stream
from loopcal.files.result.pose_table import PoseTable, pose_table
from loopcal.statistics.case import Case
from loopcal.statistics.continued import Ending, continued
from loopcal.workflow.projects import named_project


@dataclass(frozen=True, eq=False)
class Refit:
    """What a fit found before anything was chosen, validated or judged.

    label: of the method; converged: whether it ended; unit: SI, of the accuracy; table: readings
    and differences of the poses used; values: of all parameters [SI].
    """

    label: str
    converged: bool
    unit: str
    accuracy: Distances
    table: PoseTable
    values: dict[str, float]

    def shown_in(self, document: ResultDocument) -> ResultDocument:
        """The document of the last result with these numbers; sds and verdict are not known yet."""
        entries = {p.name: p for p in document.parameters}
        parameters = tuple(
            replace(entries[name], value=value, sd=None, interval=None)
            for name, value in self.values.items()
            if name in entries
        )
        accuracy: Any = document.accuracy and replace(document.accuracy, after=self.accuracy)
        return replace(
            document,
            parameters=parameters,
            accuracy=accuracy,
            method_label=self.label,
            verdict=None,
            validation=None,
            outliers=None,
            change_points=None,
        )


@one_blas_thread()
def run_refit(
    project: str | Path, ending: Ending, *, method: str | None = None, function: str | None = None
) -> Refit:
    """Fit a project from where an earlier calibration ended; nothing is written.

    method: instead of the project's; function: FILE.py:NAME of the loops. Raises InputError for
    what cannot be used, for a stream, and for a machine without outputs.
    """
    read = named_project(project, function)
    fit = read.fit.settings
    if method is not None:
        fit = fit.changed(method=method)
    if project_stream(read) is not None:
        raise InputError("the project streams its readings", code="unsupported", place=read.name)
    loaded = load_dataset(read)
    case = Case(read.mechanism, loaded.dataset, loaded.noise, fit)
    result = continued(case, ending)
    accuracy = result.accuracy_after
    if accuracy is None:
        raise InputError("the machine has no outputs", code="unsupported", place=read.name)
    whole = pose_table(result)
    after, readings = dict(whole.differences_after), dict(whole.readings)
    table = PoseTable(whole.poses, differences_after=after, readings=readings)
    label, ended = result.fit.label, result.status.converged
    return Refit(label, ended, accuracy.unit, accuracy.distances, table, dict(result.value))
