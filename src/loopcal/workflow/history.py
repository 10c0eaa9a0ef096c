"""The history of a machine: results, verifications and events are added, and it is read."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from loopcal.document.judgement import Finding
from loopcal.document.result_document import ResultDocument
from loopcal.errors import InputError
from loopcal.files.history.folder import append_entries, read_entries, refuse_no_history
from loopcal.files.result.deployed import HISTORY, note_deployed, result_path
from loopcal.life.history import History, verification_words
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.statistics.verified import Verification
from loopcal.workflow.saved_result import read_result

_ELSEWHERE = ("placement", "effect", "model error")


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

    Raises InputError for what cannot be read or written; nothing was added then.
    """
    from loopcal.report.history_page import history_html

    refuse_no_history(folder)
    page = Path(f"{str(folder).rstrip('/')}.html") if out is None else Path(out)
    read = [read_result(result) for result in add]
    added = [("calibration", calibration_entry(r.document, r.mechanism, r.path)) for r in read]
    added += [("event", _event(words)) for words in events]
    # The page is of the entries as they will be, and comes with them or not at all.
    entries = append_entries(folder, added, lambda every: {page: history_html(History(every))})
    machine_history = History(entries)
    for result in add:
        note_history(machine_history, result)
    return HistoryDone(machine_history, page)


def history(folder: str | Path) -> History:
    """The history of a machine from its folder; damaged entries are named and skipped.

    Drift rates are learnt by restricted likelihood from five calibrations on (Patterson and
    Thompson 1971). Raises InputError where there is no such folder.
    """
    return History(read_entries(folder))


def verification_entry(
    verification: Verification, result: str | Path, readings: str | Path
) -> dict[str, Any]:
    """What a history keeps of a verification."""
    answer, changes = verification.verdict["consistent"], verification.changes
    return {
        "words": verification_words(answer.code, verification.innovation.p_value),
        "findings": _against(verification.findings),
        "result": str(result),
        "readings": str(readings),
        "poses": len(verification.poses),
        "rms": None if verification.calibrated is None else verification.calibrated.rms,
        "unit": verification.unit,
        "p_value": verification.innovation.p_value,
        "changes": None if changes is None else changes.document()["found"],
    }


def _against(findings: Iterable[Finding]) -> list[dict[str, str]]:
    """The stored findings that refuse or caution about a calibration or a machine."""
    against = (one for one in findings if one.severity != "info")
    return [{"code": o.code, "severity": o.severity, "title": o.title} for o in against]


def note_history(machine_history: History, result: str | Path) -> None:
    """Keep a history beside a result in it too, for its report."""
    name = machine_history.entries.folder.name
    note_deployed(result_path(result), HISTORY, name, machine_history.document())


def _event(words: str) -> dict[str, Any]:
    if not words.strip():
        raise InputError(
            "the event has no words", code="invalid-value", remedy='say what happened: "new belt"'
        )
    return {"words": words.strip()}


def calibration_entry(document: ResultDocument, mechanism: Mechanism, path: Path) -> dict[str, Any]:
    """What a history keeps of a calibration or an update; path: of its result.json."""
    roles = mechanism.roles
    verdict = document.verdict
    distances = None if document.accuracy is None else document.accuracy.after
    return {
        "words": "not judged" if verdict is None else verdict.grade,
        "findings": _against(document.findings),
        "result": str(path),
        "readings": document.data.file,
        "readings_sha256": document.data.sha256,
        "machine": mechanism.name,
        "method": document.method,
        "poses": document.data.used,
        "rms": None if distances is None else distances.rms,
        "unit": "m" if document.accuracy is None else document.accuracy.unit,
        "parameters": {
            p.name: {"value": p.value, "sd": p.sd, "unit": p.unit, "role": roles[p.name]}
            for p in document.parameters
            if p.sd is not None and not p.fixed and roles[p.name] not in _ELSEWHERE
        },
    }
