"""Images of a board on a hand, or of a board before a camera on it, by equations of their own."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from loopcal.estimation.cameras.corners import Corners
from loopcal.estimation.cameras.start import CameraStart, start
from loopcal.mechanisms.cameras.board import Board
from loopcal.mechanisms.cameras.lens import Intrinsics

Array = NDArray[np.float64]
SIZE = (1600, 1200)
COLUMNS, ROWS, PITCH = 7, 5, 0.03
K1, K2 = -0.1, 0.05


def motion(turn: Array, shift: Array) -> Array:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec(turn).as_matrix(), shift
    return T


def pixel(P: Array, f: float, c: Array) -> Array:
    x, y = P[:, 0] / P[:, 2], P[:, 1] / P[:, 2]
    r2 = x**2 + y**2
    bent = 1.0 + K1 * r2 + K2 * r2**2
    return np.column_stack([f * x * bent + c[0], f * y * bent + c[1]])


def grid_board(pitch: float = PITCH) -> Board:
    places = [(i, j) for j in range(ROWS) for i in range(COLUMNS)]
    return Board("board", {str(k): (i * pitch, j * pitch, 0.0) for k, (i, j) in enumerate(places)})


@dataclass(frozen=True)
class Shots:
    """What a user has, and what is true."""

    corners: Corners
    T: Array
    intrinsics: dict[str, Intrinsics]
    X: Array
    Y: Array
    f: float
    held: bool
    sizes: dict[str, tuple[int, int]] = field(default_factory=lambda: {"cam": SIZE})

    def start(self, *, stated: bool = True, **changes: Any) -> CameraStart:
        """`start` of these shots; changes of corners, T, intrinsics or held."""
        shots = replace(self, **{k: v for k, v in changes.items() if k != "held"})
        lenses = shots.intrinsics if stated else None
        held = changes.get("held", self.held)
        return start(shots.corners, shots.T, lenses, self.sizes, held)


def shots(
    seed: int,
    *,
    held: bool = True,
    images: int = 12,
    noise: float = 0.2,
    turns: str = "free",
    wrong: float = 0.0,
) -> Shots:
    """Images at random poses; turns: "free", "none" or "axis", the hand's z alone."""
    random = np.random.default_rng(seed)
    f = random.uniform(1000.0, 2000.0)
    c = np.array(SIZE) / 2.0 - 0.5 + random.normal(0.0, 15.0, 2)
    board = grid_board()
    xyz = board.xyz
    near = motion(random.normal(0.0, 1.5, 3), random.uniform(-0.1, 0.1, 3))
    far = motion(random.normal(0.0, 1.5, 3), random.uniform(0.3, 0.9, 3))
    X, Y = (far, near) if held else (near, far)
    first: Array | None = None
    hands: list[Array] = []
    pixels: list[Array] = []
    while len(hands) < images:
        C = _view(random, f, xyz.mean(axis=0))
        A = np.linalg.inv(X) @ C @ np.linalg.inv(Y)
        T = A if held else np.linalg.inv(A)
        if turns != "free":
            first = T if first is None else first
            angle = random.uniform(-0.5, 0.5) if turns == "axis" else 0.0
            T = motion(np.zeros(3), random.uniform(-0.05, 0.05, 3)) @ first
            T = T @ motion(np.array([0.0, 0.0, angle]), np.zeros(3))
        P = X @ (T if held else np.linalg.inv(T)) @ Y
        uv = pixel(xyz @ P[:3, :3].T + P[:3, 3], f, c)
        if (uv > 0).all() and (uv < np.array(SIZE)).all():
            hands.append(T)
            pixels.append(uv + random.normal(0.0, noise, uv.shape))
    n = len(xyz)
    index = [np.repeat(np.arange(images), n), np.zeros(images * n), np.zeros(images * n)]
    index = [*index, np.tile(np.arange(n), images)]
    uv = np.concatenate(pixels)
    some = random.random(len(uv)) < wrong
    uv[some] += random.uniform(-60.0, 60.0, (int(some.sum()), 2))
    names = [f"image {i}" for i in range(images)]
    corners = Corners.of([i.astype(np.intp) for i in index], uv, ["cam"], [board], names)
    lens = Intrinsics("brown5", f, f, float(c[0]), float(c[1]), (K1, K2, 0.0, 0.0, 0.0), SIZE)
    return Shots(corners, np.array(hands), {"cam": lens}, X, Y, f, held)


def _view(random: np.random.Generator, f: float, middle: Array) -> Array:
    """A board tilted by up to 45 degrees, anywhere in the image."""
    tilt, about = random.uniform(0.1, 0.8), random.uniform(0.0, 2.0 * np.pi)
    turn = motion(tilt * np.array([np.cos(about), np.sin(about), 0.0]), np.zeros(3))
    turn = turn @ motion(np.array([0.0, 0.0, random.uniform(-3.0, 3.0)]), np.zeros(3))
    turn = turn @ motion(np.array([np.pi, 0.0, 0.0]), np.zeros(3))
    z = f / SIZE[0] * random.uniform(0.5, 0.8)
    place = z * np.array([*(np.array([450.0, 350.0]) / f * random.uniform(-1.0, 1.0, 2)), 1.0])
    turn[:3, 3] = place - turn[:3, :3] @ middle
    return turn
