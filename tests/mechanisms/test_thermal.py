"""A parameter changes by its coefficient for each kelvin from the reference temperature."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import loopcal as lc
from loopcal.errors import Code
from loopcal.files.machines.mechanism_file import read_mechanism
from loopcal.files.machines.mechanism_writer import mechanism_to_toml
from tests.command_line import run_here as run
from tests.refusals import refused

NOISE = lc.Noise({"xP": 1e-5, "yP": 1e-5, "phi*": 1e-5})
TRUTH = {"l2_thermal": 12e-6, "phi30_thermal": 20e-6}
EXACT = lc.Noise({"*": 0.0})


def warmed(**given: object) -> lc.Mechanism:
    effect = lc.effects.Thermal(("l2", "phi30"), **given)  # type: ignore[arg-type]
    return lc.with_effects(lc.planar_two_link(), [effect])


def poses(number: int, seed: int = 2) -> dict[str, np.ndarray]:
    ranges = {"phi2": (-1.5, 1.5), "phi3": (0.5, 2.5), "temperature": (288.15, 308.15)}
    return dict(lc.random_poses(ranges, number, seed=seed))


@pytest.mark.parametrize(("reference", "unit"), [(20.0, "degC"), (293.15, "K")])
def test_a_length_grows_by_its_coefficient_for_each_kelvin(reference: float, unit: str) -> None:
    arm = warmed(reference=reference, unit=unit).with_nominal(TRUTH)
    at = poses(10)
    warm = lc.simulate(arm, at, noise=EXACT, seed=1).dataset
    for i in range(10):
        rise = at["temperature"][i] - 293.15
        longer = {"l2": 0.8 + 12e-6 * rise, "phi30": 20e-6 * rise}
        cold = lc.planar_two_link().with_nominal(longer)
        one = {q: at[q][i : i + 1] for q in ("phi2", "phi3")}
        plain = lc.simulate(cold, one, noise=EXACT, seed=1).dataset
        assert warm["xP"][i] == pytest.approx(plain["xP"][0], abs=1e-14)
        assert warm["yP"][i] == pytest.approx(plain["yP"][0], abs=1e-14)


def test_coefficients_are_per_kelvin_whatever_the_reference_is_in() -> None:
    arm = warmed()
    assert arm.pose_constants == {"temperature": "K"}
    assert [arm.parameters[n].unit for n in TRUTH] == ["m/K", "rad/K"]


def test_coefficients_are_recovered_in_python() -> None:
    arm = warmed()
    made = lc.simulate(arm, poses(100), noise=NOISE, seed=3, truth=TRUTH)
    result = lc.calibrate(arm, made.dataset, noise=NOISE, method="implicit-loop")
    assert result.status.converged
    for name, true in TRUTH.items():
        sd = result.sd[name]
        assert sd is not None
        assert sd < 1e-6
        assert abs(result.value[name] - true) < 4 * sd, name


def predicted_at(calibration: lc.Result | lc.SavedResult, celsius: float) -> str:
    at = {"phi2": [0.1, 0.2], "phi3": [1.0, 1.2], "temperature": [298.15, 273.15 + celsius]}
    return lc.predict(calibration, at).words()


def test_a_temperature_far_from_those_of_the_calibration_is_named(tmp_path: Path) -> None:
    arm = warmed()
    made = lc.simulate(arm, poses(30), noise=NOISE, seed=3, truth=TRUTH)
    first = lc.calibrate(arm, made.dataset, noise=NOISE, method="implicit-loop")
    first.save(tmp_path / "first")
    for result in (first, lc.read_result(tmp_path / "first")):
        assert "OTHER CONDITIONS" not in predicted_at(result, 36.0)
        words = predicted_at(result, 60.0)
        low, high = (made.dataset["temperature"][[i]][0] - 273.15 for i in ends(made.dataset))
        assert f"temperature reaches 60 degC; the calibration was measured at {low:.3g}" in words
        assert f"{low:.3g} degC to {high:.3g} degC" in words
    hot = poses(30) | {"temperature": np.full(30, 333.15)}
    later = lc.simulate(arm, hot, noise=NOISE, seed=4, truth=TRUTH).dataset
    checked, updated = lc.verify(first, later), lc.update(first, later)
    (remark,) = checked.unlike
    assert remark.startswith("OTHER CONDITIONS  temperature reaches 60 degC")
    assert remark in str(checked)
    assert remark in checked.document()["other_conditions"]
    assert remark in updated.warnings
    assert "OTHER CONDITIONS" not in predicted_at(updated, 60.0)
    assert not lc.verify(updated, later).unlike


def ends(data: lc.Dataset) -> tuple[int, int]:
    return int(data["temperature"].argmin()), int(data["temperature"].argmax())


PROJECT = """
schema = 1
fit = { method = "implicit-loop" }
[mechanism]
type = "planar-two-link"
[[mechanism.effect]]
type = "thermal"
changing = ["l2", "phi30"]
[data]
file = "poses.csv"
[data.columns]
phi2 = "phi2"
phi3 = "phi3"
xP = { column = "xP", unit = "mm" }
yP = { column = "yP", unit = "mm" }
temperature = { column = "T", unit = "degC" }
[noise]
"phi*" = 1e-5
xPyP = 1e-5
[simulation]
poses = 100
[simulation.ranges]
phi2 = { from = -90, to = 90, unit = "deg" }
phi3 = { from = 30, to = 150, unit = "deg" }
temperature = { from = 15, to = 35, unit = "degC" }
[simulation.truth]
l2_thermal = { value = 12, unit = "um/K" }
phi30_thermal = { value = 20, unit = "urad/degC" }
"""


def test_coefficients_are_recovered_from_a_project_with_a_column_in_celsius(tmp_path: Path) -> None:
    project, data = tmp_path / "project.toml", tmp_path / "poses.csv"
    project.write_text(PROJECT)
    run("simulate", str(project), "--out", str(data), "--seed", "4")
    header, first, *_ = data.read_text().splitlines()
    assert 15 <= float(first.split(",")[header.split(",").index("T")]) <= 35
    read = lc.load_dataset(lc.read_project(project))
    assert 288.15 <= read.dataset["temperature"].min() < read.dataset["temperature"].max() <= 308.15
    result = lc.calibrate(
        lc.read_project(project).mechanism, read.dataset, noise=read.noise, method="implicit-loop"
    )
    for name, true in TRUTH.items():
        assert abs(result.value[name] - true) < 4 * (result.sd[name] or 0.0), name


def test_celsius_taken_as_kelvin_is_refused_before_the_fit(tmp_path: Path) -> None:
    project, data = tmp_path / "project.toml", tmp_path / "poses.csv"
    project.write_text(PROJECT)
    run("simulate", str(project), "--out", str(data), "--seed", "4")
    project.write_text(PROJECT.replace('{ column = "T", unit = "degC" }', '"T"'))
    with refused("implausible-unit", "'T'") as caught:
        lc.load_dataset(lc.read_project(project))
    assert caught.value.code == "implausible-unit"
    project.write_text(PROJECT.replace('unit = "degC" }\n[noise]', "check = false }\n[noise]"))
    assert lc.load_dataset(lc.read_project(project)).dataset["temperature"].max() < 40


CHAIN = """
schema = 1
fit = { method = "implicit-loop" }
[mechanism]
type = "urdf"
joint = [
    { name = "q1", xyz = [0, 0, 0.4], axis = [0, 0, 1] },
    { name = "q2", xyz = [0.15, 0, 0], axis = [0, 1, 0] },
    { name = "q3", xyz = [0.6, 0, 0], axis = [0, 1, 0] },
]
[[mechanism.effect]]
type = "thermal"
changing = ["q3_x", "q2_ry"]
[data]
file = "poses.csv"
[data.columns]
q1 = "q1"
q2 = "q2"
q3 = "q3"
x = "x"
y = "y"
z = "z"
temperature = { column = "T", unit = "degC" }
[noise]
"q*" = 1e-5
xyz = 1e-5
[parameters]
tool_x = 0.4
tool_y = 0.05
[simulation]
poses = 100
truth = { q3_x_thermal = 12e-6, q2_ry_thermal = 20e-6 }
[simulation.ranges]
q1 = { from = -2, to = 2 }
q2 = { from = -1, to = 1 }
q3 = { from = 0.3, to = 2 }
temperature = { from = 15, to = 35, unit = "degC" }
"""


def test_a_link_and_a_zero_of_a_chain_are_recovered_and_predicted_from(tmp_path: Path) -> None:
    (tmp_path / "project.toml").write_text(CHAIN)
    run("simulate", "project.toml", "--out", "poses.csv", "--seed", "1", cwd=tmp_path)
    done = run("calibrate", "project.toml", "--no-report", "--out", "out", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    document = json.loads((tmp_path / "out" / "result.json").read_text())
    found = {p["name"]: p for p in document["parameters"]}
    for name, true in {"q3_x_thermal": 12e-6, "q2_ry_thermal": 20e-6}.items():
        assert found[name]["sd"] < 1e-6
        assert abs(found[name]["value"] - true) < 4 * found[name]["sd"], name
    told = run("predict", "out", "poses.csv", cwd=tmp_path)
    assert told.returncode == 0, told.stderr
    x = [float(line.split(",")[1]) for line in told.stdout.splitlines()[1:]]
    read = lc.load_dataset(lc.read_project(tmp_path / "project.toml")).dataset["x"]
    assert np.abs(np.array(x) - read).max() < 1e-4


def test_it_is_written_again_bit_for_bit(tmp_path: Path) -> None:
    arm = warmed(column="T", reference=295.15, unit="K", name="growth").with_nominal(TRUTH)
    (tmp_path / "arm.toml").write_text(mechanism_to_toml(arm))
    assert read_mechanism(tmp_path / "arm.toml") == arm


@pytest.mark.parametrize(
    ("given", "code", "stated"),
    [
        ({"unit": "m"}, "invalid-value", ("20", "'thermal'")),
        ({"reference": float("nan")}, "invalid-value", ("nan",)),
        ({"unit": "degK"}, "unknown-unit", ("degK",)),
    ],
)
def test_what_is_no_temperature_is_refused(
    given: dict[str, object], code: Code, stated: tuple[str, ...]
) -> None:
    with refused(code, *stated):
        warmed(**given)


def test_without_parameters_all_lengths_grow_in_proportion() -> None:
    arm = lc.with_effects(lc.planar_two_link(), [lc.effects.Thermal()])
    assert arm.parameters["thermal_expansion"].unit == "1/K"
    at = poses(5)
    warm = lc.simulate(arm, at, noise=EXACT, seed=1, truth={"thermal_expansion": 12e-6}).dataset
    for i, T in enumerate(at["temperature"]):
        grown = 1.0 + 12e-6 * (T - 293.15)
        cold = lc.planar_two_link().with_nominal({"l2": 0.8 * grown, "l3": 0.6 * grown})
        one = {q: at[q][i : i + 1] for q in ("phi2", "phi3")}
        plain = lc.simulate(cold, one, noise=EXACT, seed=1).dataset
        assert warm["xP"][i] == pytest.approx(plain["xP"][0], abs=1e-14)
