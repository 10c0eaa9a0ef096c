"""The readings of a project, with their noise, and what looks odd about them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError
from loopcal.files.paths import expanded
from loopcal.files.project.data_entries import DataSpec, implied_by, named_columns, refuse_unread
from loopcal.files.project.noise_entries import CovarianceColumns
from loopcal.files.project.project_file import Project
from loopcal.files.tables.columns import Column
from loopcal.files.tables.readers import column_labels, read_dataset, read_poses
from loopcal.files.toml.place import Place
from loopcal.measurements.checks import DataWarning, check_dataset
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise
from loopcal.mechanisms.outputs import measured_points

Array = NDArray[np.float64]
LEFT_OUT = ("exclude", "every")


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
    read, told = _read(project, spec, place, columns_aside(project))
    loaded = loaded_from(project, read)
    own = {**project.mechanism.quantities, **project.mechanism.known}
    odd = check_dataset(loaded.dataset, own, points=measured_points(project.mechanism))
    return replace(loaded, warnings=(*told, *odd))


def columns_aside(project: Project) -> dict[str, Column]:
    """The columns of covariances, under names that no quantity can have."""
    return {
        name: column
        for i, block in enumerate(project.noise.columns)
        for name, column in _covariance_columns(i, block).items()
    }


def loaded_from(project: Project, read: Dataset) -> LoadedData:
    """The readings of a project out of its columns, read with those aside; nothing is checked."""
    own = {**project.mechanism.quantities, **project.mechanism.known}
    dataset = replace(
        read,
        readings={q: v for q, v in read.readings.items() if q in own},
        units={q: u for q, u in read.units.items() if q in own},
    )
    covariances = {
        block.quantities: _covariance(
            block, np.array([read[c] for c in _covariance_columns(i, block)]), dataset
        )
        for i, block in enumerate(project.noise.columns)
    }
    return LoadedData(dataset, project.noise.noise(covariances), ())


def _read(
    project: Project, spec: DataSpec, place: Place, aside: Mapping[str, Column]
) -> tuple[Dataset, tuple[DataWarning, ...]]:
    """The readings of all files, with columns read aside where a file has them."""
    path = expanded(spec.file, project.folder, place.at("file"))
    if project.simulation is not None and not path.exists():
        raise InputError(
            f"there is no file {str(path)!r} yet",
            code="missing-file",
            place=str(place.at("file")),
            remedy=f"create it: loopcal simulate {project.path or '-'} --out {path} --seed 1",
        )
    if not spec.joins:
        try:
            return believed(spec, read_dataset(path, {**spec.columns, **aside}, **spec.options)), ()
        except InputError as error:
            if error.code == "missing-column":
                _refuse_unnamed(project, spec, path, place)
            raise
    parts = [_part(project, spec, path, aside)]
    for i, other in enumerate(spec.joins):
        where = place.at("join", i, "file")
        part = _part(project, other, expanded(other.file, project.folder, where), aside)
        implied = [q for n in other.instruments for q in implied_by(project.mechanism, n)]
        zeros = {q: np.full(len(part), project.mechanism.implied[q]) for q in implied}
        parts.append(part.with_readings(zeros))
    instruments = {q for f in project.mechanism.families if f.form != "closure" for q in f.readings}
    its_own = set(project.mechanism.quantities) - instruments
    from loopcal.measurements.joining import join

    joined = join(parts, [not its_own.isdisjoint(part.readings) for part in parts])
    refuse_unread(
        set(joined.dataset.readings), project.mechanism, project.noise, place.at("columns")
    )
    dataset = joined.dataset.thin(spec.options["every"]).exclude(spec.options["exclude"])
    return dataset, tuple(_left_out(name, ids) for name, ids in joined.left_out)


def _refuse_unnamed(project: Project, spec: DataSpec, path: Path, place: Place) -> None:
    """InputError for a quantity that has no column of its own name, and none that is stated."""
    how = {key: spec.options[key] for key in spec.options if key not in ("pose", *LEFT_OUT)}
    there = column_labels(path, **how)
    read = {*project.inputs["data"].get("columns", ()), *there}
    refuse_unread(read, project.mechanism, project.noise, place.at("columns"), there)


def _part(project: Project, spec: DataSpec, path: Path, aside: Mapping[str, Column]) -> Dataset:
    """One of several files."""
    how = {key: spec.options[key] for key in spec.options if key not in ("pose", *LEFT_OUT)}
    there = column_labels(path, **how)
    assert project.data is not None
    stated = {q for part in (project.data, *project.data.joins) for q in part.columns}
    spec = named_columns(spec, there, project.mechanism, stated)
    pose = spec.options["pose"]
    if pose is None:
        raise InputError(
            "joining several files needs pose ids",
            code="mismatched-poses",
            place=str(path),
            remedy='name the column of the ids: pose = "..."; or state pose = 0 for each file, '
            "to join them row by row",
        )
    columns = {**spec.columns, **{k: c for k, c in aside.items() if c.column in there}}
    if not columns and not spec.instruments:
        raise InputError(
            "no column of this file is a quantity of the mechanism",
            code="missing-column",
            place=str(path),
            remedy="name its columns: columns = { x = ... }",
        )
    if not columns:  # ids alone: the poses in which an instrument without readings was used
        return read_poses(path, pose, **how)
    return believed(spec, read_dataset(path, columns, pose=pose, **how))


def believed(spec: DataSpec, read: Dataset) -> Dataset:
    """The readings with sds no smaller than the project believes."""
    sds = {q: np.fmax(v, spec.sd_at_least.get(q, 0.0)) for q, v in read.sds.items()}
    return replace(read, sds=sds)


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
    try:
        Noise({block.quantities: matrices})
    except InputError as error:
        raise error.at(block.place) from None
    return matrices
