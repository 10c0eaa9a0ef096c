"""The pose of a board from one view, with both answers where a plane allows two.

Planes: Collins and Bartoli (2014), from the homography's first derivatives at the middle of the
view's corners. With J (2 x 2) that derivative, (p, q) the middle's ray, and R_v the rotation of z
onto (p, q, 1):  (I | -(p, q)^T) R_v(:, :2) S = J / gamma. S is the upper left block of a rotation,
whose third row is determined but for its sign: two poses. Bodies of points in space: many starts.
Both are refined by reprojection with weights that wrong corners lose.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.estimation.cameras.corners import Corners, Views
from loopcal.estimation.cameras.homography import homographies, robust_weights, spread
from loopcal.estimation.cameras.twists import moved
from loopcal.mechanisms.placement import inverse, rigid
from loopcal.mechanisms.rotations import nearest_rotation, skew


@dataclass(frozen=True)
class BoardPoses:
    """T_camera_board (V, 2, 4, 4) of each view, the better one first, with its error.

    error: (V, 2) robust rms of the rays' distances X/Z, Y/Z; inf where a view has no pose.
    """

    T_camera_board: Array
    error: Array

    @property
    def usable(self) -> NDArray[np.bool_]:
        """(V,) the views that have a pose."""
        return np.isfinite(self.error[:, 0])


def board_poses(corners: Corners, ray: Array) -> BoardPoses:
    """From rays X/Z, Y/Z (N, 2) of the corners.

    A view of a plane needs four corners that are not on one line, a view of a body as well.
    """
    views = corners.views
    T = np.broadcast_to(np.eye(4), (len(views), 2, 4, 4)).copy()
    error = np.full((len(views), 2), np.inf)
    flat = np.array([board.planar for board in corners.boards])[views.board]
    for planar in (True, False):
        chosen = flat == planar
        if not chosen.any():
            continue
        some = corners.where(chosen[views.of_corner])
        solve = _of_plane if planar else _of_body
        T[chosen], error[chosen] = solve(some, ray[chosen[views.of_corner]])
    return BoardPoses(T, error)


def _of_plane(corners: Corners, ray: Array) -> tuple[Array, Array]:
    views = corners.views
    xy = corners.xyz[:, :2]
    height = corners.xyz[views.first, 2]
    middle = views.sums(xy) / views.sizes[:, None]
    H, _ = homographies(views, xy - middle[views.of_corner], ray)
    T = _two_poses(H)
    # Back from the middle of the corners, at their height, to the board's frame.
    back = np.broadcast_to(np.eye(4), (len(views), 4, 4)).copy()
    back[:, :2, 3], back[:, 2, 3] = -middle, -height
    both = [refined(views, corners.xyz, ray, T[:, i] @ back) for i in (0, 1)]
    return _ranked(both, spread(views, xy))


def _two_poses(H: Array) -> Array:
    """(V, 2, 4, 4) from homographies (V, 3, 3) of rays, about each plane's origin."""
    H = H / np.where(np.abs(H[:, 2:, 2:]) < 1e-12, 1e-12, H[:, 2:, 2:])
    pq = H[:, :2, 2]
    J = H[:, :2, :2] - pq[:, :, None] * H[:, 2:, :2]
    ray = np.column_stack([pq, np.ones(len(H))])
    z = ray / np.linalg.norm(ray, axis=1)[:, None]
    # The rotation of (0, 0, 1) onto z about their normal: I + [n] + [n]^2 / (1 + cos).
    N = skew(np.stack([-z[:, 1], z[:, 0], np.zeros(len(z))], axis=1))
    Rv = np.eye(3) + N + N @ N / (1.0 + z[:, 2])[:, None, None]
    left = Rv[:, :2, :2] - pq[:, :, None] * Rv[:, 2:, :2]
    A = np.linalg.solve(left, J)
    gamma = np.maximum(np.linalg.norm(A, 2, axis=(1, 2)), 1e-12)
    S = A / gamma[:, None, None]
    rest = np.eye(2) - np.swapaxes(S, 1, 2) @ S
    low = np.sqrt(np.maximum(np.stack([rest[:, 0, 0], rest[:, 1, 1]], axis=1), 0.0))
    low[:, 1] *= np.where(rest[:, 0, 1] < 0.0, -1.0, 1.0)
    out = []
    for sign in (1.0, -1.0):
        columns = np.concatenate([S, sign * low[:, None, :]], axis=1)
        third = np.cross(columns[:, :, 0], columns[:, :, 1])
        R = Rv @ np.concatenate([columns, third[:, :, None]], axis=2)
        out.append(rigid(nearest_rotation(R), ray / gamma[:, None]))
    return np.stack(out, axis=1)


def _of_body(corners: Corners, ray: Array) -> tuple[Array, Array]:
    """From the 24 rotations of a cube as starts, the two best that differ."""
    from scipy.spatial.transform import Rotation

    views = corners.views
    starts = np.asarray(Rotation.create_group("O").as_matrix())
    middle = views.sums(ray) / views.sizes[:, None]
    width = np.sqrt(views.sums((ray - middle[views.of_corner]) ** 2).sum(axis=1))
    centre = views.sums(corners.xyz) / views.sizes[:, None]
    size = np.sqrt(views.sums((corners.xyz - centre[views.of_corner]) ** 2).sum(axis=1))
    # Two of three axes are seen: depth is size over width, times sqrt(2/3).
    depth = np.sqrt(2.0 / 3.0) * size / np.maximum(width, 1e-9)
    toward = np.column_stack([middle, np.ones(len(views))]) * depth[:, None]
    cube = np.broadcast_to(starts[:, None], (len(starts), len(views), 3, 3))
    place = toward - np.einsum("sij,vj->svi", starts, centre)
    # Four iterations rank the starts; the best five of each view go on.
    T, error = _all_refined(corners, ray, rigid(cube, place), iterations=4)
    order = np.argsort(error, axis=0)[:5]
    T, error = _all_refined(corners, ray, T[order, np.arange(len(views))], iterations=10)
    return _best_two(np.swapaxes(T, 0, 1), error.T, views.sizes >= 4)


