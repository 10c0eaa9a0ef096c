"""Poses and hand-eye samples of other programs are read as they state them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from loopcal.files.cameras.places import read_places, read_samples
from tests.refusals import refused

TURNED = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""A quarter turn about z, the quaternion x, y, z, w = 0, 0, sin 45, cos 45 degrees."""
Q = {"x": 0.0, "y": 0.0, "z": 0.7071067811865476, "w": 0.7071067811865476}


def sample(x: float) -> str:
    """A transform as ROS writes it."""
    rotation = ", ".join(f"{axis}: {value}" for axis, value in Q.items())
    return f"{{translation: {{x: {x}, y: 2.0, z: 3.0}}, rotation: {{{rotation}}}}}"


def written(folder: Path, text: str, name: str = "poses.yaml") -> Path:
    path = folder / name
    path.parent.mkdir(exist_ok=True)
    path.write_text(text, "utf-8")
    return path


def test_samples_of_easy_handeye(tmp_path: Path) -> None:
    text = "samples:\n" + "".join(
        f"- robot: {sample(i)}\n  tracking: {sample(10 + i)}\n" for i in range(3)
    )
    samples = read_samples(written(tmp_path, text))
    np.testing.assert_allclose(samples.robot[:, 0, 3], (0, 1, 2))
    np.testing.assert_allclose(samples.tracking[1, :3, :3], TURNED, atol=1e-15)
    first = f"hand_world_samples:\n  transforms: [{sample(1)}, {sample(2)}]\n"
    text = f"{first}camera_marker_samples:\n  transforms: [{sample(3)}, {sample(4)}]\n"
    np.testing.assert_allclose(read_samples(written(tmp_path, text)).tracking[:, 0, 3], (3, 4))
    with refused("mismatched-poses", "2", "1"):
        read_samples(written(tmp_path, text.replace(f"{sample(3)}, ", "")))


def test_samples_without_marker_state_the_poses_of_the_robot(tmp_path: Path) -> None:
    path = written(tmp_path, "samples:\n" + "".join(f"- robot: {sample(i)}\n" for i in range(3)))
    places = read_places(path)
    assert places.name == ("1", "2", "3")
    np.testing.assert_allclose(places.T[:, 0, 3], (0, 1, 2))
    with refused("missing-key", "tracking"):
        read_samples(path)


def test_poses_of_industrial_calibration_in_files_beside_images(tmp_path: Path) -> None:
    pose = "x: {}\ny: 2.0\nz: 3.0\nqx: 0.0\nqy: 0.0\nqz: 0.70710678\nqw: 0.70710678\n"
    for i in range(2):
        written(tmp_path, pose.format(i), f"poses/{i}.yaml")
    text = "data:\n- image: images/7.png\n  pose: poses/0.yaml\n"
    text += "- pose: poses/1.yaml\n  image: images/8.png\n"
    places = read_places(written(tmp_path, text))
    assert places.name == ("7", "8")
    np.testing.assert_allclose(places.T[:, 0, 3], (0, 1))
    assert read_places(tmp_path / "poses/1.yaml").T.shape == (1, 4, 4)
    with refused("missing-file", "9.yaml"):
        read_places(written(tmp_path, text.replace("poses/1", "poses/9")))


def test_poses_of_a_table_with_quaternions_in_any_order(tmp_path: Path) -> None:
    text = "pose,x_mm,y_mm,z_mm,qw,qx,qy,qz\na,1000,2000,3000,0.70710678,0,0,0.70710678\n"
    text += "b,0,0,0,1,0,0,0\n"
    places = read_places(written(tmp_path, text, "poses.csv"))
    assert places.name == ("a", "b")
    np.testing.assert_allclose(places.T[0, :3], np.c_[TURNED, (1, 2, 3)], atol=1e-8)
    text = "pose,x_m,y_m,z_m,qx,qy,qz,qw\na,1,2,3,0,0,0.70710678,0.70710678\nb,0,0,0,0,0,0,1\n"
    other = read_places(written(tmp_path, text, "poses.csv"))
    np.testing.assert_allclose(other.T, places.T, atol=1e-8)


@pytest.mark.parametrize(
    "names", ["r00,r01,r02,t0,r10,r11,r12,t1,r20,r21,r22,t2", "a,b,c,d,e,f,g,h,i,j,k,l", ""]
)
def test_three_rows_of_a_matrix_with_any_names(names: str, tmp_path: Path) -> None:
    by_cell = names or "r11,r12,r13,r21,r22,r23,r31,r32,r33,t1,t2,t3"
    rows = np.c_[TURNED, (1, 2, 3)] if names else np.r_[TURNED.ravel(), 1, 2, 3]
    text = f"pose,{by_cell}\nn1," + ",".join(f"{value:g}" for value in rows.ravel()) + "\n"
    places = read_places(written(tmp_path, text + text.split("\n")[1] + "\n", "poses.csv"))
    np.testing.assert_allclose(places.T[0, :3], np.c_[TURNED, (1, 2, 3)], atol=1e-12)


@pytest.mark.parametrize("by", ["rows", "columns"])
def test_sixteen_numbers_of_one_name_are_a_matrix(by: str, tmp_path: Path) -> None:
    """As robots log them, column by column too: O_T_EE."""
    T = np.r_[np.c_[TURNED, (1, 2, 3)], [[0, 0, 0, 1]]]
    row = ",".join(f"{value:g}" for value in (T if by == "rows" else T.T).ravel())
    text = "image," + ",".join(f"O_T_EE_{i}" for i in range(16)) + f"\nn1,{row}\nn2,{row}\n"
    np.testing.assert_allclose(read_places(written(tmp_path, text, "poses.csv")).T[1], T)


