"""Calibrated cameras for ROS, Kalibr, OpenCV and easy_handeye, and their frames in a URDF."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from loopcal.arrays import Array
from loopcal.companions.robot.exports.format import ExportFiles, ExportOptions, Format
from loopcal.document.exported import Exported
from loopcal.errors import InputError, listed
from loopcal.files.cameras import written
from loopcal.files.cameras.intrinsics import read_intrinsics
from loopcal.files.machines.urdf import UrdfRobot
from loopcal.mechanisms.cameras.lens import FRAME, LENSES, Intrinsics
from loopcal.mechanisms.chain import product
from loopcal.mechanisms.origins import CalibratedOrigin
from loopcal.mechanisms.placement import inverse
from loopcal.mechanisms.station import Station


@dataclass(frozen=True, eq=False)
class Camera:
    """on_hand: whether it is mounted on the flange; T: its place (4, 4) in the flange's frame, or
    in the base's; None where the result does not hold it."""

    intrinsics: Intrinsics
    on_hand: bool
    T: Array | None


def cameras_of(exported: Exported, source: Path | None = None) -> dict[str, Camera]:
    """The cameras of a machine by name, none of others; source: a file with their images' sizes."""
    stated = {} if source is None else read_intrinsics(source)
    owners = dict.fromkeys(p.owner for p in exported.parameters if p.role == "lens")
    roles = {p.name: p.role for p in exported.parameters}
    cameras = {}
    for name in owners:
        keys = {p.name.removeprefix(f"{name}_") for p in exported.parameters if p.owner == name}
        # The largest lens whose coefficients are all there; a fisheye has no p1.
        lens = max(
            (one for one, coefficients in LENSES.items() if {*coefficients} <= keys),
            key=lambda one: len(LENSES[one]),
        )
        values = {key: exported.values[f"{name}_{key}"] for key in (*FRAME, *LENSES[lens])}
        sizes = [stated[name]] if name in stated else list(stated.values())
        image = sizes[0].image if len(sizes) == 1 else exported.images.get(name)
        steps, on_hand = Station(name).steps, roles.get(f"{name}_x") == "mounting"
        T = None
        if all(step.parameter in exported.values for step in steps):
            T = product(steps, {}, exported.values)
            T = T if on_hand else inverse(T)
        cameras[name] = Camera(Intrinsics.of(lens, values, image), on_hand, T)
    return cameras


def eyes_of(exported: Exported) -> dict[str, tuple[bool, Array | None]]:
    """What sees boards or markers by name: whether it is on the flange, and its place."""
    return {n: (c.on_hand, c.T) for n, c in cameras_of(exported).items()} | {**exported.eyes}


def camera_info(exported: Exported, options: ExportOptions) -> ExportFiles:
    """NAME.yaml for each camera, as camera_info_manager loads it."""
    return _each(exported, options, "{}.yaml", written.camera_info)


def opencv(exported: Exported, options: ExportOptions) -> ExportFiles:
    """NAME_opencv.yaml for each camera, as cv::FileStorage reads it."""
    return _each(exported, options, "{}_opencv.yaml", lambda _, one: written.opencv_storage(one))


def camchain(exported: Exported, options: ExportOptions) -> ExportFiles:
    """camchain.yaml with all cameras; places only where one thing carries all of them."""
    cameras = cameras_of(exported, options.source)
    together = len({one.on_hand for one in cameras.values()}) == 1
    places = {n: inverse(c.T) for n, c in cameras.items() if together and c.T is not None}
    text = written.camchain({name: one.intrinsics for name, one in cameras.items()}, places)
    return ExportFiles({"camchain.yaml": text})


def easy_handeye(exported: Exported, options: ExportOptions) -> ExportFiles:
    """NAME_eye_on_hand.yaml or NAME_eye_on_base.yaml for each camera."""
    files = {}
    for name, (on_hand, T) in eyes_of(exported).items():
        if T is None:
            raise InputError(
                f"the place of the camera {name!r} is not in the result", code="unsupported"
            )
        where = "hand" if on_hand else "base"
        files[f"{name}_eye_on_{where}.yaml"] = written.easy_handeye(
            name, T, on_hand=on_hand, frames={}
        )
    words = "The frames are named base_link, tool0 and NAME_optical_frame. Rename them to yours."
    return ExportFiles(files, (words,))


def _each(
    exported: Exported,
    options: ExportOptions,
    file: str,
    text: Callable[[str, Intrinsics], str],
) -> ExportFiles:
    cameras = cameras_of(exported, options.source)
    return ExportFiles({file.format(n): text(n, one.intrinsics) for n, one in cameras.items()})


