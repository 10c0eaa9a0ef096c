"""Without readings `init` writes a project that can be planned from."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

import loopcal as lc
from loopcal.errors import InputError, UsageError
from tests.command_line import run_here
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


@pytest.mark.parametrize("robot", [("--machine", "motoman-ma1400"), ("--dh", "dh.csv")])
def test_the_printed_command_plans_within_a_quarter_turn_where_nothing_states_limits(
    tmp_path: Path, robot: tuple[str, str]
) -> None:
    table = "joint,a [mm],d [mm],alpha [deg],theta [deg],kind\n1,150,450,-90,0,revolute\n"
    table += "2,600,0,0,-90,revolute\n3,0,50,90,0,prismatic\n"
    (tmp_path / "dh.csv").write_text(table, "utf-8")
    done = run_here("init", *robot, "--out", ".", cwd=tmp_path)
    assert "write the real limits before you plan" in done.stdout
    line = next(row.split()[1:] for row in done.stdout.splitlines() if "loopcal plan" in row)
    assert run_here(*line, "--poses", "8", cwd=tmp_path).returncode == 0
    project = lc.read_project(tmp_path / "project.toml")
    plan = json.loads((tmp_path / "project-plan/plan.json").read_text("utf-8"))
    for joint, unit in project.mechanism.joints.items():
        most = max(abs(pose["readings"][joint]) for pose in plan["poses"])
        assert 0.0 < most <= (0.5 * math.pi if unit == "rad" else 0.5)


def test_a_machine_with_closed_loops_is_begun_from_its_template(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="closed loops") as refused:
        lc.init(machine="stewart-gough", out=tmp_path)
    assert refused.value.command == "loopcal new my-stewart-gough --mechanism stewart-gough"


def test_recognised_readings_keep_what_was_stated_to_plan_with(tmp_path: Path) -> None:
    dh_arm.write_slipped(tmp_path)
    path = tmp_path / "project.toml"
    lc.init(urdf=tmp_path / "arm.urdf", out=tmp_path)
    stated = '[plan.ranges]\nJ1 = { from = -80, to = 80, unit = "deg" }\n'
    path.write_text(path.read_text("utf-8") + stated, "utf-8")
    line = ("init", "poses.csv", "--urdf", "arm.urdf", "--out", ".", "--force")
    assert run_here(*line, cwd=tmp_path).returncode == 0
    project = lc.read_project(path)
    assert project.data is not None
    assert project.plan.ranges == {"J1": pytest.approx((-math.radians(80), math.radians(80)))}


def test_without_a_robot_it_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="describes the robot"):
        lc.init(out=tmp_path)
