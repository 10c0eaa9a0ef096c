"""An update after another scale, where a length that the poses hardly show takes part in it: the
last axis of a palletiser is vertical, so its tool's height and that of its base are one. And where
the whole machine is let drift, which takes up most of a scale.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from analyses.gauntlet_asked import asked
from analyses.gauntlet_days import another_scale, made
from analyses.gauntlet_kinds import KINDS
from analyses.lives_truth import write_readings


@pytest.mark.parametrize(
    ("kind", "draw"), [("palletiser", 3), ("the fleet", 72003), ("the fleet", 72004)]
)
def test_a_scale_that_is_followed_is_stated_in_full(tmp_path: Path, kind: str, draw: int) -> None:
    user, rng = KINDS[kind].machine(draw), np.random.default_rng(7)
    for name, event in {"first": None, "later": another_scale}.items():
        day, _ = made(user, 40, rng, event)
        write_readings(tmp_path / f"{name}.csv", user, day.joints, day.points, day.columns)
    asked(tmp_path, "init", "first.csv", *user.description(tmp_path), "--run")
    done = asked(tmp_path, "update", "calibration/project-result", "later.csv", "--out", "updated")
    assert not done.returncode, done.stderr
    result = json.loads((tmp_path / "updated" / "result.json").read_text("utf-8"))
    assert result["verdict"]["sound"]["code"] == "scale-since"
    scale = min(result["scales"], key=lambda one: one["p_value"])
    assert abs(scale["size"] - 1e-4) < 4.0 * scale["sd"] < 6e-5
    # What either scale moves is s / 2^0.5 of some metres: 15 mm is what a tool's height says.
    asked(tmp_path, "predict", "updated", "later.csv", "--out", "there.csv")
    there = np.genfromtxt(tmp_path / "there.csv", delimiter=",", names=True, deletechars="")
    assert (there["sd_[m]"] < 5e-4).all()
