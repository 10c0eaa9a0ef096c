"""Several robots under one ground, each from a URDF of its own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import loopcal as lc
from loopcal.errors import Code
from loopcal.files.machines.mechanism_writer import mechanism_to_toml
from loopcal.mechanisms.frame import ChainFrame, matrices
from tests.refusals import refused

Array = NDArray[np.float64]
ARM = """<robot name="arm">
<link name="base"/><link name="upper"/><link name="hand"/>
<joint name="j1" type="revolute"><parent link="base"/><child link="upper"/>
<origin xyz="0 0 0.4"/><axis xyz="0 0 1"/><limit lower="-2" upper="2"/></joint>
<joint name="j2" type="revolute"><parent link="upper"/><child link="hand"/>
<origin xyz="0.5 0 0.1" rpy="1.5 0 0"/><axis xyz="0 0 1"/></joint></robot>
"""
CELL = """schema = 1
type = "tree"
fix_redundant = false

[[robot]]
file = "arm.urdf"
prefix = "left_"

[[robot]]
file = "arm.urdf"
prefix = "right_"
xyz = [1.2, 0.3, 0.0]
rpy = [0.0, 0.0, 3.0]

[[instrument]]
type = "held-part"
name = "part"
between = ["left_hand", "right_hand"]

[[instrument]]
type = "point"
name = "eye"
on = "left_hand"
"""


@pytest.fixture
def cell(tmp_path: Path) -> Path:
    """A mechanism file of two arms of one type."""
    (tmp_path / "arm.urdf").write_text(ARM, encoding="utf-8")
    path = tmp_path / "cell.toml"
    path.write_text(CELL, encoding="utf-8")
    return path


def turn(axis: int, angle: float) -> Array:
    """A rotation about x or z, (4, 4)."""
    T = np.eye(4)
    i, j = ((1, 2), (2, 0), (0, 1))[axis]
    T[[i, j], [i, j]], T[i, j], T[j, i] = np.cos(angle), -np.sin(angle), np.sin(angle)
    return T


def shift(x: float, y: float, z: float) -> Array:
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def hand(a: float, b: float) -> Array:
    """T_base_hand of one arm."""
    T: Array = shift(0, 0, 0.4) @ turn(2, a) @ shift(0.5, 0, 0.1) @ turn(0, 1.5) @ turn(2, b)
    return T


def test_robots_stand_beside_the_first_one(cell: Path) -> None:
    robot = lc.read_mechanism(cell)
    assert list(robot.joints) == ["left_j1", "left_j2", "right_j1", "right_j2"]
    mounted = [p.name for p in robot.parameters if p.name.startswith("right_mount")]
    assert sorted(mounted) == [f"right_mount_{e}" for e in ("rx", "ry", "rz", "x", "y", "z")]
    tree = robot.tree
    assert tree is not None
    assert tree.root == "left_base"
    q = {"left_j1": 0.3, "left_j2": -0.4, "right_j1": 1.1, "right_j2": 0.7}

    nominal = {p.name: p.nominal for p in robot.parameters}
    between = ChainFrame(tree.path("right_hand", "left_hand"), q, nominal)
    right = shift(1.2, 0.3, 0.0) @ turn(2, 3.0) @ hand(1.1, 0.7)
    expected = np.linalg.inv(hand(0.3, -0.4)) @ right
    np.testing.assert_allclose(matrices(between, 1)[0], expected, atol=1e-12)


def test_several_robots_are_written_as_bodies(cell: Path) -> None:
    robot = lc.read_mechanism(cell)
    again = cell.with_name("again.toml")
    again.write_text(mechanism_to_toml(robot), encoding="utf-8")
    same = lc.read_mechanism(again)
    assert same.parameters == robot.parameters
    assert str(same.tape) == str(robot.tape)


@pytest.mark.parametrize(
    ("old", "new", "code", "stated"),
    [
        ('prefix = "right_"', 'prefix = "left_"', "duplicate-name", "left_"),
        ('prefix = "left_"\n', 'prefix = "left_"\nxyz = [1, 0, 0]\n', "conflicting-keys", "ground"),
        ('"right_hand"', '"rigth_hand"', "unknown-name", "rigth_hand"),
        ("fix_redundant = false", 'file = "arm.urdf"', "conflicting-keys", "robot"),
        (', "right_hand"]', ', "left_upper"]', "missing-key", "no instrument looks"),
    ],
)
def test_what_does_not_fit_is_refused(
    cell: Path, old: str, new: str, code: Code, stated: str
) -> None:
    cell.write_text(CELL.replace(old, new, 1), encoding="utf-8")
    with refused(code, stated):
        lc.read_mechanism(cell)


def test_init_finds_where_the_other_robot_stands(cell: Path) -> None:
    """Stated 0.3 m and 0.2 rad off; a tracker sees both hands."""
    seen = """
[[instrument]]
type = "point"
name = "other"
on = "right_hand"
target = "other_target"
station = "base"
readings = ["other_x", "other_y", "other_z"]
"""
    held = CELL.index("[[instrument]]"), CELL.index('[[instrument]]\ntype = "point"')
    apart = f"{CELL[: held[0]]}{CELL[held[1] :]}{seen}"
    cell.write_text(apart, encoding="utf-8")
    robot = lc.read_mechanism(cell)
    joints = dict.fromkeys(robot.joints, (-1.2, 1.2))
    sds = lc.Noise(dict.fromkeys(robot.quantities, 1e-05))
    truth = {"right_mount_x": 0.9, "right_mount_rz": 2.8, "base_x": 1.0, "base_rz": 0.5}
    truth |= {"eye_target_x": 0.05} if "eye_target_x" in robot.parameters.names else {}
    truth |= {"other_target_y": 0.05}
    made = lc.simulate(robot, lc.random_poses(joints, 40, seed=1), noise=sds, seed=2, truth=truth)
    table = made.dataset
    names = list(robot.quantities)
    rows = [",".join(f"{q} [{robot.quantities[q]}]" for q in names)]
    rows += [",".join(f"{table[q][i]:.9f}" for q in names) for i in range(len(table))]
    (cell.parent / "seen.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    x = [q for q in robot.outputs if not q.startswith("other")]
    begun = lc.init(
        cell.parent / "seen.csv",
        machine=str(cell),
        observe=[
            f"point name=eye on=left_hand station=eye columns={','.join(x)}",
            "point name=other on=right_hand station=eye columns=other_x,other_y,other_z",
        ],
        out=cell.parent / "project",
    )
    assert np.isinf(begun.mechanism.parameters["right_mount_x"].prior_sd)
    assert begun.mechanism.parameters["right_j2_x"].prior_sd == pytest.approx(2e-3)
    result = lc.calibrate(cell.parent / "project" / "project.toml", method="implicit-loop")
    found = {p.name: (p.value, p.sd) for p in result.unjudged.parameters}
    assert result.status.converged
    assert found["right_mount_x"][0] == pytest.approx(0.9, abs=0.02)
    assert found["right_mount_rz"][0] == pytest.approx(2.8, abs=0.02)
