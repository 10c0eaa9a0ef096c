"""The exchanged links of the seed's table 7 are found, told, and settled by a prior."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import loopcal as lc
from loopcal.statistics import optima
from loopcal.statistics.optima import other_optima

STEPS = np.radians(np.arange(0.0, 91.0, 10.0))
TRUTH = lc.planar_two_link().with_nominal({"l2": 0.8, "l3": 0.6})
START = lc.planar_two_link().with_nominal({"l2": 0.802, "l3": 0.597})
WEAK = {"xP": 1e-4, "yP": 1e-4, "phi2": 0.1, "phi3": 1e-3}


def fitted(sds, prior, seed: int, **how) -> lc.Result:
    poses = lc.grid_poses({"phi2": STEPS, "phi3": STEPS})
    made = lc.simulate(TRUTH, poses, noise=lc.Noise(sds), seed=seed)
    return lc.calibrate(
        START,
        made.dataset,
        noise=lc.Noise(sds),
        prior=lc.Prior(prior),
        **{"method": "implicit-loop", **how},
    )


@pytest.mark.parametrize("seed", range(12))
def test_the_exchanged_links_are_found_and_fit_worse(seed: int) -> None:
    result = fitted(WEAK, {"*": np.inf}, seed)
    assert result.value["l2"] == pytest.approx(0.8, abs=0.01)
    (other,) = other_optima(result)
    # a negative link is the same link turned round
    assert abs(other.parameters["l2"]) == pytest.approx(0.6, abs=0.01)
    assert abs(other.parameters["l3"]) == pytest.approx(0.8, abs=0.01)
    assert other.of_result is not None
    assert other.of_result < other.chi_squared < 2.0 * other.of_result
    assert "another optimum" in lc.findings(result).words()
    assert result.document.other_optima == (other,)


@pytest.mark.parametrize("seed", range(4))
def test_a_prior_settles_it(seed: int) -> None:
    result = fitted(WEAK, {"*": 0.01}, seed)  # 10 mm and 10 mrad
    assert result.value["l2"] == pytest.approx(0.8, abs=0.01)
    assert other_optima(result) == ()


def test_a_start_at_the_exchange_is_told_that_it_is_not_the_best() -> None:
    start = {"l2": 0.6, "l3": 0.8}
    result = fitted(WEAK, {"*": np.inf}, 0, start=start)
    assert result.value["l2"] == pytest.approx(0.6, abs=0.01)
    (other,) = other_optima(result)
    assert other.of_result is not None
    assert other.chi_squared < other.of_result
    assert "fits better" in str(other)


def test_good_encoders_leave_one_optimum() -> None:
    good = WEAK | {"phi2": 1e-3}
    assert other_optima(fitted(good, {"*": np.inf}, 0)) == ()


def test_an_optimum_of_the_same_parameters_is_not_told_of(monkeypatch: pytest.MonkeyPatch) -> None:
    # A joint of one pose without a reading stands elsewhere; the machine is the same.
    result = fitted(WEAK, {"*": np.inf}, 0)
    assert result.chi_squared is not None
    ended = SimpleNamespace(
        status=SimpleNamespace(converged=True),
        parameters=np.array([result.value[n] for n in result.mechanism.parameters.names]),
        chi_squared=1.05 * result.chi_squared.value,
    )

    def solve(*_args: Any, **_how: Any) -> Any:
        return ended

    monkeypatch.setattr(optima, "solve", solve)
    fit = replace(result.fit, method=replace(result.fit.solver, solve=solve))
    assert other_optima(replace(result, fit=fit)) == ()
