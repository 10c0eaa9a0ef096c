"""Without readings `init` writes a project that can be planned from."""

from __future__ import annotations

from pathlib import Path

import pytest

import loopcal as lc
from loopcal.errors import UsageError
from tests.reference import dh_arm


def test_a_robot_alone_is_a_project_to_plan_from(tmp_path: Path) -> None:
    dh_arm.write_slipped(tmp_path)
    made = lc.init(urdf=tmp_path / "arm.urdf", out=tmp_path)
    assert made.command == f"loopcal plan {(tmp_path / 'project.toml').as_posix()}"
    project = lc.read_project(tmp_path / "project.toml")
    assert project.data is None
    assert [*project.mechanism.joints] == [f"J{i}" for i in range(1, 7)]  # without the gripper
    plan = lc.plan(project.mechanism, 8, noise=made.noise)
    assert len(plan.poses) >= 8


def test_without_a_robot_it_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="describes the robot"):
        lc.init(out=tmp_path)
