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
from loopcal.estimation.result import Result
from loopcal.files.machines.mechanism_file import read_mechanism
from loopcal.files.project.new_readings import read_new_readings
from loopcal.files.project.project_data import load_dataset
from loopcal.files.project.project_file import Project, read_project
from loopcal.files.result.result_poses import poses_of_result
from loopcal.files.tables.readers import column_labels, read_dataset, read_once
from loopcal.files.toml.reader import read_toml
from loopcal.measurements.checks import refuse_implausible
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.tables import column_names
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parameters import matching
from loopcal.workflow.beginning.initial import InitialProject
from loopcal.workflow.calibration import calibrated
from loopcal.workflow.saved_result import SavedResult, read_result

Units = Mapping[str, str] | None
POSE = "pose"
"""The column of pose ids of a table or file that no project describes."""


@dataclass(frozen=True, eq=False)
class Stated:
    """A mechanism, its readings, and the options and title that a project states."""

    mechanism: Mechanism
    data: Dataset
    options: Mapping[str, Any] = field(default_factory=dict)
    title: str | None = None


def described(value: Any) -> Any:
    """A mechanism or a project, where a path of one is given."""
    if isinstance(value, str | Path):
        content = read_toml(value)
        return read_project(value) if "mechanism" in content else read_mechanism(value)
    if isinstance(value, Mechanism | Project | InitialProject):
        return value
    raise InputError(
        f"a {type(value).__name__} is no mechanism",
        code="invalid-value",
        remedy="give a Mechanism, a Project, or the path of a project or mechanism file",
    )


def stated(mechanism: Any, data: Any, units: Units) -> Stated:
    """Mechanism, readings and options from values, or from the files that paths name.

    Raises InputError for what cannot be read, and for readings whose unit is implausible.
    """
    machine = described(mechanism)
    if isinstance(machine, InitialProject):
        dataset = machine.dataset if data is None else readings(data, machine.mechanism, units)
        return Stated(machine.mechanism, dataset, {"noise": machine.noise})
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
        dataset = read_new_readings(data, project.inputs, project.mechanism, whole=True)
    else:
        dataset = readings(data, project.mechanism, units)
    settings = project.fit.settings
    options: dict[str, Any] = {"fit": settings, "start": settings.start}
    if noise.entries or not settings.method.exact:
        options["noise"] = noise
    return Stated(project.mechanism, dataset, options, project.title)


def readings(data: Any, mechanism: Mechanism, units: Units = None) -> Dataset:
    """A dataset of a table or a file, in the units stated or else in SI.

    A column "pose" holds ids. Columns of a file that the mechanism does not know are left out.
    Raises InputError where SI is implausible, with the likely unit.
    """
    if isinstance(data, Dataset):
        if units:
            raise InputError(
                "units are given for a Dataset, whose values are SI already",
                code="conflicting-keys",
                remedy="remove units, or give them to Dataset.from_arrays",
            )
        return data
    units_of = {**mechanism.quantities, **mechanism.pose_constants}
    from_file = isinstance(data, str | Path)
    source = read_once(data) if from_file else data
    names = column_labels(source) if from_file else column_names(data)
    stated_units = {
        name: unit for key, unit in (units or {}).items() for name in matching(key, names, "column")
    }
    # A machine may have a quantity of this name.
    pose = POSE if POSE in names and POSE not in units_of else None
    if from_file:
        named = {q: q for q in units_of if q in names} or None
        dataset = read_dataset(source, named, pose=pose, units=stated_units)
    else:
        dataset = Dataset.from_arrays(data, units=stated_units, poses=pose)
    # A stated unit is believed; SI is only assumed.
    refuse_implausible(dataset, {q: u for q, u in units_of.items() if q not in stated_units})
    return dataset


def result_of(value: Any) -> Any:
    """The result of a folder, where a path of one is given."""
    return read_result(value) if isinstance(value, str | Path) else value


def fitted(value: Any) -> Any:
    """A result with its fit in memory; a project, or the path of one, is calibrated.

    Raises InputError for a result from a folder, which lacks the equations of the fit.
    """
    if isinstance(value, Result):
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


def later_readings(result: Any, data: Any, units: Units, *, whole: bool) -> Any:
    """Further readings for a result; a path is read in the columns of its project.

    whole: with the outputs. A folder of a result stands for the readings it was calibrated with.
    """
    if isinstance(data, Result | Dataset):
        return data
    mechanism: Mechanism = result.mechanism
    if isinstance(data, SavedResult):
        data = data.path
    if not isinstance(data, str | Path):
        return readings(data, mechanism, units)
    poses = poses_of_result(data, mechanism)
    if poses is not None:
        return poses
    inputs = result.document.inputs if isinstance(result, Result | SavedResult) else {}
    if units is None:
        return read_new_readings(data, inputs, mechanism, whole=whole)
    return readings(data, mechanism, units)
