"""The instrument is placed where it stands, whatever the motion; what cannot be placed says so."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import loopcal as lc
from loopcal.errors import Code
from loopcal.estimation.calibrate import calibrate
from loopcal.estimation.prediction import predict_outputs
from loopcal.estimation.problem.alignment import align, align_most, can_be_placed
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.prior import Prior
from tests.reference.four_bars import passive
from tests.reference.machines import MACHINES
from tests.reference.simulated import arm_at, ma1400, planar_arm
from tests.refusals import refused

Array = NDArray[np.float64]
SHIFTS = st.lists(st.floats(-10, 10), min_size=3, max_size=3).map(np.array)
QUATERNIONS = (
    st.lists(st.floats(-1, 1), min_size=4, max_size=4)
    .map(np.array)
    .filter(lambda q: np.linalg.norm(q) > 0.1)
)
POINTS = np.random.default_rng(1).normal(size=(3, 20))


@given(QUATERNIONS, SHIFTS)
def test_a_rigid_motion_is_recovered(quaternion: Any, shift: Any) -> None:
    rotation = Rotation.from_quat(quaternion).as_matrix()
    found = align(POINTS, rotation @ POINTS + shift[:, None])
    assert found.rotation == pytest.approx(rotation, abs=1e-13)
    assert found.shift == pytest.approx(shift, abs=1e-13)
    assert found.rms <= 1e-13


@given(st.floats(-math.pi, math.pi), SHIFTS)
def test_so_it_is_in_the_plane(angle: float, shift: Any) -> None:
    c, s = math.cos(angle), math.sin(angle)
    rotation = np.array([[c, -s], [s, c]])
    found = align(POINTS[:2], rotation @ POINTS[:2] + shift[:2, None])
    assert found.rotation == pytest.approx(rotation, abs=1e-13)
    assert found.shift == pytest.approx(shift[:2], abs=1e-13)


@pytest.mark.parametrize("size", [1.0, 1e3, 1e9, 1e200])
def test_gross_errors_do_not_place_the_instrument(size: float) -> None:
    rotation = Rotation.from_euler("xyz", [0.4, -1.0, 2.0]).as_matrix()
    targets = rotation @ POINTS + 1.0
    targets[1, 3] += size
    found = align_most(POINTS, targets)
    assert found.rotation == pytest.approx(rotation, abs=1e-12)
    assert found.shift == pytest.approx(np.ones(3), abs=1e-12)


def test_scatter_as_of_noise_counts_in_full() -> None:
    targets = POINTS + 0.01 * np.random.default_rng(2).normal(size=POINTS.shape)
    assert align_most(POINTS, targets).rms == align(POINTS, targets).rms


def test_points_not_measured_do_not_count() -> None:
    rotation = Rotation.from_euler("xyz", [0.4, -1.0, 2.0]).as_matrix()
    targets = rotation @ POINTS + 1.0
    targets[1, 3] = targets[0, 7] = np.nan
    computed = POINTS.copy()
    computed[2, 11] = np.nan
    found = align(computed, targets)
    assert found.rotation == pytest.approx(rotation, abs=1e-13)


def test_points_in_a_plane_determine_a_rotation_and_never_a_reflection() -> None:
    flat = POINTS * np.array([[1.0], [1.0], [0.0]])
    rotation = Rotation.from_euler("xyz", [0.4, -1.0, 2.0]).as_matrix()
    assert align(flat, rotation @ flat).rotation == pytest.approx(rotation, abs=1e-13)


@given(QUATERNIONS)
def test_mirrored_points_are_met_by_the_best_rotation(quaternion: Any) -> None:
    mirror = np.diag([1.0, 1.0, -1.0])
    targets = Rotation.from_quat(quaternion).as_matrix() @ mirror @ POINTS
    found = align(POINTS, targets)
    assert np.linalg.det(found.rotation) == pytest.approx(1.0, abs=1e-12)
    # scipy's solution of the same problem, centred
    centred = POINTS - POINTS.mean(axis=1, keepdims=True)
    best, rssd = Rotation.align_vectors(
        (targets - targets.mean(axis=1, keepdims=True)).T, centred.T
    )
    assert found.rotation == pytest.approx(best.as_matrix(), abs=1e-9)
    assert found.rms == pytest.approx(rssd / math.sqrt(20), rel=1e-9)


def test_it_is_the_least_squares_motion_of_noisy_points() -> None:
    targets = POINTS + 0.1 * np.random.default_rng(2).normal(size=POINTS.shape)
    found = align(POINTS, targets)

    def square(rotation: Array, shift: Array) -> float:
        return float(np.square(rotation @ POINTS + shift[:, None] - targets).sum())

    least = square(found.rotation, found.shift)
    assert found.rms == pytest.approx(math.sqrt(least / 20))
    for small in 1e-4 * np.random.default_rng(3).normal(size=(50, 6)):
        other = Rotation.from_rotvec(small[:3]).as_matrix() @ found.rotation
        assert square(other, found.shift + small[3:]) >= least


@pytest.mark.parametrize(
    ("points", "code", "stated"),
    [
        (np.outer([1.0, 2.0, 3.0], np.arange(10.0)), "too-few-poses", ()),
        (np.ones((3, 10)), "too-few-poses", ()),
        (np.where(np.arange(20) < 2, POINTS, np.nan), "too-few-poses", ("2",)),
    ],
)
def test_points_that_do_not_show_how_the_instrument_stands_are_refused(
    points: Array, code: Code, stated: tuple[str, ...]
) -> None:
    with refused(code, *stated):
        align(points, points)


@pytest.mark.parametrize("name", ["MA1400", "dh"])
@pytest.mark.parametrize("seed", range(5))
def test_a_machine_seen_from_anywhere_is_placed_before_the_fit(name: str, seed: int) -> None:
    """Nobody has to guess the tracker's placement: the readings of a moved machine suffice."""
    rng = np.random.default_rng(seed)
    machine = MACHINES[name]
    joints = rng.uniform(-1.5, 1.5, (6, 40))
    here = arm_at(machine, joints)
    # about the upright: transitions need their axes to meet their planes
    rotation = Rotation.from_euler("zyx", [rng.choice([0.0, math.pi]), 0.2, 0.3]).as_matrix()
    shift = rng.uniform(-5, 5, 3)
    point = rotation @ np.array([here.exact[a] for a in "xyz"]) + shift[:, None]
    noise = 1e-4 * rng.normal(size=(9, 40))
    noisy = {q: v + e for (q, v), e in zip(here.exact.items(), noise, strict=True)}
    noisy |= {a: v + e for a, v, e in zip("xyz", point, noise[:3], strict=True)}
    data = Dataset.from_arrays(noisy)
    prior = {p.name: 1e-3 for p in machine.parameters}
    assert machine.placement is not None
    prior |= dict.fromkeys(machine.placement.parameters, math.inf)
    result = calibrate(machine, data, noise=Noise({"*": 1e-4}), prior=Prior(prior))
    assert result.status.converged
    assert result.accuracy_before is not None
    assert result.accuracy_before.rms < 2e-3
    assert result.chi_squared is not None
    assert (result.chi_squared.p_value or 0.0) > 1e-4


