"""Public functions take a path wherever they take a value, and tables in the units stated."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import polars as pl
import pytest

import loopcal as lc
from tests.refusals import refused

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "planar" / "project.toml"
DEGREES = {"phi?": "deg", "?P": "mm"}
NOISE = {"?P": 1e-3, "phi?": 1e-3}


@pytest.fixture(scope="module")
def project() -> lc.Project:
    return lc.read_project(EXAMPLE)


@pytest.fixture(scope="module")
def data(project: lc.Project) -> lc.Dataset:
    return lc.load_dataset(EXAMPLE).dataset


@pytest.fixture(scope="module")
def result(project: lc.Project, data: lc.Dataset) -> lc.Result:
    return lc.calibrate(project.mechanism, data, noise=NOISE, method="implicit-loop")


@pytest.fixture(scope="module")
def folder(result: lc.Result, tmp_path_factory: pytest.TempPathFactory) -> Path:
    found = tmp_path_factory.mktemp("result")
    result.save(found, report=False)
    return found


def in_degrees(data: lc.Dataset) -> dict[str, Any]:
    """As people have them: mm and degrees, with ids."""
    table: dict[str, Any] = {"pose": list(data.poses)}
    table |= {q: 1e3 * data[q] for q in ("xP", "yP")}
    return table | {q: np.degrees(data[q]) for q in ("phi2", "phi3")}


def test_a_project_with_options_keeps_its_title(project: lc.Project) -> None:
    assert project.title
    assert lc.calibrate(EXAMPLE, method="least-squares").document.title == project.title


def test_a_project_its_path_and_its_values_give_the_same_fit(
    project: lc.Project, data: lc.Dataset
) -> None:
    noise = lc.load_dataset(project).noise
    settings: dict[str, Any] = {"method": "implicit-loop", "prior": {"*": np.inf}}
    found = [
        lc.calibrate(EXAMPLE, **settings),
        lc.calibrate(str(EXAMPLE), **settings),
        lc.calibrate(project, **settings),
        lc.calibrate(project.mechanism, data, noise=noise, **settings),
    ]
    assert all(r.value == found[0].value and r.sd == found[0].sd for r in found)


def test_options_override_those_of_the_project() -> None:
    assert lc.calibrate(EXAMPLE, method="least-squares").method == "least-squares"
    loose = lc.calibrate(EXAMPLE, method="implicit-loop", noise={"*": 5e-3})
    assert loose.noise[0].sd == 5e-3


def test_a_mechanism_file_and_a_file_of_readings(
    folder: Path, data: lc.Dataset, tmp_path: Path
) -> None:
    pl.DataFrame(in_degrees(data)).write_csv(tmp_path / "poses.csv")
    given = {"noise": NOISE, "method": "implicit-loop"}
    found = lc.calibrate(folder / "mechanism.toml", tmp_path / "poses.csv", units=DEGREES, **given)
    assert found.value["l2"] == pytest.approx(lc.read_result(folder).value["l2"], abs=1e-9)
    assert found.dataset.poses == data.poses


@pytest.mark.parametrize("kind", [dict, pd.DataFrame, pl.DataFrame])
def test_any_table_is_read_in_the_units_stated(
    kind: Any, project: lc.Project, data: lc.Dataset, result: lc.Result
) -> None:
    table = kind(in_degrees(data))
    found = lc.calibrate(
        project.mechanism, table, units=DEGREES, noise=NOISE, method="implicit-loop"
    )
    assert found.value["l2"] == pytest.approx(result.value["l2"], abs=1e-9)
    assert found.dataset.poses == data.poses
    assert lc.check(project.mechanism, table, units=DEGREES, noise=NOISE).verdict == "good"
    assert lc.verify(result, table, units=DEGREES).calibrated is not None


@pytest.mark.parametrize(
    ("quantities", "likely"), [(("phi2", "phi3"), "deg"), (("xP", "yP"), "mm")]
)
def test_a_table_in_degrees_or_millimetres_without_units_is_refused_with_the_likely_unit(
    project: lc.Project, data: lc.Dataset, result: lc.Result, quantities: Any, likely: str
) -> None:
    table = pd.DataFrame({q: data[q] for q in data.quantities})
    shown = in_degrees(data)
    for quantity in quantities:
        table[quantity] = shown[quantity]
    told = f'units={{"{quantities[0]}": "{likely}"}}'
    with refused("implausible-unit", told):
        lc.calibrate(project.mechanism, table, noise=NOISE)
    with refused("implausible-unit", told):
        lc.check(project.mechanism, table)
    with refused("implausible-unit", told):
        lc.verify(result, table)


def test_a_stated_unit_is_believed(project: lc.Project) -> None:
    turned = {"phi2": [20.0, 20.5, 21.0], "phi3": [1.0, 1.2, 1.4]}
    with refused("implausible-unit", "phi2"):
        lc.simulate(project.mechanism, turned, noise={"*": 0.0}, seed=1)
    made = lc.simulate(project.mechanism, turned, noise={"*": 0.0}, seed=1, units={"phi2": "rad"})
    assert made.dataset["phi2"].max() == 21.0


def test_units_of_si_values_are_refused(project: lc.Project, data: lc.Dataset) -> None:
    with refused("conflicting-keys", "Dataset"):
        lc.calibrate(project.mechanism, data, noise=NOISE, units=DEGREES)
    with refused("unknown-name", "psi"):
        lc.calibrate(project.mechanism, in_degrees(data), noise=NOISE, units={"psi?": "deg"})


def test_results_are_taken_from_their_folder(
    folder: Path, result: lc.Result, data: lc.Dataset
) -> None:
    saved = lc.read_result(folder)
    poses = {"phi2": [0.3], "phi3": [1.0]}
    there = lc.verify(result, data).calibrated
    assert there is not None
    for its in (folder, str(folder), folder / "result.json", saved):
        found = lc.predict(its, poses)
        assert np.allclose(found.covariance, lc.predict(result, poses).covariance, rtol=1e-6)
        assert lc.compare(its, result).chi_squared < 1e-9
        here = lc.verify(its, data).calibrated
        assert here is not None
        assert there is not None
        assert here.rms == pytest.approx(there.rms)
    again = lc.verify(folder, saved).calibrated
    assert again is not None
    assert again.rms == pytest.approx(there.rms, rel=1e-6)


def test_what_needs_the_fit_calibrates_a_project_and_refuses_a_folder(folder: Path) -> None:
    assert lc.findings(EXAMPLE).observability.O1 is not None
    for function in (lc.findings, lc.find_outliers, lc.find_shifts, lc.intervals, lc.verdict):
        with refused("unsupported", "project.toml"):
            function(folder)


def test_simulation_of_a_project_is_that_of_the_command_line(tmp_path: Path) -> None:
    from loopcal.workflow.checking import run_simulation

    written = run_simulation(EXAMPLE, out=tmp_path / "poses.csv", seed=3).simulation
    made = lc.simulate(EXAMPLE, seed=3)
    assert all((made.dataset[q] == written.dataset[q]).all() for q in made.dataset.quantities)


def test_methods_and_validations_of_a_project() -> None:
    kinds = {"plain": {"method": "least-squares"}, "loop": {"method": "implicit-loop"}}
    found = lc.compare_methods(EXAMPLE, None, kinds, folds=3)
    assert set(found.validations) == set(kinds)
    assert lc.validate(EXAMPLE, folds=3, method="implicit-loop").accuracy is not None


def test_repeated_readings_of_files_and_tables(tmp_path: Path) -> None:
    values = np.array([0.1, 0.3, 0.2, 0.1, 0.3])
    pl.DataFrame({"a": values}).write_csv(tmp_path / "a.csv")
    sds = [
        lc.repeated_readings(given)["a"].sd
        for given in (tmp_path / "a.csv", [tmp_path / "a.csv"], {"a": values})
    ]
    assert np.allclose(sds, 0.1)


def test_what_is_no_mechanism_is_refused(data: lc.Dataset) -> None:
    with refused("invalid-value", "int"):
        lc.calibrate(3, data)
    with refused("no-data"):
        lc.calibrate(lc.planar_two_link())


def test_signatures_show_units_and_the_options_below() -> None:
    for function in (lc.calibrate, lc.check, lc.validate, lc.predict, lc.verify):
        known = inspect.signature(function).parameters
        assert "units" in known
        assert len(known) > 3
        assert "path" in (inspect.getdoc(function) or "")


def test_a_table_of_a_projects_columns_is_read_in_their_units(
    data: lc.Dataset, tmp_path: Path
) -> None:
    table = pd.DataFrame(in_degrees(data)).set_axis(["pose", "X", "Y", "first", "second"], axis=1)
    table.to_csv(tmp_path / "poses.csv", index=False)
    text = EXAMPLE.read_text()
    named = {"xP": "X", "yP": "Y", "phi2": "first", "phi3": "second"}
    for quantity, label in named.items():
        text = text.replace(f'column = "{quantity}"', f'column = "{label}"')
    (tmp_path / "project.toml").write_text(text)
    result = lc.calibrate(tmp_path / "project.toml", method="implicit-loop")
    result.save(tmp_path / "result", report=False)
    saved = lc.load(tmp_path / "result")
    by_file = lc.predict(saved, tmp_path / "poses.csv").outputs["xP"]
    predicted = saved.predict(table)
    assert predicted.outputs["xP"] == pytest.approx(by_file, abs=1e-12)
    assert predicted.poses == data.poses
    joints = np.column_stack([data["phi2"], data["phi3"]])
    assert lc.verify(saved, table).calibrated == lc.verify(saved, tmp_path / "poses.csv").calibrated
    # Radians beyond the calibrated poses are as small as degrees near zero.
    assert saved.predict(joints + 0.5).outputs["xP"].shape == (100,)
    with refused("implausible-unit", "units='deg'"):
        saved.predict(np.degrees(joints))


@pytest.mark.parametrize("method", ["auto", "implicit-loop", "least-squares"])
def test_sds_of_another_number_of_poses_are_refused(
    project: lc.Project, data: lc.Dataset, method: str
) -> None:
    with refused("wrong-shape", "'xP' has 5 entries, the data have 100 poses"):
        lc.calibrate(project.mechanism, data, noise=NOISE | {"xP": np.ones(5)}, method=method)
