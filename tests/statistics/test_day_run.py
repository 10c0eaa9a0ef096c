"""What `verify` says of a run of another day: slips, drifts, outliers, copies, files at fault."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

import loopcal as lc
from analyses.gauntlet_worlds import Run, World, bending
from loopcal.statistics.another_day import Day
from loopcal.statistics.calibrated import Calibrated
from loopcal.statistics.day_run import _system
from loopcal.statistics.possible_changes import ALONG_A_DAY, possible
from loopcal.statistics.verification import _repeated

Rng = np.random.Generator
WORLD = World("six", poses=100)
SAGGING = World("ur", poses=120, worn=bending)


@cache
def calibrated(world: World) -> lc.Result:
    trial = world.made(np.random.default_rng(0), np.random.default_rng(1))
    method = {} if world is SAGGING else {"method": "implicit-loop"}
    return lc.calibrate(trial.mechanism, trial.readings, noise=trial.noise, **method)


def later(
    world: World,
    seed: int = 5,
    tamper: Callable[..., Any] | None = None,
    poses: int = 30,
    **happened: Any,
) -> lc.Verification:
    """The same machine on another day, on which something happened; tamper: to the file."""
    made = replace(world, poses=poses, **happened).made(
        np.random.default_rng(0), np.random.default_rng(seed)
    )
    readings = made.readings
    if tamper is not None:
        readings = tamper(readings, np.random.default_rng(seed))
    return lc.verify(calibrated(world), readings)


def slipped(run: Run, rng: Rng) -> None:
    run.target[20:] += np.array([0.6e-3, -0.4e-3, 0.5e-3])


def slipped_early(run: Run, rng: Rng) -> None:
    run.target[5:] += np.array([0.6e-3, -0.4e-3, 0.5e-3])


def drifting(run: Run, rng: Rng) -> None:
    run.drift += np.linspace(0.0, 0.3e-3, len(run.drift))[:, None] * np.array([0.6, -0.5, 0.6])


def drifting_a_little(run: Run, rng: Rng) -> None:
    run.drift += np.linspace(0.0, 0.12e-3, len(run.drift))[:, None] * np.array([0.6, -0.5, 0.6])


def one_off(run: Run, rng: Rng) -> None:
    run.drift[5] += 12e-3


def loose(run: Run, rng: Rng) -> None:
    run.target += 3e-4 * rng.standard_normal(run.target.shape)


def exchanged(run: Run, rng: Rng) -> None:
    run.target += np.array([4e-3, -6e-3, 3e-3])


def late(readings: dict[str, np.ndarray], rng: Rng) -> dict[str, np.ndarray]:
    return readings | {q: np.roll(readings[q], 1) for q in "xyz"}


def reversed_joint(readings: dict[str, np.ndarray], rng: Rng) -> dict[str, np.ndarray]:
    return readings | {"q5": -readings["q5"]}


def doubled(readings: dict[str, np.ndarray], rng: Rng) -> dict[str, np.ndarray]:
    return {q: np.concatenate([v, v[:10]]) for q, v in readings.items()}


def sorted_by_a_joint(by: float) -> Callable[..., dict[str, np.ndarray]]:
    """The rows in the order of the first joint, the tracker drifting by so much meanwhile [m]."""

    def tampered(readings: dict[str, np.ndarray], rng: Rng) -> dict[str, np.ndarray]:
        order = np.argsort(readings["q1"])
        run = {q: values[order] for q, values in readings.items()}
        share = np.linspace(-0.5, 0.5, len(order))
        ways = {"x": 0.8, "y": -0.4, "z": 0.6}
        return run | {q: run[q] + by * way * share for q, way in ways.items()}

    return tampered


def test_a_drift_in_an_order_that_the_joints_tell_is_not_called_a_change() -> None:
    """Without the drift's own say, alpha_3 and a_1 had changed."""
    for seed, by in ((5, 1e-4), (7, 2e-4)):
        answer = later(WORLD, seed, sorted_by_a_joint(by)).verdict["consistent"]
        assert (answer.passed, answer.code) == (None, "drift-or-model")
        assert "drifted" in answer.words


