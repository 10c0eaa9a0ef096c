"""What is written for other programs is read back the same, by loopcal and by OpenCV."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from loopcal.files.cameras import written
from loopcal.files.cameras.document import read_document, transform
from loopcal.files.cameras.intrinsics import read_intrinsics, read_rig
from loopcal.mechanisms.cameras.lens import LENSES, Intrinsics, project
from tests.mechanisms.test_cameras import camera, points
from tests.refusals import refused

T = np.array(
    [[0.6, -0.8, 0.0, 0.1], [0.8, 0.6, 0.0, -1e-7], [0.0, 0.0, 1.0, 0.3], [0.0, 0.0, 0.0, 1.0]]
)


@pytest.mark.parametrize("lens", LENSES)
def test_storage_is_read_back_the_same(lens: str, tmp_path: Path) -> None:
    path = tmp_path / "camera.yaml"
    path.write_text(written.opencv_storage(camera(lens)), "utf-8")
    one = read_intrinsics(path)["camera"]
    # A pinhole has five coefficients of 0 in OpenCV.
    assert one.lens == ("brown5" if lens == "pinhole" else lens)
    seen = np.array(project(one.lens, points(), one.values))
    np.testing.assert_array_equal(seen, project(lens, points(), camera(lens).values))


@pytest.mark.parametrize("lens", LENSES)
def test_opencv_reads_its_file_and_sees_the_same_pixels(lens: str, tmp_path: Path) -> None:
    cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed (loopcal[images])")
    path = tmp_path / "camera.yaml"
    path.write_text(written.opencv_storage(camera(lens)), "utf-8")
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    K = storage.getNode("camera_matrix").mat()
    D = storage.getNode("distortion_coefficients").mat()
    assert storage.getNode("image_width").real() == 1600
    xyz = points().T
    if storage.getNode("fisheye_model").real():
        seen, _ = cv2.fisheye.projectPoints(xyz[:, None], np.zeros(3), np.zeros(3), K, D)
    else:
        seen, _ = cv2.projectPoints(xyz, np.zeros(3), np.zeros(3), K, D)
    here = np.array(project(lens, xyz.T, camera(lens).values)).T
    np.testing.assert_allclose(seen.reshape(-1, 2), here, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("lens", ["pinhole", "brown5", "brown8", "fisheye"])
def test_camera_info_is_read_back_the_same(lens: str, tmp_path: Path) -> None:
    path = tmp_path / "camera.yaml"
    path.write_text(written.camera_info("eye", camera(lens)), "utf-8")
    one = read_intrinsics(path)["eye"]
    assert one.image == (1600, 1200)
    np.testing.assert_array_equal(
        project(one.lens, points(), one.values), project(lens, points(), camera(lens).values)
    )


def test_a_camchain_is_read_back_the_same(tmp_path: Path) -> None:
    brown = Intrinsics("brown5", 800.0, 801.0, 3.0, 2.0, (-0.2, 0.05, 1e-5, -0.002, 0.0), (6, 4))
    cameras = {"left": brown, "right": camera("fisheye"), "top": camera("pinhole")}
    places = {"left": np.eye(4), "right": T, "top": T @ T}
    path = tmp_path / "camchain.yaml"
    path.write_text(written.camchain(cameras, places), "utf-8")
    rig = read_rig(path)
    assert list(rig.cameras.values()) == list(cameras.values())
    for name, place in zip(("cam0", "cam1", "cam2"), places.values(), strict=True):
        np.testing.assert_allclose(rig.T_camera_first[name], place, atol=1e-15)


def test_a_hand_eye_calibration_is_read_back_the_same(tmp_path: Path) -> None:
    frames = {"robot_base_frame": "arm: base"}
    path = tmp_path / "eye.yaml"
    path.write_text(written.easy_handeye("eye", T, on_hand=True, frames=frames), "utf-8")
    one = read_document(path)
    np.testing.assert_allclose(transform(one.part("transformation")), T, atol=1e-15)
    parameters = one.part("parameters")
    assert parameters.part("eye_on_hand").flag
    assert parameters.part("robot_base_frame").text == "arm: base"


def test_numbers_are_those_of_yaml_1_1() -> None:
    import yaml

    text = written.camera_info("eye", Intrinsics("brown5", 1e16, 1e-7, 0.1, 2.0, image=(6, 4)))
    data = yaml.safe_load(text)["camera_matrix"]["data"]
    assert (data[0], data[4]) == (1e16, 1e-7)


def test_lenses_and_sizes_that_a_format_lacks_are_refused() -> None:
    with refused("unsupported", "'brown12'", "'eye'"):
        written.camera_info("eye", camera("brown12"))
    with refused("unsupported", "k3"):
        written.camchain({"eye": camera("brown5")}, {})
    with refused("missing-key", "image"):
        written.camera_info("eye", Intrinsics("pinhole", 1.0, 1.0, 0.0, 0.0))
