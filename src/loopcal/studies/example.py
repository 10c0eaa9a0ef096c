"""The first draw of a scenario, calibrated by every method: one case behind the distributions."""

from __future__ import annotations

from loopcal.errors import InputError
from loopcal.estimation.result import Result
from loopcal.files.study.study_file import Scenario
from loopcal.measurements.dataset import Dataset
from loopcal.simulation.simulate import simulate
from loopcal.studies.draws import calibrated, seed_of


def first_draw(scenario: Scenario, seed: int) -> dict[str, Result]:
    """Method -> result for the same readings that draw 0 of the study has.

    A method that cannot evaluate this draw is left out.
    """
    driven = Dataset.from_arrays(scenario.simulation.driven(seed_of(seed, scenario.name, "poses")))
    own = seed_of(seed, scenario.name, 0)
    truth = scenario.simulation.machine(scenario.mechanism.parameters, own)
    made = simulate(scenario.mechanism, driven, noise=scenario.noise, seed=own, truth=truth)
    found = {}
    for method in scenario.methods:
        try:
            found[method.name] = calibrated(method, made)
        except InputError:
            continue
    return found
