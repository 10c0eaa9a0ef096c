"""What happened to a camera during a run is named: it was moved, or its focus changed."""

from __future__ import annotations

import numpy as np
import pytest

import loopcal as lc
from loopcal.statistics.change_points import find_shifts
from tests.mechanisms import test_camera
from tests.mechanisms.test_camera import NEAR, hands, mechanism, pixels, readings

POINTS = {str(i): (0.04 * (i % 4) - 0.06, 0.04 * (i // 4) - 0.04, 0.0) for i in range(12)}
PLACE = {"eye_x": 0.1, "eye_z": 1.1, "eye_ry": 0.1, "eye_rx": 3.0}
LENS = {"eye_f": 900.0, "eye_cx": 630.0, "eye_cy": 470.0}
SDS = {"[xyz]": 1e-4, "w?": 1e-4, "eye": 0.2}


@pytest.mark.parametrize(
    ("name", "size", "moved"), [("eye_f", 9.0, "lens"), ("eye_z", 8e-3, "station")]
)
def test_a_change_of_focus_is_no_move_of_the_camera(name: str, size: float, moved: str) -> None:
    random = np.random.default_rng(11)
    eye = lc.instruments.camera("eye", points=POINTS, lens="pinhole")
    still = lc.assemble(lc.machines.free_body(), [eye], {**PLACE, **LENS})
    changing = lc.with_effects(still, [lc.effects.Shift((name,), (15.0,))])
    w = random.uniform(-0.25, 0.25, (3, 30))
    q = dict(zip(("qx", "qy", "qz"), w, strict=True))
    at = np.array([0.15, 0.15, 0.4]) * random.uniform(-1.0, 1.0, (30, 3))
    hands = dict(zip("xyz", at.T, strict=True)) | q
    hands |= {"qw": np.sqrt(1.0 - np.square(w).sum(axis=0)), "pose": np.arange(30.0)}
    truth = changing.with_nominal({f"{name}_from15": size})
    data = lc.simulate(truth, hands, noise=lc.Noise(SDS), seed=3).dataset
    result = lc.calibrate(still, data, noise=lc.Noise(SDS), method="implicit-loop")
    first = min(find_shifts(result).found, key=lambda point: point.p_value)
    assert (first.moved, first.pose) == (moved, "16")
    change = first.changes[name]
    assert abs(change.size - size) < 4.0 * change.sd + 0.1 * size
    assert ("the focal length eye_f changed" in first.what) == (moved == "lens")


@pytest.mark.parametrize("turned", [0.0, 0.004])
def test_of_a_camera_on_a_hand_that_never_turns_the_turn_alone_is_named(
    turned: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where it sits shows only where the board stands, and `verify` ended in an IndexError."""
    x, y, z, rz, ry, rx = NEAR

    def day(seed: int, count: int) -> lc.Dataset:
        T = hands(count, seed)
        T[:, :3, :3] = np.eye(3)
        uv = pixels(T, on="body")
        noise = np.random.default_rng(seed).normal(0.0, 0.1, uv.shape)
        return lc.Dataset.from_arrays(readings(T, uv + noise))

    made = mechanism("body")
    held = made.with_parameters(made.parameters.with_prior({"eye_[xyz]": 0.02}))
    noise = lc.Noise({"[xyz]": 1e-5, "w?": 1e-5, "eye": 0.1})
    result = lc.calibrate(held, day(64300, 16), noise=noise, method="implicit-loop")
    monkeypatch.setattr(test_camera, "NEAR", (x, y, z, rz + turned, ry, rx))
    done = lc.verify(result, day(64301, 8))
    assert done.changes is not None
    assert done.verdict["consistent"].passed == (not turned)
    assert [change.name for change in done.changes.found] == (["eye"] if turned else [])
    for change in done.changes.found:
        assert change.unit == "rad"
        assert change.low < turned < change.high
        assert "eye turned by" in change.words
        assert {"eye_x", "eye_y", "eye_z"} <= {*change.hidden}
