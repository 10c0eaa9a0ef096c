"""Machines of one type: mean and spread, unusual machines, and the start of the next one."""

from __future__ import annotations

import json
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import loopcal as lc
from analyses.fleet import POSES, drawn, fleets
from loopcal.companions.life.fleet import learn
from loopcal.companions.life.measured_machine import MeasuredMachine, machine_parameters
from loopcal.companions.life.spread import Spread
from loopcal.statistics.calibrated import Calibrated
from tests.command_line import run_here as run
from tests.life.test_updating import PROJECT, straight
from tests.refusals import refused


def spreads(machines: int, ratio: float, draws: int = 250) -> list[Spread]:
    """Of one parameter whose true spread is `ratio`, found with sds of about 1."""
    rng, found = np.random.default_rng(machines), []
    for _ in range(draws):
        v = rng.uniform(0.5, 2.0, machines)
        found.append(Spread.of(rng.normal(0.0, np.sqrt(ratio**2 + v)), v))
    return found


@pytest.mark.parametrize("machines", [3, 5, 10])
def test_the_spread_is_found_without_bias_and_its_interval_holds(machines: int) -> None:
    found = spreads(machines, 4.0)
    variances = np.array([one.variance for one in found])
    assert variances.mean() == pytest.approx(16.0, abs=3.0 * variances.std() / np.sqrt(len(found)))
    assert np.mean([one.low <= 4.0 <= one.high for one in found]) == pytest.approx(0.95, abs=0.045)


def test_where_machines_are_alike_the_spread_is_bounded() -> None:
    found = spreads(5, 0.0)
    assert np.mean([one.low == 0.0 for one in found]) > 0.94
    assert np.mean([one.variance == 0.0 for one in found]) > 0.4


def test_without_errors_of_calibration_one_more_machine_has_students_t() -> None:
    from scipy.stats import t

    y = np.array([1.0, 1.3, 0.8, 1.1])
    one = Spread.of(y, np.full(4, 1e-20))
    assert one.variance == pytest.approx(np.var(y, ddof=1), rel=1e-6)
    apart = np.std(y, ddof=1) * np.sqrt(1.25)
    for z in (0.5, 2.0, 6.0):
        expected = 2.0 * t.sf(z, 3)
        assert one.tail(y.mean() + z * apart, 0.0) == pytest.approx(expected, rel=0.02)
    assert one.predictive_sd == pytest.approx(t.ppf(0.975, 3) * apart / 1.96, rel=0.02)


@pytest.mark.parametrize(("machines", "draws"), [(3, 40), (5, 30), (10, 12)])
def test_few_machines_that_are_alike_are_called_unusual(machines: int, draws: int) -> None:
    alarms = [bool(found.unusual) for found in fleets(machines, 3.0, draws)]
    assert np.mean(alarms) <= 0.05 + 2.0 * np.sqrt(0.05 * 0.95 / draws)


def test_a_machine_ten_spreads_off_is_found_and_its_parameter_named() -> None:
    found = fleets(10, 3.0, 4, outlier=(10.0,))
    assert all(one.unusual[0].name == "m0" for one in found)
    assert all(one.machines[0].outstanding == ("l2",) for one in found)
    assert "unusual: l2" in str(found[0])


def test_a_calibration_that_began_from_a_prior_says_what_its_readings_alone_say() -> None:
    line = straight()
    rng = np.random.default_rng(0)
    q = rng.uniform(0.0, 1.0, 20)
    data = {"q": q, "y": 1.1 * q + 0.2 + 1e-2 * rng.standard_normal(20)}
    noise = lc.Noise({"q": 0.0, "y": 1e-2})
    told = line.with_parameters(line.parameters.with_prior({"a": 0.1, "b": 0.2}))
    alone, begun = (
        MeasuredMachine.of(
            Calibrated.of(lc.calibrate(m, data, noise=noise, method="implicit-loop"), ""), 20
        )
        for m in (line, told)
    )
    assert begun.values == pytest.approx(alone.values, rel=1e-8)
    assert begun.covariance == pytest.approx(alone.covariance, rel=1e-8)


