"""A machine over time: drift rates, limits, and what the commands add."""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

import loopcal as lc
from loopcal.companions.life.history import chart
from loopcal.companions.life.history_folder import append_entries, read_entries
from loopcal.companions.life.pages import history_figures, history_html
from loopcal.document.result_document import UPDATED
from tests.command_line import run_here as run
from tests.life.test_updating import PROJECT
from tests.refusals import refused


def test_limits_hold_a_steady_accuracy_and_not_one_that_has_doubled() -> None:
    rng = np.random.default_rng(3)
    steady = [chart(rng.normal(1.0, 0.1, 12)) for _ in range(200)]
    assert np.mean([its.outside for its in steady if its]) < 0.03
    worse = chart([1.0, 1.1, 0.9, 1.0, 1.05, 0.95, 1.0, 2.0, 2.1, 1.9])
    assert worse is not None
    assert worse.outside
    assert chart([1.0, 2.0]) is None


BEGIN = datetime(2026, 1, 1, tzinfo=UTC)


def _add(folder: Path, values: dict[str, float], day: float | None, unit: str = "m") -> None:
    """A calibration measured so many days after the begin, all processed on one day."""
    its = {n: {"value": v, "sd": 1e-6, "unit": unit, "kind": "length"} for n, v in values.items()}
    content: dict[str, object] = {"words": "ok", "rms": None, "parameters": its}
    if day is not None:
        text = f"{BEGIN + timedelta(days=day):%Y-%m-%d}"
        content["measured"] = {"first": text, "last": text}
    append_entries(folder, [("calibration", content)])


def _event(folder: Path, words: str, day: float) -> None:
    append_entries(folder, [("event", {"words": words})], time=BEGIN + timedelta(days=day))


def test_a_history_states_the_drift_since_its_last_calibration(tmp_path: Path) -> None:
    """The random walk of two sds in a year: half of it after a quarter of a year."""
    for i, value in enumerate([0.0, 2e-4, -1e-4, 3e-4, 1e-4]):
        _add(tmp_path, {"l2": 0.8 + value}, 365.25 * i)
    found = lc.history(tmp_path)
    (trend,) = found.trends
    later = BEGIN + timedelta(days=365.25 * 4.25)
    assert trend.rate is not None
    assert found.drift(later) == {"l2": pytest.approx(0.5 * trend.rate, rel=1e-3)}
    assert found.drift(BEGIN) == {"l2": 0.0}


def test_measurements_without_a_date_have_no_rate(tmp_path: Path) -> None:
    """Eight calibrations in half a minute: 40 um are a change, not 66 mm in a year."""
    rng = np.random.default_rng(1)
    for i in range(8):
        _add(tmp_path, {"l2": 0.8 + 5e-6 * i + 1e-6 * rng.standard_normal()}, None)
    found = lc.history(tmp_path)
    (trend,) = found.trends
    assert found.changes
    assert trend.rate is None
    assert all(change.year is None and change.days is None for change in found.changes)
    assert not found.drift()
    assert "Date of measurement unknown" in str(found)


@pytest.mark.parametrize(("apart", "yearly"), [(0.0, False), (5.0, False), (91.0, True)])
def test_a_rate_needs_half_a_year(tmp_path: Path, apart: float, yearly: bool) -> None:
    rng = np.random.default_rng(2)
    for i in range(8):
        _add(tmp_path, {"l2": 0.8 + 5e-6 * i + 1e-6 * rng.standard_normal()}, apart * i)
    found = lc.history(tmp_path)
    (trend,), (change,) = found.trends, found.changes
    assert change.way == "drift"
    assert change.size == pytest.approx(35e-6, abs=3e-6)
    assert (change.days is not None) == (apart > 0.0)
    assert (change.year is not None) == yearly == (trend.rate is not None)
    if change.year is not None and change.year_half is not None:
        assert abs(change.year - 5e-6 * 365.25 / 91.0) <= change.year_half


def test_a_step_at_a_collision_is_a_step(tmp_path: Path) -> None:
    """It is dated and attributed; neither it nor the calibrations around it become a rate."""
    rng = np.random.default_rng(3)
    for i in range(8):
        values = {n: 0.8 + 1e-6 * rng.standard_normal() for n in ("a_2", "a_3")}
        values["a_3"] -= 40e-6 if i > 5 else 0.0
        _add(tmp_path, values, 91.0 * i)
    _event(tmp_path, "collision", 500.0)
    found = lc.history(tmp_path)
    (step,) = found.changes
    assert (step.causes, step.way, step.after, step.before) == (("a_3",), "step", 6, 7)
    assert step.event == "collision"
    assert step.half is not None
    assert abs(step.size + 40e-6) <= step.half
    assert step.year is None
    # without the step, what is left is as steady as the other parameter
    trend = next(one for one in found.trends if one.name == "a_3")
    assert trend.rate is not None
    assert trend.rate < 5e-6
    days = [entry.kind for entry in found.shown]
    assert days.index("event") == 6
    assert [found.marks(entry) for entry in found.shown][6:8] == ["event", "changed: a_3"]
    assert lc.History.from_document(found.document()).changes == found.changes
    assert "diamond" in history_html(found)


