"""Where a fit without some poses begins: one step from the fit of all, nearly where it will end."""

from __future__ import annotations

import numpy as np
import pytest

import loopcal as lc
from loopcal.estimation.leaving_out import LeavingOut, settled
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


def test_two_steps_end_where_a_fit_of_the_rest_does() -> None:
    whole = lc.calibrate(ARM.truth, DATA, noise=lc.Noise(SDS), method="implicit-loop")
    gone = np.arange(0, 60, 10)
    begun = LeavingOut(whole).begun(gone)
    assert begun is not None
    end = settled(whole, begun, gone, 1e-4)
    assert end is not None
    rest = DATA.take(np.setdiff1d(np.arange(60), gone))
    part = lc.calibrate(ARM.truth, rest, noise=lc.Noise(SDS), method="implicit-loop")
    for name, value in zip(whole.mechanism.parameters.names, end.tolist(), strict=True):
        assert abs(value - part.value[name]) <= 1e-3 * (part.sd[name] or 1e-12)


def test_sds_of_sensors_are_learnt_of_the_rest() -> None:
    """One step from those of all poses, by sums over poses: nearer than those are."""
    stated = {"xP": 2e-4, "yP": 2e-4, "phi2": 1e-3, "phi3": 1e-3}
    learnt: dict[tuple[str, ...], str] = {("xP", "yP"): "group"}
    noise = lc.Noise(stated, estimate=learnt)
    whole = lc.calibrate(ARM.truth, DATA, noise=noise, method="implicit-loop")
    gone = np.arange(12)
    begun = LeavingOut(whole).begun(gone)
    assert begun is not None
    assert whole.estimate is not None
    rest = DATA.take(np.setdiff1d(np.arange(60), gone))
    part = lc.calibrate(ARM.truth, rest, noise=noise, method="implicit-loop")
    assert part.estimate is not None
    for name, factor in part.estimate.factors.items():
        away = abs(np.log(whole.estimate.factors[name] / factor))
        assert abs(np.log(begun.factors[name] / factor)) < 0.2 * away


def test_a_step_that_bends_is_not_believed() -> None:
    """With joints that err by 3 degrees the loops are curved within a step."""
    sds = {"xP": 1e-3, "yP": 1e-3, "phi2": 0.05, "phi3": 0.05}
    data = ARM.read(sds, seed=4)
    whole = lc.calibrate(ARM.truth, data, noise=lc.Noise(sds), method="implicit-loop")
    gone = np.arange(40)
    begun = LeavingOut(whole).begun(gone)
    assert begun is not None
    assert settled(whole, begun, gone, 1e-5) is None


def test_a_further_sweep_ends_what_one_sweep_does_not() -> None:
    """The same joints: one sweep is not believed, the next ends where a fit of the rest does."""
    sds = {"xP": 1e-3, "yP": 1e-3, "phi2": 0.05, "phi3": 0.05}
    data, gone = ARM.read(sds, seed=4), np.arange(40)
    whole = lc.calibrate(ARM.truth, data, noise=lc.Noise(sds), method="implicit-loop")
    begun = LeavingOut(whole).begun(gone)
    assert begun is not None
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("loopcal.estimation.leaving_out._STEPS", 1)
        assert settled(whole, begun, gone, 1e-2) is None
    end = settled(whole, begun, gone, 1e-2)
    assert end is not None
    rest = data.take(np.setdiff1d(np.arange(60), gone))
    part = lc.calibrate(ARM.truth, rest, noise=lc.Noise(sds), method="implicit-loop")
    for name, value in zip(whole.mechanism.parameters.names, end.tolist(), strict=True):
        assert abs(value - part.value[name]) <= 1e-2 * (part.sd[name] or 1e-12)


def test_a_fit_that_leaves_a_parameter_open_is_not_stepped_to() -> None:
    whole = lc.calibrate(ARM.truth, DATA, noise=lc.Noise(SDS), method="implicit-loop")
    gone = np.arange(59)
    begun = LeavingOut(whole).begun(gone)
    assert begun is None or settled(whole, begun, gone, 1e-2) is None
