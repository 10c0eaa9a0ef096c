"""The light of a step is true: never better than the verdict of the result that it shows."""

from __future__ import annotations

import shutil
from dataclasses import replace
from itertools import product
from pathlib import Path

import pytest

from loopcal.companions.app.pages import stand
from loopcal.companions.app.project_folder import Entry
from loopcal.companions.app.session import Session
from loopcal.companions.app.steps import LIGHTS, State
from tests.app.plain_command import command
from tests.command_line import run_here

OF_A_RESULT = ("fit", "diagnose", "validate", "deploy", "history")


def lights(state: State) -> dict[str, str]:
    return {step.key: step.light for step in stand(state)}


def ended(line: str, code: int) -> Entry:
    return Entry(
        1, "2026-01-01T00:00:00Z", "ended", "x", {"command": f"loopcal {line}", "code": code}
    )


@pytest.fixture
def state(hostile: Path) -> State:
    return Session(hostile, command).state()


def test_no_step_is_better_than_the_verdict_of_its_result(state: State) -> None:
    document = state.document
    assert document is not None
    assert document.verdict is not None
    runs = {"export": ended("export r", 0), "history": ended("history h --add r", 0)}
    for answers in product((True, None, False), repeat=3):
        named = zip(("sound", "valid", "better"), answers, strict=True)
        its = {n: replace(getattr(document.verdict, n), passed=passed) for n, passed in named}
        verdict = replace(document.verdict, **its)
        for stale, fresh in product((False, True), repeat=2):
            found = lights(
                replace(
                    state,
                    document=replace(document, verdict=verdict),
                    stale=stale,
                    deployed={"r/export/arm.urdf": fresh},
                    runs=runs,
                )
            )
            worst = max(verdict.grade, "care" if stale else "good", key=LIGHTS.index)
            for key in OF_A_RESULT:
                assert LIGHTS.index(found[key]) >= LIGHTS.index(worst), (key, answers, stale)
            if not fresh:
                assert found["deploy"] in ("care", "bad")


def test_a_preview_deploys_nothing(state: State) -> None:
    runs = {"export": ended("export r --to urdf --force --out .preview/urdf", 0)}
    assert lights(replace(state, runs=runs, deployed={}))["deploy"] == "none"


def test_a_result_without_a_verdict_is_not_good(state: State) -> None:
    assert state.document is not None
    unjudged = replace(state, document=replace(state.document, verdict=None))
    found = lights(replace(unjudged, deployed={"r/export/arm.urdf": True}))
    assert found["fit"] == found["deploy"] == "care"


@pytest.mark.parametrize("line", ["export project-result --to json", "record project-result"])
def test_what_was_made_of_an_earlier_result_is_known_as_such(
    hostile: Path, tmp_path: Path, line: str
) -> None:
    folder = tmp_path / "arm"
    shutil.copytree(hostile, folder)
    session = Session(folder, command)
    preview = "export project-result --to json --force --out .preview/json"
    assert run_here(*preview.split(), cwd=folder).returncode == 0
    assert session.deployed() == {}
    assert run_here(*line.split(), cwd=folder).returncode == 0
    made = session.deployed()
    assert made
    assert all(made.values())
    # another export of this result, elsewhere or only looked at, changes nothing
    for other in (preview, "export project-result --to json --out elsewhere"):
        assert run_here(*other.split(), cwd=folder).returncode == 0
        assert session.deployed() == made
    result = folder / "project-result" / "result.json"
    result.write_text(result.read_text("utf-8").replace('"schema"', ' "schema"', 1), "utf-8")
    assert session.deployed() == dict.fromkeys(made, False)
    force = ["--force"] if line.startswith("export") else []
    assert run_here(*line.split(), *force, cwd=folder).returncode == 0
    assert session.deployed() == made
    for name in made:
        (folder / name).write_text("changed by hand", "utf-8")
    assert session.deployed() == dict.fromkeys(made, False)
