"""The history of a machine: results, verifications and events are added, and it is read."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from loopcal.companions.life.history import History, verification_words
from loopcal.companions.life.history_folder import append_entries, read_entries, refuse_no_history
from loopcal.companions.life.joint_entry import Joint
from loopcal.document.result_document import ResultDocument
from loopcal.document.verdict import Finding
from loopcal.errors import InputError
from loopcal.files.atomic import Data
from loopcal.files.result.deployed import HISTORY, note_deployed, result_path
from loopcal.measurements.days import Days
from loopcal.statistics.calibrated import Calibrated
from loopcal.statistics.verified import Verification
from loopcal.workflow.keeping import Writer
from loopcal.workflow.saved_result import read_result

_ELSEWHERE = ("placement", "effect", "model error")


@dataclass(frozen=True, eq=False)
class HistoryDone:
    """A history that was read, and the page that shows it."""

    history: History
    page: Path


@dataclass(frozen=True)
class HistoryKeeper:
    """Keeps calibrations and verifications as entries of the history in this folder.

    stated: days of the measurement, in place of what readings and project say.
    """

    folder: str | Path
    stated: Days | None = None

    def refuse(self) -> None:
        """Raise InputError, before any work, where the path is no folder."""
        refuse_no_history(self.folder)

    def of_calibration(
        self, document: ResultDocument, calibrated: Calibrated, path: Path
    ) -> Writer:
        """Writes the files of a calibration with its entry; path: of its result.json."""
        days = self.stated or document.measured
        content = calibration_entry(document, calibrated, path)
        return self._writer("calibration", {**content, **_measured(days)})

    def of_verification(
        self,
        verification: Verification,
        result: str | Path,
        readings: str | Path,
        measured: Days | None,
    ) -> Writer:
        """Writes the files of a verification with its entry."""
        content = verification_entry(verification, result, readings)
        return self._writer("verification", {**content, **_measured(self.stated or measured)})

    def note(self, result: str | Path) -> None:
        """Keep the history beside a result in it too, for its report."""
        note_history(history(self.folder), result)

    def _writer(self, kind: str, content: Mapping[str, Any]) -> Writer:
        return partial(_write_with, self.folder, (kind, content))


def _write_with(
    folder: str | Path,
    entry: tuple[str, Mapping[str, Any]],
    files: Mapping[Path, Data],
    *,
    remove: Iterable[Path] = (),
) -> None:
    append_entries(folder, [entry], lambda _: files, remove=remove)


def run_history(
    folder: str | Path,
    *,
    add: Sequence[str | Path] = (),
    events: Sequence[str] = (),
    stated: Days | None = None,
    out: str | Path | None = None,
) -> HistoryDone:
    """Add results and events to a history, and write its page, by default FOLDER.html.

    stated: the days of what is added, in place of what readings and project say.

    Raises InputError for what cannot be read or written; nothing was added then.
    """
    from loopcal.companions.life.pages import history_html

    refuse_no_history(folder)
    page = Path(f"{str(folder).rstrip('/')}.html") if out is None else Path(out)
    read = [read_result(result) for result in add]
    added = [
        (
            "calibration",
            calibration_entry(r.document, r.calibrated, r.path)
            | _measured(stated or r.document.measured),
        )
        for r in read
    ]
    added += [("event", {**_event(words), **_measured(stated)}) for words in events]
    # The page is of the entries as they will be, and comes with them or not at all.
    entries = append_entries(folder, added, lambda every: {page: history_html(History(every))})
    machine_history = History(entries)
    for result in add:
        note_history(machine_history, result)
    return HistoryDone(machine_history, page)


def history(folder: str | Path) -> History:
    """The history of a machine from its folder; damaged entries are named and skipped.

    Steps and drift are sought over the days of measurement (`loopcal.History`). Raises InputError
    where there is no such folder.
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


def _measured(days: Days | None) -> dict[str, Any]:
    return {"measured": None if days is None else asdict(days)}


def _event(words: str) -> dict[str, Any]:
    if not words.strip():
        raise InputError(
            "the event has no words", code="invalid-value", remedy='say what happened: "new belt"'
        )
    return {"words": words.strip()}


def calibration_entry(
    document: ResultDocument, calibrated: Calibrated, path: Path
) -> dict[str, Any]:
    """What a history keeps of a calibration or an update; path: of its result.json."""
    machine = calibrated.mechanism.parameters
    kept = [
        p
        for p in document.parameters
        if p.sd is not None and not p.fixed and machine[p.name].role not in _ELSEWHERE
    ]
    verdict = document.verdict
    distances = None if document.accuracy is None else document.accuracy.after
    return {
        "words": "not judged" if verdict is None else verdict.grade,
        "findings": _against(document.findings),
        "result": str(path),
        "readings": document.data.file,
        "readings_sha256": document.data.sha256,
        "machine": calibrated.mechanism.name,
        "method": document.method,
        "model": [document.method_label, *(term.name for term in document.terms)],
        "poses": document.data.used,
        "rms": None if distances is None else distances.rms,
        "unit": "m" if document.accuracy is None else document.accuracy.unit,
        "parameters": {
            p.name: {
                "value": p.value,
                "sd": p.sd,
                "unit": p.unit,
                "role": machine[p.name].role,
                "owner": machine[p.name].owner,
            }
            for p in kept
        },
        "joint": Joint.of(calibrated, [p.name for p in kept]).content,
    }
