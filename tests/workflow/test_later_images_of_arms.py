"""Another day of an arm with a camera on its hand: joints are read, the board lies elsewhere."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import loopcal as lc
from analyses.cameras_truth import Rig, Shots, motion, poses, shots
from analyses.gauntlet_truth import turned_by
from loopcal.statistics.verified import Verification

IMAGES = 8


def files(rig: Rig, seed: int, folder: Path, images: int = IMAGES) -> Path:
    """A folder of images of a rig, with the table of the robot among them."""
    rng = np.random.default_rng([48, seed])
    q = poses(rig, images, rng)
    uv = rig.pixels(rig.flange(q))
    read = q + rig.encoder * rng.normal(size=q.shape)
    Shots(rig, q, read, uv + rig.corner * rng.normal(size=uv.shape)).write(folder)
    return folder


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> tuple[Rig, Path]:
    """A rig and its calibration."""
    folder = tmp_path_factory.mktemp("arm")
    made = shots(37, held=False, images=25)
    made.write(folder / "day-1")
    lc.init(folder / "day-1", dh=folder / "day-1" / "dh.csv", out=folder / "c")
    result = lc.calibrate(folder / "c" / "project.toml", method="implicit-loop")
    result.save(folder / "result")
    return made.rig, folder / "result"


def verified(first: Path, folder: Path) -> Verification:
    return lc.verify(lc.read_result(first), folder)


def turned(rig: Rig, angle: float, shift: tuple[float, float, float]) -> Rig:
    """The same with its board turned about its normal, and moved."""
    moved = motion(np.eye(3), np.array(shift)) @ rig.fixed
    turn = turned_by(np.array([[0.0, 0.0, angle]]))[0]
    return replace(rig, fixed=moved @ motion(turn, np.zeros(3)))


@pytest.mark.parametrize("angle", [0.0, 3.1])
def test_wherever_the_board_is_put_the_arm_is_as_calibrated(
    first: tuple[Rig, Path], angle: float, tmp_path: Path
) -> None:
    rig, result = first
    done = verified(result, files(turned(rig, angle, (0.1, -0.3, -0.2)), 1, tmp_path / "day-2"))
    assert done.verdict["consistent"].passed
    assert done.calibrated is not None
    assert done.calibrated.rms < 6.0 * rig.corner


def test_a_zero_that_moved_is_named(first: tuple[Rig, Path], tmp_path: Path) -> None:
    rig, result = first
    links = list(rig.arm.links)
    links[2] = replace(links[2], offset=links[2].offset + np.radians(0.2))
    bent = replace(turned(rig, 0.5, (0.0, 0.1, 0.0)), arm=replace(rig.arm, links=tuple(links)))
    done = verified(result, files(bent, 2, tmp_path / "day-2"))
    assert not done.verdict["consistent"].passed
    assert done.changes is not None
    (change, *_) = done.changes.found
    assert "theta_3" in change.zeros


def test_a_zero_is_named_where_corners_are_missing(first: tuple[Rig, Path], tmp_path: Path) -> None:
    rig, result = first
    links = list(rig.arm.links)
    links[2] = replace(links[2], offset=links[2].offset + np.radians(0.2))
    folder = files(replace(rig, arm=replace(rig.arm, links=tuple(links))), 3, tmp_path / "day-2")
    (corners,) = [one for one in folder.iterdir() if one.name == "readings.csv"]
    head, *lines = corners.read_text("utf-8").splitlines()
    seen = np.random.default_rng(3).random(len(lines)) > 0.1
    rest = [line for line, kept in zip(lines, seen.tolist(), strict=True) if kept]
    corners.write_text("\n".join([head, *rest]) + "\n", "utf-8")
    done = verified(result, folder)
    assert done.verdict["consistent"].code == "re-master"
    assert done.changes is not None
    assert [change.name for change in done.changes.found] == ["theta_3"]


def scattered(verification: Verification) -> dict[str, float]:
    changes = verification.changes
    assert changes is not None
    assert not verification.shifts.found
    assert not verification.verdict["consistent"].passed
    return dict(changes.scatter)


def test_a_zero_is_named_beside_joints_that_scatter(
    first: tuple[Rig, Path], tmp_path: Path
) -> None:
    rig, result = first
    links = list(rig.arm.links)
    links[2] = replace(links[2], offset=links[2].offset + np.radians(0.3))
    shaken = replace(rig, encoder=15.0 * rig.encoder, arm=replace(rig.arm, links=tuple(links)))
    done = verified(result, files(shaken, 5, tmp_path / "day-2", images=15))
    scatter = scattered(done)
    assert [*scatter] == ["joints"]
    assert 8.0 < scatter["joints"] < 30.0
    assert done.changes is not None
    (change,) = done.changes.found
    assert "theta_3" in change.zeros


@pytest.mark.parametrize(
    ("shaken", "seed", "scatters", "least", "most"),
    [
        # Six of the 96 equations of an image see the joints, so that the test of all says nothing.
        ({"encoder": 4.0}, 8, "joints", 2.0, 8.0),
        ({"corner": 3.0}, 6, "readings", 2.7, 3.3),
    ],
)
def test_what_scatters_is_no_change(
    first: tuple[Rig, Path],
    tmp_path: Path,
    shaken: dict[str, float],
    seed: int,
    scatters: str,
    least: float,
    most: float,
) -> None:
    rig, result = first
    noisy = replace(rig, **{name: times * getattr(rig, name) for name, times in shaken.items()})
    done = verified(result, files(noisy, seed, tmp_path / "day-2", images=15))
    scatter = scattered(done)
    assert [*scatter] == [scatters]
    assert least < scatter[scatters] < most
    assert done.changes is not None
    assert not done.changes.found


def test_images_that_were_cut_are_followed(first: tuple[Rig, Path], tmp_path: Path) -> None:
    """The earlier images were held against the principal point of today, 200 px elsewhere."""
    rig, result = first
    folder = files(rig, 7, tmp_path / "day-2")
    (corners,) = [one for one in folder.iterdir() if one.name == "readings.csv"]
    head, *lines = corners.read_text("utf-8").splitlines()
    column = head.split(",").index("u_px")
    cells = [line.split(",") for line in lines]
    for row in cells:
        row[column : column + 2] = (
            f"{float(v) - by:.4f}"
            for v, by in zip(row[column : column + 2], (160.0, 120.0), strict=True)
        )
    corners.write_text("\n".join([head, *map(",".join, cells)]) + "\n", "utf-8")
    before = lc.read_result(result)
    with pytest.warns(UserWarning, match="as images do that were cut"):
        after = lc.update(before, folder)
    assert after.chi_squared is not None
    assert after.chi_squared.value < 1.2 * after.chi_squared.degrees_of_freedom
    (eye,) = [name.removesuffix("_cx") for name in after.value if name.endswith("_cx")]
    for name, by in (("cx", 160.0), ("cy", 120.0)):
        (old,) = [one.value for one in before.document.parameters if one.name == f"{eye}_{name}"]
        assert after.value[f"{eye}_{name}"] == pytest.approx((old or 0.0) - by, abs=3.0)


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("images shuffled", "order of the rows"),
        ("joints half in radians", "in another unit"),
        ("camera not read again", "repeat the corners of another image"),
    ],
)
def test_a_later_file_that_no_pose_explains_is_refused_like_a_first_one(
    first: tuple[Rig, Path], fault: str, words: str, tmp_path: Path
) -> None:
    """Minutes passed, and then the camera and the board seemed to have moved by 200 mm."""
    rig, result = first
    folder = files(rig, 9, tmp_path / "day-2", images=12)
    poses, corners = folder / "poses.csv", folder / "readings.csv"
    head, *rows = (line.split(",") for line in poses.read_text("utf-8").splitlines())
    top, *seen = (line.split(",") for line in corners.read_text("utf-8").splitlines())
    names = [row[0] for row in rows]
    if fault == "images shuffled":
        other = dict(zip(names, np.random.default_rng(0).permutation(names).tolist(), strict=True))
        seen = [[other[row[0]], *row[1:]] for row in seen]
    elif fault == "joints half in radians":
        factor = np.radians(1.0) if "deg" in head[1] else np.degrees(1.0)
        turned = [[row[0], *(f"{float(q) * factor:.9g}" for q in row[1:])] for row in rows[6:]]
        rows = [*rows[:6], *turned]
    else:
        last = [row for row in seen if row[0] == names[5]]
        kept = [row for row in seen if row[0] in names[:6]]
        seen = [*kept, *([name, *row[1:]] for name in names[6:] for row in last)]
    for path, lines in ((poses, [head, *rows]), (corners, [top, *seen])):
        path.write_text("".join(",".join(line) + "\n" for line in lines), "utf-8")
    with pytest.raises(lc.InputError) as caught:
        verified(result, folder)
    assert caught.value.code == "mismatched-poses"
    assert words in str(caught.value)