def _joint(folder: Path, values: tuple[float, float], day: float, model: str = "") -> None:
    """A calibration that knows two lengths to 1 mm, and their sum to 10 um."""
    names, C = ("a", "b"), [[1e-6], [-1e-6 + 5e-11, 1e-6]]
    its = {
        n: {"value": v, "sd": 1e-3, "unit": "m", "role": "length", "owner": ""}
        for n, v in zip(names, values, strict=True)
    }
    joint: dict[str, object] = {"names": names, "covariance": C, "moves": [[0.25], [0.25, 0.25]]}
    joint |= {"zeros": {"arm": [0.3, -0.1]}, "units": {"arm": "rad"}}
    text = f"{BEGIN + timedelta(days=day):%Y-%m-%d}"
    measured = {"first": text, "last": text}
    content = {"words": "ok", "rms": None, "parameters": its, "joint": joint, "model": [model]}
    append_entries(folder, [("calibration", {**content, "measured": measured})])


def _days_of_two(folder: Path, model: str = "") -> None:
    """A step of the first by 0.2 mm, before the fifth of eight."""
    rng, C = np.random.default_rng(5), np.array([[1e-6, -1e-6 + 5e-11], [-1e-6 + 5e-11, 1e-6]])
    for i in range(8):
        a, b = rng.multivariate_normal([0.5 + 2e-4 * (i > 3), 0.3], C)
        _joint(folder, (a, b), 91.0 * i, model if i > 3 else "")


def test_a_change_that_moves_no_parameter_by_its_sd_is_found_and_all_its_causes_are_named(
    tmp_path: Path,
) -> None:
    _days_of_two(tmp_path)
    found = lc.history(tmp_path)
    (step,) = found.changes
    assert (step.way, step.after, step.before) == ("step", 4, 5)
    assert {"a", "b"} <= set(step.causes)
    # half the change of the sum, by `moves`
    assert step.moved == pytest.approx(1e-4, abs=1e-5)
    assert step.moved is not None
    assert step.moved_half is not None
    assert abs(step.moved - 1e-4) <= step.moved_half
    table = str(found).partition("what ")[2]
    assert step.name in table
    assert "mm" in table
    assert json.loads(json.dumps(found.document()))["changes"][0]["causes"] == [*step.causes]


def test_a_change_beside_another_choice_of_terms_is_not_taken_for_one(tmp_path: Path) -> None:
    _days_of_two(tmp_path, "sag")
    found = lc.history(tmp_path)
    assert found.changes == ()
    assert "chose different terms" in str(found)


def test_an_update_is_no_other_choice_of_terms(tmp_path: Path) -> None:
    _days_of_two(tmp_path, UPDATED)
    found = lc.history(tmp_path)
    assert [one.way for one in found.changes] == ["step"]
    assert "chose different terms" not in str(found)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("names", ["a"]),
        ("covariance", [[1.0]]),
        ("covariance", [[0.0], [0.0, 0.0]]),
        ("moves", [[1.0], [1.0, "x"]]),
        ("zeros", {"arm": [1.0]}),
        ("units", {"arm": "furlong"}),
    ],
)
def test_an_entry_that_says_nothing_of_its_parameters_together_is_skipped(
    tmp_path: Path, key: str, value: object
) -> None:
    _joint(tmp_path, (0.5, 0.3), 0.0)
    (entry,) = read_entries(tmp_path).whole
    joint = {**entry.content["joint"], key: value}
    append_entries(tmp_path, [("calibration", {**entry.content, "joint": joint})])
    assert len(read_entries(tmp_path).skipped) == 1


def test_each_unit_has_its_own_figure(tmp_path: Path) -> None:
    for i in range(2):
        for name, unit in (("k", "N"), ("g", "1"), ("l", "m")):
            _add(tmp_path / "all", {name: float(i)}, 400.0 * i, unit)
    keys = [figure.key for figure in history_figures(lc.history(tmp_path / "all"))]
    assert len(keys) == len(set(keys)) == 3