def test_a_change_that_is_no_drift_is_named_in_any_order() -> None:
    found = later(WORLD, 5, sorted_by_a_joint(0.0), event=exchanged)
    assert found.verdict["consistent"].passed is False
    assert found.changes is not None
    assert [change.name for change in found.changes.found] == ["tool"]


@pytest.mark.parametrize("world", [WORLD, SAGGING], ids=["rigid", "sagging"])
class TestEach:
    def test_a_clean_day_is_as_calibrated(self, world: World) -> None:
        assert later(world).verdict["consistent"].codes == ("unchanged",)

    def test_a_target_that_slips_is_named_with_its_pose_and_size(self, world: World) -> None:
        found = later(world, event=slipped)
        answer = found.verdict["consistent"]
        assert (answer.passed, answer.code) == (False, "change-points")
        (point,) = found.shifts.told_apart
        assert point.pose == "21"
        assert {n: c.size for n, c in point.changes.items()} == pytest.approx(
            {"tool_x": 0.6e-3, "tool_y": -0.4e-3, "tool_z": 0.5e-3}, abs=0.1e-3
        )
        assert found.changes is not None
        assert found.changes.found == ()  # nothing had changed before the run

    @pytest.mark.parametrize("poses", [9, 12, 16])
    def test_so_is_one_that_slips_in_a_short_run(self, world: World, poses: int) -> None:
        """It was "an error that no change explains", or another machine of the type."""
        found = later(world, poses=poses, event=slipped_early)
        answer = found.verdict["consistent"]
        assert (answer.passed, answer.code) == (False, "change-points")
        (point,) = found.shifts.told_apart
        assert (point.pose, point.moved) == ("6", "target")
        assert {n: c.size for n, c in point.changes.items()} == pytest.approx(
            {"tool_x": 0.6e-3, "tool_y": -0.4e-3, "tool_z": 0.5e-3}, abs=0.15e-3
        )
        assert found.changes is not None
        assert found.changes.found == ()

    def test_what_moves_in_clean_short_runs_is_seldom_named(self, world: World) -> None:
        """At 1 % two or more of 24 are rarer than 1 in 40."""
        moved = [
            later(world, seed, poses=poses).shifts.found
            for poses in (8, 10, 14)
            for seed in range(200, 208)
        ]
        assert sum(bool(found) for found in moved) < 2

    def test_a_drift_of_the_instrument_is_named(self, world: World) -> None:
        found = later(world, event=drifting)
        assert found.verdict["consistent"].passed is not True
        assert any(point.shape == "ramp" for point in found.shifts.found)

    def test_a_drift_as_large_as_the_smallest_visible_one_is_named(self, world: World) -> None:
        """Beside smooth functions of the joints, learnt from 30 poses, it was not seen."""
        found = later(world, event=drifting_a_little)
        assert found.verdict["consistent"].passed is not True
        assert [point.shape for point in found.shifts.found] == ["ramp"]
        assert found.changes is not None
        (drift,) = [one for one in found.changes.candidates if one.kind == "drift"]
        assert 0.05e-3 < (drift.smallest or 0.0) < 0.2e-3

    def test_one_pose_far_off_is_named_and_not_the_machine(self, world: World) -> None:
        found, clean = later(world, event=one_off), later(world)
        assert found.outliers == ("6",)
        answer = found.verdict["consistent"]
        assert (answer.passed, answer.codes) == (None, ("outliers", "unchanged"))
        assert found.calibrated is not None
        assert clean.calibrated is not None
        assert found.calibrated.rms < 1.1 * clean.calibrated.rms
        assert found.worst[0].pose == "6"

    def test_a_pose_far_off_hides_no_zero_that_moved(self, world: World) -> None:
        def both(run: Run, rng: Rng) -> None:
            run.encoders[:, 4] += np.deg2rad(0.05)
            one_off(run, rng)

        found = later(world, event=both)
        assert found.outliers == ("6",)
        assert found.changes is not None
        (change,) = found.changes.found
        assert change.zeros == ("q5",)
        assert not found.shifts.found

    def test_an_error_that_nothing_explains_is_not_as_calibrated(self, world: World) -> None:
        found = later(world, event=loose)
        assert found.verdict["consistent"].passed is False
        assert "errors-larger" in found.verdict["consistent"].codes
        assert found.changes is not None
        assert found.changes.found == ()

    def test_a_tool_that_was_exchanged_is_named_as_the_tool(self, world: World) -> None:
        found = later(world, event=exchanged)
        assert found.changes is not None
        (change,) = found.changes.found
        assert (change.name, change.kind) == ("tool", "mounting")
        assert change.parts == pytest.approx(
            {"tool_x": 4e-3, "tool_y": -6e-3, "tool_z": 3e-3}, abs=0.15e-3
        )

    @pytest.mark.parametrize(
        ("tamper", "words"),
        [(late, "1 row too late"), (reversed_joint, "q5 counts the other way round")],
    )
    def test_a_file_at_fault_is_named(
        self, world: World, tamper: Callable[..., object], words: str
    ) -> None:
        found = later(world, tamper=tamper)
        answer = found.verdict["consistent"]
        assert (answer.passed, answer.code) == (False, "column-fault")
        assert words in answer.words
        assert found.verdict["better"].code == "unknown-accuracy"
        assert found.changes is None


