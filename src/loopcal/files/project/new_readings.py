"""Readings to predict from: written as those were that a result was calibrated with."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence, Set
from dataclasses import replace
from pathlib import Path
from typing import Any

from loopcal.errors import InputError, listed
from loopcal.files.project.data_table import DataColumn, DataTable, data_files
from loopcal.files.project.noise_table import noises
from loopcal.files.project.parts import of_another_day
from loopcal.files.tables.columns import Column
from loopcal.files.tables.readers import column_labels, read_dataset, read_once
from loopcal.files.toml.place import Place
from loopcal.measurements.checks import refuse_implausible
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.mechanism import Mechanism


def read_new_readings(
    path: str | Path | Sequence[Any],
    inputs: Mapping[str, Any],
    mechanism: Mechanism,
    *,
    whole: bool = False,
) -> Dataset:
    """Readings of what predicts the outputs, SI, under the columns and units of a project.

    path: a file in the columns of the project, or files or tables in the layout that its
    [data.source] states; inputs: the project as result.json holds it; without one, columns are
    named as quantities, in SI; whole: read the outputs too. The pose ids and sds of readings are
    read where the file has their columns. Raises InputError as `read_dataset` does.
    """
    spec = _spec(inputs, mechanism)
    units = {**mechanism.quantities, **mechanism.pose_constants}
    needless = set() if whole else {*mechanism.outputs, *mechanism.predicting().unused}
    paths = (path,) if isinstance(path, str | Path) else tuple(path)
    if spec.apart:
        return of_another_day(spec, [Path(one) for one in paths], mechanism, needless)
    if spec.source is not None and not _is_converted(paths, spec, units.keys() - needless):
        from loopcal.files.recognition.converting import converted, source_fields

        return converted(source_fields(paths, spec.source), spec.source, units.keys() - needless)
    if len(paths) > 1:
        raise InputError(
            f"{len(paths)} files are named, and the calibration is of one",
            code="conflicting-keys",
            remedy="name one file with all columns of the project",
        )
    source = read_once(paths[0], **spec.keywords)
    labels = column_labels(source)
    parts = [spec.columns_of(part, labels, mechanism) for part in spec.parts]
    columns = {
        quantity: _without_absent_sd(_as_headed(column, labels), labels)
        for part in parts
        for quantity, column in part.columns.items()
        if quantity not in needless
        # readings without the constant that dates the last change are of the machine as it is now
        and not (quantity in mechanism.latest and _absent(column.column, labels))
    }
    gone = [c.column for c in columns.values() if _absent(c.column, labels)]
    if gone and len(spec.parts) > 1:
        first = listed([Path(part.file).name for part in spec.parts])
        raise InputError(
            f"there is no column {gone[0]!r}",
            code="missing-column",
            place=str(paths[0]),
            remedy=f"name all files of the day: the calibration was of {first}",
        )
    for quantity, column in columns.items():
        if quantity in mechanism.pose_constants and _absent(column.column, labels):
            raise InputError(
                f"there is no column {column.column!r}, and the calibration learnt what "
                f"{quantity} does",
                code="missing-column",
                place=str(paths[0]),
                remedy=f"add the column with {quantity} at each pose of this file",
            )
    pose_column = spec.pose if spec.pose in labels or isinstance(spec.pose, int) else None
    dataset = read_dataset(source, columns, pose=pose_column, **spec.keywords)
    for quantity in [q for q, column in columns.items() if column.unit is None]:
        try:
            refuse_implausible(dataset, {quantity: units[quantity]})
        except InputError as error:
            if "mechanism" in inputs:
                raise
            raise InputError(
                error.message,
                code=error.code,
                place=error.place,
                remedy="the result does not know the units of this file: give units="
                f'{{"{quantity}": ...}} in Python, or calibrate again from readings with units',
            ) from None
    return dataset


def reads(path: Any, inputs: Mapping[str, Any], mechanism: Mechanism, *, whole: bool) -> bool:
    """Whether a file has a column of the project for each joint; whole: and for some output."""
    spec = _spec(inputs, mechanism)
    outputs = [q for part in spec.parts for q in part.columns if q in mechanism.outputs]
    return _has_columns(path, spec, {*mechanism.joints}) and (
        not whole or any(_has_columns(path, spec, {q}) for q in outputs)
    )


def _is_converted(paths: Sequence[Any], spec: DataTable, wanted: Set[str]) -> bool:
    """Whether a file has the columns that the project reads, and so not those of its source."""
    assert spec.source is not None
    return len(paths) == 1 and _has_columns(paths[0], spec, spec.source.columns.keys() & wanted)


def _has_columns(path: Any, spec: DataTable, quantities: Set[str]) -> bool:
    """Whether a file has the columns in which the project reads these quantities."""
    if not isinstance(path, str | Path):
        return False
    try:
        labels = column_labels(read_once(path, **spec.keywords))
    except InputError:  # of a table below titles, which only its source describes
        return False
    columns = {q: c.column for part in spec.parts for q, c in part.columns.items()}
    return {columns[q] for q in quantities if q in columns} <= {*labels}


def _spec(inputs: Mapping[str, Any], mechanism: Mechanism) -> DataTable:
    if "data" not in inputs:
        names = [*mechanism.quantities, *mechanism.pose_constants]
        columns = {q: DataColumn(q) for q in names if q not in mechanism.latest}
        return DataTable("", pose="pose", columns=columns)
    from loopcal.files.project.names import scope_of
    from loopcal.files.project.project_schema import ProjectTables
    from loopcal.files.toml.tables import read_tables

    kept = {key: _infinite(inputs[key]) for key in ("data", "noise") if key in inputs}
    place = Place("result.json").at("inputs")
    # The constants that date the last change may have no column, like implied quantities.
    undated = replace(mechanism, implied={**mechanism.implied, **mechanism.latest})
    tables = read_tables(ProjectTables, {"schema": 1, **kept}, place)
    noise = noises(tables.made("noise"), undated, place.at("noise"))
    data = tables.made("data", scope_of(undated))
    read = data_files(data, undated, noise, place.at("data"))
    assert read is not None
    return read


def result_columns(inputs: Mapping[str, Any], mechanism: Mechanism) -> dict[str, Column]:
    """Quantity -> its column and unit in the user's files, or else in the project of a result."""
    spec = _spec(inputs, mechanism)
    joints = {} if spec.source is None else spec.source.columns
    columns = {q: column for part in spec.parts for q, column in part.columns.items()}
    return {**columns, **{q: Column(one.column, one.unit) for q, one in joints.items()}}


