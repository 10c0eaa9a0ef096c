"""Pose performance: figures worked out by hand, invariances, and intervals that hold the truth."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from analyses.pose_performance import CASES, condition_coverage, coverage, distance_coverage
from loopcal.companions.performance.accuracy import Group, Means, fitted_base, frame_effect
from loopcal.companions.performance.instrument import Figures, MeasuringErrors, tracker_of
from loopcal.companions.performance.intervals import NormalScatter, length_interval, repeatability
from loopcal.companions.performance.performance import pose_performance
from loopcal.companions.performance.summary import overview
from loopcal.measurements.attained import AttainedPoses
from tests.refusals import refused

CROSS = 1e-3 * np.array([[0.13, 0, 0], [0.07, 0, 0], [0.1, 0.04, 0], [0.1, -0.04, 0]])
"""Mean 0.1 mm along x; distances from it 0.03, 0.03, 0.04 and 0.04 mm."""
PLACES = np.array([[0.0, 0.0, 0.0], [0.3, 0.0, 0.0], [0.0, 0.4, 0.0], [0.3, 0.4, 0.2]])


def attained(*clouds: np.ndarray, at: np.ndarray = PLACES, **more: object) -> AttainedPoses:
    """Offsets (n, 3) of the poses P1, P2, ..., cycle by cycle."""
    poses = tuple(f"P{i + 1}" for i, cloud in enumerate(clouds) for _ in cloud)
    cycles = tuple(str(k) for cloud in clouds for k in range(len(cloud)))
    asked = np.array([at[i] for i, cloud in enumerate(clouds) for _ in cloud])
    return AttainedPoses("poses", poses, cycles, asked, asked + np.vstack(clouds), **more)  # type: ignore[arg-type]


def test_accuracy_and_repeatability_by_hand() -> None:
    (pose,) = pose_performance(attained(CROSS)).conditions[0].poses
    assert pose.accuracy.value == pytest.approx(1e-4)
    sd = math.sqrt(4 * 0.005**2 / 3)
    assert pose.repeatability is not None
    assert pose.repeatability.value == pytest.approx(1e-3 * (0.035 + 3 * sd))
    assert pose.offset == pytest.approx((1e-4, 0.0, 0.0))


def test_distance_by_hand() -> None:
    """P2 moves along the line to P1 by 0.1, 0.2 and 0.3 mm: AD 0.2 mm, RD 3 * 0.1 mm."""
    moves = 1e-3 * np.array([[0.1, 0, 0], [0.2, 0, 0], [0.3, 0, 0]])
    (found,) = pose_performance(attained(np.zeros((3, 3)), moves)).conditions[0].distances
    assert found.commanded == pytest.approx(0.3)
    assert found.accuracy.value == pytest.approx(2e-4)
    assert found.repeatability.value == pytest.approx(3e-4)
    t = 4.302652729911275  # two degrees of freedom
    assert found.accuracy.high == pytest.approx(2e-4 + t * 1e-4 / math.sqrt(3), rel=1e-3)
    assert found.repeatability.low == pytest.approx(3e-4 * math.sqrt(2 / 7.377758908227871))


def test_variation_of_directions_by_hand() -> None:
    """Means 0.03 and 0.04 mm from the first along x and y: largest distance 0.05 mm."""
    step = 1e-3 * np.array([[0.0, 0, 0], [0.03, 0, 0], [0, 0.04, 0]])
    wobble = 1e-6 * np.array([[1.0, 0, 0], [-1.0, 0, 0]])
    cloud = np.vstack([s + wobble for s in step])
    table = replace(attained(cloud), direction=("a", "a", "b", "b", "c", "c"))
    (found,) = pose_performance(table).conditions[0].variations
    assert found.variation.value == pytest.approx(5e-5)
    assert found.directions == ("a", "b", "c")


def test_drift_by_hand() -> None:
    """The second ten cycles lie 0.3 mm farther along x, and scatter twice as much."""
    wobble = 1e-6 * np.tile([[1.0, 0, 0], [-1.0, 0, 0]], (5, 1))
    moved = 1e-4 * np.array([[1.0, 0.0, 0.0], [4.0, 0.0, 0.0]])
    cloud = np.vstack([moved[0] + wobble, moved[1] + 2 * wobble])
    table = replace(attained(cloud), time=60.0 * np.arange(20.0))
    (found,) = pose_performance(table).conditions[0].drifts
    assert [block.time for block in found.blocks] == [270.0, 870.0]
    assert found.shift.value == pytest.approx(3e-4)
    assert found.accuracy.value == pytest.approx(3e-4)
    assert found.repeatability.value == pytest.approx(1e-6)


def test_a_slow_drift_is_noticed_and_independent_cycles_are_not() -> None:
    """At a level of 1 %: at most 5 of 100 sets of independent cycles (0.05 % by chance)."""

    def noticed(seed: int, warming: float) -> bool:
        rng = np.random.default_rng(seed)
        slow = warming * np.linspace(0.0, 1.0, 10)[:, None] * [0.0, 0.0, 1.0]
        clouds = [rng.normal(0.0, 1e-5, (10, 3)) + slow for _ in range(3)]
        part = pose_performance(attained(*clouds)).conditions[0]
        return any("drifts" in note for note in part.notes)

    assert sum(noticed(seed, 0.0) for seed in range(100)) <= 5
    assert sum(noticed(seed, 6e-5) for seed in range(10)) >= 9


def test_orientation_by_hand() -> None:
    """Turns about the base's x of 10, 20 and 30 µrad, whatever orientation was commanded."""
    asked = np.repeat(Rotation.from_euler("ZYX", [0.3, 0.7, 2.0]).as_matrix()[None], 3, axis=0)
    turns = Rotation.from_rotvec([[1e-5, 0, 0], [2e-5, 0, 0], [3e-5, 0, 0]]).as_matrix()
    table = replace(attained(np.zeros((3, 3))), commanded_turns=asked, measured_turns=turns @ asked)
    x, y, _ = pose_performance(table).conditions[0].poses[0].orientation
    assert x.accuracy.value == pytest.approx(2e-5)
    assert x.repeatability.value == pytest.approx(3e-5)
    assert y.accuracy.value == pytest.approx(0.0, abs=1e-12)


