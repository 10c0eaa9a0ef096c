"""A file that is at fault as a whole is named before any fit, and a good one never."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import loopcal as lc
from analyses.file_faults import FAULTS, GOOD, ROUGH, draw
from analyses.instruments import setup
from analyses.trees import ARM as LIMB
from analyses.trees import HEADER, limb, named, off, placed, read, table, tracked
from loopcal.estimation.faults.misfit import _Linear, _scales, beside, misfit, missed
from loopcal.estimation.faults.repairs import repairs
from loopcal.estimation.faults.search import (
    NEAR,
    PLAUSIBLE,
    _File,
    _thinned,
    column_faults,
    suspicious,
)
from loopcal.estimation.steps import started
from loopcal.mechanisms.instruments.pose import pose
from loopcal.mechanisms.machine import assemble
from tests.reference.robots import urdf_of
from tests.reference.verdicts import verdict_of
from tests.statistics.test_change_points import ARM, NOISE, joints

SPATIAL = {
    "left-handed frame": "six-axis point",
    "quaternion x, y, z, w": "six-axis pose",
    "inverse pose": "six-axis pose",
    "three joints reversed": "six-axis draw-wire",
    "last joint reversed": "six-axis point",
    "z constant": "six-axis point",
}
"""Faults that take more than a planar arm."""


@pytest.mark.parametrize("fault", [f for f in FAULTS if f != "two joints exchanged"])
def test_a_fault_of_the_whole_file_is_named(fault: str) -> None:
    found = draw(setup(SPATIAL.get(fault, "two-link point")), fault, 3)
    assert {*found.codes} & {*FAULTS[fault].codes}, found.words


@pytest.mark.parametrize(
    ("columns", "signs", "words"),
    [
        (("qx", "qw"), (1.0, 1.0), "have qw and qx exchanged"),
        (("qy", "qz"), (1.0, 1.0), "have qy and qz exchanged"),
        (("qy", "qy"), (-1.0, -1.0), "the orientations in qw, qx, qy and qz do not"),
    ],
)
def test_orientations_that_do_not_fit_their_points_are_no_shuffled_rows(
    columns: tuple[str, str], signs: tuple[float, float], words: str
) -> None:
    """Two columns of a quaternion in each other's place were "shuffled rows, or ids"."""
    given = setup("six-axis pose")
    made = lc.simulate(given.truth, given.driven, noise=given.noise, seed=3)
    readings, (one, other) = dict(made.dataset.readings), columns
    readings |= {one: signs[0] * readings[other], other: signs[1] * readings[one]}
    problem = started(given.nominal(3), lc.Dataset.from_arrays(readings), given.noise, "auto")
    (fault,) = column_faults(problem)
    assert fault.code == "orientation"
    assert words in fault.words


@pytest.mark.parametrize("name", ["six-axis draw-wire", "six-axis pose", "two-link point"])
@pytest.mark.parametrize("drawing", [GOOD, ROUGH])
def test_a_good_file_is_not_blamed_even_beside_a_rough_drawing(name: str, drawing: str) -> None:
    assert draw(setup(name), drawing, 1).codes == ()


def test_a_search_on_good_readings_finds_nothing() -> None:
    """The suspicion is not what keeps good files safe."""
    given = setup("six-axis draw-wire")
    made = lc.simulate(given.truth, given.driven, noise=given.noise, seed=4, start=given.start)
    nominal = given.nominal(4)
    held = nominal.with_parameters(nominal.parameters.with_fixed(given.held))
    problem = started(held, made.dataset, given.noise, "auto")
    assert column_faults(problem) == column_faults(problem, suspected=False) == ()


@pytest.mark.parametrize("fault", [GOOD, "joints in gon, declared deg", "readings one row late"])
def test_a_coarse_sensor_is_no_fault_of_the_file_and_hides_none(fault: str) -> None:
    """The drawing misses by a tenth of the spread, as 0.1 rad of the second joint say it must."""
    given = setup("two-link point")
    noise = lc.Noise({q: 0.1 if q == "phi3" else 1e-4 for q in given.truth.quantities})
    made = lc.simulate(given.truth, given.driven, noise=noise, seed=2)
    readings = dict(made.dataset.readings)
    if fault in FAULTS:
        FAULTS[fault].change(readings, ["phi2", "phi3"], np.random.default_rng(0))
    problem = started(given.nominal(2), made.dataset.with_readings(readings), noise, "auto")
    assert misfit(problem).share > 3 * NEAR
    assert suspicious(problem) is (fault != GOOD)
    assert suspicious(problem, stated=False)  # learnt sds may begin anywhere


