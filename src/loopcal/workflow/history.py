"""The history of a machine: results, verifications and events are added, and it is read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from loopcal.document.result_document import ResultDocument
from loopcal.errors import InputError
from loopcal.files.atomic import write_atomic
from loopcal.files.history.folder import Entry, append_entry, read_entries
from loopcal.files.result.deployed import HISTORY, note_deployed, result_path
from loopcal.files.result.result_folder import ReadResult, read_result_folder
from loopcal.life.history import History, verification_words
from loopcal.statistics.verified import Verification


@dataclass(frozen=True, eq=False)
class HistoryDone:
    """A history that was read, and the page that shows it."""

    history: History
    page: Path


def run_history(
    folder: str | Path,
    *,
    add: Sequence[str | Path] = (),
    events: Sequence[str] = (),
    out: str | Path | None = None,
) -> HistoryDone:
    """Add results and events to a history, and write its page, by default FOLDER.html.

    Raises InputError for what cannot be read or written.
    """
    from loopcal.report.history_page import history_html

    for result in add:
        add_result(folder, result)
    for words in events:
        add_event(folder, words)
    found = history(folder)
    page = Path(f"{str(folder).rstrip('/')}.html") if out is None else Path(out)
    write_atomic(page, history_html(found))
    return HistoryDone(found, page)


def history(folder: str | Path) -> History:
    """The history of a machine from its folder; damaged entries are named and skipped.

    Drift rates are learnt by restricted likelihood from five calibrations on (Patterson and
    Thompson 1971). Raises InputError where there is no such folder.
    """
    return History(read_entries(folder))


def add_result(folder: str | Path, result: str | Path) -> Entry:
    """Add a calibration or an update to a history."""
    entry = append_entry(folder, "calibration", _calibration(read_result_folder(result)))
    return _noted(entry, folder, result)


def add_verification(
    folder: str | Path, found: Verification, result: str | Path, readings: str | Path
) -> Entry:
    """Add a verification to a history."""
    answer, changes = found.verdict["consistent"], found.changes
    content = {
        "words": verification_words(answer.code, found.innovation.p_value),
        "result": str(result),
        "readings": str(readings),
        "poses": len(found.poses),
        "rms": None if found.calibrated is None else found.calibrated.rms,
        "unit": found.unit,
        "p_value": found.innovation.p_value,
        "changes": None if changes is None else changes.document()["found"],
    }
    return _noted(append_entry(folder, "verification", content), folder, result)


def _noted(entry: Entry, folder: str | Path, result: str | Path) -> Entry:
    """Keep the history beside the result too, for its report."""
    told = history(folder).document()
    note_deployed(result_path(result), HISTORY, Path(folder).name, told)
    return entry


def add_event(folder: str | Path, words: str) -> Entry:
    """Add an event to a history, such as a collision. Raises InputError for an empty text."""
    if not words.strip():
        raise InputError(
            "the event has no words", code="invalid-value", remedy='say what happened: "new belt"'
        )
    return append_entry(folder, "event", {"words": words.strip()})


def _calibration(read: ReadResult) -> dict[str, object]:
    document: ResultDocument = read.document
    kinds = read.mechanism.kinds
    verdict = document.verdict
    distances = None if document.accuracy is None else document.accuracy.after
    return {
        "words": "not judged" if verdict is None else verdict.grade,
        "result": str(read.path),
        "readings": document.data.file,
        "readings_sha256": document.data.sha256,
        "machine": read.mechanism.name,
        "method": document.method,
        "poses": document.data.used,
        "rms": None if distances is None else distances.rms,
        "unit": "m" if document.accuracy is None else document.accuracy.unit,
        "parameters": {
            p.name: {"value": p.value, "sd": p.sd, "unit": p.unit, "kind": kinds[p.name]}
            for p in document.parameters
            if p.sd is not None and not p.fixed and kinds[p.name] not in ("placement", "effect")
        },
    }
