"""A constant that an instrument adds to all distances is measured beside machine and station."""

from __future__ import annotations

import numpy as np

import loopcal as lc
from loopcal.document.findings import ScaleEntry
from loopcal.estimation.fit import Fit
from loopcal.statistics.case import Case
from loopcal.statistics.ordered_system import ordered_system
from loopcal.statistics.range_zeros import range_zeros
from tests.estimation.test_contacts import READINGS
from tests.statistics.test_stations import stations

NOISE = lc.Noise({"q*": 2e-5, "[xyz]_*": 2e-5})
TRULY = 3e-4


def entries(seed: int, zero: float, away: float = 2.5) -> tuple[ScaleEntry, ...]:
    """Of an arm as far from its drawing as the prior says, so far [m] from the instrument."""
    arm = stations("a")
    placed = arm.with_nominal({"a_x": away})
    rng = np.random.default_rng(seed)
    free = [p for p in placed.parameters if p.name != "a_x"]
    truth = {p.name: p.nominal + 1e-3 * rng.standard_normal() for p in free}
    made = lc.simulate(placed, READINGS, noise=NOISE, seed=seed, truth=truth).dataset
    points = np.array([made[f"{axis}_a"] for axis in "xyz"])
    points = points + zero * points / np.linalg.norm(points, axis=0)
    data = made.with_readings(dict(zip(("x_a", "y_a", "z_a"), points, strict=True)))
    fit = Fit(method="implicit-loop", prior=lc.Prior({"*": 1e-3}), start="nominal")
    return range_zeros(ordered_system(Case(placed, data, NOISE, fit).calibrated()).fitted())


def test_a_wrong_constant_of_the_prism_is_found_with_its_sd() -> None:
    found = [one for seed in range(12) for one in entries(seed, TRULY)]
    assert len(found) == 12
    assert all(one.unit == "m" and one.instruments == ("a",) for one in found)
    z = np.array([(one.size - TRULY) / one.sd for one in found])
    # A mean square of 12 normal numbers is below this but once in 10,000 times.
    assert np.square(z).mean() < 3.1
    assert np.median([one.p_value for one in found]) < 1e-3


def test_without_one_its_size_is_as_its_sd_says() -> None:
    z = np.array([one.size / one.sd for seed in range(40) for one in entries(100 + seed, 0.0)])
    # Quantiles 0.0005 and 0.9995 of chi-squared of 40 over 40.
    assert 0.44 < np.square(z).mean() < 1.87


def test_the_frame_of_the_machine_is_no_instrument() -> None:
    assert not entries(1, TRULY, away=0.0)
