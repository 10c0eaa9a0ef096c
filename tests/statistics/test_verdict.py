"""The verdict: every finding has its answer, a small region is named, clean data stay green."""

from __future__ import annotations

import math
import re
import shlex
from dataclasses import fields, replace
from functools import cache
from pathlib import Path
from string import Formatter
from typing import Any

import numpy as np
import pytest
from typer.main import get_command

import loopcal as lc
from analyses.gauntlet_worlds import Parallel
from loopcal.cli.application import app
from loopcal.cli.registry import COMMANDS, loaded
from loopcal.document.accuracy import Coverage, PixelSize
from loopcal.document.catalogue import CATALOGUE
from loopcal.document.change_points import (
    Change,
    ChangePoint,
    ChangePoints,
    Dependence,
    InstrumentDependence,
    Likeness,
)
from loopcal.document.choice import Candidate, Chosen, TermEntry, TermPart
from loopcal.document.findings import (
    CheckEntry,
    ColumnFault,
    ConflictEntry,
    DelayEntry,
    HalvesEntry,
    LensErrorEntry,
    OtherOptimum,
    Outlier,
    RepeatsEntry,
    ScaleEntry,
    Undetermined,
)
from loopcal.document.fit import ChiSquared, ParameterEntry
from loopcal.document.result_document import UPDATED, CoarseReadings, ResultDocument
from loopcal.document.verdict import UNASKED, Fact, Figure, Finding, Named, Row, Where
from loopcal.mechanisms.limits import joint_limits
from loopcal.mechanisms.parameters import Role, labels_of
from loopcal.mechanisms.structure.structured import GRAVITY_TILT
from loopcal.presentation.shown import WIDTH
from loopcal.statistics.judged_machine import off_the_drawing
from loopcal.statistics.predictor import predictor
from loopcal.statistics.region import region_of
from loopcal.statistics.verdict import findings_of, judged
from tests.conftest import ROOT
from tests.reference.machines import dh_arm
from tests.reference.simulated import arm_at, planar_arm
from tests.reference.verdicts import verdict_of

SDS = {"xP": 1e-4, "yP": 1e-4, "phi2": 1e-3, "phi3": 1e-3}


@cache
def clean() -> ResultDocument:
    """A planar arm 2 mm off its drawing, validated."""
    arm = planar_arm(60)
    off, noise = arm.off(2e-3, 2e-3, seed=3), lc.Noise(SDS)
    data = arm.read(SDS, 1)
    result = lc.calibrate(off, data, noise=noise, start="nominal", method="implicit-loop")
    validation = lc.validate(
        off, data, noise=noise, full=result, folds=5, start="nominal", method="implicit-loop"
    )
    return lc.Result.of(result, validation=validation.entry).document


def changed(value: Any, path: str, new: Any) -> Any:
    name, _, rest = path.partition(".")
    return replace(value, **{name: changed(getattr(value, name), rest, new) if rest else new})


def at_fault(code: str) -> ResultDocument:
    """The clean document with what leads to this finding."""
    path, value, _ = FINDINGS[code]
    # least squares is tested where it predicted poses not used
    begun = changed(clean(), "validation", None) if code == "untested" else clean()
    if code == "overfitted":  # stated regions contain what few poses leave open
        begun = changed(clean(), "validation.coverage", None)
    if code == "scale-since":
        begun = changed(clean(), "method_label", UPDATED)
    return changed(begun, path, value)


def likeness(p: float) -> Likeness:
    return Likeness(0.8, p)


def depends(serial: float, spatial: float) -> Dependence:
    return Dependence((InstrumentDependence("T", likeness(serial), likeness(spatial)),), 0.01)


OUTLIER = Outlier("17", None, 30.0, 1e-6, 30.0, None, None)
SLIP = ChangePoint("step", "86", "85", 86, "target", {"x6B": Change(5e-4, 1e-5, "m")}, 900.0, 1e-9)
SAG = TermEntry("sag", "rad/m", 9e-4, None, 5e-4, 4, 3.0, 40.0, "joints give way by 0.9 mrad/m")
FINDINGS: dict[str, tuple[str, Any, bool | None]] = {
    "column-fault": ("column_faults", (ColumnFault(("xP",), "xP is in mm", 1.0, 0.0),), False),
    "not-converged": ("status.converged", False, False),
    "sds-too-small": ("chi_squared", ChiSquared.of(400.0, 114), False),
    "sds-too-large": ("chi_squared", ChiSquared.of(11.0, 114), False),
    "sds-generous": ("chi_squared", ChiSquared.of(57.0, 114), None),
    "repeats-share-error": ("repeats", RepeatsEntry(50, 2.4, 1e-9), None),
    "halves-disagree": ("halves", (HalvesEntry("eye_f", "px", 671.0, 734.0, 3.4, None),), False),
    "poses-delayed": ("delay", DelayEntry(True, 0.02, 1e-3, 1e-9), False),
    "change-points": ("change_points", ChangePoints((SLIP,), 0.01, 120, ""), False),
    "changes-modelled": (
        "change_points",
        ChangePoints((replace(SLIP, modelled=True),), 0.01, 120, ""),
        None,
    ),
    "scales-unlike": ("scales", (ScaleEntry(("point_2",), 1e-4, 1e-5, 1e-9, 1e-3),), None),
    "scale-off-the-drawing": ("scales", (ScaleEntry((), 1e-4, 1e-5, 1e-9, 1e-3),), None),
    "scale-since": ("scales", (ScaleEntry((), 1e-4, 1e-5, 1e-9, 1e-3),), None),
    "update-mixed": ("check", CheckEntry(False, "tool moved."), False),
    "update-moved": ("check", CheckEntry(None, "Something may have moved."), None),
    "joint-scale": ("scales", (ScaleEntry((), 2e-3, 1e-4, 1e-9, 1e-3, joint="q4"),), None),
    "range-zero": ("scales", (ScaleEntry(("point",), 2e-3, 1e-4, 1e-9, 1e-3, "m"),), None),
    "observations-conflict": ("conflicts", (ConflictEntry("x", 6e-3, 1e-3, "m", 1e-9),), None),
    "sds-not-converged": ("sds_settled", False, None),
    "mounting-unstated": ("mechanism.unstated", (("x6B", "y6B", "z6B"),), None),
    "model-incomplete": ("dependence", depends(1.0, 1e-9), False),
    "serial-dependence": ("dependence", depends(1e-9, 1.0), None),
    "errors-shared": ("dependence", Dependence((), 1e-3, shared=likeness(1e-9)), None),
    "regions-too-small": ("validation.coverage", Coverage(0.95, 0.6, 60), False),
    "overfitted": ("accuracy.after.rms", 1e-4, None),
    "outliers": ("outliers", (OUTLIER,), None),
    "readings-coarse": ("data.coarse", (CoarseReadings(("phi2",), "rad", 1.7e-3, 5e-4),), None),
    "other-optimum": (
        "other_optima",
        (OtherOptimum({"l2": 0.6}, 250.0, "another optimum: l2 600 mm"),),
        None,
    ),
    "not-identifiable": (
        "identifiability.not_identifiable",
        (Undetermined({"l2": 1.0}, "l2"),),
        None,
    ),
    "untested": ("noise", (), None),
}


