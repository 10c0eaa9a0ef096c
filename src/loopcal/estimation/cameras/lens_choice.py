"""Which model describes a lens that no file states.

Each model is adjusted to images of boards that stand anywhere: errors of a robot would hide what a
lens leaves. A model of more terms takes up some of a print that is bent. So one that fits better is
asked twice: it is adjusted without a part of the images, with each point of the boards where the
others show it, and has to describe this part better, by more than chance from image to image.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.estimation.cameras.corners import Corners
from loopcal.estimation.cameras.pixels import by_point
from loopcal.estimation.cameras.scene import REDESCENDING, Scene, adjusted, ahead, groups
from loopcal.mechanisms.cameras.lens import LENSES, Intrinsics

Squares = tuple[Array, NDArray[np.intp]]
"""Of each image the mean square [px^2] of distances, of wrong corners by `WRONG`, and the count."""
EVERY = ("f", "cx", "cy", *LENSES["brown12"])
"""What is adjusted of lenses."""
SURE = 20.0
"""Gain in log likelihood from which corners show another lens: more than half of log n for each of
four coefficients (Schwarz 1978), for any n of corners up to 20,000."""
WRONG = 4.0
"""Medians of the residuals from which on a corner counts as wrong."""
# Chosen, not derived: printed boards are detected by two and more times as much.
FINEST = 0.02
"""[px] Residuals of corners, rms, below which no other lens is asked for."""
ERRORS = 2.0
"""Standard errors over images of the same: a few images show no lens. Of images that are left out
one is enough, as more terms describe these worse by themselves."""
# Chosen, not derived: of halves the ones that adjust a lens are too few where images are.
_PARTS = 5
"""Parts of the images that are left out in turn: another lens is asked for from so many on."""
# Chosen, not derived: places of points and lens are found in turn, and the third changes little.
_ROUNDS = 3


@dataclass(frozen=True, eq=False)
class Trial:
    """Some images and corners, boards with free poses; residuals: (N, 2) [px]."""

    corners: Corners
    scene: Scene
    residuals: Array

    @classmethod
    def of(cls, corners: Corners, scene: Scene) -> Trial:
        """Adjusted, with its lenses."""
        # More terms would stand in for pixels that are not square.
        every = ("aspect", *EVERY)
        names = [n for n in every if all(n in lens.values for lens in scene.intrinsics)]
        first = adjusted(corners, scene, names, iterations=20)
        last = adjusted(corners, first.scene, names, iterations=20, loss=REDESCENDING)
        return cls(corners, last.scene, last.residuals)

    def with_lens(self, lens: str, cameras: Collection[str]) -> Trial:
        """With another lens of the same family in these cameras."""
        lenses = tuple(
            Intrinsics.of(lens, dict.fromkeys(LENSES[lens], 0.0) | one.values, one.image)
            if camera in cameras
            else one
            for camera, one in zip(self.corners.cameras, self.scene.intrinsics, strict=True)
        )
        return Trial.of(self.corners, replace(self.scene, intrinsics=lenses))

    @property
    def squares(self) -> Squares:
        """Without what a point of a board that is elsewhere does alike in all images."""
        return self._squares(self.residuals - self._of_points()[1])

    @property
    def rms(self) -> float:
        """[px] of the same."""
        return rms_of(self.squares)

    def not_used(self) -> Squares:
        """Of each part of the images, by lens and print of the others."""
        part = (np.cumsum(np.bincount(self.corners.image) > 0) % _PARTS)[self.corners.image]
        size = len(self.corners.poses)
        total: Squares = np.zeros(size), np.zeros(size, np.intp)
        for k in range(_PARTS):
            learnt = self._of(part != k)
            for _ in range(_ROUNDS):
                learnt = Trial.of(learnt._as_printed().corners, learnt.scene)
            other = self._of(part == k)
            corners = replace(other.corners, boards=learnt.corners.boards)
            lenses, X = learnt.scene.intrinsics, learnt.scene.X
            scene = replace(other.scene, intrinsics=lenses, X=X)
            seen = adjusted(corners, scene, iterations=20, loss=REDESCENDING)
            squares = Trial(corners, seen.scene, seen.residuals)._squares(seen.residuals)
            total = total[0] + squares[0], total[1] + squares[1]
        return total

    def _of(self, keep: NDArray[np.bool_]) -> Trial:
        """Some of the corners, those of whole images."""
        corners, scene = self.corners.where(keep), self.scene
        assert scene.F is not None
        views = self.corners.views
        kept = np.unique(groups(views)[np.isin(views.image, corners.image)])
        return Trial(corners, replace(scene, F=scene.F[kept]), self.residuals[keep])

    def _as_printed(self) -> Trial:
        """With the points of the boards where the images show them."""
        moved, _ = self._of_points()
        boards, first = [], 0
        for board in self.corners.boards:
            xyz = board.xyz + moved[first : first + len(board.points)]
            first += len(board.points)
            points = dict(zip(board.points, map(tuple, xyz.tolist()), strict=True))
            boards.append(replace(board, points=points))
        return replace(self, corners=replace(self.corners, boards=tuple(boards)))

    def _of_points(self) -> tuple[Array, Array]:
        """How far points of all boards are off (n, 3) [m], and what that makes of the residuals."""
        corners, left = self.corners, self.residuals
        T = self.scene.of_views(corners.views)[corners.views.of_corner]
        P = (T[:, :3, :3] @ corners.xyz[:, :, None])[:, :, 0] + T[:, :3, 3]
        J = np.empty((len(corners), 2, 3))
        for c, lens in enumerate(self.scene.intrinsics):
            mine = corners.camera == c
            J[mine] = by_point(lens.lens, ahead(P[mine]), lens.values) @ T[mine, :3, :3]
        d = np.hypot(*left.T)
        J_good = np.where((d < WRONG * np.median(d))[:, None, None], J, 0.0)
        counts = np.cumsum([0, *(len(board.points) for board in corners.boards)])
        point = counts[corners.board] + corners.point
        N, g = np.zeros((counts[-1], 3, 3)), np.zeros((counts[-1], 3))
        np.add.at(N, point, np.swapaxes(J_good, 1, 2) @ J_good)
        np.add.at(g, point, np.einsum("nij,ni->nj", J_good, left))
        moved = np.einsum("kij,kj->ki", np.linalg.pinv(N, rcond=1e-6, hermitian=True), g)
        return moved, np.einsum("nij,nj->ni", J, moved[point])

    def _squares(self, residuals: Array) -> Squares:
        image, size = self.corners.image, len(self.corners.poses)
        d = np.hypot(*residuals.T)
        count = np.bincount(image, minlength=size)
        sums = np.bincount(image, np.minimum(d, WRONG * np.median(d)) ** 2, size)
        return sums / np.maximum(count, 1), count


def rms_of(squares: Squares) -> float:
    """[px] Over all corners."""
    square, count = squares
    return float(np.sqrt(square @ count / count.sum()))


def clearly_better(other: Trial, one: Trial) -> bool:
    """Whether the lens of the first fits more likely, and in images by more than chance, those that
    it was adjusted to and those that it was not."""
    if min(len(np.unique(each.corners.image)) for each in (other, one)) < _PARTS:
        return False
    return _gains(other.squares, one.squares, ERRORS) and _gains(
        other.not_used(), one.not_used(), 1.0
    )


def _gains(other: Squares, one: Squares, errors: float) -> bool:
    """Whether log likelihood grows by `SURE` and so many standard errors over images."""
    (less, n), (more, m) = other, one
    gain = np.minimum(n, m) * (more - less) / max(rms_of(other), FINEST) ** 2
    gain = gain[(n > 0) & (m > 0)]
    error = np.sqrt(len(gain)) * gain.std()
    return bool(gain.sum() > max(SURE, errors * error))
