"""Two results on the disk, compared."""

from __future__ import annotations

from pathlib import Path

from loopcal.errors import InputError
from loopcal.files.machines.python_function import Loops, load_function
from loopcal.files.project.new_readings import read_new_readings
from loopcal.files.result.result_folder import read_result_folder
from loopcal.files.result.result_poses import read_result_poses
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.statistics.calibrated import Calibrated
from loopcal.statistics.compared import Compared
from loopcal.statistics.comparison import compare


def run_comparison(
    a: str | Path,
    b: str | Path,
    *,
    poses: str | Path | None = None,
    align: bool = True,
    function: str | None = None,
) -> Compared:
    """Compare the results of two folders that `loopcal calibrate` wrote.

    poses: a file of readings at which the machines are compared, in the columns of A's project,
    else those of both; align and the rest as in `compare`. Raises InputError for what cannot be
    used.
    """
    loops = None if function is None else load_function(function)
    first, second = (_read(path, loops) for path in (a, b))
    at = None
    if poses is not None:
        document = read_result_folder(a, function=loops).document
        at = read_new_readings(poses, document.inputs, first.mechanism)
    try:
        return compare(first, second, poses=at, align=align)
    except InputError as error:
        raise error.at(f"{first.name}, {second.name}") from None


def _read(path: str | Path, loops: Loops | Mechanism | None) -> Calibrated:
    read = read_result_folder(path, function=loops)
    poses = read_result_poses(read.path.parent, read.mechanism)
    return Calibrated.from_document(read.document, read.mechanism, poses, str(path))
