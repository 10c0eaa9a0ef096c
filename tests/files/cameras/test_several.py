"""Corners and lenses that stand in several files are taken together."""

from __future__ import annotations

from pathlib import Path

import pytest

from loopcal.files.cameras.folder import Files, read_files
from tests.refusals import refused

LENS = "fx: {}\nfy: {}\ncx: 640\ncy: 480\nwidth: 1280\nheight: 960\n"


def folder_of(folder: Path, files: dict[str, str]) -> Files:
    files = files | {"board.csv": "board,point,x_m,y_m,z_m\nboard,0,0,0,0\nboard,1,0.1,0,0\n"}
    for name, text in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return read_files([folder])


def table(shift: float, images: str = "ab", header: str = "image,point,u_px,v_px") -> str:
    rows = [f"{i},{k},{100.0 * k + shift},{50.0 + shift}" for i in images for k in (0, 1)]
    return "\n".join([header, *rows]) + "\n"


@pytest.mark.parametrize(
    ("names", "cameras"),
    [
        (("corners_left.csv", "corners_right.csv"), ("left", "right")),
        (("cam0/corners.csv", "cam1/corners.csv"), ("cam0", "cam1")),
        (("mako_corners.csv", "ids_corners.csv"), ("ids", "mako")),
    ],
)
def test_a_file_for_each_camera(
    tmp_path: Path, names: tuple[str, str], cameras: tuple[str, str]
) -> None:
    files = folder_of(tmp_path, {names[0]: table(0.0), names[1]: table(30.0)})
    assert sorted(files.corners.cameras) == sorted(cameras)
    assert files.corners.images == ("a", "b")
    assert len(files.corners) == 8


def test_a_file_for_each_image(tmp_path: Path) -> None:
    text = "point,u_px,v_px\n0,1,2\n1,3,4\n"
    names = ("img_0.csv", "img_1.csv", "img_2.csv")
    files = folder_of(tmp_path, dict.fromkeys(names, text))
    assert files.corners.images == ("0", "1", "2")
    assert files.corners.cameras == ("1",)


def test_images_in_parts_are_of_one_camera(tmp_path: Path) -> None:
    files = folder_of(tmp_path, {"one.csv": table(0.0, "ab"), "two.csv": table(30.0, "cd")})
    assert files.corners.images == ("a", "b", "c", "d")
    assert files.corners.cameras == ("1",)


def test_two_detectors_of_the_same_images_are_no_cameras(tmp_path: Path) -> None:
    with refused("conflicting-keys", "one.csv", "two.csv"):
        folder_of(tmp_path, {"one.csv": table(0.0), "two.csv": table(0.3)})


def test_lenses_that_name_no_camera_are_those_of_their_files(tmp_path: Path) -> None:
    """The last one was that of both."""
    files = folder_of(
        tmp_path,
        {
            "corners_left.csv": table(0.0),
            "corners_right.csv": table(30.0),
            "left.yaml": LENS.format(900, 900),
            "right.yaml": LENS.format(1000, 1000),
        },
    )
    assert {name: lens.fx for name, lens in files.lenses.items()} == {"left": 900, "right": 1000}


def test_a_file_in_which_nothing_is_recognised_is_named(tmp_path: Path) -> None:
    """A camera alone was calibrated, and nothing said that the robot's file was not read."""
    files = folder_of(
        tmp_path,
        {"corners.csv": table(0.0), "robot.yaml": "flange: [1, 2]\n", "poses.npy": "\x93NUMPY"},
    )
    assert [words.split(":")[0].split(" ")[0] for words in files.remarks] == [
        "poses.npy",
        "robot.yaml",
    ]
