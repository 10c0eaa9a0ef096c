"""Poses that were not read at the moment of their images are named with their share of the way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import loopcal as lc
from loopcal.document.findings import Undetermined
from loopcal.statistics.change_points import find_shifts
from loopcal.statistics.ordered_system import ordered_system
from loopcal.statistics.pose_delay import pose_delay
from loopcal.statistics.verdict import findings_of
from tests.mechanisms.test_camera import SIX
from tests.reference.simulated import planar_arm
from tests.statistics.test_camera_changes import LENS, PLACE, POINTS, SDS
from tests.statistics.test_change_points import ARM, NOISE, joints
from tests.statistics.test_change_points import read as read_by_tracker
from tests.statistics.test_comparison import sds_of
from tests.statistics.test_verdict import depends

SHARE = 0.02
FILES = {"project": "project.toml", "result": "result"}


def hands(seed: int, ordered: bool) -> dict[str, NDArray[np.float64]]:
    """30 poses of a hand before a camera; ordered: along a path."""
    w, at = np.random.default_rng(seed).uniform(-1.0, 1.0, (2, 30, 3))
    if ordered:
        phase = np.linspace(0.0, np.pi, 30)[:, None]
        w, at = np.cos(phase + np.arange(3.0)), np.sin(0.5 * phase + np.arange(3.0))
    turn = Rotation.from_rotvec(0.5 * w).as_quat().T
    place = np.array([0.15, 0.15, 0.4]) * at
    return dict(zip(("qx", "qy", "qz", "qw", *"xyz"), (*turn, *place.T), strict=True))


def delayed(true: dict[str, NDArray[np.float64]], step: int) -> dict[str, NDArray[np.float64]]:
    """What is read a share of the way to a neighbour."""
    i = np.arange(30)
    to = np.clip(i + step, 0, 29)
    q = Rotation.from_quat(np.column_stack([true[c] for c in ("qx", "qy", "qz", "qw")]))
    turn = (q * Rotation.from_rotvec(SHARE * (q.inv() * q[to]).as_rotvec())).as_quat().T
    place = [true[c] + SHARE * (true[c][to] - true[c]) for c in "xyz"]
    return dict(zip(("qx", "qy", "qz", "qw", *"xyz"), (*turn, *place), strict=True))


def machine() -> lc.Mechanism:
    eye = lc.instruments.camera("eye", points=POINTS, lens="pinhole")
    return lc.assemble(lc.machines.free_body(), [eye], {**PLACE, **LENS})


def read(step: int, seed: int, ordered: bool = False) -> lc.Dataset:
    true = hands(seed, ordered)
    data = lc.simulate(machine(), true, noise=lc.Noise(SDS), seed=seed).dataset
    if not step:
        return data
    stated = delayed(true, step)
    moved = {c: data[c] + stated[c] - true[c] for c in "xyz"}
    return data.with_readings({**moved, **{c: stated[c] for c in ("qx", "qy", "qz", "qw")}})


def calibrated(step: int, seed: int = 1, ordered: bool = False) -> lc.Result:
    noise = lc.Noise(SDS)
    noise = lc.Noise(SDS, estimate={"[xyz]": "group", "w?": "group"}) if step else noise
    data = read(step, seed, ordered)
    return lc.calibrate(machine(), data, noise=noise, method="implicit-loop")


@pytest.mark.parametrize("step", [1, -1])
def test_a_delay_is_a_share_of_the_way_to_a_neighbour(step: int) -> None:
    result = calibrated(step)
    delay = find_shifts(result).delay
    assert delay is not None
    assert delay.ahead == (step > 0)
    assert delay.p_value < 1e-6
    assert delay.share == pytest.approx(SHARE, abs=0.1 * SHARE)
    assert result.verdict is not None
    (one,) = (f for f in result.verdict.findings if f.code == "poses-delayed")
    assert one.title.startswith(
        "The machine's readings are from "
        + ("after each pose is left" if step > 0 else "before each pose is reached")
    )
    assert f"% of the way {'to the next' if step > 0 else 'from the last'} one" in one.title


def test_an_instrument_may_read_before_the_machine_stands() -> None:
    arm = planar_arm(40)
    noise = lc.Noise(sds_of(arm))
    q = {name: arm.read(sds_of(arm), 1)[name] for name in ("phi2", "phi3")}
    left = {name: SHARE * (np.roll(values, 1) - values) for name, values in q.items()}
    true = {name: values + left[name] for name, values in q.items()}
    data = lc.simulate(arm.truth, true, noise=noise, seed=1).dataset
    late = data.with_readings({name: data[name] - left[name] for name in q})
    delay = find_shifts(lc.calibrate(arm.truth, late, noise=noise, method="implicit-loop")).delay
    assert delay is not None
    assert not delay.ahead
    assert delay.share == pytest.approx(-SHARE, abs=0.1 * SHARE)


@pytest.mark.parametrize("seed", [61011, 61014, 61019])
def test_columns_that_take_up_the_poses_leave_no_delay(seed: int) -> None:
    """Steps of 14 places at four poses leave little of 30 poses, whatever corners they have."""
    data, random = read(0, seed), np.random.default_rng(seed)
    data = data.with_readings({c: data[c] + random.normal(0.0, 1e-3, 30) for c in "xyz"})
    result = lc.calibrate(machine(), data, method="least-squares")
    fit = ordered_system(result).fitted()
    places = [n for n in fit.system.problem.names if n.split("_")[-1] in SIX]
    columns = fit.system.columns(places)
    for pose in (6, 11, 16, 21):
        fit = fit.beside(columns * (np.arange(30) >= pose)[:, None, None])
    delay = pose_delay(fit.again())
    assert delay is None or delay.p_value > 0.01


def test_images_far_off_the_machine_leave_the_verdict_open() -> None:
    document = calibrated(0).document
    accuracy = document.accuracy
    assert accuracy is not None

    def off(px: float) -> list[str]:
        (one,) = accuracy.by
        assert one.position is not None
        position = replace(one.position, after=replace(one.position.after, rms=px))
        far = replace(accuracy, by=(replace(one, position=position),))
        made = findings_of(replace(document, accuracy=far), files=FILES)
        return [f.code for f in made if (f.question, f.severity) == ("sound", "caution")]

    (focal,) = (p.value for p in document.parameters if p.name == "eye_f")
    assert "images-contradict" not in off(4.9e-3 * focal)
    assert "images-contradict" in off(5.1e-3 * focal)


@pytest.mark.parametrize("seed", range(4))
def test_poses_of_the_right_moment_have_no_delay(seed: int) -> None:
    assert find_shifts(calibrated(0, seed)).delay is None


def test_along_a_path_a_delay_is_not_told_from_an_error_of_the_machine() -> None:
    assert find_shifts(calibrated(1, ordered=True)).delay is None


def test_a_robot_that_states_poses_of_its_flange_is_sent_to_images_and_not_to_plan() -> None:
    document, undetermined = calibrated(0).document, (Undetermined({"eye_f": 1.0}, "eye_f"),)
    weak = replace(document.identifiability, not_identifiable=undetermined)
    made = findings_of(replace(document, identifiability=weak), files=FILES)
    steps = [one.next for one in made if one.next]
    assert any("random order, with the hand turned" in step.words for step in steps)
    assert not any((step.command or "").startswith("loopcal plan") for step in steps)


@pytest.mark.parametrize("exact", [False, True])
def test_a_robot_whose_poses_err_alike_is_asked_for_its_joints(exact: bool) -> None:
    """As by least squares, which takes the poses as exact and has no noise of them."""
    document = replace(calibrated(0).document, dependence=depends(1.0, 1e-9))
    document = replace(document, noise=()) if exact else document
    (one,) = (f for f in findings_of(document, files=FILES) if f.code == "model-incomplete")
    assert one.next is not None
    assert one.next.words.startswith("State the joints in place of the poses")
    assert one.next.command is None


@pytest.mark.parametrize("step", [1, -1])
def test_a_delay_of_another_day_is_named_and_nothing_else(step: int) -> None:
    found = lc.verify(calibrated(0), read(step, 2))
    assert found.changes is not None
    (one,) = found.changes.found
    assert one.kind == "delay"
    assert -one.value == pytest.approx(SHARE, abs=max(3.0 * one.sd, 1e-3))
    answer = found.verdict["consistent"]
    assert "poses-delayed" in answer.codes
    assert f"% of the way {'to the next' if step > 0 else 'from the last'} one" in answer.words


def test_joints_of_another_day_that_were_read_late_are_named() -> None:
    arm, noise = planar_arm(40), lc.Noise(sds_of(planar_arm(40)))
    first = lc.calibrate(arm.truth, arm.read(sds_of(arm), 1), noise=noise, method="implicit-loop")
    q = {name: arm.read(sds_of(arm), 2)[name] for name in ("phi2", "phi3")}
    data = lc.simulate(arm.truth, q, noise=noise, seed=2).dataset
    late = {n: data[n] + SHARE * (np.roll(data[n], -1) - data[n]) for n in q}
    found = lc.verify(first, data.with_readings(late))
    assert found.changes is not None
    (one,) = found.changes.found
    assert one.kind == "delay"
    assert -one.value == pytest.approx(SHARE, abs=0.1 * SHARE)


@pytest.mark.parametrize("seed", range(2, 6))
def test_another_day_of_the_right_moment_has_no_delay(seed: int) -> None:
    found = lc.verify(calibrated(0), read(0, seed))
    assert found.changes is not None
    assert not found.changes.found


@pytest.mark.parametrize("play", [2e-4, 4e-4])
def test_play_of_the_joints_is_no_delay_of_another_day(play: float) -> None:
    """Beside a zero that moved, 36 of 40 such days were "not of one moment"."""

    def day(poses: int, seed: int, zero: float = 0.0) -> lc.Dataset:
        data = read_by_tracker(joints(poses, seed), seed)
        moved = {f"theta_{i}": data[f"theta_{i}"] for i in range(1, 7)}
        moved = {q: x + 0.5 * play * np.sign(np.diff(x, prepend=-9.0)) for q, x in moved.items()}
        return data.with_readings({**moved, "theta_3": moved["theta_3"] - zero})

    first = lc.calibrate(ARM, day(80, 1), noise=NOISE, method="auto")
    for seed in range(40, 45):
        found = lc.verify(first, day(30, seed, 1e-3))
        assert found.changes is not None
        assert [change.kind for change in found.changes.found] == ["zero"]
