"""A fit that goes on from where a result ended finds what a calibration anew would find."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from loopcal.companions.app.edits import with_shift, with_value, without_poses
from loopcal.errors import InputError
from loopcal.report.source import read_source
from loopcal.statistics.continued import Ending
from loopcal.workflow.calibration import Calibration, run_calibration
from loopcal.workflow.checking import run_simulation
from loopcal.workflow.projects import new_project, run_refit

pytest.importorskip("tomlkit", reason="tomlkit is absent; `pip install .[app]` installs it")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A planar arm with readings, calibrated by the method that predicts best."""
    folder = tmp_path_factory.mktemp("refit") / "arm"
    project = new_project(str(folder), "planar-two-link").project
    project.write_text(project.read_text("utf-8").replace("step = 10", "step = 30"), "utf-8")
    run_simulation(project, out=folder / "poses.csv", seed=1)
    run_calibration(project)
    return folder


def ending(folder: Path) -> Ending:
    source = read_source(folder / "project-result")
    return Ending.of(source.document, source.table.poses)


def written(folder: Path, name: str, text: str) -> Path:
    path = folder / f"{name}.toml"
    path.write_text(text, "utf-8")
    return path


def assert_as_anew(folder: Path, project: Path) -> Calibration:
    """The same parameters, to a small part of their sds, and the same poses and errors."""
    found = run_refit(project, ending(folder))
    anew = run_calibration(project)
    assert found.converged
    assert found.table.poses == anew.result.dataset.poses
    sds = {name: sd for name, sd in anew.result.sd.items() if sd is not None}
    for name, sd in sds.items():
        assert found.values[name] == pytest.approx(anew.result.value[name], abs=0.05 * sd)
    size = anew.result.accuracy_after
    assert size is not None
    assert found.accuracy.rms == pytest.approx(size.rms, rel=1e-2)
    return anew


def test_without_some_poses(folder: Path) -> None:
    text = without_poses((folder / "project.toml").read_text("utf-8"), ["3", "4", "17"])
    assert_as_anew(folder, written(folder, "fewer", text))


def test_by_another_method(folder: Path) -> None:
    text = (folder / "project.toml").read_text("utf-8")
    text = with_value(text, ["fit", "method"], "implicit-loop")
    assert_as_anew(folder, written(folder, "other", text))


def test_with_a_reflector_that_moved(folder: Path) -> None:
    """The new parameters begin at their nominal values."""
    text = (folder / "project.toml").read_text("utf-8")
    text = with_value(text, ["data", "columns", "pose"], {"column": "pose", "unit": "1"})
    text = with_shift(text, ["xA", "yA"], [20.0], "pose")
    project = written(folder, "moved", text)
    found = run_refit(project, ending(folder))
    new = set(found.values) - set(ending(folder).values)
    assert new == {"xA_from20", "yA_from20"}
    assert found.converged
    assert np.isfinite([*found.values.values()]).all()


def test_another_machine_is_refused(folder: Path, tmp_path: Path) -> None:
    other = new_project(str(tmp_path / "other"), "four-bar").project
    run_simulation(other, out=other.with_name("poses.csv"), seed=1)
    with pytest.raises(InputError, match="has no parameter"):
        run_refit(other, ending(folder))
