"""What the cameras of a result saw: corners, residuals, boards in space; figures and a table."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.estimation.cameras.board_pose import board_poses
from loopcal.estimation.cameras.corners import Corners
from loopcal.estimation.cameras.pixels import pixels, rays
from loopcal.figures.figure import Figure
from loopcal.figures.images import (
    ImagePlane,
    Outline,
    SdMap,
    Sight,
    image_residuals,
    over_radius,
    projection_sds,
    scene,
)
from loopcal.figures.space import Machine
from loopcal.mechanisms.cameras.board import Board
from loopcal.mechanisms.cameras.lens import Intrinsics, turning_radius
from loopcal.mechanisms.chain import product
from loopcal.mechanisms.instruments.camera import CameraEntry, cameras_of
from loopcal.mechanisms.placement import inverse
from loopcal.mechanisms.skeleton import body_poses
from loopcal.mechanisms.station import Station
from loopcal.presentation.shown import NONE, Table, significant, size
from loopcal.report.source import Source

DISTANCES = (0.5, 1.0, 2.0)
"""At which the uncertainty of a projection is drawn [m]."""
GRID = 41
"""Columns of its map; finer ones look alike."""
OF_IMAGES = ("scene", "image-", "radius-", "projection-")
"""How the keys of figures of cameras begin."""
FEW = 0.5
"""An image with less than this share of its camera's usual number of corners has few."""


@dataclass(frozen=True, eq=False)
class CameraView:
    """What one camera saw of one board, n corners in N images.

    image: (n,) index of its pose; points: their ids; uv, residuals: (2, n) [px], computed minus
    measured; T: (N, 4, 4) T_camera_board, NaN where it is not known; on_body: it moves with the
    machine, and the board does not.
    """

    name: str
    intrinsics: Intrinsics
    size: tuple[float, float]
    on_body: bool
    board: Board
    image: NDArray[np.intp]
    points: tuple[str, ...]
    uv: Array
    residuals: Array
    T: Array
    T_base_body: Array

    @property
    def plane(self) -> ImagePlane:
        """Its image."""
        lens, values = self.intrinsics.lens, self.intrinsics.values
        centre = np.array([values["cx"], values["cy"]])
        r, turns = turning_radius(lens, values), np.inf
        if r < (np.pi / 2.0 if lens == "fisheye" else np.inf):
            along = np.tan(r) if lens == "fisheye" else r
            turns = float(pixels(lens, np.array([[along, 0.0, 1.0]]), values)[0, 0]) - centre[0]
        return ImagePlane(self.name, self.size, centre, turns)

    @property
    def distance(self) -> Array:
        """(n,) [m] of each corner's point along the line of sight."""
        X = np.column_stack([self.board.xyz, np.ones(len(self.board.points))])
        row = {point: i for i, point in enumerate(self.board.points)}
        at = X[[row[point] for point in self.points]]
        return np.asarray(np.einsum("nj,nj->n", self.T[self.image, 2], at))


def camera_views(source: Source) -> tuple[CameraView, ...]:
    """By instrument; none where the mechanism is not known or has no camera."""
    mechanism = source.mechanism
    cameras = () if mechanism is None else cameras_of(mechanism)
    if mechanism is None or not cameras:
        return ()
    T_base_body = body_poses(mechanism, _readings(source))
    if T_base_body is None:
        T_base_body = np.full((len(source.table.poses), 4, 4), np.nan)
    made = [_view(source, one, T_base_body) for one in cameras]
    return tuple(one for one in made if one.image.size)


def _readings(source: Source) -> dict[str, Array]:
    """What places the machine; what is the same in all poses by construction may have no column."""
    assert source.mechanism is not None
    count = len(source.table.poses)
    implied = {q: np.full(count, v) for q, v in source.mechanism.implied.items()}
    read = {q: v for q, v in source.table.readings.items() if np.isfinite(v).any()}
    return {**implied, **read, **source.table.pose_constants}


def _view(source: Source, entry: CameraEntry, T_base_body: Array) -> CameraView:
    board, intrinsics = entry.board, entry.intrinsics
    labels = [f"{entry.name}:{board.name}:{point}" for point in board.points]
    table = source.table
    nothing = np.full(len(table.poses), np.nan)

    def rows(columns: Mapping[str, Array]) -> Array:
        return np.array([[columns.get(f"{k}:{a}", nothing) for k in labels] for a in "uv"])

    measured, off = rows(table.readings), rows(table.differences_after)
    point, image = np.nonzero(np.isfinite(measured + off).all(axis=0))
    uv, residuals = measured[:, point, image], off[:, point, image]
    width, height = map(float, intrinsics.image or (0, 0))
    if intrinsics.image is None:
        # The size is not stated: take twice the principal point, and let it hold all corners.
        middle = 2.0 * np.array([intrinsics.cx, intrinsics.cy]) + 1.0
        width, height = np.maximum(middle, uv.max(axis=1, initial=0.0)).tolist()
    ids = list(board.points)
    T = (
        inverse(entry.T_eye) @ inverse(T_base_body) @ inverse(entry.T_board)
        if entry.on_body
        else entry.T_eye @ T_base_body @ entry.T_board
    )
    view = CameraView(
        entry.name,
        intrinsics,
        (width, height),
        entry.on_body,
        board,
        image.astype(np.intp),
        tuple(ids[i] for i in point),
        uv,
        residuals,
        T,
        T_base_body,
    )
    return replace(view, T=_placed(view, point)) if np.isnan(T).any() else view


