"""The machines of `analyses.lives` are what their files say, and its rates count as stated."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import loopcal as lc
from analyses.gauntlet_truth import Arm, drawn
from analyses.lives import absurd, alarmed, named, table, wrong
from analyses.lives_days import CLEAN, KINDS, Planted, afterwards, kinds, made
from analyses.lives_parallel import (
    DELTA,
    DELTA_BOX,
    PALLETISER,
    PALLETISER_BOX,
    RotaryDelta,
    rezeroed,
)
from analyses.lives_truth import DEGREE, FLEET, Machine, away, machine, write_readings

RNG = np.random.default_rng(0)


def as_drawn(number: int) -> Machine:
    """A machine without any error, measured without noise."""
    user = machine(number)
    return replace(user, arm=user.drawing, tracker=0.0, encoder=0.0)


@pytest.mark.parametrize("number", [0, 2, 3, 20])
def test_a_drawing_is_the_machine_of_its_file(number: int, tmp_path: Path) -> None:
    user = as_drawn(number)
    conditions = user.conditions(40)
    q, p = user.measured(user.posed(40, RNG), conditions, RNG)
    write_readings(tmp_path / "day.csv", user.joints, q, p, user.columns(conditions))
    option, file = user.description(tmp_path)
    of = {key: tmp_path / file if option == f"--{key}" else None for key in ("dh", "urdf")}
    project = lc.init(tmp_path / "day.csv", dh=of["dh"], urdf=of["urdf"])
    assert project.rms < 0.01  # [mm]: the joints are rounded to a millionth of a degree


def test_a_delta_goes_where_its_arms_put_it() -> None:
    P = drawn(DELTA_BOX, 50, RNG)
    np.testing.assert_allclose(DELTA.flange(DELTA.angles(P))[1], P, atol=1e-12)


def test_bars_of_equal_length_keep_the_gripper_level() -> None:
    R, _ = PALLETISER.flange(drawn(PALLETISER_BOX, 50, RNG))
    np.testing.assert_allclose(R[:, 2, 2], -1.0, atol=1e-12)


@pytest.mark.parametrize("number", [1, 16, 20, 25])
def test_each_day_differs_from_a_clean_one(number: int) -> None:
    user = machine(number)
    clean, _ = made(user, 1, CLEAN)
    for name, kind in KINDS.items():
        if name == CLEAN or not kind.happens(user):
            continue
        day, planted = made(user, 1, name)
        assert planted.kind == name
        same = np.array_equal(day.points, clean.points) and np.array_equal(day.joints, clean.joints)
        assert not same


def test_a_zero_that_moved_stays_for_further_poses_and_a_drift_does_not() -> None:
    user = machine(0)
    q = user.posed(50, RNG)
    true = user.points(q, user.conditions(50))

    def off(kind: str) -> float:
        return float(away(user.points(q, afterwards(made(user, 1, kind)[0], 50)), true).max())

    assert off("zero") > 1e-4
    assert off("warming") == pytest.approx(0.0, abs=1e-9)
    assert off("one pose off") == pytest.approx(0.0, abs=1e-9)


def test_half_of_all_days_are_clean_and_every_kind_comes() -> None:
    days = [kind for number in range(FLEET) for kind in kinds(machine(number), 10)]
    assert days.count(CLEAN) == len(days) // 2
    assert {*days} == {*KINDS}


def test_zeros_move_where_the_motor_is() -> None:
    for one in (PALLETISER, DELTA):
        moved = rezeroed(one, 2, 1e-3)
        assert isinstance(moved, Arm | RotaryDelta)
        q = PALLETISER_BOX.mean(axis=1)[None] if one is PALLETISER else np.full((1, 3), 0.5)
        there = q + np.eye(q.shape[1])[1] * 1e-3
        np.testing.assert_allclose(moved.flange(q)[1], one.flange(there)[1], atol=1e-12)


def answer(kind: str, planted: Planted, **rest: Any) -> dict[str, Any]:
    accuracy = {"expected": 1e-4}
    base = {"kind": kind, "draw": 1, "planted": planted.document(), "exit": 0, "error": ""}
    return base | {"passed": True, "words": "", "accuracy": accuracy, "true": 1e-4} | rest


ZERO = Planted("zero", 0.05 * DEGREE, "rad", ("J3", "theta_3", "offset_3"))
SLIP = Planted("slip", 1e-3, "m", ("tool",), pose=12)


def change(name: str, value: float, unit: str, *alike: str) -> dict[str, Any]:
    return {"name": name, "kind": "", "value": value, "unit": unit, "alike": alike}


def test_a_zero_is_named_by_its_joint_and_size() -> None:
    right = [change("theta_3", 0.9e-3, "rad")]
    assert named(answer("zero", ZERO, passed=False, changes=right))
    assert not named(answer("zero", ZERO, passed=True, changes=right))
    other = [change("a_3", 1e-3, "m")]
    assert not named(answer("zero", ZERO, passed=False, changes=other))
    alike = [change("a_3", 1e-3, "m", "offset_3")]
    assert named(answer("zero", ZERO, passed=False, changes=alike))
    tenfold = [change("theta_3", 9e-3, "rad")]
    assert not named(answer("zero", ZERO, passed=False, changes=tenfold))
    assert absurd(answer("zero", ZERO, passed=False, changes=tenfold))


def test_a_slip_is_named_with_its_pose_and_no_other_cause() -> None:
    words = "the reflector slipped by 1.0 mm from pose 13 on"
    assert named(answer("slip", SLIP, passed=False, words=words))
    assert not named(answer("slip", SLIP, passed=False, words=words.replace("13", "20")))
    also = [change("theta_6", 1e-3, "rad")]
    assert not named(answer("slip", SLIP, passed=False, words=words, changes=also))


def test_called_as_calibrated_is_wrong_where_the_truth_is_far_beyond() -> None:
    clean = Planted(CLEAN)
    assert not alarmed(answer(CLEAN, clean))
    assert alarmed(answer(CLEAN, clean, passed=None))
    assert not wrong(answer(CLEAN, clean, true=1.4e-4))
    assert wrong(answer(CLEAN, clean, true=1.6e-4))
    assert not wrong(answer(CLEAN, clean, true=1.6e-4, passed=False))


def test_the_table_has_a_row_for_each_kind() -> None:
    answers = [
        answer(CLEAN, Planted(CLEAN)),
        answer(CLEAN, Planted(CLEAN), passed=None),
        answer("slip", SLIP, passed=False, words="slipped from pose 12"),
    ]
    lines = table([{"draw": 0, "sound": True}], answers).splitlines()
    assert lines[1].split()[:3] == ["clean", "2", "50.0"]
    assert lines[2].split()[:3] == ["slip", "1", "100.0"]
    assert "calibrations: 1, sound 1, failed 0" in lines
