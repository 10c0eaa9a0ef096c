"""Robots that programs for robotics toolboxes define are read as tables of their rows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from loopcal.files.recognition.dh_table import is_dh, read_dh
from loopcal.files.recognition.robot_listings import called_robot

ROWS = [  # a [m], d [m], alpha [rad], offset [rad]
    (0.15, 0.445, -np.pi / 2, 0.0),
    (0.7, 0.0, 0.0, -np.pi / 2),
    (0.0, 0.085, 0.0, 0.0),
]
CALLS = """% L(9) = Link('d', 9);
deg = pi/180;
L(1) = Link('d', 0.445, 'a', 0.15, ...
    'alpha', -pi/2, 'qlim', [-160 160]*deg);
L(2) = Link([0 0 0.7 0 0 -pi/2]);
L(3) = Link('revolute', 'd', 0.085);
robot = SerialLink(L, 'name', 'arm');
"""
CLASSES = """super().__init__([
    RevoluteDH(d=0.445, a=0.15, alpha=np.deg2rad(-90)),  # the waist
    rtb.RevoluteDH(a=0.7, offset=-90*deg, qlim=[-2, 2]),
    RevoluteDH(d=0.085)], name="arm")
"""
MATRIX = "robot = SerialLink([0 .445 .15 -1.5707963267948966; 0 0 .7 0 0 -pi/2; 0 .085 0 0]);"
TREE = """rows = [0.15 -pi/2 0.445 0;
    0.7 0 0 0
    0 0 0.085 0];
setFixedTransform(joint, rows(1,:), 'mdh');
"""


@pytest.mark.parametrize(
    ("name", "text"), [("arm.m", CALLS), ("arm.py", CLASSES), ("arm.txt", MATRIX)]
)
def test_joints_of_calls(tmp_path: Path, name: str, text: str) -> None:
    path = tmp_path / name
    path.write_text(text)
    assert is_dh(path)
    table = read_dh(path)
    np.testing.assert_allclose([(r.a, r.d, r.alpha, r.offset) for r in table.rows], ROWS)
    assert table.stated
    assert not table.modified


def test_a_tree_states_its_convention(tmp_path: Path) -> None:
    path = tmp_path / "arm.m"
    path.write_text(TREE)
    table = read_dh(path)
    expected = [(a, d, alpha, 0.0) for a, d, alpha, _ in ROWS]
    np.testing.assert_allclose([(r.a, r.d, r.alpha, r.offset) for r in table.rows], expected)
    assert table.modified


def test_a_slide(tmp_path: Path) -> None:
    """Its theta is constant, and its offset adds to d."""
    path = tmp_path / "arm.m"
    path.write_text("L(1) = Link([pi/2 0 0 pi/2 1 0.3]); L(2) = Revolute('a', 0.5);")
    slide, turn = read_dh(path).rows
    assert (slide.kind, turn.kind) == ("prismatic", "revolute")
    np.testing.assert_allclose([slide.d, slide.offset, slide.alpha], [0.3, np.pi / 2, np.pi / 2])


def test_other_programs_are_no_robots(tmp_path: Path) -> None:
    path = tmp_path / "loops.py"
    path.write_text("class Link(Base):\n    pass\nroot = Link(base)\n")
    assert not is_dh(path)


@pytest.mark.parametrize(
    "text",
    [
        "Link('" + "b" * 150_000 + "')",
        "Link(" + "a b, " * 30_000 + ")",
        "Link(" + "1" * 150_000 + ")",
        "".join(f"setFixedTransform(j, r{i}(1,:), 'dh'); " for i in range(4_000)),
        "L = Link([0 0 0 0]);" + " " * 300_000,
    ],
)
def test_a_program_that_defines_no_robot_is_put_aside_in_time(text: str, tmp_path: Path) -> None:
    path = tmp_path / "robot.m"
    path.write_text(text)
    assert called_robot(path) is None
