"""A project from corners that cameras saw: boards, poses and lenses found by themselves."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError, listed
from loopcal.estimation.cameras.corners import Corners
from loopcal.estimation.cameras.start import (
    CameraStart,
    start,
    way_of_turning,
    with_stated_lenses,
)
from loopcal.files.cameras.corner_table import CornerTable
from loopcal.files.cameras.folder import Files, read_files
from loopcal.files.cameras.places import read_places
from loopcal.files.machines.mechanism_file import mechanism_from_data
from loopcal.files.recognition.expressions import joint_columns
from loopcal.files.recognition.fields import Field, in_si, taken_in
from loopcal.files.recognition.joint_sets import joint_sets
from loopcal.files.recognition.robots import Robot
from loopcal.files.recognition.sources import sources_of
from loopcal.files.tables.writer import table_bytes
from loopcal.files.toml.reader import SCHEMA
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.cameras.board import Board
from loopcal.mechanisms.cameras.lens import Intrinsics
from loopcal.mechanisms.instruments.camera import PIXEL
from loopcal.mechanisms.placement import yaw_pitch_roll
from loopcal.units import from_si
from loopcal.workflow.beginning.begun import PROJECT, READINGS, Begun, drawn, joint_noise
from loopcal.workflow.beginning.matching import matched

Array = NDArray[np.float64]
CORNERS, WRONG = "corners.csv", "wrong-corners.csv"
"""Those of the project, and those that do not fit, which it leaves out."""
USUAL_LENS = "brown5"
CORNER, PLACE, TURN = 0.02, 1e-4, 1e-4
"""Where the learning of sds begins: a corner, at least [px], a joint [rad], a stated pose [m],
[rad]."""
_NORMAL = 1.4826
"""The sd of normal values over the median of their sizes."""
POINT_SD = 0.5e-3
"""How far markers on a body are from where they are stated [m], as its sd."""
USUAL = {"k2": 0.5, "p1": 5e-3, "p2": 5e-3, "k3": 1.0} | dict.fromkeys(
    ("k4", "k5", "k6", "s1", "s2", "s3", "s4"), 1.0
)
"""Prior sds of coefficients of distortion that few images determine. Chosen: lenses on sale have
smaller ones."""
CENTRAL = 0.45
"""A principal point is no nearer to the edge than this share of how far corners reach. Chosen:
half would be the middle of an image that corners fill."""
_LENGTH, _TWIST, _ZERO = 0.5, 1.0, 5.0
"""How far a robot is from its drawing, as sds [mm, mrad, mrad]: pixels at a distance tell less than
a tracker. Chosen: docs/explanation/model-error.md has what arms of many makers are off by."""
_STATED, _CENTRED = 0.02, 0.05
"""Sds in focal lengths: of stated intrinsics, and of a principal point that is not stated from the
middle of the image. Chosen: lenses are refocused, images cut."""
_MOUNTED, _TURNED = 20.0, 3.0
"""As sds [mm, deg]: where a board or camera sits on a hand that is never turned, which no image
shows, beside where the start puts it."""
_FEWEST = 3
"""Points that an image needs to show where a board of unknown pose is."""


Describe = Callable[[Sequence[Field]], Robot]
"""The robot by the columns of its joints."""


@dataclass(frozen=True, eq=False)
class FromImages:
    """What was begun from images, and its parts, of which corners may be left out."""

    begun: Begun
    project: _Project

    def without(self, readings: Mapping[str, NDArray[np.bool_]], words: str) -> Begun:
        """The same without some readings, by name and pose; words: why, which joins the remarks."""
        project = self.project
        wrong = project.marked(readings)
        begun = project.begun
        corners = begun.corners
        kept = replace(begun, corners=corners.where(~wrong), residuals=begun.residuals[~wrong])
        left = project.begun_at(kept)
        out = replace(begun, corners=corners.where(wrong), residuals=begun.residuals[wrong])
        aside = project.begun_at(out)
        made = _made(left, (*self.begun.remarks, words))
        return replace(made, beside={**made.beside, WRONG: aside.corners()})


@dataclass(frozen=True, eq=False)
class Hand:
    """The body that moves: its columns of readings by quantity [SI], and T_base_flange (N, 4, 4)
    by pose; ways: these by what their turns may mean, in words; table: of the mechanism without
    instruments; noise: of its readings."""

    poses: tuple[str, ...]
    table: Mapping[str, Any]
    readings: Mapping[str, Array]
    T_base_flange: Array | None
    noise: Mapping[str, Any]
    remarks: tuple[str, ...] = ()
    parameters: Mapping[str, Any] = field(default_factory=dict)
    ways: Mapping[str, Array] = field(default_factory=dict)

    def turned(self, way: str) -> Hand:
        """With its turns understood in this way."""
        T = self.ways[way]
        remarks = (*self.remarks, f"turns of the flange: {way}")
        return replace(self, T_base_flange=T, readings=_flange(T), remarks=remarks)


def from_images(
    entries: Sequence[Any], describe: Describe | None, joints: str | None, folder: Path
) -> FromImages:
    """`init` of a folder or files that hold corners.

    describe: the robot by the columns of its joints, None where nothing describes one; joints:
    these columns, as in `init`; folder: where the project will lie. Raises InputError where
    something remains open.
    """
    files = read_files(entries)
    project, turned = understood(files, hand_of(files, describe, joints, folder))
    remarks = (
        *files.remarks,
        *project.hand.remarks,
        *project.left_out,
        *turned,
        # The poses of joints are those of a drawing, which scatter does not show to be wrong.
        *(f.sentence for f in project.begun.facts if describe is None or f.code != "board-pitch"),
    )
    return FromImages(_made(project, remarks), project)


def _made(project: _Project, remarks: tuple[str, ...]) -> Begun:
    begun = project.begun
    words = (
        f"{len(project.kept)} images with {len(begun.corners)} corners; the calibration begins at "
        f"{begun.rms:.2f} px rms"
    )
    beside = {READINGS: project.readings(), CORNERS: project.corners()}
    return Begun(project.tables, beside, remarks, project.dataset, words)


def understood(
    files: Files, hand: Hand, held: bool | None = None
) -> tuple[_Project, tuple[str, ...]]:
    """A project of the files, and what was changed of the stated lenses; held: the board is on the
    flange, None where the images are to show it."""
    boards = [named(files.boards, name) for name in files.corners.boards]
    table, renamed = matched(files.corners, boards, hand.poses)
    corners = _corners(table, boards, hand.poses)
    stated, sizes = by_camera(files.lenses, table.cameras), dict(table.sizes)
    lenses, turned = _upright(stated, table)
    if hand.ways:
        hand = hand.turned(way_of_turning(hand.ways, corners, lenses, sizes))
    begun = start(corners, hand.T_base_flange, lenses, sizes, held)
    if turned and any(fact.code == "u-reversed" for fact in begun.facts):
        # An image on its side that is a mirror besides is one whose u and v are exchanged.
        lenses, turned = stated, ()
        begun = start(corners, hand.T_base_flange, lenses, sizes, held)
    if set(lenses) >= set(table.cameras):
        # What was stated is nominal: what the images add to it is for the calibration to say.
        begun = with_stated_lenses(begun)
    if hand.T_base_flange is None:
        hand = _unread(begun, hand)
    elif begun.T_base_flange is not None and "x" in hand.readings:
        hand = replace(hand, readings=_flange(begun.T_base_flange))
    return _Project(begun, hand, table, lenses), (*renamed, *turned)


def named(boards: Mapping[str, Board], name: str) -> Board:
    if name in boards:
        return boards[name]
    if len(boards) == 1:
        return replace(next(iter(boards.values())), name=name)
    raise InputError(
        f"the corners are of the board {name!r}, which no file describes",
        code="unknown-name",
        remedy=f"name it as one of {listed(list(boards), 10)}",
    )


def by_camera(lenses: Mapping[str, Intrinsics], cameras: Sequence[str]) -> dict[str, Intrinsics]:
    """The stated lenses under the names of the corners' cameras; a pinhole may be bent."""
    lenses = {
        name: replace(lens, lens=USUAL_LENS, distortion=()) if lens.lens == "pinhole" else lens
        for name, lens in lenses.items()
    }
    if set(cameras) <= set(lenses):
        return {name: lenses[name] for name in cameras}
    if len(lenses) == len(cameras):  # in their order, where names differ
        return dict(zip(cameras, lenses.values(), strict=True))
    return {name: lenses[name] for name in cameras if name in lenses}


