"""What the method "auto" makes of a run in which something slipped, or a pose does not fit."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

import loopcal as lc
from loopcal.document.change_points import NOT_SEARCHED
from loopcal.execution.executor import Executor, InProcess
from loopcal.execution.forked import helping, process_cores
from loopcal.files.result import result_file
from loopcal.statistics import choice
from loopcal.statistics.case import Case, Entrant, entrants
from loopcal.statistics.changes import CERTAIN, NUMBER, Changes, changes, unchanged
from loopcal.statistics.choice import choose
from loopcal.statistics.continued import Ending, continued
from loopcal.statistics.findings import findings as statistics_findings
from loopcal.statistics.folds import Scheme
from loopcal.statistics.judged import Judged, fitted
from loopcal.statistics.outliers import find_poses
from loopcal.statistics.verdict import findings_of
from loopcal.workflow.checking import run_prediction
from tests.estimation.test_real_data import RIGHT, measured
from tests.reference.simulated import MA1400_RANGES
from tests.statistics.test_change_points import (
    ARM,
    NOISE,
    Array,
    Find,
    joined,
    joints,
    read,
    sagging,
)

FIT = lc.Fit(method="least-squares", model_error="structured")
SLIP = {"x6B": 3e-3, "z6B": -2e-3}
MA1400 = """joint,a_mm,d_mm,alpha_deg,offset_deg
S,150,1415.9,-90,0
L,614,0,180,-90
U,200,0,-90,0
R,0,-640,90,0
B,30,0,90,-90
T,0,200,0,0
"""


def regional(seed: int, regions: int = 6, poses: int = 20) -> dict[str, Array]:
    """Joints of an arm that is measured region by region."""
    rng = np.random.default_rng(seed)
    low, high = 0.6 * MA1400_RANGES.T
    near = 0.06 * (high - low)
    middles = rng.uniform(low, high, (regions, 6))
    values = np.concatenate([m + rng.normal(0.0, near, (poses, 6)) for m in middles])
    return {f"theta_{i}": values[:, i - 1] for i in range(1, 7)}


def slipped(seed: int = 3, poses: int = 48, at: int = 28, wrong: int = 12) -> lc.Dataset:
    """A target that slips, on an arm that sags, and one pose whose y is off by 20 mm."""
    where = joints(poses, seed)
    data = sagging(joined(read(where, seed), read(where, seed, SLIP), at))
    return data.with_readings({"y": data["y"] + 0.02 * (np.arange(poses) == wrong)})


def told(data: lc.Dataset) -> lc.Result:
    case = Case(ARM, data, None, lc.Fit(method="auto"))
    return lc.Result.of(choose(case, Scheme(folds=2, blocks=0)).result)


@pytest.fixture(scope="module")
def course() -> list[str]:
    """What is fitted to all poses, and where what happened during the run is sought, in order."""
    return []


@pytest.fixture(scope="module")
def result(course: list[str]) -> Iterator[lc.Result]:
    sought = changes

    def recorded(one: Entrant, *given: Any) -> Judged:
        course.append("structured" if one.structured else one.name)
        return fitted(one, *given)

    def recorded_changes(*given: Any) -> Changes:
        course.append("changes")
        return sought(*given)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(choice, "fitted", recorded)
        patch.setattr(choice, "changes", recorded_changes)
        patch.setenv("LOOPCAL_THREADS", "1")  # what a forked copy does is not seen here
        yield told(slipped())


def test_plain_candidates_are_fitted_once_after_the_changes_are_known(
    result: lc.Result, course: list[str]
) -> None:
    assert result.chosen is not None
    sought = course.index("changes")
    plain = [name for name in course[sought + 1 :] if name != "structured"]
    assert set(course[:sought]) == {"structured"}
    assert "nominal" in plain
    assert len(set(plain)) == len(plain)


def test_a_slip_is_modelled_and_an_outlier_discarded_and_both_are_said(result: lc.Result) -> None:
    document = result.document
    assert document.change_points is not None
    (point,) = document.change_points.found
    assert point.modelled
    assert abs(point.number - 29) <= 1
    assert document.data.discarded == ("13",)
    assert (document.data.poses, document.data.used) == (48, 47)
    assert [o.pose for o in document.outliers or ()] == ["13"]
    text = " ".join(str(result).split())
    for words in (
        f"from pose {point.pose} on",
        "without the outlier 13",
    ):
        assert words in text
    (modelled,) = (one for one in findings_of(document) if one.code == "changes-modelled")
    assert modelled.title.startswith("The fit models what changed along the run: from pose")
    assert "[[mechanism.effect]]" in document.change_points.toml
    assert document.accuracy is not None
    assert document.accuracy.after.rms < 3e-4
    assert document.validation is not None
    assert document.validation.accuracy is not None
    assert document.validation.accuracy.rms < 4e-4


def test_without_outliers_a_fit_begins_where_the_one_before_it_ended(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    begun = list[bool]()
    calibrated = Case.calibrated

    def recorded(self: Case, *given: Any, **options: Any) -> lc.FitResult:
        begun.append(self.begin is not None)
        return calibrated(self, *given, **options)

    case = Case(ARM, slipped(), None, lc.Fit(method="auto"))
    (one,) = (e for e in entrants(case) if e.structured and e.case.fit.method.exact)
    whole = one.case.calibrated()
    monkeypatch.setattr(Case, "calibrated", recorded)
    what = changes(case, one.case.fit, whole)
    assert (len(what.points), [*what.outliers]) == (1, ["13"])
    # with the slip as asked for, and then without the outlier
    assert begun == [False, True]


@pytest.mark.parametrize(
    ("data", "first"),
    [
        (slipped(), ["happened", "outliers sought"]),
        (sagging(read(joints(48, 3), 3)), ["outliers sought"]),
    ],
)
def test_what_certainly_happened_is_told_before_outliers_are_sought(
    data: lc.Dataset, first: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    course = list[str]()

    def sought(whole: lc.FitResult) -> Any:
        course.append("outliers sought")
        return find_poses(whole)

    monkeypatch.setattr("loopcal.statistics.changes.find_poses", sought)
    case = Case(ARM, data, None, lc.Fit(method="auto"))
    (one,) = (e for e in entrants(case) if e.structured and e.case.fit.method.exact)
    changes(case, one.case.fit, one.case.calibrated(), happened=partial(course.append, "happened"))
    assert course[:2] == first


@pytest.mark.parametrize("cores", ["1", "2"])
def test_where_nothing_is_an_outlier_no_other_fit_has_to_name_it(
    cores: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = Case(ARM, slipped(), NOISE, lc.Fit(method="auto"))
    (one,) = (e for e in entrants(case) if e.structured and e.case.fit.method.exact)
    module = "loopcal.statistics.changes"
    monkeypatch.setenv("LOOPCAL_THREADS", cores)
    monkeypatch.setattr(f"{module}._certain", lambda _: {})

    def waiting(*_: Any) -> set[str]:
        assert helping(), "where one core is free, nothing is done in advance"
        time.sleep(60.0)
        raise AssertionError("nobody waits for it")

    monkeypatch.setattr(f"{module}._named_carefully", waiting)
    what = changes(case, one.case.fit, one.case.calibrated())
    assert (len(what.points), [*what.outliers]) == (1, [])


@pytest.mark.parametrize("poses", [20, 48])
def test_an_outlier_alone_is_left_out_of_the_fit_as_well(poses: int) -> None:
    data = sagging(read(joints(poses, 4), 4))
    bent = data.with_readings({"y": data["y"] + 0.02 * (np.arange(poses) == 12)})
    document, whole = told(bent).document, told(data).document
    assert document.change_points is not None
    assert document.change_points.found == ()
    assert document.data.discarded == ("13",)
    assert whole.data.discarded == ()
    (finding,) = (one for one in findings_of(document) if one.code == "outliers")
    assert finding.words == "1 pose does not fit the others (13; left out of the fit)."
    assert document.validation is not None
    assert document.validation.accuracy is not None
    assert whole.validation is not None
    assert whole.validation.accuracy is not None
    assert document.validation.accuracy.rms < 1.3 * whole.validation.accuracy.rms


@pytest.mark.parametrize("wrong", [12, 30, 42])
def test_gross_errors_are_left_out_up_to_three_tenths(wrong: int) -> None:
    """The fit was spoilt where they were more than a tenth, and the run searched by it."""
    rng = np.random.default_rng(wrong)
    data = sagging(read(joints(150, 4), 4))
    rows = np.sort(rng.choice(150, wrong, replace=False))
    y = data["y"].copy()
    y[rows] += rng.choice([-1.0, 1.0], wrong) * rng.uniform(2e-3, 2e-2, wrong)
    document, whole = (told(one).document for one in (data.with_readings({"y": y}), data))
    assert document.data.discarded == tuple(data.poses[i] for i in rows)
    assert document.validation is not None
    assert document.validation.accuracy is not None
    assert whole.validation is not None
    assert whole.validation.accuracy is not None
    assert document.validation.accuracy.rms < 1.2 * whole.validation.accuracy.rms


@pytest.mark.parametrize(
    ("every", "off"),
    [(range(0, 48, 5), 1e-4), (range(20, 30), 2e-2)],
    ids=["of few sds", "one after the other"],
)
def test_a_fifth_of_other_poses_is_kept(every: range, off: float) -> None:
    """The machine model or a slip may be at fault."""
    data = sagging(read(joints(48, 4), 4))
    bent = data.with_readings({"y": data["y"] + off * np.isin(np.arange(48), every)})
    assert told(bent).document.data.discarded == ()


def test_what_the_chosen_fit_alone_shows_is_modelled(monkeypatch: pytest.MonkeyPatch) -> None:
    levels = []

    def late(case: Case, way: lc.Fit, whole: Any, level: float, *told: Any) -> Changes:
        levels.append(level)
        return changes(case, way, whole, level, *told) if len(levels) > 1 else unchanged(case)

    monkeypatch.setattr(choice, "changes", late)
    monkeypatch.setenv("LOOPCAL_THREADS", "1")  # what a forked copy does is not seen here
    result = told(slipped())
    assert levels == [CERTAIN, 0.01]
    assert result.document.change_points is not None
    (point,) = result.document.change_points.found
    assert point.modelled
    assert abs(point.number - 29) <= 1
    assert result.document.accuracy is not None
    assert result.document.accuracy.after.rms < 3e-4


def test_a_run_in_which_nothing_happened_is_searched_once(monkeypatch: pytest.MonkeyPatch) -> None:
    where = joints(48, 3)
    case = Case(ARM, sagging(read(where, 3)), None, lc.Fit(method="auto"))
    result = choose(case, Scheme(folds=2, blocks=0)).result
    monkeypatch.delattr("loopcal.statistics.findings.find_shifts")
    assert not statistics_findings(result).shifts.found


def test_changes_are_sought_where_all_free_cores_serve(monkeypatch: pytest.MonkeyPatch) -> None:
    by: list[Executor] = []

    def recorded(*given: Any) -> Changes:
        by.append(process_cores())
        return changes(*given)

    monkeypatch.setattr(choice, "changes", recorded)
    monkeypatch.setenv("LOOPCAL_THREADS", "2")
    told(sagging(read(joints(24, 3), 3)))
    assert by
    assert not any(isinstance(one, InProcess) for one in by)  # one of several that share them


@pytest.fixture(scope="module")
def findings(result: lc.Result) -> lc.Findings:
    return lc.findings(result)


def test_predictions_hold_after_the_last_change(
    result: lc.Result, findings: lc.Findings, tmp_path: Path
) -> None:
    where = joints(40, 11)
    now = sagging(read(where, 11, SLIP))
    found = lc.predict(result, lc.Dataset.from_arrays(where))
    gaps = np.array([found.outputs[q] - now[q] for q in "xyz"])
    assert np.sqrt(np.square(gaps).sum(axis=0).mean()) < 1e-3
    before = np.full(40, 1.0)
    past = lc.predict(result, lc.Dataset.from_arrays({**where, NUMBER: before}))
    moved = np.array([past.outputs[q] - found.outputs[q] for q in "xyz"])
    size = float(np.linalg.norm(list(SLIP.values())))
    assert np.linalg.norm(moved, axis=0).mean() == pytest.approx(size, rel=0.2)
    result_file.write_result(result, result.document, tmp_path)
    lines = [",".join(["pose", *where])]
    lines += [
        f"{i}," + ",".join(map(repr, row))
        for i, row in enumerate(zip(*_lists(where), strict=True), 1)
    ]
    (tmp_path / "new.csv").write_text("\n".join(lines) + "\n")
    again = run_prediction(tmp_path, tmp_path / "new.csv", out=None)
    for q in "xyz":
        np.testing.assert_allclose(again.outputs[q], found.outputs[q], atol=1e-12)


def _lists(values: dict[str, Array]) -> list[list[float]]:
    return [column.tolist() for column in values.values()]


def test_findings_keep_what_was_modelled_and_name_it_once(
    result: lc.Result, findings: lc.Findings
) -> None:
    assert [p.modelled for p in findings.shifts.found] == [True]
    assert [o.pose for o in findings.outliers.found] == ["13"]
    document = result.document
    assert [one.code for one in findings_of(document)].count("changes-modelled") == 1
    assert not any("along the run" in words for words in document.warnings)


def carrying(where: dict[str, Array], seed: int, times: float) -> lc.Dataset:
    """An arm that gives way under its tool, of so many times its weight."""
    arm = lc.structured(ARM, harmonics=False)
    gives = {"theta_2_sag_y_tool": 1e-3, "theta_3_sag_y_tool": 4e-4, "theta_2_sag_x_tool": 2e-4}
    truth = {p.name: p.nominal + times * gives.get(p.name, 0.0) for p in arm.parameters}
    return lc.simulate(arm, where, noise=NOISE, seed=seed, truth=truth).dataset


@pytest.fixture(scope="module")
def heavier() -> lc.Result:
    where = joints(60, 3)
    return told(joined(carrying(where, 3, 1.0), carrying(where, 3, 2.0), 34))


def test_another_load_is_modelled_and_predictions_hold_under_it(
    heavier: lc.Result, tmp_path: Path
) -> None:
    assert heavier.document.change_points is not None
    (point,) = heavier.document.change_points.found
    assert (point.moved, point.modelled, point.changing) == ("load", True, ("load",))
    assert abs(point.number - 35) <= 1
    sizes = {f"{name}_from{point.number}": one.size for name, one in point.changes.items()}
    assert sizes == {name: heavier.value[name] for name in sizes}
    answer = lc.verdict(heavier).answers["sound"]
    assert (answer.passed, answer.code) == (None, "changes-modelled")
    assert 'changing = ["load"]' in heavier.document.change_points.toml
    where, now = joints(40, 11), lc.Dataset.from_arrays(joints(40, 11))
    predicted = lc.predict(heavier, now)
    true = carrying(where, 11, 2.0)
    errors = np.array([predicted.outputs[q] - true[q] for q in "xyz"])
    stated = np.array([predicted.sd[q] for q in "xyz"])
    assert 0.5 < np.sqrt(np.mean(errors**2)) / np.sqrt(np.mean(stated**2)) < 1.5
    result_file.write_result(heavier, heavier.document, tmp_path)
    again = lc.read_mechanism(tmp_path / "mechanism.toml")
    assert again.latest == {NUMBER: float(point.pose)}
    assert again.terms == heavier.mechanism.terms


@pytest.mark.parametrize("stated", [False, True])
def test_a_fit_goes_on_with_another_load(heavier: lc.Result, stated: bool) -> None:
    where, changes_told = joints(60, 3), heavier.document.change_points
    data = joined(carrying(where, 3, 1.0), carrying(where, 3, 2.0), 34)
    assert changes_told is not None
    again = lc.with_shifts(ARM, data, changes_told.found)
    case = Case(again.mechanism, again.data, None, lc.Fit(method="auto"))
    if not stated:
        case = Case(ARM, data, None, lc.Fit(method="auto"))
    found = continued(case, Ending.of(heavier.document, data.poses))
    assert found.mechanism.terms == heavier.mechanism.terms
    for name in found.value:
        sd = heavier.sd[name] or 0.0
        assert found.value[name] == pytest.approx(heavier.value[name], abs=0.1 * sd + 1e-12)


def test_another_load_is_no_change_that_a_plain_machine_models(heavier: lc.Result) -> None:
    case = Case(ARM, read(joints(30, 1), 1), None, FIT)
    assert heavier.document.change_points is not None
    points = heavier.document.change_points.found
    made = replace(unchanged(case), points=points, searched=NOT_SEARCHED)
    effect = lc.effects.Shift(("load",), (11.0,), "number")
    for mechanism, modelled in ((heavier.mechanism, True), (lc.with_effects(ARM, [effect]), False)):
        entry = made.entry(mechanism)
        assert entry is not None
        assert [p.modelled for p in entry.found] == [modelled]


@pytest.mark.parametrize("sag", [1e-3, 3e-3])
def test_a_sagging_arm_measured_region_by_region_has_no_certain_change(sag: float) -> None:
    for seed in range(2):
        case = Case(ARM, sagging(read(regional(seed), seed), sag), None, FIT)
        assert changes(case, case.fit, case.calibrated()).points == ()


def test_a_calibration_needs_the_column_that_dates_its_changes() -> None:
    data = read(joints(30, 1), 1)
    effect = lc.effects.Shift(("x6B",), (11.0,), "number")
    machine = lc.with_effects(ARM, [effect])
    assert machine.latest == {"number": 11.0}
    with pytest.raises(lc.InputError, match="known constant 'number' is missing"):
        lc.calibrate(machine, data, method="least-squares")


ZERO = -5.3e-3
"""Of all distances of the tracker to the reflector, which both arms of the Motoman show."""


def test_the_other_arm_has_the_same_wrong_constant_of_the_reflector(
    shared_data: Find, tmp_path: Path
) -> None:
    """Its drawing, placed, misses the readings least where they are longer by what the workspace of
    the first arm says."""
    path = shared_data("motoman_ma1400_leica/left_arm_grid.csv")
    (tmp_path / "dh.csv").write_text(MA1400)
    columns = pl.read_csv(path)
    points = columns.select("x", "y", "z").to_numpy()
    away = np.linalg.norm(points, axis=1, keepdims=True)

    def missed(zero: float) -> float:
        corrected = points * (1.0 - zero / away)
        read = {f"{a}_m": corrected[:, i] for i, a in enumerate("xyz")}
        joints = {f"{j}_rad": columns[j].to_numpy() for j in "SLURBT"}
        return float(lc.init({**joints, **read}, dh=tmp_path / "dh.csv").rms)

    as_read, as_found, twice = map(missed, (0.0, ZERO, 2.0 * ZERO))
    assert as_found < 0.75 * as_read
    assert as_found < 0.75 * twice


def test_the_workspace_set_is_calibrated_as_if_its_slips_were_known(shared_data: Find) -> None:
    data = measured(shared_data("motoman_ma1400_leica/right_arm_workspace.csv"))
    document = lc.calibrate(lc.motoman_ma1400(RIGHT), data, method="auto").document
    assert document.change_points is not None
    numbers = [int(p.pose) for p in document.change_points.found if p.modelled]
    for pose in (14, 86, 170):
        assert any(abs(number - pose) <= 4 for number in numbers)
    assert "13" in document.data.discarded
    zero = next(one for one in document.scales or () if one.unit == "m")
    assert zero.size == pytest.approx(ZERO, abs=4e-4)
    assert zero.p_value < 1e-9
    validation = document.validation
    assert validation is not None
    assert validation.blocked is not None
    assert validation.accuracy is not None
    assert validation.blocked.accuracy is not None
    assert validation.accuracy.rms <= 0.22e-3
    assert validation.blocked.accuracy.rms <= 0.40e-3


def wandering(order: str, seed: int = 5, size: float = 1.5e-3) -> lc.Dataset:
    """A sagging arm whose instrument drifts in z, so far over the run, in this order of poses."""
    where = joints(60, seed)
    if order == "sweep":
        along = np.argsort(where["theta_1"])
        where = {q: values[along] for q, values in where.items()}
    data = sagging(read(where, seed))
    return data.with_readings({"z": data["z"] + np.linspace(0.0, size, 60)})


def test_a_drift_of_the_instrument_is_modelled_and_predictions_hold_for_the_end(
    tmp_path: Path,
) -> None:
    result = told(wandering("random"))
    assert result.document.change_points is not None
    (point,) = result.document.change_points.found
    assert (point.shape, point.modelled, point.moved) == ("ramp", True, "reading")
    assert (point.imitated, point.bends) == (False, 0)
    assert point.changes["z"].size == pytest.approx(1.5e-3, rel=0.15)
    assert result.mechanism.latest == {NUMBER: 60.0}
    answer = lc.verdict(result).answers["sound"]
    assert (answer.passed, answer.code) == (None, "changes-modelled")
    assert "all along poses 1 to 60" in answer.words
    assert "Predictions hold for the end of the run." in answer.words
    where = joints(40, 11)
    found = lc.predict(result, lc.Dataset.from_arrays(where)).outputs
    first = {**where, NUMBER: np.full(40, 1.0)}
    begun = lc.predict(result, lc.Dataset.from_arrays(first)).outputs
    assert float(np.mean(found["z"] - begun["z"])) == pytest.approx(1.5e-3, rel=0.15)
    result_file.write_result(result, result.document, tmp_path)
    assert lc.read_mechanism(tmp_path / "mechanism.toml").latest == {NUMBER: 60.0}


def warming(where: dict[str, Array], seed: int, growth: float) -> lc.Dataset:
    """A sagging arm whose lengths grow in proportion, so far over the run."""
    lengths = [p for p in ARM.parameters if p.dimension == "length"]
    cold, warm = (read(where, seed, {p.name: g * p.nominal for p in lengths}) for g in (0, growth))
    share = np.linspace(0.0, 1.0, len(cold))
    moved = {q: cold[q] + share * (warm[q] - cold[q]) for q in "xyz"}
    return sagging(cold.with_readings(moved))


def test_a_machine_that_warms_up_is_no_drifting_instrument_and_predictions_hold_for_its_end() -> (
    None
):
    where, growth = joints(60, 5), 6e-4
    result = told(warming(where, 5, growth))
    assert result.document.change_points is not None
    (one,) = result.document.change_points.found
    assert (one.shape, one.modelled, one.moved) == ("ramp", True, "expansion")
    assert one.changes["the scale of the machine"].size == pytest.approx(growth, rel=0.2)
    assert result.value["lengths_drift"] == pytest.approx(growth, rel=0.2)
    assert 'changing = ["lengths"]' in result.document.change_points.toml
    fresh = joints(40, 11)
    lengths = [p for p in ARM.parameters if p.dimension == "length"]
    cold, warm = (
        sagging(read(fresh, 12, {p.name: g * p.nominal for p in lengths})) for g in (0.0, growth)
    )
    now = lc.predict(result, lc.Dataset.from_arrays(fresh)).outputs
    off = [np.sqrt(np.mean([np.square(now[q] - true[q]) for q in "xyz"])) for true in (warm, cold)]
    assert off[0] < 0.5 * off[1]


def test_a_warm_up_is_modelled_as_a_curve() -> None:
    data = wandering("random", size=0.0)
    result = told(data.with_readings({"z": data["z"] + 1.2e-3 * -np.expm1(-np.arange(60) / 12.0)}))
    assert result.document.change_points is not None
    (point,) = result.document.change_points.found
    assert (point.shape, point.moved, point.bends) == ("ramp", "reading", 4)
    assert point.changes["z"].size == pytest.approx(1.2e-3, rel=0.15)
    assert "bends = 4" in result.document.change_points.toml
    assert "drifted along a curve" in str(point)
    assert "z_drift4" in result.mechanism.parameters.names


def test_a_drift_that_the_joints_imitate_is_not_modelled() -> None:
    case = Case(ARM, wandering("sweep"), None, FIT)
    whole = case.calibrated()
    assert changes(case, case.fit, whole).points == ()
    ramps = [point for point in lc.find_shifts(whole).found if point.shape == "ramp"]
    assert ramps
    assert all(point.imitated for point in ramps)


def test_a_target_that_seems_to_drift_is_not_modelled() -> None:
    where = joints(60, 5)
    slow, fast = read(where, 5), read(where, 5, {"x6B": 3e-3})
    share = np.linspace(0.0, 1.0, 60)
    moved = {q: slow[q] + share * (fast[q] - slow[q]) for q in "xyz"}
    case = Case(ARM, sagging(slow.with_readings(moved)), None, FIT)
    whole = case.calibrated()
    assert [(p.shape, p.moved) for p in lc.find_shifts(whole).found] == [("ramp", "target")]
    assert changes(case, case.fit, whole).points == ()


def along_a_path(seed: int, poses: int = 120) -> dict[str, Array]:
    """Joints that go to and fro, each at its own pace."""
    rng = np.random.default_rng(seed)
    phase = 2.0 * np.pi * rng.uniform(2.0, 5.0, 6) * np.linspace(0.0, 1.0, poses)[:, None]
    swing = 0.3 * np.ptp(MA1400_RANGES, axis=1) * np.sin(phase + rng.uniform(0.0, 6.0, 6))
    values = 0.6 * MA1400_RANGES.mean(axis=1) + swing
    return {f"theta_{i}": values[:, i - 1] for i in range(1, 7)}


@pytest.mark.parametrize("seed", range(4))
def test_along_a_path_only_an_edge_sharper_than_the_path_is_told_from_the_machine(
    seed: int,
) -> None:
    where = along_a_path(seed)
    whole = read(where, seed)
    bent = lc.calibrate(ARM, sagging(whole, 3e-3), method="least-squares")
    found = lc.find_shifts(bent)
    assert found.found  # the machine itself looks like changes
    assert not found.told_apart
    data = sagging(joined(whole, read(where, seed, SLIP), 60), 3e-3)
    found = lc.find_shifts(lc.calibrate(ARM, data, method="least-squares"))
    assert [point.number for point in found.told_apart] == [61]
