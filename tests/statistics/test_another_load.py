"""Another load on an arm without stated masses, and a model that lacks the sag."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

import loopcal as lc
from loopcal.mechanisms.structure.structured import loadable
from loopcal.statistics.another_day import Day
from loopcal.statistics.calibrated import Calibrated
from loopcal.statistics.change_tests import _System, what_changed
from loopcal.statistics.day_causes import Causes
from tests.statistics.test_change_points import ARM, NOISE, Array, joints

GIVING = lc.structured(ARM, harmonics=False)
SAG = {"sag": 8e-4, "sag_across": 1.5e-4}
"""Sds of what the load bends about the joints' axes and across them [rad/m]."""


def bent(seed: int) -> dict[str, float]:
    """What a load bends of each joint [rad/m]."""
    rng = np.random.default_rng(seed)
    return {
        p.name: (SAG["sag"] if p.name in about() else SAG["sag_across"]) * rng.standard_normal()
        for p in GIVING.parameters
        if "_sag_" in p.name and p.name.endswith("_tool")
    }


def carrying(
    where: dict[str, Array], seed: int, times: float, further: int | None = None
) -> lc.Dataset:
    """Readings of an arm that carries so many times its load, and gives way under it; further: the
    seed of a load that bends each joint otherwise."""
    loaded, more = bent(0), {} if further is None else bent(further)
    truth = {
        p.name: p.nominal + times * loaded.get(p.name, 0.0) + more.get(p.name, 0.0)
        for p in GIVING.parameters
    }
    return lc.simulate(GIVING, where, noise=NOISE, seed=seed, truth=truth).dataset


def about() -> tuple[str, ...]:
    """The columns about the joints' axes."""
    (term,) = (term for term in GIVING.terms if term.name == "sag")
    return term.parameters


def over_stated(result: lc.Result, times: float) -> float:
    """True error under so many times the load over the stated one, at poses not used."""
    fresh = carrying(joints(100, 99), 99, times)
    predicted = lc.predict(result, lc.Dataset.from_arrays(joints(100, 99)))
    errors = np.array([predicted.outputs[q] - fresh[q] for q in "xyz"])
    stated = np.array([predicted.sd[q] for q in "xyz"])
    return float(np.sqrt(np.mean(errors**2) / np.mean(stated**2)))


@pytest.fixture(scope="module")
def first() -> lc.Result:
    return lc.calibrate(ARM, carrying(joints(60, 3), 3, 1.0), method="auto")


@pytest.mark.parametrize("seed", range(21, 26))
def test_a_load_is_among_what_is_named(first: lc.Result, seed: int) -> None:
    """The arm has 17 such columns: a scale alone was named in four of these five."""
    found = lc.verify(first, carrying(joints(8, seed), seed, 1.5))
    assert found.changes is not None
    assert found.verdict["consistent"].passed is False
    assert all("load" in change.kinds for change in found.changes.found)


@pytest.mark.parametrize("seed", [59108, 59111])
def test_what_one_weight_leaves_of_a_load_begins_at_no_pose(first: lc.Result, seed: int) -> None:
    """A payload of 6 kg "changed from pose 6 on", which was there all day: of a load that bends
    joints in another proportion than the first one did."""
    found = lc.verify(first, carrying(joints(30, seed), seed, 1.0, further=seed))
    assert found.changes is not None
    assert [change.name for change in found.changes.found] == ["the load"]
    assert found.shifts.found == ()


def test_coarse_joints_of_a_later_file_are_named(first: lc.Result) -> None:
    """A log that is rounded to 0.001 rad looks like a machine that has changed."""
    day = carrying(joints(40, 21), 21, 1.0)
    coarse = day.with_readings({q: np.round(day[q], 3) for q in ARM.joints})
    assert "rounded to 0.001 rad" in lc.verify(first, coarse).read_as
    assert lc.verify(first, day).read_as == ""


