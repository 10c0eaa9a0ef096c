"""Poses that took no part in a fit: which they are, and how well they are predicted."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import multivariate_normal

import loopcal as lc
from loopcal.errors import Code, InputError
from loopcal.estimation.calibrate import calibrate
from loopcal.estimation.result import FitResult
from loopcal.statistics import case, validation
from loopcal.statistics.folds import blocks, folds, grouped, held_out, repeated
from loopcal.statistics.predictive import Held, Predictive, predictive
from loopcal.statistics.validate import compare_methods, validate
from tests.reference.simulated import arm_at, planar_arm
from tests.refusals import refused

SDS = {"xP": 1e-4, "yP": 1e-4, "phi2": 1e-3, "phi3": 1e-3}
NOISE = lc.Noise(SDS)
ARM = planar_arm(40)
DATA = ARM.read(SDS, seed=1)


def by_hand(left_out: np.ndarray[Any, Any], **how: Any) -> tuple[lc.Result, np.ndarray[Any, Any]]:
    """A fit from scratch without some poses, and its prediction errors there (2, n)."""
    rest = np.setdiff1d(np.arange(len(DATA)), left_out)
    fit = lc.calibrate(ARM.truth, DATA.take(rest), **{"method": "implicit-loop", **how})
    v = fit.value
    a = DATA["phi2"][left_out] + v["phi20"]
    b = a + DATA["phi3"][left_out] + v["phi30"]
    x = v["xA"] + v["l2"] * np.cos(a) + v["l3"] * np.cos(b) - DATA["xP"][left_out]
    y = v["yA"] + v["l2"] * np.sin(a) + v["l3"] * np.sin(b) - DATA["yP"][left_out]
    return fit, np.array([x, y])


def test_every_pose_is_left_out_once_and_repeats_stay_together() -> None:
    joints = np.array([DATA["phi2"], DATA["phi3"]])
    twice = arm_at(ARM.truth, np.hstack([joints, joints + 1e-7]))
    data = twice.read({"xP": 1e-4})
    groups = repeated(ARM.truth, data)
    assert (groups[:40] == groups[40:]).all()
    assert len(set(groups.tolist())) == 40
    parts = folds(groups, 7, seed=3)
    assert sorted(np.concatenate(parts).tolist()) == list(range(80))
    assert {len(part) for part in parts} <= {10, 12}
    for part in parts:
        assert set(part) == {(i + 40) % 80 for i in part}
    again = folds(groups, 7, seed=3)
    assert all((a == b).all() for a, b in zip(parts, again, strict=True))
    some = held_out(groups, 0.3, seed=0)
    assert len(some) == 24
    assert set(some) == {(i + 40) % 80 for i in some}


def test_a_part_without_regions_leaves_those_of_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    def silent(fit: FitResult, held: Held, drifting: Any, run: Any) -> Predictive | None:
        return None if 0 in run.held else predictive(fit, held, drifting, run)

    monkeypatch.setattr(validation, "predictive", silent)
    made = validate(ARM.truth, DATA, noise=NOISE, folds=5)
    assert made.coverage is not None
    assert made.coverage.poses == 32
    assert made.log_likelihood is None
    (part,) = made.silent
    assert part.poses == 8
    words, *_ = made.warnings
    assert words.startswith(f"Fold {part.number} of 5 (8 poses) has no region: ")
    assert made.entry.silent == made.silent


def test_a_passive_sensor_that_jitters_and_a_time_do_not_split_repeats() -> None:
    """A four-bar by two angles: the second is passive, and reads each position anew."""
    crank = np.repeat(np.linspace(0.0, 6.0, 30), 4)
    rng = np.random.default_rng(0)
    data = lc.Dataset.from_arrays(
        {"a": crank, "b": np.sin(crank) + rng.normal(0.0, 1e-3, 120), "t": np.arange(120.0)}
    )
    coupler = lc.Mechanism.from_function(
        lambda x, p: p.r * np.sin(x.a) - x.b + p.v * x.t,
        {"a": "rad", "b": "rad"},
        {"r": (1.0, "1"), "v": (0.0, "1")},
        pose_constants={"t": "1"},
    )
    groups = repeated(coupler, data, {"a": 0.0, "b": 1e-3})
    assert (groups == np.repeat(np.arange(30), 4)).all()
    assert len(set(repeated(coupler, data).tolist())) > 100


def test_one_repeated_pose_among_poses_that_stand_apart_is_seen_and_loads_what_it_needs() -> None:
    rng = np.random.default_rng(8)
    joints = rng.uniform(-2.0, 2.0, (2, 300))
    alone = repeated(ARM.truth, lc.Dataset.from_arrays({"phi2": joints[0], "phi3": joints[1]}))
    assert (alone == np.arange(300)).all()
    joints[:, 17] = joints[:, 211] + 3e-4 * np.array([1.0, -1.0])  # within 1e-4 of the range
    twice = repeated(ARM.truth, lc.Dataset.from_arrays({"phi2": joints[0], "phi3": joints[1]}))
    assert len(set(twice.tolist())) == 299
    assert twice[17] == twice[211]


def test_a_dense_path_is_cut_where_its_noise_ends_not_chained_into_one() -> None:
    path = lc.Dataset.from_arrays({"phi2": np.linspace(0, 1, 2000), "phi3": np.zeros(2000)})
    groups = repeated(ARM.truth, path, {"phi2": 1e-3})
    counts = np.bincount(groups)
    assert 200 < len(counts) < 500
    assert counts.max() <= 9


def test_blocks_are_regions_that_keep_repeats_together() -> None:
    """Five clumps of joints, angles beyond a turn among them: the blocks are the clumps."""
    rng = np.random.default_rng(2)
    centres = rng.uniform(-3.0, 3.0, (2, 5)).repeat(16, axis=1) + 0.1 * rng.normal(size=(2, 80))
    clumps = np.arange(80) // 16
    turned = centres + 2.0 * np.pi * rng.integers(-1, 2, (2, 80))
    data = arm_at(ARM.truth, turned).read()
    found = blocks(ARM.truth, data, repeated(ARM.truth, data), 5)
    assert {tuple(set(clumps[part].tolist())) for part in found} == {(i,) for i in range(5)}
    again = blocks(ARM.truth, data, repeated(ARM.truth, data), 5)
    assert all((a == b).all() for a, b in zip(found, again, strict=True))
    mixed = blocks(ARM.truth, data, np.arange(80, dtype=np.intp) // 2, 4)
    assert all(set(part.tolist()) == {i ^ 1 for i in part.tolist()} for part in mixed)
    assert min(map(len, mixed)) >= 5
    with refused("too-few-poses", "6"):
        blocks(ARM.truth, data.take(np.arange(6)), np.arange(6, dtype=np.intp), 7)


def test_joints_of_another_arm_are_no_place() -> None:
    """Where an arm was not read it is as near to all: two clumps of either arm are four blocks."""
    rng = np.random.default_rng(4)
    clumps = np.arange(60) // 15
    q = np.where(clumps % 2, 1.0, -1.0) + 0.1 * rng.normal(size=(2, 60))
    data = arm_at(ARM.truth, q).read()
    read = {
        name: np.where(clumps // 2 == arm, data[name], np.nan)
        for arm, name in enumerate(("phi2", "phi3"))
    }
    found = blocks(ARM.truth, data.with_readings(read), np.arange(60, dtype=np.intp), 4)
    assert {tuple(set(clumps[part].tolist())) for part in found} == {(i,) for i in range(4)}


def test_blocked_validation_predicts_regions_by_fits_of_the_others() -> None:
    groups = repeated(ARM.truth, DATA)
    found = validate(ARM.truth, DATA, noise=NOISE, folds=5, blocks=4, method="implicit-loop")
    alone = validate(ARM.truth, DATA, noise=NOISE, folds=5, method="implicit-loop")
    assert found.blocked is not None
    assert found.accuracy == alone.accuracy
    assert found.blocked.distances is not None
    for part in blocks(ARM.truth, DATA, groups, 4):
        errors = by_hand(part, noise=NOISE)[1]
        assert found.blocked.distances[part] == pytest.approx(np.hypot(*errors), rel=1e-6)
    assert found.entry.blocked == found.blocked.entry
    assert found.blocked.parts == 4


def test_stated_regions_hold_as_often_as_they_say() -> None:
    """40 draws of 40 poses: the share has a standard error of 0.5 %."""
    held = [
        validate(
            ARM.truth, ARM.read(SDS, seed=seed), noise=NOISE, folds=4, method="implicit-loop"
        ).coverage
        for seed in range(40)
    ]
    shares = [found.share for found in held if found is not None]
    assert len(shares) == 40
    assert np.mean(shares) == pytest.approx(0.95, abs=0.015)
    wrong = validate(
        ARM.truth, DATA, noise={"?P": 1e-4, "phi?": 1e-4}, folds=4, method="implicit-loop"
    ).coverage
    assert wrong is not None
    assert wrong.share < 0.5


def test_stated_groups_stay_together() -> None:
    groups = grouped(ARM.truth, DATA, [i // 4 for i in range(40)])
    for part in folds(groups, 5, seed=0):
        assert len(part) == 8
        assert len(set((part // 4).tolist())) == 2


BY_NOISE = {"noise": NOISE, "method": "implicit-loop"}


@pytest.mark.parametrize("how", [{"method": "least-squares"}, BY_NOISE], ids=str)
def test_refits_give_nothing_away(how: dict[str, Any]) -> None:
    parts = folds(repeated(ARM.truth, DATA), 5, seed=2)
    found = validate(ARM.truth, DATA, folds=5, seed=2, **how)
    errors = np.zeros((2, len(DATA)))
    for part in parts:
        errors[:, part] = by_hand(part, **how)[1]
    assert found.distances == pytest.approx(np.hypot(*errors), rel=1e-6)
    assert found.accuracy is not None
    assert found.accuracy.rms == pytest.approx(np.sqrt(np.square(errors).sum(axis=0).mean()))
    assert found.poses == DATA.poses


def test_refits_that_begin_at_learnt_sds_give_nothing_away() -> None:
    """The second encoder, exact here, may end at zero in one fit and not in another."""
    data = ARM.read(SDS | {"phi3": 0.0}, seed=3)
    noise = lc.Noise(SDS, estimate={"phi?": "each"})
    found = validate(ARM.truth, data, folds=5, seed=2, noise=noise, method="implicit-loop")
    assert found.distances is not None
    for part in folds(repeated(ARM.truth, data), 5, seed=2):
        rest = data.take(np.setdiff1d(np.arange(len(data)), part))
        other = validate(
            ARM.truth, rest, noise=noise, other=data.take(part), method="implicit-loop"
        )
        assert found.distances[part] == pytest.approx(other.distances, rel=1e-4)


def test_the_predictive_likelihood_is_that_of_the_misclosure() -> None:
    part = held_out(repeated(ARM.truth, DATA), 0.2, seed=4)
    found = validate(ARM.truth, DATA, noise=NOISE, hold_out=0.2, seed=4, method="implicit-loop")
    fit, errors = by_hand(part, noise=NOISE)
    v, total = fit.value, 0.0
    for i, e in zip(part, errors.T, strict=True):
        a = DATA["phi2"][i] + v["phi20"]
        b = a + DATA["phi3"][i] + v["phi30"]
        turn_b = v["l3"] * np.array([-np.sin(b), np.cos(b)])
        turn_a = v["l2"] * np.array([-np.sin(a), np.cos(a)]) + turn_b
        along = [[np.cos(a), np.sin(a)], [np.cos(b), np.sin(b)]]
        J = np.column_stack([np.eye(2), np.array(along).T, turn_a, turn_b])
        W = np.eye(2) * 1e-8 + 1e-6 * (np.outer(turn_a, turn_a) + np.outer(turn_b, turn_b))
        total += float(multivariate_normal.logpdf(e, cov=W + J @ fit.covariance @ J.T))
    assert found.log_likelihood == pytest.approx(total, rel=1e-6)


def test_the_right_noise_predicts_best() -> None:
    wrong = lc.Noise(SDS | {"phi2": 1e-5})
    found = compare_methods(
        ARM.truth,
        DATA,
        {
            "right": {"noise": NOISE, "method": "implicit-loop"},
            "wrong": {"noise": wrong, "method": "implicit-loop"},
            "basic": {"method": "least-squares"},
        },
        folds=5,
    )
    right, bad, plain = (found.validations[n].log_likelihood for n in ("right", "wrong", "basic"))
    assert right is not None
    assert bad is not None
    assert plain is not None
    assert right > plain > bad
    assert [line.split()[0] for line in str(found).splitlines()] == ["on", *found.validations]


def test_sds_by_pose_and_estimated_ones_are_validated_too() -> None:
    by_pose = lc.Noise({q: np.full(len(DATA), sd) for q, sd in SDS.items()})
    plain = validate(ARM.truth, DATA, noise=NOISE, folds=4, method="implicit-loop")
    assert validate(
        ARM.truth, DATA, noise=by_pose, folds=4, method="implicit-loop"
    ).log_likelihood == pytest.approx(plain.log_likelihood)
    begun = lc.Noise(SDS | {"phi2": 1e-4, "phi3": 1e-4}, estimate={"phi?": "group"})
    learnt = validate(ARM.truth, DATA, noise=begun, folds=4, method="implicit-loop")
    stated = validate(
        ARM.truth, DATA, noise=lc.Noise(begun.entries), folds=4, method="implicit-loop"
    )
    assert learnt.log_likelihood is not None
    assert stated.log_likelihood is not None
    assert plain.log_likelihood is not None
    assert learnt.log_likelihood > stated.log_likelihood + 100
    assert learnt.log_likelihood == pytest.approx(plain.log_likelihood, abs=5)


def test_another_file_is_predicted_by_the_fit_of_all() -> None:
    other = planar_arm(3, seed=9).read(SDS, seed=5)
    found = validate(ARM.truth, DATA, noise=NOISE, other=other, method="implicit-loop")
    assert found.poses == other.poses
    assert found.log_likelihood is not None
    assert found.accuracy is not None
    assert found.accuracy.max < 6e-3


def test_poses_that_a_part_leaves_open_have_no_likelihood() -> None:
    arm = ARM.truth.with_parameters(ARM.truth.parameters.with_fixed(["xA", "yA"]))
    joints = np.zeros((2, 12))
    joints[0], joints[1, -1] = np.linspace(0, 2, 12), 0.7  # one pose alone tells l2 from l3
    exact = SDS | {"phi3": 0.0}
    data = arm_at(arm, joints).read(exact, seed=3)
    assert (
        validate(arm, data, noise=lc.Noise(exact), folds=12, method="implicit-loop").log_likelihood
        is None
    )
    assert validate(
        arm, data, noise=lc.Noise(exact), hold_out=0.2, seed=2, method="implicit-loop"
    ).log_likelihood


def test_a_pose_without_outputs_changes_no_likelihood() -> None:
    """It has no loop, so its probability is one, whatever memory held before."""
    blank = {
        q: np.append(v, np.nan if q in ("xP", "yP") else 0.3) for q, v in DATA.readings.items()
    }
    whole = lc.calibrate(ARM.truth, DATA, noise=NOISE, method="implicit-loop")
    other = validate(ARM.truth, DATA, noise=NOISE, full=whole, other=DATA, method="implicit-loop")
    more = validate(
        ARM.truth,
        DATA,
        noise=NOISE,
        full=whole,
        other=lc.Dataset.from_arrays(blank),
        method="implicit-loop",
    )
    assert more.log_likelihood == pytest.approx(other.log_likelihood, rel=1e-12)
    assert more.by_pose is not None
    assert more.by_pose[-1] == 0.0


@pytest.mark.parametrize(
    ("how", "code", "stated"),
    [
        ({"folds": 1}, "too-few-poses", ("1",)),
        ({"folds": 41}, "too-few-poses", ("41", "40")),
        ({"hold_out": 1.5}, "invalid-value", ("1.5",)),
        ({"hold_out": 0.999}, "too-few-poses", ("0.999", "40")),
        ({"seed": -1}, "invalid-value", ("seed",)),
        ({"groups": [1, 2]}, "wrong-shape", ("2", "40")),
    ],
)
def test_a_choice_that_cannot_be_made_is_refused(
    how: dict[str, Any], code: Code, stated: tuple[str, ...]
) -> None:
    with refused(code, *stated):
        validate(ARM.truth, DATA, method="least-squares", **how)


def project(name: str, monkeypatch: pytest.MonkeyPatch, file: Path) -> lc.Project:
    monkeypatch.setenv("LOOPCAL_DATA", str(file.parents[1]))
    folder = Path(__file__).resolve().parents[2] / "examples" / "motoman"
    return lc.read_project(folder / f"{name}.toml")


def test_the_measured_grid(
    shared_data: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    file = shared_data("motoman_ma1400_leica/left_arm_grid.csv")
    read = project("left_arm_grid", monkeypatch, file)
    data = lc.load_dataset(read).dataset
    found = validate(read.mechanism, data, method="least-squares", folds=10).accuracy
    assert found is not None
    assert found.rms == pytest.approx(0.077e-3, abs=0.001e-3)
    assert found.max == pytest.approx(0.172e-3, abs=0.006e-3)


def test_the_measured_workspace(
    shared_data: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    file = shared_data("motoman_ma1400_leica/right_arm_workspace.csv")
    read = project("right_arm_workspace", monkeypatch, file)
    data = lc.load_dataset(read).dataset
    noise = lc.Noise({"theta_*": 5e-5, "xyz": 5e-6})
    data = lc.Dataset(data.readings, data.units, data.poses)
    methods: dict[str, dict[str, Any]] = {
        "basic": {"method": "least-squares"},
        "new": {"noise": noise, "method": "implicit-loop"},
    }
    found = compare_methods(read.mechanism, data, methods, folds=10).validations
    basic, new = (found[name].accuracy for name in methods)
    assert basic is not None
    assert new is not None
    assert basic.rms == pytest.approx(2.39e-3, abs=0.02e-3)
    assert new.rms == pytest.approx(3.08e-3, abs=0.06e-3)


def test_a_fold_that_fails_is_reported_and_the_others_count(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    parts = folds(repeated(ARM.truth, DATA), 5, seed=0)
    gone = {DATA.poses[i] for i in parts[2]}

    def failing(mechanism: lc.Mechanism, data: lc.Dataset, **how: Any) -> FitResult:
        if not gone & set(data.poses):
            raise InputError("these poses do not close")
        return calibrate(mechanism, data, **how)

    whole = validate(ARM.truth, DATA, noise=NOISE, folds=5, method="implicit-loop")
    monkeypatch.setattr(case, "calibrate", failing)
    found = validate(ARM.truth, DATA, noise=NOISE, folds=5, method="implicit-loop")
    (failed,) = found.failed
    assert (failed.number, failed.poses, failed.reason) == (3, 8, "these poses do not close")
    assert found.parts == 5
    assert "4 of 5 folds predicted" in found.words
    assert set(found.poses) == set(DATA.poses) - gone
    kept = [pose not in gone for pose in whole.poses]
    assert whole.by_pose is not None
    assert found.log_likelihood == pytest.approx(whole.by_pose[kept].sum(), rel=1e-12)
    assert any("Fold 3 of 5 (8 poses)" in warning for warning in found.warnings)


def test_where_every_fold_fails_there_is_no_validation() -> None:
    full = lc.calibrate(ARM.truth, DATA, noise=NOISE, method="implicit-loop")
    with refused("not-converged", "max_iterations"):
        validate(
            ARM.truth,
            DATA,
            noise=NOISE,
            folds=5,
            full=full,
            max_iterations=0,
            method="implicit-loop",
        )
