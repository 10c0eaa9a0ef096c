"""The gauntlet's machines are what their files say, its draws come from the command, and it counts
as it states: the whole of it is `python -m analyses.gauntlet`.
"""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import loopcal as lc
from analyses import gauntlet_days as days
from analyses import rates
from analyses.gauntlet_asked import answered, asked
from analyses.gauntlet_days import Planted, afterwards, made
from analyses.gauntlet_kinds import CLEAN, FIRST, IMAGES, KINDS, LATER
from analyses.gauntlet_rivals import rival
from analyses.gauntlet_truth import Arm, drawn
from analyses.kept import kept
from analyses.lives_parallel import (
    DELTA,
    DELTA_BOX,
    PALLETISER,
    PALLETISER_BOX,
    RotaryDelta,
    rezeroed,
)
from analyses.lives_truth import DEGREE, Machine, away, machine, off, roles, write_readings

RNG = np.random.default_rng(0)
NOISE = 1e-5
ANOTHER, FIRST_DAY, ZERO_DAY = "another day", "six axes, random order", "day 2: zero"


def as_drawn(user: Machine) -> Machine:
    """A machine without any error; the noise shows that its points were measured."""
    return replace(user, arm=user.drawing, tracker=NOISE, encoder=0.0)


@pytest.mark.parametrize("kind", ["the fleet", "palletiser", "three reflectors"])
def test_a_drawing_is_the_machine_of_its_file(kind: str, tmp_path: Path) -> None:
    user = as_drawn(KINDS[kind].machine(3))
    day, _ = made(user, 30, np.random.default_rng(1))
    write_readings(tmp_path / "day.csv", user, day.joints, day.points, day.columns)
    option, file = user.description(tmp_path)
    of = {key: tmp_path / file if option == f"--{key}" else None for key in ("dh", "urdf")}
    project = lc.init(tmp_path / "day.csv", dh=of["dh"], urdf=of["urdf"])
    # three coordinates, less what placing takes up; the worst tenth of the poses does not count
    assert 0.5 * NOISE < project.rms < 3.0**0.5 * NOISE


def test_the_command_runs_here_as_in_a_process_of_its_own(tmp_path: Path) -> None:
    (tmp_path / "day.csv").write_text("pose,J1 [deg],x [mm]\n1,nonsense,2\n", "utf-8")
    arguments = ("init", "day.csv", "--out", "calibration")
    begin = [sys.executable, "-m", "loopcal"]
    there = subprocess.run([*begin, *arguments], cwd=tmp_path, capture_output=True, text=True)
    here = asked(tmp_path, *arguments)
    assert there.returncode != 0
    assert (here.returncode, here.stdout, here.stderr) == (
        there.returncode,
        there.stdout,
        there.stderr,
    )


def test_a_file_in_inches_is_refused_by_name(tmp_path: Path) -> None:
    draw = answered("points in inches", 0, tmp_path)
    assert "failed" not in draw
    assert rates.alarmed(draw)
    assert rates.named(draw)


def test_a_delta_goes_where_its_arms_put_it() -> None:
    P = drawn(DELTA_BOX, 50, RNG)
    np.testing.assert_allclose(DELTA.flange(DELTA.angles(P))[1], P, atol=1e-12)


def test_bars_of_equal_length_keep_the_gripper_level() -> None:
    R, _ = PALLETISER.flange(drawn(PALLETISER_BOX, 50, RNG))
    np.testing.assert_allclose(R[:, 2, 2], -1.0, atol=1e-12)


def test_zeros_move_where_the_motor_is() -> None:
    for one in (PALLETISER, DELTA):
        moved = rezeroed(one, 2, 1e-3)
        assert isinstance(moved, Arm | RotaryDelta)
        q = PALLETISER_BOX.mean(axis=1)[None] if one is PALLETISER else np.full((1, 3), 0.5)
        there = q + np.eye(q.shape[1])[1] * 1e-3
        np.testing.assert_allclose(moved.flange(q)[1], one.flange(there)[1], atol=1e-12)


