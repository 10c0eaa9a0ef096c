"""Contacts and orientations: implied readings, lost ones, several sockets, and no length at all."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import loopcal as lc
from analyses import trees
from analyses.instruments import (
    ARM_VALUES,
    JOINTS,
    LAST,
    SIZE,
    Setup,
    at,
    setup,
    six_axis,
    touching,
)
from loopcal.estimation.faults.repairs import repairs
from loopcal.estimation.problem.constants import constants_by_pose, with_implied
from loopcal.estimation.steps import started
from loopcal.mechanisms.instruments.contact import ball_bar, socket
from loopcal.mechanisms.instruments.point import point
from loopcal.mechanisms.instruments.pose import pose
from loopcal.mechanisms.machine import assemble
from loopcal.mechanisms.parallel.four_bar import four_bar
from loopcal.workflow.checking import run_check
from tests.refusals import refused

Array = NDArray[np.float64]
HELD = (*LAST, "d_1", "offset_1", SIZE)
NOISE = lc.Noise({"q*": 5e-5, "*_gap_*": 2e-5})
ELSEWHERE = (0.85, 0.86, 0.04, -0.60, -1.25, -0.33)


def simulated(given: Setup, seed: int) -> lc.Simulation:
    return lc.simulate(given.truth, given.driven, noise=NOISE, seed=seed, start=given.start)


def test_a_second_socket_tells_what_one_cannot() -> None:
    """23 parameters and 3 more, each socket's loops in its own poses only."""
    first = setup("six-axis socket")
    second = touching(
        lambda p: (socket("second"), at("second", *p)), 23, about=ELSEWHERE, solved=JOINTS[:3]
    )
    one, two = simulated(first, 3), simulated(second, 4)
    arm = assemble(six_axis(), [socket(), socket("second")], {**two.parameters, **one.parameters})
    arm = arm.with_parameters(arm.parameters.with_fixed(HELD))
    poses = len(one.dataset), len(two.dataset)
    joined = {q: np.concatenate([one.dataset[q], two.dataset[q]]) for q in JOINTS}
    for name, was in (("socket", (0.0, np.nan)), ("second", (np.nan, 0.0))):
        joined |= {f"{name}_gap_{a}": np.repeat(was, poses) for a in "xyz"}
    both = lc.calibrate(arm, joined, noise=NOISE, method="implicit-loop")
    held = first.truth.with_parameters(first.truth.parameters.with_fixed(HELD))
    alone = lc.calibrate(
        held, {q: one.dataset[q] for q in JOINTS}, noise=NOISE, method="implicit-loop"
    )
    assert both.identifiability.rank == len(both.estimated) == 26
    assert both.chi_squared is not None
    assert both.chi_squared.degrees_of_freedom == 3 * sum(poses) - 26
    assert 0.001 < (both.chi_squared.p_value or 0.0) < 0.999
    # twice the poses in one socket would leave 0.71
    better = [(both.sd[n] or 1.0) / (alone.sd[n] or 0.0) for n in alone.estimated]
    assert np.median(better) < 0.6
    for name in both.estimated:
        assert abs(both.value[name] - arm.parameters[name].nominal) < 5 * (both.sd[name] or 0.0)


def contact(*, fixed: tuple[str, ...] = (), bar: bool = False) -> lc.Mechanism:
    looking = [socket(), *([ball_bar()] if bar else [])]
    made = assemble(
        six_axis(), looking, ARM_VALUES | ({"bar_length": 0.5, "bar_x": 1.0} if bar else {})
    )
    return made.with_parameters(made.parameters.with_fixed(fixed))


def uncertain(mechanism: lc.Mechanism) -> lc.Mechanism:
    return mechanism.with_parameters(mechanism.parameters.with_prior({"bar_length": 1e-3}))


READINGS = {q: np.random.default_rng(i).uniform(-1, 1, 40) for i, q in enumerate(JOINTS)}


def test_a_machine_of_any_size_is_refused_and_a_length_is_named() -> None:
    with refused("unknown-size") as error:
        lc.calibrate(contact(), READINGS, noise=NOISE, method="implicit-loop")
    assert "say d_4 = { fixed = true }" in (error.value.remedy or "")


@pytest.mark.parametrize(
    ("mechanism", "readings"),
    [
        (contact(fixed=("a_2",)), READINGS),
        (contact(fixed=("bar_length",), bar=True), READINGS),
        (uncertain(contact(bar=True)), READINGS),
        (contact(), READINGS | {"socket_gap_x": np.full(40, 0.01)}),
    ],
    ids=["a link is held", "a bar is known", "a bar is uncertain", "gaps are measured"],
)
def test_a_length_that_is_known_sets_the_size(
    mechanism: lc.Mechanism, readings: dict[str, Array]
) -> None:
    noise = lc.Noise({"q*": 5e-5, "*_gap*": 2e-5})
    result = lc.calibrate(
        mechanism, readings, noise=noise, max_iterations=1, method="implicit-loop"
    )
    assert result.chi_squared is not None


def test_a_blank_orientation_leaves_the_position() -> None:
    arm = assemble(six_axis(), [pose(station=None)], ARM_VALUES)
    blank = np.full(4, np.nan)
    data = lc.Dataset.from_arrays(
        {**{q: np.zeros(4) for q in JOINTS}, **{a: np.zeros(4) for a in "xyz"}}
        | {"qw": np.array([1.0, np.nan, 2.0, 1.0]), "qx": np.array([0.0, 0.0, np.nan, 0.0])}
        | {"qy": np.zeros(4), "qz": np.zeros(4)}
    )
    implied = with_implied(arm, data)
    assert np.isnan(implied["pose_wx"]).tolist() == [False, True, True, False]
    known = constants_by_pose(arm, data)
    assert known[:, 1].tolist() == known[:, 2].tolist() == [1.0, 0.0, 0.0, 0.0]
    with refused("missing-reading", "'qw'"):
        constants_by_pose(arm, lc.Dataset.from_arrays(dict.fromkeys(JOINTS, blank)))