def test_another_frame_changes_nothing_after_the_fit() -> None:
    rng = np.random.default_rng(1)
    table = attained(*(rng.normal(0, 1e-4, (4, 3)) + rng.normal(0, 3e-4, 3) for _ in range(4)))
    turn = Rotation.from_rotvec([0.4, -1.0, 2.0]).as_matrix()
    moved = replace(table, measured=table.measured @ turn.T + [5.0, 1.0, -2.0])
    here, there = (pose_performance(t).conditions[0] for t in (table, moved))
    for a, b in zip(here.poses, there.poses, strict=True):
        assert a.accuracy_fitted is not None
        assert b.accuracy_fitted is not None
        assert b.accuracy_fitted.value == pytest.approx(a.accuracy_fitted.value, rel=1e-6)
        assert b.accuracy_fitted.high == pytest.approx(a.accuracy_fitted.high, rel=1e-3)
        assert b.accuracy.value > 1.0
    assert any("another frame" in note for note in there.notes)


def test_in_a_plane_two_poses_fix_the_frame_and_z_counts_nowhere() -> None:
    flat = PLACES * [1.0, 1.0, 0.0]
    turn = Rotation.from_rotvec([0.0, 0.0, 2.5]).as_matrix()
    table = replace(attained(CROSS, CROSS, at=flat), planar=True)
    errors = MeasuringErrors(Figures.of("2 um"), tracker_of("10 um, 20 um"))
    here = pose_performance(table, errors).conditions[0]
    assert here.poses[0].accuracy.value == pytest.approx(1e-4)
    assert here.poses[0].instrument == pytest.approx(
        NormalScatter.of(4e-12 * np.eye(2)).repeatability
    )
    assert here.poses[0].accuracy_fitted is not None
    assert here.poses[0].accuracy_fitted.value == pytest.approx(0.0, abs=1e-12)
    moved = replace(table, measured=table.measured @ turn.T + [5.0, 1.0, 0.0])
    there = pose_performance(moved, errors).conditions[0]
    assert there.poses[1].accuracy_fitted is not None
    assert there.poses[1].accuracy_fitted.value == pytest.approx(0.0, abs=1e-12)
    mirrored = attained(*[np.zeros((2, 3))] * 3, at=flat)
    mirrored = replace(mirrored, planar=True, measured=mirrored.commanded * [1.0, -1.0, 0.0])
    for pose in pose_performance(mirrored).conditions[0].poses:
        assert pose.accuracy_fitted is not None
        assert pose.accuracy_fitted.value > 1e-2  # no turn in the plane mirrors


