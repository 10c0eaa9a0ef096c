"""The calibrated kinematics as MJCF and SDF: bodies, joints, their limits and the tip.

Each joint's frame is placed in that of the joint before; the body behind it is called JOINT_link.
Masses are those of the URDF that the robot was read from: each of its links is a body fixed behind
its joint. Without them SDF states none, and MJCF states a bound, since MuJoCo refuses to load a
moving body without mass. Shapes are left out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from xml.sax.saxutils import escape, quoteattr

import numpy as np

from loopcal.arrays import Array
from loopcal.companions.robot.exports.format import ExportFiles, ExportOptions, Format
from loopcal.companions.robot.exports.urdf import decimal
from loopcal.document.exported import Exported
from loopcal.errors import listed
from loopcal.files.machines.urdf import MOMENTS, Inertial, read_inertials
from loopcal.mechanisms.rest import RestChain, RestJoint, quaternion

BOUND = 1e-6
"""[kg, kg m^2] least mass and inertia of bodies of which none is known."""
MASSES = "the URDF calibrated, for masses"


def mjcf(exported: Exported, options: ExportOptions) -> ExportFiles:
    """robot.xml, in MuJoCo's format."""
    chain = _chain(exported)
    weights = _weights(exported, options)
    light = "" if all(weights.values()) else f' boundmass="{BOUND}" boundinertia="{BOUND}"'
    lines = [
        f"<mujoco model={quoteattr(exported.name)}>",
        f'  <compiler angle="radian" autolimits="true"{light}/>',
        "  <worldbody>",
        '    <body name="base">',
    ]
    for depth, joint in enumerate(chain.joints):
        indent = "  " * (depth + 3)
        kind = "slide" if joint.kind == "prismatic" else "hinge"
        axis = _numbers(_sense(joint) * np.array(joint.axis))
        lines += [
            f"{indent}<body name={quoteattr(joint.name + '_link')} {_pos_quat(joint.before)}>",
            f'{indent}  <joint name={quoteattr(joint.name)} type="{kind}" axis="{axis}"'
            + (
                f' range="{_numbers(np.array(limits))}"'
                if (limits := _limits(exported, joint))
                else ""
            )
            + "/>",
            *(
                f"{indent}  <body name={quoteattr(one.name)} {_pos_quat(one.T @ one.inertial.T)}>"
                f'<inertial pos="0 0 0" mass="{decimal(one.inertial.mass)}" '
                f'fullinertia="{_numbers(np.array(one.inertial.moments))}"/></body>'
                for one in weights[joint.name]
            ),
        ]
    inside = "  " * (len(chain.joints) + 3)
    lines.append(f'{inside}<site name="tip" {_pos_quat(chain.tip)}/>')
    lines += ["  " * depth + "</body>" for depth in range(len(chain.joints) + 2, 1, -1)]
    lines.append("  </worldbody>")
    following = [joint for joint in chain.joints if _follows(joint)]
    # MuJoCo couples joints by a polynomial of degree four; all but its linear coefficient are zero.
    if following:
        lines.append("  <equality>")
        lines += [
            f"    <joint joint1={quoteattr(j.name)} joint2={quoteattr(j.reads)} "
            f'polycoef="0 {decimal(abs(j.factor))} 0 0 0"/>'
            for j in following
        ]
        lines.append("  </equality>")
    return ExportFiles(
        {"robot.xml": "\n".join([*lines, "</mujoco>", ""])},
        _warnings(exported, weights, bounded=bool(light)),
    )


