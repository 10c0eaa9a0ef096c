"""Makers' figures: what they come to as sds and covariances, and what cannot be one."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import loopcal as lc
from loopcal.errors import InputError
from loopcal.measurements.datasheet import DatasheetSd, Tracker, length_figure
from loopcal.measurements.noise import resolve_noise
from tests.refusals import refused

AT500: dict[str, Any] = {"range": "10 um + 0.3 um/m", "transverse": "15 um + 6 um/m"}
POINTS = np.random.default_rng(3).normal(0, 4, (40, 3))


def rotation(seed: int) -> np.ndarray:
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.linalg.det(q)


def test_on_the_axis_range_and_transverse_are_told_at_once():
    C = lc.tracker_covariance([[4.0, 0, 0], [0, -2.0, 0]], **AT500, kind="sd")
    range_4, across_4 = 10e-6 + 4 * 0.3e-6, 15e-6 + 4 * 6e-6
    np.testing.assert_allclose(C[0], np.diag([range_4**2, across_4**2, across_4**2]), rtol=1e-12)
    range_2, across_2 = 10e-6 + 2 * 0.3e-6, 15e-6 + 2 * 6e-6
    np.testing.assert_allclose(C[1], np.diag([across_2**2, range_2**2, across_2**2]), rtol=1e-12)


def test_the_preset_is_half_of_the_printed_permissible_errors():
    printed = lc.tracker_covariance(POINTS, **AT500, kind="sd")
    np.testing.assert_allclose(lc.tracker_covariance(POINTS, "leica-at500"), printed / 4)
    np.testing.assert_allclose(lc.tracker_covariance(POINTS, **AT500), printed / 4)
    uniform = lc.tracker_covariance(POINTS, "leica-at500", coverage="uniform")
    np.testing.assert_allclose(uniform, printed / 3)
    np.testing.assert_allclose(lc.tracker_covariance(POINTS, **AT500, coverage=3), printed / 9)


@pytest.mark.parametrize("seed", range(3))
def test_turning_the_frame_turns_the_covariance(seed):
    R = rotation(seed)
    here = lc.tracker_covariance(POINTS, "leica-at500")
    there = lc.tracker_covariance(POINTS @ R.T, "leica-at500")
    np.testing.assert_allclose(there, R @ here @ R.T, rtol=1e-10, atol=1e-22)


def test_the_covariance_is_that_of_where_the_instrument_stands():
    station = np.array([1.0, -2.0, 0.5])
    moved = lc.tracker_covariance(POINTS + station, "leica-at500", station=station)
    np.testing.assert_allclose(moved, lc.tracker_covariance(POINTS, "leica-at500"), rtol=1e-9)


def test_noise_drawn_in_range_and_direction_has_that_covariance():
    point, draws = np.array([3.0, 4.0, 12.0]), 200_000
    rng = np.random.default_rng(11)
    distance = 13.0
    u = point / distance
    across = np.linalg.svd(u[None])[2][1:]
    sd_range, sd_across = (10 + 0.3 * distance) * 1e-6, (15 + 6 * distance) * 1e-6
    length = distance + sd_range * rng.normal(size=draws)
    angles = sd_across / distance * rng.normal(size=(draws, 2))
    direction = u + angles @ across
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    seen = np.cov((length[:, None] * direction).T)
    expected = lc.tracker_covariance([point], **AT500, kind="sd")[0]
    np.testing.assert_allclose(seen, expected, atol=0.015 * expected.max())


def test_an_angle_grows_with_distance():
    figure = length_figure("2 arcsec")
    assert figure.constant == 0.0
    assert figure.per_metre == pytest.approx(2 * math.pi / 180 / 3600)
    assert length_figure("±0.01 mm + 5 um/m").constant == pytest.approx(1e-5)
    assert length_figure("1e-5 m + 0.006mm / m").per_metre == pytest.approx(6e-6)


def test_in_a_plane_there_is_one_transverse_direction():
    C = lc.tracker_covariance([[0.0, 2.0]], range="10 um", transverse="2 um", kind="sd")
    np.testing.assert_allclose(C, [np.diag([4e-12, 1e-10])])


def test_native_readings_have_the_same_covariance_as_the_point_they_make():
    """C = J S J^T, with J the derivative of x, y, z by range, azimuth and elevation."""
    rng = np.random.default_rng(8)
    r, a, e = rng.uniform(1, 20, 30), rng.uniform(-3, 3, 30), rng.uniform(-1.2, 1.2, 30)
    u = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    level = np.array([-np.sin(a), np.cos(a), 0 * a])
    up = np.array([-np.sin(e) * np.cos(a), -np.sin(e) * np.sin(a), np.cos(e)])
    J = np.array([u, r * np.cos(e) * level, r * up]).transpose(2, 1, 0)
    native = Tracker.of("leica-at500", native=True).covariance(np.array([r, a, e]).T)
    points = lc.tracker_covariance((r * u).T, "leica-at500")
    np.testing.assert_allclose(J @ native @ J.transpose(0, 2, 1), points, rtol=1e-12, atol=1e-24)
    flat = Tracker.of("leica-at500", native=True).covariance(np.array([r, a]).T)
    np.testing.assert_allclose(flat[:, 1, 1], native[:, 2, 2])


def test_rounded_coordinates_add_their_variance():
    plain = lc.tracker_covariance(POINTS, "leica-at500")
    rounded = lc.tracker_covariance(POINTS, "leica-at500", rounded_to=1e-4)
    np.testing.assert_allclose(
        rounded - plain, np.broadcast_to(np.eye(3) * 1e-8 / 12, plain.shape), atol=1e-16
    )


def test_the_sd_of_an_encoder_is_that_of_its_uniform_rounding():
    rng = np.random.default_rng(5)
    step = 2 * np.pi / 4096
    true = rng.uniform(-np.pi, np.pi, 400_000)
    seen = np.std(np.round(true / step) * step - true)
    assert lc.encoder_sd(counts=4096) == pytest.approx(seen, rel=5e-3)
    assert lc.encoder_sd(bits=12) == lc.encoder_sd(counts=4096)
    assert lc.encoder_sd(rounded_to=step) == pytest.approx(lc.encoder_sd(bits=12))
    assert lc.encoder_sd(bits=12, gear=100) == pytest.approx(lc.encoder_sd(bits=12) / 100)


def test_parts_of_an_encoder_add_in_quadrature():
    arcsec = np.pi / 180 / 3600
    assert lc.encoder_sd(accuracy="5 arcsec") == pytest.approx(2.5 * arcsec)
    assert lc.encoder_sd(accuracy="5 arcsec", kind="sd") == pytest.approx(5 * arcsec)
    assert lc.encoder_sd(accuracy="3 um", coverage="uniform") == pytest.approx(3e-6 / 3**0.5)
    both = lc.encoder_sd(bits=20, accuracy="5 arcsec", rounded_to=1e-5)
    parts = [lc.encoder_sd(bits=20), lc.encoder_sd(accuracy="5 arcsec"), 1e-5 / 12**0.5]
    assert both == pytest.approx(np.linalg.norm(parts))


def expand(key: str) -> tuple[str, ...]:
    return {"q*": ("q1", "q2")}.get(key, (key,))


def test_as_noise_it_follows_every_reading_and_says_where_it_is_from():
    points = np.array([[1.0, 0, 0], [0, 5.0, 0], [np.nan, 1.0, 2.0]])
    columns = dict(zip("xyz", points.T, strict=True))
    data = lc.Dataset.from_arrays({"q1": np.zeros(3), "q2": np.zeros(3), **columns})
    noise = lc.Noise(
        {"q*": lc.encoder_sd(bits=20), "q2": 1e-3, ("x", "y", "z"): Tracker.of("leica-at500")}
    )
    found = resolve_noise(noise, data, ["q1", "q2", "x", "y", "z"], expand)
    assert found.sources == ("datasheet", "given", *["datasheet"] * 3)
    (block,) = found.blocks
    covariance = block.factor @ np.swapaxes(block.factor, 1, 2)
    np.testing.assert_allclose(
        covariance[:2], lc.tracker_covariance(points[:2], "leica-at500"), atol=1e-20
    )
    assert np.isinf(found.sd[2]).tolist() == [False, False, True]
    assert "Tracker" in repr(noise)
    assert noise == lc.Noise(dict(noise.entries))


def test_a_number_it_is_all_the_same():
    sd = lc.encoder_sd(bits=20)
    assert isinstance(sd, DatasheetSd)
    assert sd == 2 * np.pi / 2**20 / 12**0.5


def test_a_lost_reflector_is_named_by_its_pose():
    data = lc.Dataset.from_arrays({q: [1.0, 0.0] for q in "xyz"}, poses=["a", "lost"])
    noise = lc.Noise({("x", "y", "z"): Tracker.of("leica-at500")})
    with refused("lost-reflector") as caught:
        resolve_noise(noise, data, ["x", "y", "z"], lambda key: (key,))
    assert "lost" in str(caught.value)


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: lc.tracker_covariance([[1.0, 0, 0]], "leica-at900"),
        lambda: lc.tracker_covariance([[1.0, 0, 0]], "leica-at500", kind="sd"),
        lambda: lc.tracker_covariance([[1.0, 0, 0]], range="10 um"),
        lambda: lc.tracker_covariance([[1.0, 0, 0]], range="10", transverse="1 um"),
        lambda: lc.tracker_covariance([[1.0, 0, 0]], range="1.2.3 um", transverse="1 um"),
        lambda: lc.tracker_covariance([[1.0, 0, 0]], range="10 um/s", transverse="1 um"),
        lambda: lc.tracker_covariance([[1.0, 0, 0]], range="10 kg", transverse="1 um"),
        lambda: lc.tracker_covariance([[1.0, 0, 0]], "leica-at500", coverage=0),
        lambda: lc.tracker_covariance([[1.0, 0, 0]], "leica-at500", coverage="normal"),
        lambda: lc.tracker_covariance([[1.0, 0, 0]], **AT500, kind="sd", coverage=2),
        lambda: lc.tracker_covariance([[1.0, 0, 0]], **AT500, kind="typical"),
        lambda: lc.tracker_covariance([1.0, 0, 0], "leica-at500"),
        lambda: lc.tracker_covariance([[1.0, 0, 0]], "leica-at500", station=[0, 0]),
        lambda: lc.tracker_covariance([[0.0, 0, 0]], "leica-at500"),
        lambda: lc.tracker_covariance([[1.0, 0, 0]], "leica-at500", rounded_to=-1),
        lambda: Tracker.of("leica-at500", native=True, station=[0, 0, 0]),
        lambda: Tracker.of("leica-at500", native=True).covariance([[0.0, 1.0, 0.1]]),
        lambda: lc.encoder_sd(),
        lambda: lc.encoder_sd(bits=0),
        lambda: lc.encoder_sd(bits=3, counts=8),
        lambda: lc.encoder_sd(counts=-5),
        lambda: lc.encoder_sd(bits=3, kind="mpe"),
        lambda: lc.encoder_sd(accuracy="5"),
        lambda: lc.encoder_sd(accuracy="5 um + 1 um/m"),
        lambda: lc.encoder_sd(bits=3, gear=0),
        lambda: lc.Noise({"x": Tracker.of("leica-at500")}),
        lambda: lc.Noise({("x", "y"): Tracker.of("leica-at500", station=[0, 0, 1])}),
    ],
)
def test_what_cannot_be_a_figure_is_refused_with_a_remedy(wrong):
    with pytest.raises(InputError) as caught:
        wrong()
    assert caught.value.remedy
