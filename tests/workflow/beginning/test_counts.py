"""Counts of encoders without zeros and counts per turn are solved by the nominal machine."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import loopcal as lc
from analyses.layouts import World, described, of, predicted_error, written, xyz


@pytest.mark.parametrize("robot", ["six", "gantry"])
def test_counts_become_joints(tmp_path: Path, robot: str) -> None:
    world, rng = World(robot, 4), np.random.default_rng(4)
    described(world, tmp_path)
    n = world.q.shape[1]
    per_unit = np.exp(rng.uniform(np.log(3e4), np.log(1e6), n)) * rng.choice([-1.0, 1.0], n)
    per_unit = np.where(world.slides, 1e6, per_unit)
    zeros = np.round(rng.uniform(-1.0, 1.0, n) * per_unit)
    names = [f"J{i + 1}" for i in range(n)]
    counts = np.round(world.read * per_unit + zeros)
    data = tmp_path / written(tmp_path / "a.csv", {**of(names, counts), **xyz("{}", world.points)})
    made = lc.init(data, dh=tmp_path / "dh.csv", out=tmp_path)
    (words,) = (one for one in made.remarks if "counts of encoders" in one)
    assert "--joints '" in words
    scales = [p.name for p in made.mechanism.parameters if p.name.endswith("_scale")]
    assert len(scales) == n
    # Later readings are counts too. Angles alone would have let the tracker's 0.03 mm through.
    fresh = of(names, world.fresh * per_unit + zeros)
    assert predicted_error(tmp_path, fresh, world.target(world.fresh)) < 6e-5


def test_angles_are_no_counts(tmp_path: Path) -> None:
    world = World("six", 4)
    described(world, tmp_path)
    columns = {**of([f"J{i + 1}" for i in range(6)], world.shown(world.read))}
    data = tmp_path / written(tmp_path / "a.csv", {**columns, **xyz("{}", world.points)})
    made = lc.init(data, dh=tmp_path / "dh.csv")
    assert not any("counts" in words for words in made.remarks)
