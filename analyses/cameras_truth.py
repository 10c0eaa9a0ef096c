"""Robots that hold a camera or a board, as they truly are, and the files that a user has of them.

Arms are those of `analyses.gauntlet_truth`; hand, board and lens are written out here, in no code
of loopcal's. T_a_b maps coordinates in b to a. Lengths are m, angles rad, pixels px.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from analyses import gauntlet_truth as truth
from analyses.gauntlet_truth import Arm, Array, turned_by
from analyses.lives_truth import DEGREE, dh_table

Rng = np.random.Generator
ARMS = {"six": truth.SIX, "ur": truth.UR, "irb": truth.IRB}
ENCODER = 5e-5
"""sd of what a joint reads [rad]."""
LENGTHS, TWISTS, ZEROS = 5e-4, 1e-3, 5e-3
"""sds of an arm off its drawing, those that `loopcal init` states for cameras [m, rad, rad]."""
SQUARE, PRINT = 1e-3, (1e-2, 1e-2, 1e-3, 1e-3)
"""sds of a pixel's aspect and of what prints are off by, as `loopcal init` has them: of size,
aspect [1] and the heights of the middle [m]."""
IMAGE = np.array([1600, 1200])
COLUMNS, ROWS = 8, 6
TILT = 45.0 * DEGREE
"""Most that a board is tilted against the image."""
TRIES, BATCH = 40, 60
MIDDLE = {
    "six": (0.0, 0.0, 0.0, 0.3, 0.9, 0.0),
    "irb": (0.0, 0.3, 0.0, 0.3, 0.8, 0.0),
    "ur": (0.2, -1.4, 1.6, -1.7, -1.5, 0.3),
}
"""Joints of each arm about which a user takes images."""


@dataclass(frozen=True, eq=False)
class Rig:
    """A robot, what it holds, a board and a lens.

    held: whether the board is on the flange, else the camera is; fixed: T_base_camera or
    T_base_board, carried: T_flange_board or T_flange_camera; lens: f, aspect, cx, cy, k1, k2, p1,
    p2, k3; printed: size and aspect less 1, and the two heights of its middle, of the board
    beside the stated one; corner: sd of a corner [px]; encoder: sd of a joint.
    """

    family: str
    held: bool
    drawing: Arm
    arm: Arm
    fixed: Array
    carried: Array
    lens: Array
    pitch: float
    printed: Array
    corner: float
    encoder: float = ENCODER

    @property
    def points(self) -> Array:
        """Points of the board in its frame, (n, 3)."""
        y, x = np.divmod(np.arange(COLUMNS * ROWS), COLUMNS)
        return self.pitch * np.column_stack([x, y, 0.0 * x])

    @property
    def print(self) -> Array:
        """The same as they truly are."""
        size, aspect, warp_x, warp_y = self.printed
        half = 0.5 * self.pitch * np.array([COLUMNS - 1, ROWS - 1])
        across = (self.points[:, :2] / half - 1.0) ** 2
        height = (1.0 - across) @ np.array([warp_x, warp_y])
        longer = (1.0 + size) * np.array([1.0, 1.0 + aspect])
        return np.column_stack([self.points[:, :2] * longer, height])

    def flange(self, q: Array) -> Array:
        """T_base_flange (N, 4, 4) of the true arm."""
        return _flange(self.arm, q)

    def board(self, T: Array) -> Array:
        """T_camera_board (N, 4, 4), of T_base_flange (N, 4, 4)."""
        if self.held:
            return np.asarray(inverse(self.fixed) @ T @ self.carried)
        return np.asarray(inverse(T @ self.carried) @ self.fixed)

    def pixels(self, T: Array) -> Array:
        """(N, n, 2) of T_base_flange (N, 4, 4)."""
        M = self.board(T)
        P = np.einsum("nij,kj->nki", M[:, :3, :3], self.print) + M[:, None, :3, 3]
        return seen(P, self.lens)


def seen(P: Array, lens: Array) -> Array:
    """Pixels (..., 2) of points (..., 3) in the camera, by OpenCV's equations."""
    f, aspect, cx, cy, k1, k2, p1, p2, k3 = lens
    x, y = P[..., 0] / P[..., 2], P[..., 1] / P[..., 2]
    r2 = x**2 + y**2
    bent = 1.0 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    u = f * (bent * x + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x**2)) + cx
    v = f * (1.0 + aspect) * (bent * y + p1 * (r2 + 2.0 * y**2) + 2.0 * p2 * x * y) + cy
    return np.stack([u, v], axis=-1)