def test_six_numbers_of_one_name_may_be_joints(tmp_path: Path) -> None:
    text = "image," + ",".join(f"joint_{i}" for i in range(6)) + "\nn1,1,2,3,4,5,6\n"
    with refused("missing-column"):
        read_places(written(tmp_path, text, "poses.csv"))


def test_poses_that_are_none_are_refused(tmp_path: Path) -> None:
    with refused("missing-column", "poses.csv", "qw"):
        read_places(written(tmp_path, "pose,x_m,y_m,z_m\n1,0,0,1\n2,0,1,1\n", "poses.csv"))
    with refused("invalid-value", "quaternion"):
        read_places(written(tmp_path, "{x: 0, y: 0, z: 0, qx: 0, qy: 0, qz: 0, qw: 0}"))
    with refused("missing-key", "poses.yaml"):
        read_places(written(tmp_path, "a: 1\n"))


MATRIX = [[*row, t] for row, t in zip(TURNED.tolist(), (1.0, 2.0, 3.0), strict=True)]
FLAT = [cell for row in [*MATRIX, [0.0, 0.0, 0.0, 1.0]] for cell in row]


@pytest.mark.parametrize(
    "one",
    [
        [*MATRIX, [0.0, 0.0, 0.0, 1.0]],
        MATRIX,
        FLAT,
        {"T_base_flange": MATRIX, "stamp": 1.5},
        {"position": [1.0, 2.0, 3.0], "orientation": [0.0, 0.0, Q["z"], Q["w"]]},
        {"t": [[1.0], [2.0], [3.0]], "R": TURNED.tolist()},
        {"tvec": [1.0, 2.0, 3.0], "rvec": [0.0, 0.0, np.pi / 2.0]},
    ],
)
def test_poses_by_image_in_json(tmp_path: Path, one: object) -> None:
    path = written(tmp_path, json.dumps({"img_7.png": one, "img_8.png": one}), "robot.json")
    places = read_places(path)
    assert places.name == ("img_7.png", "img_8.png")
    np.testing.assert_allclose(places.T[1, :3], np.c_[TURNED, (1, 2, 3)], atol=1e-8)
    rows = [{"image": name, "pose": one} for name in ("img_7.png", "img_8.png")]
    listed = read_places(written(tmp_path, json.dumps(rows), "listed.json"))
    assert listed.name == ("img_7", "img_8")
    np.testing.assert_allclose(listed.T, places.T)


def test_matrices_of_opencv(tmp_path: Path) -> None:
    matrix = f"!!opencv-matrix\n  rows: 4\n  cols: 4\n  dt: d\n  data: {FLAT}\n"
    text = "%YAML:1.0\n---\n" + "".join(f"pose_{i}: {matrix}" for i in range(3))
    places = read_places(written(tmp_path, text))
    assert places.name == ("pose_0", "pose_1", "pose_2")
    np.testing.assert_allclose(places.T[2, :3], np.c_[TURNED, (1, 2, 3)], atol=1e-12)


def test_rotations_and_translations_side_by_side(tmp_path: Path) -> None:
    lists = {"R_gripper2base": [TURNED.tolist()] * 3, "t_gripper2base": [[1.0, 2.0, 3.0]] * 3}
    places = read_places(written(tmp_path, json.dumps(lists), "robot.json"))
    assert places.counted
    assert places.name == ("1", "2", "3")
    np.testing.assert_allclose(places.T[2, :3], np.c_[TURNED, (1, 2, 3)], atol=1e-12)


def test_samples_of_moveit(tmp_path: Path) -> None:
    def rows(x: float) -> str:
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = TURNED, (x, 2.0, 3.0)
        return str(T.tolist())

    text = "".join(
        f"- effector_wrt_world: {rows(i)}\n  object_wrt_sensor: {rows(10 + i)}\n" for i in range(3)
    )
    samples = read_samples(written(tmp_path, text))
    np.testing.assert_allclose(samples.robot[:, 0, 3], (0, 1, 2))
    np.testing.assert_allclose(samples.tracking[:, 0, 3], (10, 11, 12))
    assert not samples.turned_around


def test_a_hand_with_other_turns_does_not_turn_about_z_alone(tmp_path: Path) -> None:
    text = "pose,x_mm,y_mm,z_mm,p,r\n1,10,20,30,4,5\n2,11,20,30,5,6\n"
    with refused("missing-column"):
        read_places(written(tmp_path, text, "poses.csv"))


def test_xml_of_opencv_declares_nothing(tmp_path: Path) -> None:
    matrix = "<T><rows>3</rows><cols>4</cols><data>1 0 0 7 0 1 0 8 0 0 1 9</data></T>"
    text = f"<?xml version='1.0'?><opencv_storage>{matrix}</opencv_storage>"
    places = read_places(written(tmp_path, text, "pose.xml"))
    np.testing.assert_allclose(places.T[0, :3, 3], (7, 8, 9))
    declared = text.replace("?><", '?><!DOCTYPE x [<!ENTITY a "b">]><')
    with refused("missing-key", "pose"):
        read_places(written(tmp_path, declared.replace("opencv_storage", "x"), "other.xml"))
    with refused("invalid-syntax", "document type"):
        read_places(written(tmp_path, declared, "declared.xml"))
    with refused("invalid-syntax"):
        read_places(written(tmp_path, text[:-5], "cut.xml"))
