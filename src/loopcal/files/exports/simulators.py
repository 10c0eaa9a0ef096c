"""The calibrated kinematics as MJCF and SDF: bodies, joints and the tip, without shapes and masses.

Each joint's frame is placed in that of the joint before; the body behind it is called JOINT_link.
Every moving body has a mass of 1 kg, since simulators refuse none: put in those of your robot.
"""

from __future__ import annotations

from collections.abc import Sequence
from xml.sax.saxutils import escape, quoteattr

import numpy as np
from numpy.typing import NDArray

from loopcal.document.exported import Exported
from loopcal.files.exports.format import ExportFiles, ExportOptions, Format
from loopcal.files.exports.urdf import decimal
from loopcal.mechanisms.rest import RestChain, RestJoint, quaternion

Array = NDArray[np.float64]


def mjcf(exported: Exported, options: ExportOptions) -> ExportFiles:
    """robot.xml, in MuJoCo's format."""
    chain = _chain(exported)
    lines = [
        f"<mujoco model={quoteattr(exported.name)}>",
        '  <compiler angle="radian" autolimits="true"/>',
        "  <worldbody>",
        '    <body name="base">',
    ]
    for depth, joint in enumerate(chain.joints):
        indent = "  " * (depth + 3)
        kind = "slide" if joint.kind == "prismatic" else "hinge"
        axis = _numbers(_sense(joint) * np.array(joint.axis))
        lines += [
            f"{indent}<body name={quoteattr(joint.name + '_link')} {_pos_quat(joint.before)}>",
            f'{indent}  <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>',
            f'{indent}  <joint name={quoteattr(joint.name)} type="{kind}" axis="{axis}"/>',
        ]
    inside = "  " * (len(chain.joints) + 3)
    lines.append(f'{inside}<site name="tip" {_pos_quat(chain.tip)}/>')
    lines += ["  " * depth + "</body>" for depth in range(len(chain.joints) + 2, 1, -1)]
    lines.append("  </worldbody>")
    following = [joint for joint in chain.joints if _follows(joint)]
    if following:
        lines.append("  <equality>")
        lines += [
            f"    <joint joint1={quoteattr(j.name)} joint2={quoteattr(j.reads)} "
            f'polycoef="0 {decimal(abs(j.factor))} 0 0 0"/>'
            for j in following
        ]
        lines.append("  </equality>")
    return ExportFiles(
        {"robot.xml": "\n".join([*lines, "</mujoco>", ""])}, _follow_words(following)
    )


def sdf(exported: Exported, options: ExportOptions) -> ExportFiles:
    """robot.sdf, of version 1.9, which knows quaternions."""
    chain = _chain(exported)
    lines = [
        '<?xml version="1.0"?>',
        '<sdf version="1.9">',
        f"  <model name={quoteattr(exported.name)}>",
        '    <link name="base"/>',
    ]
    parent = "base"
    for joint in chain.joints:
        link = joint.name + "_link"
        axis = _numbers(_sense(joint) * np.array(joint.axis))
        lines += [
            f"    <link name={quoteattr(link)}>",
            f"      {_pose(joint.before, parent)}",
            "    </link>",
            f'    <joint name={quoteattr(joint.name)} type="{joint.kind}">',
            f"      <parent>{escape(parent)}</parent>",
            f"      <child>{escape(link)}</child>",
            f"      <axis><xyz>{axis}</xyz>"
            "<limit><lower>-1e16</lower><upper>1e16</upper></limit></axis>",
            "    </joint>",
        ]
        parent = link
    lines += [
        f'    <frame name="tip" attached_to={quoteattr(parent)}>',
        f"      {_pose(chain.tip, parent)}",
        "    </frame>",
        "  </model>",
        "</sdf>",
        "",
    ]
    following = [joint for joint in chain.joints if _follows(joint)]
    return ExportFiles({"robot.sdf": "\n".join(lines)}, _follow_words(following))


def _chain(exported: Exported) -> RestChain:
    assert exported.chain is not None
    return exported.chain


def _sense(joint: RestJoint) -> float:
    """The sign of the axis: a factor of -1 turns it round."""
    return -1.0 if joint.factor < 0.0 else 1.0


def _follows(joint: RestJoint) -> bool:
    return joint.name != joint.reads or abs(joint.factor) != 1.0


def _follow_words(following: Sequence[RestJoint]) -> tuple[str, ...]:
    if not following:
        return ()
    words = ", ".join(f"{j.name} by {decimal(abs(j.factor))} times {j.reads}" for j in following)
    return (f"These joints follow others, which the simulator has to command: {words}.",)


def _numbers(values: Array) -> str:
    return " ".join(map(decimal, values.tolist()))


def _pos_quat(T: Array) -> str:
    return f'pos="{_numbers(T[:3, 3])}" quat="{_numbers(np.array(quaternion(T[:3, :3])))}"'


def _pose(T: Array, parent: str) -> str:
    w, *vector = quaternion(T[:3, :3])
    numbers = _numbers(np.array([*T[:3, 3], *vector, w]))
    return f'<pose relative_to={quoteattr(parent)} rotation_format="quat_xyzw">{numbers}</pose>'


FORMATS = (
    Format("mjcf", "kinematics for MuJoCo", mjcf),
    Format("sdf", "kinematics for Gazebo (SDF 1.9)", sdf),
)
