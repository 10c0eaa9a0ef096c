"""Figures of machines with platforms: points and angles apart, legs as lines of their own."""

from __future__ import annotations

import numpy as np
import pytest

import loopcal as lc
from analyses.machines import CASES
from loopcal.report.drawn import figures
from loopcal.report.source import source_of


@pytest.mark.parametrize(
    ("name", "trace", "lines"),
    [
        ("3-RRR, pose", "scatter", 4),
        ("Stewart-Gough, pose", "scatter3d", 8),
        ("rotary delta, point", "scatter3d", 3),
    ],
)
def test_points_are_drawn_beside_the_machine_and_angles_are_not_lengths(
    name: str, trace: str, lines: int
) -> None:
    case = CASES[name]
    mechanism = case.made()
    sds = {q: 1e-5 if unit == "m" else 1e-2 for q, unit in mechanism.quantities.items()}
    sds |= {q: 1e-5 for q in sds if q.startswith(("theta", "leg"))}
    noise = lc.Noise(sds | dict.fromkeys(case.unread(mechanism), np.inf))
    poses = lc.random_poses(case.driven, 40, seed=1)
    made = lc.simulate(mechanism, poses, noise=noise, seed=1)
    result = lc.calibrate(mechanism, made.dataset, noise=noise, method="implicit-loop")
    drawn = figures(source_of(result, result.document, "out"))
    machine = next(t for t in drawn["arrows"].data if t["name"].startswith("machine"))
    assert machine["type"] == trace
    assert sum(value is None for value in machine["x"]) == lines - 1
    # points are read to 10 um, beside angles a thousand times worse
    assert result.accuracy_before is not None
    assert result.accuracy_before.max < 1e-3
    told = max(float(v) for v in drawn["histogram"].data[0]["x"])
    assert told == pytest.approx(1e3 * result.accuracy_before.max, rel=1e-3)
