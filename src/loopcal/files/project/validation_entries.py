"""The readings that a project's validation needs: other files, and the column of groups."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from loopcal.files.paths import expanded
from loopcal.files.project.fit_entries import ValidationSpec
from loopcal.files.project.project_data import LoadedData, load_dataset
from loopcal.files.project.project_file import Project
from loopcal.files.tables.columns import Column
from loopcal.files.tables.readers import read_dataset
from loopcal.files.toml.place import Place


def validation_arguments(project: Project, asked: ValidationSpec) -> dict[str, Any]:
    """What `validate` needs of a validation: the choice, other readings and groups, read.

    Raises InputError where a file cannot be read.
    """
    found: dict[str, Any] = {"folds": asked.folds or 0, "hold_out": asked.hold_out}
    if asked.file is not None:
        other = _other(project, asked.file)
        found |= {"other": other.dataset, "other_noise": other.noise}
    if asked.group is not None:
        found["groups"] = _groups(project, asked.group)
    return {**found, "seed": asked.seed}


def _other(project: Project, file: str) -> LoadedData:
    """The readings of another file, in the columns and units of the project's own."""
    assert project.data is not None
    options = {**project.data.options, "exclude": [], "every": 1}
    columns = {
        q: c for part in (project.data, *project.data.joins) for q, c in part.columns.items()
    }
    other = replace(project.data, file=file, columns=columns, options=options, joins=())
    return load_dataset(replace(project, data=other))


def _groups(project: Project, column: str | int) -> tuple[float, ...]:
    """The group of each pose: equal numbers in a column of the project's file."""
    assert project.data is not None
    place = Place(project.name).at("data").at("file")
    path = expanded(project.data.file, project.folder, place)
    read = read_dataset(path, {"group": Column(column)}, **project.data.options)
    return tuple(read["group"].tolist())
