"""Straight moves: right at their ends, and in between as targets are inserted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import loopcal as lc
from analyses import corrected as loops
from analyses.gauntlet_truth import drawn
from loopcal.deployment.inverse import solve
from loopcal.deployment.rigid import between, moved

NAMES = [f"q{i}" for i in range(1, 7)]
ROWS = ["above,20,-10,15,40,50,-30,joint", "across,55,-5,-5,30,60,-10,linear"]


@pytest.fixture(scope="module")
def result() -> lc.Result:
    arm = loops.drawing(loops.ARMS["six-axis"])
    rng = np.random.default_rng(5)
    truth = {p.name: p.nominal + 2e-3 * rng.standard_normal() for p in arm.parameters}
    joints = dict(zip(NAMES, drawn(loops.BOXES["six-axis"], 40, rng).T, strict=True))
    noise = lc.Noise(dict.fromkeys(NAMES, 2e-5) | dict.fromkeys("xyz", 2e-5))
    made = lc.simulate(arm, joints, noise=noise, seed=1, truth=truth)
    return lc.calibrate(arm, made.dataset, noise=noise, method="implicit-loop")


def program(tmp_path: Path) -> Path:
    path = tmp_path / "line.csv"
    head = ",".join(["pose", *(f"{name} [deg]" for name in NAMES), "move"])
    path.write_text("\r\n".join([head, *ROWS, ""]), newline="")
    return path


def off(done: lc.Correction, q: np.ndarray, wanted: np.ndarray) -> float:
    """The largest error [m] on the controller's line between two corrected targets."""
    arms, worst = done.arms, 0.0
    ends = arms.controller(q)
    for share in np.linspace(0.05, 0.95, 19):
        pose = moved(ends[:1], between(ends[:1], ends[1:]), float(share))
        joints = solve(arms.controller, pose, q[:1] + share * (q[1:] - q[:1])).joints
        aim = moved(wanted[:1], between(wanted[:1], wanted[1:]), float(share))
        error = between(aim, arms.machine(joints))[0, :3]
        worst = max(worst, float(np.linalg.norm(error)))
    return worst


def test_the_error_in_between_is_that_of_the_machine_on_the_controllers_line(
    result: lc.Result, tmp_path: Path
) -> None:
    done = lc.correct(result, program(tmp_path))
    (move,) = done.moves
    assert (move.begin, move.end, move.line) == (0, 1, 3)
    assert move.error > 1e-5
    found = off(done, done.corrected.joints, done.corrected.targets.poses)
    assert move.error == pytest.approx(found, rel=0.1)
    assert "1 straight move" in str(done)
    assert done.document()["straight_moves"][0]["error"] == move.error


def test_inserted_targets_bring_it_below_the_bound(result: lc.Result, tmp_path: Path) -> None:
    path = program(tmp_path)
    before = lc.correct(result, path).moves[0].error
    done = lc.correct(result, path, bounds=lc.CorrectionBounds(line=before / 10.0))
    (move,) = done.moves
    assert len(move.inserted) == 3  # the error falls with the square of the length
    assert move.error < before / 10.0
    lines = done.content.decode().split("\r\n")
    assert [line.split(",")[0] for line in lines] == [
        "pose", "above", "across-1", "across-2", "across-3", "across", "",
    ]  # fmt: skip
    q = np.radians([[float(v) for v in line.split(",")[1:7]] for line in lines[1:-1]])
    assert q[1:-1] == pytest.approx(move.inserted, abs=1e-8)
    T = done.corrected.targets.poses
    way = between(T[:1], T[1:])
    wanted = np.concatenate([moved(T[:1], way, share) for share in (0.0, 0.25, 0.5, 0.75, 1.0)])
    assert done.arms.machine(q) == pytest.approx(wanted, abs=1e-8)
    assert max(off(done, q[i : i + 2], wanted[i : i + 2]) for i in range(4)) < before / 10.0


def test_a_bound_that_cannot_be_held_inserts_nothing(result: lc.Result, tmp_path: Path) -> None:
    done = lc.correct(result, program(tmp_path), bounds=lc.CorrectionBounds(line=1e-12))
    assert not len(done.moves[0].inserted)
    assert done.content.count(b"\r\n") == 3
