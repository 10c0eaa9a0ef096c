"""Boards are read from Kalibr's targets, descriptions and tables of points."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from loopcal.files.cameras.boards import read_boards
from loopcal.files.cameras.folder import read_files
from loopcal.mechanisms.cameras.board import Pattern
from tests.refusals import refused


def written(folder: Path, text: str, name: str = "board.yaml") -> Path:
    (folder / name).write_text(text, "utf-8")
    return folder / name


def test_targets_of_kalibr(tmp_path: Path) -> None:
    text = """target_type: 'aprilgrid' #gridtype
tagCols: 6               #number of apriltags
tagRows: 5
tagSize: 0.088           # edge to edge [m]
tagSpacing: 0.3
"""
    board = read_boards(written(tmp_path, text))["board"]
    assert len(board.points) == 120
    assert np.allclose(board.points["6.0"], (0.0, 0.1144, 0.0))
    text = "target_type: checkerboard\ntargetCols: 6\ntargetRows: 7\n"
    text += "rowSpacingMeters: 0.06\ncolSpacingMeters: 0.05\n"
    board = read_boards(written(tmp_path, text))["board"]
    assert np.allclose(board.points["7"], (0.05, 0.06, 0.0))
    text = "target_type: circlegrid\ntargetCols: 3\ntargetRows: 4\nspacingMeters: 0.02\n"
    board = read_boards(written(tmp_path, text + "asymmetricGrid: True\n"))["board"]
    assert board.pattern == Pattern("asymmetric circles", 3, 4)
    assert np.allclose(board.points["3"], (0.02, 0.02, 0.0))


def test_a_charuco_board_as_a_project_and_others_state_it(tmp_path: Path) -> None:
    stated = {"type": "charuco", "squares": [5, 7], "square": 36.195, "marker": 18.256}
    stated |= {"unit": "mm", "dictionary": "6X6_250", "legacy": True}
    board = read_boards(written(tmp_path, json.dumps(stated)))["board"]
    text = "rows: 7\ncols: 5\nchessboard_dim: 0.036195\naruco_marker_dim: 0.018256\n"
    other = read_boards(written(tmp_path, text + "dictionary: 10\nlegacy_pattern: true\n"))["board"]
    assert np.allclose(board.xyz, other.xyz)
    assert board.pattern is not None
    assert other.pattern is not None
    assert board.pattern.legacy
    assert (other.pattern.legacy, other.pattern.dictionary) == (True, "6X6_250")


def test_a_checkerboard_as_the_text_of_rwhec_states_it(tmp_path: Path) -> None:
    text = "\tchess_mm_height 28\n\n\tchess_mm_width 30.5\nchess_height 6\nchess_width 8\n"
    path = written(tmp_path, text, "calibration_object.txt")
    written(tmp_path, "image,camera,point,u,v\na,1,0,5.5,6.5\na,1,1,7.5,8.5\n", "corners.csv")
    board = read_files([tmp_path]).boards["board"]
    assert board.pattern == Pattern("checkerboard", 8, 6)
    assert board.points["9"] == pytest.approx((0.0305, 0.028, 0.0))
    path.write_text(text.replace("chess_width 8", "chess_width 8.5"), "utf-8")
    with refused("invalid-value", "calibration_object.txt", "chess_width", "8.5"):
        read_files([tmp_path])


@pytest.mark.parametrize(("unit", "factor"), [("inch", 0.0254), ("cm", 0.01), ("um", 1e-6)])
def test_a_board_in_any_unit_is_one_in_a_folder(tmp_path: Path, unit: str, factor: float) -> None:
    written(tmp_path, f"point,x_{unit},y_{unit},z_{unit}\n0,0,0,0\n1,2,3,0\n", "print.csv")
    written(tmp_path, "image,camera,point,u,v\na,1,0,5.5,6.5\na,1,1,7.5,8.5\n", "corners.csv")
    points = read_files([tmp_path]).boards["board"].points
    assert points["1"] == pytest.approx((2.0 * factor, 3.0 * factor, 0.0))


def test_points_of_several_boards_in_a_table(tmp_path: Path) -> None:
    text = "board,point,x [mm],y [mm],z [mm]\nleft,9,1,2,3\nleft,14,4,5,6\nright,9,7,8,9\n"
    boards = read_boards(written(tmp_path, text, "board.csv"))
    assert list(boards) == ["left", "right"]
    assert boards["left"].points["14"] == (0.004, 0.005, 0.006)
    text = "id;x_m;y_m\n0;0,00;0\n1;0,03;0\n"
    board = read_boards(written(tmp_path, text, "board.csv"))["board"]
    assert board.points == {"0": (0.0, 0.0, 0.0), "1": (0.03, 0.0, 0.0)}


@pytest.mark.parametrize(
    ("name", "text", "code", "stated"),
    [
        ("b.csv", "point,x_m,y_m\n0,0,0\n0,1,1\n", "duplicate-name", ("row 3", "'0'")),
        ("b.csv", "point,x_m,y_m\n0,0,\n1,1,1\n", "missing-reading", ("row 2",)),
        ("b.csv", "point,x_m,y_m\n0,0,a\n1,1,1\n", "invalid-number", ("row 2", "'y_m'", "'a'")),
        ("b.csv", "point,u,v\n0,0,1\n1,1,1\n", "missing-column", ("x_m", "'u'")),
        ("b.yaml", "type: hexagons\n", "unknown-name", ("'hexagons'", "charuco")),
        ("b.yaml", "type: checkerboard\ncolumns: 3\n", "missing-key", ("rows",)),
        ("b.yaml", "type: circles\ncolumns: 3\nrows: 3\nspacing: -1\n", "invalid-value", ("-1",)),
    ],
)
def test_faults_are_named_with_their_place(
    name: str, text: str, code: str, stated: tuple[str, ...], tmp_path: Path
) -> None:
    with refused(code, name, *stated):  # type: ignore[arg-type]
        read_boards(written(tmp_path, text, name))


@pytest.mark.parametrize(
    "text",
    [
        "target_finder:\n  type: rct_ros_tools::ModifiedCircleGridTargetFinderPlugin\n  rows: 4\n"
        "  cols: 3\n  spacing: 0.02\n",
        "type: industrial_calibration::ModifiedCircleGridTargetFinderPlugin\nrows: 4\ncols: 3\n"
        "spacing: 0.02\n",
        "target_definition:\n  rows: 4\n  cols: 3\n  spacing: 0.02\n",
    ],
)
def test_targets_of_industrial_calibration_and_robot_cal_tools(tmp_path: Path, text: str) -> None:
    (tmp_path / "target.yaml").write_text(text, "utf-8")
    (board,) = read_boards(tmp_path / "target.yaml").values()
    assert len(board.points) == 12
    assert board.points["11"] == pytest.approx((0.04, 0.06, 0.0))


def test_keys_are_words_however_they_are_joined(tmp_path: Path) -> None:
    path = tmp_path / "board.json"
    text = '{"squaresX": 4, "squares_y": 3, "squareLength": 0.02'
    path.write_text(f'{text}, "markerLength": 0.014, "dictionary": "DICT_4X4_50"}}', "utf-8")
    (board,) = read_boards(path).values()
    assert board.pattern is not None
    assert (board.pattern.kind, len(board.points)) == ("charuco", 6)
    path.write_text(f"{text}}}", "utf-8")  # a board of squares, whose inner corners are seen
    (board,) = read_boards(path).values()
    assert board.pattern is not None
    assert (board.pattern.kind, len(board.points)) == ("checkerboard", 6)
