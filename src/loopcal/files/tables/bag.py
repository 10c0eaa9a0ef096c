"""ROS bags as recordings: joint states and what measures a point or a pose, by header stamps.

Images and all other topics are never deserialised.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from loopcal.errors import InputError, listed, unknown_name
from loopcal.files.tables.isolated import files_of, from_child
from loopcal.files.tables.parquet import sha256_of_all
from loopcal.files.tables.raw import existing_file, sha256_of
from loopcal.files.tables.reader import RECOGNISED, Layout, Reader
from loopcal.files.tables.recording import Recording, Series, packed, unpacked
from loopcal.files.tables.table import Table, positions_of

_TABLES = frozenset((".csv", ".tsv", ".txt", ".xlsx", ".parquet", ".mat", ".json"))
_JOINTS = "sensor_msgs/msg/JointState"
_AXES = ("x [m]", "y [m]", "z [m]", "qw", "qx", "qy", "qz")


def _point(p: Any) -> tuple[float, ...]:
    return (p.x, p.y, p.z)


def _pose(p: Any, q: Any) -> tuple[float, ...]:
    return (*_point(p), q.w, q.x, q.y, q.z)


_MEASURED: Mapping[str, Callable[[Any], tuple[float, ...]]] = {
    "geometry_msgs/msg/PointStamped": lambda m: _point(m.point),
    "geometry_msgs/msg/PoseStamped": lambda m: _pose(m.pose.position, m.pose.orientation),
    "geometry_msgs/msg/TransformStamped": lambda m: _pose(
        m.transform.translation, m.transform.rotation
    ),
}


@dataclass(eq=False)
class _Stamped:
    """Readings of one joint or topic: stamps [ns], and so many numbers for each; of a topic also
    how much later each was received [ns]."""

    width: int
    stamps: array[int] = field(default_factory=lambda: array("q"))
    numbers: array[float] = field(default_factory=lambda: array("d"))
    later: array[int] = field(default_factory=lambda: array("q"))

    def add(self, stamp: Any, numbers: Collection[float], received: int) -> None:
        at = 10**9 * stamp.sec + stamp.nanosec
        self.stamps.append(at)
        self.numbers.extend(numbers)
        self.later.append(received - at)

    def series(self, begin: int, names: tuple[str, ...]) -> Series:
        # Zero stamps stay zero: they are refused.
        times = 1e-9 * (np.array(self.stamps) - begin) if any(self.stamps) else np.zeros(1)
        return Series(times, np.array(self.numbers).reshape(-1, self.width), names)


def read_bag(path: str | Path, topic: str | None = None) -> Recording:
    """What a ROS bag (ROS 1, or ROS 2 in MCAP or sqlite3) holds of joints, points and poses.

    topic: the only measuring topic to be read. The bag is read in a child process of limited time
    and memory; images and other topics are never deserialised. The recording can be given to
    `init` and `calibrate` as readings: a row for each pose at which the robot stands.

    Raises InputError for a bag that cannot be read, without joint states, without a stand, and
    with stamps that are zero or do not rise; without rosbags it names the command that installs it.
    """
    path = Path(path)
    path = path if path.is_dir() else existing_file(path)
    if path.suffix.lower() in _TABLES:
        raise InputError(
            "this is a table, and no ROS bag",
            code="wrong-file-type",
            place=path.name,
            remedy="read it with lc.read_dataset, or give it to lc.calibrate and lc.init as it is",
        )
    arguments = {"path": str(path.absolute()), "topic": topic}
    return unpacked(from_child(f"{__name__}:_packed_bag", arguments, path, "ROS bag"))


def _packed_bag(path: str, topic: str | None) -> bytes:
    """In the child."""
    return packed(_recording(Path(path), topic))


def read_standing(
    path: str | Path,
    layout: Layout = RECOGNISED,
    *,
    wanted: Collection[str | int] | None = None,
) -> Table:
    """Joints by their names, then x, y, z [m] and qw ... qz of each measuring topic.

    The layout may state the only topic to be read. Where there are several, the name precedes the
    columns. A stand in which a topic is silent has NaN there. Raises InputError as `read_bag`.
    """
    path = Path(path)
    columns = _recording(path, layout.topic).table
    names = tuple(columns)
    positions = positions_of(wanted, names, path.name)
    return Table(
        path.name,
        None,
        sha256_of_all([sha256_of(one) for one in files_of(path)]),
        names,
        {i: columns[names[i]] for i in positions},
        np.arange(1, len(columns[names[0]]) + 1, dtype=np.int64),
    )


def _recording(path: Path, topic: str | None) -> Recording:
    joints: dict[tuple[str, int], _Stamped] = {}
    measured: dict[str, _Stamped] = {}
    with _opened(path) as bag:
        topics = {c.topic: c.msgtype for c in bag.connections}
        measuring = [name for name, kind in topics.items() if kind in _MEASURED]
        if topic is not None and topic not in measuring:
            raise unknown_name(
                f"no topic {topic!r} measures a point or a pose", topic, measuring, path.name
            )
        read = [
            c
            for c in bag.connections
            if c.msgtype == _JOINTS or (c.msgtype in _MEASURED and topic in (None, c.topic))
        ]
        # without any connection stated rosbags reads them all
        for connection, received, raw in bag.messages(connections=read) if read else ():
            message = bag.deserialize(raw, connection.msgtype)
            stamp = message.header.stamp
            if connection.msgtype == _JOINTS:
                for name, value in zip(message.name, message.position, strict=False):
                    one = joints.setdefault((name, connection.id), _Stamped(1))
                    one.add(stamp, (value,), received)
            else:
                numbers = _MEASURED[connection.msgtype](message)
                one = measured.setdefault(connection.topic, _Stamped(len(numbers)))
                one.add(stamp, numbers, received)
    if not joints:
        few = [f"{name} ({kind})" for name, kind in topics.items()]
        raise InputError(
            f"no topic has joint states ({_JOINTS}); there are {listed(few, 10)}",
            code="missing-column",
            place=path.name,
            remedy="record the joint states too: ros2 bag record /joint_states ...",
        )
    begin = min(one.stamps[0] for one in joints.values())
    used = {c.topic for c in read}
    recording = Recording(
        _by_joint({key: one.series(begin, (key[0],)) for key, one in joints.items()}),
        {
            name: one.series(begin, _axes_of(name, one.width, len(measured) == 1))
            for name, one in measured.items()
        },
        {name: kind for name, kind in topics.items() if name not in used},
        {name: 1e-9 * float(np.median(one.later)) for name, one in measured.items()},
    )
    recording.refuse_unusable(path.name)
    return recording


def _by_joint(published: Mapping[tuple[str, int], Series]) -> dict[str, Series]:
    """By name; of a joint that several publish, the publisher that did most often."""
    best: dict[str, Series] = {}
    for (name, _), one in published.items():
        if name not in best or len(one.times) > len(best[name].times):
            best[name] = one
    return best


def _axes_of(topic: str, width: int, alone: bool) -> tuple[str, ...]:
    head = "" if alone else topic.strip("/").replace("/", "_") + "_"
    return tuple(f"{head}{axis}" for axis in _AXES[:width])


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """A bag of ROS 1 or ROS 2; rosbags knows the types that it does not state itself."""
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise InputError(
            "ROS bags are read by rosbags, which is not installed",
            code="missing-dependency",
            place=path.name,
            remedy="pip install 'loopcal[bags]'",
        ).then("pip install 'loopcal[bags]'") from None
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as bag:
        yield bag


READER = Reader(
    "ROS bag",
    "joint states and measured points or poses of ROS 1 or ROS 2 (MCAP, sqlite3), a row for each "
    "pose at which the robot stands; needs `pip install 'loopcal[bags]'`",
    (".bag", ".mcap", ".db3"),
    read_standing,
    ("topic",),
    part="topic",
    in_folder="metadata.yaml",
)
