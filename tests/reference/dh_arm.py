"""A six-axis arm by Denavit and Hartenberg in plain NumPy, its true parameters and its readings."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from loopcal.files.exports.tables import DenavitTable

NOMINAL = np.array(  # a [m], d [m], alpha [rad], theta [rad]
    [
        [0.15, 0.45, -np.pi / 2, 0.0],
        [0.60, 0.00, 0.0, -np.pi / 2],
        [0.12, 0.00, -np.pi / 2, 0.0],
        [0.00, 0.64, np.pi / 2, 0.0],
        [0.00, 0.00, -np.pi / 2, 0.0],
        [0.00, 0.10, 0.0, 0.0],
    ]
)
LIMITS = np.radians([120.0, 60.0, 60.0, 150.0, 100.0, 170.0])
SLIPPED = 31
"""The first pose after the reflector has slipped, of `write_slipped`."""
TARGET = np.array([0.05, -0.03, 0.12])


def pose(a: float, d: float, alpha: float, theta: float) -> np.ndarray:
    """Rz(theta) Tz(d) Tx(a) Rx(alpha), written out."""
    c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
    return np.array(
        [
            [c, -s * ca, s * sa, a * c],
            [s, c * ca, -c * sa, a * s],
            [0.0, sa, ca, d],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def table_pose(
    table: DenavitTable, readings: dict[str, float], *, modified: bool = False
) -> np.ndarray:
    """T_base_tip (4, 4) of a table at readings by quantity [m or rad]."""
    T = table.base
    for row in table.rows:
        moved = row.factor * readings[row.reads]
        slide, turned = (moved, 0.0) if row.kind == "prismatic" else (0.0, moved)
        d, theta = row.d + slide, row.theta + turned
        if modified:
            T = T @ pose(row.a, 0.0, row.alpha, 0.0) @ pose(0.0, d, 0.0, theta)
        else:
            T = T @ pose(row.a, d, row.alpha, theta)
    return T @ table.tool


def turn(rz: float, ry: float, rx: float) -> np.ndarray:
    """Rz Ry Rx, from elementary rotations."""
    return (pose(0, 0, 0, rz) @ np.linalg.inv(pose(0, 0, np.pi / 2, 0)) @ pose(0, 0, 0, ry))[
        :3, :3
    ] @ pose(0, 0, np.pi / 2 + rx, 0)[:3, :3]


def station() -> np.ndarray:
    """T_station_base."""
    T = np.eye(4)
    T[:3, :3] = turn(1.1, 0.02, -0.03)
    T[:3, 3] = (2.4, -0.7, -0.9)
    return T


def tool() -> np.ndarray:
    """T_flange_target."""
    T = np.eye(4)
    T[:3, :3] = turn(2.0, 0.4, -0.8)
    T[:3, 3] = TARGET
    return T


def poses(count: int = 90, seed: int = 1, limits: np.ndarray = LIMITS) -> np.ndarray:
    """Random joint angles (N, 6) [rad]."""
    return np.random.default_rng(seed).uniform(-limits, limits, size=(count, 6))


def seen(joints: np.ndarray, *, sd: float = 5e-5, turned: float = 0.0, seed: int = 2) -> np.ndarray:
    """T_station_target (N, 4, 4) of a machine 0.3 mm and 0.5 mrad off nominal, with noise."""
    rng = np.random.default_rng(seed)
    off = rng.standard_normal((6, 4)) * (3e-4, 3e-4, 5e-4, 5e-4)
    off[1, 1] = 0.0  # d of the second joint moves along the axis of the third
    true = NOMINAL + off
    found = []
    for q in joints:
        T = station()
        for (a, d, alpha, theta), angle in zip(true, q, strict=True):
            T = T @ pose(a, d, alpha, theta + angle)
        T = T @ tool()
        T[:3, 3] += sd * rng.standard_normal(3)
        if turned:
            T[:3, :3] = T[:3, :3] @ turn(*(turned * rng.standard_normal(3)))
        found.append(T)
    return np.array(found)


def dh_table() -> str:
    """The nominal table as CSV, in mm and degrees."""
    rows = ["joint,a [mm],d [mm],alpha [deg],theta [deg]"]
    for i, (a, d, alpha, theta) in enumerate(NOMINAL, 1):
        turns = np.degrees([alpha, theta])
        rows.append(f"J{i},{1e3 * a:g},{1e3 * d:g},{turns[0]:g},{turns[1]:g}")
    return "\n".join(rows) + "\n"


def urdf() -> str:
    """The same arm as a URDF, with a camera's frame and a gripper behind its flange."""
    lines = ['<robot name="arm">', '  <link name="base_link"/>']
    parent, twist = "base_link", 0.0
    xyz = (0.0, 0.0, 0.0)
    for i, (a, d, alpha, theta) in enumerate(NOMINAL, 1):
        # the link's frame lies at the joint's axis; Tz(d) Tx(a) Rx(alpha) begins the next origin
        R = pose(0, 0, twist, 0)[:3, :3] @ pose(0, 0, 0, theta)[:3, :3]
        with warnings.catch_warnings():  # of gimbal lock, where any of the angles will do
            warnings.simplefilter("ignore")
            angles = Rotation.from_matrix(R).as_euler("xyz")
        turned = " ".join(f"{angle:.17g}" for angle in angles)
        lines += [
            f'  <link name="link_{i}"/>',
            f'  <joint name="J{i}" type="revolute"><parent link="{parent}"/>'
            f'<child link="link_{i}"/><origin xyz="{xyz[0]} 0 {xyz[2]}" rpy="{turned}"/>'
            '<axis xyz="0 0 1"/><limit lower="-3.2" upper="3.2" effort="0" velocity="1"/></joint>',
        ]
        parent, twist, xyz = f"link_{i}", alpha, (a, 0.0, d)
    lines += [
        '  <link name="tool0"/><link name="camera"/><link name="finger"/>',
        f'  <joint name="flange" type="fixed"><parent link="{parent}"/><child link="tool0"/>'
        f'<origin xyz="{xyz[0]} 0 {xyz[2]}" rpy="{twist} 0 0"/></joint>',
        '  <joint name="mount" type="fixed"><parent link="tool0"/><child link="camera"/></joint>',
        '  <joint name="grip" type="prismatic"><parent link="tool0"/><child link="finger"/>'
        '<axis xyz="0 1 0"/><limit lower="0" upper="0.1" effort="0" velocity="1"/></joint>',
        "</robot>",
    ]
    return "\n".join(lines)


def write_slipped(folder: Path) -> None:
    """arm.urdf, and poses.csv of an arm whose reflector slips by 3 mm after 30 of 60 poses."""
    joints = poses(60)
    found, numbers = seen(joints), np.arange(1, 61)
    slip = np.where(numbers >= SLIPPED, 3e-3, 0.0)
    points = 1e3 * (found[:, :3, 3] + slip[:, None] * found[:, :3, 0])
    named = [*(f"J{i} [rad]" for i in range(1, 7)), "x [mm]", "y [mm]", "z [mm]"]
    rows = [
        ",".join([str(number), *(f"{value:.5f}" for value in row)])
        for number, row in zip(numbers, np.column_stack([joints, points]), strict=True)
    ]
    text = "\n".join([",".join(["pose", *named]), *rows]) + "\n"
    (folder / "poses.csv").write_text(text, "utf-8")
    (folder / "arm.urdf").write_text(urdf() + "\n", "utf-8")