def test_the_fitted_base_is_no_worse() -> None:
    rng = np.random.default_rng(2)
    table = attained(*(rng.normal(0, 1e-5, (3, 3)) + rng.normal(0, 1e-3, 3) for _ in range(4)))
    poses = pose_performance(table).conditions[0].poses
    before = sum(p.accuracy.value**2 for p in poses)
    assert sum(p.accuracy_fitted.value**2 for p in poses if p.accuracy_fitted) < before


def test_covariances_after_the_fit_are_those_of_the_whole_matrix() -> None:
    """M C M^T with M = I - J (J^T W J)^-1 J^T W, all means at once."""
    rng = np.random.default_rng(3)
    table = attained(*(rng.normal(0, 1e-4, (n, 3)) for n in (3, 5, 4, 6)))
    table = replace(table, direction=tuple("ab"[i % 2] for i in range(len(table))))
    keys = dict.fromkeys(zip(table.pose, table.direction or (), strict=True))
    rows = [
        np.array([i for i in range(len(table)) if (table.pose[i], (table.direction or ())[i]) == k])
        for k in keys
    ]
    groups = [Group(*key, its) for key, its in zip(keys, rows, strict=True)]
    errors = MeasuringErrors(tracker=tracker_of("20 um, 40 um"), frame=Figures.of("1 mm, 1 mrad"))
    means = Means.of(groups, table.measured, table.commanded, errors)
    base = fitted_base(means)
    assert not isinstance(base, str)
    n = len(groups)
    C = np.zeros((n, 3, n, 3))
    for g in range(n):
        C[g, :, g] += means.scatter[g]
        for k in range(n):
            if groups[g].pose == groups[k].pose:
                C[g, :, k] += means.shared[g]
    turn = np.kron(np.eye(n), base.rotation)
    J = frame_effect(means.commanded).reshape(-1, 6)
    W = np.diag(np.repeat(means.cycles, 3))
    S = np.linalg.solve(J.T @ W @ J, J.T @ W)
    M = np.eye(3 * n) - J @ S
    inner = turn @ C.reshape(3 * n, 3 * n) @ turn.T
    whole = (M @ inner @ M.T).reshape(n, 3, n, 3)
    for g in range(n):
        np.testing.assert_allclose(base.covariance[g], whole[g, :, g], atol=1e-18)
    np.testing.assert_allclose(base.turn, (S @ inner @ S.T)[3:, 3:], rtol=1e-9)


def test_a_thousand_poses_are_no_trouble() -> None:
    """One cycle each, as of a calibration: AP before and after, and what is missing."""
    rng = np.random.default_rng(4)
    clouds = [rng.normal(0.0, 1e-4, (1, 3)) for _ in range(1000)]
    done = pose_performance(attained(*clouds, at=rng.uniform(-1.0, 1.0, (1000, 3))))
    assert len(done.conditions[0].poses) == 1000
    assert "more: --json has all" in str(done)


def test_the_instruments_share_of_repeatability() -> None:
    """Isotropic scatter of sd s has RP = (2 sqrt(2/pi) + 3 sqrt(3 - 8/pi)) s = 3.6161 s."""
    errors = MeasuringErrors(Figures.of("5 um"))
    (pose,) = pose_performance(attained(CROSS), errors).conditions[0].poses
    assert pose.instrument == pytest.approx(5e-6 * 3.61608805)
    assert pose.repeatability is not None
    assert pose.instrument_share == pytest.approx(
        (5e-6 * 3.61608805 / pose.repeatability.value) ** 2
    )


def test_scatter_on_a_line_is_half_normal() -> None:
    found = NormalScatter.of(np.diag([4.0, 0.0, 0.0]))
    assert found.mean == pytest.approx(2 * math.sqrt(2 / math.pi), rel=1e-9)
    assert found.sd == pytest.approx(2 * math.sqrt(1 - 2 / math.pi), rel=1e-9)


def test_common_errors_make_accuracy_uncertain_and_do_not_average_out() -> None:
    cloud = np.tile(CROSS, (25, 1))
    errors = MeasuringErrors(tracker=tracker_of("20 um, 20 um"), frame=Figures.of("10 um"))
    alone, common = (
        pose_performance(attained(cloud), e).conditions[0].poses[0].accuracy
        for e in (MeasuringErrors(), errors)
    )
    assert alone.high is not None
    assert alone.low is not None
    assert common.high is not None
    assert common.low is not None
    sd = math.sqrt(10e-6**2 + 10e-6**2)  # data sheet's MPE is two sds
    assert common.high - common.low == pytest.approx(2 * 1.96 * sd, rel=0.05)
    assert alone.high - alone.low < sd


