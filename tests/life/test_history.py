"""A machine over time: drift rates, limits, and what the commands add."""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

import loopcal as lc
from loopcal.files.history.folder import append_entry
from loopcal.life.history import chart, drift_rate
from loopcal.report.life_pages import history_html
from tests.command_line import run_here as run
from tests.life.test_updating import PROJECT


def test_a_drift_rate_is_found_in_the_mean() -> None:
    """Random walks of 20 calibrations: the mean learnt variance is the true one."""
    rng, t = np.random.default_rng(1), np.linspace(0.0, 5.0, 20)
    squares = []
    for _ in range(150):
        walk = np.concatenate([[0.0], np.cumsum(rng.normal(0.0, 0.3 * np.sqrt(np.diff(t))))])
        y = walk + rng.normal(0.0, 0.1, len(t))
        squares.append(drift_rate(t, y, np.full(len(t), 0.1)) ** 2)
    assert np.mean(squares) == pytest.approx(0.09, rel=0.15)


def test_a_machine_that_does_not_drift_has_no_rate_half_of_the_time() -> None:
    rng, t = np.random.default_rng(2), np.linspace(0.0, 5.0, 8)
    rates = [drift_rate(t, rng.normal(0.0, 1.0, 8), np.ones(8)) for _ in range(100)]
    assert np.mean(np.array(rates) == 0.0) > 0.4
    assert np.median(rates) < 0.2


def test_limits_hold_a_steady_accuracy_and_not_one_that_has_doubled() -> None:
    rng = np.random.default_rng(3)
    steady = [chart(rng.normal(1.0, 0.1, 12)) for _ in range(200)]
    assert np.mean([its.outside for its in steady if its]) < 0.03
    worse = chart([1.0, 1.1, 0.9, 1.0, 1.05, 0.95, 1.0, 2.0, 2.1, 1.9])
    assert worse is not None
    assert worse.outside
    assert chart([1.0, 2.0]) is None


def test_a_history_states_the_drift_since_its_last_calibration(tmp_path: Path) -> None:
    """The random walk of two sds in a year: half of it after a quarter of a year."""
    begin = datetime(2026, 1, 1, tzinfo=UTC)
    for i, value in enumerate([0.0, 2e-4, -1e-4, 3e-4, 1e-4]):
        its = {"l2": {"value": 0.8 + value, "sd": 1e-6, "unit": "m", "kind": "length"}}
        content = {"words": "ok", "rms": None, "parameters": its}
        append_entry(tmp_path, "calibration", content, time=begin + timedelta(days=365.25 * i))
    found = lc.history(tmp_path)
    (trend,) = found.trends
    later = begin + timedelta(days=365.25 * 4.25)
    assert trend.rate is not None
    assert found.drift(later) == {"l2": pytest.approx(0.5 * trend.rate)}
    assert found.drift(begin) == {"l2": 0.0}


def test_commands_add_what_they_found(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text(PROJECT)
    out, folder = str(tmp_path / "a.csv"), str(tmp_path / "m.history")
    assert run("simulate", str(tmp_path / "a.toml"), "--out", out, "--seed", "1").returncode == 0
    kept = ("--history", folder)
    assert run("calibrate", str(tmp_path / "a.toml"), "--no-report", *kept).returncode == 0
    result = str(tmp_path / "a-result")
    assert run("verify", result, out, *kept).returncode == 0
    done = run("history", folder, "--event", "<b>collision</b>", "--json")
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    kinds = [entry["kind"] for entry in document["entries"]]
    assert kinds == ["calibration", "verification", "event"]
    assert {trend["name"] for trend in document["trends"]} >= {"l2", "l3"}
    assert not {trend["name"] for trend in document["trends"]} & {"xA", "yA"}
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
