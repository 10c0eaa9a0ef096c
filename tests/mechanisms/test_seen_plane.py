"""A plane that a camera with depth sees, against planes that are carried over by matrices."""

from __future__ import annotations

import numpy as np
import pytest

import loopcal as lc
from loopcal.estimation.mounted import Bodies, see_planes
from loopcal.mechanisms.station import pose_of
from tests.refusals import refused

CAMERA = {"x": 0.03, "y": -0.02, "z": 0.05, "rz": 0.4, "ry": -0.3, "rx": 0.2}
WALL = {"tilt_1": 0.02, "tilt_2": -0.03, "distance": 2.5}
SD = 1e-3
"""Of angles [rad] and distance [m]."""
NORMAL = (0.0, 0.0, 1.0)
ARM = lc.machines.serial([lc.Joint(f"q{i}") for i in range(1, 7)])
DRAWING = {"d_1": 0.4, "a_2": 0.5, "a_3": 0.1, "d_4": 0.6, "a_5": 0.05, "d_6": 0.1}
DRAWING |= {"alpha_1": -1.57, "alpha_3": -1.57, "alpha_4": 1.57, "alpha_5": -1.57}
EYE = lc.instruments.seen_plane("depth", plane="wall", normal=NORMAL)
SEEING = lc.assemble(ARM, [EYE], DRAWING)


def cameras(q: np.ndarray) -> np.ndarray:
    """(N, 4, 4) of the camera in the base."""
    return SEEING.fk(q) @ pose_of([*CAMERA.values()])


def normal() -> np.ndarray:
    """n of the wall, tilted from z towards x and y."""
    a, b = WALL["tilt_1"], WALL["tilt_2"]
    e_1, e_2 = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
    return np.cos(b) * (np.cos(a) * np.array(NORMAL) + np.sin(a) * e_1) + np.sin(b) * e_2


def seen(q: np.ndarray) -> dict[str, np.ndarray]:
    """What the camera reads at joints (N, 6): the plane in its frame by the transposed turn."""
    T = cameras(q)
    n = np.einsum("nji,j->ni", T[:, :3, :3], normal())
    away = WALL["distance"] - T[:, :3, 3] @ normal()
    return {
        "depth_tilt_x": np.arcsin(n[:, 0]),
        "depth_tilt_y": np.arcsin(n[:, 1]),
        "depth_range": away,
    }


def poses(count: int, rng: np.random.Generator) -> np.ndarray:
    """Joints that turn the camera to the wall, within 60 degrees."""
    q = rng.uniform(-1.5, 1.5, (40 * count, 6))
    return q[cameras(q)[:, :3, 2] @ np.array(NORMAL) > 0.5][:count]


def test_a_camera_that_is_mounted_as_stated_finds_the_wall_and_its_place_on_the_hand() -> None:
    rng = np.random.default_rng(11)
    q = poses(40, rng)
    read = {f"q{i}": q[:, i - 1] for i in range(1, 7)} | seen(q)
    read |= {name: read[name] + SD * rng.normal(size=len(q)) for name in EYE.readings}
    noise = {"depth_*": SD, "q*": 0.0}
    held = [p.name for p in SEEING.parameters if p.owner not in ("depth", "wall")]
    begun = {f"depth_{k}": v + 0.05 for k, v in CAMERA.items()} | {"wall_distance": 2.0}
    parameters = SEEING.parameters.with_nominal(begun).with_fixed(held)
    machine = SEEING.with_parameters(parameters)
    result = lc.calibrate(machine, read, noise=noise, method="implicit-loop")
    truth = {f"depth_{k}": v for k, v in CAMERA.items()} | {f"wall_{k}": v for k, v in WALL.items()}
    sds = np.array([result.sd[k] or np.inf for k in truth])
    off = np.array([result.value[k] - v for k, v in truth.items()])
    assert np.abs(off / sds).max() < 4.0
    assert sds.max() < 2e-3
    chi = result.chi_squared
    assert chi is not None
    assert 0.6 < chi.value / chi.degrees_of_freedom < 1.5


def test_three_readings_are_named() -> None:
    with refused("wrong-shape", "'depth'", "2 readings"):
        lc.instruments.seen_plane(readings=["a", "b"])


def test_a_plane_is_no_line() -> None:
    with pytest.raises(lc.InputError, match="dimensions"):
        lc.assemble(lc.machines.planar_two_link(), [lc.instruments.seen_plane()])


@pytest.mark.parametrize("stated", [True, False])
def test_the_plane_and_the_camera_are_placed_by_what_it_sees(stated: bool) -> None:
    q = poses(30, np.random.default_rng(4))
    T, (x, y, away) = SEEING.fk(q), seen(q).values()
    n_camera = np.stack([np.sin(x), np.sin(y), np.sqrt(1.0 - np.sin(x) ** 2 - np.sin(y) ** 2)], 1)
    bodies = Bodies(T[:, :3, :3], T[:, :3, 3])
    camera, n, c = see_planes(bodies, n_camera, away, normal() if stated else None)
    np.testing.assert_allclose(n, normal(), atol=1e-6)
    np.testing.assert_allclose(c, WALL["distance"], atol=1e-5)
    np.testing.assert_allclose(camera, pose_of([*CAMERA.values()]), atol=1e-5)
