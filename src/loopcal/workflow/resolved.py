"""What a user gives in Python, a path or a value: resolved to mechanisms, readings and results.

Functions below this layer know values in SI only. A table without units is taken as SI, and
refused where that is implausible.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from loopcal.errors import InputError
from loopcal.estimation.result import FitResult
from loopcal.files.machines.mechanism_file import read_mechanism
from loopcal.files.project.project_data import load_dataset
from loopcal.files.project.project_file import Project, read_project
from loopcal.files.toml.reader import read_toml
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.workflow.beginning.initial import InitialProject
from loopcal.workflow.calibration import calibrated
from loopcal.workflow.readings import Units, new_readings, readings
from loopcal.workflow.result import Result
from loopcal.workflow.saved_result import SavedResult, read_result


@dataclass(frozen=True, eq=False)
class Stated:
    """A mechanism, its readings, and what a project states beside them."""

    mechanism: Mechanism
    data: Dataset
    options: Mapping[str, Any] = field(default_factory=dict)
    parts: Mapping[str, Any] = field(default_factory=dict)
    """Of the result: title and inputs of the project."""


_CALLS = (
    "name the robot with readings: lc.calibrate(readings, urdf='robot.urdf'); or give a "
    "project, or a Mechanism, as lc.assemble(machine, instruments) makes one"
)


def described(value: Any) -> Any:
    """A mechanism or a project, where a path of one or a result is given."""
    if isinstance(value, str | Path):
        try:
            content = read_toml(value)
        except InputError as error:
            if error.code != "wrong-file-type":
                raise
            raise InputError(
                error.message, code=error.code, place=error.place, remedy=_CALLS
            ) from None
        return read_project(value) if "mechanism" in content else read_mechanism(value)
    if isinstance(value, Mechanism | Project | InitialProject):
        return value
    if isinstance(value, FitResult | SavedResult):
        return value.mechanism
    words = (
        "no mechanism is given" if value is None else f"a {type(value).__name__} is no mechanism"
    )
    raise InputError(words, code="invalid-value", remedy=_CALLS)


def stated(mechanism: Any, data: Any, units: Units) -> Stated:
    """Mechanism, readings and options from values, or from the files that paths name.

    Raises InputError for what cannot be read, and for readings whose unit is implausible.
    """
    machine = described(mechanism)
    if isinstance(machine, InitialProject):
        dataset = machine.dataset if data is None else readings(data, machine.mechanism, units)
        return Stated(
            machine.mechanism, dataset, {"noise": machine.noise}, {"inputs": machine.inputs}
        )
    if isinstance(machine, Project):
        return _of_project(machine, data, units)
    if data is None:
        raise InputError(
            "no readings are given",
            code="no-data",
            remedy="give a DataFrame, a dict of arrays, a Dataset, or the path of a file",
        )
    return Stated(machine, readings(data, machine, units))


def _of_project(project: Project, data: Any, units: Units) -> Stated:
    noise = project.noise.noise()
    if data is None:
        loaded = load_dataset(project)
        dataset, noise = loaded.dataset, loaded.noise
    elif isinstance(data, str | Path) and units is None:
        dataset = new_readings(data, project.inputs, project.mechanism, whole=True)
    else:
        dataset = readings(data, project.mechanism, units)
    settings = project.fit.settings
    options: dict[str, Any] = {"fit": settings, "start": settings.start}
    if noise.entries or not settings.method.exact:
        options["noise"] = noise
    kept = {"title": project.title, "inputs": project.inputs}
    return Stated(project.mechanism, dataset, options, kept)


def result_of(value: Any) -> Any:
    """The result of a folder, where a path of one is given, and of a fit."""
    if isinstance(value, FitResult):
        return Result.of(value)
    if isinstance(value, str | Path):
        return read_result(value)
    if hasattr(value, "mechanism"):
        return value
    raise InputError(
        f"a {type(value).__name__} is no result",
        code="invalid-value",
        remedy="give what lc.calibrate or lc.read_result returns, or the path of a folder",
    )


def fitted(value: Any) -> FitResult:
    """A result with its fit in memory; a project, or the path of one, is calibrated.

    Raises InputError for a result from a folder, which lacks the equations of the fit.
    """
    if isinstance(value, FitResult):
        return value
    if isinstance(value, Project) or Path(str(value)).suffix == ".toml":
        project = described(value)
        if isinstance(project, Project):
            return calibrated(project)
    raise InputError(
        f"{str(value)!r} holds no fit: what is computed from its equations needs it in memory",
        code="unsupported",
        remedy="give the result of calibrate, or the path of the project (project.toml)",
    )
