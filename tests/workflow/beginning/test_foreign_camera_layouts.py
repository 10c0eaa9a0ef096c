"""The same images of a board and poses of a robot as other people and programs write them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import loopcal as lc
from loopcal.arrays import Array
from loopcal.mechanisms.cameras.printed import checkerboard
from tests.mechanisms.test_camera import hands, pixels
from tests.refusals import refused

COUNT, COLUMNS, ROWS, SQUARE = 12, 5, 4, 0.05
BOARD = checkerboard(COLUMNS, ROWS, SQUARE).points
T = hands(COUNT, 5)
TURNS = Rotation.from_matrix(T[:, :3, :3])
UV: Array = pixels(T, on="base", points=BOARD).transpose(2, 0, 1)
"""(images, points, 2) [px]."""


def text(folder: Path, name: str, *lines: str) -> None:
    (folder / name).write_text("\n".join(lines) + "\n", encoding="utf-8")


def board(folder: Path) -> None:
    text(folder, "board.yaml", "type: checkerboard", f"columns: {COLUMNS}", f"rows: {ROWS}")
    with (folder / "board.yaml").open("a", encoding="utf-8") as file:
        file.write(f"square: {1e3 * SQUARE:g}\nunit: mm\n")


def corners(folder: Path, name: str, head: str = "image,id,px,py") -> None:
    """A row per corner; name: of an image by its number."""
    rows = (
        f"{name.format(i)},{k},{u:.5f},{v:.5f}" for i in range(COUNT) for k, (u, v) in enum(UV[i])
    )
    text(folder, "corners.csv", head, *rows)


def enum(points: Array) -> list[tuple[int, tuple[float, float]]]:
    return [(k, (u, v)) for k, (u, v) in enumerate(points.tolist())]


def numbers(values: Array) -> str:
    return ", ".join(f"{value:.12g}" for value in np.ravel(values))


def matrix(values: Array, rows: int, columns: int, kind: str = "d") -> str:
    return (
        f"!!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: {kind}\n"
        f"   data: [ {numbers(values)} ]"
    )


def storage_of_opencv(folder: Path) -> None:
    """What OpenCV's calibration sample writes, and a matrix per pose."""
    text(
        folder,
        "out_camera_data.yml",
        *("%YAML:1.0", "---", f"nframes: {COUNT}", f"board_width: {COLUMNS}"),
        *(f"board_height: {ROWS}", f"square_size: {SQUARE}"),
        f"image_points: {matrix(UV, COUNT, len(BOARD), '2f')}",
    )
    poses = (f"T_{i}: {matrix(one, 4, 4)}" for i, one in enumerate(T))
    text(folder, "robot.yml", "%YAML:1.0", "---", *poses)


def storage_in_xml(folder: Path) -> None:
    """Rotation vectors and translations of each pose in XML."""

    def vector(name: str, values: Array) -> str:
        return (
            f'<{name} type_id="opencv-matrix"><rows>3</rows><cols>1</cols><dt>d</dt>'
            f"<data>{numbers(values).replace(',', ' ')}</data></{name}>"
        )

    poses = (
        f"<pose_{i:03}>{vector('rvec', turn)}{vector('tvec', one[:3, 3])}</pose_{i:03}>"
        for i, (one, turn) in enumerate(zip(T, TURNS.as_rotvec(), strict=True))
    )
    text(folder, "poses.xml", '<?xml version="1.0"?>', "<opencv_storage>", *poses)
    with (folder / "poses.xml").open("a", encoding="utf-8") as file:
        file.write("</opencv_storage>\n")
    corners(folder, "{:03}.png")
    board(folder)


def a_json_per_image(folder: Path) -> None:
    """Corners, their ids and the pose, row by row; the first corner is not seen."""
    for i in range(COUNT):
        shot = {
            "image": f"{i:04}.png",
            "charuco_ids": list(range(1, len(BOARD))),
            "charuco_corners": [[uv] for uv in UV[i][1:].tolist()],
            "pose": T[i].ravel().tolist(),
        }
        (folder / f"{i:04}.json").write_text(json.dumps(shot), encoding="utf-8")
    board(folder)