def test_clean_data_are_sound_valid_and_better_than_the_drawing() -> None:
    found = verdict_of(clean())
    assert [a.passed for a in found.answers.values()] == [True, True, True, None]
    assert found.tolerance.code == "no-tolerance"
    assert found.grade == "good"
    assert found.headline.startswith("Sound")


@pytest.mark.parametrize("code", FINDINGS)
def test_every_finding_has_its_answer(code: str) -> None:
    passed = FINDINGS[code][2]
    found = verdict_of(at_fault(code))
    assert found.sound.code == code
    assert found.sound.passed is passed
    assert found.sound.next
    assert found.grade == ("bad" if passed is False else "care")


def test_a_focal_length_that_images_hardly_show_leaves_the_result_open() -> None:
    def found(sd: float) -> dict[str, Any]:
        focal = replace(unsaid(), name="eye_f", unit="px", value=1400.0, sd=sd)
        every = findings_of(replace(clean(), parameters=(*clean().parameters, focal)))
        return {one.code: one for one in every}

    assert "focal-length-unsure" not in found(69.0)
    assert "eye_f is 1400 px ± 71 px" in found(71.0)["focal-length-unsure"].words


def test_a_smooth_error_that_the_images_show_is_named_and_stays_sound() -> None:
    def found(gain: float) -> ResultDocument:
        return replace(clean(), lens_errors=(LensErrorEntry("eye", 0.3, gain),))

    assert "lens-leaves-error" not in [one.code for one in findings_of(found(9.0))]
    named = {one.code: one for one in findings_of(found(11.0))}["lens-leaves-error"]
    assert "0.30 px" in named.words
    assert "eye" in named.words
    assert verdict_of(found(11.0)).sound.passed


def unsaid() -> ParameterEntry:
    """A parameter of which nothing says what it is."""
    return replace(clean().parameters[0], meaning="")


def scaled(value: float, sd: float, prior_sd: float) -> dict[str, Any]:
    """Findings of images that show a print of another size, by code."""
    one = replace(unsaid(), name="board_scale", unit="1", role="print", fixed=False, nominal=0.0)
    one = replace(one, value=value, sd=sd, prior_sd=prior_sd)
    accuracy = clean().accuracy
    assert accuracy is not None
    (point,) = accuracy.by
    assert point.position is not None
    images = replace(point, position=replace(point.position, unit="px"))
    document = replace(clean(), parameters=(*clean().parameters, one))
    document = replace(document, accuracy=replace(accuracy, by=(images,)))
    assert verdict_of(document).sound.passed
    return {found.code: found for found in findings_of(document)}


def test_robot_and_board_that_state_lengths_otherwise_are_told() -> None:
    assert "scale-decided" not in scaled(0.0025, 0.0009, 0.01)
    robot = scaled(0.0058, 0.0009, 0.01)["scale-decided"]
    assert "board_scale is 0.58 % ± 0.090 % if the robot is as stated" in robot.words
    assert "the robot is stated 0.58 % too long" in robot.words
    # weighed means of 0 and d
    b, r, d = 5e-4, 1e-3, 6e-3
    share = r**2 / (b**2 + r**2)
    board = scaled(d * (1.0 - share), b * math.sqrt(share), b)["scale-decided"]
    assert "the board is stated 0.60 % too short" in board.words
    assert board.numbers["sds"].value == pytest.approx(d / math.hypot(b, r))


def test_repeats_that_count_once_are_told_and_stay_sound() -> None:
    data = replace(clean().data, averaged=("2", "3"))
    named = {one.code: one for one in findings_of(replace(clean(), data=data))}
    assert named["repeats-averaged"].words.startswith("2 rows repeat an earlier pose")
    assert verdict_of(replace(clean(), data=data)).sound.passed
    assert "repeats-averaged" not in [one.code for one in findings_of(clean())]


def test_halves_of_the_images_may_differ_by_three_sds_in_the_focal_length() -> None:
    def codes(*halves: HalvesEntry) -> list[str]:
        return [one.code for one in findings_of(replace(clean(), halves=halves))]

    near, far = (HalvesEntry("eye_f", "px", 700.0, 700.0 + d, 10.0, None) for d in (29.9, 30.1))
    assert "halves-disagree" not in codes(near)
    assert "halves-disagree" in codes(far)
    # With few degrees of freedom the sd itself is not known.
    assert "halves-disagree" not in codes(replace(far, degrees_of_freedom=10.0))
    # The other parameters share the level.
    rest = [HalvesEntry(f"eye_k{i}", "1", 0.0, d, 1.0, None) for i, d in enumerate((3.5, 0.0, 0.0))]
    assert "halves-disagree" in codes(rest[0])
    assert "halves-disagree" in codes(near, *rest)
    assert "halves-disagree" not in codes(near, replace(rest[0], second=3.2), *rest[1:])


@pytest.mark.parametrize(("share", "code"), [(0.4, "changes-small"), (0.6, "change-points")])
def test_a_change_counts_by_its_size_beside_the_predicted_sd(share: float, code: str) -> None:
    """Not by its p-value, which falls with the number of poses."""
    document = clean()
    assert document.prediction is not None
    assert document.prediction.region is not None
    stated = document.prediction.region.worst
    assert stated.sd_at_poses is not None
    little = replace(SLIP, moves=share * stated.sd_at_poses, unit=stated.unit)
    found = verdict_of(replace(document, change_points=ChangePoints((little,), 0.01, 120))).sound
    assert (found.code, found.passed) == (code, None if code == "changes-small" else False)
    assert "from pose 86 on" in found.words
    # one that is large decides, and so does one whose size is unknown
    for other in (replace(little, moves=stated.sd_at_poses), replace(little, moves=None)):
        both = ChangePoints((little, other), 0.01, 120)
        assert verdict_of(replace(document, change_points=both)).sound.code == "change-points"


