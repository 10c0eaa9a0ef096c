"""Poses of a later day are read as the images of the first day showed that they are stated."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import loopcal as lc
from loopcal.files.result import result_file
from loopcal.mechanisms.placement import inverse
from loopcal.workflow.checking import run_prediction
from tests.estimation.cameras.truth import Array, Shots, shots


def quaternions(T: Array) -> tuple[str, Array]:
    return "x,y,z,qx,qy,qz,qw", np.column_stack(
        [T[:, :3, 3], Rotation.from_matrix(T[:, :3, :3]).as_quat()]
    )


def inverted(T: Array) -> tuple[str, Array]:
    return quaternions(inverse(T))


def exchanged(T: Array) -> tuple[str, Array]:
    header, values = quaternions(T)
    return header.replace("qx,qy,qz,qw", "qw,qx,qy,qz"), values


def in_mm(T: Array) -> tuple[str, Array]:
    header, values = quaternions(T)
    return header, values * np.array([1e3, 1e3, 1e3, 1.0, 1.0, 1.0, 1.0])


def in_turns(T: Array) -> tuple[str, Array]:
    turns = Rotation.from_matrix(T[:, :3, :3]).as_euler("XYZ", degrees=True)
    return "x_m,y_m,z_m,rx_deg,ry_deg,rz_deg", np.column_stack([T[:, :3, 3], turns])


def table(path: Path, stated: tuple[str, Array]) -> Path:
    header, values = stated
    rows = [f"pose,{header}"]
    rows += [",".join([f"image {i}", *(f"{v:.9f}" for v in row)]) for i, row in enumerate(values)]
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")
    return path


def folder(path: Path, true: Shots, stated: tuple[str, Array]) -> Path:
    path.mkdir()
    table(path / "poses.csv", stated)
    corners = true.corners
    points = corners.boards[0].points.items()
    rows = ["board,point,x_m,y_m,z_m", *(f"board,{p},{x},{y},{z}" for p, (x, y, z) in points)]
    (path / "board.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    rows = ["pose,camera,board,point,u_px,v_px"]
    rows += [
        f"{corners.poses[i]},cam,board,{p},{u:.4f},{v:.4f}"
        for i, p, (u, v) in zip(corners.image, corners.point, corners.uv, strict=True)
    ]
    (path / "corners.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize("stated", [quaternions, inverted, exchanged, in_mm, in_turns])
def test_pixels_of_poses_without_images_are_where_they_were_seen(
    tmp_path: Path, stated: Callable[[Array], tuple[str, Array]]
) -> None:
    true = shots(4, held=False, images=14, noise=0.1)
    project = lc.init(folder(tmp_path / "images", true, stated(true.T)), out=tmp_path / "cal")
    assert ("flange = [" in project.text) == (stated is not quaternions)
    result = lc.calibrate(tmp_path / "cal" / "project.toml", method="implicit-loop")
    result_file.write_result(result, result.document, tmp_path / "cal")
    later = table(tmp_path / "later.csv", stated(true.T))
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        some = run_prediction(tmp_path / "cal", later, out=None)
    assert any("read as before" in str(one.message) for one in said) == (stated is not quaternions)
    seen = true.corners.uv.reshape(len(true.T), -1)
    np.testing.assert_allclose(np.stack([*some.outputs.values()], axis=1), seen, atol=1.0)
    corners = [name.removesuffix(":u") for name in some.outputs if name.endswith(":u")]
    assert 2 * len(corners) == len(some.outputs)
    # A table of all pairs of 144 corners had 41,616 columns, and took five minutes.
    of_corners = [
        f"covariance {c}:{a} {c}:{b}"
        for c in corners
        for b in "uv"
        for a in "uv"[: "uv".index(b) + 1]
    ]
    columns = [name.partition(" [")[0] for name in some.columns()]
    assert [name for name in columns if name.startswith("covariance")] == of_corners
    assert {pose["covariance"] for pose in some.document()["poses"]} == {None}


def test_a_unit_that_is_stated_later_counts(tmp_path: Path) -> None:
    true = shots(4, held=False, images=14, noise=0.1)
    lc.init(folder(tmp_path / "images", true, in_mm(true.T)), out=tmp_path / "cal")
    result = lc.calibrate(tmp_path / "cal" / "project.toml", method="implicit-loop")
    result_file.write_result(result, result.document, tmp_path / "cal")
    header, values = in_mm(true.T)
    later = table(tmp_path / "later.csv", (header.replace("x,y,z", "x_mm,y_mm,z_mm"), values))
    some = run_prediction(tmp_path / "cal", later, out=None)
    seen = true.corners.uv.reshape(len(true.T), -1)
    np.testing.assert_allclose(np.stack([*some.outputs.values()], axis=1), seen, atol=1.0)


@pytest.mark.parametrize(("off", "kept"), [(6e-3, True), (0.3, False)])
def test_images_whose_poses_err_more_are_left_to_the_calibration(
    tmp_path: Path, off: float, kept: bool
) -> None:
    """Two of 20 poses of another form of the arm were left out, and the rest was sound with sds of
    half the errors."""
    true, random = shots(4, held=False, images=20, noise=0.1), np.random.default_rng(1)
    T = true.T.copy()
    T[:, :3, 3] += 3e-4 * random.normal(size=(len(T), 3))
    T[[4, 11], :3, 3] += off * np.array([[0.6, 0.8, 0.0], [-0.8, 0.6, 0.0]])
    project = lc.init(folder(tmp_path / "images", true, quaternions(T)), out=tmp_path / "cal")
    assert "2 images (image 4, image 11) do not fit" in str(project)
    assert len(project.dataset) == (20 if kept else 18)
    if kept:
        result = lc.calibrate(tmp_path / "cal" / "project.toml")
        (sd,) = [one.sd for one in result.document.noise if "x" in one.quantities]
        assert 0.7 < sd / np.sqrt(3e-4**2 + 2.0 * off**2 / (3 * 20)) < 1.4
