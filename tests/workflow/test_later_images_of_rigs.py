"""Another day of two cameras on one bracket, whose lenses were both refocused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import loopcal as lc

COLUMNS, ROWS, PITCH, IMAGE = 7, 5, 0.025, (1440, 1080)
FOCAL, SD = np.array([1400.0, 1550.0]), 0.15
BASELINE = np.array([0.3, 0.0, 0.02])


def day(folder: Path, seed: int, images: int, longer: float = 0.0) -> Path:
    """A folder of corners of a board that both cameras see, of lenses longer by this share."""
    random = np.random.default_rng(seed)
    y, x = np.divmod(np.arange(COLUMNS * ROWS), COLUMNS)
    points = PITCH * np.column_stack([x, y, 0.0 * x])
    inward = Rotation.from_rotvec([0.0, 0.35, 0.0])
    lines, shown = ["pose,camera,board,point,u_px,v_px"], 0
    while shown < images:
        about, tilt = random.uniform(0.0, 2.0 * np.pi), np.radians(random.uniform(10.0, 40.0))
        turn = Rotation.from_rotvec(tilt * np.array([np.cos(about), np.sin(about), 0.0]))
        z = random.uniform(0.6, 1.1)
        place = z * np.array([*random.uniform(-0.15, 0.15, 2), 1.0]) + [0.1, 0.0, 0.0]
        P = turn.apply(points - points.mean(axis=0)) + place
        both = []
        for f, seen in zip((1.0 + longer) * FOCAL, (P, inward.apply(P - BASELINE)), strict=True):
            uv = f * seen[:, :2] / seen[:, 2:] + (np.array(IMAGE) - 1.0) / 2.0
            both.append(uv + random.normal(0.0, SD, uv.shape))
        if all((uv > 0.0).all() and (uv < IMAGE).all() for uv in both):
            shown += 1
            lines += [
                f"{shown},cam{c},board,{k},{u:.4f},{v:.4f}"
                for c, uv in enumerate(both, 1)
                for k, (u, v) in enumerate(uv)
            ]
    folder.mkdir()
    (folder / "corners.csv").write_text("\n".join(lines) + "\n", "utf-8")
    lines = ["board,point,x_m,y_m,z_m"]
    lines += [f"board,{k},{a:.6f},{b:.6f},0" for k, (a, b, _) in enumerate(points)]
    (folder / "board.csv").write_text("\n".join(lines) + "\n", "utf-8")
    return folder


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> lc.Result:
    project = lc.init(day(tmp_path_factory.mktemp("rig") / "first", 1, 20))
    noise = project.noise
    return lc.calibrate(project.mechanism, project.dataset, noise=noise, method="implicit-loop")


@pytest.mark.parametrize("seed", range(2, 4))
def test_two_lenses_that_were_refocused_alike_are_named_together(
    first: lc.Result, seed: int, tmp_path: Path
) -> None:
    """With the distance of the board each hides the other: a principal point was named alone."""
    found = lc.verify(first, day(tmp_path / "later", seed, 12, 3e-3))
    assert found.changes is not None
    (change,) = found.changes.found
    assert change.name == "the focal lengths"
    for name, size in zip(("cam1_f", "cam2_f"), 3e-3 * FOCAL, strict=True):
        assert change.parts[name] == pytest.approx(size, abs=1.2)
    assert found.changes.code == "images-changed"


def test_lenses_that_stayed_are_as_calibrated(first: lc.Result, tmp_path: Path) -> None:
    found = lc.verify(first, day(tmp_path / "later", 7, 12))
    assert found.changes is not None
    assert not found.changes.found