def _all_refined(corners: Corners, ray: Array, T: Array, *, iterations: int) -> tuple[Array, Array]:
    """`refined` from several poses T (s, V, 4, 4) per view in one go."""
    count, views, n = len(T), corners.views, len(corners)
    image, camera, board = (np.tile(k, count) for k in (views.image, views.camera, views.board))
    first = np.concatenate([views.first + k * n for k in range(count)])
    of_corner = np.concatenate([views.of_corner + k * len(views) for k in range(count)])
    repeated = Views(image, camera, board, first, of_corner)
    xyz, rays = np.tile(corners.xyz, (count, 1)), np.tile(ray, (count, 1))
    T, error = refined(repeated, xyz, rays, T.reshape(-1, 4, 4), iterations=iterations)
    return T.reshape(count, -1, 4, 4), error.reshape(count, -1)


def _best_two(T: Array, error: Array, usable: NDArray[np.bool_]) -> tuple[Array, Array]:
    rows = np.arange(len(T))
    first = np.argmin(error, axis=1)
    best = T[rows, first]
    alike = np.einsum("vij,vsij->vs", best[:, :3, :3], T[:, :, :3, :3])
    # tr(R^T R') = 1 + 2 cos: below 2.9 the rotations differ by more than 18 degrees.
    second = np.argmin(np.where(alike > 2.9, np.inf, error), axis=1)
    return _ranked([(best, error[rows, first]), (T[rows, second], error[rows, second])], usable)


def _ranked(both: list[tuple[Array, Array]], usable: NDArray[np.bool_]) -> tuple[Array, Array]:
    T = np.stack([pose for pose, _ in both], axis=1)
    error = np.stack([e for _, e in both], axis=1)
    error[~usable] = np.inf
    order = np.argsort(error, axis=1)
    rows = np.arange(len(T))[:, None]
    return T[rows, order], error[rows, order]


def refined(
    views: Views, xyz: Array, ray: Array, T: Array, *, iterations: int = 10
) -> tuple[Array, Array]:
    """T_camera_board (V, 4, 4) with least robust reprojection in rays, and its rms (V,).

    Levenberg's method, each view with its damping; a pose with corners behind the camera has the
    error inf.
    """
    weight = np.ones(len(ray))
    damping = np.full(len(views), 1e-3)
    P, r = _misses(views, xyz, ray, T)
    for step in range(iterations):
        if step in (2, 4, 6):
            weight = robust_weights(views, np.linalg.norm(r, axis=1))
        cost = views.sums(weight * (r**2).sum(axis=1))
        near = np.abs(P[:, 2:]) < 1e-9
        Z = np.where(near, 1e-9, P[:, 2:])
        J = np.zeros((len(P), 2, 6))
        J[:, 0, 0] = J[:, 1, 1] = 1.0
        J[:, :, 2] = -P[:, :2] / Z
        J[:, :, :3] /= Z[:, :, None]
        J[:, :, 3:] = -J[:, :, :3] @ skew(P)
        rows = np.sqrt(weight)[:, None, None] * np.concatenate([J, r[:, :, None]], axis=2)
        product = views.products(rows)
        N, g = product[:, :6, :6], product[:, :6, 6]
        diagonal = np.einsum("vii->vi", N)
        N = N + np.einsum("v,vi,ij->vij", damping, diagonal, np.eye(6)) + 1e-15 * np.eye(6)
        trial = moved(T, np.linalg.solve(N, g[:, :, None])[:, :, 0])
        P_trial, r_trial = _misses(views, xyz, ray, trial)
        better = views.sums(weight * (r_trial**2).sum(axis=1)) < cost
        T = np.where(better[:, None, None], trial, T)
        of_corner = better[views.of_corner][:, None]
        P, r = np.where(of_corner, P_trial, P), np.where(of_corner, r_trial, r)
        damping = np.where(better, damping / 5.0, damping * 5.0)
        # Later steps that change no pose by 1e-9 of a ray's unit cannot be seen in a pixel.
        if step > 6 and np.abs(g).max(initial=0.0) < 1e-9:
            break
    distance = np.linalg.norm(r, axis=1)
    weight = robust_weights(views, distance)
    error = np.sqrt(views.sums(weight * distance**2) / views.sums(weight))
    behind = views.sums((P[:, 2] <= 0.0).astype(float)) > 0.2 * views.sizes
    return T, np.where(behind, np.inf, error)


def _misses(views: Views, xyz: Array, ray: Array, T: Array) -> tuple[Array, Array]:
    each = T[views.of_corner]
    P = (each[:, :3, :3] @ xyz[:, :, None])[:, :, 0] + each[:, :3, 3]
    Z = np.where(np.abs(P[:, 2:]) < 1e-9, 1e-9, P[:, 2:])
    return P, ray - P[:, :2] / Z


def facing(T_camera_board: Array) -> Array:
    """(...,) z of the camera in the board's frame [m]: positive where it is in front."""
    return np.asarray(inverse(T_camera_board)[..., 2, 3])
