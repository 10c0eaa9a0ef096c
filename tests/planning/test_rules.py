"""Which candidates may be measured."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import loopcal as lc
from loopcal.companions.planning.candidates import drawn, ranges_of, stated_candidates
from loopcal.files.machines.mechanism_file import mechanism_from_data
from loopcal.measurements.plan_settings import Box, PlanSettings, Sight
from tests.refusals import refused

INF = math.inf


def arm() -> lc.Mechanism:
    """Two links in space, the reflector 0.1 m beyond the second, seen by a tracker 3 m away."""
    joints = [lc.Joint("q1", "dh"), lc.Joint("q2", "dh")]
    nominal = {"a_1": 0.5, "alpha_1": math.pi / 2, "a_2": 0.4, "tool_x": 0.1, "base_x": 3.0}
    return lc.serial_arm(joints, nominal)


def posed(*degrees: tuple[float, float]) -> lc.Dataset:
    rows = np.radians(np.array(degrees, dtype=float)).T
    return lc.Dataset.from_arrays({"q1": rows[0], "q2": rows[1]})


def left(settings: PlanSettings, *degrees: tuple[float, float]) -> list[str]:
    return list(stated_candidates(arm(), posed(*degrees), settings).driven.poses)


def test_a_segment_crosses_a_box_where_any_of_its_points_lies_inside() -> None:
    rng = np.random.default_rng(1)
    box = Box((-0.3, -0.2, -0.4), (0.2, 0.5, 0.3))
    a, b = rng.uniform(-1.0, 1.0, (2, 3, 400))
    share = np.linspace(0.0, 1.0, 2001)
    inside = np.array(
        [box.holds(a[:, [i]] + (b - a)[:, [i]] * share).any() for i in range(a.shape[1])]
    )
    np.testing.assert_array_equal(box.crossed(a, b), inside)


def test_a_segment_along_a_face_is_told_from_one_beside_it() -> None:
    box = Box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
    a = np.array([[-1.0, -1.0], [0.5, 1.5], [0.5, 0.5]])
    b = np.array([[2.0, 2.0], [0.5, 1.5], [0.5, 0.5]])
    assert box.crossed(a, b).tolist() == [True, False]


def test_the_end_point_stays_within_reach_in_the_frame_of_the_base() -> None:
    """The tracker sees the base 3 m away: boxes do not care."""
    reach = PlanSettings(reach=Box((-INF, -INF, 0.2), (INF, INF, INF)))
    assert left(reach, (0, 0), (0, 60), (0, -60), (90, 60)) == ["2", "4"]


def test_links_may_not_touch_a_box_that_the_end_point_passes_by() -> None:
    """The first link lies along x from the base to 0.5 m; the end point is above it."""
    post = PlanSettings(keep_out=(Box((0.2, -0.1, -0.1), (0.3, 0.1, 0.1)),))
    assert left(post, (0, 90), (90, 90), (-90, 90)) == ["2", "3"]


def test_a_box_between_tracker_and_reflector_blocks_the_sight() -> None:
    """The tracker stands at x = -3 m in the base's frame; the wall at -1 m ends at 0.2 m height."""
    wall = Box((-1.1, -INF, -INF), (-1.0, INF, 0.2))
    assert left(PlanSettings(keep_out=(wall,)), (0, 0), (0, 90)) == ["1", "2"]
    both = PlanSettings(keep_out=(wall,), sight=Sight())
    assert left(both, (0, 0), (0, 90)) == ["2"]


def test_the_reflector_must_look_at_the_instrument() -> None:
    """It looks back along the last link (-x of the body), the tracker stands at x = -3 m."""
    sight = Sight(normal=(-1.0, 0.0, 0.0), within=math.radians(30.0))
    seen = left(PlanSettings(sight=sight), (0, 0), (0, 25), (0, 45), (180, 0), (0, 180))
    assert seen == ["1", "2"]


def test_no_pose_is_near_a_forbidden_row() -> None:
    rows = posed((10.0, 20.0))
    settings = PlanSettings(forbidden=rows)
    assert left(settings, (10.5, 19.5), (12.0, 20.0), (10.0, 22.0)) == ["2", "3"]


def test_what_each_rule_takes_is_counted_and_more_are_drawn() -> None:
    machine = arm()
    settings = PlanSettings(
        {"q1": (-3.0, 3.0), "q2": (-1.5, 1.5)},
        reach=Box((0.0, -INF, -INF), (INF, INF, INF)),
        number=200,
    )
    found = drawn(machine, ranges_of(machine, settings.ranges, None), settings)
    assert len(found.driven) == 200
    assert found.considered > 200
    kept = found.considered - found.refused["reach"]
    assert kept >= 200


def test_loops_that_cannot_close_are_counted() -> None:
    machine = lc.Mechanism.from_function(
        lambda x, p: [x.a**2 + x.b**2 - p.r**2],
        {"a": "m", "b": "m"},
        {"r": (1.0, "m")},
        outputs=("b",),
    )
    machine = replace(machine, home={"b": 0.5})
    found = stated_candidates(
        machine, lc.Dataset.from_arrays({"a": [0.2, 1.5, -0.7]}), PlanSettings()
    )
    assert list(found.driven.poses) == ["1", "3"]
    assert found.refused == {"loops do not close": 1}


def test_ranges_that_nothing_states_are_asked_for() -> None:
    with refused("missing-key", "q1"):
        ranges_of(arm(), {}, None)


def test_cameras_without_a_robot_are_not_planned() -> None:
    eye: dict[str, object] = {
        "type": "camera",
        "name": "eye",
        "board": "o",
        "on": "base",
        "lens": "brown5",
    }
    eye |= {"points": {"1": [0, 0, 0], "2": [1, 0, 0], "3": [0, 1, 0], "4": [1, 1, 0]}}
    alone = mechanism_from_data({"type": "free-body", "read": False, "instrument": [eye]}, "x.toml")
    with refused("undetermined-quantities", "no robot moves camera or board"):
        lc.plan(alone, 5, noise={"*": 1e-4})
    flange = mechanism_from_data({"type": "free-body", "instrument": [eye]}, "x.toml")
    ranges = dict.fromkeys(("x", "y", "z", "qw", "qx", "qy", "qz"), (-1.0, 1.0))
    with refused("undetermined-quantities", "poses of its flange and no joints"):
        ranges_of(flange, ranges, None)


def test_rules_need_a_point() -> None:
    machine = lc.Mechanism.from_function(
        lambda x, p: x.a * p.k - x.b, {"a": "m", "b": "m"}, {"k": (1.0, "1")}, outputs=("b",)
    )
    with refused("unsupported"):
        stated_candidates(
            machine, lc.Dataset.from_arrays({"a": [0.1]}), PlanSettings(sight=Sight())
        )


def test_settings_are_checked() -> None:
    with refused("invalid-value"):
        PlanSettings(number=0)
    with refused("unknown-name"):
        PlanSettings(model_error="some")


@pytest.mark.parametrize("degrees", [0.0, 37.0])
def test_where_the_station_stands_changes_no_box(degrees: float) -> None:
    machine = arm().with_nominal({"base_rz": math.radians(degrees), "base_y": 0.7})
    reach = PlanSettings(reach=Box((0.6, -INF, -INF), (INF, INF, INF)))
    found = stated_candidates(machine, posed((0, 0), (90, 0), (20, 10)), reach)
    assert list(found.driven.poses) == ["1", "3"]
