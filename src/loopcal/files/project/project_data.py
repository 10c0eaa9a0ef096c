"""The readings of a project, with their noise, and what looks odd about them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, replace
from pathlib import Path
from shlex import quote
from typing import Any

import numpy as np

from loopcal.arrays import Array
from loopcal.errors import InputError, listed, placed
from loopcal.files.outputs import expanded
from loopcal.files.project.data_table import (
    DataColumn,
    DataTable,
    FileTable,
    data_files,
    refuse_unread,
)
from loopcal.files.project.fit_table import Validation
from loopcal.files.project.noise_table import CovarianceColumns, noises
from loopcal.files.project.parts import believed, of_another_day, one_below_another, read_part
from loopcal.files.project.project_file import Project
from loopcal.files.tables.readers import Column, column_labels, read_dataset, read_once
from loopcal.files.tables.registry import reader_of
from loopcal.files.toml.place import Place
from loopcal.measurements.checks import DataWarning, check_dataset, refuse_implausible
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.outputs import measured_points
from loopcal.mechanisms.parallel.free_body import POSITION


@dataclass(frozen=True, eq=False)
class LoadedData:
    """The readings of a project.

    noise: what the project says of the sensors, with the covariances that came with the
    readings; warnings: what is odd about the readings but does not stop the work.
    """

    dataset: Dataset
    noise: Noise
    warnings: tuple[DataWarning, ...]


def load_dataset(project: Project) -> LoadedData:
    """Read the data file of a project.

    Raises InputError where there is none, where it cannot be read as the project says, and
    where the readings cannot be in the units stated.
    """
    spec, place = project.data, Place(project.name).at("data")
    if spec is None:
        raise InputError(
            "the project names no readings",
            code="missing-key",
            place=project.name,
            remedy='add [data] with file = "poses.csv"',
        )
    read, join_warnings = _read(project, spec, place, columns_aside(project))
    loaded = loaded_from(project, read)
    units = project.mechanism.units
    read_as_0 = project.mechanism.implied.keys() & loaded.dataset.readings.keys()
    silent = [q for q in read_as_0 if not np.nan_to_num(loaded.dataset.readings[q]).any()]
    points = measured_points(project.mechanism)
    odd = check_dataset(loaded.dataset, units, trusted=silent, points=points)
    return replace(loaded, warnings=(*join_warnings, *odd))


def columns_aside(project: Project) -> dict[str, Column]:
    """The columns of covariances, under names that no quantity can have."""
    return {
        name: column
        for i, block in enumerate(project.noise.columns)
        for name, column in _covariance_columns(i, block).items()
    }


def loaded_from(project: Project, read: Dataset) -> LoadedData:
    """The readings of a project out of its columns, read with those aside; nothing is checked."""
    units = project.mechanism.units
    dataset = replace(
        read,
        readings={q: v for q, v in read.readings.items() if q in units},
        units={q: u for q, u in read.units.items() if q in units},
    )
    covariances = {
        block.quantities: _covariance(
            block, np.array([read[c] for c in _covariance_columns(i, block)]), dataset
        )
        for i, block in enumerate(project.noise.columns)
    }
    return LoadedData(dataset, project.noise.noise(covariances), ())


def _read(
    project: Project, spec: DataTable, place: Place, aside: Mapping[str, Column]
) -> tuple[Dataset, tuple[DataWarning, ...]]:
    """The readings of all files, with columns read aside where a file has them."""
    path = expanded(spec.parts[0].file, project.folder, place.at("file"))
    if project.simulation is not None and not path.exists():
        named = quote(str(project.path or "-"))
        command = f"loopcal simulate {named} --out {quote(str(path))} --seed 1"
        raise InputError(
            f"there is no file {str(path)!r} yet",
            code="missing-file",
            place=str(place.at("file")),
            remedy=f"create it: {command}",
        ).then(command)
    if spec.apart:
        paths = [
            expanded(part.file, project.folder, place.at("file", i, "file"))
            for i, part in enumerate(spec.parts)
        ]
        files = list(zip(paths, spec.parts, strict=True))
        dataset = one_below_another(spec, files, project.mechanism, aside)
        read = {q for q, values in dataset.readings.items() if np.isfinite(values).any()}
        refuse_unread(read, project.mechanism, project.noise, place.at("columns"))
        return dataset.thin(spec.every).exclude(spec.exclude), ()
    if not spec.join:
        try:
            return believed(spec, read_dataset(path, {**spec.columns, **aside}, **spec.options)), ()
        except InputError as error:
            if error.code == "missing-column":
                _refuse_unnamed(project, spec, path, place)
            raise
    parts = [read_part(spec, spec, path, project.mechanism, aside)]
    for i, other in enumerate(spec.join):
        path = expanded(other.file, project.folder, place.at("join", i, "file"))
        parts.append(read_part(spec, other, path, project.mechanism, aside))
    instruments = {q for f in project.mechanism.families if f.form != "closure" for q in f.readings}
    machine_quantities = set(project.mechanism.quantities) - instruments
    from loopcal.measurements.joining import join

    joined = join(parts, [not machine_quantities.isdisjoint(part.readings) for part in parts])
    refuse_unread(
        set(joined.dataset.readings), project.mechanism, project.noise, place.at("columns")
    )
    dataset = joined.dataset.thin(spec.every).exclude(spec.exclude)
    return dataset, tuple(_left_out(name, ids) for name, ids in joined.left_out)


def _refuse_unnamed(project: Project, spec: FileTable, path: Path, place: Place) -> None:
    """InputError for a quantity without a column of the same name or a stated one."""
    labels = column_labels(path, **spec.keywords)
    read = {*project.inputs["data"].get("columns", ()), *labels}
    refuse_unread(read, project.mechanism, project.noise, place.at("columns"), labels)


def _left_out(name: str, poses: Sequence[str]) -> DataWarning:
    first = ", ".join(poses[:5]) + (", ..." if len(poses) > 5 else "")
    are = "pose is" if len(poses) == 1 else "poses are"
    return DataWarning(
        None, f"{name}: {len(poses)} {are} not in the other files and left out ({first})"
    )


def _covariance_columns(number: int, block: CovarianceColumns) -> dict[str, Column]:
    """Columns to be read beside the quantities, under names that no quantity can have."""
    return {f" covariance {number} {column}": Column(column) for column in block.columns}


def _covariance(block: CovarianceColumns, values: Array, dataset: Dataset) -> Array:
    """(N, b, b) [SI squared]; any will do for what was not read."""
    missing = np.isnan([dataset[q] for q in block.quantities]).T
    # The unit matrix for gaps: any positive definite one passes, and none is used.
    either = missing[:, :, None] | missing[:, None, :]
    matrices = np.where(either, np.eye(missing.shape[1]), block.matrices(values))
    gaps = np.isnan(matrices).any(axis=(1, 2))
    if gaps.any():
        first = int(np.argmax(gaps))
        raise InputError(
            f"the covariance of {', '.join(block.quantities)} is missing in {int(gaps.sum())} "
            f"poses, first in {dataset.poses[first]!r}",
            code="missing-reading",
            place=dataset.place(first),
            remedy="fill the columns, or exclude these poses (data.exclude)",
        )
    with placed(block.place):
        Noise({block.quantities: matrices})
    return matrices


# The readings that a project's validation needs: other files, and the column of groups.


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
    if project.data.apart:
        path = expanded(file, project.folder, Place(project.name).at("fit", "validation", "file"))
        return loaded_from(project, of_another_day(project.data, [path], project.mechanism, ()))
    columns = {q: c for part in project.data.parts for q, c in part.columns.items()}
    other = replace(project.data, file=file, columns=columns, exclude=(), every=1, join=())
    return load_dataset(replace(project, data=other))


def _groups(project: Project, column: str | int, poses: Sequence[str]) -> tuple[float, ...]:
    """The group of each pose: equal numbers in a column of the project's file.

    Of several joined files the first that has the column; its groups follow the ids of the poses.
    Files with poses of their own have groups of their own.
    """
    spec = project.data
    assert spec is not None
    place = Place(project.name).at("data")
    asked = {"group": Column(column)}
    if isinstance(spec.file, str) and not spec.join:
        path = expanded(spec.file, project.folder, place.at("file"))
        return tuple(read_dataset(path, asked, **spec.options)["group"].tolist())
    groups: dict[str, float] = {}
    for part in spec.parts:
        path = expanded(part.file, project.folder, place.at("file"))
        source = read_once(path, **part.keywords)
        if not (isinstance(column, int) or column in column_labels(source)):
            continue
        read = read_dataset(source, asked, pose=part.pose or spec.pose, **part.keywords)
        values, ids = read["group"].tolist(), read.poses
        if spec.apart:
            # Numbers of groups differ between files; their size means nothing.
            offset = 1.0 + max((abs(v) for v in groups.values() if v == v), default=0.0)
            values = [offset + v - np.nanmin(values) for v in values]
            ids = tuple(f"{path.stem}:{pose}" for pose in ids)
        groups |= dict(zip(ids, values, strict=True))
        if not spec.apart:
            break
    if groups:
        return tuple(groups.get(pose, math.nan) for pose in poses)
    raise InputError(
        f"no file of readings has the column {column!r}",
        code="missing-column",
        place=str(Place(project.name).at("fit", "validation", "group")),
        remedy="name a column of numbers in one of the files",
    )


# Readings to predict from: written as those were that a result was calibrated with.


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
    units = mechanism.units
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
    # A later file may be of another kind, which takes other options: text has no sheets.
    without: dict[str, Any] = dict.fromkeys({*spec.keywords} - {*reader_of(paths[0]).options})
    spec = replace(spec, **without)
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
    turned = [quantity for of in mechanism.orientations for quantity in of.columns]
    for quantity, column in columns.items():
        if quantity in mechanism.pose_constants and _absent(column.column, labels):
            if quantity in turned:
                names = ",".join(str(columns[q].column) for q in turned)
                raise InputError(
                    f"there is no column {column.column!r} of the orientation, which the "
                    "calibration measured",
                    code="missing-column",
                    place=str(paths[0]),
                    remedy="measure the orientation too, or calibrate by the points of both days: "
                    f"loopcal init with --leave-out {names}",
                )
            raise InputError(
                f"there is no column {column.column!r}, and the calibration learnt what "
                f"{quantity} does",
                code="missing-column",
                place=str(paths[0]),
                remedy=f"add the column with {quantity} at each pose of this file",
            )
    pose_column = spec.pose if spec.pose in labels or isinstance(spec.pose, int) else None
    dataset = read_dataset(source, columns, pose=pose_column, **spec.keywords)
    if spec.source is not None:  # a file of the user's may call its columns alike
        own = columns.keys() - dataset.source.trusted
        refuse_implausible(dataset, {q: units[q] for q in own})
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
    """Whether a file has a column of the project for each joint, or for the position of a body
    without joints; whole: and for some output."""
    spec = _spec(inputs, mechanism)
    outputs = [q for part in spec.parts for q in part.columns if q in mechanism.outputs]
    return _has_columns(path, spec, {*(mechanism.joints or POSITION)}) and (
        not whole or any(_has_columns(path, spec, {q}) for q in outputs)
    )


def _is_converted(paths: Sequence[Any], spec: DataTable, wanted: Set[str]) -> bool:
    """Whether a file has the columns that the project reads, and so not those of its source."""
    assert spec.source is not None
    read = spec.source.columns.keys() & wanted
    if len(paths) != 1 or _has_columns(paths[0], spec, read):
        return len(paths) == 1
    source = {q: DataColumn(c.column) for q, c in spec.source.columns.items()}
    of_source = replace(spec, columns=source, join=())
    as_source = _has_columns(paths[0], of_source, read)
    return not as_source and _has_columns(paths[0], spec, read, with_units=True)


def _has_columns(
    path: Any, spec: DataTable, quantities: Set[str], *, with_units: bool = False
) -> bool:
    """Whether a file has the columns in which the project reads these quantities, in those of their
    names where it states none; with_units: or columns of these names that state a unit."""
    if not isinstance(path, str | Path):
        return False
    try:
        labels = column_labels(read_once(path, **spec.keywords))
    except InputError:  # of a table below titles, which only its source describes
        return False
    columns = {q: c.column for part in spec.parts for q, c in part.columns.items()}
    wanted = {columns.get(q, q) for q in quantities}.difference(labels)
    if not wanted or not with_units:
        return not wanted
    from loopcal.files.recognition.headers import heading

    stated = {one.stem for one in map(heading, labels) if one.unit}
    return all(heading(str(column)).stem in stated for column in wanted)


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