_SIZES = "a file with the sizes of the images, as the camera_info that was there before"
FORMATS = (
    Format(
        "camera_info",
        "camera matrix and distortion (camera_info YAML)",
        "ROS camera drivers and image_proc",
        "name the file in `camera_info_url` of the driver",
        camera_info,
        "cameras",
        _SIZES,
        optional=True,
    ),
    Format(
        "opencv",
        "camera matrix and distortion (cv::FileStorage YAML)",
        "programs with OpenCV",
        "read `camera_matrix` and `distortion_coefficients`",
        opencv,
        "cameras",
        _SIZES,
        optional=True,
    ),
    Format(
        "camchain",
        "cameras and their places beside each other (Kalibr camchain)",
        "Kalibr, visual-inertial odometry",
        "name the file as the camera chain",
        camchain,
        "cameras",
        _SIZES,
        optional=True,
    ),
    Format(
        "easy_handeye",
        "hand-eye calibration as easy_handeye keeps it",
        "ROS with easy_handeye's publisher",
        "put the file where easy_handeye looks for calibrations, and rename its frames",
        easy_handeye,
        "eyes",
    ),
)


# The optical frame of a camera in a URDF hangs by fixed joints on a link of the robot. The first of
# these joints takes up the calibrated place; what a driver defines behind it stays.


@dataclass(frozen=True)
class CameraOrigins:
    """origins: of the joints that cameras hang on; warnings: of cameras that the URDF lacks."""

    origins: tuple[CalibratedOrigin, ...] = ()
    warnings: tuple[str, ...] = ()


def camera_origins(robot: UrdfRobot, exported: Exported) -> CameraOrigins:
    """The joints of a URDF that carry cameras, with their calibrated origins.

    The frame of a camera is the link NAME_optical_frame, or the only one that ends so.
    """
    cameras = cameras_of(exported)
    if not cameras:
        return CameraOrigins()
    joints, links = robot.joints, [*robot.above]
    if not exported.origins or exported.origins[0].joint.name not in joints:
        return CameraOrigins()
    base = robot.link(joints[exported.origins[0].joint.name], "parent")
    tip = robot.link(joints[exported.origins[-1].joint.name], "child")
    calibrated = {one.joint.name for one in exported.origins}
    origins, warnings = [], []
    for name, one in cameras.items():
        if one.T is None:
            continue
        frame = _optical(links, name, alone=len(cameras) == 1)
        if frame is None:
            warnings.append(
                f"The URDF has no link {name + '_optical_frame'!r}: the place of the camera "
                f"{name!r} is not in it. Links: {listed(links)}."
            )
            continue
        carried = _hung(robot, frame, tip if one.on_hand else base, one.T, calibrated)
        if carried is None:
            warnings.append(
                f"The link {frame!r} does not hang by fixed joints on what carries the camera "
                f"{name!r}: its place is not in the URDF."
            )
        else:
            origins.append(carried)
    return CameraOrigins(tuple(origins), tuple(warnings))


def _optical(links: Collection[str], name: str, *, alone: bool) -> str | None:
    """The link that is a camera's frame; None where none is, or several may be."""
    stated = [link for link in (f"{name}_optical_frame", name) if link in links]
    usual = [link for link in links if link.endswith("optical_frame")]
    if stated or not (alone and len(usual) == 1):
        return next(iter(stated), None)
    return usual[0]


def _hung(
    robot: UrdfRobot, frame: str, holder: str, T_holder_camera: Array, calibrated: Collection[str]
) -> CalibratedOrigin | None:
    """The origin of the first fixed joint from what carries a camera to its frame; None where
    a moving or a calibrated joint is between."""
    carried = {holder: np.eye(4)}
    link = holder
    for joint, parent in _above(robot, holder, calibrated):
        carried[parent] = joint.drawn @ carried[link]
        link = parent
    T_link_frame = np.eye(4)
    for joint, parent in _above(robot, frame, calibrated):
        if parent in carried:
            T = carried[parent] @ T_holder_camera @ inverse(T_link_frame)
            return replace(joint, T=T)
        T_link_frame = joint.drawn @ T_link_frame
    return None


def _above(
    robot: UrdfRobot, link: str, calibrated: Collection[str]
) -> Iterator[tuple[CalibratedOrigin, str]]:
    """The fixed joints above a link, each as drawn with its parent link."""
    met: set[str] = set()
    while link in robot.above and link not in met:
        met.add(link)
        element = robot.above[link][-1]
        if element.get("type") != "fixed" or element.get("name") in calibrated:
            return
        joint, link = robot.joint(element), robot.link(element, "parent")
        yield CalibratedOrigin(joint, np.eye(4), joint.axis), link
