"""Cameras and boards that no image connects: each part is started alone, by one hand.

Cameras and boards are connected where a camera sees a board. Every part has its own mount: one
camera may be on the flange, while another one stands before a board that is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.estimation.cameras.corners import Corners, Views
from loopcal.estimation.cameras.facts import Fact
from loopcal.estimation.cameras.start import CameraStart

Run = Callable[[Corners, Array | None], CameraStart]


def in_parts(corners: Corners, T_base_flange: Array | None, run: Run) -> CameraStart:
    """The start of every part as one, all by the same poses (n, 4, 4).

    Poses that one part corrects hold for the others, and those before it are started again. Without
    a robot everything is one part: a pose is free for each board and image.
    """
    parts = _parts(corners)
    if T_base_flange is None or len(parts) < 2:
        return run(corners, T_base_flange)
    T, facts, made, last = T_base_flange, dict[str, Fact](), dict[int, CameraStart](), 0
    for i in range(2 * len(parts) - 1):
        if i == last + len(parts):
            break  # every part has begun by these poses
        begun = run(_alone(corners, parts[i % len(parts)]), T)
        for fact in begun.facts:
            words = f"{', '.join(begun.corners.cameras)}: {fact.sentence}"
            facts[words] = replace(fact, sentence=words)
        assert begun.T_base_flange is not None
        if not np.array_equal(begun.T_base_flange, T, equal_nan=True):
            T, last = begun.T_base_flange, i
        made[i % len(parts)] = begun
    return _joined(corners, list(made.values()), T, tuple(facts.values()))


def _parts(corners: Corners) -> list[NDArray[np.bool_]]:
    """(N,) the corners of each part, the part with most views first."""
    label = np.arange(len(corners.cameras))
    views = corners.views
    for board in range(len(corners.boards)):
        same = np.unique(label[views.camera[views.board == board]])
        label[np.isin(label, same[1:])] = same[0] if same.size else 0
    of_view = label[views.camera]
    labels, counts = np.unique(of_view, return_counts=True)
    order = labels[np.argsort(-counts, kind="stable")]
    return [(of_view == one)[views.of_corner] for one in order]


def _alone(corners: Corners, part: NDArray[np.bool_]) -> Corners:
    """Only the corners of a part, with its cameras and boards."""
    some = corners.where(part)
    (cameras, camera), (boards, board) = (
        np.unique(index, return_inverse=True) for index in (some.camera, some.board)
    )
    return replace(
        some,
        camera=camera,
        board=board,
        cameras=tuple(corners.cameras[c] for c in cameras),
        boards=tuple(corners.boards[b] for b in boards),
    )


def _joined(
    corners: Corners, made: list[CameraStart], T: Array, facts: tuple[Fact, ...]
) -> CameraStart:
    """Starts of parts as one, its corners and views in their usual order."""
    names = [board.name for board in corners.boards]
    which = [
        (
            np.array([corners.cameras.index(c) for c in one.corners.cameras]),
            np.array([names.index(b.name) for b in one.corners.boards]),
        )
        for one in made
    ]

    def indices(of: Callable[[Corners], Corners | Views]) -> list[NDArray[np.intp]]:
        every = [
            (some.image, cameras[some.camera], boards[some.board])
            for one, (cameras, boards) in zip(made, which, strict=True)
            for some in [of(one.corners)]
        ]
        return [np.concatenate(column) for column in zip(*every, strict=True)]

    X, Y = (np.tile(np.eye(4), (len(of), 1, 1)) for of in (corners.cameras, names))
    stated = list(corners.boards)
    for one, (cameras, boards) in zip(made, which, strict=True):
        X[cameras], Y[boards] = one.X, one.Y
        for b, board in zip(boards, one.corners.boards, strict=True):
            stated[b] = board  # as corrected
    point = np.concatenate([one.corners.point for one in made])
    uv = np.concatenate([one.corners.uv for one in made])
    index = [*indices(lambda some: some), point]
    by_corner = np.lexsort(index[::-1])
    by_view = np.lexsort(indices(lambda some: some.views)[::-1])
    return CameraStart(
        Corners.of(index, uv, corners.cameras, stated, corners.poses),
        T,
        frozenset(c for one in made for c in one.on_flange),
        {c: one.intrinsics[c] for one in made for c in one.corners.cameras},
        {c: one.intrinsics_stated[c] for one in made for c in one.corners.cameras},
        X,
        Y,
        np.concatenate([one.T_camera_board for one in made])[by_view],
        np.concatenate([one.branches for one in made])[by_view],
        np.concatenate([one.chosen for one in made])[by_view],
        np.concatenate([one.residuals for one in made])[by_corner],
        facts,
    )
