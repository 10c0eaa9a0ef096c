"""Images whose stated pose is wrong: `init` leaves them out, and a calibration names them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

import loopcal as lc
from analyses.cameras_truth import Shots, shots
from loopcal.estimation.cameras.facts import Fact
from loopcal.workflow.beginning.from_images import FromImages, from_images
from loopcal.workflow.beginning.images_project import UNEXPLAINED
from loopcal.workflow.beginning.initial import InitialProject
from loopcal.workflow.beginning.misfits import LeftOut

WRONG = 3
"""Position of the image whose pose is wrong."""


def _written(folder: Path, seed: int, off: float, far: float = 0.0) -> Shots:
    """Images with the pose of one of them off by so much [m], [rad], and its share of wrong
    corners."""
    one = shots(seed, held=True, images=16)
    T = one.rig.flange(one.read)
    T[WRONG, :3, 3] += off * np.array([1.0, -0.7, 0.4])
    uv, rng = one.uv.copy(), np.random.default_rng(seed)
    bad = rng.random(uv.shape[:2]) < far
    uv[bad] += rng.choice([-1.0, 1.0], (int(bad.sum()), 2)) * rng.uniform(3.0, 20.0, (bad.sum(), 2))
    folder.mkdir()
    one.write(folder, T=T, uv=uv)
    return one


def _left_out(project: InitialProject) -> bool:
    return any("Left out image" in words for words in project.remarks)


def test_an_image_with_a_wrong_pose_is_left_out_beside_wrong_corners(tmp_path: Path) -> None:
    one = _written(tmp_path / "images", 1, 0.03, 0.05)
    project = lc.init(tmp_path / "images")
    assert _left_out(project)
    assert len(project.dataset) == 15
    result = lc.calibrate(
        project.mechanism, project.dataset, noise=project.noise, method="implicit-loop"
    )
    f = {p.name: p for p in result.unjudged.parameters}["cam_f"]
    assert f.sd is not None
    assert abs(f.value - one.rig.lens[0]) < 4.0 * f.sd


def test_no_good_image_is_left_out(tmp_path: Path) -> None:
    _written(tmp_path / "images", 2, 0.0)
    project = lc.init(tmp_path / "images")
    assert not _left_out(project)
    assert len(project.dataset) == 16


def test_an_image_that_the_others_explain_is_not_said_not_to_fit(tmp_path: Path) -> None:
    _written(tmp_path / "images", 2, 0.0)
    made = from_images([tmp_path / "images"], None, None, tmp_path, named=False)
    sentence = "Image 3 does not fit."
    doubt = Fact(UNEXPLAINED, sentence, {}, ("3",))
    start = replace(made.project.begun, facts=(doubt,))
    begun = replace(made.begun, remarks=(sentence,))
    doubtful = FromImages(begun, made.project.begun_at(start))
    assert doubtful.clear_of(LeftOut({})).remarks == (sentence,)
    assert doubtful.clear_of(LeftOut({}, explained=frozenset("3"))).remarks == ()


def test_a_pose_that_hundreds_of_corners_hide_is_an_outlier(tmp_path: Path) -> None:
    one = shots(4, held=True, images=16)
    one.write(tmp_path, T=one.rig.flange(one.read))
    project = lc.init(tmp_path)
    data = project.dataset
    x = data["x"].copy()
    x[WRONG] += 0.005
    result = lc.calibrate(
        project.mechanism,
        data.with_readings({"x": x}),
        noise=project.noise,
        method="implicit-loop",
    )
    outliers = lc.find_outliers(result)
    assert [one.pose for one in outliers.found] == [data.poses[WRONG]]
    assert outliers.found[0].p_value < 1e-6


def test_an_image_that_was_taken_twice_hides_nothing(tmp_path: Path) -> None:
    one = shots(2, held=True, images=16)
    T, uv = one.rig.flange(one.read), one.uv.copy()
    T[8], uv[8] = T[WRONG], uv[WRONG]  # to the last digit, so that one row is a copy
    one.write(tmp_path, T=T, uv=uv)
    assert len(lc.init(tmp_path).dataset) == 16


def test_an_image_that_copies_another_is_named_and_left_out(tmp_path: Path) -> None:
    one = shots(5, held=True, images=16)
    uv = one.uv.copy()
    uv[WRONG] = uv[9]
    one.write(tmp_path, T=one.rig.flange(one.read), uv=uv)
    project = lc.init(tmp_path)
    assert any("Image 4 copies image 10" in words for words in project.remarks)
    assert _left_out(project)
    assert "4" not in project.dataset.poses


def test_a_board_that_was_moved_between_two_images_is_modelled(tmp_path: Path) -> None:
    one = shots(6, held=False, images=24)
    T, uv = one.rig.flange(one.read), one.uv.copy()
    fixed = one.rig.fixed.copy()
    fixed[:3, 3] += [0.003, -0.002, 0.0]
    moved = replace(one.rig, fixed=fixed)
    uv[12:] += (moved.pixels(one.rig.flange(one.q)) - one.rig.pixels(one.rig.flange(one.q)))[12:]
    one.write(tmp_path, T=T, uv=uv)
    project = lc.init(tmp_path)
    result = lc.calibrate(project.mechanism, project.dataset, noise=project.noise)
    changes = result.document.change_points
    assert changes is not None
    assert [(point.pose, point.modelled) for point in changes.found] == [("13", True)]
    f = {p.name: p for p in result.document.parameters}["cam_f"]
    assert f.sd is not None
    assert abs(f.value - one.rig.lens[0]) < 4.0 * f.sd
