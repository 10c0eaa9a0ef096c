"""The readings that a result was calibrated with, from the residuals.csv beside it."""

from __future__ import annotations

from pathlib import Path

from loopcal.files.columns import Column
from loopcal.files.dataset_readers import read_dataset
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.mechanism import Mechanism


def read_result_poses(folder: Path, mechanism: Mechanism) -> Dataset | None:
    """The poses used, SI; None where they are not there, or known constants that go with them.

    Raises InputError where residuals.csv cannot be read.
    """
    path = folder / "residuals.csv"
    if mechanism.known or not path.exists():
        return None
    columns = {q: Column(f"{q} [{unit}]") for q, unit in mechanism.quantities.items()}
    return read_dataset(path, columns, pose="pose")
