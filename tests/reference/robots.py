"""Robots of the test partners rtb-data and example-robot-data, where these are installed."""

from __future__ import annotations

import importlib.metadata
from pathlib import Path

import pytest

EXAMPLE = "cmeel.prefix/share/example-robot-data/robots"
RTB = "rtbdata/xacro"
ROBOTS = {
    "UR5": ("example-robot-data", f"{EXAMPLE}/ur_description/urdf/ur5_robot.urdf"),
    "UR10": ("example-robot-data", f"{EXAMPLE}/ur_description/urdf/ur10_robot.urdf"),
    "Panda": ("example-robot-data", f"{EXAMPLE}/panda_description/urdf/panda.urdf"),
    "Tiago": ("example-robot-data", f"{EXAMPLE}/tiago_description/robots/tiago_no_hand.urdf"),
    "Talos": ("example-robot-data", f"{EXAMPLE}/talos_data/robots/talos_left_arm.urdf"),
    "xArm7": ("example-robot-data", f"{EXAMPLE}/xarm_description/urdf/xarm7.urdf"),
    "iiwa": ("rtb-data", f"{RTB}/kuka_description/kuka_lbr_iiwa/urdf/lbr_iiwa_14_r820.urdf"),
    "Puma 560": ("rtb-data", f"{RTB}/unimation_puma560_description/urdf/puma560_robot.urdf"),
    "KR210": ("rtb-data", f"{RTB}/kuka_description/kuka_kr210/urdf/kr210l150.urdf"),
}
CHAINS = {
    "UR5": ("UR5", "base_link", "tool0"),
    "UR10": ("UR10", "base_link", "tool0"),
    "Panda": ("Panda", "panda_link0", "panda_hand"),
    "Panda, a finger": ("Panda", "panda_link0", "panda_rightfinger"),
    "iiwa": ("iiwa", "base_link", "tool0"),
    "Puma 560": ("Puma 560", "link1", "link7"),
    "xArm7": ("xArm7", "link_base", "link7"),
    "KR210": ("KR210", "base_link", "tool0"),
    "Tiago, from a lifting torso": ("Tiago", "base_link", "arm_tool_link"),
    "Talos, mimicking fingers": ("Talos", "arm_left_1_link", "gripper_left_fingertip_3_link"),
}
"""Robot, base and tip."""


def urdf_of(robot: str) -> Path:
    """The URDF of a robot; skips the test where the partner is not installed."""
    package, path = ROBOTS[robot]
    try:
        found = Path(str(importlib.metadata.distribution(package).locate_file(path)))
    except importlib.metadata.PackageNotFoundError:
        pytest.skip(f"{package} is not installed (make partners)")
    if not found.is_file():
        pytest.skip(f"{package} has no {path}")
    return found