def sdf(exported: Exported, options: ExportOptions) -> ExportFiles:
    """robot.sdf, of version 1.9, which knows quaternions."""
    chain = _chain(exported)
    weights = _weights(exported, options)
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
            f"      <axis><xyz>{axis}</xyz>{_limit(exported, joint)}</axis>",
            "    </joint>",
        ]
        for one in weights[joint.name]:
            moments = zip(MOMENTS, map(decimal, one.inertial.moments), strict=True)
            lines += [
                f"    <link name={quoteattr(one.name)}>",
                f"      {_pose(one.T, link)}",
                f"      <inertial>{_pose(one.inertial.T)}<mass>{decimal(one.inertial.mass)}</mass>",
                f"      <inertia>{''.join(f'<{k}>{v}</{k}>' for k, v in moments)}</inertia>",
                "      </inertial>",
                "    </link>",
                f'    <joint name={quoteattr(one.name + "_fixed")} type="fixed">',
                f"      <parent>{escape(link)}</parent>",
                f"      <child>{escape(one.name)}</child>",
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
    warnings = _warnings(exported, weights, bounded=False)
    return ExportFiles({"robot.sdf": "\n".join(lines)}, warnings)


def _chain(exported: Exported) -> RestChain:
    assert exported.chain is not None
    return exported.chain


@dataclass(frozen=True, eq=False)
class _Weight:
    """A link that weighs: its name, its frame T (4, 4) in that of the body that it is fixed to."""

    name: str
    T: Array
    inertial: Inertial


def _weights(exported: Exported, options: ExportOptions) -> dict[str, list[_Weight]]:
    """Joint of the chain -> links of the source that move with it."""
    joints = _chain(exported).joints
    weights: dict[str, list[_Weight]] = {joint.name: [] for joint in joints}
    if options.source is None or not exported.links:
        return weights
    stated = read_inertials(options.source)
    moves = {one.joint.name for one in exported.origins if one.joint.kind != "fixed"}
    body, ahead, behind = np.eye(4), iter(joints), ""
    for name, link in exported.links.items():
        if name in moves:
            joint = next(ahead)
            body, behind = body @ joint.before, joint.name
        if behind and name in stated:
            # T_body_link = T_base_body^-1 T_base_link.
            weight = _Weight(
                f"{name}_mass",
                np.asarray(np.linalg.solve(body, link), dtype=np.float64),
                stated[name],
            )
            weights[behind].append(weight)
    return weights


def _limits(exported: Exported, joint: RestJoint) -> tuple[float, float] | None:
    """Of the joint's motion; none of one that turns freely or follows another."""
    return None if _follows(joint) else exported.limits.get(joint.reads)


def _limit(exported: Exported, joint: RestJoint) -> str:
    limits = _limits(exported, joint)
    if limits is None:
        return "<limit/>"
    low, high = map(decimal, limits)
    return f"<limit><lower>{low}</lower><upper>{high}</upper></limit>"


def _warnings(
    exported: Exported, weights: Mapping[str, Sequence[_Weight]], *, bounded: bool
) -> tuple[str, ...]:
    """Which joints follow others, and what the file does not state."""
    joints = _chain(exported).joints
    following = [j for j in joints if _follows(j)]
    light = [joint.name for joint in joints if not weights[joint.name]]
    free = [j.name for j in joints if not _follows(j) and _limits(exported, j) is None]
    words = []
    if following:
        by = ", ".join(f"{j.name} by {decimal(abs(j.factor))} times {j.reads}" for j in following)
        words.append(f"These joints follow others, which the simulator has to command: {by}.")
    if light:
        least = f" MuJoCo takes {BOUND} kg and kg m2." if bounded else ""
        words.append(
            f"No mass and no sound inertia is known of: {listed(light)}.{least} State them."
        )
    if free:
        words.append(
            f"No limits are known of: {listed(free)}. State them where the joint has some."
        )
    return tuple(words)


def _sense(joint: RestJoint) -> float:
    """The sign of the axis: a factor of -1 turns it round."""
    return -1.0 if joint.factor < 0.0 else 1.0


def _follows(joint: RestJoint) -> bool:
    # A factor of -1 alone is no coupling: it turns the axis round (`_sense`).
    return joint.name != joint.reads or abs(joint.factor) != 1.0


def _numbers(values: Array) -> str:
    return " ".join(map(decimal, values.tolist()))


def _pos_quat(T: Array) -> str:
    return f'pos="{_numbers(T[:3, 3])}" quat="{_numbers(np.array(quaternion(T[:3, :3])))}"'


def _pose(T: Array, parent: str | None = None) -> str:
    # SDF has the real part last, MJCF first.
    w, *vector = quaternion(T[:3, :3])
    numbers = _numbers(np.array([*T[:3, 3], *vector, w]))
    seen = "" if parent is None else f" relative_to={quoteattr(parent)}"
    return f'<pose{seen} rotation_format="quat_xyzw">{numbers}</pose>'


_THEN = (
    "take the poses of the frames into your model; limits, masses and inertias are those of the "
    "URDF; shapes are left out"
)
FORMATS = tuple(
    Format(name, label, user, _THEN, write, source=MASSES, optional=True, described=True)
    for name, label, user, write in (
        ("mjcf", "kinematics for MuJoCo", "MuJoCo", mjcf),
        ("sdf", "kinematics for Gazebo (SDF 1.9)", "Gazebo", sdf),
    )
)
