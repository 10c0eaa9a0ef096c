"""What `verify` finds, `update` follows, whichever parameter the calibration held."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import loopcal as lc
from analyses.followed import ALLOWED, LATER, ZERO, Days, moved
from analyses.gauntlet_worlds import World
from analyses.instruments import setup
from analyses.planning import cases
from loopcal.companions.life.drift import Drifting
from loopcal.estimation.prediction import predict_outputs
from loopcal.mechanisms.instruments.point import point
from loopcal.mechanisms.machine import assemble
from loopcal.mechanisms.origins import LinkJoint, Mimic, joint_chain
from loopcal.mechanisms.redundancy import exchanged
from loopcal.statistics.calibrated import Calibrated
from tests.command_line import run_here as run
from tests.refusals import refused

CASES = [("ur urdf", "q3"), ("ur urdf", "q5"), ("ur", "q6"), ("six", "q5"), ("seven", "q4")]


@cache
def calibrated(arm: str, how: str = "stated") -> tuple[Days, lc.Result]:
    days = Days.of(arm, how, 0)
    return days, days.calibrated(how)


@pytest.mark.parametrize(("arm", "joint"), CASES)
def test_an_update_is_as_good_as_a_recalibration_with_the_zero_unknown(
    arm: str, joint: str
) -> None:
    days, first = calibrated(arm)
    errors = days.errors(first, joint)
    assert errors.said
    assert errors.none > 3.0 * errors.oracle
    assert errors.plain < ALLOWED * errors.oracle
    assert errors.drift < ALLOWED * errors.oracle


def test_an_update_by_joints_that_scatter_is_not_sound() -> None:
    """Its own verdict said sound, beside a warning and exit code 4."""
    days, first = calibrated("ur urdf")
    rng, day = np.random.default_rng(5), dict(days.later.readings)
    for name in (f"q{i}" for i in range(1, 7)):
        day[name] = day[name] + 1e-3 * rng.standard_normal(len(day[name]))
    verdict = lc.verify(first, day).verdict["consistent"]
    assert verdict.passed is False
    # so few poses do not show whether joints scatter or everything changed
    assert verdict.words.startswith("The machine is not as calibrated: chi-squared")
    updated = lc.Result.of(lc.update(first, day)).document
    assert updated.check is not None
    assert updated.check.words == verdict.words
    assert updated.verdict is not None
    assert updated.verdict.sound.passed is False
    assert "update-mixed" in updated.verdict.sound.codes


def test_with_a_learnt_model_error_too() -> None:
    days, first = calibrated("ur urdf", "auto")
    errors = days.errors(first, "q3")
    assert first.terms
    assert errors.said
    assert max(errors.plain, errors.drift) < ALLOWED * errors.oracle


@pytest.mark.parametrize("drift", [[], ["zero=0.05deg"], ["q3=0.05deg"], ["q3_rz=0.05deg"]])
def test_from_the_command_line(tmp_path: Path, drift: list[str]) -> None:
    """q3_rz is the parameter of that zero, and held: others make it superfluous."""
    days, first = calibrated("ur urdf")
    assert first.mechanism.parameters["q3_rz"].fixed
    first.save(tmp_path / "first")
    day, folder = moved(days.later.readings, "q3", ZERO), str(tmp_path / "first")
    file = str(tmp_path / "day.csv")
    np.savetxt(
        file, np.column_stack([*day.values()]), delimiter=",", header=",".join(day), comments=""
    )
    assert run("verify", folder, file).returncode == 4
    allowed = [text for one in drift for text in ("--drift", one)]
    done = run("update", folder, file, *allowed, "--no-report", "--out", str(tmp_path / "new"))
    assert done.returncode == 0, done.stderr
    assert "mixes" not in done.stdout
    stated = drift and "zero" not in drift[0]
    words = " ".join(done.stdout.split())
    assert bool(re.search("The update estimates the zero of q3 anew", words)) != bool(stated)
    new = lc.read_result(tmp_path / "new")
    oracle = days.recalibrated(first, lc.update(first, day), "q3", day)
    assert days.error(new, "q3", ZERO) < ALLOWED * days.error(oracle, "q3", ZERO)


@pytest.mark.parametrize(("times", "allowed"), [(10.0, ALLOWED), (20.0, 3.0)])
def test_a_zero_that_moved_far_is_followed_as_well(times: float, allowed: float) -> None:
    """No line from where the calibration was reaches it: the check is made where it moved."""
    days, first = calibrated("ur urdf")
    size = times * ZERO
    day = moved(days.later.readings, "q3", size)
    new = lc.update(first, day)
    assert not [words for words in new.warnings if "mixes" in words]
    assert [words for words in new.warnings if "The update estimates the zero of q3" in words]
    oracle = days.recalibrated(first, new, "q3", day)
    assert days.error(new, "q3", size) < allowed * days.error(oracle, "q3", size)


@pytest.mark.parametrize("how", ["structured", "none"])
def test_another_scale_of_a_slide_is_followed_whether_one_was_learnt(how: str) -> None:
    """It was followed by none, and the result was "J3_scale is 4.7 sds off"; where none was learnt,
    the update mixed two machines."""
    given, share = setup("origins, two prismatic, point"), 1e-3
    made = lc.simulate(given.truth, given.driven, noise=given.noise, seed=1)
    nominal = given.truth.with_parameters(given.truth.parameters.with_fixed(given.held))
    fit = lc.Fit(method="implicit-loop", model_error=how)
    first = lc.calibrate(nominal, made.dataset, noise=given.noise, fit=fit)
    slide = next(q for q in given.driven if given.truth.quantities[q] == "m")
    stretched = {**given.driven, slide: given.driven[slide] * (1.0 + share)}
    day = lc.simulate(given.truth, stretched, noise=given.noise, seed=2).dataset
    new = lc.update(first, day.with_readings({slide: day[slide] / (1.0 + share)}))
    assert any(f"The update estimates the scale of {slide} anew" in w for w in new.warnings)
    assert not [words for words in new.warnings if "mixes" in words]
    name = f"{slide}_scale"
    scale = new.value[name] - first.value.get(name, 0.0)
    assert scale == pytest.approx(
        share, abs=1e-4 if how == "structured" else 4.0 * (new.sd[name] or 0.0)
    )
    assert {*new.value} - {*first.value} <= {name}  # no load is estimated that did not change


@pytest.mark.parametrize(("arm", "how"), [("ur urdf", "stated"), ("six", "stated"), ("ur", "auto")])
def test_a_machine_that_is_warmer_is_followed_in_proportion(arm: str, how: str) -> None:
    """Held lengths too, by what does the same. Eight poses say the scale to 12 ppm, 0.01 mm of
    these arms, and less of whether the tool is as warm."""
    days, first = calibrated(arm, how)
    growth = 1.0 + 3e-4
    day = {q: growth * v if q in "xyz" else v for q, v in days.later.readings.items()}
    new = lc.update(first, day)
    assert not [words for words in new.warnings if "mixes" in words]
    said = "The update estimates the scale of the machine anew. It holds at the temperature of"
    assert [words for words in new.warnings if said in words]
    warm = replace(days, fresh=replace(days.fresh, true=growth * days.fresh.true))
    cold = days.error(first, "q1", 0.0)
    assert warm.error(first, "q1", 0.0) > 2.0 * cold
    assert warm.error(new, "q1", 0.0) < 2.0 * cold


@pytest.mark.parametrize("kept", ["tool_*", "offset_6"])
def test_it_does_not_matter_which_parameter_was_held(kept: str) -> None:
    """The last zero turns the tool: either is held, and the machines are the same."""
    days, first = calibrated("six")
    free = first.mechanism.parameters.with_fixed(["offset_6", "d_6", "a_6", "alpha_6"], fixed=False)
    bare = first.mechanism.with_parameters(free)
    assert {"offset_6", "tool_x"} <= {*free.free}
    mechanism = lc.fix_redundant(bare, keep=[kept])
    assert mechanism.parameters["offset_6"].fixed == (kept == "tool_*")
    one = days.first
    other = lc.calibrate(mechanism, one.readings, noise=one.noise, method="implicit-loop")
    day = moved(days.later.readings, "q6", ZERO)
    points = []
    for result in (first, other):
        for key in ("offset_6", "q6"):
            new = lc.update(result, day, drift={key: ZERO})
            predicted = lc.predict(new, days.fresh.readings)
            points.append(np.column_stack([predicted.outputs[q] for q in days.fresh.outputs]))
    # A hundredth of what the zero moves the tool by: updates settle to 0.02 sds.
    assert np.ptp(points, axis=0).max() < 1e-2 * ZERO * 0.06


def test_the_step_of_a_held_parameter_does_the_same_to_readings() -> None:
    mechanism, size = calibrated("ur urdf")[1].calibrated, 1e-5
    names, free = mechanism.parameters.names, mechanism.parameters.free
    steps = exchanged(mechanism, ["q3_rz", "q4"], free)
    read = np.zeros((9, 4))
    read[:6] = np.random.default_rng(0).uniform(-1.0, 1.0, (6, 4))
    start = np.array([p.nominal for p in mechanism.parameters])

    def reached(p: np.ndarray, x: np.ndarray) -> np.ndarray:
        return predict_outputs(mechanism, p, x, np.empty((0, 4)))

    for name, step in steps.items():
        p, followed, x = start.copy(), start.copy(), read.copy()
        followed[[names.index(n) for n in free]] += size * step
        if name in names:
            p[names.index(name)] += size
        else:
            x[mechanism.tape.quantities.index(name)] += size
        assert np.abs(reached(p, x) - reached(start, read)).max() > 1e-6
        assert reached(p, x) == pytest.approx(reached(followed, read), abs=1e-9)


def test_a_role_of_which_no_parameter_can_follow_is_refused() -> None:
    trial = World("planar").made(np.random.default_rng(0))
    held = trial.mechanism.with_parameters(trial.mechanism.parameters.with_fixed(["l2", "l3"]))
    first = lc.calibrate(held, trial.readings, noise=trial.noise, method="implicit-loop")
    with refused("no-free-parameter", "length"):
        lc.update(first, trial.readings, drift={"length": 1e-3})


def test_the_zero_of_every_joint_can_drift() -> None:
    days, first = calibrated("ur urdf")
    known = Calibrated.of(first, "").stationed
    drifting = Drifting(known, lc.Dataset.from_arrays(days.later.readings), None)
    stated = drifting.stated({"zero": ZERO})
    assert len([name for name in stated if name[:2] in days.joints]) >= len(days.joints)
    assert drifting.columns(stated).shape == (len(known.mechanism.parameters), len(stated))
    assert len(days.later.readings["q1"]) == LATER


def test_the_zero_of_a_joint_that_others_follow_is_followed_with_theirs() -> None:
    """A palletiser keeps its forearm level by a rod: its elbow turns back with the shoulder."""
    level = Mimic("q2", -1.0)
    joints = [
        LinkJoint("q1", "revolute", (0.0, 0.0, 0.8), axis=(0.0, 0.0, 1.0)),
        LinkJoint("q2", "revolute", (0.3, 0.0, 0.0), axis=(0.0, 1.0, 0.0)),
        LinkJoint("elbow", "revolute", (0.0, 0.0, 1.0), axis=(0.0, 1.0, 0.0), mimic=level),
        LinkJoint("q3", "revolute", (0.0, 0.0, 0.0), axis=(0.0, 1.0, 0.0)),
        LinkJoint("q4", "revolute", (1.1, 0.0, 0.0), axis=(1.0, 0.0, 0.0)),
        LinkJoint("flange", "fixed", (0.1, 0.0, 0.0)),
    ]
    made = assemble(joint_chain(joints), [point(readings=("x", "y", "z"))])
    arm = lc.fix_redundant(made.with_nominal({"tool_x": 0.1, "tool_z": 0.05, "tool_y": 0.05}))
    box = {"q1": (-2.0, 2.0), "q2": (-0.5, 0.8), "q3": (-0.4, 0.6), "q4": (-2.0, 2.0)}
    noise = lc.Noise({"q?": 2e-5, "x": 2e-5, "y": 2e-5, "z": 2e-5})
    days = [
        lc.simulate(arm, lc.random_poses(box, count, seed=count), noise=noise, seed=count).dataset
        for count in (60, 15)
    ]
    first = lc.calibrate(arm, days[0], noise=noise, method="implicit-loop")
    later = {q: days[1][q] for q in days[1].readings}
    updated = lc.update(first, moved(later, "q2", 1e-3))
    assert any("the zero of q2 anew" in words for words in updated.warnings)
    assert not any("mixes both machines" in words for words in updated.warnings)
    change = {n: updated.value[n] - first.value[n] for n in ("q2_ry", "elbow_ry")}
    assert change == pytest.approx({"q2_ry": 1e-3, "elbow_ry": -1e-3}, abs=2e-4)


def test_a_zero_that_the_poses_hardly_show_is_followed_with_those_that_explain_it() -> None:
    """The check asked for an update, which said "mixes both machines: calibrate anew"."""
    case = cases()["Stewart-Gough"]
    noise = lc.Noise({**case.noise, "x": 15e-6, "y": 15e-6, "z": 15e-6})
    rng, parameters = np.random.default_rng(3), case.mechanism.parameters
    truth = {n: parameters[n].nominal + rng.normal(0.0, 3e-4) for n in parameters.free}

    def day(seed: int, poses: int) -> lc.Dataset:
        where = lc.random_poses(case.ranges, poses, seed=seed)
        return lc.simulate(case.mechanism, where, noise=noise, seed=seed, truth=truth).dataset

    first = lc.calibrate(case.mechanism, day(1, 60), noise=noise, method="implicit-loop")
    later = day(3, 15)
    later = later.with_readings({"leg_3": later["leg_3"] - 1.2e-4})
    check = lc.verify(first, later)
    assert check.changes is not None
    (change,) = check.changes.found
    assert change.zeros[0] == "leg_3"
    assert len(change.zeros) > 1
    assert change.p_value > 1e-3
    words = " ".join(lc.update(first, later).warnings)
    assert "The update estimates the zero of leg_3 and " in words
    assert "mixes" not in words