def test_placed_by_hand_is_placed_by_alignment() -> None:
    simulated = planar_arm(40)
    turned = 2.5
    c, s = math.cos(turned), math.sin(turned)
    R = np.array([[c, -s], [s, c]])
    data = simulated.read(dict.fromkeys(simulated.exact, 1e-4), seed=1)
    x, y = R @ np.array([data["xP"], data["yP"]]) + np.array([[3.0], [-2.0]])
    seen = data.with_readings({"xP": x, "yP": y})
    noise = Noise({"*": 1e-4})
    result = calibrate(simulated.truth, seen, noise=noise, start="align")
    plain = calibrate(simulated.truth, data, noise=noise, start="nominal")
    assert result.status.converged
    for name in ("l2", "l3", "phi30"):
        assert result.value[name] == pytest.approx(plain.value[name], rel=1e-9)
    assert result.mechanism.parameters["xA"].nominal == pytest.approx(3.0, abs=0.1)


def test_the_start_is_moved_only_where_the_placement_is_free_and_flat() -> None:
    machine = MACHINES["dh"]
    parameters = machine.parameters
    assert can_be_placed(machine)
    fixed = machine.with_parameters(parameters.with_fixed(["base_rz"]))
    assert not can_be_placed(fixed)
    known = machine.with_parameters(parameters.with_prior({"base_x": 0.1}))
    assert not can_be_placed(known)
    assert not can_be_placed(passive().truth)


