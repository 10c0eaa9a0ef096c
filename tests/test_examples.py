"""The examples: `loopcal simulate` made their readings, and they calibrate as promised."""

from __future__ import annotations

import json
import math
import os
import runpy
from functools import cache
from pathlib import Path

import pytest

from loopcal.estimation.calibrate import calibrate
from loopcal.estimation.result import FitResult
from loopcal.files.project.project_data import load_dataset
from loopcal.files.project.project_file import read_project
from tests.command_line import run_here

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
SIMULATED = ("planar", "six_axis")


@cache
def calibrated(path: Path, method: str) -> FitResult:
    project = read_project(path)
    loaded = load_dataset(project)
    assert loaded.warnings == ()
    return calibrate(project.mechanism, loaded.dataset, noise=loaded.noise, method=method)


def errors(name: str, result: FitResult) -> dict[str, float]:
    """True minus estimate [SI] of every estimated parameter."""
    truth = json.loads((EXAMPLES / name / "poses.truth.json").read_text("utf-8"))["parameters"]
    return {p: truth[p]["value"] - result.value[p] for p in result.estimated}


@pytest.mark.parametrize("name", SIMULATED)
def test_the_implicit_loop_finds_the_truth_within_its_sds(name):
    result = calibrated(EXAMPLES / name / "project.toml", "implicit-loop")
    assert result.status.converged
    assert result.chi_squared is not None
    assert 0.01 < (result.chi_squared.p_value or 0.0) < 0.99
    for parameter, error in errors(name, result).items():
        assert abs(error) < 3.5 * (result.sd[parameter] or 0.0), parameter


@pytest.mark.parametrize("name", SIMULATED)
@pytest.mark.parametrize("unit", ["m", "rad"])
def test_it_comes_much_nearer_to_the_truth_than_least_squares(name, unit):
    """One sensor is ten times worse than the others, and only the implicit loop knows it."""
    size = {}
    for method in ("implicit-loop", "least-squares"):
        result = calibrated(EXAMPLES / name / "project.toml", method)
        its = [e for p, e in errors(name, result).items() if its_unit(result, p) == unit]
        size[method] = math.sqrt(sum(e * e for e in its) / len(its))
    assert size["implicit-loop"] < 0.4 * size["least-squares"]


def its_unit(result: FitResult, parameter: str) -> str:
    return result.mechanism.parameters[parameter].unit


@pytest.mark.parametrize("name", SIMULATED)
def test_the_readings_are_what_simulate_writes(name, tmp_path):
    out = tmp_path / "poses.csv"
    done = run_here("simulate", EXAMPLES / name / "project.toml", "--out", out, "--seed", "1")
    assert done.returncode == 0, done.stderr
    made, kept = (p.read_text("utf-8").split() for p in (out, EXAMPLES / name / "poses.csv"))
    assert made[0] == kept[0]
    assert len(made) == len(kept)
    for new, old in zip(made[1:], kept[1:], strict=True):
        # to the last digits: mathematical functions round differently from machine to machine
        assert [*map(float, new.split(","))] == pytest.approx([*map(float, old.split(","))], 1e-9)


@pytest.mark.parametrize(
    ("project", "data", "method", "rms", "within"),
    [
        ("left_arm_grid", "left_arm_grid", "least-squares", 0.0735e-3, 0.0005e-3),
        ("left_arm_grid", "left_arm_grid", "implicit-loop", 0.079e-3, 0.002e-3),
        ("right_arm_workspace", "right_arm_workspace", "least-squares", 2.36e-3, 0.02e-3),
        ("right_arm_workspace", "right_arm_workspace", "implicit-loop", 3.08e-3, 0.02e-3),
    ],
)
def test_the_measured_arms(project, data, method, rms, within, shared_data, monkeypatch):
    path = shared_data(f"motoman_ma1400_leica/{data}.csv")
    monkeypatch.setenv("LOOPCAL_DATA", os.fspath(path.parents[1]))
    result = calibrated(EXAMPLES / "motoman" / f"{project}.toml", method)
    assert result.status.converged
    assert len(result.estimated) == result.identifiability.rank == 27
    assert result.accuracy_after is not None
    assert result.accuracy_after.rms == pytest.approx(rms, abs=within)
    if project == "right_arm_workspace" and result.chi_squared is not None:
        assert result.chi_squared.variance_factor == pytest.approx(1080, rel=0.05)
        assert any("model error" in warning for warning in result.warnings)


@pytest.mark.parametrize(
    ("project", "poses", "free", "rms", "within"),
    [
        ("motoman/dual_arm", 492, 96, 0.0761e-3, 0.0005e-3),
        ("talos/left_arm", 61, 39, 0.5116e-3, 0.002e-3),
    ],
)
def test_the_measured_robots(project, poses, free, rms, within, shared_data, monkeypatch):
    path = shared_data("trees/talos.urdf")
    monkeypatch.setenv("LOOPCAL_DATA", os.fspath(path.parents[1]))
    result = calibrated(EXAMPLES / f"{project}.toml", "implicit-loop")
    assert result.status.converged
    assert len(result.dataset) == poses
    assert len(result.estimated) == free
    assert result.accuracy_after is not None
    assert result.accuracy_after.rms == pytest.approx(rms, abs=within)


def test_halves_of_measured_sets_give_the_table_12_that_the_documentation_tells(
    shared_data, monkeypatch
):
    path = shared_data("motoman_ma1400_leica/left_arm_grid.csv")
    monkeypatch.setenv("LOOPCAL_DATA", str(path.parents[1]))
    table = runpy.run_path(str(EXAMPLES / "seed" / "table_12.py"))
    grid, workspace = (
        [table["halves"](name, method) for method in table["METHODS"]]
        for name in table["SETS"].values()
    )
    for one in (*grid, *workspace):
        assert all(fit.status.converged for fit in one.fits)
    inside = [sum(abs(p.z) <= 1.96 for p in one.compared.parameters) for one in grid]
    assert inside == [19, 21]  # least squares: by the scatter of its poses
    assert 0.05 < grid[0].compared.p_value < 0.1 < grid[1].compared.p_value
    assert max(grid[0].elsewhere + grid[1].elsewhere) < 0.09e-3
    for basic, new in zip(
        workspace[0].compared.parameters, workspace[1].compared.parameters, strict=True
    ):
        assert new.a == pytest.approx(basic.a, abs=1e-4)
        assert abs(new.z) < 2.5
    told = "\n".join(table["report"]("grid", grid))
    assert "difference of these" in told
    assert "on the other half's poses" in told