def _upright(
    lenses: Mapping[str, Intrinsics], table: CornerTable
) -> tuple[dict[str, Intrinsics], tuple[str, ...]]:
    """The lenses, those turned back whose principal point is that of an image on its side."""
    upright, remarks = dict(lenses), []
    for name, lens in lenses.items():
        seen = [i for i, camera in enumerate(table.camera) if camera == name]
        most_u, most_v = float(table.u[seen].max()), float(table.v[seen].max())

        def inside(cx: float, cy: float, u: float = most_u, v: float = most_v) -> bool:
            return cx >= CENTRAL * u and cy >= CENTRAL * v

        if inside(lens.cx, lens.cy) or not inside(lens.cy, lens.cx):
            continue
        values = lens.values | dict.fromkeys(("p1", "p2"), 0.0)
        values |= {"f": lens.fy, "aspect": lens.fx / lens.fy - 1.0, "cx": lens.cy, "cy": lens.cx}
        values = {key: values[key] for key in lens.values}
        upright[name] = Intrinsics.of(lens.lens, values, lens.image and lens.image[::-1])
        remarks.append(
            f"the stated principal point ({lens.cx:.0f}, {lens.cy:.0f}) px of camera {name!r} is "
            f"that of an image on its side, since corners reach ({most_u:.0f}, {most_v:.0f}) px: "
            f"({lens.cy:.0f}, {lens.cx:.0f}) px is used"
        )
    return upright, tuple(remarks)


