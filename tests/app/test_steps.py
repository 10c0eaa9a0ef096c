"""The light of a step is true: never better than the verdict of the result that it shows."""

from __future__ import annotations

import shutil
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path

import pytest

from loopcal.companions.app.pages import stand
from loopcal.companions.app.project_folder import Entry
from loopcal.companions.app.session import Session, read_robot
from loopcal.companions.app.steps import LIGHTS, State
from loopcal.errors import InputError
from tests.app.conftest import SCRIPT
from tests.app.plain_command import command
from tests.command_line import run_here


def lights(state: State) -> dict[str, str]:
    return {step.key: step.light for step in stand(state)}


def inputs(session: Session) -> dict[str, str]:
    """The lights as long as there is no result."""
    return lights(replace(session.state(), document=None))


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
    lines = ("check project.toml", "plan project.toml", "export r", "history h --add r")
    runs = {line.split()[0]: ended(line, 0) for line in lines}
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
            for key, light in found.items():
                assert light == "none" or LIGHTS.index(light) >= LIGHTS.index(worst), (
                    key,
                    answers,
                    stale,
                )
            if not fresh:
                assert found["deploy"] in ("care", "bad")


def test_a_result_that_cannot_be_read_is_wrong_and_not_absent(state: State) -> None:
    result = ("fit", "diagnose", "validate")
    absent = lights(replace(state, document=None))
    unreadable = lights(replace(state, document=None, unreadable="this is no JSON"))
    assert {absent[step] for step in result} == {"none"}
    assert {unreadable[step] for step in result} == {"bad"}


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


def noted_now(session: Session, line: str) -> None:
    """The log has a run of a command that read what there is now."""
    of = session.read_by(line.split()[0])
    session.folder.noted("ended", "x", {"command": f"loopcal {line}", "code": 0, "of": of})


def test_what_read_other_files_than_there_are_now_is_not_good(
    hostile: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "arm"
    shutil.copytree(hostile, folder)
    session = Session(folder, command)
    for line in ("check project.toml --json", "plan project.toml", "verify project-result day.csv"):
        noted_now(session, line)
    assert session.state().outdated == frozenset()
    assert inputs(session)["plan"] == "good"
    session.changed(["record", "customer"], "x", "no number follows from it")
    assert session.state().outdated == frozenset()
    session.changed(["plan", "seed"], 5, "a plan follows from it")
    assert session.state().outdated == {"plan"}
    session.excluded([session.every_pose().poses[3]], "bad")  # type: ignore[union-attr]
    assert session.state().outdated == {"check", "plan"}
    assert inputs(session)["check"] == inputs(session)["plan"] == "care"
    assert lights(session.state())["fit"] == "care"
    session.folder.undo()
    assert session.state().outdated == {"plan"}
    result = folder / "project-result" / "result.json"
    result.write_text(result.read_text("utf-8").replace('"schema"', ' "schema"', 1), "utf-8")
    assert session.state().outdated == {"plan", "verify"}


def test_readings_handed_in_are_read_or_the_step_says_that_they_are_not(
    hostile: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "arm"
    shutil.copytree(hostile, folder)
    session = Session(folder, command)
    assert inputs(session)["data"] == "good"
    content = (folder / f"{SCRIPT}.csv").read_bytes()
    session.folder.take("later.csv", content, "data")
    session.folder.take("day.csv", content, "validate")  # of another day, as verify reads it
    session.folder.take("robot.urdf", b"<robot/>", "data")
    assert session.waiting() == ("later.csv",)
    assert inputs(session)["data"] == "care"
    session.changed(["data", "file"], "later.csv", "handed in")
    assert session.waiting() == ()
    assert inputs(session)["data"] == "good"
    assert lights(session.state())["fit"] == "care"  # the result is of the other file
    session.folder.undo()
    session.left_aside("later.csv")
    assert session.waiting() == ()
    (folder / f"{SCRIPT}.csv").write_bytes(b"lost")
    assert inputs(session)["data"] == "bad"


def test_files_of_which_init_made_others_are_not_offered_again(
    hostile: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "arm"
    shutil.copytree(hostile, folder)
    session = Session(folder, command)
    for name in ("board.csv", "later one.csv"):
        session.folder.take(name, b"1", "data")
    assert session.waiting() == ("board.csv", "later one.csv")
    for code, waiting in ((3, ("board.csv", "later one.csv")), (0, ("board.csv",))):
        done = {"command": "loopcal init 'later one.csv' --out .", "code": code}
        session.folder.noted("ended", "Recognise", done)
        assert session.waiting() == waiting


@pytest.mark.parametrize(
    ("kind", "name", "content"),
    [
        ("urdf", "arm.urdf", bytes(range(256)) * 8),
        ("urdf", "arm.urdf", b"<robot name='r'><link name='a'/></robot>"),
        ("dh", "arm.csv", b"\x93\x01\x7f\n\x02,\x03"),
    ],
)
def test_a_robot_that_is_none_is_refused_and_not_kept(
    tmp_path: Path, kind: str, name: str, content: bytes
) -> None:
    session = Session(tmp_path, command)
    with pytest.raises(InputError):
        session.folder.take(name, content, "robot", partial(read_robot, kind))
    assert not (tmp_path / name).exists()
    (tmp_path / name).write_bytes(content)  # by another program
    with pytest.raises(InputError):
        session.choose_robot(kind, name)
    assert session.robot() == (None, None)
    assert not session.folder.log().entries
