"""Where a fit without some poses begins: one step from the fit of all, nearly where it will end."""

from __future__ import annotations

import numpy as np
import pytest

import loopcal as lc
from loopcal.estimation.leaving_out import LeavingOut
from tests.reference.simulated import planar_arm

SDS = {"xP": 1e-4, "yP": 1e-4, "phi2": 1e-3, "phi3": 1e-3}
ARM = planar_arm(60)
DATA = ARM.read(SDS, seed=4)


@pytest.mark.parametrize("method", ["implicit-loop", "least-squares"])
@pytest.mark.parametrize("gone", [np.arange(0, 60, 10), np.arange(15)])
def test_the_rest_of_the_poses_end_near_where_they_begin(
    method: str, gone: np.ndarray[tuple[int], np.dtype[np.intp]]
) -> None:
    whole = lc.calibrate(ARM.truth, DATA, noise=lc.Noise(SDS), method=method)
    rest = DATA.take(np.setdiff1d(np.arange(60), gone))
    part = lc.calibrate(ARM.truth, rest, noise=lc.Noise(SDS), method=method)
    begun = LeavingOut(whole).begun(gone)
    assert begun is not None
    assert not begun.factors
    for name in whole.estimated:
        sd = part.sd[name] or 1.0
        moved = abs(whole.value[name] - part.value[name]) / sd
        assert abs(begun.values[name] - part.value[name]) < max(0.1 * moved, 0.01) * sd


def test_what_is_learnt_of_the_rest_is_known_from_the_sums() -> None:
    rng = np.random.default_rng(3)
    arm = ARM.truth.with_nominal({"l2": ARM.truth.parameters["l2"].nominal + 1e-3})
    whole = lc.calibrate(
        arm, DATA, noise=lc.Noise(SDS), method="least-squares", model_error="structured"
    )
    gone = np.sort(rng.permutation(60)[:8])
    rest = DATA.take(np.setdiff1d(np.arange(60), gone))
    begun = LeavingOut(whole).begun(gone)
    assert begun is not None
    assert begun.problem.mechanism.learnt_terms
    part = lc.calibrate(begun.problem.mechanism, rest, noise=lc.Noise(SDS), method="least-squares")
    for before, after in zip(
        begun.problem.mechanism.parameters, part.mechanism.parameters, strict=True
    ):
        if np.isfinite(before.prior_sd):
            assert after.prior_sd == pytest.approx(before.prior_sd, rel=0.1)