def motion(R: Array, t: Array) -> Array:
    """(..., 4, 4)."""
    T = np.zeros((*R.shape[:-2], 4, 4))
    T[..., :3, :3], T[..., :3, 3], T[..., 3, 3] = R, t, 1.0
    return T


def inverse(T: Array) -> Array:
    """T^-1 of rigid motions (..., 4, 4)."""
    Rt = np.swapaxes(T[..., :3, :3], -1, -2)
    return motion(Rt, -np.einsum("...ij,...j->...i", Rt, T[..., :3, 3]))


def rig(number: int, held: bool, rng: Rng, encoder: float = ENCODER) -> Rig:
    """A robot of one of three makes, off its drawing, with a camera of its own."""
    family = (*ARMS,)[number % len(ARMS)]
    drawing = ARMS[family]
    f, pitch = rng.uniform(1100.0, 2200.0), rng.uniform(0.02, 0.04)
    c = (IMAGE - 1.0) / 2.0 + rng.normal(0.0, 15.0, 2)
    bent = rng.normal(0.0, [0.1, 0.1, 5e-4, 5e-4, 0.1])
    lens, printed = np.array([f, rng.normal(0.0, SQUARE), *c, *bent]), rng.normal(0.0, PRINT)
    arm, corner, nowhere = built(drawing, rng), rng.uniform(0.1, 0.4), np.eye(4)
    one = Rig(family, held, drawing, arm, nowhere, nowhere, lens, pitch, printed, corner, encoder)
    fixed, carried = _mounts(one, rng)
    return replace(one, fixed=fixed, carried=carried)


def built(drawing: Arm, rng: Rng) -> Arm:
    """The arm as it was built.

    The base and the flange are where the first and the last axis stand: what is off there is where
    camera and board are.
    """
    links = []
    for j, link in enumerate(drawing.links):
        dl, da, zero = LENGTHS * rng.normal(size=2), TWISTS * rng.normal(size=2), ZEROS
        first, last = j == 0, j == len(drawing.links) - 1
        one = link
        if not last:
            one = replace(one, a=link.a + dl[0], alpha=link.alpha + da[0])
        if not last and link.beta is not None:
            one = replace(one, beta=link.beta + da[1])
        if not (first or last):
            one = replace(one, offset=link.offset + zero * rng.normal())
            if link.beta is None:
                one = replace(one, d=link.d + dl[1])
        links.append(one)
    return replace(drawing, links=tuple(links))


def _flange(arm: Arm, q: Array) -> Array:
    return motion(*arm.flange(q))


def _mounts(of: Rig, rng: Rng) -> tuple[Array, Array]:
    """The fixed one of camera and board where it faces the other at `MIDDLE`, and the other on the
    flange."""
    place = rng.normal(0.0, 0.02, 3) + np.array([0.05, 0.0, 0.1])
    turn = turned_by(rng.uniform(-3.0, 3.0) * np.array([[0.0, 0.0, 1.0]]))[0]
    carried = motion(turn @ turned_by(rng.normal(0.0, 0.15, (1, 3)))[0], place)
    at, view = of.flange(np.array([MIDDLE[of.family]]))[0], _view(of, rng, 0.0)
    return at @ carried @ (inverse(view) if of.held else view), carried


def _distance(f: float, pitch: float) -> float:
    """At which the board fills half of the image's width."""
    return float(f * pitch * (COLUMNS - 1) / (0.5 * IMAGE[0]))


