"""Faults of the columns of instruments that read no coordinates."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import loopcal as lc
from analyses.instruments import Setup, setup
from loopcal.estimation.faults import search
from loopcal.estimation.faults.misfit import Misfit, misfit, shrunk
from loopcal.estimation.faults.repairs import repairs
from loopcal.estimation.faults.search import column_faults
from loopcal.estimation.problem.problem import Problem, build_problem


def problem(given: Setup, poses: int, **wrong: str) -> Problem:
    """The readings of some poses, columns named in `wrong` filled with those of another."""
    some = {q: v[:poses] for q, v in given.driven.items()}
    made = lc.simulate(given.truth, some, noise=given.noise, seed=2, start=given.start)
    readings = dict(made.dataset.readings)
    readings |= {name: readings[other] for name, other in wrong.items()}
    nominal = given.nominal(2)
    held = nominal.with_parameters(nominal.parameters.with_fixed(given.held))
    return build_problem(held, lc.Dataset.from_arrays(readings), given.noise)


def test_exchanged_angles_of_a_tracker_are_found() -> None:
    angles = {"T_azimuth": "T_elevation", "T_elevation": "T_azimuth"}
    (fault,) = column_faults(problem(setup("six-axis spherical"), 30, **angles))
    assert fault.words == "the columns of T_azimuth and T_elevation are exchanged"
    assert fault.before is not None
    assert fault.after is not None
    assert fault.after < 0.01 * fault.before


def test_a_parked_joint_is_not_blamed_for_its_unit() -> None:
    """Another unit would only change its offset, which is estimated."""
    given = setup("six-axis point")
    parked = replace(given, driven={**given.driven, "q4": np.full_like(given.driven["q4"], 0.5)})
    problem_ = problem(parked, 40)
    at = problem_.mechanism.parameters.names.index("offset_4")
    start = problem_.start.copy()
    start[at] -= 0.5 - 0.5 * np.pi / 180
    faults = column_faults(replace(problem_, start=start))
    assert not any("q4" in fault.words for fault in faults)


def test_a_noisy_joint_that_was_held_is_not_blamed_for_its_unit() -> None:
    """In a smaller unit its noise would be gone, and with it most of the misfit."""
    project = lc.read_project(Path(__file__).parents[3] / "examples" / "planar" / "project.toml")
    loaded = lc.load_dataset(project)
    held = {q: loaded.dataset[q][:10] for q in ("xP", "yP", "phi2", "phi3")}
    some = build_problem(project.mechanism, lc.Dataset.from_arrays(held), loaded.noise)
    assert column_faults(some) == ()
    held["phi2"] = np.degrees(loaded.dataset["phi2"][:10])
    held["phi3"] = np.degrees(held["phi3"])
    some = build_problem(project.mechanism, lc.Dataset.from_arrays(held), loaded.noise)
    assert [fault.code for fault in column_faults(some)] == ["unit"]


def test_a_length_a_thousand_times_smaller_makes_no_better_machine() -> None:
    """Only the wire says how large the arm is: in millimetres it would be as good, and smaller."""
    given = setup("two-link draw-wire")
    whole = problem(replace(given, far=0.0), 60)
    bent = whole.readings.copy()
    bent[list(whole.mechanism.quantities).index("wire")] += 0.02 * np.sin(3.0 * np.arange(60.0))
    assert column_faults(replace(whole, readings=bent)) == ()


def test_a_search_without_bounds_is_cut_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    """Exchanged columns go first: their number grows with the square of the columns."""
    given = setup("two-link point")
    rng = np.random.default_rng(1)
    whole = problem(given, 40)
    driven = [whole.mechanism.tape.quantities.index(q) for q in given.driven]
    readings = whole.readings.copy()
    readings[driven] = readings[driven][:, rng.permutation(40)]
    whole = replace(whole, readings=readings)
    every = [one for one in repairs(whole) if not shrunk(one.problem)]
    pairs = sum(one.code == "exchanged" for one in every)
    monkeypatch.setattr(search, "MOST_READ", len(every) - pairs)
    tried: list[Problem] = []

    def counted(one: Problem, rounds: int = 3, steps: int = 10, kept: float = 0.9) -> Misfit:
        tried.append(one)
        return misfit(one, rounds, steps, kept)

    monkeypatch.setattr(search, "misfit", counted)
    (fault,) = column_faults(whole)
    assert fault.code in ("wrong-machine", "rows-shuffled")
    assert len(tried) <= len(every) - pairs + 20
    assert f"{pairs:,} of {len(every):,} possible faults" in fault.words


def test_a_joint_that_was_not_recorded_is_suspected() -> None:
    given = setup("six-axis point")
    whole = problem(given, 60)
    readings = whole.readings.copy()
    readings[whole.mechanism.tape.quantities.index("q2")] = 0.1
    (fault,) = column_faults(replace(whole, readings=readings))
    assert "perhaps 'q2' moved, but it reads the same in every pose; or another" in fault.words
