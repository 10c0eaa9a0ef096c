"""Calibrated tools and instruments as static transforms of ROS 2.

static_transform_publisher of tf2_ros takes x, y, z in m and the unit quaternion of the child frame
in its parent, as `--frame-id PARENT --child-frame-id CHILD`.
"""

from __future__ import annotations

import re
from xml.sax.saxutils import quoteattr

from loopcal.companions.robot.exports.cameras import eyes_of
from loopcal.companions.robot.exports.format import ExportFiles, ExportOptions, Format
from loopcal.companions.robot.exports.urdf import decimal
from loopcal.document.exported import Exported, Placed
from loopcal.errors import listed
from loopcal.mechanisms.rest import quaternion

_PARENTS = ("base", "flange")


def tf(exported: Exported, options: ExportOptions) -> ExportFiles:
    """static_transforms.launch.xml: what stands in the base or is mounted on the flange."""
    cameras = {n: eye for n, eye in eyes_of(exported).items() if eye[1] is not None}
    named = {word for name in cameras for word in (name, f"{name} in base")}
    frames = [
        placed
        for placed in exported.frames
        if placed.model == "geometry" and placed.seen_in in _PARENTS and placed.name not in named
    ]
    frames += [
        Placed(f"{n}_optical_frame", "flange" if on_hand else "base", T, True, "geometry")
        for n, (on_hand, T) in cameras.items()
        if T is not None
    ]
    lines = ["<launch>", *map(_node, frames), "</launch>", ""]
    points = [placed.name for placed in frames if not placed.turned]
    words = ["The transforms name the frames base and flange. Rename them to links of your robot."]
    if points:
        words.append(f"The orientation was not measured, and is the parent's: {listed(points)}.")
    return ExportFiles({"static_transforms.launch.xml": "\n".join(lines)}, tuple(words))


def _node(placed: Placed) -> str:
    w, x, y, z = quaternion(placed.T[:3, :3])
    numbers = zip(
        ("x", "y", "z", "qx", "qy", "qz", "qw"),
        (*placed.T[:3, 3].tolist(), x, y, z, w),
        strict=True,
    )
    child = re.sub(r"\W+", "_", placed.name)
    arguments = [f"--{name} {decimal(value)}" for name, value in numbers]
    arguments += [f"--frame-id {placed.seen_in}", f"--child-frame-id {child}"]
    return (
        '  <node pkg="tf2_ros" exec="static_transform_publisher" '
        f"args={quoteattr(' '.join(arguments))}/>"
    )


FORMATS = (
    Format(
        "tf",
        "tool and instrument as static transforms (ROS 2 launch file)",
        "ROS 2 with a tracker or camera that has to know where it stands",
        "include the launch file; name your links in place of `base` and `flange`",
        tf,
        "places",
    ),
)
