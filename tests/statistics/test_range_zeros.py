"""A constant that an instrument adds to all distances is measured beside machine and station."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import loopcal as lc
from analyses.instruments import ARM_VALUES, six_axis
from loopcal.document.findings import ScaleEntry
from loopcal.estimation.fit import Fit
from loopcal.instruments import point, spherical
from loopcal.statistics.case import Case
from loopcal.statistics.ordered_system import ordered_system
from loopcal.statistics.scales import range_zeros
from tests.estimation.test_contacts import READINGS
from tests.refusals import refused
from tests.statistics.test_stations import stations

NOISE = lc.Noise({"q*": 2e-5, "[xyz]_*": 2e-5})
TRULY = 3e-4


def case(seed: int, zero: float, away: float = 2.5, *effects: Any) -> Case:
    """Of an arm as far from its drawing as the prior says, so far [m] from the instrument."""
    placed = stations("a").with_nominal({"a_x": away})
    rng = np.random.default_rng(seed)
    free = [p for p in placed.parameters if p.name != "a_x"]
    truth = {p.name: p.nominal + 1e-3 * rng.standard_normal() for p in free}
    made = lc.simulate(placed, READINGS, noise=NOISE, seed=seed, truth=truth).dataset
    points = np.array([made[f"{axis}_a"] for axis in "xyz"])
    points = points + zero * points / np.linalg.norm(points, axis=0)
    data = made.with_readings(dict(zip(("x_a", "y_a", "z_a"), points, strict=True)))
    priors = {p.name: 1e-3 for p in placed.parameters}
    fit = Fit(method="implicit-loop", prior=lc.Prior(priors), start="nominal")
    return Case(lc.with_effects(placed, effects), data, NOISE, fit)


def entries(seed: int, zero: float, away: float = 2.5) -> tuple[ScaleEntry, ...]:
    return range_zeros(ordered_system(case(seed, zero, away).calibrated()).fitted())


def test_a_wrong_constant_of_the_prism_is_found_with_its_sd() -> None:
    found = [one for seed in range(6) for one in entries(seed, TRULY)]
    assert len(found) == 6
    assert all(one.unit == "m" and one.instruments == ("a",) for one in found)
    z = np.array([(one.size - TRULY) / one.sd for one in found])
    # Quantile 0.9999 of chi-squared of 6 over 6.
    assert np.square(z).mean() < 4.7
    assert np.median([one.p_value for one in found]) < 1e-3


def test_without_one_its_size_is_as_its_sd_says() -> None:
    z = np.array([one.size / one.sd for seed in range(20) for one in entries(100 + seed, 0.0)])
    # Quantiles 0.0005 and 0.9995 of chi-squared of 20 over 20.
    assert 0.27 < np.square(z).mean() < 2.37


def test_the_frame_of_the_machine_is_no_instrument() -> None:
    assert not entries(1, TRULY, away=0.0)


def test_the_effect_takes_the_constant_up() -> None:
    results = [case(seed, TRULY, 2.5, lc.effects.RangeZeros()).calibrated() for seed in range(6)]
    off = [one.value["a_zero"] - TRULY for one in results]
    z = np.array(off) / np.array([one.sd["a_zero"] for one in results], dtype=float)
    # Quantile 0.9999 of chi-squared of 6 over 6.
    assert np.square(z).mean() < 4.7
    left = [range_zeros(ordered_system(one).fitted()) for one in results]
    assert all(one.p_value > 0.01 for found in left for one in found)


def test_the_effect_makes_distances_longer_and_leaves_directions() -> None:
    seen = [point("p", station="a", target="tool"), spherical("s", station="b", target="tool")]
    arm = lc.with_effects(lc.assemble(six_axis(), seen, ARM_VALUES), [lc.effects.RangeZeros()])
    arm = arm.with_nominal({"a_x": 2.5, "b_y": 2.0})
    noise = lc.Noise({"q*": 2e-5, **dict.fromkeys(arm.outputs, 1e-6)})
    truths = [{"p_zero": zero, "s_zero": -2.0 * zero} for zero in (0.0, 2e-3)]
    before, after = (
        lc.simulate(arm, READINGS, noise=noise, seed=1, truth=truth).dataset for truth in truths
    )
    old, new = (np.array([one[q] for q in arm.outputs[:3]]) for one in (before, after))
    away = np.linalg.norm(old, axis=0)
    assert new == pytest.approx(old * (1.0 + 2e-3 / away), abs=1e-8)
    distance, *angles = arm.outputs[3:]
    assert after[distance] - before[distance] == pytest.approx(-4e-3, abs=1e-9)
    for angle in angles:
        assert after[angle] == pytest.approx(before[angle], abs=1e-9)


def test_without_an_instrument_that_reads_lengths_there_is_no_zero() -> None:
    with refused("unsupported", "range_zeros", "there are none"):
        arm = lc.assemble(six_axis(), [lc.instruments.inclinometer("level")])
        lc.with_effects(arm, [lc.effects.RangeZeros()])
