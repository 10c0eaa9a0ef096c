"""One observation that contradicts the others is named with its size; honest ones are not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import loopcal as lc
from analyses.trees import touching
from loopcal.document.findings import ConflictEntry
from loopcal.statistics.conflicts import conflicts


def calibrated(folder: Path, draw: int, radius: str) -> lc.Result:
    """Two arms that touch each other under a tracker; radius: of the second ball, as stated."""
    world = touching(np.random.default_rng([draw, 0]))
    for name, text in {"bodies.csv": world.bodies + "\n", **world.files}.items():
        (folder / name).write_text(text, "utf-8")
    observe = [one.replace("58mm,58mm", f"58mm,{radius}") for one in world.observe]
    files = [folder / name for name in world.files]
    lc.init(*files, dh=folder / "bodies.csv", observe=observe, out=folder / "cell")
    return lc.calibrate(folder / "cell" / "project.toml", method="implicit-loop")


@pytest.mark.parametrize(("draw", "radius", "wrong"), [(0, "58mm", 0.0), (1, "58.2mm", 2e-4)])
def test_a_ball_that_is_not_as_large_as_stated_contradicts_the_tracker(
    tmp_path: Path, draw: int, radius: str, wrong: float
) -> None:
    """Its learnt sd takes the whole of it, so that no residual stands out."""
    result = calibrated(tmp_path, draw, radius)
    by_name = {one.instrument: one for one in conflicts(result)}
    assert by_name.keys() == {"touch", "a", "b"}
    assert min(by_name["a"].p_value, by_name["b"].p_value) > 0.01
    touch = by_name["touch"]
    codes = [finding.code for finding in result.document.findings or ()]
    if wrong:
        assert touch.p_value < 1e-6
        assert touch.apart == pytest.approx(wrong, rel=0.2)
        assert touch.alone == pytest.approx(5e-5, rel=0.3)
    else:
        assert touch.p_value > 0.01
    assert ("observations-conflict" in codes) is bool(wrong)


def test_a_conflict_is_what_an_observation_leaves_beyond_its_own_scatter() -> None:
    assert ConflictEntry("a", 5e-4, 3e-4, "m", 1e-9).apart == pytest.approx(4e-4)
    assert ConflictEntry("a", 3e-4, 5e-4, "m", 0.9).apart == 0.0


def test_one_observation_has_nothing_to_contradict() -> None:
    line = lc.Mechanism.from_function(
        lambda x, p: p.slope * x.q + p.zero - x.y,
        {"q": "m", "y": "m"},
        {"slope": (1.0, "1"), "zero": (0.0, "m")},
        outputs=("y",),
    )
    q = np.linspace(0.0, 1.0, 40)
    y = q + np.random.default_rng(2).normal(0.0, 1e-4, 40)
    noise = lc.Noise({"q": 1e-4, "y": 1e-4})
    assert conflicts(lc.calibrate(line, {"q": q, "y": y}, noise=noise)) == ()
