"""Terms leave a structured candidate by a rule; those of the drawing stay."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import loopcal as lc
from analyses.gauntlet_truth import Arm
from analyses.gauntlet_worlds import Event, Rng, Run, World, nothing
from loopcal.estimation.noise.term_parts import gain, support
from loopcal.estimation.noise.term_scales import searched
from loopcal.estimation.result import FitResult
from loopcal.mechanisms.structure.structured import GEOMETRY_TERMS
from loopcal.statistics.case import Case, entrants, without_terms
from loopcal.statistics.judged import (
    EXCLUDED,
    UNCERTAIN,
    Judged,
    Rule,
    begun,
    fitted,
    lean,
)
from loopcal.statistics.predictor import predictor

ALL = Rule(gain, math.inf)
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
    fewer = lean(case, full, UNCERTAIN)
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


def test_what_readings_cannot_show_stays_and_widens_the_stated_sds() -> None:
    """12 poses of a rigid arm: a good tracker excludes sag, one of 0.1 mm does not."""
    good, full = judged(World(poses=12))
    assert names(lean(good, full, EXCLUDED)) <= DRAWN
    poor, full = judged(World(poses=12, sd=1e-4, encoder=1e-4))
    fewer = lean(poor, full, EXCLUDED)
    assert {"sag", "sag_across", "harmonics"} <= names(fewer)
    bare = lean(poor, full, ALL)
    assert names(bare) <= DRAWN
    assert usual_sd(fewer) > 1.1 * usual_sd(bare)


def usual_sd(one: Judged) -> float:
    assert one.whole is not None
    made = predictor(one.whole)
    assert made is not None
    return made.usual[0].sd


def test_support_is_the_integral_over_the_scale() -> None:
    """Laplace's method beside quadrature: the criterion at many scales, the others learnt anew."""
    _, full = judged(World(poses=12, worn=sagging))
    assert full.whole is not None
    assert full.whole.estimate is not None
    learnt = full.whole.estimate.variances.terms
    assert learnt is not None
    system, every = learnt.system, np.ones(len(learnt.at.x), dtype=bool)
    present = searched(system, learnt.at.x, every)
    z = np.linspace(-4.0, 4.0, 21)  # 81 scales give the same integrals to 2e-4
    for i, term in enumerate(system.terms):
        rest = np.arange(len(every)) != 1 + i
        likelihoods = []
        for log_scale in math.log(term.sd) + term.spread * z:
            x = present.at.x.copy()
            x[1 + i] = 2.0 * log_scale
            likelihoods.append(-0.5 * searched(system, x, rest).at.criterion)
        most = max(likelihoods)  # with the prior of the scale but for 1/((2 pi)^(1/2) spread)
        mean = np.trapezoid(np.exp(np.array(likelihoods) - most), z) / math.sqrt(2.0 * math.pi)
        x = present.at.x.copy()
        x[1 + i] = 2.0 * math.log(1e-6 * term.sd)
        without = searched(system, x, rest).at
        exact = 2.0 * (most + math.log(mean)) + without.criterion - without.penalties[i]
        assert support(present, i) == pytest.approx(exact, abs=0.5), term.name


def test_sag_stays_whose_load_changed() -> None:
    trial = World(poses=30).made(np.random.default_rng([3, 1]))
    data = lc.Dataset.from_arrays(trial.readings | {"pose": np.arange(30.0)})
    machine = lc.with_effects(trial.mechanism, [lc.effects.Shift(("load",), (15.0,))])
    case = Case(machine, data, trial.noise, lc.Fit(method="auto"), trusted=True)
    fewer = lean(case, fitted(next(iter(entrants(case)))), ALL)
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


@pytest.mark.parametrize(
    ("event", "stated", "stays"), [(nothing, 0.5, False), (nothing, 0.29, True), (loose, 0.5, True)]
)
def test_a_white_error_leaves_that_the_instrument_explains(
    event: Event, stated: float, stays: bool
) -> None:
    """Noise twice as large as stated is the instrument's, 0.3 mm at the tool the machine's; what is
    2.6 times as large may be either's, and stays."""
    case, full = judged(World(poses=60, event=event, learnt=True, stated=stated))
    assert full.whole is not None
    assert machine_error(full.whole) > 0.0
    none = Rule(gain, -math.inf)
    assert lean(case, full, none) is full  # beside a smooth discrepancy it is what that leaves
    fewer = lean(case, full, UNCERTAIN)
    assert fewer.whole is not None
    assert (machine_error(fewer.whole) > 0.0) is stays
    # later fits of the same candidate have none either
    again = fewer.entrant.case.calibrated(np.arange(50))
    assert (machine_error(again) > 0.0) is stays


def machine_error(whole: FitResult) -> float:
    return next(entry.sd for entry in whole.noise if entry.role == "disturbance")
