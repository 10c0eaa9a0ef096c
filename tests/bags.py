"""ROS bags for tests, written by rosbags: a robot that goes from pose to pose and waits there."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
CONTAINERS = ("bag", "mcap", "sqlite3")
HOLD, MOVE, RATE, TRACKER_RATE = 1.0, 0.5, 100, 25
"""[s] at each pose and between two, [1/s] messages of joints and of the instrument."""

# A header, its frame, 1 by 10^9 pixels of one byte, and then no pixel.
IMAGE = b"\x00\x01\x00\x00" + bytes(8) + b"\x01\x00\x00\x00\x00" + bytes(3)
IMAGE += (1).to_bytes(4, "little") + (10**9).to_bytes(4, "little") + b"\x06\x00\x00\x00mono8\x00"
IMAGE += bytes(2) + (10**9).to_bytes(4, "little") + (10**9).to_bytes(4, "little")


def times(count: int, rate: float) -> Array:
    """(N,) stamps [s] of a recording of so many poses."""
    return np.arange(0.0, count * (HOLD + MOVE), 1.0 / rate)


def motion(poses: Array, t: Array) -> Array:
    """(N, n) values of the poses (P, n) at times t: each is held, then blended into the next."""
    pose = np.clip((t / (HOLD + MOVE)).astype(int), 0, len(poses) - 1)
    share = np.clip((t - pose * (HOLD + MOVE) - HOLD) / MOVE, 0.0, 1.0)
    blend = (share**2 * (3.0 - 2.0 * share))[:, None]
    following = poses[np.minimum(pose + 1, len(poses) - 1)]
    return np.asarray((1.0 - blend) * poses[pose] + blend * following)


def write_bag(
    folder: Path,
    container: str,
    joints: Mapping[str, Array],
    points: Mapping[str, Array | Callable[[Array], Array]],
    *,
    noise: float = 0.0,
    delay: float = 0.0,
    publishers: int = 1,
    stamped: bool = True,
    seed: int = 0,
) -> Path:
    """A bag of joints (P,) and of points (P, 3) by topic, readings at rest with this noise.

    points: of each pose, or what makes them of joints (N, n): then they move as the robot does.

    delay: [s] by which the points are late; publishers: of joints, each of some. A camera
    topic declares an image of 1 GB that is not there: reading it would fail. stamped: False leaves
    all header stamps at zero.
    """
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2
    from rosbags.typesys import Stores, get_typestore

    first = container == "bag"
    store = get_typestore(Stores.ROS1_NOETIC if first else Stores.ROS2_JAZZY)
    types = store.types
    path = folder / f"calib.{container}" if first else folder / f"calib-{container}"
    plugin = StoragePlugin.MCAP if container == "mcap" else StoragePlugin.SQLITE3
    rng = np.random.default_rng(seed)

    def header(at: float) -> Any:
        ns = round(1e9 * (1000.0 + at)) if stamped else 0
        stamp = types["builtin_interfaces/msg/Time"](*divmod(ns, 10**9))
        sequence = (0,) if first else ()
        return types["std_msgs/msg/Header"](*sequence, stamp, "base")

    messages: list[tuple[float, str, str, Any]] = []
    poses = np.column_stack([*joints.values()]) if joints else np.zeros((1, 0))
    t = times(len(poses), RATE)
    readings = motion(poses, t) + noise * rng.normal(size=(len(t), len(joints)))
    for number in range(publishers if joints else 0):
        some = slice(number, None, publishers)
        topic = "/joint_states" if not number else f"/joints_{number}"
        for at, q in zip(t, readings[:, some].copy(), strict=True):
            body = ([*joints][some], q, np.zeros(0), np.zeros(0))
            state = types["sensor_msgs/msg/JointState"](header(at), *body)
            messages.append((at, topic, "sensor_msgs/msg/JointState", state))
    for topic, xyz in points.items():
        t = times(len(poses), TRACKER_RATE)
        if callable(xyz):
            exact = xyz(motion(poses, t - delay))
        else:
            exact = motion(xyz, t - delay)
        measured = exact + noise * rng.normal(size=(len(t), 3))
        for at, p in zip(t, measured, strict=True):
            point = types["geometry_msgs/msg/Point"](*p)
            message = types["geometry_msgs/msg/PointStamped"](header(at), point)
            messages.append((at, topic, "geometry_msgs/msg/PointStamped", message))
    with Writer1(path) if first else Writer2(path, version=9, storage_plugin=plugin) as bag:
        image = bag.add_connection("/camera", "sensor_msgs/msg/Image", typestore=store)
        bag.write(image, 1, IMAGE)
        connections: dict[str, Any] = {}
        for at, topic, kind, message in sorted(messages, key=lambda m: m[0]):
            if topic not in connections:
                connections[topic] = bag.add_connection(topic, kind, typestore=store)
            serialize = store.serialize_ros1 if first else store.serialize_cdr
            bag.write(connections[topic], round(1e9 * (2000.0 + at)), serialize(message, kind))
    return path
