"""Parameters that equal each other, `[same]`: one is estimated for all, everywhere."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import loopcal as lc
from loopcal.cli.run import main
from tests.refusals import refused

UNITS = {"a": "rad", "b": "rad", "x": "m", "y": "m"}
NOISE = {"a": 1e-4, "b": 1e-4, "x": 2e-5, "y": 2e-5}


def arm(second: str) -> Callable[[Any, Any], list[Any]]:
    """Two links in a plane, whose gears have a scale each; `second` names that of the outer one."""

    def loops(x: Any, p: Any) -> list[Any]:
        inner = x.a * (1.0 + p["g1"])
        outer = inner + x.b * (1.0 + p[second])
        return [
            0.8 * np.cos(inner) + p["l"] * np.cos(outer) - x.x,
            0.8 * np.sin(inner) + p["l"] * np.sin(outer) - x.y,
        ]

    return loops


def machine(*scales: str) -> lc.Mechanism:
    """The arm with parameters for these scales."""
    parameters = {"l": (0.6, "m"), **dict.fromkeys(scales, (0.0, "1"))}
    return lc.Mechanism.from_function(arm(scales[-1]), UNITS, parameters, ("x", "y"))


def readings(scale: float = 1e-3) -> lc.Dataset:
    """Of an arm whose two gears have one scale."""
    rng = np.random.default_rng(5)
    driven = lc.Dataset.from_arrays({q: rng.uniform(-1.5, 1.5, 60) for q in "ab"})
    truth = machine("g1").with_nominal({"g1": scale, "l": 0.6005})
    return lc.simulate(truth, driven, noise=NOISE, seed=2).dataset


def sd(result: Any, name: str) -> float:
    """Of an estimated parameter."""
    value: float | None = result.params[name].sd
    assert value is not None
    return value


def test_equal_parameters_are_fitted_as_one() -> None:
    tied = machine("g1", "g2").with_same({"gears": ["g1", "g2"]})
    one, two = (
        lc.calibrate(m, readings(), noise=NOISE, method="implicit-loop")
        for m in (machine("g1"), tied)
    )
    assert two.params["g2"].value == two.params["g1"].value
    assert sd(two, "g2") == sd(two, "g1")
    assert two.params["g2"].same == "g1"
    for name in ("g1", "l"):
        assert two.params[name].value == pytest.approx(one.params[name].value, rel=1e-9)
        assert sd(two, name) == pytest.approx(sd(one, name), rel=1e-9)
    assert two.estimated == ("l", "g1")
    apart = lc.calibrate(machine("g1", "g2"), readings(), noise=NOISE, method="implicit-loop")
    assert sd(apart, "g1") > 1.1 * sd(two, "g1")
    assert "as g1" in str(two.params)


@pytest.mark.parametrize(
    ("groups", "code"),
    [
        ({"gears": ["g1"]}, "invalid-value"),
        ({"gears": ["g1", "g1"]}, "invalid-value"),
        ({"gears": ["g?", "g1"]}, "invalid-value"),
        ({"gears": ["g1", "g3"]}, "unknown-name"),
        ({"gears": ["g1", "l"]}, "conflicting-keys"),
        ({"gears": ["g1", "g2"], "again": ["g2", "g1"]}, "duplicate-name"),
    ],
)
def test_what_cannot_be_equal_is_refused(groups: dict[str, list[str]], code: Any) -> None:
    with refused(code):
        machine("g1", "g2").with_same(groups)


MECHANISM = """
[mechanism]
type = "tree"
body = [
  { name = "l1", parent = "base", row = { name = "lq1", a = 0.06, d = 0.35, alpha = 1.57 } },
  { name = "l2", parent = "l1", row = { name = "lq2", a = 0.42, alpha = -1.57 } },
  { name = "r1", parent = "base", row = { name = "rq1", a = 0.06, d = 0.35, alpha = 1.57 } },
  { name = "r2", parent = "r1", row = { name = "rq2", a = 0.42, alpha = -1.57 } },
]
[[mechanism.instrument]]
type = "point"
name = "left"
on = "l2"
station = "tracker"
readings = ["lx", "ly", "lz"]
[[mechanism.instrument]]
type = "point"
name = "right"
on = "r2"
station = "tracker"
target = "right_target"
readings = ["rx", "ry", "rz"]
[[mechanism.effect]]
type = "scale"
joints = ["lq2", "rq2"]
"""
PROJECT = f"""schema = 1
{MECHANISM}
[mechanism.parameters]
"[dao]*" = {{ sd = 0.002 }}
"*target_?" = {{ sd = 0.1 }}
[data]
file = "poses.csv"
pose = "pose"
[noise]
"?q?" = {{ sd = 50, unit = "urad" }}
"[lr][xyz]" = {{ sd = 20, unit = "um" }}
[fit]
method = "implicit-loop"
[simulation.ranges]
lq1 = {{ from = -80, to = 80, unit = "deg" }}
lq2 = {{ from = -80, to = 80, unit = "deg" }}
rq1 = {{ from = -80, to = 80, unit = "deg" }}
rq2 = {{ from = -80, to = 80, unit = "deg" }}
[simulation]
poses = 60
[simulation.truth]
lq2_scale = {{ value = 1e-3, unit = "1" }}
a_l2 = {{ value = 0.4205, unit = "m" }}
[same]
gears = ["lq2_scale", "rq2_scale"]
links = ["a_l*", "a_r*"]
"""


@pytest.fixture
def calibrated(tmp_path: Path) -> Path:
    """The folder of a robot of two arms whose gears and links are alike, with its result."""
    (tmp_path / "project.toml").write_text(PROJECT, encoding="utf-8")
    for seed, name in ((1, "poses.csv"), (2, "later.csv")):
        project, out = str(tmp_path / "project.toml"), str(tmp_path / name)
        assert main(["simulate", project, "--seed", str(seed), "--out", out]) == 0
    result = lc.calibrate(tmp_path / "project.toml")
    result.save(tmp_path / "result")
    return tmp_path


def test_a_project_states_it_and_every_later_day_keeps_it(calibrated: Path) -> None:
    result = lc.read_result(calibrated / "result")
    assert result.verdict is not None
    for first, other, truth in (
        ("lq2_scale", "rq2_scale", 1e-3),
        ("a_l1", "a_r1", 0.06),
        ("a_l2", "a_r2", 0.4205),
    ):
        entry = result.params[first]
        assert result.params[other].value == entry.value
        assert abs(entry.value - truth) < 4.0 * sd(result, first)
    assert lc.verify(result, calibrated / "later.csv").verdict["consistent"].passed is True
    updated = lc.update(result, calibrated / "later.csv")
    scale = updated.params["lq2_scale"]
    assert updated.params["rq2_scale"].value == scale.value
    assert sd(updated, "lq2_scale") < sd(result, "lq2_scale")
    assert abs(scale.value - 1e-3) < 4.0 * sd(updated, "lq2_scale")
    updated.save(calibrated / "updated")
    again = lc.read_result(calibrated / "updated")
    assert again.mechanism.parameters["rq2_scale"].same == "lq2_scale"
    assert again.params["rq2_scale"].value == scale.value


def test_what_is_stated_of_one_alone_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "project.toml"
    path.write_text(PROJECT.replace("[data]", "a_r2 = { value = 0.43 }\n[data]"), encoding="utf-8")
    with refused("conflicting-keys", "a_l2"):
        lc.read_project(path)
