"""Folders of a camera as users write them: read as they are meant, and what was changed is said."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

import loopcal as lc
from analyses.cameras_truth import shots
from loopcal.estimation.cameras.corners import Corners
from loopcal.estimation.cameras.mistakes import corrected
from loopcal.estimation.cameras.placing import Reading
from loopcal.estimation.cameras.start import way_of_turning
from loopcal.files.cameras.boards import read_boards
from loopcal.files.cameras.corner_table import CornerTable
from loopcal.files.cameras.corners import read_corners
from loopcal.files.cameras.folder import read_files
from loopcal.files.cameras.places import read_places
from loopcal.mechanisms.cameras.board import Board
from loopcal.statistics.case import nominal_machine
from loopcal.workflow.beginning.from_images import matched
from tests.mechanisms.test_camera import LENS, POINTS, hands, pixels
from tests.refusals import refused
from tests.workflow.beginning.test_from_images import written


def rewritten(path: Path, change: Callable[[list[str]], list[str]], header: str = "") -> None:
    """The rows of a table changed, cell by cell, and its header where one is given."""
    head, *rows = path.read_text(encoding="utf-8").splitlines()
    changed = [",".join(change(row.split(","))) for row in rows]
    path.write_text("\n".join([header or head, *changed]) + "\n", encoding="utf-8")


def turned(sequence: str) -> Callable[[list[str]], list[str]]:
    def change(row: list[str]) -> list[str]:
        w, x, y, z = map(float, row[4:])
        turn = Rotation.from_quat([x, y, z, w])
        angles = turn.as_rotvec() if not sequence else turn.as_euler(sequence, degrees=True)
        return [*row[:4], *(f"{a:.9f}" for a in angles)]

    return change


def named(folder: Path) -> None:
    rewritten(folder / "corners.csv", lambda row: [f"img_{int(row[0]):03}.png", *row[1:]])


def x_and_y(folder: Path) -> None:
    rewritten(folder / "corners.csv", lambda row: [row[0], *row[3:]], "image,id,x,y")


def kuka(folder: Path) -> None:
    rewritten(folder / "robot.csv", turned("ZYX"), "pose,X,Y,Z,A,B,C")


def fanuc(folder: Path) -> None:
    head = "image,x_mm,y_mm,z_mm,w_deg,p_deg,r_deg"
    rewritten(folder / "robot.csv", turned("xyz"), head)


def epson(folder: Path) -> None:
    rewritten(folder / "robot.csv", turned("ZYX"), "pose,X,Y,Z,U,V,W")


def mitsubishi(folder: Path) -> None:
    rewritten(folder / "robot.csv", turned("xyz"), "pose,X,Y,Z,A,B,C")


def omron(folder: Path) -> None:
    rewritten(folder / "robot.csv", turned("ZYZ"), "pose,X,Y,Z,yaw,pitch,roll")


def comau(folder: Path) -> None:
    rewritten(folder / "robot.csv", turned("ZYZ"), "pose,X,Y,Z,A,E,R")


def vectors(folder: Path) -> None:
    rewritten(folder / "robot.csv", turned(""), "pose,x_mm,y_mm,z_mm,rx,ry,rz")


def described_otherwise(folder: Path) -> None:
    (folder / "board.yaml").write_text(
        "type: checkerboard\ncolumns: 4\nrows: 3\nsquare: 0.05\n", encoding="utf-8"
    )


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (kuka, "A, B, C in deg, turns A, B, C, Rz Ry Rx"),
        (epson, "U, V, W in deg, turns U, V, W, Rz Ry Rx"),
        (mitsubishi, "A, B, C in deg, turns A, B, C about x, y and z"),
        (omron, "yaw, pitch, roll, Rz Ry Rz"),
        (comau, "A, E, R in deg, turns A, E, R, Rz Ry Rz"),
        (fanuc, "W, P, R, Rz Ry Rx"),
        (vectors, "rx, ry, rz in rad, a rotation vector"),
    ],
)
def test_turns_are_read_as_the_board_turns(
    tmp_path: Path, change: Callable[[Path], None], words: str
) -> None:
    T = hands(12, 5)
    written(tmp_path, pixels(T, on="base"), T)
    change(tmp_path)
    table = read_places(tmp_path / "robot.csv")
    corners = of_table(read_corners(tmp_path / "corners.csv"), read_boards(tmp_path / "points.csv"))
    way = way_of_turning(table.ways, corners, {"1": LENS}, {})
    assert words in way
    assert table.ways[way][:, :3, :3] == pytest.approx(T[:, :3, :3], abs=1e-6)


def test_turns_u_v_w_are_no_pixels(tmp_path: Path) -> None:
    T = hands(12, 5)
    written(tmp_path, pixels(T, on="base"), T)
    epson(tmp_path)
    files = read_files([tmp_path])
    assert [path.name for path in files.poses] == ["robot.csv"]
    assert set(files.corners.image) == {str(i) for i in range(12)}


def test_pixels_in_a_mirror_are_refused_where_several_mistakes_explain_them(
    tmp_path: Path,
) -> None:
    T = hands(16, 60202)
    written(tmp_path, pixels(T, on="base"), T)
    rewritten(tmp_path / "corners.csv", lambda row: [*row[:-1], f"{940.0 - float(row[-1])}"])
    with refused("conflicting-keys", "mirror", "v = height - 1 - v"):
        lc.init(tmp_path)


def of_table(table: CornerTable, boards: Mapping[str, Board]) -> Corners:
    """Its corners, of one camera and one board, images by their numbers."""
    (board,) = boards.values()
    points = list(board.points)
    zero = np.zeros(len(table), dtype=int)
    index = [np.array(list(map(int, table.image))), zero, zero]
    index.append(np.array([points.index(p) for p in table.point]))
    uv = np.stack([table.u, table.v], axis=1)
    return Corners.of(index, uv, ("1",), (board,), tuple(map(str, range(12))))


def test_other_names_start_at_the_same_place(tmp_path: Path) -> None:
    T = hands(12, 5)
    written(tmp_path, pixels(T, on="base"), T)
    for change in (x_and_y, named, fanuc, described_otherwise):
        change(tmp_path)
    project = lc.init(tmp_path)
    for words in ("same number", "W, P, R", "points.csv and board.yaml"):
        assert words in str(project)
    assert project.mechanism.parameters["camera_1_f"].nominal == pytest.approx(LENS.fx, rel=0.01)
    assert len(project.dataset) == 12


def test_numbers_may_begin_at_one() -> None:
    board = Board("board", {str(i): (0.1 * i, 0.0, 0.0) for i in range(3)})
    uv = np.zeros(3)
    table = CornerTable(("im_07",) * 3, ("1",) * 3, ("board",) * 3, ("1", "2", "3"), uv, uv)
    after, remarks = matched(table, [board], ["7", "8"])
    assert (after.image, after.point) == (("7",) * 3, ("0", "1", "2"))
    assert len(remarks) == 2
    assert matched(after, [board], ["7", "8"])[1] == ()


def test_a_board_of_hundreds_of_metres_is_taken_in_mm() -> None:
    T = hands(6, 5)
    board = Board("board", {k: (1e3 * x, 1e3 * y, z) for k, (x, y, z) in POINTS.items()})
    image, point = np.repeat(np.arange(6), 12), np.tile(np.arange(12), 6)
    uv = pixels(T, on="base").transpose(2, 0, 1).reshape(-1, 2)
    zero = np.zeros(72, dtype=int)
    names = tuple(map(str, range(6)))
    corners = Corners.of([image, zero, zero, point], uv, ("1",), (board,), names)
    reading, facts = corrected(Reading(corners, None, (LENS,)), None)
    assert [fact.code for fact in facts] == ["unit-of-board"]
    assert reading.corners.boards[0].xyz.max() == pytest.approx(0.12)


@pytest.mark.parametrize("stated", [True, False])
def test_a_lens_that_nobody_states_is_no_drawing(stated: bool) -> None:
    eye = lc.instruments.camera("eye", points=POINTS)
    mechanism = lc.assemble(lc.machines.free_body(), [eye])
    if stated:
        mechanism = mechanism.with_parameters(mechanism.parameters.with_prior({"eye_f": 10.0}))
    assert ("eye_f" in nominal_machine(mechanism).parameters.free) == (not stated)


def test_a_project_in_the_folder_is_passed_over(tmp_path: Path) -> None:
    T = hands(12, 5)
    written(tmp_path, pixels(T, on="base"), T)
    made = lc.init(tmp_path, out=tmp_path / "calibration")
    assert made.written
    assert lc.init(tmp_path).words == made.words


@pytest.mark.parametrize("on", ["base", "body"])
def test_where_the_start_puts_what_the_hand_carries_is_no_drawing(tmp_path: Path, on: str) -> None:
    T = hands(12, 5)
    # by half as much, so that also a camera in the hand has the board near its image
    T[:, :3, :3] = (Rotation.from_matrix(T[:, :3, :3]) ** 0.5).as_matrix()
    written(tmp_path, pixels(T, on=on), T)
    made = lc.init(tmp_path, out=tmp_path / "calibration")
    parameters = made.mechanism.parameters
    carried = [p for p in parameters if p.role == "mounting" and p.unit in ("m", "rad")]
    assert len(carried) == 6
    assert {(p.unit, round(p.prior_sd, 3)) for p in carried} == {("m", 0.2), ("rad", 1.0)}
    assert all(np.isinf(p.prior_sd) for p in parameters if p.role == "placement")


def listed_beside_a_lens(folder: Path, poses: list[str]) -> None:
    """As industrial_calibration keeps lens, images and poses."""
    one_each(folder, poses)
    rows = [f"- image: images/{i}.png\n  pose: poses/{i}.yaml\n" for i in range(len(poses))]
    lens = "intrinsics:\n  fx: 900.0\n  fy: 900.0\n  cx: 640.0\n  cy: 480.0\n"
    (folder / "data.yaml").write_text(f"{lens}data:\n{''.join(rows)}", encoding="utf-8")


def one_each(folder: Path, poses: list[str]) -> None:
    (folder / "poses").mkdir()
    for i, pose in enumerate(poses):
        (folder / "poses" / f"{i}.yaml").write_text(pose, encoding="utf-8")


@pytest.mark.parametrize("keep", [listed_beside_a_lens, one_each])
def test_poses_in_files_of_their_own(
    tmp_path: Path, keep: Callable[[Path, list[str]], None]
) -> None:
    T = hands(12, 5)
    written(tmp_path, pixels(T, on="base"), T)
    (tmp_path / "robot.csv").unlink()
    quaternions = Rotation.from_matrix(T[:, :3, :3]).as_quat()
    names = ("x", "y", "z", "qx", "qy", "qz", "qw")
    numbers = np.column_stack([T[:, :3, 3], quaternions]).tolist()
    keep(
        tmp_path,
        ["".join(f"{n}: {v}\n" for n, v in zip(names, row, strict=True)) for row in numbers],
    )
    project = lc.init(tmp_path)
    assert len(project.dataset) == 12
    np.testing.assert_allclose(project.dataset.readings["x"], T[:, 0, 3], atol=1e-12)


def test_the_robot_of_hand_eye_samples_stands_beside_corners(tmp_path: Path) -> None:
    T = hands(12, 5)
    written(tmp_path, pixels(T, on="base"), T)
    (tmp_path / "robot.csv").unlink()
    rewritten(tmp_path / "corners.csv", lambda row: [str(int(row[0]) + 1), *row[1:]])

    def motion(one: np.ndarray) -> str:
        x, y, z, w = Rotation.from_matrix(one[:3, :3]).as_quat()
        place = dict(zip("xyz", one[:3, 3].tolist(), strict=True))
        turn = {"x": float(x), "y": float(y), "z": float(z), "w": float(w)}
        return str({"translation": place, "rotation": turn}).replace("'", "")

    samples = [f"- robot: {motion(one)}\n  tracking: {motion(np.eye(4))}\n" for one in T]
    (tmp_path / "samples.yaml").write_text("samples:\n" + "".join(samples), encoding="utf-8")
    project = lc.init(tmp_path)
    np.testing.assert_allclose(project.dataset.readings["x"], T[:, 0, 3], atol=1e-12)


def test_a_folder_of_detected_tags(tmp_path: Path) -> None:
    """With the target of Kalibr and the poses of the robot, and no table of corners."""
    T = hands(12, 5)
    side, apart = 0.06, 0.078
    around = side * np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    tags = [apart * np.array([i % 3, i // 3]) + around for i in range(6)]
    points = {
        f"{i}.{k}": (*map(float, p), 0.0) for i, tag in enumerate(tags) for k, p in enumerate(tag)
    }
    uv = pixels(T, on="base", points=points)
    found = {
        f"img_{i}.png": [
            {"tag_id": tag, "corners": uv[4 * tag : 4 * tag + 4, :, i].tolist()} for tag in range(6)
        ]
        for i in range(12)
    }
    written(tmp_path, pixels(T, on="base"), T)
    for name in ("corners.csv", "points.csv"):
        (tmp_path / name).unlink()
    (tmp_path / "detections.json").write_text(json.dumps(found), encoding="utf-8")
    (tmp_path / "target.yaml").write_text(
        "target_type: aprilgrid\ntagCols: 3\ntagRows: 2\ntagSize: 0.06\ntagSpacing: 0.3\n", "utf-8"
    )
    assert "12 images with 288 corners" in str(lc.init(tmp_path))


def test_joints_of_the_row_that_the_images_fit_are_used(tmp_path: Path) -> None:
    made = shots(37, held=False, images=12)
    made.write(tmp_path / "images", uv=np.roll(made.uv, 1, axis=0))
    begun = lc.init(tmp_path / "images", out=tmp_path / "c")  # dh.csv lies in the folder
    assert any("one row earlier, which is used" in remark for remark in begun.remarks)
    assert list(begun.dataset.poses) == [str(i) for i in range(2, 13)]  # the first has no pose
    assert_allclose(begun.dataset.readings["theta_1"], made.read[:-1, 0], atol=1e-8)


@pytest.mark.parametrize("joints", [True, False])
def test_joints_come_before_the_poses_beside_them_where_a_file_describes_the_robot(
    joints: bool, tmp_path: Path
) -> None:
    made = shots(37, held=False, images=12)
    folder = tmp_path / "images"
    made.write(folder)
    T = made.rig.flange(made.read)
    places = np.c_[T[:, :3, 3], Rotation.from_matrix(T[:, :3, :3]).as_quat()]
    head, *rows = (folder / "poses.csv").read_text(encoding="utf-8").splitlines()
    rows = [row if joints else row.split(",")[0] for row in rows]
    rows = [
        ",".join([row, *(f"{value:.9f}" for value in place)])
        for row, place in zip(rows, places, strict=True)
    ]
    head = ",".join([head if joints else "pose", "x_m,y_m,z_m,qx,qy,qz,qw"])
    (folder / "poses.csv").write_text("\n".join([head, *rows]) + "\n", encoding="utf-8")
    begun = lc.init(folder, out=tmp_path / "c")
    assert ("theta_1" in begun.dataset.readings) is joints
    assert any("not the poses of the flange" in remark for remark in begun.remarks) is joints


def test_a_type_of_machine_takes_images_of_its_board(tmp_path: Path) -> None:
    """As a chain, for which any instrument serves; these images are those of another arm."""
    made = shots(37, held=False, images=12)
    made.write(tmp_path / "images")
    (tmp_path / "images" / "dh.csv").unlink()
    with refused("mismatched-poses"):
        lc.init(tmp_path / "images", machine="motoman-ma1400")


@pytest.mark.parametrize(("along", "first"), [(False, 0), (True, 0), (False, 1)])
def test_corners_of_tags_counted_through_are_matched(
    tmp_path: Path, along: bool, first: int
) -> None:
    """A row per image; the numbers run tag by tag, or along whole rows of corners as in Kalibr."""
    (tmp_path / "target.yaml").write_text(
        "target_type: aprilgrid\ntagCols: 3\ntagRows: 2\ntagSize: 0.06\ntagSpacing: 0.3\n", "utf-8"
    )
    (board,) = read_boards(tmp_path / "target.yaml").values()
    T, xyz = hands(12, 5), board.xyz
    points = dict(zip(board.points, map(tuple, xyz.tolist()), strict=True))
    uv = pixels(T, on="base", points=points)
    order = np.lexsort((xyz[:, 0], xyz[:, 1])) if along else np.arange(len(xyz))
    written(tmp_path, pixels(T, on="base"), T)
    (tmp_path / "points.csv").unlink()
    head = [f"{axis}_{k + first}" for k in range(len(order)) for axis in "uv"]
    rows = [[i, *uv[order, :, i].ravel()] for i in range(12)]
    lines = [",".join(map(str, row)) for row in (["image", *head], *rows)]
    (tmp_path / "corners.csv").write_text("\n".join(lines) + "\n", "utf-8")
    project = lc.init(tmp_path)
    assert "12 images with 288 corners" in str(project)
    assert any("tag by tag" in words for words in project.remarks)
    assert any("along whole rows" in words for words in project.remarks) == along
    assert float(str(project).split(" begins at ")[1].split()[0]) < 0.1


def as_matrices(T: np.ndarray) -> np.ndarray:
    return T.reshape(len(T), 16)


def as_three_rows(T: np.ndarray) -> np.ndarray:
    return as_matrices(T)[:, :12]


def as_tum(T: np.ndarray) -> np.ndarray:
    """Time, place and quaternion x, y, z, w."""
    quaternions = Rotation.from_matrix(T[:, :3, :3]).as_quat()
    return np.column_stack([np.arange(len(T)), T[:, :3, 3], quaternions])


def as_vectors(T: np.ndarray) -> np.ndarray:
    return np.column_stack([T[:, :3, 3], Rotation.from_matrix(T[:, :3, :3]).as_rotvec()])


def as_numbered_turns(T: np.ndarray) -> np.ndarray:
    turns = Rotation.from_matrix(T[:, :3, :3]).as_euler("xyz", degrees=True)
    return np.column_stack([np.arange(len(T)), T[:, :3, 3], turns])


@pytest.mark.parametrize(
    ("numbers", "header"),
    [
        (as_vectors, ""),
        (as_numbered_turns, ""),
        (as_matrices, ""),
        (as_three_rows, ""),
        (as_tum, ""),
        (as_tum, "# timestamp tx ty tz qx qy qz qw\n"),
    ],
)
def test_poses_without_names_as_programs_print_them(
    tmp_path: Path, numbers: Callable[[np.ndarray], np.ndarray], header: str
) -> None:
    """Images count from 0, rows of numbers from 1."""
    T = hands(12, 5)
    written(tmp_path, pixels(T, on="base"), T)
    (tmp_path / "robot.csv").unlink()
    rewritten(tmp_path / "corners.csv", lambda row: [f"img{int(row[0]):03}.png", *row[1:]])
    rows = [" ".join(f"{v:.12f}" for v in row) for row in numbers(T)]
    (tmp_path / "poses.txt").write_text(header + "\n".join(rows) + "\n", encoding="utf-8")
    project = lc.init(tmp_path)
    assert len(project.dataset) == 12
    np.testing.assert_allclose(project.dataset.readings["x"], T[:, 0, 3], atol=1e-9)


def test_images_of_other_numbers_belong_to_rows_in_their_order() -> None:
    board = Board("board", POINTS)
    uv = np.zeros(2)
    table = CornerTable(("im_907", "im_12"), ("1",) * 2, ("board",) * 2, ("0", "1"), uv, uv)
    after, remarks = matched(table, [board], ["1", "2"], counted=True)
    assert after.image == ("2", "1")
    assert len(remarks) == 1
    # Those that begin at 1 are named as rows are.
    table = CornerTable(("1", "2"), ("1",) * 2, ("board",) * 2, ("0", "1"), uv, uv)
    assert matched(table, [board], ["1", "2", "3"], counted=True)[1] == ()
    # Rows that have times in place of names are counted all the same.
    table = CornerTable(("im_3", "im_2"), ("1",) * 2, ("board",) * 2, ("0", "1"), uv, uv)
    after, _ = matched(table, [board], ["0.2", "0.3", "0.7"], counted=True)
    assert after.image == ("0.7", "0.3")


@pytest.mark.parametrize(
    ("lens", "words"),
    [
        (
            "cam0:\n  camera_model: omni\n  intrinsics: [1.0, 900.0, 900.0, 640.0, 480.0]\n",
            "'omni' is not read; it is not used",
        ),
        (
            "K: [0, 0, 0, 0, 0, 0, 0, 0, 0]\nD: []\ndistortion_model: ''\n",
            "never calibrated; it is not used",
        ),
        (
            "K: [900, 0, 640, 0, 900, 480, 0, 0, 1]\nD: [1, 2, 3]\ndistortion_model: plumb_bob\n",
            "3 coefficients of distortion; it is not used",
        ),
    ],
)
def test_what_is_stated_of_a_lens_and_cannot_be_used_is_said(
    tmp_path: Path, lens: str, words: str
) -> None:
    T = hands(12, 5)
    written(tmp_path, pixels(T, on="base"), T)
    (tmp_path / "camchain.yaml").write_text(lens, encoding="utf-8")
    assert any(words in one for one in lc.init(tmp_path).remarks)


def test_corners_of_tags_stay_apart_in_files(tmp_path: Path) -> None:
    """Corner 0 of tag 4 is 4.0, which is no number 4."""
    T = hands(12, 5)
    written(tmp_path, pixels(T, on="base"), T)
    names = {p: f"{i // 4}.{i % 4}" for i, p in enumerate(POINTS)}
    rewritten(tmp_path / "points.csv", lambda row: [row[0], names[row[1]], *row[2:]])
    rewritten(tmp_path / "corners.csv", lambda row: [*row[:3], names[row[3]], *row[4:]])
    lc.init(tmp_path, out=tmp_path / "out")
    loaded = lc.load_dataset(lc.read_project(tmp_path / "out/project.toml"))
    assert {f"camera_1:board:{name}:u" for name in names.values()} <= {*loaded.dataset.readings}


def test_joints_named_as_a_robot_of_ros_names_them(tmp_path: Path) -> None:
    words = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
    q = np.random.default_rng(3).uniform(-1.0, 1.0, (20, 6))
    dh = "a [mm],d [mm],alpha [deg],theta [deg]\n0,89,90,0\n-425,0,0,0\n-392,0,0,0\n"
    (tmp_path / "dh.csv").write_text(f"{dh}0,109,90,0\n0,95,-90,0\n0,82,0,0\n", encoding="utf-8")
    arm = lc.init(dh=tmp_path / "dh.csv").mechanism
    noise = np.random.default_rng(4).normal(0.0, 1e-5, (20, 3))
    rows = np.column_stack([np.degrees(q), arm.fk(q)[:, :3, 3] + noise])
    head = ",".join([*(f"{word}_joint" for word in words), "x_m", "y_m", "z_m"])
    text = "\n".join([head, *(",".join(f"{v:.9f}" for v in row) for row in rows)])
    (tmp_path / "poses.csv").write_text(text + "\n", encoding="utf-8")
    project = lc.init(tmp_path / "poses.csv", dh=tmp_path / "dh.csv")
    assert project.rms < 3e-5


def test_the_size_of_images_goes_through_to_other_programs(tmp_path: Path) -> None:
    T = hands(12, 5)
    written(tmp_path, pixels(T, on="base"), T)
    lens = "fx: 900.0\nfy: 900.0\ncx: 640.0\ncy: 480.0\nwidth: 1300\nheight: 970\n"
    (tmp_path / "lens.yaml").write_text(lens, encoding="utf-8")
    lc.init(tmp_path, out=tmp_path / "out")
    result = lc.calibrate(tmp_path / "out/project.toml", method="implicit-loop")
    (text,) = lc.export(result, "camera_info").files.values()
    assert b"image_width: 1300\nimage_height: 970\n" in text


def test_a_fisheye_that_nobody_states_is_seen_as_one(tmp_path: Path) -> None:
    """Boards near a wide lens, by Kannala's formula."""
    random = np.random.default_rng(4)
    xyz = np.array([*POINTS.values()])
    turns = Rotation.from_euler("xyz", random.uniform(-35.0, 35.0, (30, 3)), degrees=True)
    places = random.uniform((-0.25, -0.2, 0.15), (0.1, 0.1, 0.3), (30, 3))
    P = np.einsum("nij,pj->pni", turns.as_matrix(), xyz) + places
    radius = np.hypot(P[..., 0], P[..., 1])
    angle = np.arctan2(radius, P[..., 2])
    far = 320.0 * angle * (1.0 + 0.02 * angle**2) / radius
    uv = np.stack([640.0 + far * P[..., 0], 480.0 + far * P[..., 1]], axis=1)
    written(tmp_path, uv + random.normal(0.0, 0.1, uv.shape), None)
    project = lc.init(tmp_path)
    assert any("It is taken as a fisheye" in one for one in project.remarks)
    assert "camera_1_k4" in project.mechanism.parameters.names
    assert "camera_1_p1" not in project.mechanism.parameters.names