@pytest.mark.parametrize("seed", range(21, 26))
def test_an_update_follows_all_that_may_have_changed(first: lc.Result, seed: int) -> None:
    """It followed the scale, was hardly better than no update, and said to be sure."""
    updated = lc.update(first, carrying(joints(8, seed), seed, 1.5))
    assert over_stated(updated, 1.5) < 1.5


@pytest.mark.parametrize("seed", [42, 46, 48])
def test_what_a_model_lacks_is_no_change(seed: int) -> None:
    """Of a rigid model and stated sds: each of these days was named a delay of the poses."""
    day = carrying(joints(60, 3), 3, 1.0)
    rigid = lc.calibrate(ARM, day, noise=NOISE, method="implicit-loop")
    assert lc.verdict(rigid).answers["sound"].passed is False
    found = lc.verify(rigid, carrying(joints(150, seed), seed, 1.0))
    assert found.changes is not None
    assert found.changes.found == ()


@pytest.fixture(scope="module")
def bare() -> lc.Result:
    """Of an arm that carries nothing, and has learnt no sag."""
    return lc.calibrate(ARM, carrying(joints(60, 3), 3, 0.0), method="auto")


@pytest.mark.parametrize("seed", [28, 30, 34])
def test_a_load_is_named_where_no_sag_was_learnt(bare: lc.Result, seed: int) -> None:
    """Nothing was, and before that a scale or a length for less than half of what it does."""
    assert bare.mechanism.structure is None or not bare.mechanism.structure.loaded
    found = lc.verify(bare, carrying(joints(30, seed), seed, 0.5))
    assert found.changes is not None
    assert [change.name for change in found.changes.found] == ["the load"]


@pytest.mark.parametrize("seed", [28, 34])
def test_an_update_follows_a_load_where_no_sag_was_learnt(bare: lc.Result, seed: int) -> None:
    """True errors were three times the stated ones."""
    updated = lc.update(bare, carrying(joints(30, seed), seed, 0.5))
    assert over_stated(updated, 0.5) < 1.2


def test_an_arm_that_carries_nothing_is_unchanged(bare: lc.Result) -> None:
    found = lc.verify(bare, carrying(joints(30, 5), 5, 0.0))
    assert found.changes is not None
    assert found.changes.verdict == "unchanged"
    assert [one.name for one in found.changes.candidates].count("the load") == 1


def test_a_load_can_be_followed_after_an_update_as_well() -> None:
    """Its parameters have prior sds of their own, which `verify` refused in one term."""
    made = lc.structured(ARM, sag=False)
    sds = {name: 1e-5 * (1.0 + i) for i, name in enumerate(made.parameters.free)}
    updated = replace(made, terms=()).with_parameters(made.parameters.with_prior(sds))
    giving = loadable(updated)
    assert giving.structure is not None
    assert giving.structure.loaded
    assert sds.items() <= {p.name: p.prior_sd for p in giving.parameters}.items()
    assert all(giving.parameters[name].prior_sd < 0.01 for name in giving.structure.loaded)


def test_a_search_that_takes_a_load_in_other_parts_ends(
    first: lc.Result, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each of two ways to describe another load was taken in place of the other, without end."""
    calibration = Calibrated.of(first, "").loadable
    day = Day.of(calibration, carrying(joints(8, 21), 21, 1.5), None)
    causes = Causes.of(day, linear := day.linearised())
    loads = [i for i, one in enumerate(causes.causes) if one.kind == "load"]
    assert len(loads) == 2
    rounds: list[tuple[int, ...]] = []

    def likely(_: _System, chosen: Sequence[int] = ()) -> dict[int, float]:
        rounds.append(tuple(chosen))
        assert len(rounds) < 10
        return {i: 1e-9 for i in loads if i not in chosen}

    monkeypatch.setattr(_System, "tests", likely)
    monkeypatch.setattr(_System, "kept", lambda _, chosen: tuple(chosen))
    assert what_changed(day, linear) is not None
