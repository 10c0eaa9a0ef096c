"""What is mounted is found from the nominal machine alone, gross errors or not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from loopcal.estimation.mounted import (
    Bodies,
    _points,
    origin_rms,
    see_lengths,
    see_points,
    see_poses,
    two_targets,
)

N = 60


@pytest.fixture
def bodies() -> Bodies:
    rng = np.random.default_rng(0)
    return Bodies(Rotation.random(N, random_state=1).as_matrix(), rng.uniform(-1, 1, (N, 3)))


S = Rotation.from_euler("ZYX", [1.0, 0.2, -0.4]).as_matrix()
t = np.array([3.0, -1.0, 0.5])


def test_targets_of_points_are_found_beside_gross_errors(bodies: Bodies) -> None:
    targets = np.array([[0.1, -0.2, 0.3], [0.0, 0.05, 0.4]])
    measured = np.array([bodies.at(u) @ S.T + t for u in targets])
    measured[:, :5] += 0.3
    measured[0, 7, 1] = np.nan
    found = see_points(bodies, measured)
    assert found.targets == pytest.approx(targets, abs=1e-6)
    assert found.rms < 1e-6


def test_of_very_many_poses_some_decide_and_all_are_judged() -> None:
    many = 20_011
    rng = np.random.default_rng(3)
    turns = Rotation.random(many, random_state=4).as_matrix()
    bodies, u = Bodies(turns, rng.uniform(-1, 1, (many, 3))), np.array([0.1, -0.2, 0.3])
    measured = bodies.at(u) @ S.T + t + rng.normal(0.0, 1e-4, (many, 3))
    measured[7] += 0.3
    measured[8] = np.nan
    found = see_points(bodies, measured[None])
    assert found.targets[0] == pytest.approx(u, abs=5.0 * 1e-4 / np.sqrt(4_000 / 3))
    assert len(found.away) == many
    assert int(np.nanargmax(found.away)) == 7
    assert np.flatnonzero(np.isnan(found.away)).tolist() == [8]


def test_poses_that_hardly_turn_the_body_leave_what_is_mounted_near_it(bodies: Bodies) -> None:
    """The free fit takes up the machine's own errors, and puts the target far away."""
    turns = 0.05 * np.random.default_rng(2).normal(size=(N, 3))
    narrow = Bodies(Rotation.from_rotvec(turns).as_matrix(), 0.2 * bodies.origins)
    u = np.array([0.05, -0.03, 0.1])
    off = np.cross(turns, [0.9, -0.6, 0.4]) + 2e-3 * np.sin(20.0 * narrow.origins)
    found = see_points(narrow, (narrow.at(u) + off)[None] @ S.T + t)
    assert np.linalg.norm(found.targets) < 0.3
    free = _points(narrow, (narrow.at(u) + off)[None] @ S.T + t, np.zeros((1, 3))).targets
    assert np.linalg.norm(free) > 1.0


def test_hand_and_eye_are_found(bodies: Bodies) -> None:
    X = Rotation.from_euler("ZYX", [2.0, -0.3, 1.2]).as_matrix()
    u = np.array([0.05, 0.02, -0.1])
    found = see_poses(bodies, bodies.at(u) @ S.T + t, S @ bodies.rotations @ X)
    assert found.turn == pytest.approx(X, abs=1e-6)
    assert found.targets[0] == pytest.approx(u, abs=1e-6)
    assert found.share < 1e-6


def test_the_anchor_and_the_zero_of_a_wire_are_found(bodies: Bodies) -> None:
    anchor, zero = np.array([2.0, 1.0, -0.5]), 0.05
    lengths = np.linalg.norm(bodies.origins - anchor, axis=1) + zero
    lengths[:4] += 0.2
    found = see_lengths(bodies, lengths)
    assert found.anchor == pytest.approx(anchor, abs=1e-4)
    assert found.zero == pytest.approx(zero, abs=1e-4)


def test_coordinates_of_the_machine_itself_are_known(bodies: Bodies) -> None:
    assert origin_rms(bodies, bodies.origins) == 0.0
    assert origin_rms(bodies, bodies.origins @ S.T + t) > 1.0


@pytest.mark.parametrize("seed", range(6))
def test_points_of_two_targets_in_turn_are_told_apart(bodies: Bodies, seed: int) -> None:
    rng = np.random.default_rng(seed)
    targets = np.array([[0.1, -0.2, 0.3], [0.06, -0.17, 0.28]])
    second = rng.random(N) < 0.35
    measured = bodies.at(targets[second.astype(int)]) @ S.T + t
    measured += rng.normal(0.0, 3e-3, measured.shape)  # as a drawing is off
    measured[3] = np.nan
    two = two_targets(bodies, measured)
    assert two is not None
    second[3] = False
    assert two.second.tolist() == second.tolist()
    assert two.apart == pytest.approx(np.linalg.norm(targets[1] - targets[0]), abs=4e-3)
    assert 3.0 * two.share < see_points(bodies, measured[None]).share


@pytest.mark.parametrize("seed", range(6))
def test_two_targets_explain_one_little_better(bodies: Bodies, seed: int) -> None:
    rng = np.random.default_rng(100 + seed)
    measured = bodies.at(np.array([0.1, -0.2, 0.3])) @ S.T + t + rng.normal(0.0, 0.02, (N, 3))
    two = two_targets(bodies, measured)
    assert two is None or 1.5 * two.share > see_points(bodies, measured[None]).share


@pytest.mark.parametrize("seed", range(8))
def test_a_target_far_from_a_body_that_hardly_moves_is_found(seed: int) -> None:
    """A table tilts about x and turns about z; the target stands far from both axes."""
    rng = np.random.default_rng(seed)
    tilts, rounds = rng.uniform(-1.6, 0.6, 36), rng.uniform(-np.pi, np.pi, 36)
    tilt = Rotation.from_euler("x", tilts[:, None])
    table = Bodies((tilt * Rotation.from_euler("z", rounds[:, None])).as_matrix(), tilt.apply(AXIS))
    u = np.array([0.18, 0.02, 0.08])
    drawn = table.at(u) + 2e-4 * np.sin(tilts)[:, None]
    found = see_points(table, drawn[None] @ S.T + t)
    assert found.rms < 5e-4
    # What no pose tells apart is where the axis of the table ends, along it.
    assert found.targets[0][:2] == pytest.approx(u[:2], abs=2e-3)


AXIS = (0.0, 0.0, -0.06)


def test_one_axis_places_a_target_that_it_turns() -> None:
    turns = Rotation.from_euler("z", np.linspace(-3.0, 3.0, 20)[:, None]).as_matrix()
    table = Bodies(turns, np.zeros((20, 3)))
    found = see_points(table, table.at(np.array([0.1, 0.2, 0.05]))[None] @ S.T + t)
    assert found.rms < 1e-9
    assert np.hypot(*found.targets[0][:2]) == pytest.approx(np.hypot(0.1, 0.2), rel=1e-3)