def test_a_wide_lens_that_nobody_states_is_bent_by_eight_coefficients(tmp_path: Path) -> None:
    """Boards near a wide lens that is mounted askew, by OpenCV's formula."""
    random = np.random.default_rng(5)
    xyz = np.array([*POINTS.values()])
    turns = Rotation.from_euler("xyz", random.uniform(-35.0, 35.0, (30, 3)), degrees=True)
    places = random.uniform((-0.3, -0.25, 0.2), (0.15, 0.15, 0.3), (30, 3))
    P = np.einsum("nij,pj->pni", turns.as_matrix(), xyz) + places
    x, y = P[..., 0] / P[..., 2], P[..., 1] / P[..., 2]
    r2 = x**2 + y**2
    far = 560.0 * (1.0 + 0.9 * r2 + 0.12 * r2**2) / (1.0 + 1.22 * r2 + 0.32 * r2**2)
    p1, p2 = 560.0 * 1e-3, -560.0 * 8e-4
    u = 640.0 + far * x + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x**2)
    v = 480.0 + far * y + 2.0 * p2 * x * y + p1 * (r2 + 2.0 * y**2)
    uv = np.stack([u, v], axis=1)
    written(tmp_path, uv + random.normal(0.0, 0.1, uv.shape), None)
    project = lc.init(tmp_path)
    assert any("eight coefficients" in one for one in project.remarks)
    assert {"camera_1_p1", "camera_1_k6"} <= {*project.mechanism.parameters.names}


