"""Models of one machine compared on the same poses: the simplest that the data do not refuse."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from loopcal.errors import InputError
from loopcal.estimation.calibrate import calibrate
from loopcal.estimation.result import FitResult
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise
from loopcal.mechanisms.effects.effect import Model, with_effects, with_only
from loopcal.mechanisms.effects.harmonics import Harmonics
from loopcal.mechanisms.effects.scale import Scale
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.planar import planar_two_link
from loopcal.simulation.poses import random_poses
from loopcal.simulation.simulate import simulate
from loopcal.statistics import case
from loopcal.statistics.folds import folds, grouped
from loopcal.statistics.models import ComparedModel, compare_models, recommended
from tests.refusals import refused

NOISE = Noise({"?P": 1e-4, "phi?": 2e-4})
MODELS = {"scale": Model(("scale",)), "gears": Model(("scale", "harmonics"))}


def arm() -> Mechanism:
    return with_effects(planar_two_link(), [Scale(), Harmonics()])


def measured(truth: dict[str, float], seed: int, poses: int = 60) -> Dataset:
    where = random_poses({"phi2": (-2.0, 2.0), "phi3": (-2.0, 2.0)}, poses, seed=seed)
    truth = {"l2": 0.802, "phi30": 0.01, **truth}
    return simulate(arm(), where, noise=NOISE, seed=seed, truth=truth).dataset


def test_a_model_switches_effects_off_by_fixing_them_at_zero() -> None:
    there = arm().with_nominal({"phi2_scale": 0.1, "phi2_cos1": 0.2})
    machine = with_only(there, Model(("scale",), ("l2", "phi3_*")))
    off = {p.name for p in machine.parameters if p.fixed}
    assert off == {*there.effects["harmonics"], "l2", "phi3_scale"}
    assert machine.parameters["phi2_cos1"].nominal == 0.0
    assert machine.parameters["phi2_scale"].nominal == 0.1
    with refused("unknown-name", "'gear'"):
        with_only(there, Model(("gear",)))
    with refused("unknown-name", "l4"):
        with_only(there, Model((), ("l4",)))


def test_nine_geometric_truths_of_ten_are_called_geometric() -> None:
    chosen = [
        compare_models(
            arm(), measured({}, seed), MODELS, noise=NOISE, folds=5, method="implicit-loop"
        ).recommended
        for seed in range(10)
    ]
    assert chosen.count("geometric") >= 9


def test_a_true_effect_is_found_and_no_more_than_it() -> None:
    truth = {"phi2_scale": 1e-3, "phi3_scale": -5e-4}
    for seed in range(3):
        found = compare_models(
            arm(), measured(truth, seed), MODELS, noise=NOISE, folds=5, method="implicit-loop"
        )
        assert found.recommended == "scale"
        assert found.result.value["phi2_scale"] == pytest.approx(1e-3, abs=4e-4)
        assert found.result.value["phi2_cos1"] == 0.0
        geometric = found.models[0]
        assert geometric.name == "geometric"
        assert geometric.parameters == 6
        assert geometric.behind is not None
        assert geometric.sd is not None
        assert geometric.behind > 2 * geometric.sd > 0.0
    truth |= {"phi2_sin2": 1e-3}
    found = compare_models(
        arm(), measured(truth, 9), MODELS, noise=NOISE, folds=5, method="implicit-loop"
    )
    assert found.recommended == "gears"
    assert "Recommended: gears" in str(found)


def test_the_difference_and_its_sd_are_those_of_the_groups() -> None:
    data = measured({"phi2_scale": 1e-3}, 4)
    groups = [i // 3 for i in range(len(data))]
    found = compare_models(
        arm(), data, MODELS, noise=NOISE, folds=5, groups=groups, method="implicit-loop"
    )
    geometric, best = found.models[0], next(m for m in found.models if m.behind == 0.0)
    assert geometric.validation is not None
    assert best.validation is not None
    assert geometric.validation.by_pose is not None
    assert best.validation.by_pose is not None
    order = np.argsort([int(p) for p in geometric.validation.poses])
    d = (best.validation.by_pose - geometric.validation.by_pose)[order]
    sums = d.reshape(-1, 3).sum(axis=1)
    assert geometric.behind == pytest.approx(sums.sum())
    assert geometric.sd == pytest.approx(math.sqrt(len(sums)) * sums.std(ddof=1))


def test_the_simplest_that_is_not_refused_is_taken() -> None:
    best = ComparedModel("best", (), (), 9, None, behind=0.0, sd=0.0)
    close = replace(best, name="close", parameters=7, behind=9.0, sd=5.0)
    alike = replace(best, name="alike", parameters=5, behind=3.9, sd=0.1)
    worse = replace(best, name="worse", parameters=3, behind=9.0, sd=4.0)
    failed = replace(best, name="failed", parameters=1, behind=None, sd=None)
    assert recommended([best, close, alike, worse, failed]) == "alike"
    assert recommended([best, close, worse, failed]) == "close"
    assert recommended([best, worse]) == "best"


def test_what_cannot_be_compared_is_told() -> None:
    with refused("missing-key"):
        compare_models(arm(), measured({}, 1), {}, noise=NOISE, method="implicit-loop")
    few = measured({}, 1, poses=6)
    with refused("not-converged"):
        compare_models(
            arm(), few, MODELS, noise=NOISE, folds=2, max_iterations=1, method="implicit-loop"
        )


def test_models_are_compared_on_the_poses_that_all_of_them_predict(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    data = measured({}, 1)
    parts = folds(grouped(arm(), data), 5, seed=0)
    gone = {data.poses[i] for i in parts[0]}
    whole = compare_models(arm(), data, MODELS, noise=NOISE, folds=5, method="implicit-loop")

    def failing(mechanism: Mechanism, given: Dataset, **how: Any) -> FitResult:
        larger = len(mechanism.parameters.free) > len(with_only(arm(), Model()).parameters.free)
        if larger and not gone & set(given.poses):
            raise InputError("these poses do not close")
        return calibrate(mechanism, given, **how)

    monkeypatch.setattr(case, "calibrate", failing)
    found = compare_models(arm(), data, MODELS, noise=NOISE, folds=5, method="implicit-loop")
    assert [len(m.validation.failed) for m in found.models if m.validation] == [
        0,
        *[1] * (len(found.models) - 1),
    ]
    terms = {
        m.name: sum(
            t
            for p, t in zip(m.validation.poses, m.validation.by_pose, strict=True)
            if p not in gone
        )
        for m in whole.models
        if m.validation is not None and m.validation.by_pose is not None
    }
    best = max(terms.values())
    for model in found.models:
        assert model.behind == pytest.approx(best - terms[model.name], abs=1e-8)


def test_a_model_that_cannot_be_fitted_is_listed_and_the_others_are_compared(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def failing(mechanism: Mechanism, given: Dataset, **how: Any) -> FitResult:
        if len(mechanism.parameters.free) > len(with_only(arm(), Model()).parameters.free):
            raise InputError("too few poses for this model")
        return calibrate(mechanism, given, **how)

    monkeypatch.setattr(case, "calibrate", failing)
    found = compare_models(
        arm(), measured({}, 1), MODELS, noise=NOISE, folds=5, method="implicit-loop"
    )
    assert found.recommended == "geometric"
    failed = {m.name: m.failed for m in found.models if m.failed}
    assert set(failed.values()) == {"too few poses for this model"}
    assert set(failed) == set(MODELS)
