"""Change points: found where they are and as what they are, and not where there are none."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.special import betainc

import loopcal as lc
from analyses.gauntlet_worlds import Event, World, in_one_corner, nothing
from loopcal.chi_squared import tail
from loopcal.document.change_points import Change, ChangePoint
from loopcal.files.machines.mechanism_file import mechanism_from_data
from loopcal.mechanisms.station import Station, pose_of
from loopcal.statistics.estimated import log_share, log_tail
from loopcal.statistics.findings import as_fitted, sized
from loopcal.statistics.verdict import findings_of
from tests.estimation.test_real_data import RIGHT, left_arm, measured
from tests.reference.simulated import MA1400_RANGES, ma1400
from tests.refusals import refused

Array = NDArray[np.float64]
Find = Callable[[str], Path]
SDS = {f"theta_{i}": 2e-5 for i in range(1, 7)} | dict.fromkeys("xyz", 5e-5)
NOISE = lc.Noise(SDS)
ARM = ma1400(2).truth


def joints(poses: int, seed: int, order: str = "random") -> dict[str, Array]:
    rng = np.random.default_rng(seed)
    low, high = 0.6 * MA1400_RANGES.T
    values = rng.uniform(low, high, (poses, 6))
    if order == "grid":
        axes = [np.linspace(low[i], high[i], 5) for i in range(3)]
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        values = np.column_stack([grid, rng.normal(0.0, 0.2, (len(grid), 3))])
    return {f"theta_{i}": values[:, i - 1] for i in range(1, 7)}


def read(poses: dict[str, Array], seed: int, changes: dict[str, float] | None = None) -> lc.Dataset:
    truth = {p.name: p.nominal + (changes or {}).get(p.name, 0.0) for p in ARM.parameters}
    return lc.simulate(ARM, poses, noise=NOISE, seed=seed, truth=truth).dataset


def joined(first: lc.Dataset, second: lc.Dataset, at: int) -> lc.Dataset:
    """The readings of the first up to pose number `at`, then those of the second."""
    later = np.arange(len(first)) >= at
    return first.with_readings({q: np.where(later, second[q], first[q]) for q in first.readings})


def sagging(data: lc.Dataset, compliance: float = 1e-3) -> lc.Dataset:
    """The point lowered, as by a shoulder that gives way with the reach [rad/m]."""
    reach = np.hypot(data["x"], data["y"])
    turn, height = compliance * reach, data["z"] - 0.45
    return data.with_readings(
        {
            "x": data["x"] + turn * height * data["x"] / reach,
            "y": data["y"] + turn * height * data["y"] / reach,
            "z": data["z"] - turn * reach,
        }
    )


def fitted(data: lc.Dataset) -> lc.Result:
    return lc.calibrate(ARM, data, noise=NOISE, start="nominal", method="implicit-loop")


@pytest.mark.parametrize("order", ["random", "grid"])
@pytest.mark.parametrize("compliance", [0.0, 1e-3])
def test_an_arm_that_only_bends_has_no_shift(order: str, compliance: float) -> None:
    alarms = 0
    for seed in range(10):
        data = sagging(read(joints(100, seed, order), seed), compliance)
        alarms += len(lc.find_shifts(fitted(data))) > 0
    assert alarms == 0


@pytest.mark.parametrize("compliance", [0.0, 1e-3])
def test_a_slipped_target_is_found_with_its_pose_and_size(compliance: float) -> None:
    for seed in range(4):
        poses = joints(120, seed)
        at = int(np.random.default_rng(seed).integers(15, 105))
        slipped = {"x6B": 1e-3, "z6B": -5e-4}
        data = joined(read(poses, seed), read(poses, seed, slipped), at)
        (point,) = lc.find_shifts(fitted(sagging(data, compliance))).found
        assert point.shape == "step"
        assert point.moved == "target"
        assert abs(point.number - 1 - at) <= 1
        assert point.p_value < 1e-6
        for name, size in slipped.items():
            assert point.changes[name].size == pytest.approx(size, abs=2.5e-4)


def test_a_moved_base_is_no_slipped_target() -> None:
    poses = joints(120, 7)
    data = joined(read(poses, 7), read(poses, 7, {"y0": 5e-4, "phix0": 1e-3}), 60)
    (point,) = lc.find_shifts(fitted(data)).found
    assert point.moved == "station"
    assert abs(point.number - 61) <= 1
    assert point.changes["base_y"].size == pytest.approx(5e-4, abs=1e-4)
    assert point.changes["base_rx"].size == pytest.approx(1e-3, abs=1e-4)


def test_an_encoder_mastered_anew_is_the_zero_of_its_joint() -> None:
    data = read(joints(120, 8), 8)
    later = np.arange(120) >= 70
    wrong = data.with_readings({"theta_3": data["theta_3"] + 2e-3 * later})
    result = fitted(wrong)
    (point,) = lc.find_shifts(result).found
    assert (point.moved, point.names) == ("joint", ("theta_3",))
    assert abs(point.number - 71) <= 1
    assert point.changes["theta_3"].size == pytest.approx(-2e-3, rel=0.1)
    again = lc.with_shifts(ARM, wrong, [point])
    refit = lc.calibrate(
        again.mechanism, again.data, noise=NOISE, start="nominal", method="implicit-loop"
    )
    assert refit.chi_squared is not None
    assert refit.chi_squared.variance_factor == pytest.approx(1.0, abs=0.25)
    assert refit.value["theta_3_from71"] == pytest.approx(2e-3, rel=0.05)


def test_what_is_modelled_is_said_by_the_sizes_of_the_fit() -> None:
    """The parameters of a shift count from the start of the run; the sentence from the step."""
    data, number = read(joints(120, 9), 9), np.arange(120)
    wrong = data.with_readings(
        {"theta_3": data["theta_3"] + 2e-3 * (number >= 40) + 3e-3 * (number >= 80)}
    )
    points = [replace(p, modelled=True) for p in lc.find_shifts(fitted(wrong)).found]
    made = lc.with_shifts(ARM, wrong, points)
    refit = lc.calibrate(
        made.mechanism, made.data, noise=NOISE, start="nominal", method="implicit-loop"
    )
    first, second = (as_fitted(refit, p, points).changes["theta_3"] for p in points)
    value, sd = refit.value, refit.sd
    assert first.size == -value["theta_3_from41"] == pytest.approx(-2e-3, rel=0.1)
    assert first.sd == sd["theta_3_from41"]
    assert second.size == value["theta_3_from41"] - value["theta_3_from81"]
    assert second.size == pytest.approx(-3e-3, rel=0.1)
    meanings = {p.name: p.meaning for p in made.mechanism.parameters}
    assert meanings["theta_3_from41"] == (
        "change of what theta_3 reads from pose 41 on, against the start"
    )


@pytest.mark.parametrize(("name", "size"), [("x2", 1e-3), ("phiy3", 1e-3)])
def test_a_link_that_bends_is_named_and_no_zero_or_target(name: str, size: float) -> None:
    for seed in range(3):
        poses = joints(80, seed)
        data = joined(read(poses, seed), read(poses, seed, {name: size}), 40)
        (point,) = lc.find_shifts(fitted(sagging(data))).found
        assert (point.shape, point.moved) == ("step", "link")
        assert abs(point.number - 41) <= 1
        assert point.changes[name].size == pytest.approx(size, abs=1.5e-4)
        assert "from pose 4" in point.what
        assert "a link of the machine changed" in point.what
        again = lc.with_shifts(ARM, data, [point])
        assert f"{name}_from{point.number}" in again.mechanism.parameters.names


def test_a_link_that_cools_is_no_step() -> None:
    """It was "from pose 26 on a link changed" where it had shrunk all along the run; for one of
    eight the drift of an instrument does the same."""
    answers = []
    for seed in range(8):
        poses = joints(80, seed)
        cold, warm = read(poses, seed), read(poses, seed, {"x2": 1e-3})
        share = np.exp(-np.linspace(0.0, 4.0, 80))
        cooling = {q: cold[q] + share * (warm[q] - cold[q]) for q in "xyz"}
        shifts = lc.find_shifts(fitted(sagging(cold.with_readings(cooling))))
        assert all(point.shape == "ramp" for point in shifts.found)
        answers.append(not shifts.found and {p.moved for p in shifts.unsure} == {"link"})
    assert sum(answers) >= 7


def test_parts_of_the_machine_that_do_the_same_change_together() -> None:
    """Beside joints that hardly turn, the length of a link does what a zero does."""
    for seed in range(4):
        poses = joints(60, seed)
        for i in (3, 5):
            poses[f"theta_{i}"] *= 0.03
        data = joined(read(poses, seed), read(poses, seed, {"x4": 3e-4}), 30)
        (point,) = lc.find_shifts(fitted(data)).found
        assert (point.moved, point.alternatives) == ("link", ())
        assert {"theta_5", "x4"} <= {*point.names}
        made = lc.with_shifts(ARM, data, [point]).mechanism.parameters.names
        assert all(f"{name}_from{point.number}" in made for name in point.names)


def test_such_a_change_along_another_day_is_named_as_well() -> None:
    result = fitted(read(joints(80, 9), 9))
    poses = joints(60, 0)
    for i in (3, 5):
        poses[f"theta_{i}"] *= 0.03
    day = joined(read(poses, 0), read(poses, 0, {"x4": 3e-4}), 30)
    done = lc.verify(result, day)
    (point,) = done.shifts.found
    assert {"theta_5", "x4"} <= {*point.names}
    assert done.verdict["consistent"].code == "change-points"


def test_two_zero_shifts_of_a_wire_are_found_and_the_refit_gives_the_noise_back() -> None:
    arm = lc.Mechanism.from_function(
        lambda x, p: (
            (
                (p.l1 * np.cos(x.a) + p.l2 * np.cos(x.a + x.b) - p.wx) ** 2
                + (p.l1 * np.sin(x.a) + p.l2 * np.sin(x.a + x.b) - p.wy) ** 2
            )
            ** 0.5
            + p.zero
            - x.L,
        ),
        {"a": "rad", "b": "rad", "L": "m"},
        {
            "l1": (0.8, "m"),
            "l2": (0.6, "m"),
            "wx": (2.0, "m"),
            "wy": (0.3, "m"),
            "zero": (0.0, "m"),
        },
        outputs=("L",),
    )
    arm = arm.with_parameters(arm.parameters.with_fixed(["l1"]))
    rng = np.random.default_rng(9)
    places = {"a": rng.uniform(-2.0, 2.0, 200), "b": rng.uniform(0.3, 2.5, 200)}
    noise = lc.Noise({"a": 1e-5, "b": 1e-5, "L": 4e-4})
    data = lc.simulate(arm, places, noise=noise, seed=1).dataset
    steps = 3e-3 * (np.arange(200) >= 57) - 3e-3 * (np.arange(200) >= 140)
    wrong = data.with_readings({"L": data["L"] + steps})
    result = lc.calibrate(arm, wrong, noise=noise, method="implicit-loop")
    found = lc.find_shifts(result).found
    assert [p.names for p in found] == [("L",), ("L",)]
    assert [abs(p.number - n) <= 1 for p, n in zip(found, (58, 141), strict=True)] == [True, True]
    assert [p.changes["L"].size for p in found] == pytest.approx([3e-3, -3e-3], abs=3e-4)
    again = lc.with_shifts(arm, wrong, found)
    assert again.toml.count("[[mechanism.effect]]") == 1
    refit = lc.calibrate(again.mechanism, again.data, noise=noise, method="implicit-loop")
    assert refit.chi_squared is not None
    assert result.chi_squared is not None
    assert result.chi_squared.variance_factor is not None
    assert result.chi_squared.variance_factor > 5.0
    assert refit.chi_squared.variance_factor == pytest.approx(1.0, abs=0.25)


def test_outliers_do_not_list_the_poses_that_a_shift_explains() -> None:
    poses = joints(120, 10)
    data = joined(read(poses, 10, {"x6B": 4e-3, "y6B": -3e-3}), read(poses, 10), 20)
    spoilt = data["x"].copy()
    spoilt[90] += 5e-3
    result = fitted(data.with_readings({"x": spoilt}))
    found = lc.findings(result)
    assert [p.moved for p in found.shifts.found] == ["target"]
    assert [o.pose for o in found.outliers.found] == [data.poses[90]]
    document = result.document
    assert document.change_points is not None
    assert "shift" in document.change_points.toml
    assert "change-points" in {one.code for one in findings_of(document)}


def test_one_outlier_is_no_shift() -> None:
    data = read(joints(100, 11), 11)
    for row in (0, 3, 50, 99):
        spoilt = data["y"].copy()
        spoilt[row] += 0.02
        assert not lc.find_shifts(fitted(data.with_readings({"y": spoilt}))).found


def test_few_poses_are_not_searched_and_a_level_is_a_probability() -> None:
    data = read(joints(15, 12), 12)
    assert lc.find_shifts(fitted(data)).tested == 0
    with refused("invalid-value"):
        lc.find_shifts(fitted(data), level=1.5)


def test_the_log_of_a_tail_goes_on_where_the_tail_underflows() -> None:
    assert log_tail(20.0, 3) == pytest.approx(np.log(tail(20.0, 3)))
    below, above = log_tail(1240.0, 3), log_tail(1320.0, 3)
    assert above - below == pytest.approx(-40.0 + 0.5 * np.log(1320 / 1240), abs=0.01)


@pytest.mark.parametrize("spare", [12.0, 25.5, 80.0])
def test_a_share_of_the_squares_has_the_tail_of_beta(spare: float) -> None:
    """Within a third where it matters: at shares that decide, log p is off by a few hundredths."""
    for rank in (1, 2, 3, 6):
        for share in (0.1, 0.4, 0.7):
            exact = float(np.log(betainc(0.5 * spare, 0.5 * rank, 1.0 - share)))
            assert log_share(share, rank, spare) == pytest.approx(exact, abs=0.3, rel=0.01)
            assert rank != 2 or log_share(share, rank, spare) == pytest.approx(exact)


def test_without_shifts_mechanism_and_data_stay() -> None:
    data = read(joints(30, 13), 13)
    same = lc.with_shifts(ARM, data, ())
    assert same.mechanism is ARM
    assert same.data is data
    assert same.toml == ""


def test_the_reflector_of_the_workspace_set_slips_where_its_makers_say(shared_data: Find) -> None:
    data = measured(shared_data("motoman_ma1400_leica/right_arm_workspace.csv"))
    result = lc.calibrate(lc.motoman_ma1400(RIGHT), data, method="least-squares")
    found = lc.findings(result)
    slips = [p for p in found.shifts.found if p.moved == "target"]
    for pose in (14, 86):
        assert any(abs(int(p.pose) - pose) <= 2 and p.p_value < 1e-6 for p in slips)
    assert any(abs(int(p.pose) - 170) <= 8 and p.p_value < 1e-6 for p in found.shifts.found)
    assert "13" in {o.pose for o in found.outliers.found}


def test_what_moves_during_the_left_grid_is_found_and_named(shared_data: Find) -> None:
    data = measured(shared_data("motoman_ma1400_leica/left_arm_grid.csv"))
    rows = np.arange(len(data))

    def shifts(wrong: dict[str, Array]) -> tuple[lc.ChangePoint, ...]:
        spoilt = data.with_readings(wrong)
        return lc.find_shifts(lc.calibrate(left_arm(), spoilt, method="least-squares")).found

    assert shifts({}) == ()
    (step,) = shifts({"x": data["x"] + 5e-4 * (rows >= 100)})
    assert abs(step.number - 101) <= 2
    assert step.changes["x"].size == pytest.approx(5e-4, abs=1e-4)
    (ramp,) = shifts({"z": data["z"] + 3e-4 * rows / len(rows)})
    assert (ramp.shape, ramp.names) == ("ramp", ("z",))
    assert ramp.changes["z"].size == pytest.approx(3e-4, abs=1.5e-4)


def test_noise_that_targets_share_is_no_step() -> None:
    """Encoders move three reflectors of one tool together: nine equations of a pose, one error."""
    from zlib import crc32

    seed = crc32(b"three reflectors")
    trial = World(instrument="three reflectors").made(np.random.default_rng([seed, 6]))
    result = lc.calibrate(
        trial.mechanism, trial.readings, method="least-squares", model_error="structured"
    )
    assert len(lc.find_shifts(result)) == 0


@pytest.mark.parametrize("slope", [1.0, 0.3], ids=["nothing left", "rounding left"])
@pytest.mark.parametrize("method", ["least-squares", "implicit-loop"])
def test_readings_without_noise_hide_no_change_and_no_outlier(slope: float, method: str) -> None:
    line = lc.Mechanism.from_function(
        lambda x, p: p.slope * x.q + p.zero - x.y,
        {"q": "m", "y": "m"},
        {"slope": (1.0, "1"), "zero": (0.0, "m")},
        outputs=("y",),
    )
    q = 0.25 * np.arange(60)
    data = {"q": q, "y": slope * q + (1.0 - slope)}
    result = lc.calibrate(line, data, noise=lc.Noise({"q": 1e-4, "y": 1e-4}), method=method)
    assert lc.find_shifts(result).found == ()
    assert lc.find_outliers(result).found == ()


def test_the_size_of_a_change_is_how_far_it_moves_the_end_point() -> None:
    """Of a target its slip; of a joint the angle times the distance from its axis; of a reading
    itself; of all less than what noise makes of it."""
    data = read(joints(30, 1), 1)
    result = fitted(data)
    base = [result.value[name] for name in ("x0", "y0")]
    radius = np.hypot(data["x"] - base[0], data["y"] - base[1])
    expected = {
        ("x6B", 1e-3, "m"): 1e-3,
        ("y", -2e-4, "m"): 2e-4,
        ("theta_1", 1e-4, "rad"): 1e-4 * np.sqrt(np.square(radius).mean()),
    }
    for (name, size, unit), moves in expected.items():
        change = {name: Change(size, 1e-5, unit)}
        point = ChangePoint("step", "9", "8", 9, "target", change, 1e6, 1e-5)
        found = sized(result, point)
        assert found.unit == "m"
        assert found.moves == pytest.approx(moves, rel=0.01)
        unsure = sized(result, replace(point, gain=4.0)).moves
        assert unsure == pytest.approx(np.sqrt(0.75) * found.moves)


def test_the_size_of_a_growth_is_how_far_all_lengths_move_the_end_point() -> None:
    poses, growth = joints(30, 1), 2e-4
    data, result = read(poses, 1), fitted(read(poses, 1))
    lengths = {p.name: p.nominal for p in ARM.parameters if p.dimension == "length"}
    grown = read(poses, 1, {name: growth * length for name, length in lengths.items()})
    change = {"the scale of the machine": Change(growth, 1e-6, "1")}
    point = ChangePoint("ramp", "1", "30", 1, "expansion", change, 1e6, 1e-5, until=30)
    moves = np.sqrt(sum(np.square(grown[q] - data[q]).mean() for q in "xyz"))
    assert sized(result, point).moves == pytest.approx(moves, rel=0.02)


def test_a_pose_in_which_no_loop_holds_is_passed_over() -> None:
    data = read(joints(60, 1), 2)
    blank = {q: np.where(np.arange(60) == 7, np.nan, data[q]) for q in "xyz"}
    whole, part = (lc.find_shifts(fitted(its)) for its in (data, data.with_readings(blank)))
    assert whole.found == part.found == ()


@pytest.mark.parametrize(("event", "named"), [(in_one_corner, 4), (nothing, 0)])
def test_a_step_without_a_sharp_edge_leaves_the_verdict_open(event: Event, named: int) -> None:
    codes = []
    for seed in range(4):
        world = World(poses=150, order="path", event=event)
        trial = world.made(np.random.default_rng([98, 700 + seed]))
        result = lc.calibrate(
            trial.mechanism,
            trial.readings,
            noise=trial.noise,
            method="implicit-loop",
            model_error="structured",
        )
        codes.append(lc.verdict(result).sound.code == "drift-or-model")
    assert sum(codes) == named


def test_a_moved_station_of_an_arm_of_transitions_is_six_parameters_of_its_station() -> None:
    """Not six of its transitions, in whose frames its model error is stated."""
    data = read(joints(60, 14), 14)
    turn, shift = Rotation.from_rotvec([1e-3, -2e-3, 1.5e-3]), np.array([2e-3, -1e-3, 1.5e-3])
    p = np.array([data[q] for q in "xyz"])
    p[:, 30:] = turn.as_matrix() @ p[:, 30:] + shift[:, None]
    wrong = data.with_readings(dict(zip("xyz", p, strict=True)))
    result = fitted(wrong)
    (point,) = lc.find_shifts(result).found
    station = Station("base")
    assert (point.moved, point.names) == ("station", station.parameters)
    assert abs(point.number - 31) <= 1
    origin = dict.fromkeys(station.parameters, 0.0)
    for name, true in station.moved(origin, turn.as_matrix(), shift).items():
        change = point.changes[name]
        assert abs(change.size - true) < 5.0 * change.sd + 0.02 * abs(true)
    again = lc.with_shifts(ARM, wrong, [point])
    refit = lc.calibrate(again.mechanism, again.data, noise=NOISE, method="implicit-loop")
    assert refit.chi_squared is not None
    assert refit.chi_squared.variance_factor == pytest.approx(1.0, abs=0.5)
    table = {"type": "motoman-ma1400", "effect": tomllib.loads(again.toml)["mechanism"]["effect"]}
    stated = mechanism_from_data(table, "mechanism.toml")
    assert all(stated.parameters[name].fixed for name in station.parameters)
    T = pose_of([point.changes[name].size for name in station.parameters])
    moved = np.linalg.norm(T[:3, :3] @ p + T[:3, 3:] - p, axis=0)
    expected = np.sqrt(np.square(moved).mean() * (1.0 - 6.0 / point.gain))
    assert sized(result, point).moves == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize(
    ("count", "words"), [(3, "c0 by 0.0100 mm, c1"), (7, "no part of 7 is sure")]
)
def test_parts_that_are_not_clear_are_counted_where_they_are_many(count: int, words: str) -> None:
    changes = {f"c{i}": Change(1e-5, 1e-5, "m") for i in range(count)}
    point = ChangePoint("step", "9", "8", 9, "load", changes, 50.0, 1e-9)
    assert point.sizes.startswith(words)
