"""A calibration on the disk updated by readings of another day."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from loopcal.document.result_document import ResultDocument, WrittenResult
from loopcal.errors import InputError, UsageError
from loopcal.estimation.result import Result
from loopcal.files.machines.python_function import load_function
from loopcal.files.project.new_readings import read_new_readings
from loopcal.files.result.result_folder import read_result_folder
from loopcal.files.result.result_poses import poses_of_result, read_result_poses
from loopcal.life.updating import update
from loopcal.statistics.calibrated import Calibrated
from loopcal.statistics.replacing import Freedom, mounted
from loopcal.statistics.verdict import refuses
from loopcal.units import difference_to_si
from loopcal.workflow.calibration import write_result

_DRIFT = re.compile(r"\s*([^=\s]+)\s*=\s*([-+.\deE]+)\s*([A-Za-zµ/]+)\s*")


@dataclass(frozen=True, eq=False)
class Updated:
    """An update that was written; objection: why it must not be used, None where it can."""

    result: Result
    written: WrittenResult
    objection: str | None


@dataclass(frozen=True)
class Mounted:
    """What has moved since: the instruments, everything mounted on the machine, or these names."""

    moved: bool = True
    remounted: bool = False
    anew: Sequence[str] = ()


def run_update(
    result: str | Path,
    readings: str | Path,
    *,
    out: str | Path | None = None,
    mounting: Mounted = Mounted(),
    drift: Sequence[str] = (),
    report: bool = False,
    function: str | None = None,
) -> Updated:
    """Update the result of a folder by readings in the columns of its project, and write it.

    out: the folder to write to, by default RESULT-updated; drift: "KIND=VALUE UNIT" each; the rest
    as in `update`. Raises InputError for what cannot be used.
    """
    loops = None if function is None else load_function(function)
    read = read_result_folder(result, function=loops)
    folder = read.path.parent
    poses = read_result_poses(folder, read.mechanism)
    known = Calibrated.from_document(read.document, read.mechanism, poses, str(result))
    anew = (*mounted(read.mechanism, mounting.remounted), *mounting.anew)
    Freedom.of(read.mechanism, anew)  # raises for a name that is not there
    data, inputs = poses_of_result(readings, read.mechanism), read.document.inputs
    if data is None:
        inputs = _with_file(inputs, readings)
        data = read_new_readings(readings, read.document.inputs, read.mechanism, whole=True)
    try:
        found = update(known, data, moved=mounting.moved, remounted=anew, drift=drifts(drift))
    except InputError as error:
        raise error.at(str(readings)) from None
    target = Path(f"{folder}-updated") if out is None else Path(out)
    if target.resolve() == folder.resolve():
        raise UsageError(
            "the update would replace the calibration that it begins from",
            code="conflicting-keys",
            remedy="write it to another folder (--out)",
        )
    found = found.adding(lambda document: _continued(document, read.document))
    title = read.document.title
    written = write_result(found, target, title=title, inputs=inputs, report=report)
    verdict = written.document.verdict
    assert verdict is not None
    bad = refuses("sound", verdict.sound)
    return Updated(found, written, verdict.sound.words if bad else None)


def drifts(given: Sequence[str]) -> dict[str, float]:
    """Sds [SI] by kind or name, of texts such as "length=0.01mm".

    Raises UsageError for a text that is none.
    """
    found = {}
    for text in given:
        match = _DRIFT.fullmatch(text)
        if match is None:
            raise UsageError(
                f"the drift {text!r} is no KIND=VALUE with a unit",
                code="invalid-value",
                remedy="write it as length=0.01mm or angle=20urad",
            )
        try:
            found[match[1]] = float(difference_to_si(float(match[2]), match[3]))
        except ValueError:
            raise UsageError(
                f"the drift {text!r} has no number", code="invalid-value", remedy="give a number"
            ) from None
    return found


def _continued(document: ResultDocument, before: ResultDocument) -> ResultDocument:
    """With what was learnt of the model error, which the covariance still contains."""
    return replace(document, terms=before.terms)


def _with_file(inputs: Mapping[str, Any], readings: str | Path) -> Mapping[str, Any]:
    """The project's entries with the file that was read."""
    if "data" not in inputs:
        return inputs
    return {**inputs, "data": {**inputs["data"], "file": str(readings)}}
