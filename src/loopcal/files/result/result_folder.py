"""The calibrated mechanism beside the result.json that it was found with."""

from __future__ import annotations

from pathlib import Path

from loopcal.document.result_document import ResultDocument
from loopcal.errors import InputError, listed
from loopcal.files.machines.mechanism_file import read_mechanism
from loopcal.files.machines.python_function import Loops
from loopcal.mechanisms.mechanism import Mechanism


def read_result_mechanism(
    path: Path, document: ResultDocument, function: Loops | Mechanism | None = None
) -> Mechanism:
    """The mechanism beside a result.json with this document.

    function: the loops of a mechanism that is written in Python. Raises InputError where
    mechanism.toml is absent, cannot be read, or has other parameters than result.json.
    """
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
    return mechanism