def units_and_order_in_keys(folder: Path) -> None:
    poses = {
        f"{i:03}.png": {"t_mm": (1e3 * one[:3, 3]).tolist(), "q_wxyz": [w, x, y, z]}
        for i, (one, (x, y, z, w)) in enumerate(zip(T, TURNS.as_quat().tolist(), strict=True))
    }
    (folder / "poses.json").write_text(json.dumps(poses), encoding="utf-8")
    corners(folder, "{:03}.png")
    board(folder)


def base_to_gripper(folder: Path) -> None:
    """Lists of matrices side by side, of the inverse poses."""
    back = np.linalg.inv(T)
    turns = Rotation.from_matrix(back[:, :3, :3]).as_rotvec()

    def listed(values: Array) -> str:
        items = (matrix(v, 3, 1).replace("\n", "\n  ") for v in values)
        return "\n".join(f" - {item}" for item in items)

    text(
        folder,
        "calib.yml",
        *("%YAML:1.0", "---", "R_base2gripper:", listed(turns)),
        *("t_base2gripper:", listed(back[:, :3, 3])),
    )
    corners(folder, "{}", "view,corner,u,v")
    board(folder)


def frames_by_path(folder: Path) -> None:
    """Frames with the path of their image, in another order than these."""
    frames = [
        {"file_path": f"./rgb/{i:03}.png", "transform_matrix": T[i].tolist()}
        for i in np.random.default_rng(3).permutation(COUNT)
    ]
    (folder / "transforms.json").write_text(json.dumps({"frames": frames}), encoding="utf-8")
    corners(folder, "./rgb/{:03}.png", "file_path,point,u,v")
    board(folder)


def messages(folder: Path) -> None:
    """A document of YAML for each message."""
    names = ("x", "y", "z", "w")
    for i, (one, q) in enumerate(zip(T, TURNS.as_quat(), strict=True)):
        place = ", ".join(f"{n}: {v:.12g}" for n, v in zip(names, one[:3, 3], strict=False))
        turn = ", ".join(f"{n}: {v:.12g}" for n, v in zip(names, q, strict=True))
        with (folder / "tool_pose.yaml").open("a", encoding="utf-8") as file:
            file.write(
                f"header:\n  stamp:\n    secs: {1_700_000_000 + 3 * i}\n    nsecs: 5\n"
                f"pose:\n  position: {{{place}}}\n  orientation: {{{turn}}}\n---\n"
            )
    corners(folder, "image_{:02}.png")
    board(folder)


def calls_of_universal_robots(folder: Path) -> None:
    rows = (
        f"p[{numbers(np.r_[one[:3, 3], t])}]" for one, t in zip(T, TURNS.as_rotvec(), strict=True)
    )
    text(folder, "poses.txt", *rows)
    corners(folder, "frame_{:03}.png")
    board(folder)


def positions_of_fanuc(folder: Path) -> None:
    """P is the number of a position, and a turn."""
    names = ("X", "Y", "Z", "W", "P", "R")
    values = np.c_[1e3 * T[:, :3, 3], TURNS.as_euler("xyz", degrees=True)]
    text(
        folder,
        "positions.txt",
        *(
            f"P[{i}] " + ", ".join(f"{n} = {v:.9f}" for n, v in zip(names, row, strict=True))
            for i, row in enumerate(values)
        ),
    )
    corners(folder, "{}.png")
    board(folder)


def trajectory_by_time(folder: Path) -> None:
    """A file of an ending that says nothing, and corners by times in ns."""
    rows = (
        f"{1_700_000_000.103 + 4 * i:.3f} {numbers(np.r_[one[:3, 3], q]).replace(',', '')}"
        for i, (one, q) in enumerate(zip(T, TURNS.as_quat(), strict=True))
    )
    text(folder, "traj.tum", "# timestamp tx ty tz qx qy qz qw", *rows)
    stamps = (f"{1_700_000_000_100_000_000 + 4_000_000_000 * i}" for i in range(COUNT))
    rows = (f"{stamp},{k},{u},{v}" for i, stamp in enumerate(stamps) for k, (u, v) in enum(UV[i]))
    text(folder, "corners.csv", "timestamp [ns],corner id,x [px],y [px]", *rows)
    board(folder)


