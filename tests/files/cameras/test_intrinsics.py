"""Cameras are read from the files of ROS, Kalibr, OpenCV and others, and refused with the place."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from loopcal.files.cameras.intrinsics import read_intrinsics, read_rig
from loopcal.mechanisms.cameras.lens import Intrinsics
from tests.refusals import refused

CAMERA_INFO = """
image_width: 1600
image_height: 1200
camera_name: eye
camera_matrix:
  rows: 3
  cols: 3
  data: [1352.0, 0., 789.7, 0., 1356.5, 627.3, 0., 0., 1.]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.21, 6.e-02, 1.2e-3, -0.0008, -.01]
rectification_matrix: {rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}
"""
EYE = Intrinsics(
    "brown5", 1352.0, 1356.5, 789.7, 627.3, (-0.21, 0.06, 1.2e-3, -8e-4, -0.01), (1600, 1200)
)
MESSAGE = """header: {seq: 0, frame_id: eye}
height: 480
width: 640
distortion_model: equidistant
D: [-0.03, 0.01, -0.004, 0.0006]
K: [380.0, 0.0, 320.5, 0.0, 381.0, 240.5, 0.0, 0.0, 1.0]
---
height: 1
"""
CAMCHAIN = """
cam0:
  camera_model: pinhole
  distortion_coeffs: [-0.2, 0.05, 0.001, -0.002]
  distortion_model: radtan
  intrinsics: [800.0, 801.0, 320.0, 240.0]
  resolution: [640, 480]
  rostopic: /cam0/image_raw
cam1:
  T_cn_cnm1:
  - [1.0, 0.0, 0.0, -0.11]
  - [0.0, 1.0, 0.0, 0.02]
  - [0.0, 0.0, 1.0, 0.0]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: pinhole
  distortion_coeffs: [-0.03, 0.01, -0.004, 0.0006]
  distortion_model: equidistant
  intrinsics: [380.0, 381.0, 320.0, 240.0]
  resolution: [640, 480]
cam2:
  T_cn_cnm1:
  - [0.0, -1.0, 0.0, 0.0]
  - [1.0, 0.0, 0.0, 0.0]
  - [0.0, 0.0, 1.0, 0.3]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: pinhole
  distortion_coeffs: []
  distortion_model: none
  intrinsics: [380.0, 381.0, 320.0, 240.0]
  resolution: [640, 480]
"""
STORAGE = """%YAML:1.0
---
calibration_time: "Sun Nov  1 10:00:00 2026"
image_width: 640
image_height: 480
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 8.0000000000000000e+02, 0., 3.2050000000000000e+02, 0., 801., 240.5, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 8
   cols: 1
   dt: d
   data: [ 0.3, -0.1, 1e-3, 2.e-03, 0.02, 0.5, -0.05, 0.03 ]
