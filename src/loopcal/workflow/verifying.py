"""A calibration on the disk checked against readings of another day."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from loopcal.errors import InputError
from loopcal.files.machines.python_function import load_function
from loopcal.files.project.new_readings import read_new_readings
from loopcal.files.result.result_folder import read_result_folder
from loopcal.files.result.result_poses import poses_of_result
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
    data = poses_of_result(readings, read.mechanism)
    if data is None:
        data = read_new_readings(readings, read.document.inputs, read.mechanism, whole=True)
    try:
        return verify(known, data, remounted=remounted, tolerance=tolerance)
    except InputError as error:
        raise error.at(str(readings)) from None
