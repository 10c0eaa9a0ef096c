"""The one path behind the command line, called from Python."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from loopcal.errors import InputError
from loopcal.files.result.result_file import read_result
from loopcal.workflow.calibration import Listeners, Request, run_calibration
from loopcal.workflow.checking import run_simulation
from loopcal.workflow.projects import new_project, schema
from tests.refusals import refused

LOOPS = """
import numpy as np
import loopcal as lc

def loops(x, p):
    return [p.length * np.sin(x.angle + p.offset) - x.height]

def arm():
    return lc.Mechanism.from_function(
        loops, {"angle": "rad", "height": "m"},
        {"length": (0.5, "m"), "offset": (0.0, "rad")}, ("height",), name="lever")

ready = arm()
number = 3

def fails(x, p):
    return [p.length * x.angle - undefined]

def branches(x, p):
    return [x.angle - x.height if x.angle > 0 else x.height]

def wrong(x, p):
    return [p.lenght * x.angle - x.height]

def broken():
    raise RuntimeError("no licence")
"""
PROJECT = """\
schema = 1
fit = { method = "implicit-loop" }
title = "Lever"
[mechanism]
type = "function"
quantities = { angle = "rad", height = "m" }
outputs = ["height"]
[parameters]
length = { value = 500, unit = "mm" }
offset = { value = 0, unit = "deg" }
[data]
file = "poses.csv"
columns = { angle = { column = "angle", unit = "deg" }, height = { column = "h", unit = "mm" } }
[noise]
angle = { sd = 1, unit = "mrad" }
height = { sd = 0.1, unit = "mm" }
[simulation]
poses = 60
ranges = { angle = { from = -80, to = 80, unit = "deg" } }
truth = { length = { value = 502, unit = "mm" } }
perturb = { offset = { sd = 5, unit = "mrad" } }
"""


@pytest.fixture
def lever(tmp_path: Path) -> Path:
    (tmp_path / "loops.py").write_text(LOOPS)
    (tmp_path / "lever.toml").write_text(PROJECT)
    return tmp_path


def function(lever: Path, name: str = "loops") -> str:
    return f"{lever / 'loops.py'}:{name}"


def test_readings_are_simulated_and_calibrated(lever: Path) -> None:
    made = run_simulation(
        lever / "lever.toml", out=lever / "poses.csv", seed=3, function=function(lever)
    )
    assert made.truth_file == lever / "poses.truth.json"
    assert made.simulation.parameters["length"] == 0.502
    assert 0 < abs(made.simulation.parameters["offset"]) < 0.025
    done = run_calibration(
        lever / "lever.toml",
        Request(truth=made.truth_file),
        function=function(lever),
        out=lever / "out",
    )
    assert done.objection is None
    assert done.result.errors is not None
    for name, error in done.result.errors.items():
        assert error == made.simulation.parameters[name] - done.result.value[name]
    assert read_result(lever / "out" / "result.json").title == "Lever"
    assert done.written.document.inputs["noise"]["angle"]["sd"] == 1


def test_readings_in_the_units_of_the_project_are_the_simulated_ones(lever: Path) -> None:
    made = run_simulation(
        lever / "lever.toml", out=lever / "poses.csv", seed=3, function=function(lever)
    )
    done = run_calibration(lever / "lever.toml", function=function(lever))
    for quantity in ("angle", "height"):
        np.testing.assert_allclose(
            done.result.dataset[quantity], made.simulation.dataset[quantity], rtol=1e-15
        )


@pytest.mark.parametrize("name", ["ready", "arm"])
def test_a_whole_mechanism_may_be_named_too(name: str, lever: Path) -> None:
    named = function(lever, name)
    run_simulation(lever / "lever.toml", out=lever / "poses.csv", seed=3, function=named)
    done = run_calibration(lever / "lever.toml", function=named)
    assert done.result.mechanism.name == "lever"
    assert done.objection is None


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("loop", "did you mean 'loops'"),
        ("number", "int"),
        ("fails", "NameError"),
        ("branches", "cannot branch"),
        ("wrong", "lenght"),
        ("broken", "no licence"),
    ],
)
def test_what_is_wrong_in_a_users_file_is_told(name: str, told: str, lever: Path) -> None:
    with pytest.raises(InputError) as caught:
        run_simulation(
            lever / "lever.toml", out=lever / "p.csv", seed=1, function=function(lever, name)
        )
    assert told in str(caught.value)
    assert not (lever / "p.csv").exists()


def test_a_mistake_in_a_users_loops_names_its_line(lever: Path) -> None:
    line = 1 + LOOPS.splitlines().index("    return [p.length * x.angle - undefined]")
    with refused("failing-function", f"loops.py, line {line}", "'undefined'"):
        run_simulation(
            lever / "lever.toml", out=lever / "p.csv", seed=1, function=function(lever, "fails")
        )


def test_machines_differ_with_the_seed_and_readings_repeat(lever: Path) -> None:
    def offset(seed: int) -> float:
        made = run_simulation(
            lever / "lever.toml", out=lever / f"{seed}.csv", seed=seed, function=function(lever)
        )
        return made.simulation.parameters["offset"]

    first = offset(1)
    written = (lever / "1.csv").read_bytes()
    assert offset(2) != first
    assert offset(1) == first
    assert (lever / "1.csv").read_bytes() == written


def test_columns_of_sds_are_simulated_as_well(tmp_path: Path) -> None:
    new_project(str(tmp_path / "arm"), "planar-two-link")
    project = tmp_path / "arm" / "project.toml"
    text = project.read_text()
    old = 'xP = { column = "xP", unit = "mm" }'
    assert old in text
    new = 'xP = { column = "xP", unit = "mm", sd_column = "u_x", sd_unit = "um" }'
    project.write_text(text.replace(old, new))
    run_simulation(project, out=tmp_path / "arm" / "poses.csv", seed=1)
    head, first, *_ = (tmp_path / "arm" / "poses.csv").read_text().splitlines()
    assert float(first.split(",")[head.split(",").index("u_x")]) == pytest.approx(100)
    done = run_calibration(project)
    entry = next(n for n in done.result.noise if n.quantities == ("xP",))
    assert entry.source == "reading"
    assert entry.sd == pytest.approx(1e-4)


def test_a_quantity_without_a_sensor_is_found_from_the_rest(tmp_path: Path) -> None:
    new_project(str(tmp_path / "arm"), "planar-two-link")
    project = tmp_path / "arm" / "project.toml"
    text = project.read_text()
    for old, new in (
        ("[parameters]", "phi3 = { sd = inf }\n[parameters]\nphi30 = { fixed = true }"),
        ('phi3 = { column = "phi3", unit = "deg" }\n', ""),
        ("phi3 = { from = -90", "phi3 = { from = 10"),
    ):
        assert old in text
        text = text.replace(old, new, 1)
    project.write_text(text)
    run_simulation(project, out=tmp_path / "arm" / "poses.csv", seed=1)
    done = run_calibration(project, Request(truth=tmp_path / "arm" / "poses.truth.json"))
    result = done.result
    assert result.status.converged
    assert result.errors is not None
    assert result.accuracy_after is None
    for name in result.errors.keys() & set(result.estimated):
        sd = result.sd[name]
        assert sd is not None
        assert abs(result.errors[name]) < 4 * sd


def test_progress_is_reported(lever: Path) -> None:
    run_simulation(lever / "lever.toml", out=lever / "poses.csv", seed=3, function=function(lever))
    told: list[int] = []
    run_calibration(
        lever / "lever.toml",
        function=function(lever),
        listeners=Listeners(
            progress=lambda iteration, chi_squared, decrease: told.append(iteration)
        ),
    )
    assert told == list(range(1, len(told) + 1))


def test_a_method_that_is_none_is_a_matter_of_usage(lever: Path) -> None:
    with refused("unknown-name", "'least-sqares'"):
        run_calibration(lever / "lever.toml", Request(method="least-sqares"))
    with refused("unknown-name", "project"):
        schema("projekt")
    with refused("unknown-name", "function"):
        new_project(str(lever / "new"), "functions")


def test_nothing_is_overwritten_by_a_new_project(tmp_path: Path) -> None:
    made = new_project(str(tmp_path / "arm"), "planar-two-link")
    made.project.write_text("mine")
    with refused("unwritable-file"):
        new_project(str(tmp_path / "arm"), "planar-two-link")
    assert made.project.read_text() == "mine"


def test_infinite_sds_are_text_in_the_inputs(lever: Path) -> None:
    text = PROJECT + '[prior]\n"*" = { sd = inf }\n'
    (lever / "lever.toml").write_text(text)
    run_simulation(lever / "lever.toml", out=lever / "poses.csv", seed=3, function=function(lever))
    done = run_calibration(lever / "lever.toml", function=function(lever))
    assert done.written.document.inputs["prior"]["*"]["sd"] == str(math.inf)
