"""A calibration on the disk updated by readings of another day."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from loopcal.companions.life import updating
from loopcal.companions.life.drift import Since
from loopcal.companions.life.history_files import HistoryKeeper
from loopcal.companions.life.history_files import history as read_history
from loopcal.companions.life.history_folder import is_history
from loopcal.companions.life.updating import updated
from loopcal.document.result_document import WrittenResult
from loopcal.errors import InputError, UsageError
from loopcal.files.outputs import refuse_foreign
from loopcal.files.result.result_file import NAMES
from loopcal.files.result.result_poses import poses_of_result
from loopcal.statistics.replacing import freed, mounted
from loopcal.statistics.verdict import refuses
from loopcal.workflow.public import on_result
from loopcal.workflow.readings import Files, first_of, new_readings
from loopcal.workflow.result import Result, save_result
from loopcal.workflow.saved_result import read_result


@dataclass(frozen=True, eq=False)
class UpdateDone:
    """An update that was written.

    drift: the sds [SI] that were allowed, by kind or name; objection: why it must not be used, None
    where it can.
    """

    result: Result
    written: WrittenResult
    drift: Mapping[str, float]
    objection: str | None


@dataclass(frozen=True)
class Mounted:
    """What has moved since: the instruments, everything mounted on the machine, or these names."""

    moved: bool = True
    remounted: bool = False
    anew: Sequence[str] = ()


def run_update(
    result: str | Path,
    readings: Files,
    *,
    out: str | Path | None = None,
    mounting: Mounted = Mounted(),
    drift: Mapping[str, float] = {},
    history: HistoryKeeper | None = None,
    report: bool = False,
    function: str | None = None,
) -> UpdateDone:
    """Update the result of a folder by readings in the columns of its project, and write it.

    out: the folder to write to, by default RESULT-updated; drift: as in `update`, by default the
    rates of the history, where it knows them; history: to which the result is added; the rest as
    in `update`.
    Raises InputError for what cannot be used.
    """
    if history is not None:
        history.refuse()
    usual = {} if drift or history is None else _usual(history.folder)
    read = read_result(result, mechanism=function)
    folder = read.path.parent
    held = {p.name for p in read.mechanism.parameters if p.fixed}
    allowed = {**drift} | {name: sd for name, sd in usual.items() if name not in held}
    target = Path(f"{folder}-updated") if out is None else Path(out)
    # Another spelling of a path is the same folder.
    if target.resolve() == folder.resolve():
        raise UsageError(
            "the update would replace the calibration that it begins from",
            code="conflicting-keys",
            remedy="write it to another folder (--out)",
        )
    refuse_foreign(*(target / name for name in (*NAMES, "report.html")))
    anew = (*mounted(read.mechanism, mounting.remounted), *mounting.anew)
    freed(read.mechanism, anew)  # raises for a name that is not there
    first, inputs = first_of(readings), _undated(read.inputs)
    data = poses_of_result(first, read.mechanism)
    if data is None:
        inputs = _with_file(inputs, first)
        data = new_readings(readings, read.inputs, read.mechanism, whole=True)
    try:
        done = updated(read.calibrated, data, Since(mounting.moved, anew, allowed), None)
    except InputError as error:
        raise error.at(str(first)) from None
    title = read.document.title
    updated_result = Result.of(done.result)
    # What mixes two machines is in the history of neither.
    keeper = None if done.mixed else history
    written = save_result(
        updated_result, target, title=title, inputs=inputs, report=report, keeper=keeper
    )
    verdict = written.document.verdict
    assert verdict is not None
    objection = done.mixed
    if objection is None and refuses("sound", verdict.sound):
        objection = verdict.sound.words
    elif objection and history:
        objection += " It is not in the history."
    return UpdateDone(updated_result, written, allowed, objection)


def _usual(folder: str | Path) -> dict[str, float]:
    """What a history knows of the drift since its last calibration."""
    return read_history(folder).drift() if is_history(folder) else {}


def _undated(inputs: Mapping[str, Any]) -> Mapping[str, Any]:
    """The project's entries without the day of its measurement, which was another one."""
    if "record" not in inputs:
        return inputs
    return {**inputs, "record": {k: v for k, v in inputs["record"].items() if k != "date"}}


def _with_file(inputs: Mapping[str, Any], readings: str | Path) -> Mapping[str, Any]:
    """The project's entries with the file that was read; several stay, as a layout."""
    if not isinstance(inputs.get("data", {}).get("file"), str):
        return inputs
    return {**inputs, "data": {**inputs["data"], "file": str(readings)}}


update: Callable[..., Result] = on_result(updating.update, "calibrated", whole=True)
