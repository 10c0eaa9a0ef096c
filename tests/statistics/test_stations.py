"""The sd of a prediction is that of one instrument, from one station."""

from __future__ import annotations

import numpy as np
import pytest

import loopcal as lc
from analyses.instruments import ARM_VALUES, six_axis
from loopcal.mechanisms.instruments.point import point
from loopcal.mechanisms.machine import assemble
from loopcal.mechanisms.mechanism import Mechanism
from tests.estimation.test_contacts import READINGS


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
    stored = lc.findings(result).added_to(result.document).prediction
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
