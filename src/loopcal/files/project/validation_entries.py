"""The readings that a project's validation needs: other files, and the column of groups."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from loopcal.errors import InputError
from loopcal.files.paths import expanded
from loopcal.files.project.fit_entries import ValidationSpec
from loopcal.files.project.project_data import LEFT_OUT, LoadedData, load_dataset
from loopcal.files.project.project_file import Project
from loopcal.files.tables.columns import Column
from loopcal.files.tables.readers import column_labels, read_dataset
from loopcal.files.toml.place import Place


def validation_arguments(
    project: Project, asked: ValidationSpec, poses: Sequence[str]
) -> dict[str, Any]:
    """What `validate` needs of a validation: the choice, other readings and groups, read.

    poses: ids of the poses that are validated, in their order.

    Raises InputError where a file cannot be read.
    """
    found: dict[str, Any] = {
        "folds": asked.folds or 0,
        "blocks": asked.blocks,
        "hold_out": asked.hold_out,
    }
    if asked.file is not None:
        other = _other(project, asked.file)
        found |= {"other": other.dataset, "other_noise": other.noise}
    if asked.group is not None:
        found["groups"] = _groups(project, asked.group, poses)
        found["place_anew"] = not any((asked.folds, asked.hold_out, asked.file))
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


def _groups(project: Project, column: str | int, poses: Sequence[str]) -> tuple[float, ...]:
    """The group of each pose: equal numbers in a column of the project's file.

    Of several files the first that has the column; its groups follow the ids of the poses.
    """
    spec = project.data
    assert spec is not None
    place = Place(project.name).at("data")
    asked = {"group": Column(column)}
    if not spec.joins:
        path = expanded(spec.file, project.folder, place.at("file"))
        return tuple(read_dataset(path, asked, **spec.options)["group"].tolist())
    for part in (spec, *spec.joins):
        path = expanded(part.file, project.folder, place.at("file"))
        how = {k: v for k, v in part.options.items() if k not in ("pose", *LEFT_OUT)}
        if isinstance(column, int) or column in column_labels(path, **how):
            read = read_dataset(path, asked, pose=part.options["pose"], **how)
            groups = dict(zip(read.poses, read["group"].tolist(), strict=True))
            return tuple(groups.get(pose, math.nan) for pose in poses)
    raise InputError(
        f"no file of readings has the column {column!r}",
        code="missing-column",
        place=str(Place(project.name).at("fit", "validation", "group")),
        remedy="name a column of numbers in one of the files",
    )
