"""Calibrated origins for a robot that is written in xacro: values, and the lines that load them.

A xacro file is a program: which of its formulas makes an origin, nobody can tell from outside. So
it is not patched; its author replaces each calibrated <origin> by one line.
"""

from __future__ import annotations

from loopcal.companions.robot.exports.format import ExportFiles, ExportOptions, Format
from loopcal.companions.robot.exports.urdf import numbers, offsets
from loopcal.document.exported import Exported
from loopcal.mechanisms.rest import roll_pitch_yaw

_LOADER = (
    '<?xml version="1.0"?>',
    '<robot xmlns:xacro="http://www.ros.org/wiki/xacro">',
    """  <xacro:property name="calibration" value="${xacro.load_yaml('calibration.yaml')}"/>""",
    '  <xacro:macro name="calibrated_origin" params="joint">',
    """    <xacro:property name="its" value="${calibration['joints'][joint]}"/>""",
    """    <origin xyz="${its['xyz']}" rpy="${its['rpy']}"/>""",
    "  </xacro:macro>",
    "</robot>",
    "",
)


def xacro(exported: Exported, options: ExportOptions) -> ExportFiles:
    """calibration.yaml with xyz [m] and rpy [rad] of every origin; calibration.xacro loads it."""
    lines = [
        "# Origins of the calibrated joints: xyz in m, rpy in rad (Rz(yaw) Ry(pitch) Rx(roll)).",
        "joints:",
    ]
    tilted = []
    for one in exported.origins:
        xyz = numbers(one.T[:3, 3].tolist())
        rpy = numbers(roll_pitch_yaw(one.T[:3, :3], one.joint.rpy))
        name = one.joint.name.replace("'", "''")
        lines.append(f"  '{name}': {{xyz: '{xyz}', rpy: '{rpy}'}}")
        if one.axis != one.joint.axis:
            tilted.append(f'{one.joint.name}: <axis xyz="{numbers(one.axis)}"/>')
    words = (f"Enter these axes by hand: {'; '.join(tilted)}.",) if tilted else ()
    files = {"calibration.yaml": "\n".join([*lines, ""]), "calibration.xacro": "\n".join(_LOADER)}
    return ExportFiles({**files, **offsets(exported)}, words)


FORMATS = (
    Format(
        "xacro",
        "origins for a xacro robot, with the lines that load them",
        "a robot written in xacro",
        "include `calibration.xacro`, replace each `<origin .../>` by "
        '`<xacro:calibrated_origin joint="NAME"/>`',
        xacro,
        "origins",
        options=("offsets",),
    ),
)