def test_a_prism_before_a_lens_is_seen_in_images_alone(tmp_path: Path) -> None:
    """Boards before a lens that is neither wide nor stated, by OpenCV's formula."""
    random = np.random.default_rng(6)
    xyz = np.array([*POINTS.values()])
    turns = Rotation.from_euler("xyz", random.uniform(-35.0, 35.0, (30, 3)), degrees=True)
    places = random.uniform((-0.25, -0.2, 0.5), (0.1, 0.1, 0.6), (30, 3))
    P = np.einsum("nij,pj->pni", turns.as_matrix(), xyz) + places
    x, y = P[..., 0] / P[..., 2], P[..., 1] / P[..., 2]
    r2 = x**2 + y**2
    u = 1300.0 * (x * (1.0 - 0.1 * r2) + 0.008 * r2) + 640.0
    v = 1300.0 * (y * (1.0 - 0.1 * r2) - 0.008 * r2) + 480.0
    uv = np.stack([u, v], axis=1)
    written(tmp_path, uv + random.normal(0.0, 0.05, uv.shape), None)
    project = lc.init(tmp_path)
    assert any("twelve coefficients" in one for one in project.remarks)
    assert "camera_1_s3" in project.mechanism.parameters.names


def test_corners_beyond_those_of_the_images_count_as_extrapolated(tmp_path: Path) -> None:
    T = hands(20, 5)
    uv = pixels(T, on="base")
    written(tmp_path, uv + np.random.default_rng(6).normal(0.0, 0.1, uv.shape), T)
    project = lc.init(tmp_path)
    noise = project.noise
    result = lc.calibrate(project.mechanism, project.dataset, noise=noise, method="implicit-loop")
    again = lc.predict(result, project.dataset)
    assert not again.extrapolated.any()
    moved = {**project.dataset.readings, "x": project.dataset.readings["x"] + 0.4}
    beyond = lc.predict(result, moved)
    assert beyond.extrapolated.sum() > 10
    assert "deg from its axis" in beyond.words()