@pytest.mark.parametrize("number", [2, 25])
def test_least_squares_estimates_the_machine_and_nominal_does_not(number: int) -> None:
    user = machine(number)
    by = 1e-4 * RNG.standard_normal(len(roles(user.drawing)))
    user = replace(user, tracker=0.0, encoder=0.0, arm=off(user.drawing, by), order="random")
    day, _ = made(user, 60, RNG)
    errors = {}
    for fitted in (True, False):
        one = rival(user, day.joints, day.points, np.zeros(60, dtype=np.intp), fitted=fitted)
        errors[fitted] = float(away(one.points(day.joints), day.points).max())
    assert errors[True] < 1e-6
    assert errors[False] > 1e-4


@pytest.mark.parametrize("kind", [kind for kind in (*FIRST, *LATER) if not kind.clean])
def test_each_fault_changes_the_file_or_the_user(kind: Any) -> None:
    user = next(user for user in map(kind.machine, range(1, 9)) if kind.happens(user))
    if not kind.event and not kind.tamper:
        assert kind.fixed
        return
    clean, _ = made(user, 40, np.random.default_rng(5), stations=user.stations)
    day, _ = made(
        user, 40, np.random.default_rng(5), kind.event, kind.tamper, stations=user.stations
    )
    same = np.array_equal(day.points, clean.points) and np.array_equal(day.joints, clean.joints)
    assert not same


def test_a_zero_that_moved_stays_for_further_poses_and_a_drift_does_not() -> None:
    user = machine(0)
    q = user.posed(50, RNG)
    true = user.points(q, user.conditions(50))

    def off_by(event: days.Event | None, tamper: days.Event | None = None) -> float:
        day, _ = made(user, 30, RNG, event, tamper)
        return float(away(user.points(q, afterwards(day, 50)), true).max())

    assert off_by(days.moved_zero) > 1e-4
    assert off_by(days.within_the_run(days.moved_zero)) > 1e-4
    assert off_by(days.drifting(1e-4, 2e-4)) == pytest.approx(0.0, abs=1e-9)
    assert off_by(None, days.poses_off(0.0, 0.02)) == pytest.approx(0.0, abs=1e-9)


def later(kind: str, planted: Planted, **rest: Any) -> dict[str, Any]:
    accuracy = {"expected": 1e-4}
    base = {"kind": kind, "draw": 1, "planted": planted.document(), "told": ""}
    base |= {"nominal inside": 1e-3, "least squares inside": 2e-4}
    return base | {"passed": True, "words": "", "accuracy": accuracy, "true": 1e-4} | rest


ZERO = Planted("zero", 0.05 * DEGREE, "rad", ("J3", "theta_3", "offset_3"))
SLIP = Planted("slip", 1e-3, "m", ("tool",), pose=12)


def change(name: str, value: float, unit: str, *alike: str) -> dict[str, Any]:
    return {"name": name, "kind": "", "value": value, "unit": unit, "alike": alike}


def test_a_zero_is_named_by_its_joint_and_size() -> None:
    right = [change("theta_3", 0.9e-3, "rad")]
    assert rates.named(later(ZERO_DAY, ZERO, passed=False, changes=right))
    assert not rates.named(later(ZERO_DAY, ZERO, passed=True, changes=right))
    other = [change("a_3", 1e-3, "m")]
    assert not rates.named(later(ZERO_DAY, ZERO, passed=False, changes=other))
    alike = [change("a_3", 1e-3, "m", "offset_3")]
    assert rates.named(later(ZERO_DAY, ZERO, passed=False, changes=alike))
    tenfold = [change("theta_3", 9e-3, "rad")]
    assert not rates.named(later(ZERO_DAY, ZERO, passed=False, changes=tenfold))
    assert rates.absurd(later(ZERO_DAY, ZERO, passed=False, changes=tenfold))


def test_a_slip_is_named_with_its_pose_and_no_other_cause() -> None:
    words = "the reflector slipped by 1.0 mm from pose 13 on"
    kind = "day 2: slip"
    assert rates.named(later(kind, SLIP, passed=False, words=words))
    assert not rates.named(later(kind, SLIP, passed=False, words=words.replace("13", "20")))
    also = [change("theta_6", 1e-3, "rad")]
    assert not rates.named(later(kind, SLIP, passed=False, words=words, changes=also))


def test_called_as_calibrated_is_wrong_where_the_truth_is_far_beyond() -> None:
    clean = Planted("")
    assert not rates.alarmed(later(ANOTHER, clean))
    assert rates.alarmed(later(ANOTHER, clean, passed=None))
    assert not rates.wrong(later(ANOTHER, clean, true=1.4e-4))
    assert rates.wrong(later(ANOTHER, clean, true=1.6e-4))
    assert not rates.wrong(later(ANOTHER, clean, true=1.6e-4, passed=False))