def _placed(view: CameraView, point: NDArray[np.intp]) -> Array:
    """T (N, 4, 4); where the pose is not read, the one that the corners of the image show."""
    T, zero = view.T.copy(), np.zeros(len(view.image), dtype=np.intp)
    names = tuple(map(str, range(len(T))))
    corners = Corners.of(
        (view.image, zero, zero, point), view.uv.T, (view.name,), (view.board,), names
    )
    alone = board_poses(corners, rays(view.intrinsics, corners.uv))
    for image, usable, both in zip(
        corners.views.image, alone.usable, alone.T_camera_board, strict=True
    ):
        if usable and np.isnan(T[image]).any():
            T[image] = both[0]
    return T


def image_figures(
    source: Source, machine: Callable[[Source, Array], Machine | None]
) -> list[Figure | None]:
    """The scene, and the figures of each camera.

    machine: draws it in the pose whose body is nearest to the middle of points (3, N).
    """
    views = camera_views(source)
    drawn: list[Figure | None] = []
    if views:
        at = views[0].T_base_body[:, :3, 3].T
        drawn.append(_scene(source, views, machine(source, at) if np.isfinite(at).any() else None))
    for name in dict.fromkeys(view.name for view in views):
        some = [view for view in views if view.name == name]
        plane = some[0].plane
        uv = np.hstack([view.uv for view in some])
        residuals = np.hstack([view.residuals for view in some])
        labels = [
            f"image {source.table.poses[i]}, point {p}"
            for view in some
            for i, p in zip(view.image, view.points, strict=True)
        ]
        drawn.append(image_residuals(plane, uv, residuals, labels))
        drawn.append(over_radius(plane, uv, residuals))
        drawn.append(_projection(source, some[0], uv))
    return drawn


def _projection(source: Source, view: CameraView, uv: Array) -> Figure | None:
    width, height = view.size
    u = np.linspace(0.0, width, GRID)
    v = np.linspace(0.0, height, max(round(GRID * height / width), 2))
    grid = np.array([(a, b) for b in v for a in u])
    ray = np.column_stack([rays(view.intrinsics, grid), np.ones(len(grid))])
    again = pixels(view.intrinsics.lens, ray, view.intrinsics.values)
    # Beyond where the lens turns back no ray has this pixel.
    ray[np.linalg.norm(again - grid, axis=1) > 0.1] = np.nan
    maps = []
    for distance in DISTANCES:
        sds = projection_sd(source, view, distance * ray)
        maps.append(SdMap(distance, sds.reshape(len(v), len(u)), distance / view.intrinsics.fx))
    boards = float(np.nanmedian(view.distance)) if np.isfinite(view.distance).any() else 1.0
    shown = int(np.argmin(np.abs(np.log(np.array(DISTANCES) / boards))))
    holder = "hand" if view.on_body else "base"
    return projection_sds(view.plane, u, v, maps, shown, uv, holder)


def projection_sd(source: Source, view: CameraView, P: Array) -> Array:
    """(n,) [px] largest sd in any direction of the pixels of points P (n, 3) [m].

    P: in the camera's frame, fixed to what carries the camera, base or hand. With p the six
    parameters of its place and those of its lens, C = J S J^T of pi(T(p) P), by differences. The
    place counts because a turn of the camera undoes a shift of the principal point (mrcal).
    """
    assert source.mechanism is not None
    covariance = source.document.covariance
    six = Station(view.name).parameters
    wanted = {*six, *(f"{view.name}_{key}" for key in view.intrinsics.values)}
    kept = [i for i, name in enumerate(covariance.names) if name in wanted]
    every = np.array(covariance.matrix, dtype=float).reshape((len(covariance.names),) * 2)
    S = every[np.ix_(kept, kept)]
    values = source.mechanism.parameters.nominal
    lens = view.intrinsics.lens

    def place(values: Mapping[str, float]) -> Array:
        T = product(Station(view.name).steps, {}, values)
        return inverse(T) if view.on_body else T

    T = inverse(place(values))
    held = P @ T[:3, :3].T + T[:3, 3]
    J = np.zeros((len(P), 2, len(kept)))
    for j, i in enumerate(kept):
        name = covariance.names[i]
        step = 1e-3 * np.sqrt(S[j, j]) if S[j, j] > 0.0 else 0.0
        ends = []
        for moved in (step, -step):
            now = {**values, name: values[name] + moved}
            T = place(now)
            intrinsic = {key: now[f"{view.name}_{key}"] for key in view.intrinsics.values}
            ends.append(pixels(lens, held @ T[:3, :3].T + T[:3, 3], intrinsic))
        if step:
            J[:, :, j] = (ends[0] - ends[1]) / (2.0 * step)
    C = J @ S @ np.swapaxes(J, 1, 2)
    half, off = 0.5 * (C[:, 0, 0] - C[:, 1, 1]), C[:, 0, 1]
    most = 0.5 * (C[:, 0, 0] + C[:, 1, 1]) + np.hypot(half, off)
    return np.asarray(np.sqrt(np.maximum(most, 0.0)))


