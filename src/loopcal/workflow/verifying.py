"""A calibration on the disk checked against readings of another day."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from loopcal.errors import InputError
from loopcal.files.machines.python_function import load_function
from loopcal.files.project.new_readings import read_new_readings
from loopcal.files.result.result_folder import ReadResult, read_result_folder
from loopcal.files.result.result_poses import read_result_poses
from loopcal.measurements.dataset import Dataset
from loopcal.statistics.calibrated import Calibrated
from loopcal.statistics.verification import verify
from loopcal.statistics.verified import Verification


def run_verification(
    result: str | Path,
    readings: str | Path,
    *,
    remounted: bool | Sequence[str] = False,
    tolerance: float | None = None,
    function: str | None = None,
) -> Verification:
    """Check a result against readings in the columns of its project, or those of another result.

    tolerance: [SI]; the rest as in `verify`. Raises InputError for what cannot be used.
    """
    loops = None if function is None else load_function(function)
    read = read_result_folder(result, function=loops)
    known = Calibrated.from_document(read.document, read.mechanism, None, str(result))
    data = _readings(readings, read)
    try:
        return verify(known, data, remounted=remounted, tolerance=tolerance)
    except InputError as error:
        raise error.at(str(readings)) from None


def _readings(readings: str | Path, read: ReadResult) -> Dataset:
    path = Path(readings)
    if not path.is_dir() and path.name != "result.json":
        return read_new_readings(readings, read.document.inputs, read.mechanism, whole=True)
    folder = path if path.is_dir() else path.parent
    poses = read_result_poses(folder, read.mechanism)
    if poses is None:
        raise InputError(
            "the result has no residuals.csv, which holds its readings",
            code="missing-file",
            place=str(folder),
            remedy="give the file of readings",
        )
    return poses