def poses(of: Rig, images: int, rng: Rng, turns: str = "free") -> Array:
    """Joints (N, 6) of images that show the whole board.

    Of views that a user would choose, by where the drawing says that the hand has to be; turns:
    "free", "none" or "axis", the hand's z alone.
    """
    chosen = np.zeros((0, 6))
    want: Array | None = None
    for _ in range(TRIES):
        arm = of.drawing if turns == "free" else of.arm
        if turns == "free" or want is None:
            wanted = np.array([_wanted(of, rng) for _ in range(BATCH)])
        else:
            wanted = np.broadcast_to(want, (BATCH, 4, 4)).copy()
            wanted[:, :3, 3] += rng.uniform(-0.08, 0.08, (BATCH, 3))
            if turns == "axis":
                spin = rng.uniform(-0.5, 0.5, BATCH)[:, None] * [0.0, 0.0, 1.0]
                wanted[:, :3, :3] = wanted[:, :3, :3] @ turned_by(spin)
        q = _solved(arm, wanted, truth.BOXES[of.family], np.array(MIDDLE[of.family]), rng)
        q = q[_shown(of, of.flange(q))]
        if turns != "free" and want is None:
            want = None if not len(q) else _flange(arm, q[:1])[0]
            continue
        chosen = np.vstack([chosen, q])
        if len(chosen) >= images:
            return chosen[:images]
    raise ValueError(f"only {len(chosen)} of {images} poses show the board")


def _shown(of: Rig, T: Array) -> NDArray[np.bool_]:
    """(N,) whether the whole board is in the image, from its front."""
    if not len(T):
        return np.zeros(0, dtype=bool)
    uv, M = of.pixels(T), of.board(T)
    z = np.einsum("nj,kj->nk", M[:, 2, :3], of.points) + M[:, 2, 3, None]
    inside = ((uv > 5.0) & (uv < IMAGE - 5.0)).all(axis=(1, 2))
    shown: NDArray[np.bool_] = inside & (z > 0.05).all(axis=1) & (M[:, 2, 2] > np.cos(TILT + 0.1))
    return shown


def _wanted(of: Rig, rng: Rng) -> Array:
    """T_base_flange of a view."""
    M = _view(of, rng, 1.0)
    if of.held:
        return np.asarray(of.fixed @ M @ inverse(of.carried))
    return np.asarray(of.fixed @ inverse(M) @ inverse(of.carried))


def _view(of: Rig, rng: Rng, spread: float) -> Array:
    """T_camera_board: the board tilted, rolled, anywhere in the image; spread: 0 in its middle."""
    tilt, about = spread * rng.uniform(0.05, 1.0) * TILT, rng.uniform(0.0, 2.0 * np.pi)
    turn = turned_by(tilt * np.array([[np.cos(about), np.sin(about), 0.0]]))[0]
    turn = turn @ turned_by(spread * rng.uniform(-1.2, 1.2) * np.array([[0.0, 0.0, 1.0]]))[0]
    z = _distance(of.lens[0], of.pitch) * (1.2 + spread * rng.uniform(-0.4, 0.4))
    half = spread * 0.35 * IMAGE / of.lens[0]
    place = z * np.array([*(half * rng.uniform(-1.0, 1.0, 2)), 1.0])
    return motion(turn, place - turn @ of.points.mean(axis=0))


def _solved(arm: Arm, want: Array, box: Array, middle: Array, rng: Rng) -> Array:
    """Joints (M, 6) within the box that bring the flange to some of `want` (N, 4, 4), by Newton's
    method from around the middle."""
    q = middle + rng.normal(0.0, 0.3, (len(want), len(box)))
    for _ in range(25):
        d = _twists(want, _flange(arm, q))
        J = np.empty((*d.shape, len(box)))
        for j in range(len(box)):
            ahead = q.copy()
            ahead[:, j] += 1e-6
            J[:, :, j] = (_twists(want, _flange(arm, ahead)) - d) / 1e-6
        damped = J.transpose(0, 2, 1) @ J + 1e-6 * np.eye(len(box))
        step = -np.linalg.solve(damped, J.transpose(0, 2, 1) @ d[:, :, None])[:, :, 0]
        q = q + step * np.minimum(1.0, 0.5 / np.maximum(np.abs(step).max(axis=1), 1e-12))[:, None]
    q = (q + np.pi) % (2.0 * np.pi) - np.pi
    there = np.abs(_flange(arm, q) - want).max(axis=(1, 2)) < 1e-4
    reached: Array = q[there & ((q > box[:, 0]) & (q < box[:, 1])).all(axis=1)]
    return reached


