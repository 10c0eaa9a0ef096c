"""ROS bags as a table: a row for each pose at which the robot stands still.

Read are joint states and what measures a point or a pose, by the stamps in their headers; images
and all other topics are never deserialised. A row holds the medians of the readings taken while
the robot stands: a tracker or camera that is late by some 10 ms then does no harm.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError, listed, unknown_name
from loopcal.files.tables.isolated import files_of
from loopcal.files.tables.parquet import sha256_of_all
from loopcal.files.tables.raw import sha256_of
from loopcal.files.tables.reader import RECOGNISED, Layout, Reader
from loopcal.files.tables.table import Table, positions_of

Array = NDArray[np.float64]
STILL = 0.4
"""[s] for which a robot has to stand, and so long is a window."""
_MARGIN = 0.1
"""[s] at both ends of a stand in which nothing is measured: delays of instruments are shorter."""
_SPREAD = 8.0
"""Sds that readings of a joint at rest span at most: of 400 normal readings 5.9 are expected."""
_SHARE = 0.2
"""Of its time a robot stands at least, so that this share of its smallest steps is noise."""
# A fifth of |z| lies below Phi^-1(0.6) = 0.2533, z standard normal.
_STEP = 0.358
"""[sd] that quantile of |a - b| of two normal readings: sqrt(2) * 0.2533."""
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
class _Series:
    """Readings of one joint or topic: stamps [ns], and so many numbers for each."""

    width: int
    stamps: array[int] = field(default_factory=lambda: array("q"))
    numbers: array[float] = field(default_factory=lambda: array("d"))

    def add(self, stamp: Any, numbers: Collection[float]) -> None:
        self.stamps.append(10**9 * stamp.sec + stamp.nanosec)
        self.numbers.extend(numbers)

    def seconds(self, begin: int) -> Array:
        """(N,) since a stamp."""
        return 1e-9 * (np.array(self.stamps) - begin)

    @property
    def values(self) -> Array:
        """(N, width)"""
        return np.array(self.numbers).reshape(-1, self.width)


def read_bag(
    path: str | Path,
    layout: Layout = RECOGNISED,
    *,
    wanted: Collection[str | int] | None = None,
) -> Table:
    """Joints by their names, then x, y, z [m] and qw ... qz of each measuring topic.

    The layout may state the only topic to be read. Where there are several, the name precedes the
    columns. A stand in which a topic is silent has NaN there. Raises InputError for a bag that
    cannot be read, without joint states, without a stand, and with stamps that do not rise.
    """
    path = Path(path)
    joints, measured = _series(path, layout.topic)
    for name, series in (*joints.items(), *measured.items()):
        steps = np.diff(series.stamps)
        if not any(series.stamps) or (steps < 0).any():
            raise InputError(
                f"the stamps of {name!r} are zero or do not rise",
                code="invalid-value",
                place=path.name,
                remedy="record messages with header.stamp set by one clock, in order",
            )
    begin = min(series.stamps[0] for series in joints.values())
    stands = _stands({name: (s.seconds(begin), s.values[:, 0]) for name, s in joints.items()})
    if not len(stands):
        raise InputError(
            f"the robot never stands still for {STILL:g} s",
            code="no-data",
            place=path.name,
            remedy="hold each pose for at least 1 s while recording",
        )
    columns = {"time [s]": stands[:, 0]}
    for name, series in joints.items():
        columns[name] = _medians(series, begin, stands)[:, 0]
    for name, series in measured.items():
        head = "" if len(measured) == 1 else name.strip("/").replace("/", "_") + "_"
        medians = _medians(series, begin, stands + np.array([_MARGIN, -_MARGIN]))
        columns |= {f"{head}{axis}": medians[:, i] for i, axis in enumerate(_AXES[: series.width])}
    names = tuple(columns)
    positions = positions_of(wanted, names, path.name)
    return Table(
        path.name,
        None,
        sha256_of_all([sha256_of(one) for one in files_of(path)]),
        names,
        {i: columns[names[i]] for i in positions},
        np.arange(1, len(stands) + 1, dtype=np.int64),
    )


def _series(path: Path, topic: str | None) -> tuple[dict[str, _Series], dict[str, _Series]]:
    """The series of joints by name, and of measuring topics."""
    joints: dict[str, _Series] = {}
    measured: dict[str, _Series] = {}
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
        for connection, _, raw in bag.messages(connections=read) if read else ():
            message = bag.deserialize(raw, connection.msgtype)
            stamp = message.header.stamp
            if connection.msgtype == _JOINTS:
                for name, value in zip(message.name, message.position, strict=False):
                    joints.setdefault(name, _Series(1)).add(stamp, (value,))
            else:
                numbers = _MEASURED[connection.msgtype](message)
                measured.setdefault(connection.topic, _Series(len(numbers))).add(stamp, numbers)
    if not joints:
        few = [f"{name} ({kind})" for name, kind in topics.items()]
        raise InputError(
            f"no topic has joint states ({_JOINTS}); there are {listed(few, 10)}",
            code="missing-column",
            place=path.name,
            remedy="record the joint states too: ros2 bag record /joint_states ...",
        )
    return joints, measured


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
        ) from None
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as bag:
        yield bag


def _stands(joints: Mapping[str, tuple[Array, Array]]) -> Array:
    """(N, 2) [s] begin and end of each time in which no joint moves; joints: times and readings."""
    grid = max((times for times, _ in joints.values()), key=len)
    still = np.ones(len(grid), dtype=bool)
    for times, readings in joints.values():
        last = np.searchsorted(times, grid, side="right") - 1
        still &= _still(times, readings)[last] & (last >= 0)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(int), [0]])))
    # A window looks back by STILL: the stand begins where the first still window does.
    return np.column_stack([grid[edges[::2]] - STILL, grid[edges[1::2] - 1]])


def _still(times: Array, readings: Array) -> NDArray[np.bool_]:
    """(N,) whether the readings of the window up to each one are alike but for their noise."""
    still = np.zeros(len(times), dtype=bool)
    steps = np.abs(np.diff(readings))
    if not steps.size:
        return still
    count = 1 + int(np.ceil(STILL / max(float(np.median(np.diff(times))), 1e-6)))
    if count > len(times):
        return still
    smallest = steps[steps > 0.0].min(initial=np.inf)
    # Of rounded readings at rest the last digit may change: 1.5 admits one step and no second.
    allowed = max(_SPREAD * float(np.quantile(steps, _SHARE)) / _STEP, 1.5 * smallest)
    windows = np.lib.stride_tricks.sliding_window_view(readings, count)
    still[count - 1 :] = np.ptp(windows, axis=1) <= allowed
    return still


def _medians(series: _Series, begin: int, stands: Array) -> Array:
    """(N, width) medians of the readings within each stand; NaN where there is none."""
    times, values = series.seconds(begin), series.values
    medians = np.full((len(stands), series.width), np.nan)
    for i, (first, last) in enumerate(np.searchsorted(times, stands)):
        inside = values[first:last].copy()
        if len(inside):
            if series.width == len(_AXES):  # q and -q are one orientation
                inside[:, 3:] *= np.where(inside[:, 3:] @ inside[0, 3:] < 0.0, -1.0, 1.0)[:, None]
            medians[i] = np.median(inside, axis=0)
    return medians


READER = Reader(
    "ROS bag",
    "joint states and measured points or poses of ROS 1 or ROS 2 (MCAP, sqlite3), a row for each "
    "pose at which the robot stands; needs `pip install 'loopcal[bags]'`",
    (".bag", ".mcap", ".db3"),
    read_bag,
    ("topic",),
    part="topic",
    in_folder="metadata.yaml",
)
