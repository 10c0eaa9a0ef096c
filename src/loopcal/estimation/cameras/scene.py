"""A scene of cameras, boards and a hand, and its adjustment to the corners by a soft loss.

View v shows board b in image i of camera c. With a robot T_v = X_c A_i Y_b, and A is held. Without
one T_v = X_c F_ib: F is a pose for each image and board, and X of the first camera the identity.
Minimised is sum s^2 rho(|r|^2 / s^2), as a rule rho(z) = 2 (sqrt(1 + z) - 1), of pixel residuals
r, s three times their median, by Levenberg's and Marquardt's method on sums of each view. A twist d
of T_v moves a point P by (I | -[P]) d; those of X, Y and F reach it by adjoints. F is eliminated
image by image (Schur complement).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.estimation.cameras.corners import Corners, Views
from loopcal.estimation.cameras.pixels import by_point, by_value, pixels
from loopcal.estimation.cameras.twists import adjoint, moved
from loopcal.mechanisms.cameras.lens import Intrinsics
from loopcal.mechanisms.rotations import skew

PRIOR_DISTORTION = 1.0
"""Prior sd of a coefficient in a start: lenses have |k1| below 1, and a narrow view shows none."""
PRIOR_TANGENTIAL = 0.02
"""The same of p and s, which together turn the camera: beyond 1 degree it is the camera's place."""
TURN = 0.0175
"""Turns of less than 1 degree, rms: an error of 1 mm would move what they tell by 57 mm."""
HELD = 1e-4
"""Prior sd [m] of a place on the flange that no image tells: it does not move."""
LEFT = 0.1
"""The least share of squares that residuals keep beside the unknowns."""
PRIOR_CENTRE = 0.1
"""Prior sd of a principal point from its start, as a share of the image's width."""


@dataclass(frozen=True)
class Loss:
    """rho(z) of z = |r|^2 / s^2, and its derivative, the weight of a corner."""

    rho: Callable[[Array], Array]
    weight: Callable[[Array], Array]

    def cost(self, r: Array, scale: float) -> float:
        """sum s^2 rho(|r|^2 / s^2) of residuals (N, 2) [px]."""
        return scale**2 * float(np.sum(self.rho((r**2).sum(axis=1) / scale**2)))


SOFT = Loss(lambda z: 2.0 * (np.sqrt(1.0 + z) - 1.0), lambda z: 1.0 / np.sqrt(1.0 + z))
REDESCENDING = Loss(lambda z: z / (1.0 + z), lambda z: 1.0 / (1.0 + z) ** 2)
"""Geman and McClure (1985)."""


@dataclass(frozen=True)
class Scene:
    """Cameras X (C, 4, 4), boards Y (B, 4, 4), hand A (n, 4, 4) or free poses F (V', 4, 4).

    intrinsics: of each camera; board: pitch and aspect, less 1, of all boards; lost: (3, k)
    directions of the flange along which no image tells the place of what it holds, which stays at
    zero there: the boards' if held, the cameras' otherwise.
    """

    intrinsics: tuple[Intrinsics, ...]
    X: Array
    Y: Array
    A: Array | None = None
    F: Array | None = None
    board: tuple[float, float] = (0.0, 0.0)
    lost: Array | None = None
    held: bool = True

    def of_views(self, views: Views) -> Array:
        """T_camera_board (V, 4, 4)."""
        if self.A is not None:
            return np.asarray(self.X[views.camera] @ self.A[views.image] @ self.Y[views.board])
        assert self.F is not None
        return np.asarray(self.X[views.camera] @ self.F[groups(views)])

    def points(self, xyz: Array) -> Array:
        """(N, 3) [m] points of a board with its pitch and aspect."""
        pitch, aspect = self.board
        return np.asarray(xyz * np.array([1.0, 1.0 + aspect, 1.0]) * (1.0 + pitch))

    def in_camera(self, corners: Corners) -> Array:
        """(N, 3) [m] each corner's point in the frame of its camera."""
        T = self.of_views(corners.views)[corners.views.of_corner]
        return np.asarray(
            (T[:, :3, :3] @ self.points(corners.xyz)[:, :, None])[:, :, 0] + T[:, :3, 3]
        )

    def residuals(self, corners: Corners, P: Array | None = None) -> Array:
        """(N, 2) [px] pixel read minus pixel predicted; one image's width behind the camera."""
        P = self.in_camera(corners) if P is None else P
        r = np.empty((len(corners), 2))
        for c, lens in enumerate(self.intrinsics):
            mine = corners.camera == c
            r[mine] = corners.uv[mine] - pixels(lens.lens, ahead(P[mine]), lens.values)
        return np.where(P[:, 2:] > 0.0, np.clip(np.nan_to_num(r, nan=1e4), -1e4, 1e4), 1e4)


