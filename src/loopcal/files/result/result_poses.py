"""The readings that a result was calibrated with, from the residuals.csv beside it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from loopcal.errors import InputError
from loopcal.files.result.pair import refuse_stale
from loopcal.files.result.result_file import read_result
from loopcal.files.tables.readers import Column, read_dataset
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.mechanism import Mechanism


def read_result_poses(folder: Path, mechanism: Mechanism) -> Dataset | None:
    """The poses used, SI, with the known constants of each; None where they are not there.

    Raises InputError where residuals.csv cannot be read, or is of another result.
    """
    path = folder / "residuals.csv"
    if not path.exists():
        return None
    refuse_stale(path)
    stated = mechanism.units
    columns = {name: Column(f"{name} [{unit}]") for name, unit in stated.items()}
    made = read_dataset(path, columns, pose="pose")
    # what is implied has a column, and blank cells where no instrument read it
    blank = {q for q in mechanism.implied if np.isnan(made.readings[q]).all()}
    return replace(made, readings={q: v for q, v in made.readings.items() if q not in blank})


def poses_of_result(path: str | Path, mechanism: Mechanism) -> Dataset | None:
    """The poses of a folder that `loopcal calibrate` wrote, or of the result.json in it.

    None for any other file or folder. Raises InputError where residuals.csv is absent or cannot be
    read.
    """
    path = Path(path)
    if path.name != "result.json" and not (path / "result.json").is_file():
        return None
    folder = path if path.is_dir() else path.parent
    poses = read_result_poses(folder, mechanism)
    if poses is None:
        raise without_poses(str(folder))
    measured = read_result(folder / "result.json").measured
    return replace(poses, source=replace(poses.source, days=measured))


def without_poses(place: str) -> InputError:
    """The error for a result without its readings."""
    return InputError(
        "the result has no residuals.csv, which holds its readings",
        code="missing-file",
        place=place,
        remedy="give the file of readings",
    )
