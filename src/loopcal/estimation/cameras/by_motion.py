"""The start of cameras and boards where no view shows enough corners, as of one point on each hand.

What the hand carries is within arm's reach of its origin: all images together are one view of a
large body, whose points are where the hand was. From the camera's pose in it follow the boards, for
u = (R_i (R x + t) + t_i) / z is linear in R and t, and so on in turns.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from loopcal.arrays import Array
from loopcal.estimation.cameras.board_pose import board_poses
from loopcal.estimation.cameras.corners import Corners
from loopcal.mechanisms.cameras.board import Board

TURNS = 4
"""Turns from the boards to the cameras and back."""
MOST = 200
"""Corners from which a camera is placed."""
FEWEST = 6
"""Corners of a camera that place it: three would by the letter."""


def by_motion(corners: Corners, ray: Array, A: Array) -> tuple[Array, Array] | None:
    """X (cameras, 4, 4) and Y (boards, 4, 4) of T_camera_board = X A_i Y.

    ray: (N, 2) X/Z, Y/Z of the corners. None where a camera sees too little.
    """
    X = np.broadcast_to(np.eye(4), (len(corners.cameras), 4, 4)).copy()
    Y = np.broadcast_to(np.eye(4), (len(corners.boards), 4, 4)).copy()
    A = A[corners.image]
    for _ in range(TURNS):
        on_hand = _moved(Y[corners.board], corners.xyz)
        for c in range(len(X)):
            mine = np.flatnonzero(corners.camera == c)
            few = mine[np.linspace(0, len(mine) - 1, min(len(mine), MOST)).astype(int)]
            T = _camera(corners, few, _moved(A[few], on_hand[few]), ray[few])
            if T is None:
                return None
            X[c] = T
        to_hand = X[corners.camera] @ A
        for b in range(len(Y)):
            mine = corners.board == b
            if mine.any():
                Y[b] = _board(corners.xyz[mine], ray[mine], to_hand[mine])
    return X, Y


def _moved(T: Array, points: Array) -> Array:
    return np.asarray((T[:, :3, :3] @ points[:, :, None])[:, :, 0] + T[:, :3, 3])


def _camera(corners: Corners, rows: Array, points: Array, ray: Array) -> Array | None:
    """(4, 4) of a body with these points (n, 3) in the camera that sees them along the rays."""
    if len(rows) < FEWEST:
        return None
    body = Board("hand", {str(i): tuple(p) for i, p in enumerate(points.tolist())})
    none = np.zeros(len(rows), dtype=np.intp)
    index = [none, none, none, np.arange(len(rows))]
    one = Corners.of(index, ray, ("",), (body,), ("",))
    poses = board_poses(replace(one, uv=ray), ray)
    return poses.T_camera_board[0, 0] if poses.usable[0] else None


def _board(xyz: Array, ray: Array, T: Array) -> Array:
    """(4, 4) of a board on the hand, whose points xyz (n, 3) are seen along the rays.

    T: (n, 4, 4) of the hand in the camera. Points on a line or at one place leave turns at zero.
    """
    middle = xyz.mean(axis=0)
    size, axes = np.linalg.svd(xyz - middle, full_matrices=False)[1:]
    axes = axes[size > 1e-6 * max(float(size.max()), 1e-9)]
    across = np.zeros((len(xyz), 2, 3))
    across[:, 0, 0] = across[:, 1, 1] = 1.0
    across[:, :, 2] = -ray
    rows = across @ T[:, :3, :3]
    places = [rows * c[:, None, None] for c in (axes @ (xyz - middle).T)]
    M = np.concatenate([*places, rows], axis=2).reshape(2 * len(xyz), -1)
    right = -(across @ T[:, :3, 3:])[:, :, 0].ravel()
    columns = np.linalg.lstsq(M, right, rcond=None)[0].reshape(-1, 3).T
    U, _, Vt = np.linalg.svd(columns[:, :-1] @ axes)
    Y = np.eye(4)
    Y[:3, :3] = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    Y[:3, 3] = columns[:, -1] - Y[:3, :3] @ middle
    return Y
