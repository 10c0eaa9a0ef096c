"""What the poses and images of a set leave undetermined, in the user's words."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from loopcal.arrays import Array
from loopcal.estimation.cameras.corners import Corners
from loopcal.estimation.cameras.facts import Fact
from loopcal.estimation.cameras.placing import Reading, view_poses
from loopcal.estimation.cameras.scene import TURN, Scene
from loopcal.mechanisms.rotations import nearest_rotation, rotation_vector

FLAT = np.radians(10.0)
"""Tilt below which a board is as good as parallel to the image: cos 10 deg = 0.985."""
ONE_DISTANCE = 0.05
"""Spread of depths [1] below which all boards stand at one distance."""
CELLS = (4, 3)
"""Columns and rows of the map of an image's coverage."""
PIVOT = 0.02
"""A point of the hand that moves by less than this share of its longest way rests."""


def motion_facts(reading: Reading, scene: Scene, *, stated: bool) -> list[Fact]:
    """All degenerate motions of a set, from the poses and corners that were used."""
    facts: list[Fact] = []
    if reading.T_base_flange is not None:
        used = reading.T_base_flange[np.unique(reading.corners.image)]
        facts += _turns(used, reading)
    facts += _boards(reading, scene, stated=stated)
    for c, camera in enumerate(reading.corners.cameras):
        facts += _coverage(reading.corners.seen(camera=c), camera, scene.intrinsics[c].image)
    return facts


def _turns(T: Array, reading: Reading) -> Iterator[Fact]:
    """No rotation, one axis, pure turns about a point."""
    R = T[:, :3, :3]
    mean = nearest_rotation(np.mean(R, axis=0))
    turns = rotation_vector(np.swapaxes(mean[None], 1, 2) @ R)
    angle = np.linalg.norm(turns, axis=1)
    spread = 2.0 * float(np.degrees(angle.max()))
    seen, other = ("board", "camera") if reading.held else ("camera", "board")
    size = np.sqrt(np.maximum(np.linalg.eigvalsh(turns.T @ turns / len(T)), 0.0))[::-1]
    axis = np.linalg.eigh(turns.T @ turns)[1][:, 2]
    values: dict[str, float | str] = {"turn_deg": spread, "images": len(T)}
    if size[0] < TURN:
        yield Fact(
            "no-rotation",
            f"In all {len(T)} images the hand is turned alike (within {spread:.2g} deg). Where on "
            f"the hand the {seen} sits cannot be distinguished from where the {other} stands. "
            "Turn the hand by 30 deg about two axes.",
            values | {"lost": 3},
        )
    elif size[1] < TURN:
        words = _axis(axis)
        yield Fact(
            "parallel-axes",
            f"The hand turns only about its {words}. Along this axis, where the {seen} sits on the "
            f"hand cannot be distinguished from where the {other} stands. "
            "Turn the hand by 30 deg about a second axis.",
            values | {"lost": 1, "axis": words, "second_turn_deg": float(np.degrees(size[1]))},
        )
    if size[0] >= TURN:
        yield from _pivot(T, spread)


def _axis(axis: Array) -> str:
    """'z' for an axis within 10 degrees of it, else its components."""
    k = int(np.argmax(np.abs(axis)))
    if abs(axis[k]) > np.cos(FLAT):
        return "xyz"[k]
    axis = axis * np.sign(axis[k])
    return "axis (" + ", ".join(f"{a:.2f}" for a in axis) + ")"


def _pivot(T: Array, spread: float) -> Iterator[Fact]:
    """A point of the hand that rests in all images: R_i c + t_i = const."""
    n = len(T)
    if n < 4:
        return
    rows = np.concatenate([T[:, :3, :3], np.broadcast_to(-np.eye(3), (n, 3, 3))], axis=2)
    right = -T[:, :3, 3].reshape(-1)
    solution = np.linalg.lstsq(rows.reshape(3 * n, 6), right, rcond=1e-4)[0]
    rest = (rows.reshape(3 * n, 6) @ solution - right).reshape(n, 3)
    moves = float(np.sqrt(np.mean(np.sum(rest**2, axis=1))))
    # The way that its turns alone would give a point at arm's length, 1 m.
    if moves < PIVOT * np.radians(spread) / 2.0:
        yield Fact(
            "pure-turns",
            f"The hand only turns about one point, which moves by {1e3 * moves:.2g} mm. The joints "
            "far from the hand hardly move: move the hand through the workspace.",
            {"moves_m": moves, "turn_deg": spread},
        )


