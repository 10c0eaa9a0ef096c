"""Joints that follow others by bars: functions of their angles take up what bars are off by."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import loopcal as lc
from analyses.lives_parallel import PALLETISER, PALLETISER_BOX, PALLETISER_URDF

READINGS = ("J1", "J2", "J3", "J4")
BARS = 3e-4
"""sd of the lengths of cranks, bars and horns [m]."""


def arm(folder: Path) -> lc.Mechanism:
    path = folder / "robot.urdf"
    path.write_text(PALLETISER_URDF)
    return lc.assemble(lc.load_urdf(path, "base", "flange"), [lc.instruments.point("tracker")])


def columns(mechanism: lc.Mechanism) -> list[str]:
    return [n for term in mechanism.terms if term.name == "couplings" for n in term.parameters]


def read_from(folder: Path, urdf: str) -> lc.Mechanism:
    path = folder / "another.urdf"
    path.write_text(urdf)
    return lc.assemble(lc.load_urdf(path, "base", "flange"), [lc.instruments.point("tracker")])


SHAPES = ["cos", "sin", "sec", "tan"]
HELD = [
    *(f"J2_2_coupling_{angle}{shape}" for angle in ("", "J3_", "of_J3_") for shape in SHAPES),
    *(
        f"J3_2_coupling_{angle}{shape}"
        for angle in ("", "of_J2_", "of_J2_2_J3_")
        for shape in SHAPES
    ),
]
"""By the angles of the lower arm, of the forearm, and between both: bars hold the wrist against
the table, whatever the lower arm does."""


def test_joints_that_follow_are_held_by_every_angle_of_their_plane(tmp_path: Path) -> None:
    assert columns(lc.structured(arm(tmp_path))) == HELD


def test_only_joints_that_follow_another_are_coupled(tmp_path: Path) -> None:
    alone = PALLETISER_URDF.replace('<mimic joint="J2" multiplier="-1"/>', "")
    alone = alone.replace('<mimic joint="J3" multiplier="-1"/>', "")
    assert not columns(lc.structured(read_from(tmp_path, alone)))


def test_a_finger_of_joints_that_follow_one_reading_is_off_by_one_angle(tmp_path: Path) -> None:
    """Multiples of one angle count once."""
    follows = '<mimic joint="knuckle" multiplier="{}"/>'
    rows = [("knuckle", "base", "bone_1", ""), ("middle", "bone_1", "bone_2", follows.format(0.9))]
    rows.append(("tip", "bone_2", "bone_3", follows.format(0.6)))
    joints = "".join(
        f'<joint name="{name}" type="revolute"><parent link="{ahead}"/><child link="{behind}"/>'
        f'<origin xyz="0.1 0 0"/><axis xyz="0 1 0"/><limit lower="0" upper="1.5" effort="1" '
        f'velocity="1"/>{followed}</joint>'
        f'<link name="{behind}"/>'
        for name, ahead, behind, followed in rows
    )
    end = '<parent link="bone_3"/><child link="flange"/><origin xyz="0.1 0 0"/>'
    end = f'<joint name="end" type="fixed">{end}</joint><link name="flange"/>'
    finger = f'<robot name="finger"><link name="base"/>{joints}{end}</robot>'
    followers = ("knuckle_2", "knuckle_3")
    assert columns(lc.structured(read_from(tmp_path, finger))) == [
        f"{joint}_coupling_{shape}" for joint in followers for shape in SHAPES
    ]


def test_axes_are_compared_as_they_stand_and_not_as_they_are_named(tmp_path: Path) -> None:
    """The arm drawn with all axes along z of frames that are turned: the table's and the gripper's
    are no less perpendicular to the others."""
    turned = 'rpy="-1.5707963267948966 0 0"/><axis xyz="0 0 1"/>'
    drawn = PALLETISER_URDF.replace('0.3 0 0"/><axis xyz="0 1 0"/>', f'0.3 0 0" {turned}')
    drawn = drawn.replace('"0 0 1"/><axis xyz="0 1 0"/>', '"0 -1 0"/><axis xyz="0 0 1"/>')
    drawn = drawn.replace('<axis xyz="0 1 0"/>', '<axis xyz="0 0 1"/>')
    drawn = drawn.replace(f'rpy="{np.pi} 0 0"', 'rpy="-1.5707963267948966 0 0"')
    assert drawn.count('<axis xyz="0 0 1"/>') == 6
    assert columns(lc.structured(read_from(tmp_path, drawn))) == HELD


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_bars_of_other_lengths_are_predicted(tmp_path: Path, seed: int) -> None:
    """Of fresh poses less than a tenth is left of what the lengths and zeros of the arm leave."""
    rng = np.random.default_rng(seed)
    bars = PALLETISER.linkages + BARS * rng.standard_normal((3, 3))
    true = replace(PALLETISER, linkages=bars, yielding=0.0, bending=0.0)
    low, high = PALLETISER_BOX.T
    q = rng.uniform(low, high, (160, 4))
    seen = true.flange(q)[1] + 1e-5 * rng.standard_normal((160, 3))
    read = {
        **dict(zip(READINGS, q.T, strict=True)),
        **dict(zip("xyz", seen.T, strict=True)),
    }
    noise = lc.Noise(dict.fromkeys(READINGS, 1e-5) | dict.fromkeys("xyz", 1e-5))
    plain = arm(tmp_path)
    off = {}
    for name, sag in (("lengths", ()), ("coupled", ("*_coupling_*",))):
        made = lc.structured(plain, sag=sag, harmonics=False, discrepancy=False)
        first = {k: v[:60] for k, v in read.items()}
        result = lc.calibrate(made, first, noise=noise, method="implicit-loop")
        predicted = lc.predict(result, {k: read[k][60:] for k in READINGS})
        points = np.column_stack([predicted.outputs[k] for k in "xyz"])
        off[name] = np.sqrt(np.square(points - true.flange(q[60:])[1]).sum(axis=1).mean())
    assert off["coupled"] < off["lengths"] / 10.0
