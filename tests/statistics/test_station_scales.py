"""Stations whose scales differ are fitted with them, and predictions allow for what none tells."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

import loopcal as lc
from loopcal.document.findings import ScaleEntry
from loopcal.estimation.fit import Fit
from loopcal.estimation.result import FitResult
from loopcal.mechanisms.effects.effect import STATION_SCALES
from loopcal.mechanisms.effects.station_scales import SD
from loopcal.statistics.case import Case
from loopcal.statistics.ordered_system import ordered_system
from loopcal.statistics.scales import scales
from loopcal.statistics.station_scales import SPREAD, with_station_scales
from tests.estimation.test_contacts import READINGS
from tests.refusals import refused
from tests.statistics.test_stations import stations

ARM = stations("a", "b")
NOISE = lc.Noise({"q*": 2e-5, "[xyz]_*": 2e-5})
PRIOR = lc.Prior({"*": 1e-3})
POSES = {q: values[:40] for q, values in READINGS.items()}
FRESH = {q: values[-20:] for q, values in READINGS.items()}
HELD = 7.815
"""Of the square of three normal numbers, held in 95 %."""


def truth(seed: int) -> dict[str, float]:
    """Parameters as the prior says."""
    rng = np.random.default_rng(seed)
    return {p.name: p.nominal + 1e-3 * rng.standard_normal() for p in ARM.parameters}


def case(seed: int, scales: tuple[float, float], **options: object) -> Case:
    """The first half of the poses seen from one station, the second from the other."""
    data = lc.simulate(ARM, POSES, noise=NOISE, seed=seed, truth=truth(seed)).dataset
    first = np.arange(len(data)) < len(data) // 2
    readings = {
        f"{axis}_{name}": np.where(seen, data[f"{axis}_{name}"] * (1.0 + scale), np.nan)
        for name, seen, scale in zip("ab", (first, ~first), scales, strict=True)
        for axis in "xyz"
    }
    fit = Fit(method="implicit-loop", prior=PRIOR, start="nominal", **options)  # type: ignore[arg-type]
    return Case(ARM, data.with_readings(readings), NOISE, fit)


def squares(result: FitResult, seed: int) -> NDArray[np.float64]:
    """Of the errors of true points, over their stated covariance, which has the joints' noise."""
    exact = lc.simulate(ARM, FRESH, noise=lc.Noise({"*": 0.0}), seed=1, truth=truth(seed)).dataset
    rng = np.random.default_rng([seed, 2])
    made = lc.predict(result, {q: v + 2e-5 * rng.standard_normal(20) for q, v in FRESH.items()})
    e = np.stack([made.outputs[f"{axis}_a"] - exact[f"{axis}_a"] for axis in "xyz"], axis=1)
    W = np.linalg.inv(made.covariance[:, :3, :3])
    return np.asarray(np.einsum("ni,nij,nj->n", e, W, e))


@cache
def fitted(scale: float, modelled: bool) -> list[FitResult]:
    """Twelve draws in which the second station measures too long."""
    made = [case(seed, (0.0, scale)) for seed in range(12)]
    return [(with_station_scales(one) if modelled else one).calibrated() for one in made]


def test_only_several_stations_get_scales_which_no_prior_of_the_user_means() -> None:
    alone = Case(stations("a"), lc.Dataset.from_arrays(POSES), None, Fit())
    assert with_station_scales(alone) is alone
    with refused("unsupported", "1 of them", "another station"):
        lc.with_effects(stations("a"), [lc.effects.StationScales()])
    robust = case(1, (0.0, 0.0), loss="huber")
    assert with_station_scales(robust) is robust
    made = with_station_scales(case(1, (0.0, 0.0)))
    assert with_station_scales(made) is made
    flat = lc.Prior({"*": math.inf}).apply(made.mechanism)
    assert flat.terms == made.mechanism.terms
    assert flat.parameters["b_scale"].prior_sd == SD
    assert math.isinf(
        flat.parameters["base_x" if "base_x" in flat.parameters.names else "a_x"].prior_sd
    )


def test_scales_that_differ_no_longer_bend_the_machine() -> None:
    """The truth of the first station is as likely as that of the second."""
    wrong, right = (
        np.mean([squares(r, i).mean() / 3.0 for i, r in enumerate(fitted(1e-4, modelled))])
        for modelled in (False, True)
    )
    # ten times the scale that instruments usually have is not wholly believed
    assert right < 0.7 * wrong


def test_the_difference_is_stated_as_if_it_were_not_in_the_fit() -> None:
    entries = [scales(ordered_system(r).fitted())[0] for r in fitted(1e-4, True)]
    assert all(isinstance(one, ScaleEntry) and one.p_value < 1e-4 for one in entries)
    z = np.array([(one.size - 1e-4) / one.sd for one in entries])
    # A mean square of 12 normal numbers is below this but once in 10,000 times.
    assert np.square(z).mean() < 3.1


def test_true_points_are_in_their_stated_regions_whatever_the_scales_are() -> None:
    """Scales of 60 pairs of instruments drawn as the prior says."""
    rng = np.random.default_rng(7)
    held = []
    for seed in range(60):
        sd = SD * math.exp(SPREAD * rng.standard_normal())
        first, second = (sd * rng.standard_normal(2)).tolist()
        made = with_station_scales(case(100 + seed, (first, second)))
        held.append((squares(made.calibrated(), 100 + seed) < HELD).mean())
    # Errors of the points of one draw are alike: 0.95 within four sds of a mean over draws.
    assert np.mean(held) == pytest.approx(0.95, abs=4.0 * np.std(held) / math.sqrt(60) + 0.01)


def test_all_that_is_read_is_seen_in_proportion_and_predictions_are_true_lengths() -> None:
    arm = with_station_scales(case(1, (0.0, 0.0))).mechanism
    truth = {"a_scale": 3e-5, "b_scale": -2e-5}
    exact = lc.Noise({"*": 0.0})
    plain = lc.simulate(ARM, FRESH, noise=exact, seed=1).dataset
    scaled = {
        t: lc.simulate(
            arm, {**FRESH, "in_calibration": np.full(20, t)}, noise=exact, seed=1, truth=truth
        ).dataset
        for t in (0.0, 1.0)
    }
    assert STATION_SCALES in arm.effects
    for axis in "xyz":
        for name in "ab":
            true, seen = (scaled[t][f"{axis}_{name}"] for t in (0.0, 1.0))
            np.testing.assert_allclose(true, plain[f"{axis}_{name}"], atol=1e-12)
            # of first order: a scale of a scale is less than a rounding of the readings
            np.testing.assert_allclose(seen, true * (1.0 + truth[f"{name}_scale"]), rtol=1e-8)


def test_a_tool_that_moved_is_seen_by_the_one_station_that_is_there() -> None:
    """An instrument without any reading that day raised warnings of NumPy."""
    result = with_station_scales(case(1, (0.0, 0.0))).calibrated()
    moved = truth(1) | {"tool_x": truth(1)["tool_x"] + 5e-3}
    day = lc.simulate(ARM, FRESH, noise=NOISE, seed=2, truth=moved).dataset
    day = day.with_readings({f"{axis}_b": np.full(20, np.nan) for axis in "xyz"})
    what = lc.verify(result, day)
    assert what.changes is not None
    assert "tool" in str(what.changes)