@pytest.mark.parametrize("turn", [-3.0, -2.0, -0.6, 0.7, 1.6, 3.1])
def test_an_arm_in_the_plane_that_is_turned_away_is_not_found_mirrored(turn: float) -> None:
    truth = {"xA": 1.0, "yA": 0.5, "phi20": turn, "l2": 0.8004}
    arm = lc.planar_two_link()
    poses = lc.random_poses({"phi2": (-1.5, 1.5), "phi3": (0.3, 2.0)}, 30, seed=4)
    noise = Noise({"?P": 2e-5, "phi?": 3e-5})
    readings = lc.simulate(arm, poses, noise=noise, seed=5, truth=truth).dataset
    result = calibrate(arm, readings, noise=noise)
    for name, value in truth.items():
        sd = result.sd[name]
        assert sd is not None
        assert abs(result.value[name] - value) < 5.0 * sd


def test_a_start_by_hand_is_kept() -> None:
    simulated = ma1400(30)
    data = simulated.read()
    at_start = calibrate(
        simulated.truth, data, method="least-squares", start={"x0": 0.5}, max_iterations=0
    )
    assert at_start.value["x0"] == 0.5
    assert at_start.value["z2"] == simulated.values["z2"]


def test_what_cannot_be_placed_says_so() -> None:
    simulated = passive()
    data = simulated.read()
    noise = Noise({"crank": 1e-3, "rocker": 1e-3, "coupler": math.inf})
    with refused("unsupported", "'passive coupler'"):
        calibrate(simulated.truth, data, noise=noise, start="align")


# prediction


@pytest.mark.parametrize("name", MACHINES)
def test_an_arm_predicts_its_end_point(name: str) -> None:
    machine = MACHINES[name]
    count = len(machine.quantities) - len(machine.outputs)
    simulated = arm_at(machine, np.random.default_rng(4).uniform(-3, 3, (count, 30)))
    readings = np.array([simulated.exact[q] for q in machine.tape.quantities])
    rows = [machine.tape.quantities.index(q) for q in machine.outputs]
    expected = readings[rows].copy()
    readings[rows] = 0.0
    p = np.array([parameter.nominal for parameter in machine.parameters])
    found = predict_outputs(machine, p, readings, np.zeros((0, 30)))
    assert found == pytest.approx(expected, abs=1e-13)


def test_an_output_hidden_in_a_loop_is_found_by_newton() -> None:
    """Where it does not stand alone in its equation: the length of a wire, solved for its angle."""
    machine = Mechanism.from_function(
        lambda x, p: (np.hypot(p.a - p.b * np.cos(x.q), p.b * np.sin(x.q)) - x.wire,),
        {"q": "rad", "wire": "m"},
        {"a": (1.0, "m"), "b": (0.4, "m")},
        outputs=("q",),
    )
    q = np.linspace(0.3, 2.8, 25)
    wire = np.hypot(1.0 - 0.4 * np.cos(q), 0.4 * np.sin(q))
    found = predict_outputs(
        machine, np.array([1.0, 0.4]), np.array([q + 0.1, wire]), np.zeros((0, 25))
    )
    assert found[0] == pytest.approx(q, abs=1e-12)


def test_where_no_output_closes_the_loop_there_is_none() -> None:
    machine = Mechanism.from_function(
        lambda x, p: (np.hypot(p.a - p.b * np.cos(x.q), p.b * np.sin(x.q)) - x.wire,),
        {"q": "rad", "wire": "m"},
        {"a": (1.0, "m"), "b": (0.4, "m")},
        outputs=("q",),
    )
    found = predict_outputs(
        machine, np.array([1.0, 0.4]), np.array([[1.0, 1.0], [0.9, 5.0]]), np.zeros((0, 2))
    )
    assert np.isfinite(found[0, 0])
    assert np.isnan(found[0, 1])
