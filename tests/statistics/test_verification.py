"""Another day: false alarms, power, placement, accuracy; `analyses/verify.py` at full size."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import loopcal as lc
from analyses.instruments import setup
from analyses.verify import LEVEL, Rates, another_day, run
from loopcal.errors import NoTrustworthyResult
from loopcal.mechanisms.station import Station
from loopcal.statistics.another_day import Day, as_learnt
from loopcal.statistics.calibrated import Calibrated
from loopcal.statistics.innovation import Innovation
from loopcal.statistics.replacing import freed, mounted
from loopcal.statistics.verdict import Quantile, kept
from loopcal.statistics.verification import _expected as errors_expected
from loopcal.statistics.verification import verify
from tests.reference.machines import dh_arm
from tests.reference.simulated import Simulated, ma1400, planar_arm
from tests.reference.verdicts import finding_of
from tests.refusals import refused
from tests.statistics.test_comparison import elsewhere, motion, sds_of

DRAWS = 6
NAMES = (
    "six-axis distance",
    "six-axis draw-wire",
    "six-axis relative distance",
    "six-axis ball-bar",
    "two-link spherical",
    "two-link draw-wire",
    "two-link relative distance",
)


@cache
def rates(name: str) -> Rates:
    return run(name, range(DRAWS))


def test_an_unchanged_machine_is_called_changed_as_often_as_stated() -> None:
    """Four standard errors of the level over all setups."""
    p = np.concatenate([rates(name).unchanged for name in NAMES])
    assert abs((p < LEVEL).mean() - LEVEL) < 4 * np.sqrt(LEVEL * (1 - LEVEL) / len(p))
    assert abs(np.mean(p) - 0.5) < 4 * np.sqrt(1 / 12 / len(p))


def test_a_joint_zero_that_moved_by_a_milliradian_is_seen() -> None:
    p = np.concatenate([rates(name).moved for name in NAMES])
    assert (p < LEVEL).mean() > 0.95


def test_the_covariance_expects_the_accuracy_that_is_found() -> None:
    ratios = np.concatenate([rates(name).ratio for name in NAMES])
    assert np.sqrt(np.square(ratios).mean()) == pytest.approx(1.0, abs=0.08)


def test_intervals_of_what_is_placed_hold_the_truth() -> None:
    held = [rates(name).held for name in NAMES if rates(name).held.size]
    assert np.mean(np.concatenate(held)) > 0.88


def calibrated(arm: Simulated, seed: int, poses: int, estimate: bool) -> lc.Result:
    outputs = tuple(arm.truth.outputs)
    noise = lc.Noise(sds_of(arm), estimate={outputs: "group"} if estimate else {})
    data = arm.read(sds_of(arm), seed).take(np.arange(poses))
    return lc.calibrate(arm.truth, data, noise=noise, start="nominal", method="implicit-loop")


def test_learnt_sds_of_few_poses_do_not_raise_the_false_alarms() -> None:
    arm = planar_arm(12)
    p = []
    for seed in range(30):
        day = elsewhere(arm, 1000 + seed, 30).read(sds_of(arm), 5000 + seed)
        found = lc.verify(calibrated(arm, seed, 12, estimate=True), day)
        assert found.innovation.learnt_freedom is not None
        p.append(found.innovation.p_value)
    assert np.mean(np.array(p) < LEVEL) < LEVEL + 4 * np.sqrt(LEVEL * (1 - LEVEL) / len(p))


def test_least_squares_is_judged_by_f_with_the_freedom_of_its_residuals() -> None:
    arm = planar_arm(20)
    sds = {q: 1e-4 if q in arm.truth.outputs else 0.0 for q in arm.truth.quantities}
    p = []
    for seed in range(25):
        result = lc.calibrate(arm.truth, arm.read(sds, seed), method="least-squares")
        day = elsewhere(arm, 1000 + seed, 20).read(sds, 5000 + seed)
        found = lc.verify(result, day)
        assert found.innovation.learnt_freedom == 34
        p.append(found.innovation.p_value)
    assert np.mean(np.array(p) < LEVEL) < LEVEL + 4 * np.sqrt(LEVEL * (1 - LEVEL) / len(p))


@pytest.mark.parametrize("seed", range(3))
def test_the_zeros_of_many_joints_are_named_together(seed: int) -> None:
    """More than three changes were called another machine of this type."""
    arm, rng = ma1400(40), np.random.default_rng(seed)
    first = calibrated(arm, seed, 40, estimate=False)
    day = elsewhere(arm, 3 + seed, 24).read(sds_of(arm), 20 + seed)
    joints = [f"theta_{i}" for i in range(2, 7)]
    off = dict(zip(joints, rng.choice([-1.0, 1.0], 5) * rng.uniform(3e-3, 9e-3, 5), strict=True))
    readings = {q: day[q] + off.get(q, 0.0) for q in arm.truth.quantities}
    found = lc.verify(first, lc.Dataset.from_arrays(readings))
    assert found.changes is not None
    assert found.changes.verdict == "re-master"
    assert set(found.changes.joints) == set(joints)
    for change in found.changes.found:
        assert abs(change.value + off[change.name]) < 4.0 * change.sd
    another = {q: v + 1e-3 * np.sin(3.0 * v) * (q in joints) for q, v in readings.items()}
    found = lc.verify(first, lc.Dataset.from_arrays(another))
    assert found.changes is None or found.changes.verdict != "re-master"


def test_a_machine_whose_placement_is_its_own_parameters_is_moved_as_a_whole() -> None:
    arm = ma1400(40)
    other = elsewhere(arm, 3, 20)
    found = lc.verify(calibrated(arm, 1, 40, estimate=False), other.read(sds_of(arm), 2))
    assert found.verdict["consistent"].passed
    rest = Station("base")
    R, shift = motion(3, 3)
    there = rest.moved(dict.fromkeys(rest.parameters, 0.0), R, shift)
    assert {placed.name for placed in found.placed} == set(rest.parameters)
    for placed in found.placed:
        assert placed.sd is not None
        assert abs(placed.value - there[placed.name]) < 4.5 * placed.sd


def test_what_was_mounted_anew_is_found_only_where_it_is_stated() -> None:
    given = setup("six-axis spherical")
    made = lc.simulate(given.truth, given.driven, noise=given.noise, seed=1)
    nominal = given.truth.with_parameters(given.truth.parameters.with_fixed(given.held))
    result = lc.calibrate(nominal, made.dataset, noise=given.noise, method="implicit-loop")
    moved = another_day(given, 1).with_nominal({"tool_x": 0.06})
    day = lc.simulate(moved, given.driven, noise=given.noise, seed=2).dataset
    stays = lc.verify(result, day)
    assert stays.verdict["consistent"].code == "changed"
    assert stays.failed
    for how in (True, ["tool"], ["T"], ["tool_*"], "tool_x"):
        found = lc.verify(result, day, remounted=how)
        assert found.verdict["consistent"].passed
        value = next(q for q in found.placed if q.name == "tool_x")
        assert value.sd is not None
        assert abs(value.value - 0.06) < 4.5 * value.sd
    with refused("unknown-name", "tool_x"):
        lc.verify(result, day, remounted=["tol_x"])


def test_readings_at_which_no_loop_has_a_value_are_no_trustworthy_result() -> None:
    machine = lc.Mechanism.from_function(
        lambda x, p: [x.y - np.sqrt(x.q + p.c)],
        {"q": "m", "y": "m"},
        {"c": (0.5, "m")},
        outputs=("y",),
    )
    q = np.linspace(0.0, 1.0, 20)
    noise = lc.Noise({"q": 1e-4, "y": 1e-4})
    result = lc.calibrate(machine, {"q": q, "y": np.sqrt(q + 0.5)}, noise=noise)
    with pytest.raises(NoTrustworthyResult, match="no value"):
        lc.verify(result, {"q": q - 5.0, "y": np.sqrt(q)})


def test_nothing_is_placed_where_nothing_stands_apart() -> None:
    given = setup("six-axis relative distance")
    assert freed(given.truth) == ()
    p = rates("six-axis relative distance")
    assert p.held.size == 0


def test_it_stands_beside_the_nominal_machine_placed_with_the_same_freedom() -> None:
    arm = planar_arm(60)
    off = arm.off(2e-3, 2e-3, seed=3)
    noise = lc.Noise(sds_of(arm))
    result = lc.calibrate(
        off, arm.read(sds_of(arm), 1), noise=noise, start="nominal", method="implicit-loop"
    )
    found = lc.verify(result, elsewhere(arm, 5, 40).read(sds_of(arm), 2), tolerance=1e-3)
    assert found.calibrated is not None
    assert found.nominal is not None
    assert found.nominal.rms > 3 * found.calibrated.rms
    assert found.verdict["better"].code == "better-than-nominal"
    assert found.verdict["tolerance"].code == "within-tolerance"
    document = found.document()
    assert document["verdict"]["headline"] == found.headline
    assert {"mean", "rms", "p95", "max"} <= set(document["accuracy"]["nominal"])
    assert lc.verify(result, elsewhere(arm, 5, 40).read(sds_of(arm), 2), tolerance=5e-5).failed


def test_what_is_open_does_not_hide_that_the_machine_is_as_calibrated() -> None:
    arm = planar_arm(60)
    off = arm.off(2e-4, 2e-4, seed=3)
    noise = lc.Noise(sds_of(arm))
    result = lc.calibrate(
        off, arm.read(sds_of(arm), 1), noise=noise, start="nominal", method="implicit-loop"
    )
    found = lc.verify(result, elsewhere(arm, 5, 3).read(sds_of(arm), 2))
    assert found.verdict["consistent"].code == "unchanged"
    assert found.verdict["better"].code == "like-nominal"
    assert found.headline.startswith("The machine is as calibrated: ")
    assert "does not predict these poses significantly better than the nominal" in found.headline


def test_the_readings_of_another_result_serve_as_well() -> None:
    arm = planar_arm(40)
    day = elsewhere(arm, 5, 30).read(sds_of(arm), 2)
    first = calibrated(arm, 1, 40, estimate=False)
    again = lc.calibrate(
        arm.truth, day, noise=lc.Noise(sds_of(arm)), start="nominal", method="implicit-loop"
    )
    assert lc.verify(first, again).document() == lc.verify(first, day).document()


def test_a_guard_band_holds_the_quantile_as_often_as_it_says() -> None:
    rng, held = np.random.default_rng(0), []
    true = np.sqrt(7.814727903251178)  # 95 % of a chi-squared with three degrees of freedom
    for _ in range(400):
        found = Quantile.of(np.linalg.norm(rng.standard_normal((3, 20)), axis=0))
        assert found is not None
        held.append(found.low <= true <= found.high)
    assert np.mean(held) == pytest.approx(0.95, abs=0.035)


@pytest.mark.parametrize(("tolerance", "passed"), [(0.5e-3, False), (1.7e-3, None), (9e-3, True)])
def test_within_the_guard_band_the_decision_is_open(tolerance: float, passed: bool | None) -> None:
    distances = 1e-3 * np.linalg.norm(np.random.default_rng(1).standard_normal((2, 15)), axis=0)
    found = finding_of(kept(Quantile.of(distances), tolerance, "m", "of this file"))
    assert found.severity == {True: "info", False: "refuse", None: "caution"}[passed]
    assert passed is not None or found.code == "near-tolerance"


def test_f_goes_over_into_chi_squared() -> None:
    exact = Innovation.of(60.0, 47, None).p_value
    assert Innovation.of(60.0, 47, 1e7).p_value == pytest.approx(exact, rel=1e-4)
    assert Innovation.of(0.0, 0, None).p_value is None


def test_an_instrument_seen_in_the_base_itself_leaves_the_arm_where_it_is() -> None:
    assert freed(dh_arm())[:1] == ("base_x",)


def test_a_nominal_machine_that_cannot_be_placed_leaves_the_rest() -> None:
    """As drawn the root has no value at these readings, as calibrated it has."""
    machine = lc.Mechanism.from_function(
        lambda x, p: [x.y - np.sqrt(x.q + p.c)],
        {"q": "m", "y": "m"},
        {"c": (0.5, "m")},
        outputs=("y",),
    )
    q = np.random.default_rng(1).permutation(np.linspace(0.3, 1.0, 20))
    noise = lc.Noise({"q": 1e-4, "y": 1e-4})
    result = lc.calibrate(machine, {"q": q, "y": np.sqrt(q + 0.5)}, noise=noise)
    known = replace(Calibrated.of(result, "A"), nominal=np.array([-0.9]))
    later = q + 0.01
    found = verify(known, {"q": later, "y": np.sqrt(later + 0.5)})
    assert found.nominal is None
    assert found.calibrated is not None
    assert found.verdict["better"].code == "nominal-not-placed"
    assert "The nominal machine cannot be placed" in str(found)
    assert found.verdict["consistent"].passed


def test_a_platform_is_verified_with_a_draw_wire() -> None:
    """The anchor stands elsewhere; then the joint of a leg moves by 1 mm."""
    made = run("platform draw-wire", range(1))
    assert made.unchanged[0] > 0.01
    assert made.moved[0] < 1e-6


def test_the_errors_of_few_poses_vary_with_the_freedom_that_their_placement_leaves() -> None:
    """Two poses of a plane have four equations, and their placement takes up three."""
    arm = planar_arm(300)
    sds = {q: 1e-4 if q in arm.truth.outputs else 1e-7 for q in arm.truth.quantities}
    noise = lc.Noise(sds)
    result = lc.calibrate(arm.truth, arm.read(sds, 1), noise=noise, method="implicit-loop")
    day = elsewhere(arm, 5, 2).read(sds, 2)
    linear = Day.of(Calibrated.of(result, ""), day, None).linearised()
    assert (len(linear.e), linear.rank) == (4, 3)
    expected, chance = errors_expected(linear, None)
    assert expected is not None
    for p, quantile in ((0.5, 0.455), (0.2, 1.642), (0.05, 3.841)):  # chi-squared of 1
        drawn = chance(expected.rms * np.sqrt(quantile))
        assert abs(drawn - p) < 3.0 * np.sqrt(p * (1.0 - p) / 200)


def test_parameters_that_are_known_exactly_are_no_obstacle() -> None:
    arm = planar_arm(40)
    prior = lc.Prior({"l2": 0.0})
    result = lc.calibrate(
        arm.truth,
        arm.read(sds_of(arm), 1),
        noise=lc.Noise(sds_of(arm)),
        prior=prior,
        method="implicit-loop",
    )
    assert (
        lc.verify(result, elsewhere(arm, 5, 30).read(sds_of(arm), 2)).verdict["consistent"].passed
    )


def test_what_was_remounted_and_what_is_named_anew_are_both_found() -> None:
    given = setup("six-axis spherical")
    both = freed(given.truth, (*mounted(given.truth), "d_6"))
    assert {"tool_x", "tool_y", "tool_z", "d_6", "T_x"} <= {*both}


def test_readings_of_their_own_sd_are_judged_by_the_sd_that_was_learnt():
    """A tracker states micrometres, the calibration has learnt a tenth of a millimetre."""
    arm = lc.planar_two_link()
    poses = lc.grid_poses({"phi2": (0.2, 1.8, 6), "phi3": (0.5, 1.5, 5)})
    noise = lc.Noise({"phi*": 5e-5, "?P": 1e-4})
    made = lc.simulate(arm, poses, noise=noise, seed=5)
    learnt = lc.Noise({"phi*": 5e-5, "?P": 1e-4}, estimate={"?P": "group"})
    known = Calibrated.of(lc.calibrate(arm, made.dataset, noise=learnt, method="implicit-loop"), "")
    tiny = {q: np.full(len(made.dataset), 1e-6) for q in ("xP", "yP", "phi2")}
    assert set(as_learnt(known, replace(made.dataset, sds=tiny)).sds) == {"phi2"}
    del tiny["phi2"]
    own, none = (replace(made.dataset, sds=sds) for sds in (tiny, {}))
    assert verify(known, own).innovation == verify(known, none).innovation


def test_components_that_nothing_tells_apart_are_sure_together() -> None:
    """White noise of the instrument and of the model: stated sds part them, and how large their
    sum is is known no less than where there is one of them."""
    arm = planar_arm(40)
    outputs = tuple(arm.truth.outputs)
    learnt: dict[str | tuple[str, ...], str] = {outputs: "group"}
    both = lc.Noise(sds_of(arm) | {"model": 1e-4}, estimate={**learnt, "model": "group"})
    alone = lc.Noise(sds_of(arm), estimate=learnt)
    data = arm.read(sds_of(arm), 1)
    day = elsewhere(arm, 7, 30).read(sds_of(arm), 8)
    freedoms = []
    for noise in (both, alone):
        result = lc.calibrate(arm.truth, data, noise=noise, start="nominal", method="implicit-loop")
        freedoms.append(lc.verify(result, day).innovation.learnt_freedom)
    assert freedoms[0] == pytest.approx(freedoms[1], rel=0.05)


@pytest.mark.parametrize(
    ("sound", "code", "passed"),
    [
        (True, "unchanged", True),
        (None, "calibration-open", True),
        (False, "calibration-not-sound", None),
    ],
)
def test_the_verdict_of_the_calibration_stands_beside_the_answer(
    sound: bool | None, code: str, passed: bool | None, tmp_path: Path
) -> None:
    arm = planar_arm(12)
    calibrated(arm, 0, 12, estimate=False).save(tmp_path, report=False)
    document = json.loads((tmp_path / "result.json").read_text())
    document["verdict"]["sound"] |= {"passed": sound, "words": "Something drifted."}
    (tmp_path / "result.json").write_text(json.dumps(document))
    day = elsewhere(arm, 1000, 30).read(sds_of(arm), 5000)
    consistent = lc.verify(tmp_path, day).verdict["consistent"]
    assert (consistent.passed, code in consistent.codes) == (passed, True)
    assert ("Something drifted." in consistent.words) == (sound is not True)
