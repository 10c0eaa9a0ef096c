"""What a result is in a notebook: tables, figures, texts, and the names other libraries use."""

from __future__ import annotations

import copy
import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

import loopcal as lc
from loopcal.document.aliases import ALIASES, INSTEAD
from loopcal.document.notebook_html import result_html
from loopcal.estimation.fit_document import fit_document
from tests import golden_files as golden
from tests.refusals import refused

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "planar" / "project.toml"


@pytest.fixture(scope="module")
def result() -> lc.Result:
    return lc.calibrate(EXAMPLE)


@pytest.fixture(scope="module")
def saved(result: lc.Result, tmp_path_factory: pytest.TempPathFactory) -> lc.SavedResult:
    folder = tmp_path_factory.mktemp("saved")
    assert "report.html" in result.save(folder).files
    return lc.read_result(folder)


def same(a: Any, b: Any) -> bool:
    """Of numbers, arrays, texts, and mappings of them."""
    if hasattr(a, "keys"):
        return list(a) == list(b) and all(same(a[k], b[k]) for k in a)
    if isinstance(a, str):
        return a == b
    return bool(np.allclose(np.array(a, dtype=float), np.array(b, dtype=float), rtol=1e-9))


def test_parameters_are_a_table(result: lc.Result) -> None:
    frame = result.params.to_pandas()
    assert frame.loc["l2", "value"] == result.value["l2"] == result.params["l2"].value
    assert frame.loc["l2", "sd"] == result.sd["l2"] == result.params["l2"].stderr
    assert result.params.to_polars()["name"].to_list() == list(result.params)
    assert "l2" in str(result.params)
    assert "l2" in result.params._repr_html_()
    with pytest.raises(KeyError, match="l2"):
        result.params["l_2"]
    assert "l_2" not in result.params


def test_fixed_and_undetermined_parameters_have_no_sd_in_a_frame() -> None:
    def rod(x: Any, p: Any) -> list[Any]:
        return [p.long + p.short + p.held - x.length]

    lengths = {"long": (1.0, "m"), "short": (0.1, "m"), "held": (0.0, "m")}
    arm = lc.Mechanism.from_function(rod, {"length": "m"}, lengths)
    arm = arm.with_parameters(arm.parameters.with_fixed(["held"]))
    table = lc.calibrate(arm, {"length": [1.11, 1.112, 1.109]}, noise={"*": 1e-3}).params
    assert table.to_pandas()["sd"].isna().all()
    assert table.to_polars()["sd"].null_count() == 3
    assert table.to_polars()["validity"].to_list() == ["undetermined", "undetermined", "fixed"]
    assert "not determined" in table._repr_html_()


def test_the_figures_of_the_report_are_plotly_figures(
    result: lc.Result, saved: lc.SavedResult
) -> None:
    for its in (result, saved):
        for name in ("residuals", "space", "parameters", "correlations"):
            figure = getattr(its.plot, name)()
            assert type(figure).__module__.startswith("plotly")
            assert figure.data


def test_a_figure_without_numbers_is_refused() -> None:
    def rod(x: Any, p: Any) -> list[Any]:
        return [p.long - x.length]

    arm = lc.Mechanism.from_function(rod, {"length": "m"}, {"long": (1.0, "m")})
    plots = lc.calibrate(arm, {"length": [1.11, 1.112]}, noise={"*": 1e-3}).plot
    with refused("no-data", "arrows"):
        plots.space()


def test_a_saved_result_says_what_it_said(result: lc.Result, saved: lc.SavedResult) -> None:
    assert saved.converged is result.converged is True
    assert saved.verdict == result.verdict
    assert saved.verdict is not None
    assert saved.verdict.headline in " ".join(saved.summary().split())
    assert saved.document.title == "Planar two-link arm, poor sensor at the first joint"
    assert saved.to_dict()["parameters"] == result.to_dict()["parameters"]
    assert same(saved.sd, result.sd)
    assert same(saved.covariance, result.covariance)
    poses = {"phi2": [0.3], "phi3": [1.0]}
    assert same(saved.predict(poses).outputs, result.predict(poses).outputs)
    assert same(lc.predict(saved.path.parent, poses).sd, result.predict(poses).sd)


def test_a_saved_result_is_not_saved_again(saved: lc.SavedResult, tmp_path: Path) -> None:
    with refused("unsupported", str(saved.path.parent)):
        saved.save(tmp_path)


def test_a_result_without_a_project_is_saved_and_judged_too(tmp_path: Path) -> None:
    project = lc.read_project(EXAMPLE)
    loaded = lc.load_dataset(project)
    found = lc.calibrate(project.mechanism, loaded.dataset, noise=loaded.noise)
    found.save(tmp_path, report=False)
    assert not (tmp_path / "report.html").exists()
    read = lc.read_result(tmp_path / "result.json")
    assert read.verdict == found.verdict
    assert read.document.title is None


