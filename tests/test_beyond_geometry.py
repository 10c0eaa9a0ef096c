"""A project with effects and models to compare, from the command line to every written file."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from loopcal.errors import InputError
from loopcal.files.mechanism_file import read_mechanism
from loopcal.files.project_file import read_project
from loopcal.files.result_file import read_result
from loopcal.workflow import run_calibration, run_prediction, run_simulation
from tests.command_line import run

EXAMPLES = Path(__file__).parents[1] / "examples"
PROJECT = """\
schema = 1
title = "Beyond geometry"
[mechanism]
type = "planar-two-link"
[[mechanism.effect]]
type = "scale"
[[mechanism.effect]]
type = "drift"
changing = ["xA", "yA"]
column = "minutes"
unit = "s"
over = 60
[data]
file = "poses.csv"
pose = "pose"
[noise]
"phi*" = { sd = 0.2, unit = "mrad" }
xPyP = { sd = 0.1, unit = "mm" }
[[compare.model]]
name = "scale"
effects = ["scale"]
[[compare.model]]
name = "all"
effects = ["scale", "drift"]
[[compare.model]]
name = "drift along x"
effects = ["drift"]
fixed = ["yA_drift"]
[simulation]
poses = 60
truth = { l2 = 0.802, phi2_scale = 1e-3 }
[simulation.ranges]
phi2 = { from = -2, to = 2 }
phi3 = { from = -2, to = 2 }
minutes = { from = 0, to = 60 }
"""


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("beyond") / "project.toml"
    path.write_text(PROJECT)
    run_simulation(path, out=path.with_name("poses.csv"), seed=3)
    return path


def test_compare_calibrates_with_the_recommended_model(project: Path) -> None:
    truth = project.with_name("poses.truth.json")
    done = run("calibrate", project, "--compare", "--truth", truth, "--json")
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert [m["name"] for m in document["models"]] == ["geometric", "scale", "all", "drift along x"]
    chosen = next(m for m in document["models"] if m["recommended"])
    assert chosen["name"] == "scale"
    assert chosen["parameters"] == 8
    assert document["models"][-1]["parameters"] == 7
    assert document["models"][-1]["fixed"] == ["yA_drift"]
    assert document["validation"]["log_likelihood"] == chosen["log_likelihood"]
    parameters = {p["name"]: p for p in document["parameters"]}
    assert parameters["xA_drift"]["fixed"]
    assert parameters["xA_drift"]["value"] == 0.0
    scale = parameters["phi2_scale"]
    assert abs(scale["error"]) < 4 * scale["sd"]
    folder = project.with_name("project-result")
    assert read_result(folder / "result.json") == document
    page = (folder / "report.html").read_text("utf-8")
    assert "scale (recommended)" in page
    assert "drift along x" in page
    written = read_mechanism(folder / "mechanism.toml")
    assert written.effects == read_project(project).mechanism.effects
    readings = project.with_name("new.csv")
    readings.write_text("phi2,phi3,minutes,xP,yP\n0.1,0.2,5,0,0\n")
    run_prediction(folder, readings, out=None)


def test_the_summary_tells_the_models(project: Path) -> None:
    done = run_calibration(project, compare=True, folds=5, out=project.with_name("other"))
    told = str(done.result)
    assert "Recommended: scale" in told
    assert "5 folds of 60 poses" in told
    assert done.result.models is not None
    assert str(done.result.models) in told


def test_without_compare_all_effects_are_on(project: Path) -> None:
    done = run_calibration(project, out=project.with_name("all"))
    assert len(done.result.estimated) == 10
    assert done.written.document["models"] is None


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('effects = ["scale"]', 'effects = ["scales"]', "'scale'"),
        ('fixed = ["yA_drift"]', 'fixed = ["zA_drift"]', "zA_drift"),
        ('name = "all"', 'name = "scale"', "names two models"),
    ],
)
def test_models_that_cannot_be_are_refused(project: Path, old: str, new: str, words: str) -> None:
    path = project.with_name("wrong.toml")
    path.write_text(PROJECT.replace(old, new))
    with pytest.raises(InputError, match="compare") as refused:
        read_project(path)
    assert words in str(refused.value)


def test_a_project_without_models_says_what_to_write(project: Path) -> None:
    path = project.with_name("none.toml")
    path.write_text(PROJECT.split("[[compare")[0])
    done = run("calibrate", path, "--compare")
    assert done.returncode == 3
    assert "[[compare.model]]" in done.stderr


def test_the_workspace_of_the_measured_arm(
    shared_data: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    path = shared_data("motoman_ma1400_leica/right_arm_workspace.csv")
    monkeypatch.setenv("LOOPCAL_DATA", os.fspath(path.parents[1]))
    project = EXAMPLES / "motoman" / "right_arm_elastic.toml"
    done = run_calibration(project, compare=True, out=tmp_path)
    models = {m["name"]: m for m in done.written.document["models"]}
    assert done.written.document["data"]["excluded"] == ["13"]
    found = {name: 1e3 * m["accuracy"]["rms"] for name, m in models.items()}
    assert found == pytest.approx(
        {
            "geometric": 2.270,
            "reflector": 1.581,
            "elastic drives": 0.697,
            "elastic arm": 0.426,
            "elastic arm, gears": 0.412,
        },
        abs=0.005,
    )
    assert models["elastic arm, gears"]["recommended"]
    # the reflector sat elsewhere: millimetres in its own frame, known to a tenth of one
    value, sd = done.result.value, done.result.sd
    assert value["y6B_from86"] == pytest.approx(6.8e-3, abs=0.3e-3)
    assert all(0.0 < (sd[f"{a}6B_from14"] or 0.0) < 0.15e-3 for a in "xyz")