@dataclass(frozen=True)
class Adjusted:
    """A scene after its adjustment.

    residuals: (N, 2) [px]; sds: of the values that were free, by (camera or -1 for the board,
    name), by leaving out each image in turn.
    """

    scene: Scene
    residuals: Array
    sds: dict[tuple[int, str], float]

    @property
    def distance(self) -> Array:
        """(N,) [px] lengths of the residuals."""
        return np.asarray(np.linalg.norm(self.residuals, axis=1))

    @property
    def core(self) -> float:
        """Rms [px] of the smaller four fifths of the distances."""
        d = np.sort(self.distance)[: max(1, (4 * len(self.residuals)) // 5)]
        return float(np.sqrt(np.mean(d**2)))

    @property
    def rms(self) -> float:
        """Rms [px] of all distances."""
        return float(np.sqrt(np.mean(self.distance**2)))


def lost_directions(R: Array) -> Array:
    """(3, k) directions y of the flange with R_i y alike in all images, R (n, 3, 3).

    Rms of |(R_i - mean R) y| below `TURN`.
    """
    size, direction = np.linalg.eigh(np.mean(np.swapaxes(R, 1, 2) @ R, axis=0) - _square(R))
    return np.asarray(direction[:, np.sqrt(np.maximum(size, 0.0)) < TURN])


def _square(R: Array) -> Array:
    mean = R.mean(axis=0)
    return np.asarray(mean.T @ mean)


def groups(views: Views) -> NDArray[np.intp]:
    """(V,) which free pose F each view has: one per image and board."""
    key = views.image * (int(views.board.max(initial=0)) + 1) + views.board
    return np.asarray(np.unique(key, return_inverse=True)[1], dtype=np.intp)


def ahead(P: Array) -> Array:
    """Points with a depth that can be divided by."""
    return np.column_stack([P[:, :2], np.maximum(P[:, 2], 1e-6)])


def adjusted(
    corners: Corners,
    scene: Scene,
    lens: Sequence[str] = (),
    board: Sequence[str] = (),
    *,
    iterations: int = 30,
    loss: Loss = SOFT,
) -> Adjusted:
    """The scene with placements, named values of every lens and of the boards adjusted.

    lens: of `Intrinsics.values`; board: "pitch", "aspect"; loss: soft from afar, and redescending
    near the end, where whole images that do not fit must have no say.
    """
    columns = _Columns(corners, scene, tuple(lens), tuple(board))
    P = scene.in_camera(corners)
    r = scene.residuals(corners, P)
    damping, start = 1e-4, scene
    for step in range(iterations):
        if step in (0, 4, 10):
            scale = columns.scale(r)
        cost = loss.cost(r, scale) + columns.prior(scene, start, scale)[0]
        system = columns.system(scene, start, P, r, scale, loss)
        while True:
            trial = columns.applied(scene, system, damping)
            P_trial = trial.in_camera(corners)
            r_trial = trial.residuals(corners, P_trial)
            gain = cost - loss.cost(r_trial, scale) - columns.prior(trial, start, scale)[0]
            if gain >= 0.0 or damping > 1e8:
                break
            damping *= 8.0
        if gain >= 0.0:
            scene, P, r, damping = trial, P_trial, r_trial, max(damping / 5.0, 1e-9)
        # Relative gains below 1e-7 change no parameter by a hundredth of its sd.
        if step > 10 and gain < 1e-7 * cost:
            break
        if gain < 1e-7 * cost and step < 10 and abs(columns.scale(r) - scale) < 1e-3 * scale:
            break
    sds = columns.sds(columns.system(scene, start, P, r, scale, loss)) if columns.names else {}
    return Adjusted(scene, r, sds)


@dataclass(frozen=True)
class _System:
    """Normal equations N d = g, the free poses' blocks beside them, and each view's parts."""

    N: Array
    g: Array
    Q: Array
    B: Array
    h: Array
    gradients: Array
    curvature: Array


class _Columns:
    """Where each unknown stands among the columns of the normal equations."""

    def __init__(
        self, corners: Corners, scene: Scene, lens: tuple[str, ...], board: tuple[str, ...]
    ) -> None:
        self.corners, self.views, self.lens, self.board = corners, corners.views, lens, board
        self.robot = scene.A is not None
        cameras, k = len(scene.intrinsics), len(lens)
        firsts = 0 if self.robot else 1
        self.X = [6 * (c - firsts) if c >= firsts else None for c in range(cameras)]
        at = 6 * (cameras - firsts)
        self.K = [at + k * c for c in range(cameras)]
        at += k * cameras
        self.Y = [at + 6 * b for b in range(len(scene.Y))] if self.robot else []
        at += 6 * len(self.Y)
        self.S = at
        self.size = at + len(board)
        self.group = groups(self.views)
        self.held, self.lost = scene.held, scene.lost
        self.names = [
            *((c, name, self.K[c] + j) for c in range(cameras) for j, name in enumerate(lens)),
            *((-1, name, self.S + j) for j, name in enumerate(board)),
        ]

    def scale(self, r: Array) -> float:
        """Three median errors [px]: residuals are smaller by what the unknowns take up.

        Four corners with a free pose leave a quarter of their squares, and the largest of them
        would count as wrong.
        """
        unknown = self.size + (0 if self.robot else 6 * (int(self.group.max()) + 1))
        left = max(1.0 - unknown / r.size, LEFT)
        return max(3.0 * float(np.median(np.linalg.norm(r, axis=1)) / np.sqrt(left)), 1e-6)

    def prior(self, scene: Scene, start: Scene, scale: float) -> tuple[float, Array, Array]:
        """Cost, curvature and descent of the priors of a start, in px^2."""
        N, g, cost = np.zeros((self.size, self.size)), np.zeros(self.size), 0.0
        for at, t, M in self._on_flange(scene):
            weight = (scale / HELD) ** 2 * len(self.views)
            N[at : at + 3, at : at + 3] += weight * M.T @ M
            g[at : at + 3] -= weight * M.T @ t
            cost += weight * float(t @ t)
        for c, name, column in self.names:
            if c < 0 or name in ("f", "aspect"):
                continue
            now, then = scene.intrinsics[c].values, start.intrinsics[c].values
            width = 2.0 * max(start.intrinsics[c].cx, start.intrinsics[c].cy)
            centre = name in ("cx", "cy")
            bend = PRIOR_TANGENTIAL if name[0] in "ps" else PRIOR_DISTORTION
            sd = PRIOR_CENTRE * width if centre else bend
            off = now[name] - (then[name] if centre else 0.0)
            N[column, column] = (scale / sd) ** 2
            g[column] = -N[column, column] * off
            cost += N[column, column] * off**2
        return cost, N, g

    def _on_flange(self, scene: Scene) -> list[tuple[int, Array, Array]]:
        """Of each thing on the flange: its column, its place along what is lost, the derivative."""
        if self.lost is None or not self.lost.size:
            return []
        L = self.lost.T
        if self.held:
            # Y exp(d) moves the board by R_Y d.
            return [
                (at, L @ Y[:3, 3], L @ Y[:3, :3]) for at, Y in zip(self.Y, scene.Y, strict=True)
            ]
        # exp(d) X moves the camera in the flange, -R_X^T t_X, by -R_X^T d.
        return [
            (at, -L @ X[:3, :3].T @ X[:3, 3], -L @ X[:3, :3].T)
            for at, X in zip(self.X, scene.X, strict=True)
            if at is not None
        ]

    def system(
        self, scene: Scene, start: Scene, P: Array, r: Array, scale: float, loss: Loss
    ) -> _System:
        """The normal equations about a scene."""
        views, k, b = self.views, len(self.lens), len(self.board)
        T = scene.of_views(views)
        J = np.zeros((len(P), 2, 6 + k + b + 1))
        weight = loss.weight((r**2).sum(axis=1) / scale**2)
        weight[P[:, 2] <= 0.0] = 0.0
        safe = ahead(P)
        for c, lens in enumerate(scene.intrinsics):
            mine = self.corners.camera == c
            values = lens.values
            D = by_point(lens.lens, safe[mine], values)
            J[mine, :, :3] = D
            J[mine, :, 3:6] = -D @ skew(safe[mine])
            J[mine, :, 6 : 6 + k] = by_value(lens.lens, safe[mine], values, self.lens)
            J[mine, :, 6 + k : -1] = D @ self._board(scene, T)[mine]
        J[:, :, -1] = r
        product = views.products(np.sqrt(weight)[:, None, None] * J)
        H, g = product[:, :-1, :-1], product[:, :-1, -1]
        return self._gathered(scene, T, H, g, self.prior(scene, start, scale))

    def _board(self, scene: Scene, T: Array) -> Array:
        """(N, 3, b) how a point moves in its camera by pitch and aspect."""
        xyz = self.corners.xyz
        pitch, aspect = scene.board
        by = {
            "pitch": xyz * np.array([1.0, 1.0 + aspect, 1.0]),
            "aspect": xyz * np.array([0.0, 1.0 + pitch, 0.0]),
        }
        R = T[self.views.of_corner, :3, :3]
        columns = [(R @ by[name][:, :, None]) for name in self.board]
        return np.concatenate(columns, axis=2) if columns else np.zeros((len(xyz), 3, 0))

    def _gathered(
        self, scene: Scene, T: Array, H: Array, g: Array, prior: tuple[float, Array, Array]
    ) -> _System:
        views, n, m = self.views, self.size, H.shape[1]
        D = np.zeros((len(views), m, n))
        k, b = len(self.lens), len(self.board)
        Ad = adjoint(T) if self.robot else adjoint(scene.X[views.camera])
        for c in range(len(scene.intrinsics)):
            mine = views.camera == c
            if (first := self.X[c]) is not None:
                D[mine, :6, first : first + 6] = np.eye(6)
            D[mine, 6 : 6 + k, self.K[c] : self.K[c] + k] = np.eye(k)
        for o, column in enumerate(self.Y):
            mine = views.board == o
            D[mine, :6, column : column + 6] = Ad[mine]
        D[:, 6 + k :, self.S :] = np.eye(b)
        HD = H @ D
        Dt = np.swapaxes(D, 1, 2)
        gradients = (Dt @ g[:, :, None])[:, :, 0]
        curvature = Dt @ HD
        N = curvature.sum(axis=0) + prior[1]
        total = gradients.sum(axis=0) + prior[2]
        if self.robot:
            none = np.zeros((0, 6, 6))
            return _System(
                N, total, none, np.zeros((0, 6, n)), np.zeros((0, 6)), gradients, curvature
            )
        E = np.swapaxes(Ad, 1, 2)
        count = int(self.group.max()) + 1
        Q, B, h = np.zeros((count, 6, 6)), np.zeros((count, 6, n)), np.zeros((count, 6))
        np.add.at(Q, self.group, E @ H[:, :6, :6] @ Ad)
        np.add.at(B, self.group, E @ HD[:, :6])
        np.add.at(h, self.group, (E @ g[:, :6, None])[:, :, 0])
        return _System(N, total, Q, B, h, gradients, curvature)

    def applied(self, scene: Scene, system: _System, damping: float) -> Scene:
        """The scene after one damped step."""
        N = system.N + damping * np.diag(np.diag(system.N)) + 1e-12 * np.eye(self.size)
        g = system.g
        F = scene.F
        if len(system.Q):
            diagonal = np.einsum("fii->fi", system.Q)
            Q = system.Q + np.einsum("fi,ij->fij", (damping + 1e-12) * diagonal + 1e-9, np.eye(6))
            QB = np.linalg.solve(Q, np.concatenate([system.B, system.h[:, :, None]], axis=2))
            N = N - np.tensordot(system.B, QB[:, :, :-1], axes=([0, 1], [0, 1]))
            g = g - np.einsum("fin,fi->n", system.B, QB[:, :, -1])
        d = np.asarray(np.linalg.lstsq(N, g, rcond=1e-15)[0]) if self.size else np.zeros(0)
        if len(system.Q):
            assert F is not None
            F = moved(F, QB[:, :, -1] - QB[:, :, :-1] @ d)
        X, Y = scene.X.copy(), scene.Y.copy()
        for c, column in enumerate(self.X):
            if column is not None:
                X[c] = moved(X[c], d[column : column + 6])
        for o, column in enumerate(self.Y):
            # Y exp(d): a turn and a shift in the board's frame.
            Y[o] = Y[o] @ moved(np.eye(4), d[column : column + 6])
        lenses, board = [], dict(zip(("pitch", "aspect"), scene.board, strict=True))
        for c, lens in enumerate(scene.intrinsics):
            step = {name: d[at] for camera, name, at in self.names if camera == c}
            values = {name: value + step.get(name, 0.0) for name, value in lens.values.items()}
            values["f"] = max(values["f"], 0.2 * lens.fx)
            lenses.append(Intrinsics.of(lens.lens, values, lens.image))
        for camera, name, at in self.names:
            if camera < 0:
                board[name] += float(d[at])
        both = (board["pitch"], board["aspect"])
        return replace(scene, X=X, Y=Y, F=F, intrinsics=tuple(lenses), board=both)

    def sds(self, system: _System) -> dict[tuple[int, str], float]:
        """Of the named values, by one Newton step without each image in turn (jackknife).

        d_i = (N - N_i)^-1 g_i, with N_i and g_i of image i; var = (n - 1) / n sum d_i^2.
        """
        curvature, N = system.curvature, system.N
        if len(system.Q):
            QB = np.linalg.solve(system.Q + 1e-9 * np.eye(6), system.B)
            free = np.swapaxes(system.B, 1, 2) @ QB
            N = N - free.sum(axis=0)
        image = self.views.image
        count = int(image.max()) + 1
        g, N_i = np.zeros((count, self.size)), np.zeros((count, self.size, self.size))
        np.add.at(g, image, system.gradients)
        np.add.at(N_i, image, curvature)
        if len(system.Q):
            group_image = np.zeros(len(free), dtype=np.intp)
            group_image[self.group] = image
            np.subtract.at(N_i, group_image, free)
        lengths = np.diag(N)
        scale = np.sqrt(np.where(lengths > 1e-150, lengths, 1.0))  # 1 for what no corner shows
        rest = (N - N_i) / np.outer(scale, scale) + 1e-9 * np.eye(self.size)
        d = np.linalg.solve(rest, (g / scale)[:, :, None])[:, :, 0] / scale
        n = max(len(np.unique(image)), 1)
        sd = np.sqrt((n - 1.0) / n * np.sum(d**2, axis=0))
        return {(c, name): float(sd[at]) for c, name, at in self.names}