def _scene(source: Source, views: tuple[CameraView, ...], machine: Machine | None) -> Figure | None:
    assert source.mechanism is not None
    return scene(*sights_and_outlines(source, views), machine)


def sights_and_outlines(
    source: Source, views: tuple[CameraView, ...]
) -> tuple[list[Sight], list[Outline]]:
    """Cameras and boards in the frame of the machine's base; without a robot in the first camera's.

    What stands still is there once.
    """
    assert source.mechanism is not None
    values = source.mechanism.parameters.nominal
    sights, outlines = [], []
    lasting: dict[str, Array] = {}
    for view in views:
        T_eye = product(Station(view.name).steps, {}, values)
        (left, top), (right, below) = (0.0, 0.0), view.size
        frame = np.array([(left, top), (right, top), (right, below), (left, below)])
        ray = np.column_stack([rays(view.intrinsics, frame), np.ones(4)])
        rms = _by_image(view)
        for image in np.unique(view.image):
            T_base_camera = view.T_base_body[image] @ T_eye if view.on_body else inverse(T_eye)
            if view.on_body or view.name not in lasting:
                lasting[view.name] = T_base_camera
                if np.isfinite(T_base_camera).all():
                    sights.append(Sight(view.name, T_base_camera, ray))
            T = T_base_camera @ view.T[image]
            label = f"image {source.table.poses[image]}: {rms[image]:.3g} px"
            outlines.append(Outline(_edge(view.board) @ T[:3, :3].T + T[:3, 3], label, rms[image]))
    return sights, outlines


def _edge(board: Board) -> Array:
    """(k, 3) [m] the box about a plane's points as a closed line, or the points of a body."""
    low, high = board.xyz.min(axis=0), board.xyz.max(axis=0)
    if not board.planar:
        return board.xyz
    (a, b, z), (c, d, _) = low, high
    return np.array([(a, b, z), (c, b, z), (c, d, z), (a, d, z), (a, b, z)])


def _by_image(view: CameraView, unit: Array | float = 1.0) -> Array:
    """(N,) rms of each image [px], or where a pixel is so large [unit]; NaN without corners."""
    count = np.bincount(view.image, minlength=len(view.T)).astype(float)
    squares = np.square(view.residuals).sum(axis=0) * unit**2
    total = np.bincount(view.image, squares, minlength=len(view.T))
    return np.where(count > 0.0, np.sqrt(total / np.maximum(count, 1.0)), np.nan)


def image_table(source: Source) -> Table | None:
    """A line for each image, the largest residuals first, with what is wrong with it."""
    views = camera_views(source)
    if not views:
        return None
    named = {one.pose: one for one in source.document.outliers or ()}
    entries = []
    for view in views:
        # NaN where the board's distance is not known.
        rms, at_board = _by_image(view), _by_image(view, view.distance / view.intrinsics.fx)
        usual = np.median(np.unique(view.image, return_counts=True)[1])
        for image in np.unique(view.image):
            pose = source.table.poses[image]
            largest = float(np.hypot(*view.residuals[:, view.image == image]).max())
            count = int((view.image == image).sum())
            outlier = named.get(pose)
            fault = NONE
            if outlier is not None:
                fault = outlier.cause or "does not fit the others"
            elif count < FEW * usual:
                fault = "few corners"
            cells = (
                pose,
                view.name,
                str(count),
                significant(rms[image], 3),
                significant(largest, 3),
            )
            entries.append((rms[image], (*cells, size(at_board[image], "m", 3), fault)))
    entries.sort(key=lambda one: -one[0])
    several = len({view.name for view in views}) > 1
    rows = [row if several else (row[0], *row[2:]) for _, row in entries]
    head = ("image", "camera", "corners", "rms [px]", "largest [px]", "rms at the board [mm]")
    head = (*(head if several else (head[0], *head[2:])), "fault")
    return Table("Images, the largest residuals first", head, tuple(rows[:MOST_IMAGES]))


MOST_IMAGES = 40
"""Lines of the table; the residuals of all images are in residuals.csv."""