def test_what_a_print_leaves_shows_no_other_lens(tmp_path: Path) -> None:
    """Of a print that is off by a pixel a fisheye left 1 % less than the usual lens."""
    shots(515, False).write(tmp_path)
    project = lc.init(tmp_path, dh=tmp_path / "dh.csv")
    names = {*project.mechanism.parameters.names}
    assert "cam_p1" in names
    assert names.isdisjoint({"cam_k4", "cam_k6"})


def test_lenses_that_are_not_read_are_named(tmp_path: Path) -> None:
    T = hands(12, 6)
    written(tmp_path, pixels(T, on="base"), T)
    text = "# Camera list\n1 SIMPLE_RADIAL 1600 1200 1352 799 599 -0.1\n"
    (tmp_path / "cameras.txt").write_text(text, encoding="utf-8")
    assert any("as COLMAP does, which is not read" in one for one in lc.init(tmp_path).remarks)


def flat(count: int) -> np.ndarray:
    """(N, 4, 4) of a hand that points downwards and turns about z alone."""
    T = hands(count, 5)
    angles = np.random.default_rng(5).uniform(-1.5, 1.5, count)
    T[:, :3, :3] = (
        Rotation.from_euler("z", angles[:, None]) * Rotation.from_euler("x", np.pi) * TOWARDS
    ).as_matrix()
    return T


