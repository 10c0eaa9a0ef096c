"""The steps of the work on a folder, and how each stands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from loopcal.document.result_document import ResultDocument
from loopcal.files.project.project_folder import Entry, Listed

LIGHTS = ("none", "good", "care", "bad")
"""Not begun, done, done with something to look at, wrong."""
GRADES = {"good": "good", "weak": "care", "undetermined": "bad"}
"""The light of what a check says of the poses."""


@dataclass(frozen=True)
class Step:
    """One step; light: of `LIGHTS`; words: why."""

    key: str
    label: str
    light: str
    words: str


@dataclass(frozen=True)
class State:
    """What the lights follow from. stale: the project is newer than the result."""

    project: bool
    objection: str | None
    document: ResultDocument | None
    stale: bool
    files: Sequence[Listed]
    runs: Mapping[str, Entry]
    """The last run of each command."""


def steps(state: State) -> list[Step]:
    """All steps in their order."""
    found = [
        Step("robot", "Robot", *_made(state, "a robot")),
        Step("data", "Data", *_made(state, "readings")),
        Step("plan", "Plan", *_ran(state, "plan", "which poses to measure")),
        Step("check", "Check", *_checked(state)),
        Step("fit", "Fit", *_fit(state)),
        Step("diagnose", "Diagnose", *_diagnose(state)),
        Step("validate", "Validate", *_validate(state)),
        Step("deploy", "Deploy", *_ran(state, "export", "files for the robot")),
        Step("history", "History", *_ran(state, "history", "the machine over time")),
    ]
    return found


def _made(state: State, what: str) -> tuple[str, str]:
    if not state.project:
        return "none", f"no project yet: give {what}"
    return ("bad", state.objection) if state.objection else ("good", "stated in the project")


def _ran(state: State, command: str, what: str) -> tuple[str, str]:
    run = state.runs.get(command)
    if run is None:
        return "none", f"not asked yet: {what}"
    code = run.told.get("code")
    return ("good", "done") if code == 0 else ("bad", f"ended with code {code}")


def _checked(state: State) -> tuple[str, str]:
    light, said = _ran(state, "check", "what the poses can determine")
    run = state.runs.get("check")
    verdict = None if run is None else run.told.get("verdict")
    return (
        (light, said)
        if verdict is None
        else (GRADES[str(verdict)], f"what the poses can determine: {verdict}")
    )


def _fit(state: State) -> tuple[str, str]:
    if state.document is None or state.document.verdict is None:
        return "none", "not calibrated yet"
    if state.stale:
        return "care", "the project has changed since: fit again"
    return state.document.verdict.grade, state.document.verdict.headline


def _diagnose(state: State) -> tuple[str, str]:
    if state.document is None or state.document.verdict is None:
        return "none", "not calibrated yet"
    sound = state.document.verdict.sound
    return {True: "good", None: "care", False: "bad"}[sound.passed], sound.words


def _validate(state: State) -> tuple[str, str]:
    if state.document is None or state.document.verdict is None:
        return "none", "not calibrated yet"
    asked = [state.document.verdict.valid, state.document.verdict.better]
    worst = min(asked, key=lambda answer: {False: 0, None: 1, True: 2}[answer.passed])
    return {True: "good", None: "care", False: "bad"}[worst.passed], worst.words
