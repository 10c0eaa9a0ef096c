"""Chapter 4 of the seed, as `examples/seed/study.toml` has it; fewer draws than the study takes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from loopcal.companions.studies.draws import run_draws
from loopcal.companions.studies.study_file import Scenario, Study, read_study
from loopcal.companions.studies.tables import ScenarioTable, tables
from loopcal.mechanisms.prior import Prior

ROOT = Path(__file__).resolve().parents[2]
NAMES = ("xA", "yA", "l2", "l3", "phi20", "phi30")


@pytest.fixture(scope="module")
def study() -> Study:
    return read_study(ROOT / "examples" / "seed" / "study.toml")


def scenario(study: Study, name: str) -> Scenario:
    return next(scenario for scenario in study.scenarios if scenario.name == name)


def table(study: Study, name: str, draws: int) -> ScenarioTable:
    only = replace(study, scenarios=(scenario(study, name),))
    return tables(only, draws, run_draws(only.scenarios[0], study.seed, range(draws))).scenarios[0]


def test_every_table_is_there_with_its_draw(study: Study) -> None:
    names = ["exact (4.4.1)", *(f"table {number}" for number in range(3, 12))]
    assert [scenario.name for scenario in study.scenarios] == names
    for each in study.scenarios[1:]:
        assert set(each.published) == {"implicit-loop", "least-squares"}
        assert all(set(errors) == set(NAMES) for errors in each.published.values())


def test_without_noise_both_methods_return_the_truth(study: Study) -> None:
    columns = run_draws(study.scenarios[0], study.seed, [0])
    errors = np.array([columns[f"error.{name}"] for name in NAMES], dtype=float)
    assert np.abs(errors[:, 0]).max() <= 1e-10  # implicit loop
    assert np.abs(errors[:, 1]).max() <= 1e-12


def test_a_poor_second_joint_biases_least_squares_as_in_the_seed(study: Study) -> None:
    found = table(study, "table 5", 150)
    ratios = {a.name: a.ratio for a in found.paired[0].advantages}
    assert ratios["l2"] is not None
    assert ratios["l3"] is not None
    assert ratios["l2"] <= 0.03
    assert ratios["l3"] <= 0.03
    basic = {spread.name: spread for spread in found.methods[1].spreads}
    for name, sign in (("l2", -1.0), ("l3", 1.0)):
        bias, sd, placed = basic[name].bias, basic[name].sd, basic[name].published
        assert sd is not None
        assert placed is not None
        assert sign * bias > 5 * sd / np.sqrt(150)
        assert abs(placed.error - bias) < sd
    for method in found.methods:
        for spread in method.spreads:
            assert spread.published is None or 1.0 < spread.published.percentile < 99.0


def test_the_exchanged_arm_is_counted_where_an_undamped_iteration_ends_there(study: Study) -> None:
    seventh = scenario(study, "table 7")
    damped = seventh.methods[0]
    undamped = replace(
        damped, name="undamped", fit=damped.fit.changed(method="implicit-loop-undamped")
    )
    stated = Prior({"xA": 0.01, "yA": 0.01, "l?": 0.01, "phi*": 0.01})
    known = stated.apply(damped.mechanism)
    prior = replace(damped, name="prior", mechanism=known)
    three = replace(seventh, methods=(damped, undamped, prior), published={})
    columns = run_draws(three, study.seed, range(60))
    method = np.array(columns["method"])
    elsewhere = np.asarray(columns["other_optimum"]) == 1.0
    assert not elsewhere[method == "implicit-loop"].any()
    assert not elsewhere[method == "prior"].any()
    exchanged = elsewhere & (method == "undamped")
    assert exchanged.any()
    l2, l3 = (np.asarray(columns[f"error.{name}"])[exchanged] for name in ("l2", "l3"))
    np.testing.assert_allclose(l2, 0.2, atol=0.01)
    np.testing.assert_allclose(l3, -0.2, atol=0.01)