def _twists(want: Array, T: Array) -> Array:
    """(N, 6): shift, and a vector along the axis of the turn, from `want` to T."""
    R = T[:, :3, :3] @ want[:, :3, :3].transpose(0, 2, 1)
    w = 0.5 * np.stack(
        [R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=1
    )
    return np.concatenate([T[:, :3, 3] - want[:, :3, 3], w], axis=1)


@dataclass(frozen=True, eq=False)
class Shots:
    """What a user has: joints (N, 6) as read, pixels (N, n, 2), NaN where a corner is missing."""

    rig: Rig
    q: Array
    read: Array
    uv: Array

    def write(
        self,
        folder: Path,
        *,
        uv: Array | None = None,
        points: Array | None = None,
        T: Array | None = None,
    ) -> None:
        """The files of a folder: corners, board, and joints with the robot's table, or poses of
        the flange T (N, 4, 4); what is not stated is as it was measured."""
        folder.mkdir(parents=True, exist_ok=True)
        uv, points = (
            (self.uv if uv is None else uv),
            (self.rig.points if points is None else points),
        )
        lines = ["pose,camera,board,point,u_px,v_px"]
        for i, k in zip(*np.nonzero(np.isfinite(uv[:, :, 0])), strict=True):
            lines.append(f"{i + 1},cam,board,{k},{uv[i, k, 0]:.4f},{uv[i, k, 1]:.4f}")
        _written(folder / "readings.csv", lines)
        lines = ["board,point,x_m,y_m,z_m"]
        lines += [f"board,{k},{x:.9g},{y:.9g},{z:.9g}" for k, (x, y, z) in enumerate(points)]
        _written(folder / "board.csv", lines)
        if T is None:
            (folder / "dh.csv").write_text(dh_table(self.rig.drawing), "utf-8")
            lines = ["pose," + ",".join(f"J{j} [deg]" for j in range(1, 7))]
            cells = [[f"{v / DEGREE:.8f}" for v in q] for q in self.read]
        else:
            lines = ["pose,x_m,y_m,z_m,qw,qx,qy,qz"]
            cells = [[f"{v:.9f}" for v in (*M[:3, 3], *quaternion(M[:3, :3]))] for M in T]
        lines += [",".join([str(i), *row]) for i, row in enumerate(cells, 1)]
        _written(folder / "poses.csv", lines)


def _written(path: Path, lines: Sequence[str]) -> None:
    path.write_text("\n".join(lines) + "\n", "utf-8")


def quaternion(R: Array) -> Array:
    """w, x, y, z of a rotation matrix, by its largest element."""
    K = np.array(
        [
            [R[0, 0] + R[1, 1] + R[2, 2], R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]],
            [0.0, R[0, 0] - R[1, 1] - R[2, 2], R[1, 0] + R[0, 1], R[0, 2] + R[2, 0]],
            [0.0, 0.0, R[1, 1] - R[0, 0] - R[2, 2], R[2, 1] + R[1, 2]],
            [0.0, 0.0, 0.0, R[2, 2] - R[0, 0] - R[1, 1]],
        ]
    )
    q: NDArray[np.float64] = np.linalg.eigh(K + np.triu(K, 1).T)[1][:, -1]
    return np.asarray(q * np.sign(q[0]))


def shots(
    number: int, held: bool, images: int = 40, turns: str = "free", encoder: float = ENCODER
) -> Shots:
    """A set of images, the same for a number every time."""
    rng = np.random.default_rng([47, number, held])
    one = rig(number, held, rng, encoder)
    q = poses(one, images, rng, turns)
    uv = one.pixels(one.flange(q))
    uv = uv + one.corner * rng.normal(size=uv.shape)
    return Shots(one, q, q + one.encoder * rng.normal(size=q.shape), uv)
