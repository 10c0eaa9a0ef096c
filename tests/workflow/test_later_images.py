"""Another day of a calibrated camera, from a folder of its files: sound, moved, reprinted."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import loopcal as lc
from loopcal.arrays import Array
from loopcal.estimation.calibrate import calibrate
from loopcal.statistics import later_corners
from loopcal.statistics.verified import Verification
from loopcal.workflow.result import write_result
from tests.mechanisms import test_camera
from tests.mechanisms.test_camera import POINTS, hands, mechanism, pixels, placed, readings
from tests.refusals import refused
from tests.workflow.beginning.test_from_images import written

COUNT, SD = 12, 0.1
SPREAD = {name: name for name in ("pose", "camera", "board", "point", "u", "v")}
JOINED = {"file": "corners.csv", "pose": "pose", "spread": SPREAD}
INPUTS = {"data": {"file": "readings.csv", "pose": "pose", "join": [JOINED]}}
"""As `init` writes them."""


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The result of a calibration."""
    T = hands(COUNT, 5)
    uv = pixels(T, on="base") + np.random.default_rng(5).normal(0.0, SD, (len(POINTS), 2, COUNT))
    noise = lc.Noise({"[xyz]": 1e-5, "w?": 1e-5, "eye": SD})
    data = lc.Dataset.from_arrays(readings(T, uv))
    result = lc.calibrate(mechanism("base"), data, noise=noise, method="implicit-loop")
    folder = tmp_path_factory.mktemp("days") / "result"
    write_result(result, folder, title="camera", inputs=INPUTS, warnings=())
    return folder


def day(folder: Path, seed: int, count: int, stated: Array | None = None) -> Path:
    """A folder of files as `init` takes them, with positions in mm.

    stated: (n, 4, 4) poses in the file, in place of those that are.
    """
    T = hands(count, seed)
    noise = np.random.default_rng(seed).normal(0.0, SD, (len(POINTS), 2, count))
    written(folder, pixels(T, on="base") + noise, T if stated is None else stated)
    corners = folder / "corners.csv"
    corners.write_text(corners.read_text("utf-8").replace(",1,board", ",eye,board"), "utf-8")
    return folder


def verified(first: Path, folder: Path) -> Verification:
    return lc.verify(lc.read_result(first), folder)


def changes(done: Verification) -> list[str]:
    assert done.changes is not None
    return [change.name for change in done.changes.found]


def test_a_folder_of_another_day_is_read_as_that_of_the_first(first: Path, tmp_path: Path) -> None:
    done = verified(first, day(tmp_path, 7, 8))
    assert done.verdict["consistent"].passed
    assert changes(done) == []
    assert done.changes is not None
    candidates = [one.name for one in done.changes.candidates]
    assert len({*candidates}) == len(candidates)  # a focal length is no mounting as well
    assert done.calibrated is not None
    assert done.calibrated.rms < 3.0 * SD


def test_a_single_image_is_a_day_too(first: Path, tmp_path: Path) -> None:
    assert verified(first, day(tmp_path, 8, 1)).verdict["consistent"].passed


