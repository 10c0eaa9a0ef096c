"""Programs of planned poses: what they drive to reads back, and what a format cannot hold is
refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from loopcal.companions.planning.plan_files import program_of_stops
from loopcal.companions.robot.programs.coordinates import JointAxes
from loopcal.companions.robot.programs.registry import WRITTEN, read_program
from tests.refusals import refused

ARMS = {
    "six turning": {f"q{i}": "rad" for i in range(1, 7)},
    "with a slide": {"q1": "rad", "q2": "rad", "q3": "m", "q4": "rad"},
}
STEP = {".ls": 0.5e-3, ".jbi": 0.5 / 1000.0}
"""What rounding leaves [deg, mm]; elsewhere a millionth."""


@pytest.mark.parametrize("ending", WRITTEN)
@pytest.mark.parametrize("arm", ARMS)
def test_planned_joints_read_back(arm: str, ending: str, tmp_path: Path) -> None:
    units = ARMS[arm]
    axes = JointAxes(units, pulses=(1000.0, -1000.0, 1500.0, 1000.0, 2000.0, 1000.0)[: len(units)])
    q = np.random.default_rng(3).uniform(-90.0, 90.0, (30, len(units))) * axes.scale
    path = tmp_path / f"measure_1{ending}"
    ids = [f"{i}, calibrate" for i in range(30)]
    path.write_bytes(program_of_stops(path, axes, q, ids, ("für ein Gerät",)))
    found = read_program(path, axes)
    assert not found.noted
    moves = [move for move in found.moves if move is not None]
    assert len(moves) == len(found.moves) == 30
    assert not any(move.straight for move in moves)
    driven = np.array([found.targets[move.target].joints for move in moves])
    assert driven == pytest.approx(q, abs=float((axes.scale * STEP.get(ending, 1e-6)).max()))


def test_what_a_format_cannot_hold_is_refused() -> None:
    six, none = JointAxes(ARMS["six turning"]), np.empty((0, 6))
    with refused("wrong-file-type", ".as", ".mod"):
        program_of_stops(Path("a.as"), six, none, (), ())
    for name in ("2nd.mod", "my plan.src", "x" * 33 + ".mod", "größe.ls"):
        with refused("invalid-value", name):
            program_of_stops(Path(name), six, none, (), ())
    with refused("missing-key", "--pulses-per-degree"):
        program_of_stops(Path("a.jbi"), six, none, (), ())
    seven = JointAxes({f"q{i}": "rad" for i in range(1, 8)})
    with refused("unsupported", "7"):
        program_of_stops(Path("a.mod"), seven, np.empty((0, 7)), (), ())