def test_a_misfit_has_no_unit_of_length() -> None:
    """Machine and readings a thousand times smaller: the same share."""
    given = setup("two-link point")
    made = lc.simulate(given.truth, given.driven, noise=given.noise, seed=1)
    small = {p.name: p.nominal * (1e-3 if p.unit == "m" else 1.0) for p in given.truth.parameters}
    readings = {
        q: v * (1e-3 if given.truth.quantities[q] == "m" else 1.0)
        for q, v in made.dataset.readings.items()
    }
    nominal = given.nominal(1)
    far = {n: nominal.parameters[n].nominal - given.truth.parameters[n].nominal for n in small}
    shrunk = given.truth.with_nominal(
        {
            n: v + far[n] * (1e-3 if given.truth.parameters[n].unit == "m" else 1.0)
            for n, v in small.items()
        }
    )
    one = misfit(started(nominal, made.dataset, given.noise, "auto")).share
    other = misfit(started(shrunk, lc.Dataset.from_arrays(readings), given.noise, "auto")).share
    assert other == pytest.approx(one, rel=1e-3)


@pytest.mark.parametrize("share", ["last half", "some"])
def test_rows_in_another_unit_are_named(share: str) -> None:
    """A file put together from two programs, or typed in by two people."""
    given = setup("six-axis spherical")
    made = lc.simulate(given.truth, given.driven, noise=given.noise, seed=2)
    count = len(made.dataset)
    some = np.arange(count) >= count // 2
    if share == "some":
        some = np.random.default_rng(0).random(count) < 0.3
    read = dict(made.dataset.readings)
    axes = [q for q in given.truth.outputs if given.truth.quantities[q] == "m"]
    readings = read | {q: np.where(some, read[q] / 25.4, read[q]) for q in axes}
    problem = started(given.nominal(2), lc.Dataset.from_arrays(readings), given.noise, "auto")
    (fault,) = column_faults(problem, suspected=False)
    assert fault.code == "unit"
    assert f"in inches, taken as millimetres in {some.sum()} poses" in fault.words


@pytest.mark.parametrize("share", ["last half", "some"])
def test_rows_whose_joints_are_in_another_unit_are_named(share: str) -> None:
    """It was called an instrument that moved by 440 mm and turned by 30 deg."""
    truth = ARM
    made = lc.simulate(truth, joints(60, 4), noise=NOISE, seed=4)
    some = np.arange(60) >= 30
    if share == "some":
        some = np.random.default_rng(0).random(60) < 0.3
    read = dict(made.dataset.readings)
    readings = read | {q: np.where(some, np.degrees(read[q]), read[q]) for q in truth.joints}
    problem = started(truth, lc.Dataset.from_arrays(readings), NOISE, "auto")
    (fault,) = column_faults(problem, suspected=False)
    assert fault.code == "unit"
    assert f"in degrees, taken as radians in {some.sum()} poses" in fault.words


@pytest.mark.parametrize("held", [slice(11, 19), slice(36, 60)])
def test_readings_that_were_not_taken_again_are_named(held: slice) -> None:
    """The instrument lost its target and repeated its last reading: it was called another load."""
    made = lc.simulate(ARM, joints(60, 4), noise=NOISE, seed=4)
    readings = {q: v.copy() for q, v in made.dataset.readings.items()}
    for q in "xyz":
        readings[q][held] = readings[q][held.start - 1]
    problem = started(ARM, lc.Dataset.from_arrays(readings), NOISE, "auto")
    (fault,) = column_faults(problem)
    assert fault.code == "constant"
    assert fault.quantities == ("x", "y", "z")
    assert f"in {held.stop - held.start} of 60 poses" in fault.words


def test_learnt_sds_are_not_sought_in_a_file_at_fault_and_every_face_says_so() -> None:
    given = setup("two-link point")
    made = lc.simulate(given.truth, given.driven, noise=given.noise, seed=2)
    readings = dict(made.dataset.readings)
    readings |= {q: np.roll(readings[q], 1) for q in ("x", "y")}
    noise = lc.Noise({"phi?": 5e-5, "xy": 2e-5}, estimate={"phi?": "group", "xy": "group"})
    result = lc.calibrate(given.nominal(2), readings, noise=noise, method="implicit-loop")
    assert result.estimate is None
    assert result.status.iterations <= 3
    assert result.status.reason == "file_at_fault"  # not the limit that a user could raise
    assert not result.status.converged
    assert [fault.code for fault in result.faults] == ["rows-shifted"]
    assert lc.find_outliers(result).columns == result.faults
    assert "\nFILE AT FAULT" in str(result.document)
    assert verdict_of(result.document).grade == "bad"