def _corners(table: CornerTable, boards: Sequence[Board], poses: tuple[str, ...]) -> Corners:
    """The corners of poses that are there, by indices. Raises InputError for unknown points."""
    poses = poses or tuple(dict.fromkeys(table.image))
    where = {pose: i for i, pose in enumerate(poses)}
    rows = [i for i, image in enumerate(table.image) if image in where]
    if not rows:
        raise InputError(
            "no image has the name of a pose",
            code="mismatched-poses",
            remedy=f"name images as poses: {listed(list(poses), 3)}; the images are "
            f"{listed(list(table.images), 3)}",
        )
    some = table.at(rows)
    camera = {name: i for i, name in enumerate(table.cameras)}
    board = {name: i for i, name in enumerate(table.boards)}
    points = [{p: i for i, p in enumerate(b.points)} for b in boards]
    index: list[list[int]] = [[], [], [], []]
    for image, cam, name, point in zip(
        some.image, some.camera, some.board, some.point, strict=True
    ):
        b = board[name]
        if point not in points[b]:
            raise InputError(
                f"the board {name!r} has no point {point!r}",
                code="unknown-name",
                place=table.file,
                remedy=f"its points are {listed(list(points[b]), 12)}",
            )
        for ids, i in zip(index, (where[image], camera[cam], b, points[b][point]), strict=True):
            ids.append(i)
    uv = np.stack([some.u, some.v], axis=1)
    return Corners.of([np.array(ids) for ids in index], uv, table.cameras, boards, poses)


def hand_of(files: Files, describe: Describe | None, joints: str | None, folder: Path) -> Hand:
    """The robot's part of the files."""
    if describe is not None:
        return _joints(files, describe, joints, folder)
    for path in files.poses:
        try:
            samples = read_places(path)
        except InputError:
            continue
        noise = {
            "[xyz]": {"sd": 1e3 * PLACE, "unit": "mm", "estimate": "group"},
            "w[xyz]": {"sd": 1e3 * TURN, "unit": "mrad", "estimate": "group"},
        }
        words = f"{path.name} states the pose of the flange"
        return Hand(
            samples.name,
            {"type": "free-body"},
            _flange(samples.T),
            samples.T,
            noise,
            (words,),
            ways=samples.ways,
        )
    remarks: tuple[str, ...] = ()
    if files.poses:
        names = listed([path.name for path in files.poses], 3)
        remarks = (
            f"{names} states no pose of a flange, and no robot is described (--urdf or --dh), so "
            "the cameras alone are calibrated",
        )
    return Hand((), {"type": "free-body", "read": False}, {}, None, {}, remarks)


