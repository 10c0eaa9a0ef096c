"""The readings of a project, with their noise, and what looks odd about them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError
from loopcal.files.columns import Column
from loopcal.files.dataset_readers import read_dataset
from loopcal.files.noise_entries import CovarianceColumns
from loopcal.files.place import Place
from loopcal.files.project_file import Project, expanded
from loopcal.measurements.checks import DataWarning, check_dataset
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise

Array = NDArray[np.float64]


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
            place=project.name,
            remedy='add [data] with file = "poses.csv"',
        )
    wanted: dict[str, Column] = dict(spec.columns)
    wide = [(block, _covariance_columns(i, block)) for i, block in enumerate(project.noise.columns)]
    for _, columns in wide:
        wanted |= columns
    path = expanded(spec.file, project.folder, place.at("file"))
    if project.simulation is not None and not path.exists():
        raise InputError(
            f"there is no file {str(path)!r} yet",
            place=str(place.at("file")),
            remedy=f"make it: loopcal simulate {project.path or '-'} --out {path} --seed 1",
        )
    read = read_dataset(path, wanted, **spec.options)
    dataset = replace(
        read,
        readings={q: v for q, v in read.readings.items() if q in spec.columns},
        units={q: u for q, u in read.units.items() if q in spec.columns},
        sds={q: np.fmax(v, spec.sd_at_least.get(q, 0.0)) for q, v in read.sds.items()},
    )
    covariances = {
        block.quantities: _covariance(block, np.array([read[c] for c in columns]), dataset)
        for block, columns in wide
    }
    expected = {**project.mechanism.quantities, **project.mechanism.known}
    warnings = check_dataset(dataset, expected)
    return LoadedData(dataset, project.noise.noise(covariances), warnings)


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
            f"the covariance of {', '.join(block.quantities)} is not there in {int(gaps.sum())} "
            f"poses, the first being {dataset.poses[first]!r}",
            place=dataset.place(first),
            remedy="fill the columns, or leave these poses out (data.exclude)",
        )
    try:
        Noise({block.quantities: matrices})
    except InputError as error:
        raise error.at(block.place) from None
    return matrices
