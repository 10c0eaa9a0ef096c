"""The clock of an instrument that drifts against that of the joints."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import loopcal as lc
from loopcal.files.project.new_project import write_new_project
from loopcal.files.tables.recording import Recording, Series
from loopcal.workflow.beginning import delays
from tests.bags import HOLD, MOVE, motion


def test_a_clock_that_drifts_is_sized(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The recording is short for the test; analyses/bag_delays.py counts how often the sds hold."""
    write_new_project(tmp_path, "urdf")
    urdf, rng = tmp_path / "robot.urdf", np.random.default_rng(6)
    drawn = lc.load_urdf(urdf)
    off = {
        n: replace(p, nominal=p.nominal + 1e-3 * rng.normal()) for n, p in drawn.parameters.items()
    }
    robot = replace(drawn, parameters=off)
    poses = rng.uniform(-1.0, 1.0, (16, 6))
    end = len(poses) * (HOLD + MOVE)
    t = np.arange(0.0, end, 0.04)
    q = motion(poses, t) + 1e-4 * rng.normal(size=(len(t), 6))
    seen = np.arange(0.01, end, 0.05)
    T = robot.fk(motion(poses, seen - 0.037 - 1e-3 * (seen - 0.5 * end)))
    points = T[:, :3, :3] @ [0.03, 0.02, 0.1] + T[:, :3, 3] + 1e-4 * rng.normal(size=(len(seen), 3))
    joints = {n: Series(1e3 + t, q[:, [i]], (n,)) for i, n in enumerate(drawn.quantities)}
    measured = {"/p": Series(1e3 + seen, points, ("x [m]", "y [m]", "z [m]"))}
    recording = Recording(joints, measured)
    (short,) = lc.init(recording, urdf=urdf).delays
    assert short.drift is None
    monkeypatch.setattr(delays, "_LONG", 20.0)
    (made,) = lc.init(recording, urdf=urdf).delays
    assert made.drift is not None
    assert 0.0 < made.drift_sd < 3e-5
    assert abs(made.drift - 1e-3) < 4.0 * made.drift_sd
    assert abs(made.value - 0.037) < 4.0 * made.sd
    assert "the clocks drift apart" in str(made)


def test_a_delay_is_shown_to_the_digits_of_its_sd() -> None:
    assert "is 0.0002 ms (sd 0.0022 ms)" in str(delays.Delay("/tracker", 2.213e-7, 2.2e-6, 39))
    assert "by -3 ppm of the time (sd 12 ppm)" in str(
        delays.Delay("/t", 0.037, 1e-5, 9, -3.2e-6, 1.2e-5)
    )