def test_rows_that_copy_others_count_once() -> None:
    found = later(WORLD, tamper=doubled)
    assert found.copied == 10
    assert len(found.poses) == 30
    assert found.verdict["consistent"].code == "rows-copied"


def read_on_the_way(readings: Any, rng: Rng) -> Any:
    """Joints from before each pose is reached, by a hundredth of the way from the last one."""
    return {
        q: v - 0.01 * np.diff(v, prepend=v[0]) if q.startswith("q") else v
        for q, v in readings.items()
    }


def test_poses_that_are_read_on_the_way_are_named_with_their_share() -> None:
    """They were "706 times as much as the calibration states", to be calibrated anew."""
    found = later(WORLD, tamper=read_on_the_way)
    answer = found.verdict["consistent"]
    assert (answer.passed, answer.code) == (False, "poses-delayed")
    assert "the machine's readings are from before each pose is reached" in answer.words
    assert found.changes is not None
    (change,) = found.changes.found
    assert -change.value == pytest.approx(0.01, rel=0.1)


def test_a_drift_has_the_sign_of_the_readings() -> None:
    (point,) = later(WORLD, event=drifting).shifts.told_apart
    assert point.names == ("x", "y", "z")
    assert [np.sign(point.changes[q].size) for q in "xyz"] == [1.0, -1.0, 1.0]


def re_zeroed(readings: Any, rng: Rng) -> Any:
    step = np.where(np.arange(len(readings["q3"])) < 18, 0.0, 1e-3)
    return readings | {"q3": readings["q3"] - step}


def test_a_zero_that_steps_along_a_day_has_the_sign_it_has_between_days() -> None:
    """What the true angle exceeds the reading by, as `find_shifts` has it too."""
    (point,) = later(WORLD, tamper=re_zeroed).shifts.found
    assert (point.moved, point.names) == ("joint", ("q3",))
    assert point.changes["q3"].size == pytest.approx(1e-3, rel=0.1)


def hung_anew(run: Run, rng: Rng) -> None:
    run.zero += 6e-3


def test_a_wire_whose_zero_changed_is_named() -> None:
    """It was "an error that no change explains", to be calibrated anew."""
    found = later(World("six", "wire", poses=150), event=hung_anew)
    assert found.changes is not None
    (change,) = found.changes.found
    assert change.name == "wire_offset"
    assert abs(change.value) == pytest.approx(6e-3, rel=0.2)


