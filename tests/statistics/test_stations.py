"""The sd of a prediction is that of one instrument, from one station."""

from __future__ import annotations

import numpy as np
import pytest

import loopcal as lc
from analyses.instruments import ARM_VALUES, six_axis
from loopcal.mechanisms.instruments.point import point
from loopcal.mechanisms.machine import assemble
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.planar import planar_machine
from tests.estimation.test_contacts import READINGS
from tests.refusals import refused


def stations(*names: str) -> Mechanism:
    """A six-axis arm whose end point so many trackers see, each from its own station."""
    seen = [
        point(name, readings=[f"{a}_{name}" for a in "xyz"], station=name, target="tool")
        for name in names
    ]
    return assemble(six_axis(), seen, ARM_VALUES)


def test_the_sd_of_a_prediction_is_that_of_one_position_however_many_stations_see_it() -> None:
    """Five trackers formerly had the root of the sum over all five, sqrt(5) too large."""
    names = ("a", "b", "c", "d", "e")
    arm = stations(*names)
    noise = lc.Noise({"q*": 1e-5, "[xyz]_*": 1e-4})
    prior = lc.Prior({"*": 1e-4})
    data = lc.simulate(arm, READINGS, noise=noise, seed=1).dataset
    result = lc.calibrate(
        arm, data, noise=noise, prior=prior, start="nominal", method="implicit-loop"
    )
    found = lc.predict(result, {q: values[:4] for q, values in READINGS.items()})
    table = found.columns()
    for i, name in enumerate(names):
        own = found.covariance[:, 3 * i : 3 * i + 3, 3 * i : 3 * i + 3]
        expected = np.sqrt(np.trace(own, axis1=1, axis2=2))
        assert np.asarray(table[f"sd of {name} [m]"], float) == pytest.approx(expected, rel=1e-12)
        of_name = found.document()["poses"][0]["by"][i]
        assert of_name["station"] == name
        assert of_name["sd"] == pytest.approx(expected[0], rel=1e-12)
    assert "sd [m]" not in table
    usual = lc.findings(result).predictor
    assert usual is not None
    assert [(one.instrument, one.station, one.unit) for one in usual.usual] == [
        (name, name, "m") for name in names
    ]
    # the stations stand alike: no instrument's sd is the sum over all of them
    sds = np.array([one.sd for one in usual.usual])
    assert sds.max() < 1.5 * sds.min()
    before = lc.check(arm, data, noise=noise, prior=prior, start="nominal")
    assert len(before.expected_at_poses) == len(names)
    assert "as e sees it" in str(before)
    stored = result.document.prediction
    assert stored is not None
    assert stored.sd_at_poses == {"m": sds.max()}


def test_one_instrument_keeps_its_columns() -> None:
    arm = stations("a")
    noise = lc.Noise({"q*": 1e-5, "[xyz]_*": 1e-4})
    prior = lc.Prior({"*": 1e-4})
    data = lc.simulate(arm, READINGS, noise=noise, seed=1).dataset
    result = lc.calibrate(
        arm, data, noise=noise, prior=prior, start="nominal", method="implicit-loop"
    )
    found = lc.predict(result, {q: values[:4] for q, values in READINGS.items()})
    assert {"sd [m]", "sd from parameters [m]", "sd from readings [m]"} <= set(found.columns())


def test_a_station_left_out_is_placed_by_its_own_readings() -> None:
    arm = stations("a", "b", "c")
    noise = lc.Noise({"q*": 1e-6, "[xyz]_*": 1e-4})
    standing = [n for family in arm.families for n in family.standing]
    prior = lc.Prior({n: 1e-3 for n in arm.parameters.names if n not in standing})
    draw = np.random.default_rng(5)
    truth = {
        p.name: p.nominal + draw.normal(0.0, 0.05 if p.name in standing else 1e-3)
        for p in arm.parameters
        if not p.fixed
    }
    poses = {q: np.random.default_rng(i).uniform(-1, 1, 90) for i, q in enumerate(READINGS)}
    data = lc.simulate(arm, poses, noise=noise, seed=2, truth=truth).dataset
    seen_by = [name for name in "abc" for _ in range(30)]
    data = data.with_readings(
        {
            f"{axis}_{name}": np.where(np.array(seen_by) == name, data[f"{axis}_{name}"], np.nan)
            for axis in "xyz"
            for name in "abc"
        }
    )
    found = lc.validate(
        arm,
        data,
        noise=noise,
        prior=prior,
        method="implicit-loop",
        groups=seen_by,
        place_anew=True,
    )
    assert found.failed == ()
    assert found.parts == 3
    assert "placed by the readings of the group" in found.words
    assert found.accuracy is not None
    assert 1.4e-4 < found.accuracy.rms < 2.5e-4
    assert found.log_likelihood is None  # the group also says where its instrument stands
    assert found.coverage is not None
    assert found.coverage.share > 0.88
    # a fit that never saw a station does not know where it stands
    apart = lc.validate(arm, data, noise=noise, prior=prior, groups=seen_by, folds=3)
    assert apart.accuracy is not None
    assert apart.accuracy.rms > 10.0 * found.accuracy.rms
    with refused("too-few-poses"):
        lc.validate(arm, data, noise=noise, prior=prior, place_anew=True)


