"""Rotations and quaternions are each other's inverse."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from loopcal.mechanisms.rotations import quaternions, rotations


def test_rotations_of_quaternions_of_any_length() -> None:
    q = np.random.default_rng(1).standard_normal((50, 4))
    R = rotations(q)
    assert np.allclose(R, Rotation.from_quat(q[:, [1, 2, 3, 0]]).as_matrix(), atol=1e-14)
    unit = q / np.linalg.norm(q, axis=1, keepdims=True)
    assert np.allclose(quaternions(R), unit * np.sign(unit[:, :1]), atol=1e-14)
