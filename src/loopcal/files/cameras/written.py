"""Cameras and their places as text that other programs read: ROS, Kalibr, OpenCV, easy_handeye.

Numbers are the shortest decimals that read back to the same double.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping

import numpy as np

from loopcal.arrays import Array
from loopcal.errors import InputError
from loopcal.mechanisms.cameras.lens import Intrinsics
from loopcal.mechanisms.rest import quaternion

_ROS = {
    "pinhole": ("plumb_bob", 5),
    "brown5": ("plumb_bob", 5),
    "brown8": ("rational_polynomial", 8),
    "fisheye": ("equidistant", 4),
}
"""Lens -> distortion_model and how many coefficients it has."""


def camera_info(name: str, camera: Intrinsics) -> str:
    """A camera_info file of ROS: camera_calibration_parsers and camera_info_manager load it.

    Raises InputError for a lens that ROS does not know, and where the image size is unknown.
    """
    if camera.lens not in _ROS:
        raise _unwritable(name, camera, "ROS camera_info", "brown8")
    width, height = _image(name, camera)
    model, count = _ROS[camera.lens]
    D = (*camera.distortion, *[0.0] * count)[:count]
    P = [camera.fx, 0.0, camera.cx, 0.0, 0.0, camera.fy, camera.cy, 0.0, 0.0, 0.0, 1.0, 0.0]
    matrices = (
        ("camera_matrix", 3, 3, _K(camera)),
        ("distortion_coefficients", 1, count, D),
        ("rectification_matrix", 3, 3, np.eye(3).ravel().tolist()),
        ("projection_matrix", 3, 4, P),
    )
    lines = [f"image_width: {width}", f"image_height: {height}", f"camera_name: {_text(name)}"]
    for key, rows, columns, data in matrices:
        lines += [f"{key}:", f"  rows: {rows}", f"  cols: {columns}", f"  data: {_list(data)}"]
        if key == "camera_matrix":
            lines.append(f"distortion_model: {model}")
    return "\n".join([*lines, ""])


def camchain(cameras: Mapping[str, Intrinsics], T_camera_first: Mapping[str, Array]) -> str:
    """A camchain of Kalibr: cam0, cam1, ... in this order, each in the place of the one before.

    Raises InputError for a lens that Kalibr does not know, and where the image size is unknown.
    """
    lines: list[str] = []
    before: Array | None = None
    for number, (name, camera) in enumerate(cameras.items()):
        D = camera.distortion
        if camera.lens in ("brown8", "brown12") or (camera.lens == "brown5" and D[4]):
            raise _unwritable(name, camera, "a camchain of Kalibr", "brown5 with k3 held at 0")
        model = {"pinhole": "none", "fisheye": "equidistant"}.get(camera.lens, "radtan")
        lines.append(f"cam{number}:")
        T = T_camera_first.get(name)
        if number and T is not None and before is not None:
            rows = (T @ np.linalg.inv(before)).tolist()
            lines += ["  T_cn_cnm1:", *(f"  - {_list(row)}" for row in rows)]
        before = T
        lines += [
            "  camera_model: pinhole",
            f"  intrinsics: {_list((camera.fx, camera.fy, camera.cx, camera.cy))}",
            f"  distortion_model: {model}",
            f"  distortion_coeffs: {_list(D[:4])}",
            f"  resolution: [ {', '.join(map(str, _image(name, camera)))} ]",
            f"  rostopic: {_text(f'/{name}/image_raw')}",
        ]
    return "\n".join([*lines, ""])


def opencv_storage(camera: Intrinsics) -> str:
    """A camera as cv::FileStorage writes it, with the names of OpenCV's own calibration program."""
    D = camera.distortion or (0.0,) * 5
    width, height = camera.image or (0, 0)
    size = [f"image_width: {width}", f"image_height: {height}"] if camera.image else []
    lines = ["%YAML:1.0", "---", *size]
    if camera.lens == "fisheye":
        lines.append("fisheye_model: 1")
    for key, rows, columns, data in (
        ("camera_matrix", 3, 3, _K(camera)),
        ("distortion_coefficients", len(D), 1, D),
    ):
        lines += [f"{key}: !!opencv-matrix", f"   rows: {rows}", f"   cols: {columns}"]
        lines += ["   dt: d", f"   data: {_list(data)}"]
    return "\n".join([*lines, ""])


def easy_handeye(name: str, T: Array, *, on_hand: bool, frames: Mapping[str, str]) -> str:
    """A calibration as easy_handeye 1 keeps it; T: place (4, 4) [m] of the camera.

    frames: robot_base_frame, robot_effector_frame, tracking_base_frame, tracking_marker_frame as
    the robot names them. T is in the effector's frame on the hand, else in the base's.
    """
    usual = {
        "robot_base_frame": "base_link",
        "robot_effector_frame": "tool0",
        "tracking_base_frame": f"{name}_optical_frame",
        "tracking_marker_frame": "board",
    }
    lines = ["parameters:", f"  eye_on_hand: {str(on_hand).lower()}"]
    lines += [f"  {key}: {_text(frames.get(key, word))}" for key, word in usual.items()]
    lines += ["  freehand_robot_movement: true", f"  namespace: {_text(f'/{name}/')}"]
    lines += ["transformation:", *(f"  {key}: {_number(value)}" for key, value in _place(T))]
    return "\n".join([*lines, ""])


def _place(T: Array) -> list[tuple[str, float]]:
    w, x, y, z = quaternion(T[:3, :3])
    keys = ("x", "y", "z", "qx", "qy", "qz", "qw")
    return list(zip(keys, (*T[:3, 3].tolist(), x, y, z, w), strict=True))


def _K(camera: Intrinsics) -> list[float]:
    return [camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0]


def _image(name: str, camera: Intrinsics) -> tuple[int, int]:
    if camera.image is None:
        raise InputError(
            f"the image size of the camera {name!r} is not known",
            code="missing-key",
            remedy="name a file that states it, as the camera_info of before: --source FILE",
        )
    return camera.image


def _unwritable(name: str, camera: Intrinsics, what: str, other: str) -> InputError:
    return InputError(
        f"{what} has no lens {camera.lens!r}, which the camera {name!r} has; it would take {other}",
        code="unsupported",
        remedy=f"calibrate the camera as {other}",
    )


def _list(values: Iterable[float]) -> str:
    return "[ " + ", ".join(_number(value) for value in values) + " ]"


def _number(value: float) -> str:
    if not math.isfinite(value):
        raise InputError("a number to be written is not finite", code="invalid-number")
    # YAML 1.1 takes 1e-05 for a text, and OpenCV reads 1.0e-05 as a number too.
    text = repr(float(value) + 0.0)
    mantissa, mark, exponent = text.partition("e")
    if mark and "." not in mantissa:
        mantissa += ".0"
    if mark and exponent[0] not in "+-":
        exponent = f"+{exponent}"
    return f"{mantissa}{mark}{exponent}"


def _text(word: str) -> str:
    """A name as YAML reads it back: quoted as JSON, which YAML contains."""
    return json.dumps(word, ensure_ascii=False)
