"""A result from the disk again: what was found, and the mechanism it was found of."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from loopcal.document.result_document import ResultDocument
from loopcal.errors import InputError, listed
from loopcal.files.machines.mechanism_file import read_mechanism
from loopcal.files.machines.python_function import Loops
from loopcal.files.result.result_file import read_result
from loopcal.mechanisms.mechanism import Mechanism


@dataclass(frozen=True, eq=False)
class ReadResult:
    """document: of result.json; mechanism: the calibrated one beside it; path: of result.json."""

    document: ResultDocument
    mechanism: Mechanism
    path: Path


def read_result_folder(
    path: str | Path, *, function: Loops | Mechanism | None = None
) -> ReadResult:
    """A folder that `loopcal calibrate` wrote, or the result.json in it.

    function: the loops of a mechanism that is written in Python. Raises InputError where
    result.json or mechanism.toml beside it are absent, cannot be read, or differ in parameters.
    """
    path = Path(path)
    if path.is_dir():
        path = path / "result.json"
    document = read_result(path)
    mechanism = read_mechanism(path.with_name("mechanism.toml"), function=function)
    names, stated = mechanism.parameters.names, {p.name for p in document.parameters}
    alone = [n for n in names if n not in stated]
    alone += [n for n in document.covariance.names if n not in names]
    if alone:
        raise InputError(
            f"result.json and mechanism.toml differ in the parameters {listed(alone)}",
            code="unknown-name",
            place=str(path.parent),
            remedy="keep the files of one calibration together, or calibrate again",
        )
    return ReadResult(document, mechanism, path)