TOWARDS = Rotation.from_matrix(hands(1, 5)[0, :3, :3])
ROBOT = "pose,x_mm,y_mm,z_mm,"


@pytest.mark.parametrize(
    ("names", "turns", "words"),
    [
        ("rx_deg,ry_deg,rz_deg", lambda R: (180.0, 0.0, -yaw(R)), "Rx Ry Rz"),
        ("yaw", lambda R: (yaw(R),), "yaw about z"),
        ("U", lambda R: (-yaw(R),), "U about -z"),
    ],
)
def test_a_hand_that_turns_about_z_alone(
    tmp_path: Path, names: str, turns: Callable[[Rotation], tuple[float, ...]], words: str
) -> None:
    """Turns of any order are by the same angles there: the images decide by where boards are."""
    T = flat(12)
    written(tmp_path, pixels(T, on="base"), T)

    def change(row: list[str]) -> list[str]:
        w, x, y, z = map(float, row[4:])
        return [*row[:4], *(f"{a:.9f}" for a in turns(Rotation.from_quat([x, y, z, w])))]

    rewritten(tmp_path / "robot.csv", change, ROBOT + names)
    table = read_places(tmp_path / "robot.csv")
    corners = of_table(read_corners(tmp_path / "corners.csv"), read_boards(tmp_path / "points.csv"))
    assert words in way_of_turning(table.ways, corners, {"1": LENS}, {})