def computed_joints(inputs: Mapping[str, Any]) -> tuple[str, ...]:
    """Joints that the project of a result computes from the user's columns, each with how."""
    columns = ((inputs.get("data") or {}).get("source") or {}).get("columns") or {}
    stated = {joint: str(one["column"]) for joint, one in columns.items()}
    return tuple(
        f"{joint} as {text}"
        for joint, text in stated.items()
        if text.startswith("-") or "+" in text or "*" in text
    )


def result_pose_column(inputs: Mapping[str, Any], mechanism: Mechanism) -> str | int:
    """The column of pose ids in the project of a result; "pose" without one."""
    return _spec(inputs, mechanism).pose or "pose"


def _absent(column: str | int | None, labels: tuple[str, ...]) -> bool:
    return isinstance(column, str) and column not in labels


def _without_absent_sd(column: Column, labels: tuple[str, ...]) -> Column:
    if _absent(column.sd_column, labels):
        return replace(column, sd_column=None, sd_unit=None, coverage=None)
    return column


def _as_headed(column: Column, labels: tuple[str, ...]) -> Column:
    """The column under the one header that spells its name otherwise, in the unit stated there."""
    if not _absent(column.column, labels):
        return column
    from loopcal.files.recognition.headers import heading

    name = heading(str(column.column)).stem
    alike = [one for one in map(heading, labels) if one.stem == name]
    if len(alike) != 1:
        return column
    return replace(column, column=alike[0].text, unit=alike[0].unit or column.unit)


def _infinite(value: Any) -> Any:
    """Plain data with the text "inf", which stands for infinity in result.json, as a number."""
    if isinstance(value, Mapping):
        return {key: _infinite(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [_infinite(inner) for inner in value]
    return math.inf if value == "inf" else value
