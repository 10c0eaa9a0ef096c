"""An error that no term explains is named with the joint that it follows."""

from __future__ import annotations

import numpy as np

import loopcal as lc
from loopcal.statistics.change_points import find_shifts
from tests.reference.simulated import MA1400_RANGES
from tests.statistics.test_change_points import ARM, read

REGION = {f"theta_{i + 1}": (low, high) for i, (low, high) in enumerate(MA1400_RANGES)}


def joints(seed: int, share: float) -> dict[str, np.ndarray]:
    """90 random poses in the middle of each joint's range."""
    low, high = MA1400_RANGES.T
    middle, half = 0.5 * (low + high), 0.5 * share * (high - low)
    q = np.random.default_rng(seed).uniform(middle - half, middle + half, (90, 6))
    return {f"theta_{i}": q[:, i - 1] for i in range(1, 7)}


def calibrated(seed: int, coupling: float, share: float = 0.5) -> lc.Result:
    """The controller states joint 6 without its share of joint 5."""
    data = read(joints(seed, share), seed)
    wrong = data["theta_6"] - coupling * data["theta_5"]
    noise = lc.Noise({"theta_*": 5e-5, "[xyz]": 5e-5}, estimate={"[xyz]": "group"})
    return lc.calibrate(
        ARM, data.with_readings({"theta_6": wrong}), noise=noise, method="implicit-loop"
    )


def test_a_wrong_coupling_of_a_wrist_is_named_by_the_joint_before_it() -> None:
    """Outside the measured joints the true error was up to four times the stated, "valid"."""
    result = calibrated(1, 4e-3)
    one = find_shifts(result).joint_error
    assert one is not None
    assert one.joint == "theta_5"
    assert one.p_value < 1e-6
    answer = lc.verdict(result, region=REGION).valid
    assert (answer.passed, answer.code) == (None, "error-follows-joint")
    assert "follows theta_5" in answer.words
    assert "of whose range 48 % was measured" in answer.words


def test_where_all_of_its_range_was_measured_the_stated_sd_holds() -> None:
    result = calibrated(1, 4e-3, 1.0)
    assert find_shifts(result).joint_error is not None
    assert lc.verdict(result, region=REGION).valid.code == "valid-in-region"


def test_of_a_machine_that_is_as_modelled_nothing_is_left_that_follows_a_joint() -> None:
    for seed in range(10):
        assert find_shifts(calibrated(seed, 0.0)).joint_error is None


def test_images_are_not_searched() -> None:
    from tests.statistics.test_pose_delay import calibrated as seen

    assert find_shifts(seen(0)).joint_error is None
