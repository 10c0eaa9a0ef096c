"""Outliers are found, blamed on the right reading, and what happened to them is named."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import loopcal as lc
from analyses.gross_errors import Counts, run, sds
from analyses.instruments import ARM_VALUES, setup, six_axis
from loopcal.errors import InputError
from loopcal.estimation.faults.search import column_faults
from loopcal.estimation.problem.problem import build_problem
from loopcal.mechanisms.instruments.point import point
from loopcal.mechanisms.machine import assemble
from loopcal.statistics import causes
from loopcal.units import from_si
from tests.estimation.test_contacts import READINGS
from tests.reference.simulated import ma1400, planar_arm
from tests.reference.verdicts import verdict_of

ARM = ma1400(60)
START = ARM.off(2e-3, 4e-3)
SDS = sds(ARM)
NOISE = lc.Noise(SDS)
UNITS = {q: "mm" if q in "xyz" else "deg" for q in ARM.exact}


def written(change=lambda readings: None) -> lc.Dataset:
    """Readings as a file has them, in degrees and millimetres with four decimals, then changed."""
    readings = {q: np.round(from_si(v, UNITS[q]), 4) for q, v in ARM.read(SDS, 1).readings.items()}
    change(readings)
    return lc.Dataset.from_arrays(readings, units=UNITS)


def outliers(change, **how) -> lc.Outliers:
    noise = None if how.get("method") == "least-squares" else NOISE
    return lc.find_outliers(
        lc.calibrate(START, written(change), noise=noise, **{"method": "implicit-loop", **how})
    )


@cache
def gross() -> Counts:
    return run(range(8))


@pytest.mark.parametrize("loss", ["huber", "student-t"])
def test_gross_errors_cost_a_robust_fit_little(loss: str) -> None:
    assert gross().rms(loss) < 1.15 * gross().rms("clean")
    assert gross().rms("gaussian") > 10 * gross().rms("clean")


@pytest.mark.parametrize("loss", ["huber", "student-t"])
def test_intervals_of_a_robust_fit_hold_in_spite_of_gross_errors(loss: str) -> None:
    """Few draws here; `analyses/gross_errors.py` does the same at full size."""
    a_draw_counts_once = np.sqrt(0.95 * 0.05 / 8)
    for fit in (loss, f"clean, {loss}"):
        assert abs(gross().coverage(fit)[0] - 0.95) < 2 * a_draw_counts_once
    assert gross().coverage("gaussian")[0] < 0.5


def test_gross_errors_are_named_and_good_readings_are_not() -> None:
    counts = gross()
    assert counts.named >= 0.95 * counts.gross
    assert counts.false_readings < 0.01 * counts.good_readings
    assert counts.false_poses < 0.01 * counts.good_poses


@pytest.mark.parametrize(
    ("instrument", "reading"),
    [("draw-wire", "wire"), ("distance", "wire"), ("relative distance", "span")],
)
def test_a_gross_error_of_an_instruments_only_reading_may_be_blamed_on_it(
    instrument: str, reading: str
) -> None:
    """Without it the pose has no loop; its size is found from the loop that it was read for."""
    given = setup(f"six-axis {instrument}")
    data = lc.simulate(given.truth, given.driven, noise=given.noise, seed=2).dataset
    wrong = data[reading] + np.where(np.arange(len(data)) == 30, 5e-3, 0.0)
    data = replace(data, readings={**data.readings, reading: wrong})
    start = given.nominal(2)
    start = start.with_parameters(start.parameters.with_fixed(given.held))
    (found,) = lc.find_outliers(
        lc.calibrate(start, data, noise=given.noise, method="implicit-loop")
    ).found
    assert found.pose == "31"
    assert reading in (found.quantity, *found.indistinct)
    assert found.size


def test_good_data_have_no_outliers() -> None:
    named = 0
    for draw in range(40):
        result = lc.calibrate(START, ARM.read(SDS, draw), noise=NOISE, method="implicit-loop")
        named += len(lc.find_outliers(result)) > 0
    assert named <= 6  # a level of 5 %


def turned(readings) -> None:
    readings["theta_4"][7] += 180


def negative(readings) -> None:
    readings["y"][7] *= -1


def moved_point(readings) -> None:
    readings["z"][7] /= 10


def radians(readings) -> None:
    readings["theta_1"][7] = np.radians(readings["theta_1"][7])


def repeated(readings) -> None:
    readings["theta_3"][7] = readings["theta_3"][6]


def mistyped(readings) -> None:
    tens = int(abs(readings["theta_2"][7]) // 10) % 10
    readings["theta_2"][7] += np.sign(readings["theta_2"][7]) * (10 if tens < 9 else -10)


def exchanged_digits(readings) -> None:
    text = f"{readings['x'][7]:.4f}"
    i = next(i for i in range(1, 3) if text[i] != text[i + 1] and text[i : i + 2].isdigit())
    readings["x"][7] = float(text[:i] + text[i + 1] + text[i] + text[i + 2 :])


@pytest.mark.parametrize("how", [{}, {"loss": "huber"}, {"method": "least-squares"}])
@pytest.mark.parametrize(
    ("change", "quantity", "words"),
    [
        (turned, "theta_4", "half a turn"),
        (negative, "y", "sign reversed"),
        (moved_point, "z", "decimal point moved"),
        (radians, "theta_1", "degrees"),
        (repeated, "theta_3", "repeated from the row before"),
        (mistyped, "theta_2", "one digit mistyped"),
        (exchanged_digits, "x", "two digits exchanged"),
    ],
)
def test_what_happened_to_a_reading_is_named(how, change, quantity, words) -> None:
    found = outliers(change, **how).found[0]
    assert (found.pose, found.quantity, found.verified) == ("8", quantity, True)
    assert found.cause is not None
    assert words in found.cause
    read = written(change)[quantity][7] - written()[quantity][7]
    off = (found.size or 0.0) - read
    full_turns = 2 * np.pi * np.round(off / (2 * np.pi)) if quantity.startswith("theta") else 0.0
    assert off - full_turns == pytest.approx(0.0, abs=2e-3)


def swapped(readings) -> None:
    readings["x"][7], readings["y"][7] = readings["y"][7], readings["x"][7]


def no_reflector(readings) -> None:
    for q in "xyz":
        readings[q][7] = 0.0


def same_point(readings) -> None:
    for q in "xyz":
        readings[q][7] = readings[q][6]


def metres(readings) -> None:
    for q in "xyz":
        readings[q][7] /= 1000


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (swapped, "x and y exchanged"),
        (no_reflector, "no reflector"),
        (same_point, "the point of the row before"),
        (metres, "metres"),
    ],
)
def test_what_happened_to_a_row_is_named(change, words) -> None:
    found = outliers(change).found
    assert [(o.pose, o.quantity, o.verified) for o in found] == [("8", None, True)]
    assert words in (found[0].cause or "")
    assert "pose 8" in str(found[0])


def test_only_columns_that_were_read_can_be_exchanged() -> None:
    """The small turns of an orientation have no column."""
    given = setup("six-axis pose")
    data = lc.simulate(given.truth, given.driven, noise=given.noise, seed=1).dataset
    data = replace(
        data, readings={q: v for q, v in data.readings.items() if q not in given.truth.implied}
    )
    problem = build_problem(given.truth, data, given.noise)
    guesses = list(causes._guesses(problem, data, causes.Suspect(3, 100.0, 6, {})))
    assert given.truth.implied
    assert any("exchanged" in guess.words for guess in guesses)
    assert not any(q in guess.words for guess in guesses for q in given.truth.implied)


def test_outliers_do_not_hide_each_other() -> None:
    def several(readings) -> None:
        for i in range(0, 60, 6):  # a sixth of all poses, all in one direction
            readings["x"][i] += 20.0 + 0.37 * i

    found = outliers(several)
    assert {o.pose for o in found.found} == {str(i + 1) for i in range(0, 60, 6)}
    assert {o.quantity for o in found.found} == {"x"}
    for outlier in found.found:
        true_size = 20e-3 + 0.37e-3 * (int(outlier.pose) - 1)
        assert outlier.size == pytest.approx(true_size, abs=1e-3)


def exchanged(readings) -> None:
    readings["theta_4"], readings["theta_6"] = readings["theta_6"], readings["theta_4"]


def one_in_degrees(readings) -> None:
    readings["theta_2"] = np.degrees(readings["theta_2"])


def one_reversed(readings) -> None:
    readings["theta_6"] = -readings["theta_6"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (exchanged, "the columns of theta_4 and theta_6 are exchanged"),
        (one_in_degrees, "theta_2 is in degrees"),
        (one_reversed, "theta_6 counts the other way round"),
    ],
)
def test_what_happened_to_a_column_is_named(change, words) -> None:
    found = outliers(change, method="least-squares", max_iterations=20)
    assert len(found.columns) == 1
    assert words in str(found)
    assert found.columns[0].before is not None
    assert found.columns[0].after is not None
    assert found.columns[0].after < 0.1 * found.columns[0].before


@pytest.mark.parametrize("method", ["least-squares", "implicit-loop"])
@pytest.mark.parametrize(
    ("project", "first", "second"),
    [
        ("left_arm_grid", "theta_4", "theta_5"),
        ("left_arm_grid", "theta_5", "theta_6"),
        ("right_arm_workspace", "theta_1", "theta_6"),
    ],
)
def test_columns_exchanged_in_measured_files_are_named(
    shared_data, monkeypatch, method, project, first, second
) -> None:
    path = shared_data("motoman_ma1400_leica/left_arm_grid.csv")
    monkeypatch.setenv("LOOPCAL_DATA", str(path.parents[1]))
    read = lc.read_project(f"examples/motoman/{project}.toml")
    data = lc.load_dataset(read)
    readings = dict(data.dataset.readings)
    readings[first], readings[second] = readings[second], readings[first]
    wrong = replace(data.dataset, readings=readings)
    noise = None if method == "least-squares" else data.noise
    result = lc.calibrate(read.mechanism, wrong, noise=noise, method=method, max_iterations=30)
    columns = lc.find_outliers(result).columns
    assert [c.words for c in columns] == [f"the columns of {first} and {second} are exchanged"]


@pytest.mark.parametrize("project", ["left_arm_grid", "right_arm_workspace"])
def test_no_column_of_the_measured_files_is_blamed(shared_data, monkeypatch, project) -> None:
    path = shared_data("motoman_ma1400_leica/left_arm_grid.csv")
    monkeypatch.setenv("LOOPCAL_DATA", str(path.parents[1]))
    read = lc.read_project(f"examples/motoman/{project}.toml")
    data = lc.load_dataset(read)
    start = build_problem(read.mechanism, data.dataset, data.noise)
    assert column_faults(start) == ()
    readings = start.readings.copy()
    row = start.mechanism.tape.quantities.index("x")
    readings[row, ::20] += 1.0  # gross errors are no fault of the column, nor do they hide one
    assert column_faults(replace(start, readings=readings)) == ()
    four, five = (start.mechanism.tape.quantities.index(f"theta_{i}") for i in (4, 5))
    readings[[four, five]] = readings[[five, four]]
    assert "theta_4 and theta_5" in column_faults(replace(start, readings=readings))[0].words


def test_a_mirror_image_names_every_column_that_may_be_to_blame() -> None:
    def mirrored(readings) -> None:
        readings["x"], readings["y"] = readings["y"], readings["x"]

    fault = outliers(mirrored, method="least-squares", max_iterations=20).columns[0]
    assert set(fault.quantities) == {"x", "y", "z"}
    assert fault.code == "left-handed"
    assert "the columns of y and z are exchanged" in fault.words


def test_pose_13_of_the_measured_workspace_is_named(shared_data, monkeypatch) -> None:
    path = shared_data("motoman_ma1400_leica/right_arm_workspace.csv")
    monkeypatch.setenv("LOOPCAL_DATA", str(path.parents[1]))
    project = lc.read_project("examples/motoman/right_arm_workspace.toml")
    data = lc.load_dataset(project)
    for method, noise in (("least-squares", None), ("implicit-loop", data.noise)):
        found = lc.find_outliers(
            lc.calibrate(project.mechanism, data.dataset, noise=noise, method=method)
        )
        assert found.by_residuals
        assert found.found[0].pose == "13"
        assert len(found) < 0.1 * len(data.dataset)


def test_a_loop_in_the_plane_tells_what_cannot_be_told_apart() -> None:
    arm = planar_arm(40)
    sds = {"xP": 1e-4, "yP": 1e-4, "phi2": 1e-4, "phi3": 1e-4}
    readings = {q: v.copy() for q, v in arm.read(sds, 2).readings.items()}
    readings["xP"][5] += 0.02
    result = lc.calibrate(arm.truth, readings, noise=lc.Noise(sds), method="implicit-loop")
    found = lc.find_outliers(result).found
    assert [o.pose for o in found] == ["6"]
    assert "xP" in (found[0].quantity, *found[0].indistinct)


def test_the_document_says_how_the_poses_were_tested() -> None:
    found = outliers(negative)
    assert found.found[0].pose == "8"
    assert found.tests.level == 0.05
    assert found.columns == ()


@pytest.mark.parametrize("wrong", [{"level": 0.0}, {"level": 1.0}, {"scale": "guess"}])
def test_a_rule_that_is_none_is_refused(wrong) -> None:
    with pytest.raises(InputError):
        lc.find_outliers(
            lc.calibrate(START, written(), noise=NOISE, method="implicit-loop"), **wrong
        )


def test_no_outlier_is_not_said_as_if_all_were_well_where_chi_squared_rejects() -> None:
    arm = planar_arm(60)
    sds = {"xP": 1e-4, "yP": 1e-4, "phi2": 1e-4, "phi3": 1e-4}
    few = {q: sd / 3 for q, sd in sds.items()}
    found = lc.find_outliers(
        lc.calibrate(arm.truth, arm.read(sds, 2), noise=lc.Noise(few), method="implicit-loop")
    )
    assert found.rejected is not None
    assert len(found) > 0 or "chi-squared rejects" in str(found)
    assert "outliers: none" not in str(found)


def test_sds_far_too_large_are_doubted_in_the_report_as_in_the_summary() -> None:
    arm = planar_arm(60)
    sds = {"xP": 1e-4, "yP": 1e-4, "phi2": 1e-4, "phi3": 1e-4}
    wide = {q: 1e3 * sd if q in ("xP", "yP") else sd for q, sd in sds.items()}
    result = lc.calibrate(arm.truth, arm.read(sds, 2), noise=lc.Noise(wide), method="implicit-loop")
    told = verdict_of(result.document)
    assert told.sound.code == "sds-too-large"
    assert told.grade == "bad"
    assert any("scatter less" in warning for warning in result.warnings)


def three_targets(names: str) -> lc.Mechanism:
    """A six-axis arm with so many targets on its tool, seen by one tracker."""
    seen = [
        point(n, readings=[f"{a}_{n}" for a in "xyz"], station="tracker", target=n) for n in names
    ]
    values = {n: v for n, v in ARM_VALUES.items() if not n.startswith("tool")}
    corners = np.random.default_rng(8).uniform(-0.15, 0.15, (len(names), 3))
    for name, corner in zip(names, corners, strict=True):
        values |= dict(zip((f"{name}_{a}" for a in "xyz"), corner.tolist(), strict=True))
    return assemble(six_axis(), seen, values)


@pytest.mark.parametrize("names", ["A", "AB", "ABC"])
def test_a_hit_target_is_told_from_wrong_joints_where_other_targets_can_tell(names: str) -> None:
    """With one target both may be to blame, and with two the joints: these fit six equations."""
    arm, noise = three_targets(names), lc.Noise({"q*": 2e-5, "[xyz]_*": 2e-5})
    rng = np.random.default_rng(3)
    hits, joints = (5, 11, 17), (8, 21, 30)
    moved = {i: rng.normal(0.0, 2e-3, 3) for i in hits}
    data = lc.simulate(arm, READINGS, noise=noise, seed=1).dataset
    readings = {q: v.copy() for q, v in data.readings.items()}
    for i in hits:
        for axis, size in zip("xyz", moved[i], strict=True):
            readings[f"{axis}_A"][i] += size
    for i in joints:
        for q in ("q2", "q3", "q5"):
            readings[q][i] += rng.normal(0.0, 3e-3)
    prior = lc.Prior({"*": 1e-3})
    result = lc.calibrate(arm, readings, noise=noise, prior=prior, method="implicit-loop")
    found = {int(o.pose) - 1: o for o in lc.find_outliers(result).found}
    assert sorted(found) == sorted((*hits, *joints))
    assert all(o.quantity is None for o in found.values())
    expected = {
        "A": (("A", "the joints"), ("A", "the joints")),
        "AB": (("A", "the joints"), ("the joints",)),
        "ABC": (("A",), ("the joints",)),
    }[names]
    assert {found[i].together for i in hits} == {expected[0]}
    assert {found[i].together for i in joints} == {expected[1]}
    if names == "ABC":
        for i in hits:
            assert found[i].size == pytest.approx(np.linalg.norm(moved[i]), abs=2e-4)
            assert "the point of 'A' is off by" in str(found[i])


def test_a_single_bad_reading_names_the_instrument_that_read_it() -> None:
    arm, noise = three_targets("AB"), lc.Noise({"q*": 2e-5, "[xyz]_*": 2e-5})
    data = lc.simulate(arm, READINGS, noise=noise, seed=1).dataset
    readings = {q: v.copy() for q, v in data.readings.items()}
    readings["y_B"][4] += 2e-3
    readings["q5"][9] += 2e-3
    prior = lc.Prior({"*": 1e-3})
    result = lc.calibrate(arm, readings, noise=noise, prior=prior, method="implicit-loop")
    found = {o.quantity: o.instrument for o in lc.find_outliers(result).found}
    assert found == {"y_B": "B", "q5": None}


def test_what_a_prior_holds_takes_up_no_equation() -> None:
    """The scale of residuals is that of the noise, however many parameters there are."""
    names = [f"c{k}" for k in range(30)]
    machine = lc.Mechanism.from_function(
        lambda x, p: [x.y - sum(getattr(p, n) * np.sin(k * x.q) for k, n in enumerate(names, 1))],
        {"q": "rad", "y": "m"},
        dict.fromkeys(names, (0.0, "m")),
        outputs=("y",),
    )
    rng, ratios = np.random.default_rng(4), []
    for _ in range(6):
        q = rng.uniform(0.0, np.pi, 60)
        data = {"q": q, "y": 1e-4 * rng.standard_normal(60)}
        noise, prior = lc.Noise({"q": 0.0, "y": 1e-4}), lc.Prior({"c?": np.inf, "c??": 1e-9})
        result = lc.calibrate(machine, data, noise=noise, prior=prior, method="implicit-loop")
        ratios.append(lc.find_outliers(result, scale="residual").scale)
    assert np.median(ratios) == pytest.approx(1.0, abs=0.15)
