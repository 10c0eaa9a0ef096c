"""Projects: read, begun from a template, and the schemas of their files."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path
from shlex import quote
from typing import Any

from loopcal.document.accuracy import Distances
from loopcal.document.result_document import ResultDocument
from loopcal.errors import InputError, UsageError, nearest
from loopcal.estimation.solve.scratch import one_blas_thread
from loopcal.files.machines.python_function import load_function
from loopcal.files.project.project_data import load_dataset
from loopcal.files.project.project_file import Project, read_project
from loopcal.files.project.stream import project_stream
from loopcal.files.project.templates import TEMPLATES
from loopcal.files.result import result_file
from loopcal.files.result.pose_table import PoseTable, pose_table
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.statistics.case import Case
from loopcal.statistics.continued import Ending, continued

SCHEMAS = ("project", "result")


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
        raise UsageError(
            f"there is no mechanism type {kind!r}",
            code="unknown-name",
            remedy=nearest(kind, TEMPLATES),
        )
    from loopcal.files.project.new_project import write_new_project

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


def schema(name: str) -> dict[str, Any]:
    """The JSON Schema of "project" files or of "result" files."""
    if name == "project":
        from loopcal.files.project.project_schema import project_schema

        return project_schema()
    if name == "result":
        return result_file.result_schema()
    raise UsageError(
        f"there is no schema {name!r}", code="unknown-name", remedy=nearest(name, SCHEMAS)
    )


def named_project(path: str | Path, function: str | None) -> Project:
    """The project of a file; function: FILE.py:NAME of its loops, where they are Python code."""
    return read_project(path, mechanism=None if function is None else load_function(function))


def project_files(project: Project, function: str | None) -> dict[str, str]:
    """Names for the command lines of findings; empty where the project's file is not all of it."""
    return {} if project.path is None or function else {"project": str(project.path)}


def refuse_tolerance(
    mechanism: Mechanism, tolerance: float | None, *, at_boards: bool = False
) -> None:
    """Raise InputError for a tolerance [m] that is not above zero, or of a machine without lengths
    among its outputs; at_boards: those of boards that cameras see are judged as well."""
    if tolerance is None:
        return
    from loopcal.statistics.verification import check_tolerance

    check_tolerance(tolerance)
    units = {mechanism.quantities[q] for q in mechanism.outputs}
    if not units & {"m", "px" if at_boards else "m"}:
        raise InputError(
            f"the tolerance is a distance, but {mechanism.name!r} has no output that is a length",
            code="wrong-unit",
            remedy="leave the tolerance out; in Python, `verify` takes it in the unit of the "
            "outputs",
        )


def stored_files(project: Project, function: str | None, folder: Path) -> dict[str, str]:
    """The same with the result's folder, as they are typed in the project's folder.

    What is stored must not depend on the folder in which the command was typed.
    """
    if not project_files(project, function) or project.path is None:
        return {}
    result = os.path.relpath(folder, project.path.parent)
    return {"project": project.path.name, "result": Path(result).as_posix()}


# A quick look at a changed project: its fit from where the last result ended, nothing judged.


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
