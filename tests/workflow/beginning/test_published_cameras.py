"""Published sets of cameras, from their folders to a calibration as an independent fit has it."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import loopcal as lc

DH = """a [m],d [m],alpha [deg],theta [deg]
0.150,1.4159,-90,0
0.614,0,180,-90
0.200,0,-90,0
0,-0.640,90,0
0.030,0,90,-90
0,0.200,0,0
"""
"""The right arm of the Motoman, as its source publishes it."""


def test_a_charuco_board_on_a_flange(shared_data: Callable[[str], Path]) -> None:
    project = lc.init(shared_data("camera/ic_charuco"))
    result = lc.calibrate(
        project.mechanism, project.dataset, noise=project.noise, method="implicit-loop"
    )
    # An independent fit makes the pitch 1.0047 +- 0.0007, and leaves 1.245 px out of sample.
    sd = result.sd["board_scale"]
    assert sd is not None
    assert abs(result.value["board_scale"] - 4.7e-3) < 2.0 * math.hypot(sd, 7e-4)
    assert result.accuracy_after is not None
    assert result.accuracy_after.rms < 1.245
    # Two corners of one image do not fit; some images scatter twice as much as others.
    assert {one.pose for one in lc.find_outliers(result).found} <= {"2", "7"}
    # Paper that is not flat, and lines of the print that are off, in all images alike.
    assert {term.name for term in result.terms} == {"points", "heights"}
    assert result.accuracy_after.rms < 1.1


def test_markers_on_a_hand_that_does_not_turn(
    shared_data: Callable[[str], Path], tmp_path: Path
) -> None:
    (tmp_path / "dh.csv").write_text(DH, "utf-8")
    joints = ",".join(f"r{i}_rad" for i in range(1, 7))
    folder = shared_data("camera/motoman_right")
    project = lc.init(folder, dh=tmp_path / "dh.csv", joints=joints)
    said = " ".join(project.remarks)
    assert "(2009, 2964) px of camera '1' is that of an image on its side" in said
    assert "In all 216 images the hand is turned alike" in said


def test_two_cameras_before_markers_without_a_robot(shared_data: Callable[[str], Path]) -> None:
    project = lc.init(shared_data("camera/motoman_right"))
    assert "not fit" not in " ".join(project.remarks)
    result = lc.calibrate(project.mechanism, project.dataset, noise=project.noise)
    assert result.accuracy_after is not None
    assert result.accuracy_after.rms < 1.0
    # As an independent fit with the robot in the loop has the principal points.
    for camera in ("camera_1", "camera_2"):
        for name, value in (("cx", 2990.0), ("cy", 2000.0)):
            sd = result.sd[f"{camera}_{name}"]
            assert sd is not None
            assert abs(result.value[f"{camera}_{name}"] - value) < 3.0 * sd
    # No joint and no pose is read that least squares could take as exact.
    assert result.chosen is not None
    assert {one.name for one in result.chosen.over} == {"implicit-loop", "nominal"}


def test_two_cameras_before_a_board_at_one_distance(shared_data: Callable[[str], Path]) -> None:
    said = " ".join(lc.init(shared_data("camera/stereo_chessboard")).remarks)
    for camera in "12":
        assert f"All boards stand at one distance from camera '{camera}'" in said