def squares_of_charuco(folder: Path) -> None:
    """Keys as OpenCV's classes have them."""
    stated: dict[str, object] = {
        "squaresX": COLUMNS + 1,
        "squaresY": ROWS + 1,
        "squareLength": SQUARE,
    }
    stated |= {"markerLength": 0.7 * SQUARE, "dictionary": "DICT_5X5_100"}
    (folder / "board.json").write_text(json.dumps(stated), encoding="utf-8")
    corners(folder, "{}", "frame,charuco_id,x,y")
    rows = (f"{i},{numbers(one).replace(' ', '')}" for i, one in enumerate(T))
    text(
        folder,
        "poses.csv",
        "frame," + ",".join(f"T{a}{b}" for a in range(4) for b in range(4)),
        *rows,
    )


@pytest.mark.parametrize(
    "write",
    [
        storage_of_opencv,
        storage_in_xml,
        a_json_per_image,
        units_and_order_in_keys,
        base_to_gripper,
        frames_by_path,
        messages,
        calls_of_universal_robots,
        positions_of_fanuc,
        trajectory_by_time,
        squares_of_charuco,
    ],
)
def test_poses_and_corners_are_those_of_the_writer(
    write: Callable[[Path], None], tmp_path: Path
) -> None:
    write(tmp_path)
    project = lc.init(tmp_path)
    assert project.words.startswith(f"{COUNT} images with ")
    assert float(project.words.rpartition("at ")[2].split()[0]) < 0.2, str(project)
    order = np.argsort(project.dataset.readings["x"])
    np.testing.assert_allclose(project.dataset.readings["x"][order], np.sort(T[:, 0, 3]), atol=1e-6)


def test_joints_beside_the_names_of_images_stand_in_a_list(tmp_path: Path) -> None:
    from analyses.cameras_truth import shots

    made = shots(37, held=False, images=12)
    made.write(tmp_path / "images")
    _, *rows = (tmp_path / "images" / "poses.csv").read_text(encoding="utf-8").splitlines()
    records = [
        {"image": f"rgb/{pose}.png", "q": list(map(float, joints))}
        for pose, *joints in (row.split(",") for row in rows[::-1])
    ]
    (tmp_path / "images" / "poses.csv").unlink()
    (tmp_path / "images" / "captures.json").write_text(json.dumps(records), encoding="utf-8")
    project = lc.init(tmp_path / "images")
    assert "captures.json, by their names" in str(project)
    assert len(project.dataset) == 12


def test_images_without_poses_of_a_robot_are_said_to_be_alone(tmp_path: Path) -> None:
    corners(tmp_path, "{}.png")
    board(tmp_path)
    text(tmp_path, "robot.pickle", "poses")
    words = str(lc.init(tmp_path))
    assert "no file states poses of a robot, so the cameras alone are calibrated" in words
    assert "robot.pickle is not read" in words


def test_a_single_image_with_a_pose_calibrates_nothing(tmp_path: Path) -> None:
    calls_of_universal_robots(tmp_path)
    (tmp_path / "poses.txt").unlink()
    q = ",".join(map(str, TURNS[0].as_quat()))
    text(tmp_path, "poses.csv", "image,x_m,y_m,z_m,qx,qy,qz,qw", f"frame_001.png,0.1,0.2,0.3,{q}")
    with refused("mismatched-poses", "only 1 of 12 images"):
        lc.init(tmp_path)


def test_a_board_without_corners_is_no_table_of_readings(tmp_path: Path) -> None:
    board(tmp_path)
    (tmp_path / "pose.json").write_text(json.dumps({"pose": T[0].tolist()}), encoding="utf-8")
    with refused("no-data", "board.yaml", "corners"):
        lc.init(tmp_path)
