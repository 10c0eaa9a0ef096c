"""Poses of robots whose limbs touch each other, and what each of them is for."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import loopcal as lc
from loopcal.companions.planning.candidates import drawn, stated_candidates, too_few
from loopcal.companions.planning.occasions import occasions
from loopcal.companions.planning.plan import plan
from loopcal.measurements.plan_settings import Box, PlanSettings
from loopcal.mechanisms.bodies import Hanging, tree_machine
from loopcal.mechanisms.instruments.contact import contact
from loopcal.mechanisms.instruments.point import point
from loopcal.mechanisms.machine import assemble
from loopcal.mechanisms.origins import LinkJoint

BETWEEN = 0.1
"""Metres between the centres of two balls that touch."""


def limb(name: str, y: float) -> list[Hanging]:
    """Three links of 0.3 m, turned about z, y and x."""
    axes = ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0))
    starts = ((0.0, y, 0.0), (0.3, 0.0, 0.0), (0.2, 0.0, 0.2))
    made, parent = [], "base"
    for i, (axis, at) in enumerate(zip(axes, starts, strict=True)):
        joint = LinkJoint(f"{name}q{i}", "revolute", at, (0.0, 0.0, 0.0), axis)
        made.append(Hanging(f"{name}{i}", parent, joint))
        parent = f"{name}{i}"
    return made


def arms() -> lc.Mechanism:
    """Two arms whose hands touch; a tracker sees the left one."""
    machine = tree_machine([*limb("l", 0.25), *limb("r", -0.25)], root="base")
    looking = [
        contact("touch", between=("l2", "r2"), radius=(BETWEEN / 2, BETWEEN / 2)),
        point("seen", on="l2", readings=["x", "y", "z"], target="at", station="tracker"),
    ]
    made = assemble(machine, looking)
    nominal = {"touch_1_y": 0.2, "touch_2_y": 0.2, "at_y": 0.2, "tracker_x": 2.0}
    sds = {p.name: 2e-3 for p in made.parameters if p.unit in ("m", "rad")}
    return made.with_nominal(nominal).with_parameters(
        made.with_nominal(nominal).parameters.with_prior(sds)
    )


RANGES = {f"{side}q{i}": (-1.0, 1.2) for side in "lr" for i in range(3)}
SETTINGS = PlanSettings(RANGES, number=200, model_error="none")


def test_joints_are_moved_within_their_limits_until_balls_touch() -> None:
    pool = drawn(arms(), RANGES, SETTINGS)
    touches = np.isfinite(pool.closed["touch_gap"])
    assert 50 < touches.sum() < 150
    np.testing.assert_allclose(pool.closed["touch_gap"][touches], 0.0, atol=1e-9)
    for joint, (low, high) in RANGES.items():
        assert low <= pool.driven[joint].min() < pool.driven[joint].max() <= high
    # the driven readings say which poses touch, and joints that need not were drawn
    np.testing.assert_array_equal(np.isfinite(pool.driven["touch_gap"]), touches)
    apart = arms().loop_values({**pool.closed.readings, "touch_gap": 0.0 * touches})
    assert np.abs(apart["touch_gap"][~touches]).min() > 1e-4


def test_poses_that_cannot_touch_within_the_limits_are_left_out() -> None:
    narrow = {**RANGES, "lq0": (0.6, 1.2), "rq0": (-1.2, -0.6)}
    pool = drawn(arms(), narrow, SETTINGS)
    assert pool.refused["does not touch within the limits"] > 0
    assert not np.isfinite(pool.closed["touch_gap"]).any()


def test_each_pose_is_for_what_was_measured_together() -> None:
    machine = arms()
    blank = np.array([np.nan, np.nan, 0.0, np.nan])
    seen = np.array([1.0, 1.0, np.nan, np.nan])
    data = lc.Dataset.from_arrays({"touch_gap": blank, "x": seen, "y": seen, "z": seen})
    assert occasions(machine, data) == (("touch",), ("seen",))
    assert occasions(machine, None) == (("seen",), ("touch", "seen"))
    # without a column of gaps all poses touch
    both = lc.Dataset.from_arrays(dict.fromkeys("xyz", seen))
    assert occasions(machine, both) == (("touch", "seen"),)


def test_poses_of_ones_choice_touch_only_where_joints_nearly_make_them() -> None:
    pool = drawn(arms(), RANGES, SETTINGS)
    touching = pool.driven.take(np.flatnonzero(np.isfinite(pool.driven["touch_gap"]))[:4])
    joints = {q: touching[q] for q in RANGES}
    near = {**joints, "lq1": joints["lq1"] + math.radians(0.3) * np.array([1.0, -1.0, 0.0, 0.0])}
    far = {**joints, "lq1": joints["lq1"] + math.radians(60.0) * np.array([1.0, -1.0, 0.0, 0.0])}
    assert len(stated_candidates(arms(), lc.Dataset.from_arrays(near), SETTINGS).driven) == 4
    left = stated_candidates(arms(), lc.Dataset.from_arrays(far), SETTINGS)
    assert left.driven.poses == ("3", "4")
    blank = {**near, "rq0": np.array([np.nan, 0.0, 0.0, 0.0]) + near["rq0"]}
    whole = stated_candidates(arms(), lc.Dataset.from_arrays(blank), SETTINGS)
    assert whole.driven.poses == ("2", "3", "4")
    kept = stated_candidates(arms(), lc.Dataset.from_arrays(near), SETTINGS).driven
    np.testing.assert_array_equal(kept["lq1"], near["lq1"])


def test_no_link_of_either_arm_enters_a_box() -> None:
    """The box stands where the forearm of the right arm goes at the end of a joint."""
    box = Box((-1.0, -1.0, -1.0), (1.0, -0.3, 1.0))
    pool = drawn(arms(), RANGES, PlanSettings(RANGES, number=200, keep_out=(box,)))
    assert pool.refused["keep-out boxes"] > 0
    assert pool.driven["rq0"].min() > -math.asin(0.05 / 0.3)
    assert pool.driven["lq0"].min() < -0.5


def test_what_a_pose_serves_is_within_reach() -> None:
    reach = Box((-math.inf, -math.inf, 0.1), (math.inf, math.inf, math.inf))
    pool = drawn(arms(), RANGES, PlanSettings(RANGES, number=200, reach=reach))
    assert pool.refused["reach"] > 0
    at = pool.closed["z"]  # the tracker is upright, and in the plane of the base
    assert np.nanmin(at) >= 0.1


@pytest.fixture(scope="module")
def planned() -> lc.Plan:
    apart = replace(SETTINGS, occasions=(("touch",), ("seen",)))
    return plan(arms(), 12, noise={"*": 1e-4}, settings=apart, criterion="D")


def test_a_plan_says_which_instruments_each_pose_serves(planned: lc.Plan) -> None:
    assert len(planned.serves) == len(planned.use)
    assert {*planned.serves} == {("touch",), ("seen",)}
    document = planned.document()
    for pose, kind in zip(document["poses"], planned.serves, strict=True):
        assert pose["serves"] == list(kind)
        assert (pose["readings"]["touch_gap"] is None) == ("touch" not in kind)
    once = [kind for kind, use in zip(planned.serves, planned.use, strict=True) if use != "repeat"]
    count = once.count(("touch",))
    assert f"{count} for 'touch'" in "\n".join(planned.summary())


def test_poses_that_touch_make_the_other_arm_known(planned: lc.Plan) -> None:
    alone = replace(SETTINGS, occasions=(("seen",),))
    blind = plan(arms(), 12, noise={"*": 1e-4}, settings=alone, criterion="D")
    assert blind.idle == ("touch",)
    for name in ("rq1_x", "rq2_z"):
        known, unknown = (made.expected.parameters[name] for made in (planned, blind))
        assert known is not None
        assert unknown is not None
        assert known < 0.9 * unknown


def test_where_no_candidate_is_left_the_next_command_is_another_one() -> None:
    words = ["plan", "project.toml", "--poses", "8"]
    for left, command in (
        (0, "loopcal plan project.toml --poses 8 --candidates READINGS"),
        (3, "loopcal plan project.toml --poses 3"),
    ):
        error = too_few(left, 100, {"reach": 100 - left}, 8)
        error.next_command(words)
        assert (error.command, error.again) == (command, False)


def test_a_plan_promises_the_sds_that_a_calibration_of_its_poses_states() -> None:
    once = replace(SETTINGS, occasions=(("touch",), ("seen",)), repeats=False)
    made = plan(arms(), 12, noise={"*": 1e-4}, settings=once, criterion="D")
    data = lc.Dataset.from_arrays(dict(made.closed.readings))
    result = lc.calibrate(arms(), data, noise={"*": 1e-4}, method="implicit-loop")
    for name, promised in made.expected.parameters.items():
        assert promised == pytest.approx(result.sd[name], rel=1e-3), name
