"""A lens that nobody states has the terms that images left out ask for, and no more."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from loopcal.estimation.cameras.corners import Corners
from loopcal.estimation.cameras.start import started
from loopcal.mechanisms.cameras.board import Board

Array = NDArray[np.float64]
COLUMNS, ROWS, PITCH, IMAGES = 10, 7, 0.02, 50
HALF = 0.5 * PITCH * np.array([COLUMNS - 1, ROWS - 1])


def lens_of(seed: int, bent: float, prism: float) -> str:
    """That is taken for images of a board, bent by so much [m] across its height and printed a
    thousandth too long, through a brown5 lens with a prism before it. Pixels are not square."""
    random = np.random.default_rng(seed)
    y, x = np.divmod(np.arange(COLUMNS * ROWS), COLUMNS)
    flat = PITCH * np.column_stack([x, y, 0.0 * x])
    across = (flat[:, :2] / HALF - 1.0) ** 2
    printed = flat + np.outer(bent * (1.0 - across[:, 1]), [0.0, 0.0, 1.0])
    printed = (printed - [*HALF, 0.0]) * [1.0, 1.001, 1.0]
    turns = Rotation.from_euler("xyz", random.uniform(-40.0, 40.0, (IMAGES, 3)), degrees=True)
    z = random.uniform(0.35, 0.6, IMAGES)
    away = random.uniform(-1.0, 1.0, (IMAGES, 2)) * [0.25, 0.17]
    places = z[:, None] * np.column_stack([away, np.ones(IMAGES)])
    P = np.einsum("nij,pj->npi", turns.as_matrix(), printed) + places[:, None]
    x, y = P[..., 0] / P[..., 2], P[..., 1] / P[..., 2]
    r2 = x**2 + y**2
    radial = 1.0 - 0.1 * r2
    u = 1500.0 * (x * radial + 1e-3 * x * y + prism * r2) + 805.0
    v = 1503.0 * (y * radial + 5e-4 * (r2 + 2.0 * y**2) - prism * r2) + 610.0
    uv = np.stack([u, v], axis=2) + random.normal(0.0, 0.25, (*u.shape, 2))
    names = {str(k): (a, b, c) for k, (a, b, c) in enumerate(flat.tolist())}
    image, point = np.divmod(np.arange(uv[..., 0].size), len(flat))
    none = np.zeros_like(image)
    corners = Corners.of(
        (image, none, none, point),
        uv.reshape(-1, 2),
        ("cam",),
        (Board("board", names),),
        tuple(map(str, range(IMAGES))),
    )
    return started(corners, None, {}, {"cam": (1600, 1200)}).intrinsics["cam"].lens


def test_a_bent_print_is_no_lens() -> None:
    assert lens_of(1, bent=6e-4, prism=0.0) == "brown5"


def test_a_prism_is_seen_beside_a_bent_print() -> None:
    assert lens_of(1, bent=6e-4, prism=0.01) == "brown12"
