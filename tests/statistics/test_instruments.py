"""Every instrument calibrates, and says how well; `analyses/instruments.py` at full size."""

from __future__ import annotations

import re
from functools import cache

import numpy as np
import pytest
from scipy.stats import kstest

from analyses.instruments import SETUPS, Counts, identifiable, run, setup
from analyses.written import read_block
from tests.conftest import ROOT

DRAWS = {"platform": 4}
MANY = 16
NAMES = tuple(SETUPS)


@cache
def counted(name: str) -> Counts:
    return run(name, range(DRAWS.get(name.split()[0], MANY)))


@pytest.mark.parametrize("name", NAMES)
def test_the_identifiable_set_is_the_derived_one(name: str) -> None:
    assert identifiable(name) == setup(name).identifiable


@pytest.mark.parametrize("name", NAMES)
def test_chi_squared_is_as_large_as_its_degrees_of_freedom(name: str) -> None:
    """Four standard errors of the mean, which are known: chi-squared has the variance 2 nu."""
    found = counted(name)
    spread = np.sqrt(2.0 / found.freedom / len(found.factors))
    assert abs(found.factors.mean() - 1.0) < 4 * spread


@pytest.mark.parametrize("name", NAMES)
def test_intervals_hold_the_truth_as_often_as_they_say(name: str) -> None:
    """Intervals of one draw share its errors: a draw counts once, and four errors of all."""
    found = counted(name)
    assert abs(found.held.mean() - 0.95) < 4 * np.sqrt(0.95 * 0.05 / len(found.held))


def test_p_values_of_all_of_them_are_uniform() -> None:
    p = np.concatenate([counted(name).p_values for name in NAMES])
    assert kstest(p, "uniform").pvalue > 0.01


ROW = re.compile(
    r"(?P<name>.*?) +(?P<rank>\d+) +(?P<due>\d+) +(?P<factor>[\d.]+) \+- (?P<factor_error>[\d.]+)"
    r" +(?P<held>[\d.]+) \+- (?P<held_error>[\d.]+) .*"
)


def test_the_documentation_shows_every_setup_as_it_was_run() -> None:
    rows = read_block(ROOT / "docs" / "explanation" / "instruments.md", "instruments").splitlines()
    found = {m["name"]: m for row in rows if (m := ROW.fullmatch(row))}
    assert tuple(found) == NAMES
    for name, row in found.items():
        assert int(row["rank"]) == int(row["due"]) == setup(name).identifiable
        assert abs(float(row["factor"]) - 1.0) < 4 * float(row["factor_error"])
        assert abs(float(row["held"]) - 95.0) < 4 * float(row["held_error"])
