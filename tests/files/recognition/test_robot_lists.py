"""Robots that a plain text lists line by line, several in one file."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import loopcal as lc
from loopcal.files.recognition.dh_table import is_dh, read_dh
from tests.refusals import refused

TEXT = """# Two robots, as of 2026
# T = Rz Tz Tx Rx; columns body, parent, reading, a, d, alpha, offset [m, rad]
[arm]                       # on a table
turn  base  q1   0     0.4  -90deg  0
reach turn  -q2  0.3   0    0       -0.5rad   # counts backwards
hand  reach -    0     0.1  0       0
note: the hand is 0.1 m long
[other one]
a1    base  r1   0.2   0.1  1.5707963  0
"""


@pytest.fixture
def robots(tmp_path: Path) -> Path:
    """A file of two robots."""
    path = tmp_path / "robots.txt"
    path.write_text(TEXT, encoding="utf-8")
    return path


def test_a_robot_is_named_behind_the_file(robots: Path) -> None:
    table = read_dh(f"{robots}[arm]")
    turn, reach, hand = table.rows
    assert (turn.body, turn.parent, turn.name, turn.d) == ("turn", "base", "q1", 0.4)
    assert turn.alpha == pytest.approx(-0.5 * math.pi)
    assert (reach.name, reach.direction) == ("q2", -1)
    assert reach.offset == pytest.approx(-0.5)
    assert (hand.kind, hand.name) == ("fixed", "")
    assert "no rows of the robot: 'note: the hand" in table.remarks[-1]
    (row,) = read_dh(f"{robots}[other one]").rows
    assert row.alpha == pytest.approx(0.5 * math.pi)
    assert is_dh(f"{robots}[arm]")


def test_of_several_robots_one_must_be_named(robots: Path) -> None:
    with refused("missing-key", "it lists 2 robots", "robots.txt[arm]"):
        read_dh(robots)
    with refused("unknown-name", "lists no robot 'arn'", "arm"):
        read_dh(f"{robots}[arn]")


def test_init_takes_a_listed_robot(robots: Path) -> None:
    rows = ["q1 [rad],q2 [rad],x [m],y [m],z [m]"]
    for a, b in np.random.default_rng(0).uniform(-1.0, 1.0, (20, 2)):
        angle = -b - 0.5
        out, down = 0.3 * math.cos(angle), 0.3 * math.sin(angle)
        hand = (math.cos(a) * out - 0.1 * math.sin(a), math.sin(a) * out + 0.1 * math.cos(a))
        rows.append(",".join(f"{v:.6f}" for v in (a, b, *hand, 0.4 - down)))
    (robots.parent / "seen.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    made = lc.init(
        robots.parent / "seen.csv",
        dh=f"{robots}[arm]",
        observe=["point name=eye on=hand columns=x,y,z"],
        out=robots.parent / "cell",
    )
    assert list(made.mechanism.joints) == ["q1", "q2"]
    result = lc.calibrate(robots.parent / "cell" / "project.toml", method="least-squares")
    assert result.document.accuracy is not None
    assert result.document.accuracy.after.rms < 2e-6
