"""A camera on a hand: 1,000 images of 100 corners, beside Ceres where it is installed.

The flange's poses are uncertain, so each image has six unknowns of its own. Ceres has the same
model: a block of six for each image with a prior in C++, and a block of lens, hand and board. Its
callback is Python, one for each image with all corners at once in NumPy, and its time is told
apart; Ceres eliminates the images by a sparse Schur complement. Both end at the same parameters, or
no time is told.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import learning
import numpy as np
from measuring import DisagreementError
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import loopcal as lc

Array = NDArray[np.float64]
IMAGES, SIDE, PITCH = 1_000, 10, 0.015
"""Corners in a row and in a column of the board, and how far apart they are [m]."""
FLANGE, PIXEL = 1e-4, 0.2
"""sds of a coordinate or turn of the flange [m, rad], and of a corner [px]."""
LENS = np.array([1200.0, 0.0, 640.0, 480.0, -0.1, 0.05, 1e-4, -1e-4, 0.0])
"""f, aspect, cx, cy, k1, k2, p1, p2, k3."""
NAMES = [f"cam_{n}" for n in ("f", "aspect", "cx", "cy", "k1", "k2", "p1", "p2", "k3")]
PLACES = [f"{o}_{axis}" for o in ("cam", "board") for axis in ("x", "y", "z", "rz", "ry", "rx")]
PRINT = ["board_scale", "board_aspect", "board_warp_*"]
APART = 0.01
"""sds by which two programs that agree may differ."""
DEMANDED, DEMANDED_LEARNT = 5.0, 15.0
"""Processor seconds that the fit may take, with sds stated and learnt."""


@dataclass(frozen=True, eq=False)
class Shots:
    """T_base_flange as read (N, 4, 4), pixels (N, n, 2), points of the board (n, 3), and where
    camera and board truly are: T_flange_camera, T_base_board."""

    flange: Array
    pixels: Array
    points: Array
    hand: Array
    board: Array


@dataclass(frozen=True)
class Images:
    """Processor seconds with sds stated and learnt; of Ceres, and of its callbacks in Python, None
    where it is absent."""

    images: int
    corners: int
    stated: float
    learnt: float
    ceres: float | None
    callbacks: float | None


def measure(images: int = IMAGES) -> Images:
    """The fits once each, after a small one that loads what they need."""
    _times(shots(20))
    shot = shots(images)
    stated, learnt, found = _times(shot)
    other: float | None = None
    callbacks: float | None = None
    if find_spec("pyceres") is not None:
        ends: list[tuple[Array, float]] = []
        other = learning.processor(lambda: ends.append(by_ceres(shot)))
        ((places, callbacks),) = ends
        refuse_apart(found, places)
    return Images(images, len(shot.points), stated, learnt, other, callbacks)


def shots(images: int, seed: int = 1) -> Shots:
    """Images of a board on a table, from all sides."""
    rng = np.random.default_rng(seed)
    y, x = np.divmod(np.arange(SIDE * SIDE, dtype=np.float64), SIDE)
    points = PITCH * np.column_stack([x, y, 0.0 * x])
    board = rigid(Rotation.from_rotvec([0.02, -0.01, 0.3]), [0.6, -0.1, 0.05])
    hand = rigid(Rotation.from_rotvec([0.1, -0.05, 0.4]), [0.03, 0.05, 0.1])
    tilts = np.column_stack([rng.uniform(-0.6, 0.6, (images, 2)), rng.uniform(-1.5, 1.5, images)])
    view = np.tile(np.eye(4), (images, 1, 1))  # T_camera_board, the board below the camera
    R = Rotation.from_rotvec(tilts) * Rotation.from_rotvec([np.pi, 0.0, 0.0])
    view[:, :3, :3] = R.as_matrix()
    middle = np.column_stack(
        [rng.uniform(-0.03, 0.03, (images, 2)), rng.uniform(0.3, 0.45, images)]
    )
    view[:, :3, 3] = middle - np.einsum("nij,j->ni", view[:, :3, :3], points.mean(axis=0))
    flange = board @ np.linalg.inv(view) @ np.linalg.inv(hand)
    P = np.einsum("nij,kj->nki", view[:, :3, :3], points) + view[:, None, :3, 3]
    pixels = projected(P, LENS)[0] + PIXEL * rng.standard_normal((*P.shape[:2], 2))
    read = flange.copy()
    read[:, :3, 3] += FLANGE * rng.standard_normal((images, 3))
    turned = Rotation.from_rotvec(FLANGE * rng.standard_normal((images, 3))).as_matrix()
    read[:, :3, :3] = read[:, :3, :3] @ turned
    return Shots(read, pixels, points, hand, board)


def projected(P: Array, lens: Array) -> tuple[Array, Array, Array]:
    """Pixels (..., 2) of points (..., 3), and their derivatives by the point (..., 2, 3) and by the
    lens (..., 2, 9). Source: Brown (1971), in the order of OpenCV."""
    f, aspect, cx, cy, k1, k2, p1, p2, k3 = lens
    z = P[..., 2]
    x, y = P[..., 0] / z, P[..., 1] / z
    r = x**2 + y**2
    g, dg = 1.0 + r * (k1 + r * (k2 + r * k3)), k1 + r * (2.0 * k2 + 3.0 * r * k3)
    u = g * x + 2.0 * p1 * x * y + p2 * (r + 2.0 * x**2)
    v = g * y + p1 * (r + 2.0 * y**2) + 2.0 * p2 * x * y
    f_v = f * (1.0 + aspect)
    mixed = 2.0 * x * y * dg + 2.0 * p1 * x + 2.0 * p2 * y
    u_x, v_y = (
        g + 2.0 * x**2 * dg + 2.0 * p1 * y + 6.0 * p2 * x,
        (g + 2.0 * y**2 * dg + 6.0 * p1 * y + 2.0 * p2 * x),
    )
    by_point = np.empty((*P.shape[:-1], 2, 3))
    by_point[..., 0, 0], by_point[..., 0, 1] = f * u_x / z, f * mixed / z
    by_point[..., 1, 0], by_point[..., 1, 1] = f_v * mixed / z, f_v * v_y / z
    by_point[..., 2] = -(by_point[..., 0] * x[..., None] + by_point[..., 1] * y[..., None])
    by_lens = np.zeros((*P.shape[:-1], 2, 9))
    by_lens[..., 0, 0], by_lens[..., 1, 0] = u, (1.0 + aspect) * v
    by_lens[..., 1, 1], by_lens[..., 0, 2], by_lens[..., 1, 3] = f * v, 1.0, 1.0
    powers = [r * x, r**2 * x, 2.0 * x * y, r + 2.0 * x**2, r**3 * x]
    heights = [r * y, r**2 * y, r + 2.0 * y**2, 2.0 * x * y, r**3 * y]
    by_lens[..., 0, 4:], by_lens[..., 1, 4:] = (
        f * np.stack(powers, axis=-1),
        f_v * np.stack(heights, axis=-1),
    )
    return np.stack([f * u + cx, f_v * v + cy], axis=-1), by_point, by_lens


def _times(shot: Shots) -> tuple[float, float, lc.Result]:
    """Processor seconds with sds stated and learnt, and what was found with those stated."""
    with TemporaryDirectory() as place:
        project = lc.init(_written(shot, Path(place)))
    mechanism = project.mechanism
    plain = mechanism.parameters.with_fixed(PRINT).with_prior({"cam_*": np.inf, "board_*": np.inf})
    mechanism = mechanism.with_parameters(plain)
    noise = lc.Noise({"[xyz]": FLANGE, "w[xyz]": FLANGE, "cam": PIXEL})
    ends: list[lc.Result] = []

    def fitted(sds: Any) -> Callable[[], object]:
        return lambda: ends.append(
            lc.calibrate(mechanism, project.dataset, noise=sds, method="implicit-loop")
        )

    stated = learning.processor(fitted(noise))
    return stated, learning.processor(fitted(project.noise)), ends[0]


def _written(shot: Shots, folder: Path) -> Path:
    """The folder of a user, with the numbers that the programs share."""
    quaternions = Rotation.from_matrix(shot.flange[:, :3, :3]).as_quat()[:, [3, 0, 1, 2]]
    poses = np.column_stack([shot.flange[:, :3, 3], quaternions])
    lines = ["pose,x_m,y_m,z_m,qw,qx,qy,qz"]
    lines += [",".join([str(i), *map(repr, row)]) for i, row in enumerate(poses.tolist(), 1)]
    (folder / "poses.csv").write_text("\n".join(lines), "utf-8")
    lines = ["board,point,x_m,y_m,z_m"]
    lines += [f"board,{k},{x!r},{y!r},{z!r}" for k, (x, y, z) in enumerate(shot.points.tolist())]
    (folder / "board.csv").write_text("\n".join(lines), "utf-8")
    lines = ["pose,camera,board,point,u_px,v_px"]
    for i, image in enumerate(shot.pixels.tolist(), 1):
        lines += [f"{i},cam,board,{k},{u!r},{v!r}" for k, (u, v) in enumerate(image)]
    (folder / "readings.csv").write_text("\n".join(lines), "utf-8")
    return folder


def rigid(R: Rotation, shift: Any) -> Array:
    """(4, 4)."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R.as_matrix(), shift
    return T


def by_ceres(shot: Shots) -> tuple[Array, float]:
    """(21,) lens, and T_flange_camera and T_board_base as shift and turn (z, y, x) [m, rad]; and
    seconds of callbacks."""
    import ceres_images

    end: tuple[Array, float] = ceres_images.calibrated(shot, LENS * 1.02, FLANGE, PIXEL)
    return end


def refuse_apart(found: lc.Result, other: Array) -> None:
    """Raise DisagreementError where another program ends elsewhere."""
    for name, value in zip([*NAMES, *PLACES], other.tolist(), strict=True):
        off = found.value[name] - value
        if found.mechanism.parameters[name].unit == "rad":
            off = float((off + np.pi) % (2.0 * np.pi) - np.pi)
        if abs(off) > APART * (found.sd[name] or 0.0):
            raise DisagreementError(f"{name}: {found.value[name]:.9g}, Ceres {value:.9g}")
