"""Hand-eye samples as tables with both poses in a row, and as ViSP's files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import loopcal as lc
from loopcal.arrays import Array
from loopcal.errors import UsageError
from loopcal.mechanisms.placement import inverse
from loopcal.workflow.beginning.initial import InitialProject
from tests.workflow.beginning.test_from_samples import EYE, MARKER, samples


def quaternion(T: Array) -> Array:
    return np.hstack([T[:, :3, 3], Rotation.from_matrix(T[:, :3, :3]).as_quat()])


def vector(T: Array) -> Array:
    return np.hstack([T[:, :3, 3], Rotation.from_matrix(T[:, :3, :3]).as_rotvec()])


def degrees(T: Array) -> Array:
    turns = Rotation.from_matrix(T[:, :3, :3]).as_rotvec(degrees=True)
    return np.hstack([1e3 * T[:, :3, 3], turns])


def placed(project: InitialProject) -> None:
    values = {p.name: p.nominal for p in project.mechanism.parameters}
    for name, T in (("camera", inverse(EYE[False])), ("marker", MARKER[False])):
        np.testing.assert_allclose([values[f"{name}_{k}"] for k in "xyz"], T[:3, 3], atol=3e-3)


QUATERNION = ("x", "y", "z", "qx", "qy", "qz", "qw")


@pytest.mark.parametrize(
    ("robot", "marker", "columns", "written"),
    [
        ("rob_", "cam_", QUATERNION, quaternion),
        ("robot_", "marker_", QUATERNION, quaternion),
        ("", "tag_", QUATERNION, quaternion),
        ("flange_", "tag_", ("x", "y", "z", "rx", "ry", "rz"), vector),
        ("tcp_", "aruco_", ("x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg"), degrees),
    ],
)
def test_both_poses_in_a_row(
    tmp_path: Path,
    robot: str,
    marker: str,
    columns: tuple[str, ...],
    written: Callable[[Array], Array],
) -> None:
    hand, seen = samples(on_hand=False)
    head = ",".join([*(robot + c for c in columns), *(marker + c for c in columns)])
    rows = [",".join(f"{v:.9f}" for v in row) for row in np.hstack([written(hand), written(seen)])]
    (tmp_path / "samples.csv").write_text("\n".join([head, *rows]) + "\n", encoding="utf-8")
    placed(lc.init(tmp_path / "samples.csv"))


def test_files_of_visp(tmp_path: Path) -> None:
    for name, T in zip(("rPe", "cPo"), samples(on_hand=False), strict=True):
        for i, row in enumerate(vector(T), 1):
            lines = ["rows: 6", "cols: 1", "data:", *(f"  - [{v:.9f}]" for v in row)]
            path = tmp_path / f"pose_{name}_{i}.yaml"
            path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    project = lc.init(tmp_path)
    assert len(project.dataset) == len(samples(on_hand=False)[0])
    placed(project)


def test_a_table_of_one_pose_is_no_sample(tmp_path: Path) -> None:
    hand, _ = samples(on_hand=False)
    head = ",".join(f"rob_{c}" for c in QUATERNION)
    rows = [",".join(f"{v:.9f}" for v in row) for row in quaternion(hand)]
    (tmp_path / "samples.csv").write_text("\n".join([head, *rows]) + "\n", encoding="utf-8")
    with pytest.raises(UsageError):
        lc.init(tmp_path / "samples.csv")
