"""A project from hand-eye samples: poses of the flange, and of a marker in the camera, no pixels.

A marker in the camera is C = X A Y with a camera beside the robot and A the flange in its base, and
C = X A^-1 Y with the camera on the hand. Files of easy_handeye hold A^-1 of a camera beside the
robot, so that both look alike: unless they say which, that which is shorter is on the hand.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from loopcal.arrays import Array
from loopcal.errors import InputError
from loopcal.estimation.cameras.hand_eye import HandEye, of_poses
from loopcal.files.cameras.folder import files_of
from loopcal.files.cameras.places import Samples, hand_eye_samples
from loopcal.files.tables.writer import table_bytes
from loopcal.files.toml.reader import SCHEMA
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.chain import product
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.placement import inverse
from loopcal.mechanisms.station import Station
from loopcal.mechanisms.tree import BASE
from loopcal.presentation.shown import with_unit
from loopcal.workflow.beginning.begun import READINGS, Begun
from loopcal.workflow.beginning.images_hand import PLACE, TURN, flange_columns
from loopcal.workflow.beginning.images_project import six_of

CAMERA, MARKER, SEEN = "camera", "marker", "seen"
_FEWEST = 3
_LATERAL, _DEPTH, _TURNS = 0.5, 1.0, 3.0
"""Where the learning of a marker's sds begins [mm, mm, mrad]."""
_FITS = 0.3
"""A miss above it (turns [rad], places over distances) is no hand-eye."""


def samples_of(entries: Sequence[object]) -> list[Samples]:
    """What the entries mean as hand-eye samples, none where they are no such files."""
    return hand_eye_samples(files_of(entries))


def from_samples(every: Sequence[Samples]) -> Begun:
    """`init` of hand-eye samples. Raises InputError for fewer than three, and where no hand and
    eye explain them."""
    if len(every[0].robot) < _FEWEST:
        raise InputError(
            f"{len(every[0].robot)} hand-eye samples are too few",
            code="not-identifiable",
            place=every[0].file,
            remedy="take ten or more, turned about two axes",
        )
    tried = [
        (*of_poses(inverse(one.robot) if back else one.robot, one.tracking), one, back)
        for one in every
        for back in (False, True)
    ]
    miss, placed, one, back = min(tried, key=lambda way: way[0])
    if miss > _FITS:
        raise InputError(
            "no place of camera and marker explains these hand-eye samples",
            code="mismatched-poses",
            place=one.file,
            remedy="check that each sample holds both poses of one moment, the flange in the base "
            "and the marker in the camera",
        )
    on_hand, robot, taken = _mounted(one, placed, back)
    return _begun(one, robot, placed, on_hand=on_hand, taken=taken)


def later_samples(every: Sequence[Samples], mechanism: Mechanism) -> Dataset:
    """Readings of another day for calibrated places of camera and marker."""
    one = every[0]
    on_hand = mechanism.families[0].against != BASE
    values = {p.name: p.nominal for p in mechanism.parameters}
    X, Y = (product(Station(name).steps, {}, values) for name in (CAMERA, MARKER))

    def misses(A: Array) -> float:
        off = X @ (inverse(A) if on_hand else A) @ Y - one.tracking
        return float(np.median(np.linalg.norm(off, axis=(1, 2))))

    return _dataset(one.tracking, min(one.robot, inverse(one.robot), key=misses))


def _mounted(one: Samples, at: HandEye, back: bool) -> tuple[bool, Array, tuple[str, ...]]:
    """Whether the camera is on the hand, the flange in the base, and what was taken for granted."""
    sizes = [float(np.linalg.norm(T[:3, 3])) for T in (at.X, at.Y)]
    on_hand = back if one.on_hand is None else one.on_hand
    if one.on_hand is None and back and one.turned_around:
        on_hand = sizes[0] < sizes[1]
    where = "on the flange" if on_hand else "beside the robot"
    words = f"the camera is {where}, as stated"
    if one.on_hand is None:
        words = f"the camera is taken to be {where}: "
        words += (
            f"the camera is {with_unit(sizes[0], 'm')} from one end of the robot, the marker "
            f"{with_unit(sizes[1], 'm')} from the other. "
            if one.turned_around and back
            else "the samples fit so with the flange in the base. "
        )
        other = "beside the robot" if on_hand else "on the flange"
        words += f"If it is {other}, the poses of the robot are the inverse ones"
    inverted = on_hand != back
    robot = inverse(one.robot) if inverted else one.robot
    more = ("the poses of the robot are turned around: base in the flange",) if inverted else ()
    return on_hand, robot, (words, *more)


def _begun(
    one: Samples, robot: Array, at: HandEye, *, on_hand: bool, taken: tuple[str, ...]
) -> Begun:
    dataset = _dataset(one.tracking, robot)
    looking = {
        "type": "pose",
        "name": SEEN,
        "readings": [f"{SEEN}_{axis}" for axis in "xyz"],
        "columns": [f"{SEEN}_q{c}" for c in "wxyz"],
        "station": CAMERA,
        "target": MARKER,
        **({"against": "body"} if on_hand else {}),
    }
    learnt = {"estimate": "group"}
    tables = {
        "schema": SCHEMA,
        "title": Path(one.file.split(" and ")[0]).stem,
        "mechanism": {
            "type": "free-body",
            "instrument": [looking],
            "parameters": {**six_of(CAMERA, at.X), **six_of(MARKER, at.Y)},
        },
        "data": {"file": READINGS, "pose": "pose"},
        "noise": {
            "[xyz]": {"sd": 1e3 * PLACE, "unit": "mm"},
            "w[xyz]": {"sd": 1e3 * TURN, "unit": "mrad"},
            f"{SEEN}_x,{SEEN}_y": {"sd": _LATERAL, "unit": "mm", **learnt},
            f"{SEEN}_z": {"sd": _DEPTH, "unit": "mm", **learnt},
            f"{SEEN}_w[xyz]": {"sd": _TURNS, "unit": "mrad", **learnt},
        },
    }
    remarks = (
        f"poses of the flange and of a marker in the camera: {one.file}"
        + "".join(f"; {way}" for way in one.ways if way),
        *taken,
        f"the robot is taken to be exact to {1e3 * PLACE:g} mm and {1e3 * TURN:g} mrad, for "
        "samples cannot distinguish its errors from those of the marker: state what you know of "
        "it in [noise]",
    )
    columns: dict[str, Any] = {"pose": list(dataset.poses), **dataset.readings}
    words = f"{len(dataset)} hand-eye samples"
    return Begun(tables, {READINGS: table_bytes(columns, ".csv")}, remarks, dataset, words)


def _dataset(tracking: Array, robot: Array) -> Dataset:
    seen = {f"{SEEN}_{key}": value for key, value in flange_columns(tracking).items()}
    readings = {**flange_columns(robot), **seen}
    poses = [str(i + 1) for i in range(len(robot))]
    return Dataset.from_arrays(readings, poses=poses)
