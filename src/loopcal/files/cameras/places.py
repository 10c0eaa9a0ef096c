"""Poses of robots and hand-eye samples as other programs write them.

easy_handeye samples      samples: robot and tracking, each translation and rotation; or
                          hand_world_samples and camera_marker_samples, each transforms
industrial_calibration    x, y, z, qx, qy, qz, qw; several in a list, in a mapping, or in files
                          that `data` lists beside their images
ViSP                      pose_rPe_1.yaml, pose_cPo_1.yaml, ...: x, y, z and a rotation vector
a table of poses          pose, x, y, z and a quaternion, a matrix or turns, units in the header,
                          [m] without; with those of two frames side by side, hand-eye samples
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from loopcal.arrays import Array
from loopcal.errors import InputError
from loopcal.files.cameras.corners import split_name
from loopcal.files.cameras.document import (
    DOCUMENTS,
    Part,
    is_transform,
    read_document,
    transform,
)
from loopcal.files.recognition.fields import Field, Source
from loopcal.files.recognition.joint_sets import unit_norm
from loopcal.files.recognition.layouts import Seen, instruments, numbered
from loopcal.files.recognition.meanings import meanings
from loopcal.files.recognition.sources import sources_of
from loopcal.units import unit

TABLES = (".csv", ".tsv", ".txt")
_ABOUT_Z = ("rz", "yaw", "u", "c", "r", "theta")
"""Names of the angle of a hand that turns about z alone, as those of SCARA robots do."""
_BESIDE_Z = frozenset(("w", "p", "a", "b", "rx", "ry", "roll", "pitch", "qx", "qy", "qz", "qw"))
"""Names of other turns beside it: such a hand does not turn about z alone."""
_POSE = re.compile(r"(?:.*_)?(?:p|pose|tcp|flange)_?\d")
"""A column of a pose whose numbers have no names, as p[...] of Universal Robots."""
_LISTED = 10_000
"""Files of poses that one file lists."""


@dataclass(frozen=True, eq=False)
class PlaceTable:
    """Places by image or pose: names, and T (N, 4, 4) [m] of each as the file states it.

    ways: T by what its turns may mean, in words, where the file leaves that open; T is the first.
    counted: whether the file has no names, and its rows are counted from 1; measured: whether its
    columns state the unit of positions.
    """

    name: tuple[str, ...]
    T: Array
    file: str = ""
    ways: Mapping[str, Array] = field(default_factory=dict)
    counted: bool = False
    measured: bool = False


@dataclass(frozen=True, eq=False)
class Samples:
    """Hand-eye samples: the flange in the robot's base, and the marker in the camera.

    robot, tracking: (N, 4, 4) [m]; on_hand: whether the camera is, as stated, or None;
    ways: how turns were understood; turned_around: whether poses of a camera beside the robot are
    inverse ones, base in flange, as easy_handeye keeps them.
    """

    robot: Array
    tracking: Array
    file: str = ""
    on_hand: bool | None = None
    ways: tuple[str, ...] = ()
    turned_around: bool = False


def read_places(path: str | Path) -> PlaceTable:
    """The poses of a file by name; a table, or YAML and JSON of industrial_calibration; of hand-eye
    samples the robot's, counted from 1.

    Raises InputError for a file without poses, and for quaternions and matrices that are none.
    """
    path = Path(path)
    if path.suffix.lower() not in DOCUMENTS:
        return _of_source(sources_of(path, 0)[0], path)
    document = read_document(path, every=True)
    if robot := _robot_poses(document):  # those of the marker may not stand beside them
        names = tuple(map(str, range(1, len(robot) + 1)))
        return PlaceTable(names, np.array(robot), path.name, counted=True)
    every = list(_of_document(document, path, "1"))
    if not every:  # numbers by name, as in the columns of a table
        with suppress(InputError):
            return _of_source(sources_of(path, 0)[0], path)
        raise InputError(
            "no pose is recognised in this file",
            code="missing-key",
            place=path.name,
            remedy="state x, y, z [m] and qx, qy, qz, qw of each pose",
        )
    counted = not any(name for name, _ in every)  # as the rows of a table without names
    times = _times(document) if counted else []
    otherwise = times if len(times) == len(every) else map(str, range(1, len(every) + 1))
    names = tuple(name or other for (name, _), other in zip(every, otherwise, strict=True))
    return PlaceTable(names, np.array([T for _, T in every]), path.name, counted=counted)


def read_positions(path: str | Path) -> PlaceTable:
    """Places of a hand that never turns, of a table that states x, y, z and no turns, as a gantry
    has them. Raises InputError for another file."""
    source = sources_of(Path(path), 0)[0]
    by = {f.stem: f for f in source.fields if not f.is_time}
    if by.keys() != {*"xyz"}:
        raise InputError("no positions alone", code="missing-column", place=source.name)
    T = np.tile(np.eye(4), (len(source), 1, 1))
    T[:, :3, 3] = np.array([unit(by[a].unit or "m").factor * by[a].values for a in "xyz"]).T
    names, counted = row_names(source)
    if not np.isfinite(T).all():
        raise InputError("a position is not complete", code="missing-reading", place=source.name)
    measured = all(f.unit for f in by.values())
    return PlaceTable(names, T, source.name, counted=counted, measured=measured)


def _times(document: Part) -> list[str]:
    """When the items of a list were taken [s], as ROS and others state it; empty where not all
    state it, or two state the same."""
    if not isinstance(document.data, list):
        return []
    times = []
    for one in document.parts():
        stated = (one.get("header") or one).get("stamp", "timestamp", "time")
        if stated is None or isinstance(stated.data, list):
            return []
        if isinstance(stated.data, dict):
            ns = int(stated.part("nsecs", "nanosec").number)
            times.append(f"{int(stated.part('secs', 'sec').number)}.{ns:09d}")
        else:
            times.append(stated.text)
    return times if len({*times}) == len(times) else []


def lists_poses(path: Path) -> bool:
    """Whether a YAML or JSON file lists poses, whatever else it states."""
    listed = read_document(path).get("data", "poses")
    return listed is not None and isinstance(listed.data, list)


def _of_document(part: Part, path: Path, name: str, depth: int = 4) -> Iterator[tuple[str, Array]]:
    if is_transform(part):
        yield name, transform(part)
        return
    if not depth:
        return
    alone = [one for _, one in part.items() if is_transform(one)]
    if len(alone) == 1:  # beside the name of its image
        yield name, transform(alone[0])
        return
    if columns := _side_columns(part):
        yield from columns
        return
    listed = part.get("data", "poses")
    if listed is not None and isinstance(listed.data, list) and len(listed.data) > _LISTED:
        raise listed.wrong(f"a list of at most {_LISTED:,} poses")
    inner = listed.parts() if listed is not None and isinstance(listed.data, list) else None
    if inner is None and isinstance(part.data, list):
        inner = part.parts()
    for one in inner or ():
        image, pose = one.get(*_NAMES), one.get("pose", "transform")
        label = split_name(Path(image.text).name)[0] if image else ""
        if pose is not None and not isinstance(pose.data, dict | list):
            # The path stands relative to the file that lists it.
            yield label, transform(read_document(path.parent / pose.text))
        else:
            yield from _of_document(pose or one, path, label, depth - 1)
    if inner is None:
        for key, one in part.items():
            yield from _of_document(one, path, key, depth - 1)


_NAMES = (
    *("image", "name", "image_name", "file", "filename", "img", "id"),
    *("file_path", "image_path", "image_file", "frame"),
)
"""How the image of a pose is named beside it."""
_SIDE = re.compile(r"(?P<turn>R|r|rot|rotations?|rvecs?)|t|T|trans|translations?|tvecs?")


def _side_columns(part: Part) -> list[tuple[str, Array]]:
    """Poses of two lists side by side, R_gripper2base and t_gripper2base, without names."""
    lists: dict[bool, list[list[Part]]] = {True: [], False: []}
    for key, one in part.items():
        kind = _SIDE.fullmatch(key.split("_")[0])
        if (
            kind
            and isinstance(one.data, list)
            and any(isinstance(x, list | dict) for x in one.data)
        ):
            lists[kind["turn"] is not None].append(one.parts())
    turned, moved = lists[True], lists[False]
    if not (len(turned) == len(moved) == 1 and len(turned[0]) == len(moved[0]) > 1):
        return []
    pairs = zip(turned[0], moved[0], strict=True)
    return [("", transform(Part({"R": R.data, "t": t.data}, R.place))) for R, t in pairs]


def _of_source(source: Source, path: Path) -> PlaceTable:
    seen = next((s for s in instruments(source.fields) if s.kind == "pose"), None)
    # Six numbers may be joints: only what shows that it turns, or is named so, is a pose.
    arrays = (
        one
        for one in numbered(source.fields)
        if one.form in ("matrix", "quaternion") or _POSE.match(one.position[0].stem)
    )
    seen = seen or next(arrays, None) or _unnamed(source.fields)
    ways = _turned_about_z(source) if seen is None else _ways(seen, len(source))
    if not ways:
        raise InputError(
            "no pose is recognised among the columns",
            code="missing-column",
            place=path.name,
            remedy="name them x_m, y_m, z_m, qx, qy, qz, qw, or x_mm, y_mm, z_mm, rx_deg, ry_deg, "
            "rz_deg",
        )
    T = next(iter(ways.values()))
    names, counted = row_names(source)
    wrong = np.flatnonzero(~np.isfinite(T).all(axis=(1, 2)))
    if wrong.size:
        raise InputError(
            f"the pose {names[wrong[0]]!r} is not complete",
            code="missing-reading",
            place=path.name,
            remedy="state all its numbers, or remove its row",
        )
    position = () if seen is None else seen.position
    measured = bool(position) and all(f.unit for f in position)
    return PlaceTable(names, T, path.name, ways if "" not in ways else {}, counted, measured)


def _ways(seen: Seen, count: int) -> dict[str, Array]:
    """Poses (N, 4, 4) by what the turns may mean, in words; "" where the file states that."""
    by_stem = {f.stem: i for i, f in enumerate(seen.turned)}
    order = tuple(range(len(seen.turned)))
    named = seen.form == "matrix" or any(by_stem)
    if seen.form == "quaternion":
        # The letters at the end of the names say which is which; without them w comes first.
        letters = {stem[-1]: i for stem, i in by_stem.items() if stem}
        order = tuple(letters[c] for c in "wxyz") if set("wxyz") <= set(letters) else order
    stated = named and seen.form != "turns"
    ways: dict[str, Array] = {}
    for one in meanings(seen):
        if one.inverted or one.turns is None or (stated and one.order != order):
            continue
        T = np.tile(np.eye(4), (count, 1, 1))
        T[:, :3, :3] = one.turns
        T[:, :3, 3] = np.array([unit(f.unit or "m").factor * f.values for f in seen.position]).T
        ways.setdefault("" if stated else one.words[-1], T)
    return ways


def _turned_about_z(source: Source) -> dict[str, Array]:
    """The same of a hand with one angle, which may count either way; {} where none is named."""
    by = {f.stem: f for f in source.fields}
    turn = next((by[name] for name in _ABOUT_Z if name in by), None)
    if turn is None or not {*"xyz"} <= by.keys() or not _BESIDE_Z.isdisjoint(by):
        return {}
    angle = unit(turn.unit or ("deg" if turn.span > 2.0 * np.pi else "rad")).factor * turn.values
    T = np.tile(np.eye(4), (len(source), 1, 1))
    T[:, :3, 3] = np.array([unit(by[a].unit or "m").factor * by[a].values for a in "xyz"]).T
    c, s = np.cos(angle), np.sin(angle)
    T[:, :2, :2] = np.moveaxis(np.array([[c, -s], [s, c]]), 2, 0)
    other = T.copy()
    other[:, :3, :3] = np.swapaxes(T[:, :3, :3], 1, 2)
    return {f"{turn.label} about z": T, f"{turn.label} about -z": other}


def _unnamed(fields: Sequence[Field]) -> Seen | None:
    """The pose of columns without names, as programs print it: a matrix of 3 or 4 rows, or x, y, z
    and a quaternion or three turns, with or without a number ahead."""
    if any(field_.stem for field_ in fields):
        return None
    for count in (16, 12):
        some = tuple(fields[len(fields) - count :])
        if len(fields) - count in (0, 1):
            turned = tuple(f for i, f in enumerate(some[:12]) if i % 4 != 3)
            return Seen("pose", some[3:12:4], turned, "matrix")
    numbered = len(fields) == 7 and not unit_norm(fields[-4:])
    if len(fields) in (7, 8) and not numbered:
        return Seen("pose", tuple(fields[-7:-4]), tuple(fields[-4:]), "quaternion")
    if len(fields) == 6 or numbered:
        return Seen("pose", tuple(fields[-6:-3]), tuple(fields[-3:]), "turns")
    return None


def row_names(source: Source) -> tuple[tuple[str, ...], bool]:
    """The names of the rows, and whether they have none: then times, each once, or counts from 1.

    Whole times are names: they number the images.
    """
    if source.ids:
        return source.ids, False
    for field_ in source.fields:
        if field_.is_time and np.unique(field_.values).size == len(source):
            whole = (field_.values == np.round(field_.values)).all()
            return tuple(str(int(t) if whole else t) for t in field_.values.tolist()), not whole
    return tuple(map(str, range(1, len(source) + 1))), True


def _robot_poses(document: Part, *also: str) -> list[Array]:
    """The poses of the robot in samples of either version; also: other names of their list."""
    if (pairs := _pairs(document)) is not None:
        return [transform(_of(one, _ROBOT, "robot")) for one in pairs.parts()]
    hand = document.get("hand_world_samples", *also)
    return [] if hand is None else [transform(T) for T in (hand.get("transforms") or hand).parts()]


def _pairs(document: Part) -> Part | None:
    """The list of samples with the poses of robot and marker in each: `samples` of easy_handeye, or
    the document, whose keys say whose they are, as MoveIt has it; None where there is none."""
    if (samples := document.get("samples")) is not None:
        return samples
    first = document.parts()[0] if isinstance(document.data, list) and document.data else document
    both = all(_whose(first, one, other) for one, other in (_SIDES, _SIDES[::-1]))
    return document if first is not document and both else None


def _whose(part: Part, one: re.Pattern[str], other: re.Pattern[str]) -> Part | None:
    """The pose whose key has the words of one, and none of the other."""
    poses = ((key, place) for key, place in part.items() if is_transform(place))
    keyed = (place for key, place in poses if one.search(key) and not other.search(key))
    return next(keyed, None)


def _of(part: Part, whose: re.Pattern[str], *names: str) -> Part:
    """The pose of robot or marker in a sample, by these names or by the words of its key."""
    other = _SIDES[1 - _SIDES.index(whose)]
    return part.get(*names) or _whose(part, whose, other) or part.part(*names)


def read_samples(path: str | Path) -> Samples:
    """Hand-eye samples of easy_handeye, of ROS 1 or 2, or of MoveIt. Raises InputError for another
    file."""
    document = read_document(path)
    pairs, robot = _pairs(document), _robot_poses(document, "robot")
    if pairs is not None:
        marked = (_of(one, _MARKER, "tracking", "optical") for one in pairs.parts())
        tracking = [transform(one) for one in marked]
    else:
        marker = document.part("camera_marker_samples", "tracking")
        tracking = [transform(T) for T in (marker.get("transforms") or marker).parts()]
    if len(robot) != len(tracking) or not robot:
        raise InputError(
            f"the file has {len(robot)} poses of the robot and {len(tracking)} of the board",
            code="mismatched-poses",
            place=document.place,
            remedy="keep the samples of both together",
        )
    return Samples(
        np.array(robot),
        np.array(tracking),
        document.place,
        _on_hand(document),
        turned_around=pairs is not document,
    )


_EYES = {"true": True, "eye_in_hand": True, "false": False, "eye_on_base": False}


def _on_hand(document: Part) -> bool | None:
    stated = (document.get("parameters") or document).get("calibration_type", "eye_on_hand")
    return None if stated is None else _EYES.get(stated.text.lower())


_ROBOT, _MARKER = (
    re.compile(rf"(?:^|[^a-z])(?:{words})", re.IGNORECASE)
    for words in (
        "rob|arm|flange|gripper|hand|tool|tcp|eef?|end.?eff|effector|base|rpe|fpe",
        "marker|target|tag|board|object|pattern|track|camera|cam|optical|aruco|april|charuco|chess"
        "|cpo",
    )
)
_SIDES = (_ROBOT, _MARKER)
_COLUMN = re.compile(
    r"(?:(.*?)[^a-z0-9]+)?(?:(?:t|q|r|w|rot|quat|pos)[^a-z0-9]*)?[xyzw]", re.IGNORECASE
)
"""Whose pose a column is of."""
_NUMBERED = re.compile(r"(.*?)[^a-z0-9]*([0-9]+)", re.IGNORECASE)
_SIX = (6, 7)
"""Columns of a pose."""


def hand_eye_samples(paths: Sequence[Path]) -> list[Samples]:
    """What files of hand-eye samples may mean, none of others: one file of easy_handeye, or two
    tables of poses, of which the name of one is that of a robot, or of the other of a marker. Both
    may also stand in one table, or every pose in a separate file."""
    tables, samples, stated = [], [], []
    alone: dict[str, dict[str, Array]] = {}
    for path in paths:
        try:
            if path.suffix.lower() in TABLES:
                tables += _side_by_side(path) or [read_places(path)]
                continue
            document, numbered = read_document(path), _NUMBERED.fullmatch(path.stem)
            if numbered and is_transform(document):
                alone.setdefault(numbered[1], {})[numbered[2]] = transform(document)
                continue
            stated.append(_on_hand(document))
            samples.append(read_samples(path))
        except InputError:
            continue
    if len(samples) == 1:
        where = {one for one in stated if one is not None}
        return [replace(samples[0], on_hand=where.pop() if len(where) == 1 else None)]
    tables += [PlaceTable(tuple(T), np.array([*T.values()]), name) for name, T in alone.items()]
    if len(tables) != 2:
        return []
    tables.sort(key=lambda one: bool(_MARKER.search(one.file)) - bool(_ROBOT.search(one.file)))
    robot, marker = tables
    named = _ROBOT.search(robot.file) or _MARKER.search(marker.file)
    at = {name: i for i, name in enumerate(marker.name)}
    rows = [i for i, name in enumerate(robot.name) if name in at]
    if not named or not rows:
        return []
    others = [at[robot.name[i]] for i in rows]
    return [
        Samples(A[rows], C[others], f"{robot.file} and {marker.file}", None, (way, other))
        for way, A in (robot.ways or {"": robot.T}).items()
        for other, C in (marker.ways or {"": marker.T}).items()
    ]


def _side_by_side(path: Path) -> list[PlaceTable]:
    """The two poses of each row of a table, none where its columns are of one pose or of more."""
    source = sources_of(path, 0)[0]
    groups: dict[str, list[Field]] = {}
    for field_ in source.fields:
        if field_.heading and (whose := _COLUMN.fullmatch(field_.stem)):
            stem = field_.stem.removeprefix(whose[1] or "").lstrip("_ .-")
            alone = replace(field_, heading=replace(field_.heading, stem=stem))
            groups.setdefault(whose[1] or "", []).append(alone)
    both = {name: some for name, some in groups.items() if len(some) in _SIX}
    if len(both) != 2:
        return []
    tables = [_of_source(replace(source, fields=tuple(some)), path) for some in both.values()]
    return [replace(one, file=name or path.stem) for name, one in zip(both, tables, strict=True)]