def test_the_next_machine_needs_fewer_poses_from_the_fleet() -> None:
    """Arms that are as alike as a calibration can see: poses and sds as they were foretold."""
    rng, results = np.random.default_rng(3), []
    noise = lc.Noise({"xP": 1e-4, "yP": 1e-4, "phi2": 1e-4, "phi3": 1e-4})
    for seed in range(7):
        l2, l3 = np.array([0.81, 0.59]) + 1e-5 * rng.standard_normal(2)
        arm = lc.planar_two_link({"l2": l2, "l3": l3, "xA": rng.normal(), "phi20": rng.normal()})
        joints = dict(zip(("phi2", "phi3"), rng.uniform(-2.0, 2.0, (2, POSES)), strict=True))
        data = lc.simulate(arm, joints, noise=noise, seed=seed).dataset
        results.append((arm, data))
    found = lc.fleet(
        [lc.calibrate(a, d, noise=noise, method="implicit-loop") for a, d in results[:6]]
    )
    assert [p.name for p in found.parameters] == ["l2", "l3", "phi30"]
    assert not found.unusual
    assert found.poses < 0.8 * found.alone
    assert found.alone == pytest.approx(POSES, abs=4)
    arm, data = results[6]
    new = lc.calibrate(
        found.started(arm), data.take(np.arange(found.poses)), noise=noise, method="implicit-loop"
    )
    whole = lc.calibrate(arm, data, noise=noise, method="implicit-loop")
    for p in found.parameters:
        assert float(new.sd[p.name] or 0.0) < 1.15 * float(whole.sd[p.name] or 0.0)


def test_results_that_cannot_be_compared_are_refused() -> None:
    machines = drawn(np.full((3, 3), 0.5), np.random.default_rng(1))
    with refused("too-few-results", "2"):
        learn(machines[:2])
    with refused("mismatched-machines", "planar-two-link"):
        learn((*machines[:2], replace(machines[2], mechanism=lc.motoman_ma1400())))
    with refused("mismatched-machines", "l9"):
        learn((*machines[:2], replace(machines[2], names=("l2", "l9", "phi30"))))
    held = np.array([True, False, False])
    with refused("mismatched-machines", "l2"):
        learn(tuple(replace(one, fixed=held) for one in machines))
    with refused("duplicate-name", "m0"):
        learn((*machines[:2], replace(machines[2], data="data 0")))
    with refused("duplicate-name", "m1"):
        learn((*machines[:2], replace(machines[1], data=None)))
    loose = replace(machines[2], determined=~held)
    assert "left out: l2 (not determined in 'm2')" in str(learn((*machines[:2], loose)))
    with refused("no-free-parameter"):
        learn((*machines[:2], replace(machines[2], determined=np.zeros(3, dtype=bool))))


def test_a_structured_model_error_leaves_the_parameters_of_the_machine_the_same() -> None:
    arm = lc.motoman_ma1400()
    names = machine_parameters(arm)
    assert machine_parameters(lc.structured(arm, discrepancy=True)) == names
    assert set(names) < set(arm.parameters.names)


def test_angles_a_turn_apart_are_the_same() -> None:
    machines = drawn(np.tile([0.8, 0.6, 0.01], (3, 1)), np.random.default_rng(1))
    values = machines[2].values + np.array([0.0, 0.0, 2.0 * np.pi])
    turned = learn((*machines[:2], replace(machines[2], values=values)))
    assert turned.parameters[2].spread == pytest.approx(learn(machines).parameters[2].spread)


def test_the_command_writes_where_the_next_project_begins(tmp_path: Path) -> None:
    results = [str(tmp_path / f"machine{i}") for i in range(3)]
    noise = lc.Noise({"xP": 1e-4, "yP": 1e-4, "phi2": 1e-3, "phi3": 1e-3})
    rng = np.random.default_rng(1)
    for i, out in enumerate(results):
        arm = lc.planar_two_link({"l2": 0.8, "l3": 0.6})
        joints = dict(zip(("phi2", "phi3"), rng.uniform(-1.5, 1.5, (2, POSES)), strict=True))
        data = lc.simulate(arm, joints, noise=noise, seed=i).dataset
        found = lc.calibrate(arm, data, noise=noise, method="implicit-loop")
        lc.write_result(found, out, report=False)
    start = tmp_path / "fleet.toml"
    done = run("fleet", *results, "--out", str(start), "--json")
    assert done.returncode == 0, done.stderr
    assert "Machines beside each other" in (tmp_path / "fleet.html").read_text()
    document = json.loads(done.stdout)
    assert document["next_machine"]["with_fleet"] <= document["next_machine"]["alone"]
    its = {p["name"]: p for p in document["parameters"]}
    written = tomllib.loads(start.read_text())
    assert written["parameters"]["l2"] == {"value": its["l2"]["mean"], "unit": "m"}
    assert written["prior"]["l2"] == {"sd": its["l2"]["prior_sd"], "unit": "m"}
    new = PROJECT + start.read_text()
    (tmp_path / "new.toml").write_text(new)
    begun = lc.read_project(tmp_path / "new.toml").mechanism.parameters["l2"]
    assert (begun.nominal, begun.prior_sd) == (its["l2"]["mean"], its["l2"]["prior_sd"])
    again = lc.fleet([lc.read_result(one) for one in results])
    assert isinstance(again, lc.Fleet)
    assert json.loads(json.dumps(again.document())) == document
    assert run("fleet", *results[:2]).returncode == 3
