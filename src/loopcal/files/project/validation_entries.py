"""The readings that a project's validation needs: other files, and the column of groups."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from loopcal.errors import InputError
from loopcal.files.outputs import expanded
from loopcal.files.project.fit_table import Validation
from loopcal.files.project.project_data import LoadedData, load_dataset
from loopcal.files.project.project_file import Project
from loopcal.files.tables.columns import Column
from loopcal.files.tables.readers import column_labels, read_dataset, read_once
from loopcal.files.toml.place import Place


def validation_arguments(
    project: Project, asked: Validation, poses: Sequence[str]
) -> dict[str, Any]:
    """What `validate` needs of a validation: the choice, other readings and groups, read.

    poses: ids of the poses that are validated, in their order.

    Raises InputError where a file cannot be read.
    """
    arguments: dict[str, Any] = {
        "folds": asked.folds or 0,
        "blocks": asked.blocks,
        "hold_out": asked.hold_out,
    }
    if asked.file is not None:
        other = _other(project, asked.file)
        arguments |= {"other": other.dataset, "other_noise": other.noise}
    if asked.group is not None:
        arguments["groups"] = _groups(project, asked.group, poses)
        # Groups alone are stations or sessions, each with a placement of the instrument.
        arguments["place_anew"] = not any((asked.folds, asked.hold_out, asked.file))
    return {**arguments, "seed": asked.seed}


def _other(project: Project, file: str) -> LoadedData:
    """The readings of another file, in the columns and units of the project's own."""
    assert project.data is not None
    columns = {q: c for part in project.data.parts for q, c in part.columns.items()}
    other = replace(project.data, file=file, columns=columns, exclude=(), every=1, join=())
    return load_dataset(replace(project, data=other))


def _groups(project: Project, column: str | int, poses: Sequence[str]) -> tuple[float, ...]:
    """The group of each pose: equal numbers in a column of the project's file.

    Of several files the first that has the column; its groups follow the ids of the poses.
    """
    spec = project.data
    assert spec is not None
    place = Place(project.name).at("data")
    asked = {"group": Column(column)}
    if not spec.join:
        path = expanded(spec.file, project.folder, place.at("file"))
        return tuple(read_dataset(path, asked, **spec.options)["group"].tolist())
    for part in spec.parts:
        path = expanded(part.file, project.folder, place.at("file"))
        source = read_once(path, **part.keywords)
        if isinstance(column, int) or column in column_labels(source):
            read = read_dataset(source, asked, pose=part.pose, **part.keywords)
            groups = dict(zip(read.poses, read["group"].tolist(), strict=True))
            return tuple(groups.get(pose, math.nan) for pose in poses)
    raise InputError(
        f"no file of readings has the column {column!r}",
        code="missing-column",
        place=str(Place(project.name).at("fit", "validation", "group")),
        remedy="name a column of numbers in one of the files",
    )