def test_the_measured_grid_displaced_or_in_another_unit_is_named(
    shared_data: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = shared_data("motoman_ma1400_leica/left_arm_grid.csv")
    monkeypatch.setenv("LOOPCAL_DATA", str(path.parents[1]))
    read = lc.read_project("examples/motoman/left_arm_grid.toml")
    data = lc.load_dataset(read)
    readings = dict(data.dataset.readings)
    readings |= {q: np.roll(readings[q], 1) for q in "xyz"}
    moved = replace(data.dataset, readings=readings)
    problem = started(read.mechanism, moved, data.noise, "auto")
    faults = column_faults(problem, suspected=False)
    assert [fault.code for fault in faults] == ["rows-shifted"]
    scaled = dict(data.dataset.readings) | {q: 1e-3 * data.dataset.readings[q] for q in "xyz"}
    problem = started(read.mechanism, replace(data.dataset, readings=scaled), data.noise, "auto")
    assert [fault.code for fault in column_faults(problem)] == ["unit"]


@pytest.mark.parametrize(
    ("fault", "code"),
    [
        (GOOD, None),
        ("quaternion x, y, z, w", "orientation"),
        ("inverse pose", "pose-inverted"),
    ],
)
def test_poses_of_a_measured_camera_whose_mounting_is_unknown(
    shared_data: Callable[[str], Path], fault: str, code: str | None
) -> None:
    path = shared_data("franka_camera/poses.csv")
    machine = lc.machines.urdf(urdf_of("Panda"), "panda_link0", "panda_link8")
    arm = lc.fix_redundant(assemble(machine, [pose("camera", target="camera")]))
    joints = [f"panda_joint{i}" for i in range(1, 8)]
    named = {joint: f"q{i}" for i, joint in enumerate(joints, 1)}
    named |= {name: name for name in ("x", "y", "z", "qw", "qx", "qy", "qz")}
    readings = dict(lc.read_dataset(path, named, pose="pose").readings)
    if fault in FAULTS:
        FAULTS[fault].change(readings, joints, np.random.default_rng(0))
    noise = lc.Noise({"panda_joint*": 1e-4, "xyz": 1e-3, "camera_w*": 2e-3})
    problem = started(arm, lc.Dataset.from_arrays(readings), noise, "auto")
    faults = column_faults(problem, suspected=False)
    assert [f.code for f in faults] == ([] if code is None else [code])


def hardly_moving(factor: float) -> lc.Result:
    """Joint 6 moves by 0.03 rad, and its readings are multiplied: 1 % of the spread at most."""
    rng = np.random.default_rng(2)
    poses = {**joints(60, 2), "theta_6": rng.normal(0.0, 0.03, 60)}
    data = lc.simulate(ARM, poses, noise=NOISE, seed=2).dataset
    wrong = data.with_readings({"theta_6": factor * data["theta_6"]})
    return lc.calibrate(ARM, wrong, noise=NOISE, start="nominal", method="least-squares")


@pytest.mark.parametrize(("factor", "codes"), [(1.0, []), (-1.0, ["reversed"])])
def test_a_fault_within_what_a_drawing_may_miss_is_found_after_the_fit(
    factor: float, codes: list[str]
) -> None:
    problem = hardly_moving(factor).problem
    assert misfit(problem).share < NEAR
    assert column_faults(problem, suspected=False) == ()
    assert [fault.code for fault in column_faults(problem)] == codes


def test_near_the_drawing_one_step_leaves_what_a_fit_leaves() -> None:
    wrong = hardly_moving(-1.0).problem
    share = beside(wrong)
    right = replace(wrong, readings=hardly_moving(1.0).problem.readings)
    assert share(wrong) == pytest.approx(misfit(wrong).share, rel=0.02)
    # what is left is of second order in the fault
    assert abs(share(right) - misfit(right).share) < 0.01 * misfit(wrong).share


def test_a_loop_without_a_derivative_has_no_part_in_the_step() -> None:
    """A distance of zero: LAPACK of 2024 refuses what later ones return."""
    machine = lc.Mechanism.from_function(
        lambda x, p: [x.d - np.sqrt((x.a - p.c) ** 2)],
        {"a": "m", "d": "m"},
        {"c": (1.0, "m")},
        outputs=("d",),
    )
    a = np.array([0.0, 0.5, 1.0, 2.0, 3.0])
    data = lc.Dataset.from_arrays({"a": a, "d": np.abs(a - 1.3)})
    problem = started(machine, data, lc.Noise({"*": 1e-4}), "auto")
    steps = _Linear.at(problem, problem.start, ("c",), _scales(problem))
    assert not np.isfinite(steps.columns[2]).all()
    assert steps.step(steps.loops, np.arange(5)) == pytest.approx([0.3], rel=0.5)
    assert isinstance(missed(problem, NEAR, noisy=True), bool)


def test_hands_that_are_exchanged_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two arms, a tracker that sees both: no column is at fault alone, and no pose is tested."""
    monkeypatch.setattr("loopcal.statistics.findings.find_poses", None)
    random = np.random.default_rng(3)
    hand = (0.02, 0.12, 0)
    left, lines = limb("l", (90.0, 0.3, 0.4), (*LIMB, hand))
    right, more = limb("r", (0.0, 0.4, 0.5), (*LIMB, hand))
    (tmp_path / "bodies.csv").write_text("\n".join([HEADER, *lines, *more]) + "\n", "utf-8")
    columns: dict[str, NDArray[np.float64]] = {}
    T, target = placed([1.5, -2.0, 0.3], [0.1, 0.2, 0.3]), np.array([0.0, 0.0, 0.05, 1.0])
    for one, name in ((off(left, random), "r"), (off(right, random), "l")):  # exchanged
        q = random.uniform(-1.4, 1.4, (40, 6))
        columns |= read(random, (one, q))
        seen = tracked(T, one, q, target)
        columns |= named(name, seen + random.normal(0.0, 2e-5, seen.shape))
    (tmp_path / "seen.csv").write_text(table(columns), "utf-8")
    observe = [f"point name={n} on={n}_6 station=at columns={n}_x,{n}_y,{n}_z" for n in "lr"]
    lc.init(tmp_path / "seen.csv", dh=tmp_path / "bodies.csv", observe=observe, out=tmp_path / "p")
    result = lc.calibrate(tmp_path / "p" / "project.toml", method="implicit-loop")
    (fault,) = result.document.column_faults or ()
    assert (fault.code, len(fault.quantities)) == ("exchanged", 6)
    assert fault.words == "the readings of 'l' and 'r' are exchanged"


@pytest.mark.parametrize("reversed_", [False, True])
def test_a_repair_is_passed_over_only_where_what_it_leaves_alone_misses_too_much(
    tmp_path: Path, reversed_: bool
) -> None:
    """Two arms off their drawings: no column of one arm explains what the other misses."""
    random = np.random.default_rng(5)
    columns: dict[str, NDArray[np.float64]] = {}
    lines: list[str] = []
    for name, foot in (("l", (90.0, 0.3, 0.4)), ("r", (0.0, 0.4, 0.5))):
        drawn, more = limb(name, foot, (*LIMB, (0.02, 0.12, 0)))
        lines += more
        rough = off(drawn, random)
        rough = replace(rough, rows=drawn.rows + 4.0 * (rough.rows - drawn.rows))
        q = random.uniform(-1.4, 1.4, (60, 6))
        columns |= read(random, (rough, q))
        target = np.array([0.0, 0.0, 0.05, 1.0])
        columns |= named(name, tracked(placed([1.5, -2.0, 0.3], [0.1, 0.2, 0.3]), rough, q, target))
    (tmp_path / "bodies.csv").write_text("\n".join([HEADER, *lines]) + "\n", "utf-8")
    if reversed_:
        columns["r6"] = -columns["r6"]
    (tmp_path / "seen.csv").write_text(table(columns), "utf-8")
    observe = [f"point name={n} on={n}_6 station=at columns={n}_x,{n}_y,{n}_z" for n in "lr"]
    lc.init(tmp_path / "seen.csv", dh=tmp_path / "bodies.csv", observe=observe, out=tmp_path / "p")
    project = lc.read_project(tmp_path / "p" / "project.toml")
    data = lc.load_dataset(project)
    problem = started(project.mechanism, data.dataset, data.noise, "auto")
    file = _File(problem, stated=False)
    assert NEAR < file.left <= PLAUSIBLE
    every = list(repairs(problem))
    passed = [repair for repair in every if not file.may_mend(repair)]
    assert len(passed) > len(every) / 3
    for repair in passed[::15]:
        assert misfit(_thinned(repair.problem, 120)).share > file.limit


@pytest.mark.parametrize("share", ["last half", "some"])
def test_rows_whose_slides_are_in_another_unit_are_named(share: str) -> None:
    given = setup("platform pose")
    made = lc.simulate(given.truth, given.driven, noise=given.noise, seed=2)
    read, count = dict(made.dataset.readings), len(made.dataset)
    some = np.arange(count) >= count // 2
    if share == "some":
        some = np.random.default_rng(0).random(count) < 0.3
    legs = [q for q in read if q.startswith("leg_")]
    readings = read | {q: np.where(some, 1e-3 * read[q], read[q]) for q in legs}
    problem = started(given.nominal(2), lc.Dataset.from_arrays(readings), given.noise, "auto")
    (fault,) = column_faults(problem, suspected=False)
    assert fault.code == "unit"
    assert f"in metres, taken as millimetres in {some.sum()} poses" in fault.words