def yaw(R: Rotation) -> float:
    turn = R * TOWARDS.inv() * Rotation.from_euler("x", -np.pi)
    return float(np.degrees(turn.as_rotvec()[2]))


def test_images_that_are_named_by_their_times(tmp_path: Path) -> None:
    """Each belongs to the row of the log that is nearest, whatever unit both are in."""
    T = hands(12, 5)
    written(tmp_path, pixels(T, on="base"), T)
    robot, corners = tmp_path / "robot.csv", tmp_path / "corners.csv"
    rewritten(robot, lambda row: [f"{1.7e9 + 2.0 * int(row[0]):.3f}", *row[1:]])
    robot.write_text(robot.read_text("utf-8").replace("pose,", "timestamp,", 1), encoding="utf-8")
    rewritten(corners, lambda row: [f"{int(1.7e12 + 2000 * int(row[0]) + 350)}", *row[1:]])
    made = lc.init(tmp_path)
    assert "poses nearest in time" in str(made)
    assert len(made.dataset) == 12


def test_what_has_no_image_or_no_pose_is_said(tmp_path: Path) -> None:
    T = hands(12, 5)
    written(tmp_path, pixels(T, on="base"), T)
    robot, corners = tmp_path / "robot.csv", tmp_path / "corners.csv"
    rows = robot.read_text("utf-8").splitlines()
    robot.write_text("\n".join([*rows[:-2], rows[-1]]) + "\n", encoding="utf-8")
    rows = corners.read_text("utf-8").splitlines()
    rows = [row for row in rows if not row.startswith(("3,", "4,"))]
    corners.write_text("\n".join(rows) + "\n", encoding="utf-8")
    words = str(lc.init(tmp_path))
    assert "2 poses without an image are left out: '3', '4'" in words
    assert "1 images without a pose or with too few corners are left out: '10'" in words


@pytest.mark.parametrize("moved", [0.0, 5.0])
def test_a_second_table_of_other_poses_is_named(tmp_path: Path, moved: float) -> None:
    T = hands(12, 5)
    written(tmp_path, pixels(T, on="base"), T)
    head, *rows = (tmp_path / "robot.csv").read_text("utf-8").splitlines()
    cells = [row.split(",") for row in rows[:9]]
    again = [",".join([pose, f"{float(x) + moved:.9f}", *rest]) for pose, x, *rest in cells]
    (tmp_path / "second.csv").write_text("\n".join([head, *again]) + "\n", "utf-8")
    said = [one for one in lc.init(tmp_path).remarks if "second.csv" in one]
    assert len(said) == (moved > 0.0)
    assert all("states 9 poses too, which are not used" in one for one in said)
