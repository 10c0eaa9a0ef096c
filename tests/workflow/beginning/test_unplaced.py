"""Tables that turn a target before a tracker, and closed loops that cannot close as read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import loopcal as lc


def test_a_table_of_one_axis_is_calibrated(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    turns = rng.uniform(-3.0, 3.0, 30)
    points = np.array([180 * np.cos(turns), 180 * np.sin(turns), 80 + 0 * turns]).T
    points = points @ np.array([[0.8, 0.6, 0.0], [-0.6, 0.8, 0.0], [0.0, 0.0, 1.0]]).T + 2000
    table = np.column_stack([np.degrees(turns), points + 0.015 * rng.standard_normal((30, 3))])
    path = tmp_path / "table.csv"
    np.savetxt(path, table, delimiter=",", header="C [deg],x [mm],y [mm],z [mm]", comments="")
    drawing = tmp_path / "dh.csv"
    drawing.write_text("joint,a [mm],d [mm],alpha [deg],theta [deg]\nC,0,0,0,0\n")
    project = lc.init(str(path), dh=str(drawing))
    assert 1e3 * project.rms < 0.04
    result = lc.calibrate(project)
    assert result.status.converged


def test_columns_that_let_no_loop_close_are_named(tmp_path: Path) -> None:
    """A delta whose second slide counts the other way round stands nowhere as read."""
    rng = np.random.default_rng(2)
    points = np.column_stack([rng.uniform(-70, 70, (30, 2)), rng.uniform(0, 200, 30)])
    angles = np.radians([-150.0, -30.0, 90.0])
    feet = 140.0 * np.column_stack([np.cos(angles), np.sin(angles)])
    away = np.linalg.norm(points[:, None, :2] - feet, axis=2)
    slides = points[:, 2:] + np.sqrt(300.0**2 - away**2)
    slides[:, 1] *= -1.0
    path = tmp_path / "delta.csv"
    table = np.column_stack([slides, points[:, [1, 2, 0]] + 1000.0])
    header = "slide_1 [mm],slide_2 [mm],slide_3 [mm],x [mm],y [mm],z [mm]"
    np.savetxt(path, table, delimiter=",", header=header, comments="")
    with pytest.raises(lc.InputError, match="slide_2 counts the other way round") as caught:
        lc.init(str(path), machine="linear-delta")
    assert "inf" not in str(caught.value)
    assert caught.value.options[0] == "--joints"
    table[:, :3] = rng.uniform(2000.0, 9000.0, (30, 3))
    np.savetxt(path, table, delimiter=",", header=header, comments="")
    with pytest.raises(lc.InputError, match="loops do not close"):
        lc.init(str(path), machine="linear-delta")
