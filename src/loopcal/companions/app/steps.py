"""How each step of the work on a folder stands: the lights of its pages."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from loopcal.companions.app.project_folder import Entry
from loopcal.document.result_document import ResultDocument

LIGHTS = ("none", "good", "care", "bad")
"""Not begun, done, done with something to look at, wrong."""
GRADES = {"good": "good", "weak": "care", "undetermined": "bad"}
"""The light of what a check says of the poses."""
FILE_FAULTS = ("column-fault", "rows-copied", "readings-coarse")
"""Findings that speak of the file of readings."""


@dataclass(frozen=True)
class State:
    """What the lights follow from. stale: the project is newer than the result."""

    project: bool
    objection: str | None
    document: ResultDocument | None
    stale: bool
    deployed: Mapping[str, bool]
    """Files for the robot and the record: whether each is of the result."""
    runs: Mapping[str, Entry]
    """The last run of each command."""
    outdated: frozenset[str] = frozenset()
    """Commands whose last run read other files than there are now."""
    measured: bool = True
    """Whether the project states readings."""
    unread: str = ""
    """Why the readings cannot be read."""
    waiting: tuple[str, ...] = ()
    """Files of readings handed in that the project does not read."""
    warned: tuple[str, ...] = ()
    """What looks odd about the readings."""
    unreadable: str = ""
    """Why the result on the disk cannot be read."""
    made_elsewhere: frozenset[str] = frozenset()
    """Commands that did not run here, whose files are there."""


Light = Callable[[State], tuple[str, str]]
"""The light of a step, of `LIGHTS`, and why."""


def never_better(stands: tuple[str, str], state: State) -> tuple[str, str]:
    """How a step stands that has begun: never better than the verdict on the result, and never
    good where the project has changed since."""
    if stands[0] == "none":
        return stands
    return max(stands, fit(state), key=lambda one: LIGHTS.index(one[0]))


def made(what: str) -> Light:
    """Of a step that gives the project a part."""

    def lit(state: State) -> tuple[str, str]:
        if not state.project:
            return "none", f"no project yet: give {what}"
        if state.objection:  # the step shows the remedy below
            return "bad", state.objection.partition("\n")[0]
        return "good", "stated in the project"

    return lit


def ran(command: str, what: str) -> Light:
    """Of a step that runs a command."""

    def lit(state: State) -> tuple[str, str]:
        run = state.runs.get(command)
        if run is None:
            elsewhere = command in state.made_elsewhere
            return "none", "made elsewhere, shown below" if elsewhere else f"not asked yet: {what}"
        code = run.record.get("code")
        if code != 0:
            return "bad", f"ended with code {code}"
        if command in state.outdated:
            return "care", "its inputs have changed since: run it again"
        return "good", "done"

    return lit


def data(state: State) -> tuple[str, str]:
    """Whether the readings are read, all of them, and nothing about them looks odd."""
    light, said = made("readings")(state)
    if light != "good":
        return light, said
    if not state.measured:
        return "none", "no readings yet"
    if state.unread:
        return "bad", state.unread
    if state.waiting:
        return "care", f"handed in but not read by the project: {', '.join(state.waiting)}"
    document = state.document
    faults = () if document is None or state.stale else document.findings
    for finding in faults:
        if finding.place.files or finding.code in FILE_FAULTS:
            return {"no": "bad", "open": "care", "yes": "good"}[finding.mark], finding.title
    return ("care", state.warned[0]) if state.warned else ("good", "read by the project")


def checked(state: State) -> tuple[str, str]:
    """What the last check says of the poses."""
    light, said = ran("check", "what the poses can determine")(state)
    run = state.runs.get("check")
    verdict = None if run is None else run.record.get("verdict")
    if verdict is None or light != "good":
        return light, said
    return GRADES[str(verdict)], f"what the poses can determine: {verdict}"


def uncalibrated(state: State) -> tuple[str, str]:
    """Of a step that shows the result, where there is none."""
    if state.unreadable:
        return "bad", "the result cannot be read"
    return "none", "not calibrated yet"


def fit(state: State) -> tuple[str, str]:
    """The verdict on the result."""
    if state.document is None:
        return uncalibrated(state)
    verdict = state.document.verdict
    if verdict is None:
        return "care", "the result states no verdict: fit again"
    if state.stale and verdict.grade != "bad":
        return "care", "the project has changed since: fit again"
    return verdict.grade, verdict.headline


def deploy(state: State) -> tuple[str, str]:
    """Whether the files for the robot are of the result."""
    run = state.runs.get("export")
    if run is not None and run.record.get("code") not in (0, None):
        return ran("export", "files for the robot")(state)
    old = [name for name, of_result in state.deployed.items() if not of_result]
    if old:
        return "care", f"of an earlier result, or changed since: {', '.join(old)}"
    return ("good", "done") if state.deployed else ("none", "not asked yet: files for the robot")


def diagnose(state: State) -> tuple[str, str]:
    """Whether the result is sound."""
    if state.document is None or state.document.verdict is None:
        return uncalibrated(state)
    sound = state.document.verdict.sound
    return {True: "good", None: "care", False: "bad"}[sound.passed], sound.words


def validate(state: State) -> tuple[str, str]:
    """Whether the result is valid and better than the drawing."""
    if state.document is None or state.document.verdict is None:
        return uncalibrated(state)
    asked = [state.document.verdict.valid, state.document.verdict.better]
    worst = min(asked, key=lambda answer: {False: 0, None: 1, True: 2}[answer.passed])
    return {True: "good", None: "care", False: "bad"}[worst.passed], worst.words