def first(kind: str, ratio: float, **rest: Any) -> dict[str, Any]:
    inside = {"error": ratio * 1e-4, "sd": 1e-4, "held": 0.95}
    base = {"kind": kind, "draw": 0, "planted": Planted("").document(), "told": "", "sound": True}
    return base | {"inside": inside, "nominal inside": 1e-3, "least squares inside": 1e-4} | rest


def test_a_region_that_is_not_called_valid_cannot_be_wrong() -> None:
    far = {"error": 3e-4, "sd": 1e-4, "held": 0.5}
    outside = {"outside": far, "nominal outside": 1e-3}
    assert rates.wrong(first(FIRST_DAY, 0.9, valid=True, **outside))
    assert not rates.wrong(first(FIRST_DAY, 0.9, valid=False, **outside))
    assert rates.wrong(first(FIRST_DAY, 1.6, valid=False))
    assert not rates.wrong(first(FIRST_DAY, 1.6, sound=None))
    assert rates.wrong(first(FIRST_DAY, 1.6, sound=None, better=True))


def test_called_better_and_worse_than_nominal_counts() -> None:
    assert rates.worse(first(FIRST_DAY, 11.0, better=True))
    assert not rates.worse(first(FIRST_DAY, 11.0, better=False))


def test_draws_of_other_code_and_broken_lines_do_not_count(tmp_path: Path) -> None:
    path = tmp_path / "kept.jsonl"
    draws = [first(FIRST_DAY, 1.0, stamp="new"), first(FIRST_DAY, 2.0, stamp="new")]
    lines = [json.dumps(d) for d in (*draws, first(FIRST_DAY, 1.0, stamp="older") | {"draw": 1})]
    path.write_text("\n".join([*lines, '{"kind": "pla']), "utf-8")
    assert [d["inside"]["error"] for d in kept(path, "new")] == [2e-4]
    assert kept(tmp_path / "absent.jsonl", "new") == []


def test_the_tables_count_alarms_names_and_confident_errors() -> None:
    draws = [
        first(FIRST_DAY, 1.0, better=True),
        first(FIRST_DAY, 1.0, sound=None) | {"draw": 1},
        first("points in inches", 2.0, told="x in inches"),
        first("points in inches", 2.0, sound=False) | {"draw": 1},
        later(ANOTHER, Planted("")),
        later(ZERO_DAY, ZERO, passed=False)
        | {"updated": {"true": 5e-5, "sd": 3e-5, "sound": True}},
    ]
    text = rates.tables(draws)
    assert "first day: false alarms on clean kinds        50.0 % of    2" in text
    assert "first day: causes named                       50.0 % of    2" in text
    assert "first day: confident and wrong                25.0 % of    4" in text
    assert "later day: false alarms on clean kinds         0.0 % of    1" in text
    assert "better in 1 of 1, sound in 1, of them wrong 1; true over stated 1.67" in text
    assert "(95 % interval 1.3 to 98.7 %)" in text


def test_a_rate_has_the_interval_of_its_number_of_draws() -> None:
    assert rates.interval(0, 60) == pytest.approx((0.0, 1.0 - 0.025 ** (1 / 60)))
    assert rates.interval(10, 10) == pytest.approx((0.025**0.1, 1.0))


def test_there_are_kinds_enough() -> None:
    assert len(CLEAN) >= 20
    assert len(KINDS) == len(CLEAN) + len(FIRST) + len(LATER) + len(IMAGES) >= 70


@pytest.mark.parametrize(
    ("kind", "draw", "code"),
    [
        ("three reflectors", 72010, "sound"),
        ("three reflectors", 72006, "sound"),
        ("zero moves", 72010, "changes-modelled"),
    ],
)
def test_play_and_gears_are_no_change(tmp_path: Path, kind: str, draw: int, code: str) -> None:
    """At every turn of a raster play looks like a step of a joint's zero; 0.05 deg is one. What
    joints err by is in all reflectors of a pose at once, and counted three times."""
    answer = answered(kind, draw, tmp_path)
    assert answer["wear"] == "sagging with " + ("backlash" if draw == 72010 else "gears")
    assert answer["codes"][0] == code