"""


def written(folder: Path, text: str, name: str = "camera.yaml") -> Path:
    (folder / name).write_text(text, "utf-8")
    return folder / name


def test_the_lens_of_rectified_images_is_read_beside_that_of_raw_ones(tmp_path: Path) -> None:
    P = "projection_matrix: {data: [1300, 0, 801, 0, 0, 1302, 590, 0, 0, 0, 1, 0]}"
    (tmp_path / "eye.yaml").write_text(CAMERA_INFO + P + "\n", encoding="utf-8")
    (eye,) = read_intrinsics(tmp_path / "eye.yaml").values()
    assert eye.rectified == (1300.0, 1302.0, 801.0, 590.0)
    assert (eye.fx, eye.distortion) == (EYE.fx, EYE.distortion)


@pytest.mark.parametrize("data", ["[]", "[1300, 0, 801]", "[1300, 0, 801, 0, 1302, 590, 0, 0, 1]"])
def test_a_projection_that_is_no_matrix_says_nothing(data: str, tmp_path: Path) -> None:
    text = f"{CAMERA_INFO}projection_matrix: {{data: {data}}}\n"
    assert read_intrinsics(written(tmp_path, text)) == {"eye": EYE}


@pytest.mark.parametrize(
    ("stated", "lens", "coefficients"),
    [
        ("-0.21", "brown5", (-0.21, 0.0, 0.0, 0.0, 0.0)),
        ("-0.21, 0.06", "brown5", (-0.21, 0.06, 0.0, 0.0, 0.0)),
        ("1, 2, 0, 0, 3, 4", "brown8", (1.0, 2.0, 0.0, 0.0, 3.0, 4.0, 0.0, 0.0)),
        ("1, 2, 0, 0, 3, 4, 5", "brown8", (1.0, 2.0, 0.0, 0.0, 3.0, 4.0, 5.0, 0.0)),
        (f"-0.21{', 0' * 19}", "brown12", (-0.21, *[0.0] * 11)),
    ],
)
def test_coefficients_that_are_missing_at_the_end_are_zero(
    stated: str, lens: str, coefficients: tuple[float, ...], tmp_path: Path
) -> None:
    text = CAMERA_INFO.replace("-0.21, 6.e-02, 1.2e-3, -0.0008, -.01", stated)
    eye = read_intrinsics(written(tmp_path, text))["eye"]
    assert (eye.lens, eye.distortion) == (lens, coefficients)


def test_a_camera_that_was_never_calibrated_is_refused(tmp_path: Path) -> None:
    zero = CAMERA_INFO.replace("1352.0, 0., 789.7, 0., 1356.5, 627.3, 0., 0., 1.", "0, " * 8 + "0")
    with refused("invalid-value", "camera.yaml", "never calibrated"):
        read_intrinsics(written(tmp_path, zero))


def test_camera_info_of_ros(tmp_path: Path) -> None:
    assert read_intrinsics(written(tmp_path, CAMERA_INFO)) == {"eye": EYE}


def test_a_message_of_ros_and_what_follows_it(tmp_path: Path) -> None:
    one = read_intrinsics(written(tmp_path, MESSAGE))["camera"]
    assert (one.lens, one.fx, one.cy, one.image) == ("fisheye", 380.0, 240.5, (640, 480))


def test_a_camchain_of_kalibr(tmp_path: Path) -> None:
    rig = read_rig(written(tmp_path, CAMCHAIN))
    assert [one.lens for one in rig.cameras.values()] == ["brown5", "fisheye", "pinhole"]
    assert rig.cameras["cam0"].distortion == (-0.2, 0.05, 0.001, -0.002, 0.0)
    np.testing.assert_allclose(rig.T_camera_first["cam1"][:3, 3], (-0.11, 0.02, 0.0))
    # T_c2_c0 = T_c2_c1 T_c1_c0: turned about z, then 0.3 m on
    np.testing.assert_allclose(rig.T_camera_first["cam2"][:3, 3], (-0.02, -0.11, 0.3))


def test_storage_of_opencv_in_yaml_and_json(tmp_path: Path) -> None:
    one = read_intrinsics(written(tmp_path, STORAGE))["camera"]
    assert (one.lens, one.distortion[7], one.cx) == ("brown8", 0.03, 320.5)
    text = """{"M1": {"type_id": "opencv-matrix", "rows": 3, "cols": 3, "dt": "d",
        "data": [800.0, 0, 320, 0, 801.0, 240, 0, 0, 1]},
        "D1": {"type_id": "opencv-matrix", "rows": 1, "cols": 4, "dt": "d", "data": [1, 2, 3, 4]},
        "M2": [[700, 0, 320], [0, 701, 240], [0, 0, 1]],
        "R": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "T": [-0.1, 0, 0]}"""
    rig = read_rig(written(tmp_path, text, "stereo.json"))
    assert rig.cameras["1"].distortion == (1.0, 2.0, 3.0, 4.0, 0.0)
    assert rig.cameras["2"].lens == "pinhole"
    assert rig.T_camera_first["2"][0, 3] == -0.1


def test_numbers_by_name_and_several_cameras(tmp_path: Path) -> None:
    text = """intrinsics: {fx: 1352.02747, fy: 1356.14287, cx: 789.67065, cy: 627.2995}"""
    assert read_intrinsics(written(tmp_path, text))["intrinsics"].lens == "pinhole"
    numbers = '"fx": 8, "fy": 8, "cx": 4, "cy": 3, "k1": -0.1, "width": 9, "height": 7'
    text = f'{{"cameras": {{"1": {{{numbers}}}}}}}'
    one = read_intrinsics(written(tmp_path, text, "set.json"))["1"]
    assert (one.lens, one.image, one.distortion[0]) == ("brown5", (9, 7), -0.1)


@pytest.mark.parametrize(
    ("old", "new", "code", "stated"),
    [
        ("plumb_bob", "fov", "unsupported", ("distortion_model", "'fov'", "plumb_bob")),
        ("1352.0, 0.,", "1352.0, 2.5,", "unsupported", ("skew of 2.5", "camera_matrix")),
        ("1352.0,", "x,", "invalid-value", ("camera_matrix: data[0]", "'x'")),
        ("1352.0,", "0.0,", "invalid-value", ("focal length",)),
        ("1352.0,", "1.0,", "wrong-shape", ("3 coefficients",)),
        ("-.01]", ".nan]", "invalid-value", ("distortion_coefficients: data[4]",)),
        ("0., 0., 1.]", "0., 1.]", "wrong-shape", ("8 numbers", "9 are expected")),
        ("camera_matrix", "matrix", "missing-key", ("fx, fy, cx, cy",)),
        ("image_height: 1200", "image_height: 12.5", "invalid-value", ("image_height", "12.5")),
        ("camera_name: eye", "image_width: 3", "invalid-syntax", ("line 4", "'image_width'")),
        ("rows: 3", "\trows: 3", "invalid-syntax", ("line 6",)),
    ],
)
def test_faults_are_named_with_file_and_key(
    old: str, new: str, code: str, stated: tuple[str, ...], tmp_path: Path
) -> None:
    text = CAMERA_INFO.replace(old, new, 1)
    if code == "wrong-shape" and old == "1352.0,":
        text = CAMERA_INFO.replace(", -0.0008, -.01]", "]")
    with refused(code, "camera.yaml", *stated):  # type: ignore[arg-type]
        read_intrinsics(written(tmp_path, text))


def test_models_and_matrices_that_are_none_are_refused(tmp_path: Path) -> None:
    with refused("unsupported", "cam0: camera_model", "'omni'"):
        read_intrinsics(written(tmp_path, CAMCHAIN.replace("pinhole", "omni", 1)))
    with refused("invalid-value", "cam1: T_cn_cnm1", "rotation"):
        read_rig(written(tmp_path, CAMCHAIN.replace("[1.0, 0.0, 0.0, -0.11]", "[2, 0, 0, 1]")))
    tilted = STORAGE.replace("rows: 8", "rows: 14").replace("0.03 ]", "0.03, 0,0,0,0, 0.01, 0 ]")
    with refused("unsupported", "tilted"):
        read_intrinsics(written(tmp_path, tilted))


@pytest.mark.parametrize(
    ("more", "lens"),
    [
        ("model: kannala_brandt\nk1: 0.01\n", "fisheye"),
        ("distortion_model: equidistant\nk1: 0.01\n", "fisheye"),
        ("k1: 0.01\nk2: 0.0\nk3: 0.0\nk4: 0.0\n", "fisheye"),
        ("model: OPENCV\nk1: 0.01\np1: 0.001\n", "brown5"),
        ("k1: 0.01\np1: 0.001\nk4: 0.1\n", "brown8"),
    ],
)
def test_a_lens_by_the_word_or_the_coefficients_of_its_program(
    tmp_path: Path, more: str, lens: str
) -> None:
    (tmp_path / "eye.yaml").write_text(f"fx: 320\nfy: 320\ncx: 640\ncy: 480\n{more}", "utf-8")
    (eye,) = read_intrinsics(tmp_path / "eye.yaml").values()
    assert eye.lens == lens
