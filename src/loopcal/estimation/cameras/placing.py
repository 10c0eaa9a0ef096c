"""Cameras, boards and free poses placed in closed form, then adjusted: one reading of the files.

The pair of a camera and a board with most views is placed first, by several closed forms that
their reprojection ranks. Each further camera or board follows from those placed, by the pose that
most of its views agree on.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.estimation.cameras.board_pose import BoardPoses, board_poses
from loopcal.estimation.cameras.by_motion import by_motion
from loopcal.estimation.cameras.corners import Corners
from loopcal.estimation.cameras.hand_eye import HandEye, consensus
from loopcal.estimation.cameras.pixels import rays
from loopcal.estimation.cameras.scene import Adjusted, Scene, adjusted, groups, lost_directions
from loopcal.estimation.cameras.twists import mean_motion
from loopcal.mechanisms.cameras.lens import Intrinsics
from loopcal.mechanisms.placement import inverse


@dataclass(frozen=True)
class Reading:
    """One way to read the files: corners, hand, lenses, and what the flange holds.

    T_base_flange: (n, 4, 4) or None without a robot; held: the board is on the flange;
    stated: the lenses are not guesses.
    """

    corners: Corners
    T_base_flange: Array | None
    lenses: tuple[Intrinsics, ...]
    held: bool = True
    stated: bool = True

    @property
    def A(self) -> Array | None:
        """(n, 4, 4) of X A Y: the hand in the base, or its inverse with the camera on it."""
        T = self.T_base_flange
        return T if T is None or self.held else inverse(T)

    def thinned(self, images: int = 120, per_view: int = 20) -> Reading:
        """With fewer images and corners, evenly spread, for trials."""
        corners = self.corners
        order = np.unique(corners.image)
        every = order[np.linspace(0, len(order) - 1, min(images, len(order))).astype(int)]
        corners = corners.where(np.isin(corners.image, every))
        views = corners.views
        slot = np.arange(len(corners)) - views.first[views.of_corner]
        # Slots are taken in steps of the golden section, which spreads them over rows and columns.
        rank = (slot * 0.6180339887498949) % 1.0
        share = np.minimum(1.0, per_view / views.sizes)[views.of_corner]
        return replace(
            self, corners=corners.where((rank < share) | (views.sizes < per_view)[views.of_corner])
        )


def view_poses(reading: Reading) -> BoardPoses:
    """Both poses of each view, from the rays of its lens; they are not to be written to.

    A start tries many readings of the same corners, which differ in the hand or in what it holds:
    their poses are computed once.
    """
    return _poses_of(_Seen(reading))


class _Seen:
    """What the poses of views depend on, compared by contents."""

    def __init__(self, reading: Reading) -> None:
        corners, planar = reading.corners, [board.planar for board in reading.corners.boards]
        arrays = (corners.image, corners.camera, corners.board, corners.xyz, corners.uv)
        self.reading = reading
        digest = hashlib.blake2b(b"".join([one.tobytes() for one in arrays])).digest()
        self._contents = reading.lenses, tuple(planar), digest

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Seen) and self._contents == other._contents

    def __hash__(self) -> int:
        return hash(self._contents)


@lru_cache(maxsize=8)
def _poses_of(seen: _Seen) -> BoardPoses:
    poses = board_poses(seen.reading.corners, _rays(seen.reading))
    poses.T_camera_board.flags.writeable = poses.error.flags.writeable = False
    return poses


def _rays(reading: Reading) -> Array:
    corners = reading.corners
    ray = np.empty((len(corners), 2))
    for c, lens in enumerate(reading.lenses):
        mine = corners.camera == c
        ray[mine] = rays(lens, corners.uv[mine])
    return ray


def _by_motion(reading: Reading) -> Scene | None:
    """A scene of boards on the hand, from how it moves."""
    if reading.A is None or not reading.held:
        return None
    places = by_motion(reading.corners, _rays(reading), reading.A)
    if places is None:
        return None
    scene = Scene(reading.lenses, *places, A=reading.A, held=True)
    return _anchored(scene, reading)


def placed(
    reading: Reading,
    poses: BoardPoses,
    lens: Sequence[str] = (),
    *,
    iterations: int = 15,
    hopeless: float = np.inf,
    draws: int = 8,
    rig: Array | None = None,
) -> Adjusted | None:
    """The best adjusted scene of a reading.

    None where neither a view nor the motion of a hand places anything, or where the closed forms
    leave more than `hopeless` px; draws:
    random starts of the closed forms beside those from all images. rig: (cameras, 4, 4) where the
    cameras may stand to each other, which without a robot few images tell.
    """
    if not poses.usable.any():
        start = _by_motion(reading)
        return None if start is None else _settled(reading, start, lens, iterations)
    if reading.A is None:
        seen, poses = usable_part(reading, poses)
        rigs = [X for X in (rig, _rig(seen, poses)) if X is not None]
        scenes = [_free(seen, poses, X) for X in rigs]
        best = min(scenes, key=lambda scene: _core(seen.corners, scene))
        return _settled(seen, best, lens, iterations)
    few = reading.thinned(60, 8)
    scenes = [_extended(reading, poses, start) for start in closed_forms(reading, poses, draws)]
    sizes = [_core(few.corners, scene) for scene in scenes]
    if not min(sizes) < hopeless:
        return None
    # Two, for the first steps may rank them anew; those far behind the first cannot.
    order = [i for i in np.argsort(sizes)[:2] if sizes[i] < 2.0 * min(sizes) + 1e-9]
    trials = [_settled(reading, scenes[i], lens, iterations) for i in _apart(order, sizes)]
    return min(trials, key=lambda trial: trial.core)


def _apart(order: list[int], sizes: list[float]) -> list[int]:
    """Without those that the closed forms left as large as the one before: they are the same."""
    return [i for k, i in enumerate(order) if k == 0 or sizes[i] > 1.01 * sizes[order[k - 1]]]


def usable_part(reading: Reading, poses: BoardPoses) -> tuple[Reading, BoardPoses]:
    """Only the views that have a pose: without a robot the others say nothing."""
    if poses.usable.all():
        return reading, poses
    keep = poses.usable
    corners = reading.corners.where(keep[reading.corners.views.of_corner])
    return replace(reading, corners=corners), BoardPoses(
        poses.T_camera_board[keep], poses.error[keep]
    )


def _core(corners: Corners, scene: Scene) -> float:
    return Adjusted(scene, scene.residuals(corners), {}).core


def _settled(reading: Reading, scene: Scene, lens: Sequence[str], iterations: int) -> Adjusted:
    """Placements first, then with the named values of lenses."""
    result = adjusted(reading.corners, scene, iterations=iterations)
    if lens:
        result = adjusted(reading.corners, result.scene, lens, iterations=2 * iterations)
    return result


def closed_forms(
    reading: Reading, poses: BoardPoses, draws: int, *, scaled: bool = False
) -> list[tuple[int, int, HandEye]]:
    """Candidates (camera, board, hand-eye) for the pair with most views."""
    assert reading.A is not None
    views = reading.corners.views
    pair = views.camera * len(reading.corners.boards) + views.board
    counts = np.bincount(pair[poses.usable])
    best = int(np.argmax(counts))
    mine = (pair == best) & poses.usable
    candidates = consensus(
        reading.A[views.image[mine]],
        poses.T_camera_board[mine],
        poses.error[mine],
        draws,
        scaled=scaled,
    )
    camera, board = divmod(best, len(reading.corners.boards))
    return [(camera, board, candidate) for candidate in candidates]


def _extended(reading: Reading, poses: BoardPoses, start: tuple[int, int, HandEye]) -> Scene:
    """All cameras and boards placed from one pair of them."""
    assert reading.A is not None
    views, A = reading.corners.views, reading.A
    X = np.broadcast_to(np.eye(4), (len(reading.lenses), 4, 4)).copy()
    Y = np.broadcast_to(np.eye(4), (len(reading.corners.boards), 4, 4)).copy()
    camera, board, solution = start
    X[camera], Y[board] = solution.X, solution.Y
    cameras, boards = {camera}, {board}
    for _ in range(len(X) + len(Y)):
        for c, b in sorted(set(zip(views.camera.tolist(), views.board.tolist(), strict=True))):
            mine = (views.camera == c) & (views.board == b) & poses.usable
            if (c in cameras) == (b in boards) or not mine.any():
                continue
            C, usable = poses.T_camera_board[mine], np.isfinite(poses.error[mine])
            hand = A[views.image[mine]][:, None]
            if c in cameras:
                Y[b] = agreed(inverse(hand) @ inverse(X[c]) @ C, usable)
                boards.add(b)
            else:
                X[c] = agreed(C @ inverse(hand @ Y[b]), usable)
                cameras.add(c)
    return _anchored(Scene(reading.lenses, X, Y, A=A, held=reading.held), reading)


def _anchored(scene: Scene, reading: Reading) -> Scene:
    """What no image tells of a place on the flange goes to the other side: there it is zero."""
    assert reading.T_base_flange is not None
    R = reading.T_base_flange[np.unique(reading.corners.image), :3, :3]
    lost, mean = lost_directions(R), R.mean(axis=0)
    X, Y = scene.X.copy(), scene.Y.copy()
    if reading.held:
        away = lost @ lost.T @ Y[0, :3, 3]
        Y[:, :3, 3] -= away
        X[:, :3, 3] += X[:, :3, :3] @ mean @ away
    else:
        away = -lost @ lost.T @ X[0, :3, :3].T @ X[0, :3, 3]
        X[:, :3, 3] += X[:, :3, :3] @ away
        Y[:, :3, 3] -= mean @ away
    return replace(scene, X=X, Y=Y, lost=lost)


def agreed(T: Array, usable: NDArray[np.bool_]) -> Array:
    """(4, 4) on which most of the poses T (n, s, 4, 4) agree: a medoid, then a weighted mean."""
    every = T[usable]
    some = every[np.linspace(0, len(every) - 1, min(len(every), 200)).astype(int)]
    size = max(float(np.median(np.abs(some[:, :3, 3]))), 1e-9)

    def apart(one: Array, many: Array) -> Array:
        turn = np.linalg.norm(one[..., :3, :3] - many[:, :3, :3], axis=(-2, -1))
        shift = np.linalg.norm(one[..., :3, 3] - many[:, :3, 3], axis=-1)
        return np.asarray(turn + shift / size)

    medoid = min(some, key=lambda one: float(np.median(np.minimum(apart(one, some), 1.0))))
    distance = apart(medoid, every)
    # Half of the two branches are false: the nearest quarter is true with any two of three views.
    scale = max(float(np.quantile(distance, 0.25)), 1e-9)
    return mean_motion(every, 1.0 / (1.0 + (distance / (2.0 * scale)) ** 2) ** 2)


def _rig(reading: Reading, poses: BoardPoses) -> Array:
    """(cameras, 4, 4) where the cameras stand to the first, by boards that two of them see."""
    views = reading.corners.views
    group = groups(views)
    X = np.broadcast_to(np.eye(4), (len(reading.lenses), 4, 4)).copy()
    placed_cameras = {0}
    for _ in range(len(X)):
        for c in range(1, len(X)):
            partners = [
                (i, j)
                for d in sorted(placed_cameras)
                for i, j in _common(views.camera, group, poses.usable, c, d)
            ]
            if c in placed_cameras or not partners:
                continue
            i, j = np.array(partners).T
            C_i, C_j = poses.T_camera_board[i], poses.T_camera_board[j]
            to_first = inverse(X[views.camera[j]])[:, None] @ C_j
            relative = C_i[:, :, None] @ inverse(to_first)[:, None]
            both = np.isfinite(poses.error[i])[:, :, None] & np.isfinite(poses.error[j])[:, None]
            X[c] = agreed(relative.reshape(len(i), 4, 4, 4), both.reshape(len(i), 4))
            placed_cameras.add(c)
    return X


def _free(reading: Reading, poses: BoardPoses, X: Array) -> Scene:
    """Of the poses that each view allows, the one that all views of its image fit best.

    A view of few corners often fits a wrong pose as well: the other cameras decide.
    """
    corners, views = reading.corners, reading.corners.views
    group = groups(views)
    F = np.broadcast_to(np.eye(4), (int(group.max()) + 1, 4, 4)).copy()
    least = np.full(len(F), np.inf)
    for camera in range(len(X)):
        mine = np.flatnonzero(views.camera == camera)
        for branch in (0, 1):
            some = mine[np.isfinite(poses.error[mine, branch])]
            trial = F.copy()
            trial[group[some]] = inverse(X[camera]) @ poses.T_camera_board[some, branch]
            r = Scene(reading.lenses, X, np.eye(4)[None], F=trial).residuals(corners)
            size = np.bincount(group, views.sums(np.linalg.norm(r, axis=1)), len(F))
            better = np.zeros(len(F), dtype=bool)
            better[group[some]] = size[group[some]] < least[group[some]]
            F[better], least[better] = trial[better], size[better]
    return Scene(reading.lenses, X, np.eye(4)[None], F=F)


def _common(
    camera: NDArray[np.intp], group: NDArray[np.intp], usable: NDArray[np.bool_], c: int, d: int
) -> list[tuple[int, int]]:
    """Pairs of views of two cameras that see the same board in the same image."""
    of_d = {int(group[j]): int(j) for j in np.flatnonzero((camera == d) & usable)}
    mine = np.flatnonzero((camera == c) & usable)
    return [(int(i), of_d[int(group[i])]) for i in mine if int(group[i]) in of_d]
