"""What pages on one folder share: commands, their order in the log, and whose code is run."""

from __future__ import annotations

import shutil
import threading
from pathlib import Path

import pytest

from analyses.app_robustness import finished, killed, made
from loopcal.cli.registry import with_loops
from loopcal.companions.app.pages import stand
from loopcal.companions.app.project_folder import Entry
from loopcal.companions.app.session import Session
from loopcal.companions.app.steps import State
from loopcal.companions.app.worker import Action
from loopcal.errors import InputError
from loopcal.files.outputs import INSIDE
from tests.app.plain_command import command
from tests.command_line import run

pytest.importorskip("tomlkit", reason="tomlkit is absent; `pip install .[app]` installs it")

EXAMPLES = Path(__file__).parents[2] / "examples"
LOOPS = """
import shutil
import threading
from pathlib import Path
Path(__file__).with_name("was-run").touch()
def loops(x, p):
    return [x["wire"] - p["l1"]]
"""
PROJECT = """
schema = 1
[mechanism]
type = "function"
quantities = { phi1 = "rad", wire = "m" }
outputs = ["wire"]
[parameters]
l1 = { value = 400, unit = "mm" }
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "loops.py").write_text(LOOPS)
    (tmp_path / "project.toml").write_text(PROJECT)
    return tmp_path


def test_python_of_the_folder_is_never_run(folder: Path) -> None:
    session = Session(folder, command)
    assert session.project() is None
    assert "--mechanism" in (session.objection() or "")
    assert session.state().objection is not None
    assert not (folder / "was-run").exists()
    project = (folder / "project.toml").read_text()
    for stated in ("loops.py:loops", "loops.py"):
        text = project.replace('type = "function"', f'type = "function"\nfunction = "{stated}"')
        with pytest.raises(InputError):
            session.read(text)
        text = project.replace('type = "function"', f'file = "{stated}"')
        with pytest.raises(InputError):
            session.read(text)
    assert not (folder / "was-run").exists()


def test_loops_named_on_the_command_line_serve_every_command(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    session = Session(folder, command, "loops.py:loops", with_loops())
    assert session.objection() is None
    named = ("--mechanism", f"{folder / 'loops.py'}:loops")
    assert session.action("fit", ("calibrate", "project.toml")).words[2:] == named
    assert session.action("see", ("history",)).words == ("history",)


def test_a_project_for_others_names_no_file_outside(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = Session(folder, command)  # before: what it starts would keep the variable
    outside = folder.parent / "arm.toml"
    text = f'schema = 1\n[mechanism]\nfile = "{outside.as_posix()}"\n'
    outside.write_text('schema = 1\ntype = "secret"\n')
    monkeypatch.setenv(INSIDE, str(folder))
    for name in (outside.as_posix(), "../arm.toml", "${HOME}/arm.toml", "link.toml"):
        (folder / "link.toml").unlink(missing_ok=True)
        (folder / "link.toml").symlink_to(outside)
        with pytest.raises(InputError, match="leads out of the folder") as caught:
            session.read(text.replace(outside.as_posix(), name))
        assert "secret" not in str(caught.value)
    monkeypatch.delenv(INSIDE)
    with pytest.raises(InputError, match="secret"):
        session.read(text)


def test_a_project_that_init_made_beside_the_readings_is_that_of_the_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("arm.urdf", "poses.csv"):
        shutil.copy(EXAMPLES / "slipped_reflector" / name, tmp_path)
    assert run("init", "poses.csv", "--urdf", "arm.urdf", cwd=tmp_path).returncode == 0
    session = Session(tmp_path, command)
    monkeypatch.setenv(INSIDE, str(tmp_path))
    project = session.folder.project
    assert session.folder.named(project) == "calibration/project.toml"
    assert session.folder.named(session.folder.result) == "calibration/project-result"
    loaded = session.readings()
    assert session.objection() is None
    assert loaded is not None
    before = session.read_by("calibrate")
    poses = tmp_path / "poses.csv"
    poses.write_text("\n".join(poses.read_text().splitlines()[:-1]) + "\n")
    assert session.read_by("calibrate") != before  # the readings count
    assert "calibration/project.toml" in {file.name for file in session.folder.listed()}
    shutil.copytree(tmp_path / "calibration", tmp_path / "another")
    assert session.folder.project == tmp_path / "project.toml"  # of two it cannot know which


def test_the_log_has_the_beginning_and_the_end_of_a_run_in_their_order(tmp_path: Path) -> None:
    session = Session(tmp_path, command)
    for words in (("print", "a"), ("fail",)):
        session.start(Action("do", words))
        finished(session)
    kinds = [entry.kind for entry in session.folder.log().entries]
    assert kinds == ["begun", "ended", "begun", "ended"]
    assert session.folder.log().unfinished() is None
    assert session.finished == 2


def test_an_act_is_fitted_at_once_and_the_last_result_stays(hostile: Path, tmp_path: Path) -> None:
    shutil.copytree(hostile, tmp_path / "arm")
    session = Session(tmp_path / "arm", command)
    source = session.source()
    assert source is not None
    before = (session.folder.result / "result.json").read_bytes()
    session.excluded(source.table.poses[:3], "bad reading")
    for _ in range(1200):
        if not session.refits.going:
            break
        threading.Event().wait(0.05)
    found = session.refit()
    assert found is not None
    assert found.table.poses == source.table.poses[3:]
    shown = found.shown_in(source.document)
    assert shown.verdict is None  # nothing is judged yet
    assert shown.validation is None
    assert (session.folder.result / "result.json").read_bytes() == before
    session.folder.undo()
    assert session.refit() is None  # the result is of this project again
    with pytest.raises(InputError, match="all poses are selected"):
        session.excluded(source.table.poses, "bad reading")


@pytest.mark.parametrize("seed", [1, 2])
def test_a_kill_loses_nothing_that_was_confirmed(tmp_path: Path, seed: int) -> None:
    """Of the server (even seeds) or of the run; `python -m analyses.app_robustness` kills 30."""
    found = killed(made(tmp_path / "arm"), seed)
    assert found.wrong == []
    assert found.edited >= 1


def test_a_fault_in_an_act_is_shown_in_a_sentence_and_logged(
    folder: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    view_module = pytest.importorskip("loopcal.companions.app.view", reason="NiceGUI is absent")
    said: list[str] = []
    monkeypatch.setattr(view_module, "_tell", said.append)
    view = view_module.View(Session(folder, command))
    assert not view.act(lambda: 1 / 0)
    assert said == [
        "Nothing was done: ZeroDivisionError: division by zero. "
        "This is a fault of loopcal; please report it."
    ]
    assert "ZeroDivisionError" in caplog.text


def test_the_light_of_a_check_is_what_it_says_of_the_poses() -> None:
    for verdict, light in (("good", "good"), ("weak", "care"), ("undetermined", "bad")):
        told = {"command": "loopcal check project.toml --json", "code": 0, "verdict": verdict}
        run = Entry(1, "2026-01-01T00:00:00Z", "ended", "Check", told)
        state = State(True, None, None, stale=False, deployed={}, runs={"check": run})
        step = next(one for one in stand(state) if one.key == "check")
        assert step.light == light
        assert verdict in step.words
