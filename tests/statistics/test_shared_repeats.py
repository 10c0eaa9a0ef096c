"""Repeats of a pose that share its error count as one reading; others count each."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

import loopcal as lc
from loopcal.statistics.another_day import day_problem
from loopcal.statistics.calibrated import Calibrated
from loopcal.statistics.folds import may_repeat
from loopcal.statistics.predictive import held_problem
from loopcal.statistics.shared_repeats import averaged
from loopcal.statistics.validation import Validation
from tests.reference.simulated import arm_at, planar_arm

JOINTS, POINT = 1e-3, 1e-4
"""Sds of the joints [rad] and of what the instrument reads [m]."""
POSES, TIMES = 14, 3


SDS = {"xP": POINT, "yP": POINT, "phi2": JOINTS, "phi3": JOINTS}
ARM = planar_arm(POSES)
NOISE = lc.Noise({"phi?": JOINTS, "?P": POINT}, estimate={"phi?": "group", "?P": "group"})


def repeats(seed: int, *, shared: bool) -> lc.Dataset:
    """Every pose read three times in a row; shared: by the same error of its joints."""
    rng = np.random.default_rng(seed)
    read = np.repeat(np.array([ARM.exact["phi2"], ARM.exact["phi3"]]), TIMES, axis=1)
    errors = rng.normal(0.0, JOINTS, (2, POSES if shared else POSES * TIMES))
    there = read + np.repeat(errors, TIMES if shared else 1, axis=1)
    points = arm_at(ARM.truth, there).read({"xP": POINT, "yP": POINT}, seed=seed)
    joints = dict(zip(("phi2", "phi3"), read, strict=True))
    return points.with_readings(joints)


def square(result: lc.Result) -> float:
    """The squared error of the machine over its stated covariance, for each parameter."""
    names = [n for n in result.estimated if n in ARM.values]
    at = [result.estimated.index(n) for n in names]
    error = np.array([result.value[n] - ARM.values[n] for n in names])
    covariance = np.asarray(result.learnt_covariance.matrix)[np.ix_(at, at)]
    return float(error @ np.linalg.solve(covariance, error)) / len(names)


def test_repeats_that_share_an_error_count_as_one_reading() -> None:
    squares = []
    for seed in range(10):
        result = lc.calibrate(ARM.truth, repeats(seed, shared=True), noise=NOISE, method="auto")
        assert len(result.unjudged.data.averaged) == POSES * (TIMES - 1)
        assert len(result.poses) == POSES
        squares.append(square(result))
    # 4.3 where each repeat counts for itself; the mean of ten has an sd of about 0.2
    assert np.mean(squares) < 1.6
    warned = [w for w in result.unjudged.data.warnings() if "repeat an earlier pose" in w]
    assert len(warned) == 1


@pytest.mark.parametrize("method", ["implicit-loop", "least-squares"])
def test_a_stated_method_says_that_repeats_share_an_error(method: str) -> None:
    """It counts each row; in none of ten honest sets, in all ten with shared errors."""
    found = {False: 0, True: 0}
    for shared in found:
        for seed in range(10):
            data = repeats(seed, shared=shared)
            result = lc.calibrate(ARM.truth, data, noise=NOISE, method=method)
            codes = {one.code for one in result.document.findings}
            found[shared] += "repeats-share-error" in codes
            assert len(result.poses) == POSES * TIMES
    assert found == {False: 0, True: 10}


def between_poses(seed: int, times: int) -> lc.Dataset:
    """Single poses, and the first of them read again so many times in between, by one error."""
    rows = 3 * np.arange(POSES)
    order = [*rows[:1], *np.ravel([[row, 0] for row in rows[1 : times + 1]]), *rows[times + 1 :]]
    data = repeats(seed, shared=True).take(np.array(order))
    noise = np.random.default_rng(seed + 1000).normal(0.0, POINT, (2, len(data)))
    again = np.array([i for i, row in enumerate(order) if row == 0])
    read = {q: np.array(data[q]) for q in ("xP", "yP")}
    for q, drawn in zip(read, noise, strict=True):
        read[q][again] += drawn[again]
    return data.with_readings(read)


def test_many_repeats_of_one_pose_in_between_count_as_one_reading() -> None:
    squares = []
    for seed in range(6):
        data = between_poses(seed, 12)
        result = lc.calibrate(ARM.truth, data, noise=NOISE, method="auto")
        squares.append(square(result))
        assert len(result.unjudged.data.averaged) == 12
    assert np.mean(squares) < 2.0


def test_few_repeats_in_between_show_a_drift_and_stay() -> None:
    result = lc.calibrate(ARM.truth, between_poses(1, 2), noise=NOISE, method="auto")
    assert not result.unjudged.data.averaged


def test_repeats_that_err_for_themselves_count_each() -> None:
    squares = []
    for seed in range(6):
        result = lc.calibrate(ARM.truth, repeats(seed, shared=False), noise=NOISE, method="auto")
        assert not result.unjudged.data.averaged
        squares.append(square(result))
    assert 0.3 < np.mean(squares) < 2.0


@pytest.mark.parametrize(
    ("rows", "repeated"),
    [
        (range(300), False),
        ([*range(299), 298], True),  # one row repeats the one before it
        ([*range(220), *range(80)], True),  # a quarter of the rows is there again, apart
        ([*range(297), 0, 1, 2], False),  # few rows are
        ([0], False),
    ],
)
def test_few_looks_tell_whether_poses_repeat(rows: Sequence[int], repeated: bool) -> None:
    joints = np.random.default_rng(1).uniform(-2.0, 2.0, (4, 300))
    units = dict.fromkeys("abcd", "rad")
    arm = lc.Mechanism.from_function(
        lambda x, p: [p.l * x.a + x.b + x.c + x.d - x.out],
        parameters={"l": (1.0, "m")},
        quantities=units | {"out": "m"},
        outputs=["out"],
    )
    data = lc.Dataset.from_arrays(dict(zip("abcd", joints, strict=True)) | {"out": joints[0]})
    assert may_repeat(arm, data.take(np.array(rows, dtype=np.intp)), {}) == repeated


@pytest.mark.parametrize("apart", [False, True])
def test_a_day_of_repeats_is_judged_as_one_reading_of_each_pose(apart: bool) -> None:
    first = lc.simulate(
        ARM.truth,
        lc.random_poses({"phi2": (-3.0, 3.0), "phi3": (-3.0, 3.0)}, 60, seed=5),
        noise=lc.Noise({"phi?": JOINTS, "?P": POINT}),
        seed=6,
    ).dataset
    calibrated = lc.calibrate(ARM.truth, first, noise=NOISE, method="auto")
    order = np.arange(POSES * TIMES)
    if apart:  # all poses, then all again
        order = order.reshape(POSES, TIMES).T.ravel()
    as_means, consistent = 0, 0
    for seed in range(10, 18):
        check = lc.verify(calibrated, repeats(seed, shared=True).take(order))
        as_means += len(check.poses) == POSES
        consistent += check.changes is None or check.changes.verdict == "unchanged"
    assert as_means >= 6
    assert consistent >= 7


def test_means_keep_what_repeats_share_and_count_what_they_do_not() -> None:
    data = lc.Dataset.from_arrays(
        {"q": [0.1, 0.1, 0.1, 0.2], "x": [1.0, 2.0, np.nan, 5.0]}, sds={"x": [1.0, 1.0, 1.0, 2.0]}
    )
    means = averaged(data, np.array([0, 0, 0, 1]), {"x", "y of an instrument that was not used"})
    assert means.poses == ("1", "4")
    assert means["q"].tolist() == [0.1, 0.2]
    assert means["x"].tolist() == [1.5, 5.0]
    assert means.counts["x"].tolist() == [2.0, 1.0]
    assert means.sds["x"].tolist() == [1.0, 2.0]
    again = averaged(means, np.array([0, 0]), {"x"})
    assert again["x"].tolist() == [pytest.approx(8.0 / 3.0)]
    assert again.take([0]).counts["x"].tolist() == [3.0]


@pytest.mark.parametrize("joint", ["phi2", "phi3"])
def test_a_joint_at_rest_in_predicted_poses_keeps_its_noise(joint: str) -> None:
    result = lc.calibrate(ARM.truth, ARM.read(SDS, seed=2), noise=NOISE, method="implicit-loop")
    poses = lc.random_poses({"phi2": (-1.0, 1.0), "phi3": (-1.0, 1.0)}, 5, seed=3)
    day = lc.simulate(ARM.truth, {**poses, joint: np.full(5, 0.3)}, noise=NOISE, seed=4).dataset
    day = day.with_readings({joint: np.full(5, 0.3)})
    row = list(result.mechanism.tape.quantities).index(joint)
    held = held_problem(result, day, NOISE)
    (learnt,) = (entry.sd for entry in result.noise if joint in entry.quantities)
    assert learnt is not None
    assert held.problem.uncertainty.sd[row] == pytest.approx(learnt)
    later = day_problem(Calibrated.of(result, ""), day, None)
    assert later.uncertainty.sd[row] == pytest.approx(learnt)


def test_a_joint_at_rest_in_all_poses_stays_exact_in_predicted_ones() -> None:
    rest = {"phi3": np.full(POSES, 0.3)}
    read = ARM.read(SDS, seed=2)
    there = np.array([read["phi2"], rest["phi3"]])
    data = arm_at(ARM.truth, there).read({"xP": POINT, "yP": POINT}, seed=5).with_readings(rest)
    noise = lc.Noise({"phi?": JOINTS, "?P": POINT})
    parameters = ARM.truth.parameters.with_fixed(["phi30", "l3"])
    machine = ARM.truth.with_parameters(parameters)
    result = lc.calibrate(machine, data, noise=noise, method="implicit-loop")
    row = list(result.mechanism.tape.quantities).index("phi3")
    assert not held_problem(result, data.take([1, 2, 3]), noise).problem.uncertainty.sd[row].any()
    moved = data.take([1, 2, 3]).with_readings({"phi3": np.full(3, 0.4)})
    assert held_problem(result, moved, noise).problem.uncertainty.sd[row].all()


def test_poses_that_are_never_split_count_once_in_what_regions_hold() -> None:
    inside = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0])
    groups = np.array([0, 1, 1, 1, 1, 2, 3])
    whole = Validation({}, "", None, None, inside=inside, groups=groups)
    assert whole.coverage is not None
    assert (whole.coverage.share, whole.coverage.poses) == (0.75, 4)
    each = Validation({}, "", None, None, inside=inside).coverage
    assert each is not None
    assert each.share == pytest.approx(3.0 / 7.0)
