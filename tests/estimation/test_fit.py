"""The settings of a fit are one value, checked once, and mean the same wherever they are given."""

from __future__ import annotations

import gc
import pickle
import sys
from dataclasses import replace
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import loopcal as lc
from loopcal.errors import InputError
from loopcal.estimation.methods.registry import METHODS, method_named
from tests.reference.simulated import planar_arm
from tests.refusals import refused

SDS = {"xP": 1e-4, "yP": 1e-4, "phi2": 1e-3, "phi3": 1e-3}
ARM = planar_arm(20)
DATA = ARM.read(SDS, seed=1)


@pytest.mark.parametrize("name", METHODS)
def test_every_registered_method_fits_and_says_what_it_is(name: str) -> None:
    method = method_named(name)
    assert method.name == name
    assert method.label
    assert method.description
    assert pickle.loads(pickle.dumps(method)) == method
    found = lc.calibrate(ARM.truth, DATA, noise=SDS, method=name)
    assert found.status.converged
    assert found.document.method == name
    assert (found.method == name) == (not method.choice)  # a choice names what it took
    assert (found.chi_squared is None) == method.exact


def test_settings_as_a_value_and_as_keywords_are_the_same_fit() -> None:
    given: dict[str, Any] = {"method": "reweighted", "loss": "huber", "prior": {"l?": 1e-3}}
    as_keywords = lc.calibrate(ARM.truth, DATA, noise=SDS, **{"method": "implicit-loop", **given})
    as_value = lc.calibrate(
        ARM.truth, DATA, noise=SDS, fit=lc.Fit(**{"method": "implicit-loop", **given})
    )
    overridden = lc.calibrate(
        ARM.truth, DATA, noise=SDS, fit=lc.Fit(loss="student-t", method="implicit-loop"), **given
    )
    assert as_keywords.fit == as_value.fit == overridden.fit
    assert as_keywords.value == as_value.value == overridden.value


def test_a_mapping_is_a_noise_and_a_prior() -> None:
    stated = lc.calibrate(
        ARM.truth, DATA, noise=lc.Noise(SDS), prior=lc.Prior({"l2": 1e-3}), method="implicit-loop"
    )
    plain = lc.calibrate(
        ARM.truth, DATA, noise=SDS, prior={"l2": (1.0, "mm")}, method="implicit-loop"
    )
    assert plain.value == stated.value
    checked = [str(lc.check(ARM.truth, DATA, noise=noise)) for noise in (SDS, lc.Noise(SDS))]
    assert checked[0] == checked[1]
    assert (
        lc.validate(ARM.truth, DATA, noise=SDS, folds=2, method="implicit-loop").log_likelihood
        is not None
    )
    angles = {q: DATA[q] for q in ("phi2", "phi3")}
    again = lc.simulate(ARM.truth, angles, noise=SDS, seed=3).dataset
    as_noise = lc.simulate(ARM.truth, angles, noise=lc.Noise(SDS), seed=3).dataset
    assert np.array_equal(again["xP"], as_noise["xP"])


@pytest.mark.parametrize("odd", [1e-3, [1, 2], "small"], ids=str)
def test_what_is_neither_a_noise_nor_a_mapping_is_refused(odd: Any) -> None:
    for call in (lc.calibrate, lc.check, lc.validate):
        with refused("invalid-value", "noise"):
            call(ARM.truth, DATA, noise=odd)
        with refused("invalid-value", "prior"):
            call(ARM.truth, DATA, noise=SDS, prior=odd)
    with refused("invalid-value", "noise"):
        lc.simulate(ARM.truth, {"phi2": [0.0], "phi3": [0.0]}, noise=odd, seed=1)


def test_an_unknown_start_is_refused_wherever_it_is_given() -> None:
    for call in (lc.calibrate, lc.check, lc.validate):
        with refused("unknown-name", "algin") as caught:
            call(ARM.truth, DATA, noise=SDS, start="algin")
        assert caught.value.remedy == "did you mean 'align'?"


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"method": "implicit"}, "no method 'implicit'"),
        ({"loss": "hubert"}, "no loss 'hubert'"),
        ({"method": "least-squares", "loss": "huber"}, "cannot use the loss 'huber'"),
        ({"method": "implicit-loop-undamped", "loss": "huber"}, "cannot use the loss 'huber'"),
        ({"max_iterations": -1}, "max_iterations is -1"),
        ({"tolerance": 0.0}, "tolerance is 0.0"),
        ({"tolerance": float("nan")}, "tolerance is nan"),
    ],
    ids=str,
)
def test_settings_that_cannot_be_are_refused(settings: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError) as caught:
        lc.Fit(**settings)
    assert words in str(caught.value)
    assert caught.value.remedy


@pytest.mark.parametrize("name", METHODS)
def test_a_coarser_tolerance_needs_no_more_iterations_and_ends_within_it(name: str) -> None:
    arm = ARM.off(1e-2, 1e-2)
    fine, coarse = (
        lc.calibrate(arm, DATA, noise=SDS, method=name, tolerance=t) for t in (None, 1e-3)
    )
    assert coarse.status.converged
    assert coarse.status.iterations <= fine.status.iterations
    for parameter in fine.estimated:
        sd = fine.sd[parameter]
        assert sd is not None
        assert abs(coarse.value[parameter] - fine.value[parameter]) < 1e-2 * sd


def test_a_result_computes_what_it_is_asked_for_once() -> None:
    found = lc.calibrate(ARM.truth, DATA, noise=SDS, method="implicit-loop")
    assert not {"residuals_after", "accuracy_after", "warnings", "noise"} & set(vars(found))
    assert found.accuracy_after is found.accuracy_after
    assert "accuracy_after" in vars(found)


def test_a_new_method_is_one_module_and_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    """A method that solves like least squares and calls itself "plain"."""
    module = ModuleType("loopcal.estimation.methods.plain")
    like = method_named("least-squares")
    setattr(module, "METHOD", replace(like, name="plain", label="plain squares"))  # noqa: B010
    monkeypatch.setitem(sys.modules, module.__name__, module)
    monkeypatch.setitem(METHODS, "plain", "plain")
    found = lc.calibrate(ARM.truth, DATA, method="plain")
    assert found.value == lc.calibrate(ARM.truth, DATA, method="least-squares").value
    assert "plain squares" in str(found)
    assert lc.validate(ARM.truth, DATA, method="plain", folds=4).log_likelihood is not None
    (interval,) = lc.intervals(found, "l2").values()
    assert interval is not None
    assert isinstance(lc.find_outliers(found), lc.Outliers)


def test_a_calibration_leaves_nothing_to_the_garbage_collector() -> None:
    """The command collects rarely: cycles that hold arrays would pile up."""
    for _ in range(2):  # the first fills caches
        gc.collect()
        gc.disable()
        try:
            lc.findings(lc.calibrate(ARM.truth, DATA, noise=SDS, method="implicit-loop"))
            left = gc.collect()
        finally:
            gc.enable()
    assert left == 0
