"""Where a camera and a board stand, from poses of both ends: C_i = X A_i Y in closed form.

C_i is the board in the camera at image i. With the board on the flange A_i = T_base_flange, X is
T_camera_base and Y is T_flange_board. With the camera there A_i is its inverse, X is
T_camera_flange and Y is T_base_board. The rotations maximise sum tr(R_C^T R_X R_A R_Y) by the two
leading singular vectors of a 9 x 9 matrix (Shah 2013). Others take the logarithms of relative
motions (Park and Martin 1994) or dual quaternions (Daniilidis 1999). Translations follow by least
squares, with a scale s of the robot's lengths against the board's:

    t_C = R_X R_A t_Y + s R_X t_A + t_X.

s = 1000 is a unit, s = -1 a mirror. Directions that no image determines stay at zero.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.mechanisms.placement import rigid
from loopcal.mechanisms.rotations import nearest_rotation, rotation_by, rotation_vector

Method = Callable[[Array, Array, Array], list[tuple[Array, Array]]]
"""Rotations (R_X, R_Y) from A, C (n, 4, 4) and weights (n,)."""
_SHORT = 1e-4
"""Singular values below this share of the largest count as zero: 0.1 mrad of turns beside 1 rad."""


ONE_AXIS = 0.1
"""Share of turns about other axes below which their noise spoils a rotation by 0.1 rad or more."""


@dataclass(frozen=True)
class HandEye:
    """X and Y (4, 4) of C_i = X A_i Y, and the scale of the translations of A."""

    X: Array
    Y: Array
    scale: float

    def predicted(self, A: Array) -> Array:
        """X A_i Y (n, 4, 4), A_i (n, 4, 4) with its translations scaled."""
        scaled = A.copy()
        scaled[:, :3, 3] *= self.scale
        return np.asarray(self.X @ scaled @ self.Y)


def shah(A: Array, C: Array, weight: Array) -> list[tuple[Array, Array]]:
    """(R_X, R_Y) by the Kronecker product, weights (n,); one pair, or none without rotations."""
    K = np.einsum("i,ibc,iad->abcd", weight, A[:, :3, :3], C[:, :3, :3]).reshape(9, 9)
    U, s, Vt = np.linalg.svd(K)
    if s[1] > (1.0 - _SHORT) * s[0]:
        return []
    x, y = U[:, 0].reshape(3, 3), Vt[0].reshape(3, 3)
    sign = np.sign(np.linalg.det(x)) or 1.0
    return [(nearest_rotation(sign * x), nearest_rotation(sign * y))]


def park(A: Array, C: Array, weight: Array) -> list[tuple[Array, Array]]:
    """(R_X, R_Y) from the axes of relative motions: log(C_i^-1 C_j) = R_Y^T log(A_i^-1 A_j)."""
    a, c, w = _relative(A, C, weight)
    R_Y = nearest_rotation(np.einsum("i,ij,ik->jk", w, rotation_vector(a), rotation_vector(c)))
    R_X = nearest_rotation(np.einsum("i,iab,bc,idc->ad", weight, C[:, :3, :3], R_Y.T, A[:, :3, :3]))
    return [(R_X, R_Y)]


def daniilidis(A: Array, C: Array, weight: Array) -> list[tuple[Array, Array]]:
    """(R_X, R_Y) from the real parts of dual quaternions: q_a q_Y = q_Y q_c, q_a0 = q_c0."""
    from scipy.spatial.transform import Rotation

    a, c, w = _relative(A, C, weight)
    pair = [Rotation.from_matrix(R).as_quat(canonical=True) for R in (a, c)]
    (va, sa), (vc, sc) = [(q[:, :3], q[:, 3]) for q in pair]
    rows = np.zeros((len(w), 4, 4))
    rows[:, :3, 0] = va - vc
    total = va + vc
    rows[:, 0, 2], rows[:, 0, 3], rows[:, 1, 3] = -total[:, 2], total[:, 1], -total[:, 0]
    rows[:, 1, 1], rows[:, 2, 1], rows[:, 2, 2] = total[:, 2], -total[:, 1], total[:, 0]
    # Weighted also by agreement of the scalar parts, which no Y can change.
    w = w * np.exp(-(((sa - sc) / 0.05) ** 2))
    normal = np.einsum("i,ijk,ijl->kl", w, rows, rows)
    q = np.linalg.eigh(normal)[1][:, 0]
    R_Y = Rotation.from_quat([*q[1:], q[0]]).as_matrix()
    R_X = nearest_rotation(np.einsum("i,iab,bc,idc->ad", weight, C[:, :3, :3], R_Y.T, A[:, :3, :3]))
    return [(R_X, R_Y)]


def _relative(A: Array, C: Array, weight: Array) -> tuple[Array, Array, Array]:
    """Rotations from each image to the next and to one half a row further, with their weights."""
    n = len(A)
    i = np.concatenate([np.arange(n), np.arange(n)])
    j = np.concatenate([(np.arange(n) + 1) % n, (np.arange(n) + n // 2) % n])
    a, c = (np.swapaxes(R[i], 1, 2) @ R[j] for R in (A[:, :3, :3], C[:, :3, :3]))
    return a, c, np.sqrt(weight[i] * weight[j])


def aligned(A: Array, C: Array, weight: Array) -> list[tuple[Array, Array]]:
    """(R_X, R_Y) of a hand that does not turn: R_X aligns two sets of positions (Kabsch 1976).

    Two pairs: the second for positions that one side sees mirrored.
    """
    w = weight / weight.sum()
    a, c = (T[:, :3, 3] - w @ T[:, :3, 3] for T in (A, C))
    M = np.einsum("i,ij,ik->jk", w, c, a)
    pairs = []
    for sign in (1.0, -1.0):
        R_X = nearest_rotation(sign * M)
        R_Y = nearest_rotation(
            np.einsum("i,iba,cb,icd->ad", weight, A[:, :3, :3], R_X, C[:, :3, :3])
        )
        pairs.append((R_X, R_Y))
    return pairs


def about_one_axis(A: Array, R_X: Array, R_Y: Array) -> list[tuple[Array, Array]]:
    """Other pairs with the same R_X R_A R_Y for turns about one axis n of the hand; else none.

    R_A = R_0 exp([n] a) for all images: R_Y' = exp([n] b) R_Y and R_X' = R_X R_0 exp(-[n] b) R_0^T
    for any b. Only positions tell b: seven more of its values are tried.
    """
    turns = rotation_vector(np.swapaxes(A[:1, :3, :3], 1, 2) @ A[:, :3, :3])
    size, axes = np.linalg.eigh(turns.T @ turns)
    if size[1] > ONE_AXIS**2 * size[2]:
        return []
    R_0, angles = A[0, :3, :3], np.arange(1, 8) * np.pi / 4.0
    about = rotation_by(angles[:, None] * axes[:, 2])
    return [(R_X @ R_0 @ R.T @ R_0.T, R @ R_Y) for R in about]


def translations(
    A: Array, C: Array, weight: Array, R_X: Array, R_Y: Array, *, scaled: bool
) -> HandEye:
    """The best translations, and the scale if `scaled`, for rotations that are held."""
    n = len(A)
    a = A[:, :3, 3] @ R_X.T
    rows = np.zeros((n, 3, 7))
    rows[:, :, :3] = R_X @ A[:, :3, :3]
    rows[:, :, 3:6] = np.eye(3)
    rows[:, :, 6] = a
    right = C[:, :3, 3]
    if not scaled:
        rows, right = rows[:, :, :6], right - a
    w = np.sqrt(weight)[:, None]
    size = max(float(np.abs(a).max(initial=0.0)), 1e-12)
    unit = np.array([1.0] * 6 + [1.0 / size])[: rows.shape[2]]
    solution, *_ = np.linalg.lstsq(
        (w[:, :, None] * rows * unit).reshape(3 * n, -1), (w * right).reshape(-1), rcond=_SHORT
    )
    solution = solution * unit
    scale = float(solution[6]) if scaled else 1.0
    return HandEye(rigid(R_X, solution[3:6]), rigid(R_Y, solution[:3]), scale)


@dataclass(frozen=True)
class _Images:
    """A (n, 4, 4) and both poses C (n, 2, 4, 4) of each image, usable where finite."""

    A: Array
    C: Array
    usable: NDArray[np.bool_]

    def turned(self, R_X: Array, R_Y: Array) -> tuple[Array, Array]:
        """The branches nearer to R_X R_A R_Y (n, 4, 4), and how far they are [rad]."""
        predicted = R_X @ self.A[:, :3, :3] @ R_Y
        agreement = np.einsum("nsij,nij->ns", self.C[:, :, :3, :3], predicted)
        agreement = np.where(self.usable, agreement, -1.0)
        branch = np.argmax(agreement, axis=1)
        rows = np.arange(len(branch))
        angle = np.arccos(np.clip((agreement[rows, branch] - 1.0) / 2.0, -1.0, 1.0))
        return self.C[rows, branch], angle


def consensus(
    A: Array, C: Array, error: Array, draws: int, *, scaled: bool = False
) -> list[HandEye]:
    """Hand-eye candidates from two poses per image: C (n, 2, 4, 4), error (n, 2).

    The branch of each image is chosen by the candidate itself, and images that disagree lose their
    weight: three rounds from the better branch of all images, and from random draws of six.
    """
    random = np.random.default_rng(6)
    n = len(A)
    images = _Images(A, C, np.isfinite(error))
    every = np.ones(n)
    pairs = [_rotations(images, C[:, 0], every, method) for method in METHODS]
    for _ in range(draws):
        weight = np.zeros(n)
        weight[random.choice(n, size=min(n, 6), replace=False)] = 1.0
        branch = np.where(images.usable[:, 1] & (random.random(n) < 0.5), 1, 0)
        pairs.append(_rotations(images, C[np.arange(n), branch], weight, shah))
    ranked = sorted((p for p in pairs if p is not None), key=lambda pair: pair[0])[:3]
    starts = [(R_X, R_Y) for _, R_X, R_Y in ranked] + aligned(A, C[:, 0], every)
    if ranked:
        starts += about_one_axis(A, *ranked[0][1:])
    settled = [_settled(images, R_X, R_Y, scaled=scaled) for R_X, R_Y in starts]
    return [candidate for _, candidate in sorted(settled, key=lambda pair: pair[0])[:4]]


def of_poses(A: Array, C: Array) -> tuple[float, HandEye]:
    """The best of one pose per image, and the geometric mean of its misses: angle [rad], and place
    over distance. A pose far off counts, but does not decide."""
    never = np.stack([np.zeros(len(A)), np.full(len(A), np.inf)], axis=1)
    ways = []
    for one in consensus(A, np.stack([C, C], axis=1), never, draws=20):
        off = one.predicted(A)
        turned = np.linalg.norm(off[:, :3, :3] - C[:, :3, :3], axis=(1, 2)) / np.sqrt(2.0)
        apart = np.linalg.norm(off[:, :3, 3] - C[:, :3, 3], axis=1)
        distance = max(median(np.linalg.norm(C[:, :3, 3], axis=1)), 1e-9)
        ways.append((float(np.exp(np.mean(np.log(turned + apart / distance + 1e-6)))), one))
    return min(ways, key=lambda way: way[0])


METHODS = (shah, park, daniilidis)
"""Closed forms of the rotations, in the order of their measured robustness."""


def _rotations(
    images: _Images, poses: Array, weight: Array, method: Method
) -> tuple[float, Array, Array] | None:
    """One start, followed for three rounds of weights: its median angle [rad], R_X and R_Y."""
    for _ in range(3):
        pairs = method(images.A, poses, weight)
        if not pairs:
            return None
        R_X, R_Y = pairs[0]
        poses, angle = images.turned(R_X, R_Y)
        weight = _weights(angle)
    return float(np.mean(np.minimum(angle, 3.0 * median(angle)))), R_X, R_Y


def _settled(images: _Images, R_X: Array, R_Y: Array, *, scaled: bool) -> tuple[float, HandEye]:
    """The translations of a pair of rotations, and the mean miss of the images."""
    poses, angle = images.turned(R_X, R_Y)
    weight = _weights(angle)
    depth = np.maximum(np.abs(poses[:, 2, 3]), 1e-9)
    for _ in range(3):
        solution = translations(images.A, poses, weight, R_X, R_Y, scaled=scaled)
        off = solution.predicted(images.A)[:, :3, 3] - poses[:, :3, 3]
        miss = angle + np.linalg.norm(off, axis=1) / depth
        weight = _weights(miss)
    return float(np.mean(np.minimum(miss, 3.0 * median(miss) + 1e-9))), solution


def median(values: Array) -> float:
    """The upper median, without the checks that take NumPy's longer than all else here."""
    return float(np.partition(values, len(values) // 2)[len(values) // 2])


def _weights(miss: Array) -> Array:
    """Geman-McClure weights by twice the median."""
    scale = max(2.0 * median(miss), 1e-6)
    return np.asarray(1.0 / (1.0 + (miss / scale) ** 2) ** 2)