def test_limits_are_exceeded_by_few_steady_machines() -> None:
    """Of all entries of a chart, not of the last alone."""
    rng = np.random.default_rng(4)
    for number in (5, 20):
        charts = [chart(rng.normal(1.0, 0.1, number)) for _ in range(300)]
        assert np.mean([any(one.beyond) for one in charts if one]) <= 0.05


def test_commands_add_what_they_found(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text(PROJECT)
    out, folder = str(tmp_path / "a.csv"), str(tmp_path / "m.history")
    assert run("simulate", str(tmp_path / "a.toml"), "--out", out, "--seed", "1").returncode == 0
    kept = ("--history", folder)
    assert run("calibrate", str(tmp_path / "a.toml"), "--no-report", *kept).returncode == 0
    result = str(tmp_path / "a-result")
    assert run("verify", result, out, *kept, "--date", "2026-03-01").returncode == 0
    assert run("verify", result, out, "--date", "2026-03-01").returncode == 2
    assert run("verify", result, out, *kept, "--date", "in March").returncode == 2
    longer = PROJECT + '[parameters]\nl2 = { value = 0.84, unit = "m" }\n'
    (tmp_path / "b.toml").write_text(longer)
    later = str(tmp_path / "b.csv")
    assert run("simulate", str(tmp_path / "b.toml"), "--out", later, "--seed", "2").returncode == 0
    mixed = run("update", result, later, *kept, "--no-report", "--drift", "l3=1um")
    assert (mixed.returncode, "not in the history" in mixed.stderr) == (4, True), mixed.stderr
    done = run("history", folder, "--event", "<b>collision</b>", "--json")
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    kinds = [entry["kind"] for entry in document["entries"]]
    assert kinds == ["calibration", "verification", "event"]
    assert [entry["content"]["measured"] for entry in document["entries"]] == [
        None,
        {"first": "2026-03-01", "last": "2026-03-01"},
        None,
    ]
    assert {trend["name"] for trend in document["trends"]} >= {"l2", "l3"}
    assert not {trend["name"] for trend in document["trends"]} & {"xA", "yA"}
    its, joint = (document["entries"][0]["content"][key] for key in ("parameters", "joint"))
    assert joint["names"] == [*its]
    variances = [row[-1] for row in joint["covariance"]]
    assert variances == pytest.approx([one["sd"] ** 2 for one in its.values()])
    assert joint["moves"][0][0] > 0.0
    page = (tmp_path / "m.history.html").read_text()
    assert "<b>collision" not in page
    assert "http://" not in page.split("<script", maxsplit=1)[0]
    found = lc.history(folder)
    assert "collision" in str(found)
    assert "Accuracy over time" in history_html(found)
    damaged = next(Path(folder).glob("*-0001.json"))
    damaged.write_text(damaged.read_text()[:100])
    assert damaged.name in run("history", folder).stdout
    assert run("history", str(tmp_path / "nowhere")).returncode == 3
    assert run("history", folder, "--event", " ").returncode == 3


def _days(folder: Path) -> list[object]:
    return [entry.content["measured"] for entry in lc.history(folder).entries.whole]


def test_the_day_is_that_of_the_readings_then_of_the_project(tmp_path: Path) -> None:
    """An option comes first; an update has other readings, so the project's day is not its own."""
    project, readings = tmp_path / "a.toml", tmp_path / "a.csv"
    folder, result = tmp_path / "m.history", str(tmp_path / "a-result")
    project.write_text(PROJECT + '\n[record]\ndate = "2026-01-05"\n')
    assert run("simulate", str(project), "--out", str(readings), "--seed", "1").returncode == 0
    kept = ("--no-report", "--history", str(folder))
    assert run("calibrate", str(project), *kept).returncode == 0
    assert run("update", result, str(readings), *kept).returncode == 0
    header, *rows = readings.read_text().splitlines()
    lines = [f"{header},at", *(f"{row},2026-02-03T10:00:00" for row in rows)]
    readings.write_text("\n".join(lines) + "\n")
    assert run("calibrate", str(project), *kept).returncode == 0
    assert run("update", result, str(readings), *kept).returncode == 0
    assert run("calibrate", str(project), *kept, "--date", "2026-05-01").returncode == 0
    assert run("verify", result, result, "--history", str(folder)).returncode == 0
    firsts = [None if one is None else one["first"] for one in _days(folder)]  # type: ignore[index]
    column = "2026-02-03"
    assert firsts == ["2026-01-05", None, column, column, "2026-05-01", column]


def test_the_folder_of_a_result_is_no_history(tmp_path: Path) -> None:
    (tmp_path / "result.json").write_text("{}", "utf-8")
    with refused("wrong-file-type", "result", str(tmp_path)):
        read_entries(tmp_path)