def _boards(reading: Reading, scene: Scene, *, stated: bool) -> Iterator[Fact]:
    """Boards parallel to the image, and at one distance."""
    corners, views = reading.corners, reading.corners.views
    T = scene.of_views(views)
    middle = T[:, :3, :3] @ (views.sums(corners.xyz) / views.sizes[:, None])[:, :, None]
    toward = middle[:, :, 0] + T[:, :3, 3]
    for c, camera in enumerate(corners.cameras):
        mine = views.camera == c
        flat = mine & np.array([b.planar for b in corners.boards])[views.board]
        name = f"camera {camera!r}" if len(corners.cameras) > 1 else "the camera"
        if flat.sum() >= 3 and reading.T_base_flange is None:
            tilt = np.arccos(np.clip(np.abs(T[flat, 2, 2]), 0.0, 1.0))
            if np.quantile(tilt, 0.9) < FLAT:
                most = float(np.degrees(tilt.max()))
                yield Fact(
                    "fronto-parallel",
                    f"Nearly all boards are parallel to the image of {name} (at most {most:.2g} "
                    "deg of tilt). Focal length and distance cannot be distinguished. "
                    "Tilt the board by 20 to 45 deg.",
                    {"tilt_deg": most, "camera": camera},
                )
        depth = toward[mine, 2]
        if depth.size >= 3:
            spread = float(np.std(depth) / np.mean(depth))
            if spread < ONE_DISTANCE:
                yield Fact(
                    "one-distance",
                    f"All boards stand at one distance from {name}: {np.mean(depth):.3g} m within "
                    f"{100 * spread:.2g} %. Focal length and distance are weakly determined. "
                    "Take images at half and at twice the distance.",
                    {"depth_m": float(np.mean(depth)), "spread": spread, "camera": camera},
                )


def _coverage(corners: Corners, camera: str, size: tuple[int, int] | None) -> Iterator[Fact]:
    """Cells of the image without a corner."""
    if size is None or not len(corners):
        return
    cell = np.floor(corners.uv / np.array(size) * np.array(CELLS)).astype(int)
    inside = ((cell >= 0) & (cell < np.array(CELLS))).all(axis=1)
    covered = len(np.unique(cell[inside] @ np.array([1, CELLS[0]])))
    share = covered / (CELLS[0] * CELLS[1])
    if share < 0.75:
        low, high = corners.uv.min(axis=0), corners.uv.max(axis=0)
        yield Fact(
            "part-of-image",
            f"Corners cover {covered} of {CELLS[0] * CELLS[1]} parts of the images of camera "
            f"{camera!r} (u {low[0]:.0f} to {high[0]:.0f} px, v {low[1]:.0f} to {high[1]:.0f} px). "
            "The distortion elsewhere is extrapolated: take images with the board there.",
            {"share": share, "camera": camera},
        )


# What the turns of a hand mean, by how far the board turns from image to image.
#
#     C_i = X A_i Y    turns by the same angle as A_i from one image to another,
#
# wherever camera and board stand, so no placement is needed to compare.


_VIEWS = 60
ALIKE = 2.0


def most_alike(ways: Mapping[str, Array], reading: Reading) -> list[str]:
    """Which of the poses (n, 4, 4) turn as the board does, by their names: those whose median
    difference is below `ALIKE` times the least; of views that allow two poses of the board the
    nearer counts. A hand that keeps an axis turns by the same angle in several of them."""
    few = reading.thinned(_VIEWS, 24)
    poses, views = view_poses(few), few.corners.views
    usable = np.flatnonzero(poses.usable)
    one, other = np.array([(i, j) for i in usable for j in usable if i < j]).reshape(-1, 2).T
    same = (views.camera[one] == views.camera[other]) & (views.board[one] == views.board[other])
    one, other = one[same], other[same]
    R = poses.T_camera_board[:, :, :3, :3]
    seen = [_angles(R[one, a], R[other, b]) for a in (0, 1) for b in (0, 1)]
    sizes = {}
    for name, T in ways.items():
        hand = T[views.image, :3, :3]
        away = np.abs(np.array(seen) - _angles(hand[one], hand[other])).min(axis=0, initial=np.inf)
        sizes[name] = float(np.median(away)) if away.size else 0.0
    return [name for name in ways if sizes[name] <= ALIKE * min(sizes.values())]


def _angles(R: Array, S: Array) -> Array:
    """(n,) [rad] between rotations."""
    cosine = (np.einsum("nij,nij->n", R, S) - 1.0) / 2.0
    return np.asarray(np.arccos(np.clip(np.nan_to_num(cosine, nan=1.0), -1.0, 1.0)))