def sessions(seed: int) -> tuple[Mechanism, lc.Dataset, list[str]]:
    """Two links seen by a camera that stood in three places, ten poses from each."""
    names = "abc"
    seen = [
        point(n, readings=[f"x_{n}", f"y_{n}"], station=n, target="tool", dimension=2)
        for n in names
    ]
    drawn = assemble(planar_machine(), seen, {"l2": 0.8, "l3": 0.6})
    draw = np.random.default_rng(seed)
    free = [p for p in drawn.parameters if not p.fixed]
    truth = {
        p.name: p.nominal + draw.normal(0.0, 0.3 if p.name[:2] in {"a_", "b_", "c_"} else 1e-3)
        for p in free
    }
    poses = {q: draw.uniform(-1.2, 1.2, 30) for q in ("phi2", "phi3")}
    data = lc.simulate(drawn, poses, noise=CAMERA, seed=seed, truth=truth).dataset
    groups = [n for n in names for _ in range(10)]
    by_group = {
        f"{axis}_{n}": np.where(np.array(groups) == n, data[f"{axis}_{n}"], np.nan)
        for axis in "xy"
        for n in names
    }
    return drawn, data.with_readings(by_group), groups


CAMERA = lc.Noise({"phi*": 1e-4, "x_*": 1e-4, "y_*": 1e-4})


def test_regions_of_groups_that_place_their_instrument_hold_as_often_as_stated() -> None:
    """15 draws of 3 groups of 10 poses, with link lengths and zeros from the other two groups."""
    held = []
    for seed in range(15):
        drawn, data, groups = sessions(seed)
        prior = lc.Prior({"l*": 1e-3, "phi*": 1e-3, "tool_*": 0.0})
        found = lc.validate(
            drawn,
            data,
            noise=CAMERA,
            prior=prior,
            groups=groups,
            place_anew=True,
            method="implicit-loop",
        )
        assert found.coverage is not None
        assert found.coverage.poses == 30
        held.append(found.coverage.share)
    assert np.mean(held) == pytest.approx(0.95, abs=0.035)


def test_poses_not_used_are_judged_by_the_learnt_sds_of_trackers_that_see_few_of_them() -> None:
    """The median sd over all poses is infinite where a tracker reads fewer than half of them."""
    arm, poses = stations("a", "b", "c"), 60
    noise = lc.Noise({"q*": 1e-5, "[xyz]_*": 1e-4})
    draw = np.random.default_rng(11)
    driven = {q: draw.uniform(-1.5, 1.5, poses) for q in READINGS}
    made = lc.simulate(arm, driven, noise=noise, seed=11).dataset
    turn = np.arange(poses) % 3
    by_turn = {
        f"{axis}_{name}": np.where(turn == i, made[f"{axis}_{name}"], np.nan)
        for axis in "xyz"
        for i, name in enumerate("abc")
    }
    trackers = [f"[xyz]_{name}" for name in "abc"]
    guess = lc.Noise(
        {"q*": 1e-5} | dict.fromkeys(trackers, 2e-5), estimate=dict.fromkeys(trackers, "group")
    )
    found = lc.validate(
        arm,
        made.with_readings(by_turn),
        noise=guess,
        prior=lc.Prior({"*": 1e-4}),
        method="implicit-loop",
        folds=5,
    )
    assert found.coverage is not None
    assert found.coverage.share > 0.88