@pytest.mark.parametrize(
    ("share", "held", "terms", "code"),
    [
        (0.1, 0.93, (SAG,), "model-lacks-little"),
        (0.3, 0.93, (SAG,), "model-incomplete"),
        (0.1, 0.6, (SAG,), "model-incomplete"),
        (0.1, None, (SAG,), "model-incomplete"),
        (0.1, 0.93, (), "model-incomplete"),
    ],
)
def test_a_lack_of_the_model_counts_by_its_size_where_its_regions_hold(
    share: float, held: float | None, terms: tuple[TermEntry, ...], code: str
) -> None:
    """On poses not used: single ones, and whole regions of the joint space."""
    document = clean()
    assert document.validation is not None
    assert document.validation.coverage is not None
    whole = None if held is None else Coverage(0.95, held, 120)
    blocked = replace(document.validation, coverage=whole, blocked=None)
    alike = replace(likeness(1e-9), correlation=share)
    alike_near = replace(
        document,
        terms=terms,
        validation=replace(document.validation, blocked=blocked),
        dependence=Dependence((InstrumentDependence("T", likeness(1.0), alike),), 0.01),
    )
    found = verdict_of(alike_near).sound
    assert (found.code, found.passed) == (code, None if code == "model-lacks-little" else False)
    if not terms and held is not None:  # of images no terms are learnt
        seen = changed(alike_near, "accuracy.pixels", (PixelSize("eye", 4e-4),))
        assert verdict_of(seen).sound.code == "model-lacks-little"
    # nobody is sent to learn terms that are learnt
    assert ("structured model error" in (found.next or "")) == (not terms)


def test_a_prior_that_the_data_contradict_is_named() -> None:
    document = clean()
    entry = document.parameters[2]
    assert entry.sd is not None
    tense = replace(entry, prior_sd=5 * entry.sd, value=entry.nominal + 40 * entry.sd)
    parameters = (*document.parameters[:2], tense, *document.parameters[3:])
    found = verdict_of(replace(document, parameters=parameters))
    assert found.sound.code == "prior-tension"
    assert entry.name in found.sound.words
    # as far off as the prior allows
    usual = replace(tense, value=entry.nominal + 5 * entry.sd)
    parameters = (*document.parameters[:2], usual, *document.parameters[3:])
    assert verdict_of(replace(document, parameters=parameters)).sound.passed


def test_regions_that_hold_contain_what_few_poses_leave_open() -> None:
    assert verdict_of(changed(clean(), "accuracy.after.rms", 1e-4)).sound.passed


def test_an_outlier_of_the_kind_that_good_data_have_is_no_finding() -> None:
    document = changed(clean(), "outliers", (replace(OUTLIER, p_value=4e-4),))
    assert document.outlier_tests is not None
    assert verdict_of(document).sound.passed
    assert verdict_of(replace(document, outlier_tests=None)).sound.code == "outliers"


