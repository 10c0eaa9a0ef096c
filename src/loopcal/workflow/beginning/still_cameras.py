"""Cameras that see a board that the robot does not move: their corners say nothing of the robot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from loopcal.files.cameras.corner_table import CornerTable
from loopcal.files.cameras.folder import Files

# Chosen, not derived: noise of a corner is below a pixel, and images of a robot span hundreds.
STILL = 0.01
"""Share of how far corners move in other images, below which they stand still."""


def without_still(files: Files) -> tuple[Files, tuple[str, ...]]:
    """The files without corners that are at one place in all images, and words for the reader.

    All are kept where none move, and without a robot.
    """
    table = files.corners
    moves = _moves(table) if files.poses else {}
    still = {pair for pair, move in moves.items() if move < STILL * max(moves.values())}
    if not still:
        return files, ()
    pairs = list(zip(table.camera, table.board, strict=True))
    kept = table.at([i for i, pair in enumerate(pairs) if pair not in still])
    words = tuple(
        f"the camera {camera!r} sees the board {board!r} at one place in all images: both stand "
        f"still, and its {pairs.count((camera, board))} corners are left out. To place the camera, "
        "calibrate the others: T_base_camera = T_base_board T_camera_board^-1, the second from one "
        "image"
        for camera, board in sorted(still)
    )
    return replace(files, corners=kept), words


def _moves(table: CornerTable) -> dict[tuple[str, str], float]:
    """How far the points of each board move in the images of each camera [px], their median."""
    pixels: dict[tuple[str, str], dict[str, list[int]]] = {}
    for i, (camera, board, point) in enumerate(
        zip(table.camera, table.board, table.point, strict=True)
    ):
        pixels.setdefault((camera, board), {}).setdefault(point, []).append(i)
    moves = {}
    for pair, points in pixels.items():
        spreads = [
            float(np.hypot(np.ptp(table.u[rows]), np.ptp(table.v[rows])))
            for rows in points.values()
            if len(rows) > 1
        ]
        if spreads:
            moves[pair] = float(np.median(spreads))
    return moves
