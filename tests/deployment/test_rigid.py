"""Rigid motions against SciPy's rotations."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from loopcal.companions.robot.rigid import between, moved
from loopcal.mechanisms.placement import inverse, rigid
from loopcal.mechanisms.rotations import nearest_rotation, quaternions, rotation_by, rotation_vector
from loopcal.mechanisms.station import pose_of

RNG = np.random.default_rng(0)
VECTORS = np.vstack(
    [
        RNG.normal(0.0, 1.0, (200, 3)),
        np.pi * np.eye(3),
        1e-9 * RNG.normal(0.0, 1.0, (20, 3)),
        np.zeros((1, 3)),
    ]
)
R = Rotation.from_rotvec(VECTORS).as_matrix()


def test_turns_are_those_of_rotation_vectors_and_back() -> None:
    assert rotation_by(VECTORS) == pytest.approx(R, abs=1e-12)
    assert rotation_by(rotation_vector(R)) == pytest.approx(R, abs=1e-12)
    assert rotation_vector(R)[:200] == pytest.approx(
        Rotation.from_matrix(R[:200]).as_rotvec(), abs=1e-9
    )


def test_the_nearest_rotation_is_no_mirror_image() -> None:
    near = R + RNG.normal(0.0, 0.1, R.shape)
    for matrices in (near, near * [1.0, 1.0, -1.0], near[:, :2, :2]):
        got = nearest_rotation(matrices)
        assert np.linalg.det(got) == pytest.approx(1.0)
        # No small turn brings it nearer: got^T M is symmetric.
        left = np.swapaxes(got, 1, 2) @ matrices
        assert left == pytest.approx(np.swapaxes(left, 1, 2), abs=1e-12)


def test_quaternions_and_turns_by_yaw_pitch_roll_agree_with_scipy() -> None:
    q = quaternions(R)
    assert Rotation.from_quat(q[:, [1, 2, 3, 0]]).as_matrix() == pytest.approx(R, abs=1e-12)
    angles = RNG.uniform(-1.5, 1.5, (50, 3))
    made = Rotation.from_euler("ZYX", angles).as_matrix()
    poses = np.array([pose_of([1.0, 2.0, 3.0, *each]) for each in angles])
    assert poses[:, :3, :3] == pytest.approx(made, abs=1e-12)
    assert (poses[:, :3, 3] == [1.0, 2.0, 3.0]).all()


def test_a_twist_leads_from_one_pose_to_the_other() -> None:
    T = rigid(R, RNG.normal(0.0, 1.0, (len(R), 3)))
    other = T[::-1]
    assert moved(T, between(T, other), 1.0) == pytest.approx(other, abs=1e-12)
    assert inverse(T) @ T == pytest.approx(np.broadcast_to(np.eye(4), T.shape), abs=1e-12)