def test_commands_of_a_result_saved_in_the_working_directory_name_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    project = lc.read_project(EXAMPLE)
    loaded = lc.load_dataset(project)
    data = {q: np.array(loaded.dataset[q]) for q in loaded.dataset.readings}
    data["xP"][len(loaded.dataset) // 2 :] += 0.05  # the instrument moves: a finding to look at
    monkeypatch.chdir(tmp_path)
    lc.write_result(lc.calibrate(project.mechanism, data, noise=loaded.noise), ".")
    steps = [one.next for one in lc.read_result(tmp_path).document.findings]
    assert "loopcal report ." in [step.command for step in steps if step]


def test_names_of_other_libraries_mean_the_same_here(
    result: lc.Result, saved: lc.SavedResult
) -> None:
    guesses: dict[str, Any] = {
        # scipy.optimize
        "success": result.status.converged,
        "message": result.status.message,
        "nit": result.status.iterations,
        "x": [result.value[n] for n in result.estimated],
        # lmfit
        "best_values": result.value,
        "values": result.value,
        "init_values": {n: result.mechanism.parameters[n].nominal for n in result.estimated},
        "var_names": None,
        "nvarys": len(result.estimated),
        "covar": result.covariance,
        "chisqr": result.chi_squared and result.chi_squared.value,
        "redchi": result.chi_squared and result.chi_squared.variance_factor,
        "best_fit": None,
        # statsmodels
        "cov": result.covariance,
        "bse": result.sd,
        "stderr": result.sd,
        "nobs": len(result.dataset),
        "fittedvalues": {n: result.dataset[n] + d for n, d in result.differences_after.items()},
    }
    called = {"fit_report", "cov_params", "conf_int", "to_pandas", "to_polars"}
    called |= {"to_dataframe"}
    assert set(ALIASES) == {*guesses, *called}
    assert len(ALIASES) >= 20
    every: list[Any] = [result, saved]
    for its in every:
        for name, value in guesses.items():
            found = getattr(its, name)
            assert value is None or same(found, value), name
        assert list(its.var_names) == list(result.estimated)
        assert same(its.cov_params(), result.covariance)
        assert its.fit_report() == its.summary()
        low, high = its.conf_int()["l2"]
        assert low < result.value["l2"] < high
        assert its.to_polars().height == its.to_pandas().shape[0] == len(result.params)


def test_an_interval_of_other_libraries_is_that_of_the_covariance(result: lc.Result) -> None:
    given = lc.intervals(result, "l2")["l2"]
    assert given is not None
    found: Any = result
    assert found.conf_int(0.05)["l2"] == pytest.approx([given.low, given.high], rel=1e-9)
    wide, narrow = (np.ptp(found.conf_int(alpha)["l2"]) for alpha in (0.01, 0.32))
    assert wide > 2.0 * narrow


@pytest.mark.parametrize("name", INSTEAD)
def test_a_name_that_means_something_else_is_refused_with_what_to_use(
    result: lc.Result, name: str
) -> None:
    assert not hasattr(result, name)
    with pytest.raises(AttributeError, match="use "):
        getattr(result, name)


def test_an_unknown_name_is_an_attribute_error(result: lc.Result) -> None:
    with pytest.raises(AttributeError, match="no_such"):
        _ = getattr(result, "no_such")  # noqa: B009
    assert copy.copy(result).value == result.value


def test_a_verdict_that_fails_says_what_failed_in_it(
    result: lc.Result, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not that a result has no verdict."""

    def failing(*_: Any) -> Any:
        return result.parts.no_such  # type: ignore[attr-defined]

    monkeypatch.setattr("loopcal.workflow.result.judged", failing)
    with pytest.raises(AttributeError, match="no attribute 'no_such'"):
        _ = replace(result).verdict


def test_a_table_of_parameters_can_be_pickled(result: lc.Result) -> None:
    assert pickle.loads(pickle.dumps(result.params)).entries == result.params.entries


def test_a_notebook_shows_what_it_showed() -> None:
    """Of a verdict with all answers, so that its words elsewhere may change."""
    answers = (
        lc.Answer(True, "sound", None, "It converged.", None),
        lc.Answer(
            False, "extrapolates", 6.0, "Valid near the measured poses only.", "Measure < 9."
        ),
        lc.Answer(None, "not-validated", None, "No other poses were predicted.", None),
        lc.Answer(None, "no-tolerance", None, "No tolerance is stated.", None),
    )
    verdict = lc.Verdict(*answers, headline="Valid near the measured poses only.")
    found = fit_document(lc.calibrate(EXAMPLE, method="implicit-loop"))
    shown = result_html(replace(found, verdict=verdict, warnings=("Mind the step.",)))
    golden.check("notebook.html", shown.replace("><", ">\n<"))


def test_what_a_notebook_shows_is_escaped() -> None:
    def rod(x: Any, p: Any) -> list[Any]:
        return [p.long - x.length]

    arm = lc.Mechanism.from_function(rod, {"length": "m"}, {"long": (1.0, "m")}, name="<b>x</b>")
    assert "<b>x" not in lc.calibrate(arm, {"length": [1.1, 1.2]}, noise={"*": 1e-3})._repr_html_()


def test_frames_are_read_in_the_units_stated(result: lc.Result) -> None:
    poses = {"phi2": [17.0, 20.0], "phi3": [57.0, 60.0]}
    expected = result.predict({q: np.radians(v) for q, v in poses.items()}).outputs
    import pandas as pd

    for table in (poses, pl.DataFrame(poses), pd.DataFrame(poses)):
        assert same(lc.predict(result, table, units={"phi?": "deg"}).outputs, expected)
