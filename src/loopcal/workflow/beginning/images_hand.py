"""The hand of a robot that images were taken with: its poses, read or computed from joints."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from loopcal.arrays import Array
from loopcal.errors import InputError, listed
from loopcal.estimation.cameras.facts import Fact
from loopcal.estimation.cameras.hand_changes import CHANGES, POSITIONS, changed
from loopcal.estimation.cameras.start import (
    CameraStart,
)
from loopcal.files.cameras.folder import Files
from loopcal.files.cameras.places import PlaceTable, read_places, read_positions, row_names
from loopcal.files.machines.mechanism_file import mechanism_from_data
from loopcal.files.recognition.fields import Field, in_si, taken_in
from loopcal.files.recognition.joint_sets import joint_columns, joint_sets
from loopcal.files.recognition.robots import Robot
from loopcal.files.recognition.sources import sources_of
from loopcal.workflow.beginning.begun import PROJECT, drawn, joint_noise

PLACE, TURN = 1e-4, 1e-4
"""Where the learning of sds begins: a stated pose [m], [rad]."""
_LENGTH, _TWIST, _ZERO = 0.5, 1.0, 5.0
"""How far a robot is from its drawing, as sds [mm, mrad, mrad]: pixels at a distance tell less than
a tracker. Chosen: docs/explanation/model-error.md has what arms of many makers are off by."""
Describe = Callable[[Sequence[Field]], Robot]
"""The robot by the columns of its joints."""


@dataclass(frozen=True, eq=False)
class Hand:
    """The body that moves: its columns of readings by quantity [SI], and T_base_flange (N, 4, 4)
    by pose; ways: these by what their turns may mean, in words; table: of the mechanism without
    instruments; noise: of its readings; counted: whether the poses have no names of their own;
    measured: whether the unit of positions is stated; unturned: whether no file states turns, so
    that the hand is taken never to turn."""

    poses: tuple[str, ...]
    table: Mapping[str, Any]
    readings: Mapping[str, Array]
    T_base_flange: Array | None
    noise: Mapping[str, Any]
    remarks: tuple[str, ...] = ()
    parameters: Mapping[str, Any] = field(default_factory=dict)
    ways: Mapping[str, Array] = field(default_factory=dict)
    counted: bool = False
    measured: bool = False
    unturned: bool = False

    def turned(self, way: str) -> Hand:
        """With its turns understood in this way."""
        T = self.ways[way]
        remarks = (*self.remarks, f"turns of the flange: {way}")
        return replace(
            self, T_base_flange=T, readings=flange_columns(T), remarks=remarks, ways={way: T}
        )

    def read_as(self, words: Sequence[str]) -> Hand:
        """With poses read as those of the first day were (`hand_changes`); joints stay."""
        some = [
            word
            for word in words
            if word in self.ways or (word in CHANGES and not (self.measured and word in POSITIONS))
        ]
        if not some or self.T_base_flange is None or "x" not in self.readings:
            return self
        T = changed(self.T_base_flange, self.ways, some)
        others = {} if self.ways.keys() & {*some} else self.ways
        return replace(
            self,
            T_base_flange=T,
            readings=flange_columns(T),
            ways={way: changed(other, {}, some) for way, other in others.items()},
            remarks=(*self.remarks, f"poses of the flange are read as before: {', '.join(some)}"),
        )

    def words(self, facts: Iterable[Fact]) -> list[str]:
        """As `read_as` takes them: how the turns were understood, and what images changed."""
        if "x" not in self.readings:
            return []
        stated = [*self.ways] if len(self.ways) == 1 else []
        return [*stated, *(fact.poses for fact in facts if fact.poses)]

    def corrected(self, T: Array) -> Hand:
        """With the poses that the images fit: joints are those of the row that stands there."""
        if "x" in self.readings:
            return replace(self, readings=flange_columns(T))
        assert self.T_base_flange is not None
        same = (T[:, None] == self.T_base_flange).all(axis=(2, 3))
        rows = np.where(same.any(axis=1), same.argmax(axis=1), np.arange(len(T)))
        return replace(
            self, readings={name: values[rows] for name, values in self.readings.items()}
        )


def hand_of(
    poses: Sequence[Path],
    describe: Describe | None,
    joints: str | None,
    folder: Path,
    *,
    unturned: bool = True,
) -> Hand:
    """The robot's part of the files: its tables of poses or joints; unturned: whether positions
    alone may be those of a hand that never turns."""
    if describe is not None:
        return _joints(poses, describe, joints, folder)
    stated = _stated(poses)
    alone = stated is None and unturned
    if alone:
        stated = next(_tables(poses, read_positions), None)
    if stated is not None:
        noise = {
            "[xyz]": {"sd": 1e3 * PLACE, "unit": "mm", "estimate": "group"},
            "w[xyz]": {"sd": 1e3 * TURN, "unit": "mrad", "estimate": "group"},
        }
        words = f"{stated.file} states the pose of the flange"
        if alone:
            words = f"{stated.file} states where the flange is, and no turns: it never turns"
        return Hand(
            stated.name,
            {"type": "free-body"},
            flange_columns(stated.T),
            stated.T,
            noise,
            (words, *(() if alone else _left_out(stated, [*_tables(poses)]))),
            ways=stated.ways,
            counted=stated.counted,
            measured=stated.measured,
            unturned=alone,
        )
    words = "no file states poses of a robot, so the cameras alone are calibrated"
    if poses:
        names = listed([path.name for path in poses], 3)
        words = (
            f"{names} states no pose of a flange, and no robot is described (--urdf or --dh), so "
            "the cameras alone are calibrated"
        )
    return Hand((), {"type": "free-body", "read": False}, {}, None, {}, (words,))


def states_flange(files: Files) -> bool:
    """Whether a table states poses of the flange."""
    return _stated(files.poses) is not None


def _stated(paths: Sequence[Path]) -> PlaceTable | None:
    """The poses of the flange: of the file with most of them, or of files with one pose each, which
    are named as these."""
    tables = [*_tables(paths)]
    most = max(tables, key=lambda table: len(table.name), default=None)
    if most is None or len(most.name) > 1 or len(tables) == 1:
        return most
    by_name = {Path(table.file).stem: table.T for table in tables}
    names = tuple(sorted(by_name, key=lambda name: (len(name), name)))  # 9 before 10
    T = np.concatenate([by_name[name] for name in names])
    return PlaceTable(names, T, f"each of {len(tables)} files")


def _tables(
    paths: Sequence[Path], read: Callable[[Path], PlaceTable] = read_places
) -> Iterator[PlaceTable]:
    for path in paths:
        with suppress(InputError):
            yield read(path)


def _left_out(stated: PlaceTable, tables: Sequence[PlaceTable]) -> Iterator[str]:
    """Names other files that state poses, where these are not among those that are used."""
    used = dict(zip(stated.name, stated.T, strict=True))
    for table in tables if len(stated.name) > 1 else ():
        among = (
            name in used and np.allclose(used[name], T, equal_nan=True)
            for name, T in zip(table.name, table.T, strict=True)
        )
        if len(table.name) > 1 and table.file != stated.file and not all(among):
            yield (
                f"{table.file} states {len(table.name)} poses too, which are not used. If they "
                f"belong to other images than those of {stated.file}, write all poses into one "
                "table. If the cameras have different poses, use one folder for each camera"
            )


def _joints(paths: Sequence[Path], describe: Describe, joints: str | None, folder: Path) -> Hand:
    """The robot's joints by columns of the table of poses."""
    if not paths:
        raise InputError(
            "no file holds the joints of the robot",
            code="no-data",
            remedy="add a table with a row for each image: pose and its joints",
        )
    # A folder may hold more than the joints, such as the robot's table.
    for path in paths:
        source = sources_of(path, 0)[0]
        columns = joint_columns(source.fields, joints) if joints else ()
        robot = describe(columns or source.fields)
        every = [(columns, "as stated")] if columns else []
        every = every or joint_sets(source.fields, robot.joints, robot.names)
        if every:
            break
    else:
        names = listed([path.name for path in paths], 3)
        raise InputError(
            f"{names} has no {robot.joints} columns that may be joints",
            code="missing-column",
            remedy="name them: --joints COLUMNS; there are "
            + listed([f.label for f in source.fields], 20),
        )
    columns, how = every[0]
    robot = robot.apart or robot  # without the point that its type states: cameras see it
    mechanism = mechanism_from_data(dict(robot.table), str(folder / PROJECT))
    stated = dict(zip(mechanism.joints, columns, strict=True))
    readings = in_si(stated, mechanism.joints)
    poses, unnamed = row_names(source)
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
        poses,
        robot.table,
        readings,
        T,
        noise,
        remarks,
        drawn(mechanism, _LENGTH, _TWIST, _ZERO),
        counted=unnamed,
    )


def flange_columns(T: Array) -> dict[str, Array]:
    """x, y, z and the quaternion of poses (N, 4, 4)."""
    from scipy.spatial.transform import Rotation

    xyzw = Rotation.from_matrix(T[:, :3, :3]).as_quat().T
    named = dict(zip(("qx", "qy", "qz", "qw"), xyzw, strict=True))
    return {**dict(zip("xyz", T[:, :3, 3].T, strict=True)), **named}


def unread(begun: CameraStart, hand: Hand) -> Hand:
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
    for name, some in flange_columns(T[seen]).items():
        filled = np.full(len(T), np.nan)
        filled[seen] = some
        readings[f"{name}0" if name in "xyz" else name] = filled
    noise = {"[xyz]": {"sd": np.inf}, "w[xyz]": {"sd": np.inf}}
    return replace(hand, poses=corners.poses, readings=readings, noise=noise)