def test_what_slides_read_grows_with_the_machine_along_a_run() -> None:
    """A gantry that warmed up was named as a drift of the instrument along its long axis."""
    first = Calibrated.of(calibrated(World("scara", poses=100)), "first")
    assert first.poses is not None
    day = Day.of(first, first.poses, None, False)
    (growth,) = (one for one in possible(day.problem, ALONG_A_DAY) if one.kind == "expansion")
    assert "q3 in proportion" in growth.names
    linear = day.linearised()
    system = _system(linear, np.zeros((len(linear.e), 0)))
    of_rows = growth.columns(linear.placement.columns) / np.sqrt(linear.factor)
    assert growth.columns(system.columns).reshape(of_rows.shape) == pytest.approx(of_rows)


def test_the_poses_of_the_calibration_prove_nothing() -> None:
    result = calibrated(WORLD)
    found = lc.verify(result, result.dataset)
    assert found.repeated == 100
    assert found.verdict["consistent"].passed is None
    assert "own-poses" in found.verdict["consistent"].codes


def test_poses_of_the_calibration_are_recognised_however_they_were_rounded() -> None:
    """Degrees with five decimals and millimetres with three; other poses are not taken for them."""
    result = calibrated(WORLD)
    readings = result.dataset.readings
    rounded = {
        q: np.round(v * 1e3, 3) / 1e3 if q in "xyz" else np.radians(np.round(np.degrees(v), 5))
        for q, v in readings.items()
    }
    assert lc.verify(result, {q: v[:30] for q, v in rounded.items()}).repeated == 30
    noisy = {q: v + 2e-5 * (q in "xyz") for q, v in readings.items()}
    assert lc.verify(result, noisy).repeated == 0


def test_so_are_those_of_a_joint_that_hardly_moved() -> None:
    """It is rounded like the others, by more than its span shows."""
    first = Calibrated.of(calibrated(WORLD), "first")
    assert first.poses is not None
    (joint, *_), span = first.mechanism.joints, np.linspace(0.0, 1e-6, 100)
    poses = first.poses.with_readings({joint: span})
    read = {
        q: np.round(v, 6) if q in first.mechanism.joints else v for q, v in poses.readings.items()
    }
    assert _repeated(replace(first, poses=poses), poses.with_readings(read)) == 100


def test_machines_as_calibrated_are_seldom_called_otherwise() -> None:
    """Twelve clean days of each machine: at 5 % three or more alarms of 24 are rarer than 1 in 8,
    five or more rarer than 1 in 100."""
    answers = [
        later(world, seed).verdict["consistent"].passed
        for world in (WORLD, SAGGING)
        for seed in range(100, 112)
    ]
    assert sum(answer is not True for answer in answers) < 5


def test_a_machine_that_has_warmed_up_is_named_by_its_scale() -> None:
    """All lengths of the machine grow by 400 ppm, as aluminium does over 17 K."""
    result = calibrated(WORLD)
    made = replace(WORLD, poses=40).made(np.random.default_rng(0), np.random.default_rng(8))
    machine = result.machine
    lengths = {p.name: p.nominal for p in machine.parameters if p.dimension == "length"}
    grown = machine.with_nominal({name: 1.0004 * value for name, value in lengths.items()})
    joints = {q: v for q, v in made.readings.items() if q.startswith("q")}
    sds = {"q*": 3e-5, **dict.fromkeys("xyz", 1.5e-5)}
    day = lc.simulate(grown, joints, noise=lc.Noise(sds), seed=3).dataset
    found = lc.verify(result, day)
    assert found.changes is not None
    (change,) = found.changes.found
    assert change.kind == "expansion"
    assert change.value == pytest.approx(4e-4, abs=4.0 * change.sd)
    assert "ppm" in change.words
