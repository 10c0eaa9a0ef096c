"""What a project says of its validation: which poses take no part in a fit."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from loopcal.errors import InputError
from loopcal.files.paths import expanded
from loopcal.files.tables.columns import Column
from loopcal.files.tables.readers import read_dataset
from loopcal.files.toml.place import Place

if TYPE_CHECKING:
    from loopcal.files.project.fit_schema import ValidationEntry
    from loopcal.files.project.project_data import LoadedData
    from loopcal.files.project.project_file import Project


@dataclass(frozen=True)
class ValidationSpec:
    """One of folds, hold_out and file is stated; group: the column of numbers that name groups."""

    folds: int | None = None
    hold_out: float | None = None
    file: str | None = None
    seed: int = 0
    group: str | int | None = None


def validation_spec(entry: ValidationEntry | None, place: Place) -> ValidationSpec | None:
    """The validation asked for.

    Raises InputError unless exactly one way is stated.
    """
    if entry is None:
        return None
    stated = [k for k in ("folds", "hold_out", "file") if getattr(entry, k) is not None]
    if len(stated) != 1:
        raise InputError(
            f"the validation states {' and '.join(stated) or 'no way to leave poses out'}",
            place=str(place),
            remedy='give one of folds = 10, hold_out = 0.3 and file = "other.csv"',
        )
    return ValidationSpec(**entry.model_dump())


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
    from loopcal.files.project.project_data import load_dataset

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