def test_a_moved_camera_is_named(
    first: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    x, y, z, rz, ry, rx = test_camera.FAR
    monkeypatch.setattr(test_camera, "FAR", (x + 0.004, y, z, rz, ry + 0.004, rx))
    folder = day(tmp_path, 7, 8)
    done = verified(first, folder)
    assert not done.verdict["consistent"].passed
    assert changes(done) == ["eye"]
    assert "(--anew eye)" in (done.verdict["consistent"].next or "")
    stated = lc.verify(lc.read_result(first), folder, remounted=["eye"])
    assert stated.verdict["consistent"].passed


@pytest.mark.parametrize("end", ["first", "last"])
def test_a_zero_of_a_robot_that_states_poses_is_among_what_is_named(
    first: Path, tmp_path: Path, end: str
) -> None:
    """Of the first joint it moves all poses in the base, of the last one in the flange: a camera or
    a board was blamed alone."""
    T, turn = hands(8, 7), np.eye(4)
    turn[:3, :3] = Rotation.from_rotvec([0.0, 0.0, np.radians(0.2)]).as_matrix()
    done = verified(
        first,
        day(tmp_path, 7, 8, np.array([turn @ one if end == "first" else one @ turn for one in T])),
    )
    answer = done.verdict["consistent"]
    assert answer.passed is False
    assert changes(done) == ["eye" if end == "first" else "board"]
    assert "the robot states other poses" in answer.words


def test_another_camera_is_named(
    first: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A lens of another focal length and principal point was three changes, or another machine."""
    lens = test_camera.LENS
    monkeypatch.setattr(
        test_camera,
        "LENS",
        replace(lens, fx=1.01 * lens.fx, fy=1.01 * lens.fy, cx=lens.cx - 12.0, cy=lens.cy + 9.0),
    )
    done = verified(first, day(tmp_path, 7, 8))
    assert done.changes is not None
    assert done.changes.code == "camera-exchanged"
    answer = done.verdict["consistent"]
    assert "eye is another camera" in answer.words
    assert "states other poses" not in answer.words


@pytest.mark.parametrize("off", [0.5, 1.0])
def test_half_a_pixel_each_way_is_another_count_of_pixels(
    first: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, off: float
) -> None:
    lens = test_camera.LENS
    shifted = replace(lens, cx=lens.cx + off, cy=lens.cy + off)
    monkeypatch.setattr(test_camera, "LENS", shifted)
    done = verified(first, day(tmp_path, 7, 25))
    assert done.changes is not None
    assert done.changes.code == ("pixels-counted" if off == 0.5 else "images-changed")
    assert ("counts pixels" in (done.verdict["consistent"].next or "")) == (off == 0.5)


def test_a_camera_is_shifted_as_its_centre_is_and_turned(
    first: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before, (x, y, z, rz, ry, rx) = placed(test_camera.FAR), test_camera.FAR
    R = placed((x, y, z, rz, ry + 0.004, rx))[:3, :3]
    centre = -before[:3, :3].T @ before[:3, 3] + [0.0, 0.002, 0.0]
    monkeypatch.setattr(test_camera, "FAR", (*(-R @ centre).tolist(), rz, ry + 0.004, rx))
    done = verified(first, day(tmp_path, 7, 8))
    assert done.changes is not None
    (change,) = done.changes.found
    assert change.low < 0.002 < change.high
    assert change.turn is not None
    turn, half = change.turn
    between = R @ before[:3, :3].T
    assert turn == pytest.approx(np.arccos(0.5 * (np.trace(between) - 1.0)), abs=1.5 * half)
    assert half < 0.2 * turn
    assert f"and turned by {np.degrees(turn):.2f} deg" in change.words
    assert np.linalg.norm(placed(test_camera.FAR)[:3, 3] - before[:3, 3]) > change.high


def test_a_pose_of_another_image_among_few_is_named(
    first: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = spoilt(day(tmp_path, 7, 8), 2)
    poses = (folder / "robot.csv").read_text("utf-8").splitlines()
    name, other = poses[3].split(",", 1)[0], poses[6].split(",", 1)[1]
    poses[3] = f"{name},{other}"
    (folder / "robot.csv").write_text("\n".join(poses) + "\n", "utf-8")
    fitted: list[lc.Dataset] = []

    def spy(start: lc.Mechanism, data: lc.Dataset, **options: Any) -> lc.FitResult:
        fitted.append(data)
        return calibrate(start, data, **options)

    monkeypatch.setattr(later_corners, "calibrate", spy)
    with pytest.warns(UserWarning, match="Image 2 does not fit"):
        done = verified(first, folder)
    assert len(done.outliers) == 1
    (data,) = fitted  # single corners are tested without this image, whose closing takes minutes
    assert (
        np.isnan(np.array([data[q] for q in data.readings if q.startswith("eye")])).all(0).sum()
        == 1
    )
    assert "Left out 2 of" in "\n".join(done.remarks)
    assert changes(done) == []
    assert done.calibrated is not None
    assert done.calibrated.rms < 3.0 * SD


def test_an_update_follows_a_moved_camera_and_its_turn(
    first: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    x, y, z, rz, ry, rx = test_camera.FAR
    moved = (x + 0.004, y, z, rz, ry + 0.004, rx)
    monkeypatch.setattr(test_camera, "FAR", moved)
    result = lc.update(lc.read_result(first), day(tmp_path, 7, 8))
    assert result.chi_squared is not None
    assert result.chi_squared.p_value is not None
    assert result.chi_squared.p_value > 1e-3
    for end, true in zip(("x", "y", "z", "rz", "ry", "rx"), moved, strict=True):
        sd = result.sd[f"eye_{end}"]
        assert sd is not None
        assert result.value[f"eye_{end}"] == pytest.approx(true, abs=4.0 * sd)


def on_a_bent_way(T: Array, share: float) -> Array:
    """Poses (n, 4, 4) as read a share of the way to the next, which begins aside of the chord: as
    that of joints, which bends by about their turn."""
    after = np.roll(T, -1, axis=0)
    after[-1] = T[-1]
    turn = np.linalg.inv(T) @ after
    vector = Rotation.from_matrix(turn[:, :3, :3]).as_rotvec()
    read = T.copy()
    chord = after[:, :3, 3] - T[:, :3, 3]
    w = np.einsum("nij,nj->ni", T[:, :3, :3], vector)
    read[:, :3, 3] += share * (chord + 0.5 * np.cross(w, chord))
    read[:, :3, :3] = T[:, :3, :3] @ Rotation.from_rotvec(share * vector).as_matrix()
    return read


@pytest.mark.parametrize("seed", [11, 12])
def test_poses_read_on_a_bent_way_are_named_as_that_alone(
    first: Path, tmp_path: Path, seed: int
) -> None:
    """They were another machine, or moves of camera and board along the run."""
    done = verified(first, day(tmp_path, seed, 20, on_a_bent_way(hands(20, seed), 0.02)))
    assert changes(done) == ["a delay towards the next pose"]
    assert done.verdict["consistent"].code == "poses-delayed"
    assert not done.shifts.found
    assert not done.outliers


def test_another_size_of_the_print_is_named(
    first: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    larger = {p: (1.01 * a, 1.01 * b, c) for p, (a, b, c) in POINTS.items()}
    monkeypatch.setattr(test_camera, "POINTS", larger)
    done = verified(first, day(tmp_path, 7, 8))
    assert not done.verdict["consistent"].passed
    assert changes(done) == ["board_scale"]
    assert "board_scale changed by" in done.headline
    assert "ppm" in done.headline
    assert "same print" in (done.verdict["consistent"].next or "")


def spoilt(folder: Path, number: int) -> Path:
    """The same with corners of so many images 15 px off."""
    lines = (folder / "corners.csv").read_text("utf-8").splitlines()
    for i in range(number):
        row = 1 + 9 * i  # of 8 images in turn, for each point
        cells = lines[row].split(",")
        cells[4] = f"{float(cells[4]) + 15.0}"
        lines[row] = ",".join(cells)
    (folder / "corners.csv").write_text("\n".join(lines) + "\n", "utf-8")
    return folder


def test_wrong_corners_are_left_out_with_a_word(first: Path, tmp_path: Path) -> None:
    done = verified(first, spoilt(day(tmp_path, 7, 8), 5))
    assert done.verdict["consistent"].passed
    assert f"Left out 5 of {8 * len(POINTS)} corners, in 5 of 8 images" in "\n".join(done.remarks)
    assert done.calibrated is not None
    assert done.calibrated.rms < 3.0 * SD


def test_an_update_leaves_wrong_corners_out_as_well(first: Path, tmp_path: Path) -> None:
    result = lc.read_result(first)
    for name in ("good", "bad"):
        (tmp_path / name).mkdir()
    good = lc.update(result, day(tmp_path / "good", 7, 8))
    spoiled = lc.update(result, spoilt(day(tmp_path / "bad", 7, 8), 5))
    for name in ("eye_f", "eye_x"):
        sd = good.sd[name]
        assert sd is not None
        assert spoiled.value[name] == pytest.approx(good.value[name], abs=0.3 * sd)
    assert any("Left out 5" in one for one in spoiled.warnings)


def test_turns_of_the_flange_are_no_conditions(first: Path) -> None:
    document = json.loads((first / "result.json").read_text("utf-8"))
    assert document["prediction"]["conditions"] == {}


def test_another_board_is_refused_with_the_point_that_differs(first: Path, tmp_path: Path) -> None:
    folder = day(tmp_path, 7, 3)
    text = (folder / "points.csv").read_text("utf-8").replace("0.04", "0.03")
    (folder / "points.csv").write_text(text, "utf-8")
    with refused("conflicting-keys", "'1'", "30", "40"):
        verified(first, folder)


def test_images_of_another_size_are_refused_with_their_factor(first: Path, tmp_path: Path) -> None:
    """Binned two by two: what a lens of half the focal length shows is no moved camera."""
    folder = day(tmp_path, 7, 8)
    head, *lines = (folder / "corners.csv").read_text("utf-8").splitlines()
    rows = [line.rsplit(",", 2) for line in lines]
    binned = [",".join([a, *(f"{(float(x) + 0.5) / 2 - 0.5:.4f}" for x in uv)]) for a, *uv in rows]
    (folder / "corners.csv").write_text("\n".join([head, *binned]) + "\n", "utf-8")
    with refused("conflicting-keys", "0.5 times", "u = (u + 0.5) / 0.5 - 0.5"):
        verified(first, folder)


def test_an_image_in_another_order_is_put_right_with_a_warning(first: Path, tmp_path: Path) -> None:
    folder = day(tmp_path, 7, 8)
    names = list(POINTS)
    lines = (folder / "corners.csv").read_text("utf-8").splitlines()
    for i, line in enumerate(lines):
        cells = line.split(",")
        if cells[0] == "3":
            cells[3] = names[len(names) - 1 - names.index(cells[3])]
            lines[i] = ",".join(cells)
    (folder / "corners.csv").write_text("\n".join(lines) + "\n", "utf-8")
    with pytest.warns(UserWarning, match="3 does not number"):
        done = verified(first, folder)
    assert done.verdict["consistent"].passed


def test_predictions_take_the_folder_as_well(first: Path, tmp_path: Path) -> None:
    result, folder = lc.read_result(first), day(tmp_path, 9, 3)
    done = result.predict(folder)
    T = hands(3, 9)
    true = pixels(T, on="base")[0, 0]
    assert done.outputs["eye:board:0:u"] == pytest.approx(true, abs=1.0)


def test_predictions_take_poses_without_images(first: Path, tmp_path: Path) -> None:
    result, folder = lc.read_result(first), day(tmp_path, 9, 3)
    alone = result.predict(folder / "robot.csv")
    assert alone.outputs["eye:board:0:u"] == pytest.approx(
        result.predict(folder).outputs["eye:board:0:u"], abs=1e-9
    )


def test_poses_whose_turns_only_images_decide_are_refused(first: Path, tmp_path: Path) -> None:
    table = tmp_path / "poses.csv"
    table.write_text("pose,x_mm,y_mm,z_mm,rx_deg,ry_deg,rz_deg\n1,10,20,300,10,20,30\n", "utf-8")
    with refused("conflicting-keys", "read in several ways"):
        lc.read_result(first).predict(table)
