"""A project with effects and models to compare, from the command line to every written file."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from loopcal.document.plain import plain
from loopcal.document.tables import model_table
from loopcal.errors import Code
from loopcal.estimation.calibrate import calibrate
from loopcal.files.machines.mechanism_file import read_mechanism
from loopcal.files.project.project_data import load_dataset
from loopcal.files.project.project_file import read_project
from loopcal.files.result.result_file import read_result
from loopcal.files.tables.readers import read_dataset
from loopcal.statistics.models import compare_models
from loopcal.statistics.outliers import find_outliers
from loopcal.workflow.calibration import Request, run_calibration
from loopcal.workflow.checking import run_prediction, run_simulation
from tests.command_line import run_here as run
from tests.refusals import refused

EXAMPLES = Path(__file__).parents[1] / "examples"
PROJECT = """\
schema = 1
fit = { method = "implicit-loop" }
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
    assert plain(read_result(folder / "result.json")) == document
    page = (folder / "report.html").read_text("utf-8")
    assert "scale (recommended)" in page
    assert "drift along x" in page
    written = read_mechanism(folder / "mechanism.toml")
    assert written.effects == read_project(project).mechanism.effects
    readings = project.with_name("new.csv")
    readings.write_text("phi2,phi3,minutes,xP,yP\n0.1,0.2,5,0,0\n")
    run_prediction(folder, readings, out=None)


def test_calibrations_with_known_constants_are_compared_at_their_poses(project: Path) -> None:
    for name in ("one", "two"):
        run_calibration(project, out=project.with_name(name))
    one, two = (project.with_name(name) for name in ("one", "two"))
    header = (one / "residuals.csv").read_text("utf-8").splitlines()[0]
    assert header.endswith("minutes [s]")
    done = run("compare", one, two)
    assert done.returncode == 0, done.stderr


def test_the_summary_tells_the_models(project: Path) -> None:
    done = run_calibration(project, Request(compare=True, folds=5), out=project.with_name("other"))
    told = str(done.written.document)
    assert "Recommended: scale" in told
    assert "5 folds of 60 poses" in told
    assert done.written.document.models is not None
    assert "\n".join(model_table(done.written.document.models, "m", "5 folds of 60 poses")) in told


def test_without_compare_all_effects_are_on(project: Path) -> None:
    done = run_calibration(project, out=project.with_name("all"))
    assert len(done.result.estimated) == 10
    assert done.written.document.models is None


@pytest.mark.parametrize(
    ("old", "new", "code", "stated"),
    [
        ('effects = ["scale"]', 'effects = ["scales"]', "unknown-name", "'scale'"),
        ('fixed = ["yA_drift"]', 'fixed = ["zA_drift"]', "unknown-name", "'zA_drift'"),
        ('name = "all"', 'name = "scale"', "duplicate-name", "'scale'"),
    ],
)
def test_models_that_cannot_be_are_refused(
    project: Path, old: str, new: str, code: Code, stated: str
) -> None:
    path = project.with_name("wrong.toml")
    path.write_text(PROJECT.replace(old, new))
    with refused(code, "compare.model", stated):
        read_project(path)


def test_a_project_without_models_says_what_to_write(project: Path) -> None:
    path = project.with_name("none.toml")
    path.write_text(PROJECT.split("[[compare")[0])
    done = run("calibrate", path, "--compare")
    assert done.returncode == 3
    assert "[[compare.model]]" in done.stderr


def test_the_workspace_of_the_measured_arm(
    shared_data: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = shared_data("motoman_ma1400_leica/right_arm_workspace.csv")
    monkeypatch.setenv("LOOPCAL_DATA", os.fspath(path.parents[1]))
    project = read_project(EXAMPLES / "motoman" / "right_arm_elastic.toml")
    loaded = load_dataset(project).dataset
    assert loaded.source.excluded == ("13",)
    # the example's model error weighs all readings alike, as least squares does ten times faster
    models = {
        name: project.compare[name] for name in ("elastic drives", "elastic arm, drift, gears")
    }
    found = compare_models(project.mechanism, loaded, models, method="least-squares")
    rms = {m.name: m.validation and m.validation.accuracy for m in found.models}
    assert {name: a and 1e3 * a.rms for name, a in rms.items()} == pytest.approx(
        {
            "geometric": 2.270,
            "elastic drives": 0.649,
            "elastic arm, drift, gears": 0.313,
        },
        abs=0.005,
    )
    assert found.recommended == "elastic arm, drift, gears"
    # the reflector sat elsewhere: millimetres in the flange's frame, known to a tenth of one
    value, sd = found.result.value, found.result.sd
    assert value["y6B_from86"] == pytest.approx(6.7e-3, abs=0.3e-3)
    assert all(0.0 < (sd[f"{a}6B_from14"] or 0.0) < 0.15e-3 for a in "xyz")


def test_the_wire_of_the_irb_120(
    shared_data: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = shared_data("abb_irb120_cable/RobotCali.xlsx")
    monkeypatch.setenv("LOOPCAL_DATA", os.fspath(path.parents[1]))
    project = EXAMPLES / "irb120" / "wire.toml"
    read = read_project(project)
    loaded = load_dataset(read)
    found = compare_models(
        read.mechanism, loaded.dataset, read.compare, noise=loaded.noise, method="implicit-loop"
    )
    rms = {m.name: m.validation and m.validation.accuracy for m in found.models}
    assert {name: a and 1e3 * a.rms for name, a in rms.items()} == pytest.approx(
        {"geometric": 0.357, "nominal arm": 0.371, "nominal arm, wire at the flange": 0.584},
        abs=0.003,
    )
    assert [m.parameters for m in found.models] == [25, 4, 7]
    # Errors of consecutive lengths are alike, and poses of the run share the drift of the fit.
    # Allowing for that, the dimensions gain what just decides: a model may be 4 behind.
    assert found.result.dependence is not None
    assert (found.result.dependence.drift_share or 0.0) > 0.5
    behind = {m.name: m.behind or 0.0 for m in found.models}
    assert behind["nominal arm"] == pytest.approx(4.1, abs=0.5)
    assert behind["nominal arm, wire at the flange"] > 40.0
    assert found.recommended == ("geometric" if behind["nominal arm"] > 4.0 else "nominal arm")
    chi = found.result.chi_squared
    assert chi is not None
    assert (chi.p_value or 0.0) > 0.1
    assert len(find_outliers(found.result)) == 0
    basic = calibrate(read.mechanism, loaded.dataset, method="least-squares")
    assert basic.status.converged
    assert basic.accuracy_after is not None
    assert basic.accuracy_after.rms < 0.26e-3
    # a hook a decimetre beside the flange: what fits best is no arm any more
    assert abs(basic.value["tool_x"]) > 0.1


def test_the_second_sheet_of_the_wires_file_repeats_the_first(
    shared_data: Callable[[str], Path],
) -> None:
    path = shared_data("abb_irb120_cable/RobotCali.xlsx")
    columns = {f"q{i}": {"column": f"q{i}", "unit": "deg"} for i in range(1, 7)}
    columns |= {"L": {"column": "L", "unit": "mm"}}
    first, second = (
        {
            tuple(row)
            for data in [read_dataset(path, columns, sheet=sheet)]
            for row in np.column_stack([data[q] for q in columns]).tolist()
        }
        for sheet in ("Sheet1", "Sheet2")
    )
    assert len(first) == 120
    assert len(second) == 10
    assert second < first