def _joints(files: Files, describe: Describe, joints: str | None, folder: Path) -> Hand:
    """The robot's joints by columns of the table of poses."""
    if not files.poses:
        raise InputError(
            "no file holds the joints of the robot",
            code="no-data",
            remedy="add a table with a row for each image: pose and its joints",
        )
    source = sources_of(files.poses[0], 0)[0]
    fields = source.fields
    columns = joint_columns(fields, joints) if joints else ()
    robot = describe(columns or fields)
    every = [(columns, "as stated")] if columns else joint_sets(fields, robot.joints, robot.names)
    if not every:
        raise InputError(
            f"{source.name} has no {robot.joints} columns that may be joints",
            code="missing-column",
            remedy="name them: --joints COLUMNS; there are "
            + listed([f.label for f in fields], 20),
        )
    columns, how = every[0]
    mechanism = mechanism_from_data(dict(robot.table), str(folder / PROJECT))
    stated = dict(zip(mechanism.joints, columns, strict=True))
    readings = in_si(stated, mechanism.joints)
    poses = source.ids or tuple(str(i) for i in range(1, len(source) + 1))
    T = mechanism.fk(np.stack(list(readings.values()), axis=1))
    noise = joint_noise(mechanism.joints)
    words = f"joints are {', '.join(f.label for f in columns)} of {source.name}, {how}"
    remarks = (*robot.remarks, words)
    if len(every) > 1:
        remarks += ("other columns may be the joints too: name them with --joints if they are",)
    if any(f.unit is None for f in columns):
        taken = " and ".join(taken_in(stated, mechanism.joints).values())
        remarks += (f"joints without a unit are taken in {taken}",)
    return Hand(
        poses, robot.table, readings, T, noise, remarks, drawn(mechanism, _LENGTH, _TWIST, _ZERO)
    )


def _flange(T: Array) -> dict[str, Array]:
    """x, y, z and the quaternion of poses (N, 4, 4)."""
    from scipy.spatial.transform import Rotation

    xyzw = Rotation.from_matrix(T[:, :3, :3]).as_quat().T
    named = dict(zip(("qx", "qy", "qz", "qw"), xyzw, strict=True))
    return {**dict(zip("xyz", T[:, :3, 3].T, strict=True)), **named}


def _unread(begun: CameraStart, hand: Hand) -> Hand:
    """Boards whose poses are unknown: where the search for each begins, in the first camera."""
    corners = begun.corners
    views = corners.views
    T = np.full((len(corners.poses), 4, 4), np.nan)
    # Of each image the view that shows most corners says where the first board is.
    for v in np.argsort(views.sizes, kind="stable"):
        camera, board = views.camera[v], views.board[v]
        to_first = np.linalg.inv(begun.X[camera] @ np.linalg.inv(begun.X[0]))
        T[views.image[v]] = (
            to_first @ begun.T_camera_board[v] @ np.linalg.inv(begun.Y[board]) @ begun.Y[0]
        )
    seen = np.isfinite(T).all(axis=(1, 2))
    readings = {}
    for name, some in _flange(T[seen]).items():
        filled = np.full(len(T), np.nan)
        filled[seen] = some
        readings[f"{name}0" if name in "xyz" else name] = filled
    noise = {"[xyz]": {"sd": np.inf}, "w[xyz]": {"sd": np.inf}}
    return replace(hand, poses=corners.poses, readings=readings, noise=noise)


def word(name: str, kind: str) -> str:
    """A name that parameters may begin with."""
    word = re.sub(r"\W", "_", name)
    return word if re.match(r"[A-Za-z_]", word) else f"{kind}_{word}"