def test_far_from_zero_the_interval_is_students() -> None:
    C = np.diag([4e-12, 1e-12, 1e-12])
    found = length_interval(np.array([1e-3, 0.0, 0.0]), C, C, 9.0)
    assert found.high is not None
    assert found.high - found.value == pytest.approx(2.262157 * 2e-6, rel=1e-5)


def test_what_cannot_be_computed_is_said_and_the_rest_is_given() -> None:
    part = pose_performance(attained(CROSS[:1])).conditions[0]
    assert part.poses[0].accuracy.value > 0.0
    assert part.poses[0].accuracy.low is None
    assert part.poses[0].repeatability is None
    words = " ".join(part.missing)
    for missing in ("AP after fitting", "RP and intervals", "vAP", "AD and RD", "Drift"):
        assert missing in words


def test_conditions_are_kept_apart() -> None:
    table = replace(attained(CROSS, CROSS), conditions={"payload": ("5",) * 4 + ("10",) * 4})
    found = pose_performance(table).conditions
    assert [part.name for part in found] == ["payload = 5", "payload = 10"]
    assert [pose.pose for part in found for pose in part.poses] == ["P1", "P2"]


def test_figures_of_each_payload_and_speed_by_hand() -> None:
    """Four conditions: offsets k times those of the cross, so AP and RP are k times its own."""
    sizes = {("5", "50"): 1.0, ("5", "100"): 2.0, ("10", "50"): 3.0, ("10", "100"): 4.0}
    table = attained(*(k * CROSS for k in sizes.values()))
    pose = ("P1",) * 16
    asked = np.zeros((16, 3))
    keys = [key for key in sizes for _ in CROSS]
    conditions = {"payload [kg]": tuple(k for k, _ in keys), "speed [%]": tuple(k for _, k in keys)}
    moved = replace(table, pose=pose, commanded=asked, measured=table.measured - table.commanded)
    done = pose_performance(replace(moved, conditions=conditions))
    rp = 1e-3 * (0.035 + 3 * math.sqrt(4 * 0.005**2 / 3))
    for part, ((payload, speed), k) in zip(done.conditions, sizes.items(), strict=True):
        assert part.condition == {"payload [kg]": payload, "speed [%]": speed}
        ap, _, repeated = part.largest.figures
        assert ap is not None
        assert repeated is not None
        assert (ap.value, repeated.value) == pytest.approx((k * 1e-4, k * rp))
    head, *rows = overview(done.conditions)
    assert head[:3] == ("payload [kg]", "speed [%]", "poses")
    assert [row[:2] for row in rows] == list(sizes)
    assert overview(done.conditions[:1]) == []
    assert "largest AP [mm]" in str(done)


def test_a_wrong_unit_is_refused() -> None:
    table = attained(CROSS, CROSS, CROSS)
    with refused("implausible-unit", "1000 times"):
        pose_performance(replace(table, measured=1e3 * table.measured))


def test_an_unknown_pose_is_refused() -> None:
    with refused("unknown-name", "P9"):
        pose_performance(attained(CROSS, CROSS), distances=[("P1", "P9")])
    with refused("invalid-value", "P1", "itself"):
        pose_performance(attained(CROSS, CROSS), distances=[("P1", "P1")])


def test_exact_readings_have_exact_figures() -> None:
    found = repeatability(np.zeros((5, 3)))
    assert (found.value, found.low, found.high) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("name", ["usual", "in a plane", "scatter along a line", "drift"])
def test_intervals_hold_the_truth(name: str) -> None:
    """`python -m analyses.pose_performance` has more cases and draws."""
    found = coverage(CASES[name], 6)
    assert min(found.values()) > 0.88


def test_intervals_hold_the_truth_at_each_payload_and_speed() -> None:
    assert min(condition_coverage(4).values()) > 0.88


def test_intervals_of_distances_hold_the_truth() -> None:
    found = distance_coverage(10, 150, common=True)
    assert min(found.values()) > 0.95 - 3 * math.sqrt(0.05 * 0.95 / 150)
