"""A chi-squared that is too large: what model error would explain it; sds scaled on request."""

from __future__ import annotations

import numpy as np
import pytest

import loopcal as lc
from loopcal.estimation.calibrate import calibrate
from loopcal.workflow.result import Result
from tests.refusals import refused

NOISE = {"?P": 1e-4, "phi?": 1e-4}


def readings(disturbed: float) -> dict[str, np.ndarray]:
    turns = np.radians(np.arange(0, 100, 10.0))
    phi2, phi3 = (a.ravel() for a in np.meshgrid(turns, turns))
    arm = lc.planar_two_link()
    data = lc.simulate(arm, {"phi2": phi2, "phi3": phi3}, noise=lc.Noise(NOISE), seed=1).dataset
    rng = np.random.default_rng(2)
    return {
        q: np.array(data[q]) + (rng.normal(scale=disturbed, size=100) if q[1] == "P" else 0.0)
        for q in data.quantities
    }


def test_the_model_error_is_found_and_said() -> None:
    result = calibrate(lc.planar_two_link(), readings(2e-3), noise=lc.Noise(NOISE))
    assert result.model_discrepancy == pytest.approx(2e-3, rel=0.2)
    said = f"an error of about {result.model_discrepancy:.2g} m in each coordinate"
    assert any(said in warning for warning in result.warnings)


def test_where_the_sds_are_right_nothing_is_missing() -> None:
    result = calibrate(lc.planar_two_link(), readings(0.0), noise=lc.Noise(NOISE))
    assert result.model_discrepancy is None
    assert not result.warnings


def test_the_variance_factor_is_applied_on_request_and_once() -> None:
    result = calibrate(lc.planar_two_link(), readings(2e-3), noise=lc.Noise(NOISE))
    scaled = result.with_variance_factor()
    assert result.chi_squared is not None
    assert result.chi_squared.variance_factor is not None
    root = result.chi_squared.variance_factor**0.5
    for name in result.estimated:
        assert scaled.sd[name] == pytest.approx((result.sd[name] or 0.0) * root)
    assert scaled.covariance == pytest.approx(result.covariance * root**2)
    assert scaled.with_variance_factor() is scaled
    assert "multiplied by the root" in str(Result.of(scaled))
    plain = calibrate(lc.planar_two_link(), readings(0.0), method="least-squares")
    with refused("unsupported", "'least-squares'"):
        plain.with_variance_factor()
