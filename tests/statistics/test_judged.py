"""Terms that a structured candidate gains nothing by leave it; those of the drawing stay."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import loopcal as lc
from analyses.gauntlet_truth import Arm
from analyses.gauntlet_worlds import Event, Rng, Run, World, nothing
from loopcal.estimation.result import FitResult
from loopcal.mechanisms.structure.structured import GEOMETRY_TERMS
from loopcal.statistics.case import Case, entrants, without_terms
from loopcal.statistics.judged import Judged, begun, fitted, lean

DRAWN = {name for name, _, _ in GEOMETRY_TERMS.values()}


def sagging(arm: Arm, rng: Rng) -> Arm:
    return replace(arm, yielding=4e-6)


def judged(world: World) -> tuple[Case, Judged]:
    trial = world.made(np.random.default_rng([3, 1]))
    data = lc.Dataset.from_arrays(trial.readings)
    case = Case(trial.mechanism, data, trial.noise, lc.Fit(method="auto"), trusted=True)
    return case, fitted(next(iter(entrants(case))))


def names(one: Judged) -> set[str]:
    return {term.name for term in one.entrant.case.mechanism.terms}


def test_a_machine_of_geometry_alone_keeps_its_dimensions_only() -> None:
    case, full = judged(World(poses=50))
    assert names(full) > DRAWN & names(full)
    fewer = lean(case, full, 10.0)
    assert fewer.whole is not None
    assert names(fewer) == {"lengths", "zeros", "twists"}
    assert fewer.whole.status.converged
    assert not {n for n in fewer.whole.value if "sag" in n or "discrepancy" in n}
    # both are compared with the machine as drawn and placed, wherever their fits began
    assert full.whole is not None
    assert fewer.whole.fit == full.whole.fit
    before = [one.closure_before for one in (fewer.whole, full.whole)]
    assert before[0].rms == pytest.approx(before[1].rms, rel=1e-9)
    assert fewer.whole.accuracy_before == full.whole.accuracy_before
    # what left is gone in later fits of the same candidate, too
    again = fewer.entrant.case.calibrated(np.arange(40))
    assert set(again.value) == set(fewer.whole.value)


def test_a_fit_that_begins_where_another_ended_is_given_up_soon(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    case, full = judged(World(poses=50))
    assert full.whole is not None
    plain = next(one for one in entrants(case) if not (one.structured or one.drawn))
    near = begun(plain, full.whole)
    assert not fitted(near).failed
    monkeypatch.setattr("loopcal.statistics.case.NEAR", 1)
    assert "max_iterations" in fitted(near).failed
    assert not fitted(plain).failed  # one that begins as it is asked to takes its time


def test_an_arm_that_sags_keeps_its_sag() -> None:
    case, full = judged(World(poses=50, worn=sagging))
    fewer = lean(case, full)
    assert "sag" in names(fewer)
    assert names(fewer) <= names(full)
    assert fewer.whole is not None
    assert all(
        term.gain is None or term.gain > 0.0 or term.name in DRAWN for term in fewer.whole.terms
    )


def test_sag_stays_whose_load_changed() -> None:
    trial = World(poses=30).made(np.random.default_rng([3, 1]))
    data = lc.Dataset.from_arrays(trial.readings | {"pose": np.arange(30.0)})
    machine = lc.with_effects(trial.mechanism, [lc.effects.Shift(("load",), (15.0,))])
    case = Case(machine, data, trial.noise, lc.Fit(method="auto"), trusted=True)
    fewer = lean(case, fitted(next(iter(entrants(case)))), math.inf)
    sags = {"sag", "sag_across", "sag_changed", "sag_across_changed"}
    assert names(fewer) - DRAWN == sags


def test_what_the_user_structured_stays() -> None:
    case, full = judged(World(poses=30))
    stated = replace(case, mechanism=lc.structured(case.mechanism, discrepancy=2))
    kept = replace(full.entrant, case=stated)
    assert without_terms(stated, kept, {"sag"}) is None
    assert without_terms(case, full.entrant, {"lengths"}) is None


@pytest.mark.parametrize("absent", ["sag", "sag_across", "discrepancy", "harmonics"])
def test_any_term_can_leave_alone(absent: str) -> None:
    case, full = judged(World(poses=30))
    fewer = without_terms(case, full.entrant, {absent})
    assert fewer is not None
    made = fewer.case.mechanism
    assert {t.name for t in made.terms} == names(full) - {absent}
    left = {n for t in full.entrant.case.mechanism.terms if t.name == absent for n in t.parameters}
    assert left.isdisjoint(made.parameters.names)


def loose(run: Run, rng: Rng) -> None:
    run.target += 3e-4 * rng.standard_normal(run.target.shape)


@pytest.mark.parametrize(("event", "stays"), [(nothing, False), (loose, True)])
def test_a_white_error_leaves_that_the_instrument_explains(event: Event, stays: bool) -> None:
    """Noise twice as large as stated is the instrument's, 0.3 mm at the tool the machine's."""
    case, full = judged(World(poses=60, event=event, learnt=True, stated=0.5))
    assert full.whole is not None
    assert machine_error(full.whole) > 0.0
    assert lean(case, full, -math.inf) is full  # beside a smooth discrepancy it is what that leaves
    fewer = lean(case, full, 10.0)
    assert fewer.whole is not None
    assert (machine_error(fewer.whole) > 0.0) is stays
    # later fits of the same candidate have none either
    again = fewer.entrant.case.calibrated(np.arange(50))
    assert (machine_error(again) > 0.0) is stays


def machine_error(whole: FitResult) -> float:
    return next(entry.sd for entry in whole.noise if entry.role == "disturbance")