class _Project:
    """The tables of the project, and the files beside it.

    on_body: the camera's body carries it, so that its place and that of the board are the inverse
    ones; by default as `begun` has it.
    """

    def __init__(
        self,
        begun: CameraStart,
        hand: Hand,
        table: CornerTable,
        stated: Collection[str],
        on_body: bool | None = None,
    ) -> None:
        self.begun, self.hand, self.table, self.stated = begun, hand, table, stated
        self.on_body = begun.held is False if on_body is None else on_body
        corners = begun.corners
        seen = np.unique(corners.image, return_counts=True)
        enough = seen[1] >= (_FEWEST if hand.table.get("read") is False else 1)
        self.kept = [int(i) for i in seen[0][enough]]
        self.eyes = {c: word(c, "camera") for c in corners.cameras}
        self.boards = {b.name: word(b.name, "board") for b in corners.boards}

    def begun_at(self, begun: CameraStart, on_body: bool | None = None) -> _Project:
        """The same from another start."""
        return _Project(begun, self.hand, self.table, self.stated, on_body)

    @property
    def left_out(self) -> tuple[str, ...]:
        """Images that are not used, in words."""
        poses = self.begun.corners.poses
        used = {poses[i] for i in self.kept}
        unused = [image for image in self.table.images if image not in used]
        if not unused:
            return ()
        return (f"images without a pose or with too few corners are left out: {listed(unused, 5)}",)

    @property
    def tables(self) -> dict[str, Any]:
        """Of the project file."""
        hand = self.hand
        spread = {k: k for k in ("pose", "camera", "board", "point", "u", "v")}
        return {
            "schema": SCHEMA,
            "title": Path(self.table.file or "images").stem,
            "mechanism": {
                **hand.table,
                "instrument": list(self._instruments()),
                "parameters": self._parameters(),
            },
            "data": {
                "file": READINGS,
                "pose": "pose",
                "join": [{"file": CORNERS, "pose": "pose", "spread": spread}],
            },
            "noise": {**hand.noise, **self._noise()},
        }

    def _pairs(self) -> Iterable[tuple[int, int]]:
        views = self.begun.corners.views
        every = zip(views.camera.tolist(), views.board.tolist(), strict=True)
        return sorted(dict.fromkeys(every))

    def _names(self) -> dict[tuple[int, int], str]:
        """What each instrument is called: by its camera, and by its board where it sees several."""
        corners = self.begun.corners
        several = len(corners.boards) > 1
        return {
            (c, b): self.eyes[corners.cameras[c]]
            + (f"_{self.boards[corners.boards[b].name]}" if several else "")
            for c, b in self._pairs()
        }

    def _instruments(self) -> Iterable[dict[str, Any]]:
        corners = self.begun.corners
        for (c, b), name in self._names().items():
            camera, board = corners.cameras[c], corners.boards[b]
            seen = (corners.camera == c) & (corners.board == b)
            ids = list(board.points)
            used = [ids[i] for i in np.unique(corners.point[seen])]
            # In the unit of the lengths that state none.
            length = dict(self.hand.table.get("units", {})).get("length", "m")
            points = {p: from_si(np.array(board.points[p]), length).tolist() for p in used}
            yield {
                "type": "camera",
                "name": name,
                "eye": self.eyes[camera],
                "board": self.boards[board.name],
                "on": "body" if self.on_body else "base",
                "lens": self.begun.intrinsics[camera].lens,
                "offsets": not board.planar,
                "points": points,
            }

    def _parameters(self) -> dict[str, Any]:
        begun, corners = self.begun, self.begun.corners
        stated: dict[str, Any] = dict(self.hand.parameters)
        free = self.hand.table.get("read") is False
        held = begun.held is not False
        blind = any(fact.code in ("no-rotation", "parallel-axes") for fact in begun.facts)
        for c, (camera, eye) in enumerate(self.eyes.items()):
            X = begun.X[c] @ np.linalg.inv(begun.X[0]) if free else begun.X[c]
            place = np.linalg.inv(X) if self.on_body else X
            stated |= _six(eye, place, fixed=free and c == 0, mounted=blind and not held)
            lens = begun.intrinsics[camera]
            for key, value in lens.values.items():
                entry: dict[str, Any] = {"value": float(value)}
                if key in ("f", "cx", "cy"):
                    entry["unit"] = "px"
                    stated_sd = camera in self.stated
                    if key != "f" or stated_sd:
                        share = _STATED if stated_sd else _CENTRED
                        entry["sd"] = round(share * abs(lens.fx), 1)
                if key in USUAL and lens.lens != "fisheye":
                    entry["sd"] = USUAL[key]
                stated[f"{eye}_{key}"] = entry
        for b, board in enumerate(corners.boards):
            Y = begun.Y[b]
            if free:
                Y = np.linalg.inv(begun.Y[0]) @ Y
            place = np.linalg.inv(Y) if self.on_body else Y
            stated |= _six(
                self.boards[board.name], place, fixed=free and b == 0, mounted=blind and held
            )
            if free and board.planar and len(board.points) > _FEWEST:
                # nothing but the board says how large anything is
                stated[f"{self.boards[board.name]}_scale"] = {"value": 0.0, "fixed": True}
            if not board.planar:
                for point in np.unique(corners.point[corners.board == b]):
                    for axis in "xyz":
                        name = f"{self.boards[board.name]}_{list(board.points)[point]}_{axis}"
                        stated[name] = {"value": 0.0, "unit": "mm", "sd": 1e3 * POINT_SD}
        return stated

    def _noise(self) -> dict[str, Any]:
        corners, residuals = self.begun.corners, self.begun.residuals
        noise = {}
        for (c, b), name in self._names().items():
            left = np.abs(residuals[(corners.camera == c) & (corners.board == b)])
            # Of the start, which wrong corners do not bend.
            sd = max(_NORMAL * float(np.median(left)), CORNER)
            noise[name] = {"sd": round(sd, 3), "unit": "px", "estimate": "group"}
        return noise

    def _labels(self) -> list[str]:
        """Under which each corner is read."""
        corners = self.begun.corners
        ids = [list(b.points) for b in corners.boards]
        eyes = [self.eyes[camera] for camera in corners.cameras]
        boards = [self.boards[board.name] for board in corners.boards]
        which = zip(corners.camera, corners.board, corners.point, strict=True)
        return [f"{eyes[c]}:{boards[b]}:{ids[b][k]}" for c, b, k in which]

    def marked(self, readings: Mapping[str, NDArray[np.bool_]]) -> NDArray[np.bool_]:
        """(N,) the corners one of whose coordinates is marked, by reading and image kept."""
        row = {image: i for i, image in enumerate(self.kept)}
        none = np.zeros(len(self.kept), dtype=bool)
        marks = [
            image in row and bool(readings.get(f"{label}:u", none)[row[image]])
            for label, image in zip(self._labels(), self.begun.corners.image.tolist(), strict=True)
        ]
        return np.array(marks, dtype=bool)

    @property
    def dataset(self) -> Dataset:
        """The readings, under the names that they have in the project."""
        corners, kept = self.begun.corners, self.kept
        readings = {name: values[kept] for name, values in self.hand.readings.items()}
        row = {image: i for i, image in enumerate(kept)}
        for label, image, pixel in zip(self._labels(), corners.image, corners.uv, strict=True):
            for axis, value in zip(PIXEL, pixel, strict=True):
                column = readings.setdefault(f"{label}:{axis}", np.full(len(kept), np.nan))
                if image in row:
                    column[row[image]] = value
        units = {name: "px" for name in readings if name.endswith((":u", ":v"))}
        poses = [corners.poses[i] for i in kept]
        return Dataset.from_arrays(readings, units=units, poses=poses)

    def readings(self) -> bytes:
        """The poses that show enough, a row each."""
        columns: dict[str, Any] = {"pose": [self.begun.corners.poses[i] for i in self.kept]}
        for name, values in self.hand.readings.items():
            columns[name] = values[self.kept]
        return table_bytes(columns, ".csv")

    def corners(self) -> bytes:
        """The corners of these poses."""
        corners = self.begun.corners
        rows = np.flatnonzero(np.isin(corners.image, self.kept))
        ids = [list(b.points) for b in corners.boards]
        columns: dict[str, Any] = {
            "pose": [corners.poses[corners.image[i]] for i in rows],
            "camera": [self.eyes[corners.cameras[corners.camera[i]]] for i in rows],
            "board": [self.boards[corners.boards[corners.board[i]].name] for i in rows],
            "point": [ids[corners.board[i]][corners.point[i]] for i in rows],
            "u": corners.uv[rows, 0],
            "v": corners.uv[rows, 1],
        }
        return table_bytes(columns, ".csv")


def _six(owner: str, T: Array, *, fixed: bool, mounted: bool) -> dict[str, Any]:
    """The six parameters of a place; mounted: as far as what is mounted usually is."""
    turns = yaw_pitch_roll(T[:3, :3])
    entries = [
        (axis, 1e3 * float(v), "mm", _MOUNTED) for axis, v in zip("xyz", T[:3, 3], strict=True)
    ]
    entries += [
        (name, float(from_si(np.array(v), "deg")), "deg", _TURNED)
        for name, v in zip(("rz", "ry", "rx"), turns, strict=True)
    ]
    further = {"fixed": True} if fixed else {}
    return {
        f"{owner}_{name}": {"value": value, "unit": of, **({"sd": sd} if mounted else further)}
        for name, value, of, sd in entries
    }