@pytest.mark.parametrize("form", ["quaternion", "rotation-vector", "rz ry rx", "rx ry rx"])
def test_simulated_orientations_are_off_by_their_noise(form: str) -> None:
    """What was read and what was true differ by the small turns that the simulation keeps."""
    arm = assemble(six_axis(), [pose(orientation=form)], ARM_VALUES)
    noise = lc.Noise({"q*": 0.0, "xyz": 0.0, "pose_w*": 1e-3})
    made = lc.simulate(arm, READINGS, noise=noise, seed=5)
    assert np.abs(made.dataset["pose_wx"]).max() < 1e-15
    off = np.array([made.quantities[f"pose_w{a}"] for a in "xyz"])
    assert off.std() == pytest.approx(1e-3, rel=0.2)
    # the loops close with the true turns beside the orientation that was read
    columns = {c: made.dataset[c] for c in arm.tape.pose_constants}
    again = lc.simulate(arm, READINGS | columns, noise=lc.Noise({"*": 0.0}), seed=0)
    assert np.array([again.quantities[f"pose_w{a}"] for a in "xyz"]) == pytest.approx(
        off, abs=1e-12
    )


def test_the_size_of_a_linkage_is_held_unless_something_tells_it() -> None:
    """Angles and gaps of 0 tell no size, nor a bar of unknown length; coordinates do."""
    for blind in (socket(dimension=2), ball_bar(dimension=2)):
        assert assemble(four_bar(), [blind]).parameters["a2_x"].fixed
    seen = assemble(four_bar(), [point(readings=("x", "y"), dimension=2)])
    assert not seen.parameters["a2_x"].fixed


def test_hands_that_only_touch_each_other_say_how_little_they_know_of_their_size(
    tmp_path: Path,
) -> None:
    """Poses left out are predicted, though few of them tell no size by themselves."""
    world = trees.touching(np.random.default_rng([0, 0]))
    (tmp_path / "bodies.csv").write_text(f"{world.bodies}\n", "utf-8")
    (tmp_path / "touch.csv").write_text(world.files["touch.csv"], "utf-8")
    cell = tmp_path / "cell"
    dh, touch = tmp_path / "bodies.csv", world.observe[:1]
    lc.init(tmp_path / "touch.csv", dh=dh, observe=touch, out=cell)
    project = cell / "project.toml"
    fit = 'fit = { method = "implicit-loop", validation = { folds = 5 } }\n\n[mechanism]\n'
    project.write_text(project.read_text("utf-8").replace("[mechanism]\n", fit, 1), "utf-8")
    document = lc.calibrate(project).document
    assert document.validation is not None
    assert not document.validation.failed
    (valid,) = (one for one in document.findings or () if one.question == "valid")
    assert valid.code == "near-poses-only"
    # The sd of (l . dl) / (l . l), by draws of the changes dl.
    names = document.covariance.names
    lengths = {p.name: p.value for p in document.parameters if p.unit == "m"}
    along = np.array([lengths.get(name, 0.0) for name in names])
    zero, C = np.zeros(len(names)), np.array(document.covariance.matrix, dtype=float)
    drawn = np.random.default_rng(0).multivariate_normal(zero, C, 20_000) @ along
    share = 100.0 * float(drawn.std()) / float(along @ along)
    (stated,) = re.findall(r"an sd of ([\d.]+) %", valid.words)
    assert float(stated) == pytest.approx(share, rel=0.05)


def test_a_plate_on_a_positioner_is_off_no_drawing_and_good_poses_are_good(tmp_path: Path) -> None:
    """Where it sits is found from its readings alone; what all poses leave to priors is no fault
    of these poses."""
    world = trees.KINDS["rail"](np.random.default_rng([0, 4]))
    (tmp_path / "bodies.csv").write_text(f"{world.bodies}\n", "utf-8")
    (tmp_path / "holes.csv").write_text(world.files["holes.csv"], "utf-8")
    cell, dh = tmp_path / "cell", tmp_path / "bodies.csv"
    lc.init(tmp_path / "holes.csv", dh=dh, observe=world.observe, out=cell)
    project = cell / "project.toml"
    document = lc.calibrate(project, method="implicit-loop").document
    assert "off-the-drawing" not in {one.code for one in document.findings or ()}
    assert document.mechanism is not None
    assert any("plate_x" in names for names in document.mechanism.unstated)
    checked = run_check(project).check
    # 7 turning joints and a slide, the plate seen as points (trees.md: 4 R + 2 P + 3)
    assert len(checked.superfluous) == len(document.covariance.names) - (4 * 8 + 2 + 3)
    assert checked.identifiability.condition_number == pytest.approx(138.0, rel=0.02)


def test_joints_that_hardly_move_are_no_repair_of_gaps() -> None:
    given = setup("six-axis socket")
    joints = {q: simulated(given, 3).dataset[q] for q in JOINTS}
    data = lc.Dataset.from_arrays(joints, units=dict.fromkeys(joints, "rad"))
    held = given.truth.with_parameters(given.truth.parameters.with_fixed(HELD))
    problem = started(held, data, NOISE, "implicit-loop")
    rows = [given.truth.tape.quantities.index(q) for q in JOINTS]
    travel = np.ptp(problem.readings[rows], axis=1)
    units = [one.problem for one in repairs(problem) if one.code == "unit"]
    assert units
    assert all((np.ptp(one.readings[rows], axis=1) >= travel).all() for one in units)