def test_where_most_poses_are_left_out_none_is_called_bad() -> None:
    document = changed(clean(), "outliers", (OUTLIER,))
    assert document.outlier_tests is not None
    few = replace(document.outlier_tests, by_residuals=True, poses=document.data.used // 3)
    assert verdict_of(replace(document, outlier_tests=few)).sound.code == "sound"


def test_where_a_quarter_of_the_poses_do_not_fit_no_one_is_told_to_exclude_them() -> None:
    document = clean()
    for share, advice in ((0.1, "correct or exclude them"), (0.4, "Find what they share")):
        count = int(share * document.data.used)
        some = tuple(replace(OUTLIER, pose=str(i)) for i in range(count))
        found = verdict_of(replace(document, outliers=some)).sound
        assert (found.code, found.passed) == ("outliers", None)
        assert advice in str(found)


def test_without_stated_sds_a_pose_with_a_long_lever_arm_is_no_outlier() -> None:
    document = clean()
    assert document.outlier_tests is not None
    tests = replace(document.outlier_tests, by_residuals=True)
    for p, sound in ((1e-5, True), (1e-9, None)):
        judged = replace(document, outlier_tests=tests, outliers=(replace(OUTLIER, p_value=p),))
        assert verdict_of(judged).sound.passed is sound
    assert not verdict_of(replace(judged, outlier_tests=document.outlier_tests)).sound.passed


def test_a_single_reading_is_remarkable_among_all_readings_of_all_poses() -> None:
    document = clean()
    readings = len(document.data.quantities)
    assert document.outlier_tests is not None
    limit = 0.005 / document.outlier_tests.poses
    for quantity, most in ((None, limit), ("phi2", limit / readings)):
        for p, code in ((0.9 * most, "outliers"), (1.1 * most, "sound")):
            one = replace(OUTLIER, quantity=quantity, p_value=p)
            assert verdict_of(replace(document, outliers=(one,))).sound.code == code


def test_an_error_of_the_machine_model_leaves_the_question_open() -> None:
    document = clean()
    sensor = replace(document.noise[0], quantities=("model_x",), unit="m", sd=1.37e-3)
    model = replace(sensor, role="disturbance")
    found = verdict_of(replace(document, noise=(*document.noise, model)))
    assert found.sound.code == "white-model-error"
    assert "1.37 mm" in found.sound.words
    nothing = replace(model, sd=0.0)
    assert verdict_of(replace(document, noise=(*document.noise, nothing))) == verdict_of(document)


def test_regions_that_take_shared_errors_as_independent_say_so_alone() -> None:
    few = changed(clean(), "validation.coverage", Coverage(0.95, 0.6, 60))
    shared = replace(few, dependence=Dependence((), 1e-3, shared=likeness(1e-9)))
    assert verdict_of(shared).sound.code == "errors-shared"
    independent = replace(few, dependence=Dependence((), 1e-3, shared=likeness(0.1)))
    assert verdict_of(independent).sound.code == "regions-too-small"


def test_a_slip_is_named_with_row_size_and_cause() -> None:
    found = verdict_of(replace(clean(), change_points=ChangePoints((SLIP,), 0.01, 120, "")))
    assert "on the target x6B moved on the body. Size: x6B by 0.500 mm" in found.sound.words


def test_a_plain_model_that_lacks_sag_is_wrong() -> None:
    first, second, third = candidates(1e-6).over
    lacking = replace(candidates(1e-6), over=(first, second, replace(third, terms=(SAG,))))
    found = verdict_of(replace(clean(), chosen=lacking))
    assert found.sound.code == "plain-model-wrong"
    assert "joints give way by 0.9 mrad/m" in found.sound.words
    for harmless in (replace(SAG, gain=8.0), replace(SAG, name="lengths")):
        over = (first, second, replace(third, terms=(harmless,)))
        assert verdict_of(replace(clean(), chosen=replace(lacking, over=over))).sound.passed
    modelled = replace(lacking, terms=("sag",))
    assert verdict_of(replace(clean(), chosen=modelled)).sound.passed


def test_a_term_that_a_better_weighted_fit_does_not_need_is_no_finding() -> None:
    first, second, third = candidates(1e-6).over
    needless = replace(second, terms=(replace(SAG, gain=-4.0),))
    chosen = replace(candidates(1e-6), over=(first, needless, replace(third, terms=(SAG,))))
    assert verdict_of(replace(clean(), chosen=chosen)).sound.passed


@pytest.mark.parametrize(
    ("learnt", "most"),
    [
        ({"sd": 0.0}, 1.25),
        ({"sd": 7e-5, "upper": 3.9e-4, "p_value": 1.0, "sd_of_sd": 7e-5}, 2.0),
    ],
)
def test_an_sd_that_may_be_0_leaves_the_question_open(learnt: dict[str, Any], most: float) -> None:
    document = clean()
    zero = replace(document.noise[0], source="estimated", **learnt)
    document = replace(document, noise=(zero, *document.noise[1:]))
    assert verdict_of(document).sound.code == "sd-not-detectable"
    region = document.region
    assert region is not None
    for times, passed in ((most - 0.05, True), (most + 0.05, None)):
        by = tuple(replace(one, sd_at_bounds=times * one.sd_at_poses) for one in region.by)
        bounded = changed(document, "prediction.region.by", by)
        assert verdict_of(bounded).sound.passed is passed
    seen = replace(zero, sd=7e-5, upper=None, p_value=1e-4)
    assert verdict_of(replace(document, noise=(seen, *document.noise[1:]))).sound.passed


def test_the_region_says_what_bounds_of_sds_would_do() -> None:
    # Encoders far better than the tracker: their learnt sd is 0, with an upper bound.
    arm, noise = planar_arm(40), lc.Noise({"?P": 1e-3, "phi?": 1e-5}, estimate={"phi?": "group"})
    data = arm.read({"xP": 1e-3, "yP": 1e-3, "phi2": 1e-6, "phi3": 1e-6}, 1)
    result = lc.calibrate(arm.off(2e-3, 2e-3, seed=3), data, noise=noise, method="implicit-loop")
    (bound,) = {e.upper for e in result.noise if not e.sd}
    calibrated = predictor(result)
    assert bound
    assert calibrated
    region = region_of(result, calibrated)
    assert region is not None
    (one,) = region.by
    lengths = [result.value[name] for name in ("l2", "l3")]
    # An encoder error moves the point by about a length: two such errors beside what was stated.
    hidden = math.sqrt((one.sd_at_bounds or 0.0) ** 2 - one.sd_at_poses**2) / bound
    assert min(lengths) < hidden < 2.0 * sum(lengths)


def test_the_gravest_finding_answers_and_the_others_are_told() -> None:
    document = changed(clean(), "outliers", (OUTLIER,))
    found = verdict_of(changed(document, "status.converged", False))
    assert found.sound.code == "not-converged"
    assert "1 pose does not fit the others (17)" in found.sound.words
    assert found.headline.startswith("Do not use this result")


def corner(poses: int = 40) -> lc.Result:
    arm = planar_arm(poses)
    near = np.random.default_rng(2).uniform(0.0, 0.15, (2, poses))
    data = arm_at(arm.truth, near).read(SDS, 1)
    return lc.calibrate(
        arm.truth, data, noise=lc.Noise(SDS), start="nominal", method="implicit-loop"
    )


def test_poses_in_a_corner_are_valid_there_only_and_both_sds_are_named() -> None:
    result = corner()
    narrow = lc.verdict(result, region={"phi2": (-2.5, 2.5), "phi3": (-2.5, 2.5)})
    assert narrow.valid.code == "near-poses-only"
    assert narrow.valid.number is not None
    assert narrow.valid.number > 5
    assert len(re.findall(r"[\d.]+ mm", narrow.valid.words)) == 2
    assert narrow.headline.startswith("Use it near the measured poses only")
    inside = lc.verdict(result, region={"phi2": (0.0, 0.15), "phi3": (0.0, 0.15)})
    assert inside.valid.passed
    assert inside.valid.number == pytest.approx(1.0, abs=0.3)


def test_a_joint_without_limits_turns_a_quarter_turn_about_the_middle_of_its_readings() -> None:
    arm = dh_arm()
    assert joint_limits(arm) == {}
    driven = [q for q in arm.quantities if q not in arm.outputs]
    poses = lc.random_poses(dict.fromkeys(driven, (0.1, 0.4)), 40, seed=3)
    sds = dict.fromkeys(arm.quantities, 1e-05)
    data = lc.simulate(arm, poses, noise=lc.Noise(sds), seed=4).dataset
    prior = dict.fromkeys(arm.parameters.names, 1e-3)
    result = lc.calibrate(arm, data, noise=sds, prior=prior, method="implicit-loop")
    known = predictor(result)
    assert known is not None
    region = region_of(result, known)
    assert region is not None
    for one in region.ranges:
        read = data.readings[one.quantity]
        assert one.source == "turn"
        assert one.high - one.low == pytest.approx(np.pi)
        assert one.low < read.min() < read.max() < one.high


def test_a_machine_that_nothing_limits_works_between_its_measured_poses() -> None:
    """A five-bar: no sensor reads its platform, and the corners of its drives' box are singular."""
    trial = Parallel("five-bar", poses=40).made(np.random.default_rng(1))
    result = lc.calibrate(
        trial.mechanism, trial.readings, noise=trial.noise, method="least-squares"
    )
    known = predictor(result)
    assert known is not None
    region = region_of(result, known)
    assert region is not None
    assert {one.source for one in region.ranges} == {"readings"}
    assert region.worst.ratio is not None
    assert 0.5 < region.worst.ratio < 1.5
    limited = region_of(result, known, {"theta_1": (1.6, 2.6)})
    assert limited is not None
    assert limited.worst.ratio is not None
    assert limited.worst.ratio > region.worst.ratio


def test_a_tolerance_is_judged_with_its_guard_band() -> None:
    p95 = clean().validation.accuracy.p95  # type: ignore[union-attr]
    for factor, passed in ((0.5, False), (1.02, None), (3.0, True)):
        assert verdict_of(clean(), factor * p95).tolerance.passed is passed


def candidates(difference: float) -> Chosen:
    document = clean()
    assert document.validation is not None
    seen = document.validation.accuracy
    over = tuple(
        Candidate(name, seen, None, d, 1e-5)
        for name, d in (("auto", 0.0), ("nominal", 1e-3), ("least squares", difference))
    )
    return Chosen("reweighted", (), "", over)


def test_never_silently_worse_than_a_rival() -> None:
    better = verdict_of(replace(clean(), chosen=candidates(1e-6)))
    assert better.better.code == "better"
    worse = verdict_of(replace(clean(), chosen=candidates(-1e-4)))
    assert worse.better.code == "worse"
    assert "least squares" in worse.better.words
    assert verdict_of(replace(clean(), validation=None)).better.code == "not-validated"


@pytest.mark.parametrize("printed", ["print", "corner"])
def test_where_only_a_print_was_stated_there_is_no_drawing_to_be_better_than(printed: Role) -> None:
    document = clean()
    first, nominal, _ = candidates(1e-6).over
    document = replace(
        document, chosen=Chosen("a", (), "", (first, replace(nominal, difference=0.0)))
    )
    assert verdict_of(document).better.code == "no-better"
    first_one, *others = (replace(p, role="placement") for p in document.parameters)
    document = replace(document, parameters=(replace(first_one, role=printed), *others))
    assert verdict_of(document).better.code == "nothing-stated"


def test_a_fit_that_did_not_converge_is_not_told_to_validate() -> None:
    unseen = replace(clean(), validation=None)
    assert "--folds" in (verdict_of(unseen).better.next or "")
    failed = replace(unseen, status=replace(unseen.status, converged=False))
    assert verdict_of(failed).better.code == "not-validated"
    assert "--folds" not in (verdict_of(failed).better.next or "")


def test_a_result_knows_its_verdict_and_files_hold_the_same(tmp_path: Path) -> None:
    result = corner()
    assert result.verdict == lc.verdict(result)
    lc.write_result(result, tmp_path)
    assert lc.read_result(tmp_path / "result.json").verdict == result.verdict


def test_a_chosen_result_is_judged_by_its_validation_and_candidates() -> None:
    arm = planar_arm(40)
    result = lc.calibrate(arm.truth, arm.read(SDS, 1), noise=lc.Noise(SDS), method="auto")
    assert result.verdict is not None
    assert result.chosen is not None
    rival = next(c for c in result.chosen.over if c.name == "nominal")
    assert result.verdict.better.number == rival.difference
    assert "sd of the difference" in result.verdict.better.words


def test_false_alarms_over_clean_draws_are_rare() -> None:
    arm = planar_arm(40)
    found = []
    for seed in range(40):
        result = lc.calibrate(
            arm.truth,
            arm.read(SDS, seed),
            noise=lc.Noise(SDS),
            start="nominal",
            method="implicit-loop",
        )
        found.append(lc.verdict(result).sound.passed)
    assert found.count(False) <= 2


@pytest.mark.parametrize(("change", "names"), [("far", True), ("shrunk", True), ("near", False)])
def test_no_machine_is_that_far_from_its_drawing(change: str, names: bool) -> None:
    document = clean()

    def moved(p):
        if p.unit != "m" or p.fixed:
            return p
        value = {"far": p.nominal + 100.0, "shrunk": 1e-14, "near": 1.5 * p.nominal}[change]
        return replace(p, value=value)

    judged = verdict_of(replace(document, parameters=tuple(map(moved, document.parameters))))
    assert (judged.sound.code == "far-from-nominal") is names
    assert judged.sound.passed is not names


def test_what_changed_along_the_run_is_not_off_the_drawing() -> None:
    """A tool that was exchanged was "50 mm off its nominal value"."""
    document = clean()
    first = next(p for p in document.parameters if not p.fixed)
    change = {first.name: Change(5e-2, 1e-4, "m")}
    point = ChangePoint("step", "9", "8", 9, "target", change, 1e6, 1e-9, modelled=True)
    made = replace(first, prior_sd=1e-2, value=first.nominal + 5e-2, owner=point.effect)
    off = replace(
        document,
        parameters=tuple(made if p is first else p for p in document.parameters),
    )
    assert verdict_of(off).sound.code == "prior-tension"
    said = verdict_of(replace(off, change_points=ChangePoints((point,), 0.01, 40))).sound
    assert (said.code, said.passed) == ("changes-modelled", None)


def test_an_arm_on_a_wall_is_told_to_state_gravity() -> None:
    """It was "gravity_tilt_1 is -60.8 deg off its nominal value: check units, signs"."""
    document = clean()
    first = next(p for p in document.parameters if not p.fixed)
    tilts = [
        replace(first, name=name, unit="rad", nominal=0.0, value=a, prior_sd=prior, meaning=meaning)
        for name, a, prior, meaning in (
            ("gravity_tilt_1", -1.06, math.radians(5), GRAVITY_TILT),
            ("gravity_tilt_2", 0.03, math.radians(5), GRAVITY_TILT),
        )
    ]
    found = verdict_of(replace(document, parameters=(*document.parameters, *tilts))).sound
    assert (found.code, found.passed) == ("gravity-elsewhere", False)
    assert "61 deg" in found.words
    assert "gravity = [" in (found.next or "")
    upright = [replace(tilt, value=0.1 * tilt.value) for tilt in tilts]
    found = verdict_of(replace(document, parameters=(*document.parameters, *upright))).sound
    assert found.passed is not False


def test_a_hundred_prior_sds_are_too_far_for_every_method() -> None:
    document = clean()
    first = next(p for p in document.parameters if not p.fixed)
    for sds, code in ((101.0, "far-from-nominal"), (90.0, "prior-tension")):
        off = replace(first, prior_sd=1e-5, value=first.nominal + sds * 1e-5)
        parameters = tuple(off if p is first else p for p in document.parameters)
        found = verdict_of(replace(document, parameters=parameters)).sound
        assert (found.code, found.passed) == (code, False)


def with_lengths(document: ResultDocument, *off: float) -> ResultDocument:
    """The document with a learnt term of so many lengths of 1 m, each this far [m] off."""
    first = next(p for p in document.parameters if p.unit == "m" and not p.fixed)
    first = replace(first, role="length", meaning="", prior_sd=2e-2, sd=2e-5)
    own = [replace(first, name=f"a_{i}", nominal=1.0, value=1.0 + d) for i, d in enumerate(off, 1)]
    term = replace(SAG, name="lengths", unit="m", columns=len(own))
    return replace(document, parameters=tuple(own), terms=(term,))


def test_shifts_of_axes_have_no_drawn_size() -> None:
    """Of a product of exponentials 2 mm were "the drawing of another machine"."""
    document = with_lengths(clean(), 2e-3, -1e-3, 3e-3, -2e-3, 1e-3)
    shifts = [replace(p, nominal=0.0, value=p.value - 1.0) for p in document.parameters]
    assert off_the_drawing(replace(document, parameters=tuple(shifts))) is None
    far = [replace(p, value=300.0 * p.value) for p in shifts]
    found = off_the_drawing(replace(document, parameters=tuple(far)))
    assert found is not None
    assert found.code == "another-drawing"


def flat(document: ResultDocument) -> ResultDocument:
    """As a method without priors has it."""
    own = tuple(replace(p, prior_sd=None) for p in document.parameters)
    return replace(document, parameters=own, terms=())


def _off(p: ParameterEntry) -> float:
    return abs(p.value - p.nominal)


def test_a_sentence_says_what_a_parameter_is() -> None:
    """Of few; programs read names."""
    gears = lc.effects.Harmonics(("q2",), orders=(1.0, 2.0, 100.0))
    arm = lc.serial_arm([lc.Joint("q1", "dh"), lc.Joint("q2", "dh")], {"a_1": 0.4, "a_2": 0.3})
    labels = labels_of(lc.with_effects(arm, [gears]).parameters)
    assert labels["q2_sin1"] == "q2_sin1 (once-per-turn gear error of q2, sine part)"
    assert labels["q2_cos100"] == "q2_cos100 (100-per-turn gear error of q2, cosine part)"
    assert labels["offset_2"] == "offset_2 (zero of q2)"
    assert labels["tool_x"] == "tool_x (position along x of tool)"
    worn = replace(
        unsaid(), name="q2_sin1", unit="rad", role="effect", owner="harmonics", nominal=0.0
    )
    worn = replace(
        worn,
        meaning="once-per-turn gear error of q2, sine part",
        value=-8e-3,
        sd=1e-4,
        prior_sd=1e-3,
    )
    document = replace(clean(), parameters=(*clean().parameters, worn))
    found = next(one for one in findings_of(document) if one.code == "prior-tension")
    assert found.place.parameters == ("q2_sin1",)
    assert found.words.startswith(f"{labels['q2_sin1']} is -0.458 deg")


def test_a_dimension_that_is_off_the_drawing_alone_is_named() -> None:
    near = (3e-4, -2e-4, 1e-4, -3e-4, 2e-4)
    found = verdict_of(with_lengths(clean(), *near, -0.05)).sound
    assert (found.code, found.passed) == ("off-the-drawing", None)
    assert "a_6 is off the drawing by -50.0 mm" in found.words
    assert verdict_of(flat(with_lengths(clean(), *near, -0.05))).sound.words == found.words
    # what the poses leave open stays where it is drawn, with the sd that this one has made large
    loose = with_lengths(clean(), *near, -0.05, 0.0, 0.0)
    loose = replace(
        loose, parameters=tuple(replace(p, sd=2e-2) if not _off(p) else p for p in loose.parameters)
    )
    assert "the other lengths are within 0.23 mm" in verdict_of(loose).sound.words
    # all of them are off, or one not far enough to stand out of five others
    for off in ((0.05, -0.04, 0.03, 0.05, -0.06, 0.05), (*near, 1e-3)):
        for document in (with_lengths(clean(), *off), flat(with_lengths(clean(), *off))):
            assert verdict_of(document).sound.passed


def test_the_drawing_of_another_machine_is_named() -> None:
    """Its lengths are off by more than a tenth of their size, with a prior or without."""
    other = with_lengths(clean(), 0.3, -0.2, 0.05, -0.3, 0.1)
    for document in (flat(other), replace(other, parameters=flat(other).parameters)):
        found = verdict_of(document).sound
        assert (found.code, found.passed) == ("off-the-drawing", None)
        assert "another machine" in found.words
        unsure = tuple(replace(p, sd=0.1) for p in document.parameters)
        assert verdict_of(replace(document, parameters=unsure)).sound.passed


def test_a_tool_far_from_its_place_is_named_without_a_prior() -> None:
    document = flat(with_lengths(clean(), 3e-4, -2e-4, 1e-4))
    tool = replace(document.parameters[0], name="tool_x", nominal=0.1, role="mounting")
    for off, code in ((0.11, "off-the-drawing"), (0.012, "sound")):
        own = (*document.parameters, replace(tool, value=0.1 + off))
        assert verdict_of(replace(document, parameters=own)).sound.code == code
    # where nobody stated a place, nothing is off
    unknown = changed(document, "mechanism.unstated", (("tool_x",),))
    for nominal, code in ((0.0, "mounting-unstated"), (0.1, "sound")):  # 0.1: as readings suggest
        own = (*document.parameters, replace(tool, nominal=nominal, value=0.21))
        assert verdict_of(replace(unknown, parameters=own)).sound.code == code


def test_a_camera_that_looks_ahead_is_off_by_the_angle_that_it_is_turned() -> None:
    """Its pitch is 90 degrees, so that yaw and roll turn about one axis and drift together."""
    document = flat(with_lengths(clean(), 3e-4, -2e-4, 1e-4))
    drawn = {"x": 0.0, "y": 0.0, "z": 0.0, "rz": 2.4, "ry": 1.571, "rx": 2.4}

    def verdict_at(**off: float) -> lc.Answer:
        eye = (
            replace(
                document.parameters[0],
                name=f"eye_{k}",
                owner="eye",
                role="mounting",
                unit="rad" if k.startswith("r") else "m",
                nominal=v,
                value=v + off.get(k, 0.0),
                sd=1e-3,
            )
            for k, v in drawn.items()
        )
        return verdict_of(replace(document, parameters=(*document.parameters, *eye))).sound

    assert verdict_at(rz=11.0, rx=11.0).passed
    turned = verdict_at(rz=11.0, rx=11.6)
    assert turned.code == "off-the-drawing"
    assert "34.4 deg" in turned.words


def test_scales_are_named_by_their_significance_and_their_size() -> None:
    one = ScaleEntry(("point_2",), 1e-4, 1e-5, 1e-9, 1e-3)
    found = verdict_of(changed(clean(), "scales", (one,))).sound
    assert "'point_2' differs by 100 ppm (sd 10 ppm) from that of the first station" in found.words
    for entries in ((replace(one, p_value=6e-4), one), (one,)):
        assert verdict_of(changed(clean(), "scales", entries)).sound.code == "scales-unlike"
    unsure = (replace(one, p_value=6e-4), replace(one, instruments=(), p_value=0.5))
    assert verdict_of(changed(clean(), "scales", unsure)).sound.passed
    little = verdict_of(changed(clean(), "scales", (replace(one, moves=1e-9),))).sound
    assert little.passed
    assert "scale-little-off" in little.codes


def test_sds_that_a_learnt_error_makes_good_are_named_on_a_sound_result() -> None:
    first, *others = candidates(1e-6).over
    for factor, told in ((3.0, True), (1.5, False)):
        over = (first, replace(others[0], excess=factor))
        found = verdict_of(replace(clean(), chosen=replace(candidates(1e-6), over=over))).sound
        assert found.passed
        assert ("err 3.0 times as much as the stated sds" in found.words) is told


def test_a_drift_that_ordered_poses_cannot_tell_from_the_machine_leaves_the_answer_open() -> None:
    document = clean()
    entry = document.prediction
    assert entry is not None
    assert entry.region is not None
    at = replace(entry.region.by[0], sd_at_poses=1e-4)
    document = changed(document, "prediction.region.by", (at,))
    drift = replace(document.parameters[0], name="xP_drift", role="effect", owner="run_drift")
    # Each coordinate moves by 1/sqrt(12) of its drift, rms over the run: three by half of it.
    large, small = 1.1e-4, 0.9e-4
    for sd, gain, words in (
        (large, 2.8, "The readings suggest one."),
        (large, 2.6, "The readings do not suggest one."),
        (small, 2.8, ""),
    ):
        own = (*document.parameters, *3 * (replace(drift, unit=at.unit, sd=sd),))
        terms = (replace(SAG, name="run_drift", unit=at.unit, gain=gain),)
        found = verdict_of(replace(document, parameters=own, terms=terms)).sound
        assert (found.code, found.passed) == (
            ("drift-or-machine", None) if words else ("sound", True)
        )
        assert words in found.words


def test_a_drift_that_ordered_poses_tell_from_the_machine_is_told_as_a_change() -> None:
    part = TermPart(("base_z",), "m", 2e-4, 2e-5, None, "base_z drifts by 0.2 mm over the run")
    term = replace(SAG, name="run_drift", unit="m", parts=(part,))
    for gain, code in ((40.0, "drift-modelled"), (2.0, "sound")):
        found = verdict_of(changed(clean(), "terms", (replace(term, gain=gain),))).sound
        assert found.code == code
        assert ("base_z drifts by 0.2 mm" in found.words) is (code != "sound")


def test_a_ramp_in_an_order_that_the_joints_tell_leaves_the_answer_open() -> None:
    """Random joints tell no order, sorted ones do; beside a slip both are named as before."""
    ramp = replace(SLIP, shape="ramp", pose="1", after="120", until=120)
    told = replace(ramp, imitated=True)
    moved, unsure = "change-points", "drift-or-model"
    for points, code in (((ramp,), moved), ((told,), unsure), ((told, SLIP), moved)):
        changes = ChangePoints(points, 0.01, 120, "")
        found = verdict_of(replace(clean(), change_points=changes)).sound
        assert (found.code, found.passed) == (code, None if code == unsure else False)
        assert "all along poses 1 to 120" in found.words or code == moved


def test_a_drift_that_a_smooth_model_error_hides_is_named() -> None:
    first, *others = candidates(1e-6).over
    alike = replace(others[0], serial=Likeness(0.3, 1e-6))
    document = replace(clean(), chosen=replace(candidates(1e-6), over=(first, alike)))
    found = verdict_of(document).sound
    assert (found.code, found.passed) == ("drift-or-model", None)
    assert "drift" in found.words
    # a term that explains the order of the poses, or a drift that the result allows for
    sag = replace(SAG, effects=("sag_1",))
    assert verdict_of(replace(document, terms=(sag,))).sound.passed
    drifts = replace(document, dependence=depends(1e-9, 1.0))
    assert verdict_of(drifts).sound.code == "serial-dependence"


def test_lengths_of_one_distribution_are_off_the_drawing_once_in_a_thousand() -> None:
    rng = np.random.default_rng(4)
    document = clean()
    alarms = [
        off_the_drawing(with_lengths(document, *(3e-4 * rng.standard_normal(8)))) is not None
        for _ in range(2000)
    ]
    assert sum(alarms) <= 6  # 2 are expected, 7 or more come once in 200


def test_stated_sds_that_the_choice_did_without_are_judged() -> None:
    first, *others = candidates(1e-6).over

    def judged(*factors: float) -> tuple[str, bool | None]:
        chi = [ChiSquared.of(100.0 * factor, 100) for factor in factors]
        over = [replace(c, chi_squared=x) for c, x in zip(others, chi, strict=False)]
        chosen = replace(candidates(1e-6), over=(first, *over))
        found = verdict_of(replace(clean(), chosen=chosen)).sound
        return found.code, found.passed

    assert judged(1e-6, 4e-3) == ("sds-overruled", None)
    assert judged(9.0, 50.0) == ("sds-overruled", None)
    assert judged(1.0, 50.0)[0] == judged(0.01, 0.9)[0] == "sound"


def test_degrees_of_freedom_used_in_vain_do_not_make_sds_generous() -> None:
    assert verdict_of(replace(clean(), chi_squared=ChiSquared.of(57.0, 114, 40.0))).sound.passed
    generous = verdict_of(replace(clean(), chi_squared=ChiSquared.of(57.0, 114, 10.0))).sound
    assert generous.code == "sds-generous"


def test_a_file_at_fault_is_told_alone_and_a_failed_fit_has_no_region() -> None:
    fault = ColumnFault(("xP",), "xP is in mm", 1.0, 0.0)
    failed = changed(clean(), "status.converged", False)
    found = verdict_of(replace(failed, column_faults=(fault,)))
    assert found.sound.words == "The file is at fault: xP is in mm."
    assert found.valid.code == verdict_of(failed).valid.code == "region-unknown"


def test_where_it_is_valid_is_open_until_the_fit_is_sound() -> None:
    assert verdict_of(clean()).valid.code == "valid-in-region"
    rejected = replace(clean(), chi_squared=ChiSquared.of(300.0, 114))
    found = verdict_of(rejected)
    assert not found.sound.passed
    assert (found.valid.code, found.valid.passed) == ("valid-if-sound", None)


def test_every_code_is_described() -> None:
    text = (ROOT / "docs" / "explanation" / "verdict.md").read_text("utf-8")
    described = set(re.findall(r"^\| `([a-z-]+)` \|", text, re.MULTILINE))
    codes = {row.code for row in CATALOGUE.values()} | {UNASKED}
    assert described == codes, "docs/explanation/verdict.md has one row for each code"


def _example(row: Row) -> Finding:
    """The finding of a row with made-up numbers and names."""
    templates = "".join((row.sentence, row.detail, row.remedy or ""))
    named = [(str(name), form) for _, name, form, _ in Formatter().parse(templates) if name]
    # In a template numbers have a format and names have none.
    numbers = {name: Figure(0.0123) for name, form in named if form}
    place = Where(*(("example",) for _ in fields(Where)))
    return row.finding(Fact(row.fact, numbers, place, {n: "example" for n, f in named if not f}))


def test_every_row_of_the_catalogue_answers_and_advises() -> None:
    """Sentences that end, at most 40 words each; what refuses or stays open says what to do."""
    for row in CATALOGUE.values():
        made = _example(row)
        assert made.words.endswith((".", "example")), row.fact
        assert made.words.startswith(made.title[:-1]), row.fact
        assert all(len(one.split()) <= 40 for one in made.words.split(". ")), row.fact
        # nothing that a user does decides these
        alone = {"nominal-not-placed", "unknown-accuracy", "machines-differ"}
        assert (made.next is None) is (row.severity == "info" or row.fact in alone), row.fact


def test_a_command_of_a_finding_is_one_of_the_program() -> None:
    """With every option that it names, quoted where a name needs it."""
    loaded(COMMANDS)
    commands = get_command(app).commands  # type: ignore[attr-defined]
    day = ["day 2.csv", "probe.csv"]  # all that were typed
    files: dict[str, Named] = {"project": "a b.toml", "result": "r", "readings": day}
    for row in CATALOGUE.values():
        step = row.finding(_fact_of(row), files).next
        assert step is None or (step.command is None) is (row.command is None)
        if step is None or step.command is None:
            continue
        program, command, *words = shlex.split(step.command)
        assert program == "loopcal"
        assert [word for word in words if word in day] == day * ("day 2.csv" in words)
        options = {o for p in commands[command].params for o in p.opts}
        assert {word for word in words if word.startswith("--")} <= options, step.command
        assert "{" not in step.command


def _fact_of(row: Row) -> Fact:
    made = _example(row)
    texts = re.findall(r"{(\w+)}", row.sentence + row.detail + (row.remedy or ""))
    return Fact(row.fact, made.numbers, made.place, dict.fromkeys(texts, "text"))


def test_a_headline_is_one_line_and_the_answer_has_the_rest() -> None:
    slips = tuple(
        replace(SLIP, pose=str(100 * i), number=100 * i, modelled=True) for i in range(1, 6)
    )
    found = verdict_of(replace(clean(), change_points=ChangePoints(slips, 0.01, 600, "")))
    when = "from poses 100, 200, 300, 400 and 500 on"
    assert found.headline == f"Use it with care: the fit models changes along the run {when}."
    assert len(found.headline) < 200
    assert "; and 2 more. Predictions hold" in found.sound.words
    assert all(len(line) <= WIDTH for line in found.lines())
    assert " ".join(" ".join(found.lines()).split()).count("From pose 100 on") == 1


def test_six_results_have_their_worst_answer_in_the_headline() -> None:
    """Each of the four answers has a code and a sentence; what is not passed has a next step."""
    begun = clean()
    wrong = changed(begun, "status.converged", False)
    narrow = (
        changed(begun, "prediction.region.by", (replace(begun.prediction.region.by[0], ratio=8.0),))
        if begun.prediction and begun.prediction.region
        else begun
    )
    cases = {
        "Sound": verdict_of(begun),
        "Do not use this result: the fit did not converge": verdict_of(wrong),
        "Use it near the measured poses only": verdict_of(narrow),
        "Do not use this result: worse than": verdict_of(replace(begun, chosen=candidates(-1e-4))),
        "Not good enough": verdict_of(begun, 1e-6),
        "Use it with care: no other poses": verdict_of(replace(begun, validation=None)),
    }
    for head, verdict in cases.items():
        assert verdict.headline.startswith(head)
        for answer in verdict.answers.values():
            assert re.fullmatch(r"[a-z-]+", answer.code)
            assert answer.words.endswith(".")
            assert (answer.next is None) is (answer.passed is True)
        numbers = [a.number for a in verdict.answers.values() if a.passed is not None]
        assert any(number is not None for number in numbers)


def test_neighbours_that_are_alike_are_said_with_share_and_certainty() -> None:
    likely = Likeness(0.0061, 1e-9)
    found = verdict_of(
        replace(clean(), dependence=Dependence((InstrumentDependence("T", None, likely),), 0.01))
    )
    assert "0.6 % of the variance of the residuals of 'T'" in found.sound.words
    assert "(p < 1e-6)" in found.sound.words


@pytest.mark.parametrize("tolerance", [True, False, None, "unasked"])
@pytest.mark.parametrize("better", [True, False, None])
@pytest.mark.parametrize("valid", [True, False, None])
@pytest.mark.parametrize("sound", [True, False, None])
def test_a_verdict_is_true_only_where_all_that_was_asked_is_answered_yes(
    sound: bool | None, valid: bool | None, better: bool | None, tolerance: bool | str | None
) -> None:
    answers = [lc.Answer(passed, "code", None, "Words.", None) for passed in (sound, valid, better)]
    last = (
        lc.Answer(None, "no-tolerance", None, "No tolerance is stated.", None)
        if tolerance == "unasked"
        else lc.Answer(None if tolerance is None else bool(tolerance), "code", None, "Words.", None)
    )
    found = lc.Verdict(answers[0], answers[1], answers[2], last, headline="Headline.")
    every = [sound, valid, better, *([] if tolerance == "unasked" else [tolerance])]
    assert bool(found) is found.ok is (every == [True] * len(every))


def test_a_printed_result_begins_with_its_headline_and_the_four_answers(tmp_path: Path) -> None:
    made = planar_arm(40).read(SDS, 1)
    fitted = lc.calibrate(
        planar_arm(40).off(1e-3, 1e-3), made, noise=lc.Noise(SDS), method="implicit-loop"
    )
    fitted.save(tmp_path, report=False)
    for result in (fitted, lc.read_result(tmp_path)):
        assert result.verdict is not None
        text = " ".join(str(result).split())
        begin = text.index(result.verdict.headline.replace("  ", " "))
        at = [text.index(f" {name} {a.mark} ", begin) for name, a in result.verdict.answers.items()]
        assert at == sorted(at)
        assert begin < 100
        assert at[-1] < text.index("converged in")
        assert str(result) == result.summary()


@pytest.mark.parametrize("code", FINDINGS)
def test_every_answer_follows_from_the_findings_alone(code: str) -> None:
    made = judged(at_fault(code), tolerance=1e-3)
    assert made.verdict is not None
    order = ["refuse", "caution", "info"]
    ranks = [order.index(one.severity) for one in made.findings]
    assert ranks == sorted(ranks)
    for question, answer in made.verdict.answers.items():
        own = [one for one in made.findings if one.question == question]
        assert answer.codes == tuple(one.code for one in own)
        severities = {one.severity for one in own}
        follows = False if "refuse" in severities else None if "caution" in severities else True
        assert answer.passed is follows, question


def test_a_finding_names_its_place_and_its_numbers() -> None:
    moved = changed(clean(), *FINDINGS["change-points"][:2])
    (slip,) = (one for one in findings_of(moved) if one.code == "change-points")
    assert slip.place.poses == ("86",)
    assert slip.place.parameters == ("x6B",)
    assert slip.numbers["changes"].value == 1.0
    assert slip.next is not None


def test_a_joint_that_stood_still_is_said_to_have_stood_still() -> None:
    arm = dh_arm()
    driven = [q for q in arm.quantities if q not in arm.outputs]
    ranges = dict.fromkeys(driven, (-1.5, 1.5)) | {driven[0]: (0.2, 0.2)}
    sds = dict.fromkeys(arm.quantities, 1e-5)
    poses = lc.random_poses(ranges, 60, seed=3)
    data = lc.simulate(arm, poses, noise=lc.Noise(sds), seed=4).dataset
    noisy = 0.2 + np.random.default_rng(5).normal(0.0, 1e-5, len(data))  # as an encoder reads
    data = data.with_readings({driven[0]: noisy})
    prior = dict.fromkeys(arm.parameters.names, 1e-2)
    result = lc.calibrate(arm, data, noise=sds, prior=prior, method="implicit-loop")
    assert result.verdict is not None
    assert result.verdict.valid.code == "valid-while-parked"
    assert repr(driven[0]) in result.verdict.valid.words
    region = result.document.region
    assert region is not None
    assert region.parked == (driven[0],)
    kept = lc.verdict(result, region={driven[0]: (noisy.min(), noisy.max())})
    assert kept.valid.code == "valid-in-region"
    assert region.worst_while_parked is not None
    assert kept.valid.number == pytest.approx(region.worst_while_parked.ratio)
    assert (region.worst.ratio or np.inf) > 3.0
