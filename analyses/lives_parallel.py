"""A palletiser and a rotary delta as they truly are, in code of their own.

Nothing here is loopcal's. Lengths are m, angles rad; a pose is a row.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from analyses.gauntlet_truth import Arm, Array, Link, ring, turn

RIGHT = 0.5 * np.pi
BARS = 1e-4
"""sd of bars and cranks [m], which are machined and not measured."""


@dataclass(frozen=True, eq=False)
class Palletiser(Arm):
    """Four motors turn a table, a lower arm, a forearm and a gripper that bars keep level.

    The angles of lower arm and forearm are from the floor, as controllers of such arms state them.
    linkages (3, 3): crank, bar and horn that turn the forearm, hold the plate at the elbow and
    level the wrist; bars are added to the length of the arm beside them. zeros (4,) of the motors.
    """

    linkages: Array = field(default_factory=lambda: np.tile([0.25, 0.0, 0.25], (3, 1)))
    zeros: Array = field(default_factory=lambda: np.zeros(4))

    def _moved(self, q: Array) -> Array:
        table, lower, fore, gripper = (super()._moved(q) + self.zeros).T
        arms = self.links[1].a, self.links[2].a
        fore = _follows(lower - RIGHT, fore + np.pi, arms[0], self.linkages[0]) - np.pi
        plate = _follows(lower - RIGHT, 0.0 * lower, arms[0], self.linkages[1])
        level = _follows(fore, plate + RIGHT, arms[1], self.linkages[2]) - RIGHT
        return np.column_stack([table, lower, fore - lower, level - fore, gripper])


def _follows(arm: Array, crank: Array, length: float, linkage: Array) -> Array:
    """The angle of the horn at the end of an arm whose bar runs beside it from a crank."""
    radius, bar, horn = linkage[0], length + linkage[1], linkage[2]
    way = radius * np.exp(1j * crank) - length * np.exp(1j * arm)
    cosine = (horn**2 + np.abs(way) ** 2 - bar**2) / (2.0 * horn * np.abs(way))
    both = np.angle(way) + np.array([[1.0], [-1.0]]) * np.arccos(cosine)
    off = np.angle(np.exp(1j * (both - crank)))
    nearest = np.argmin(np.abs(off), axis=0)
    follows: Array = crank + off[nearest, np.arange(len(crank))]
    return follows


PALLETISER = Palletiser(
    (
        Link(a=0.30, d=0.80, alpha=-RIGHT, mass=120.0),
        Link(a=1.00, offset=-RIGHT, beta=0.0, mass=60.0),
        Link(a=1.10, offset=RIGHT, beta=0.0, mass=40.0),
        Link(a=0.20, alpha=-RIGHT, mass=15.0),
        Link(d=0.15, mass=5.0),
    )
)
PALLETISER_BOX = np.radians([[-150.0, 150.0], [-25.0, 40.0], [-20.0, 35.0], [-170.0, 170.0]])


@dataclass(frozen=True, eq=False)
class RotaryDelta:
    """Three swinging arms, and rods to a platform that never turns.

    shoulders (3, 3) less the platform's joints; azimuth, tilt, proximal, distal, zeros (3,).
    """

    shoulders: Array = field(default_factory=lambda: ring(0.15, (210, 330, 90)))
    azimuth: Array = field(default_factory=lambda: np.radians([210.0, 330.0, 90.0]))
    tilt: Array = field(default_factory=lambda: np.zeros(3))
    proximal: Array = field(default_factory=lambda: np.full(3, 0.20))
    distal: Array = field(default_factory=lambda: np.full(3, 0.45))
    zeros: Array = field(default_factory=lambda: np.zeros(3))
    expansion: float = 0.0

    def flange(self, q: Array, warmth: Array | None = None) -> tuple[Array, Array]:
        """R (N, 3, 3) and o (N, 3) of the platform in the base, at readings q (N, 3)."""
        scale = 1.0 + self.expansion * (np.zeros(len(q)) if warmth is None else warmth)
        angle = q + self.zeros
        swung = np.stack([np.cos(angle), np.zeros_like(angle), -np.sin(angle)], axis=2)
        turned = np.einsum("kij,nkj->nki", self._bases(), swung * self.proximal[:, None])
        knees = scale[:, None, None] * (self.shoulders + turned)
        return np.tile(np.eye(3), (len(q), 1, 1)), _hung(knees, scale[:, None] * self.distal)

    def angles(self, P: Array) -> Array:
        """What the three arms read (N, 3) with the platform at P (N, 3), knees outwards."""
        s = np.einsum("kji,nkj->nki", self._bases(), P[:, None] - self.shoulders)
        reach = np.hypot(s[:, :, 0], s[:, :, 2])
        square = np.square(s).sum(axis=2) + self.proximal**2 - self.distal**2
        half = np.arccos(square / (2.0 * self.proximal * reach))
        middle = -np.arctan2(s[:, :, 2], s[:, :, 0])
        outwards = np.where(np.cos(middle + half) > np.cos(middle - half), half, -half)
        read: Array = middle + outwards - self.zeros
        around: Array = np.angle(np.exp(1j * read))
        return around

    def _bases(self) -> Array:
        bases: Array = turn(2, self.azimuth) @ turn(0, self.tilt)
        return bases


def _added(values: Array, j: int, size: float) -> Array:
    more = values.copy()
    more[j - 1] += size
    return more


def _hung(knees: Array, rods: Array) -> Array:
    """The lower point (N, 3) at distances (N, 3) from three points (N, 3, 3)."""
    first, second, third = knees.transpose(1, 0, 2)
    i = second - first
    d = np.linalg.norm(i, axis=1)
    i = i / d[:, None]
    way = third - first
    along = np.einsum("ni,ni->n", i, way)
    j = way - along[:, None] * i
    across = np.linalg.norm(j, axis=1)
    j = j / across[:, None]
    k = np.cross(i, j)
    k = k * -np.sign(k[:, 2:])
    x = (rods[:, 0] ** 2 - rods[:, 1] ** 2 + d**2) / (2.0 * d)
    y = (rods[:, 0] ** 2 - rods[:, 2] ** 2 + along**2 + across**2) / (2.0 * across)
    y = y - along / across * x
    z = np.sqrt(rods[:, 0] ** 2 - x**2 - y**2)
    P: Array = first + x[:, None] * i + y[:, None] * j + z[:, None] * k
    return P


DELTA = RotaryDelta()
DELTA_BOX = np.array([[-0.15, 0.15], [-0.15, 0.15], [-0.50, -0.38]])
"""Where the platform goes [m]."""


def rezeroed(machine: Arm | RotaryDelta, j: int, size: float) -> Arm | RotaryDelta:
    """The machine with another zero of joint j, counted from 1."""
    if isinstance(machine, Palletiser):
        return replace(machine, zeros=_added(machine.zeros, j, size))
    if isinstance(machine, RotaryDelta):
        return replace(machine, zeros=_added(machine.zeros, j, size))
    return relinked(machine, j, offset=size)


def bent(machine: RotaryDelta, j: int, size: float) -> RotaryDelta:
    """The delta with another length of arm j, counted from 1."""
    return replace(machine, proximal=_added(machine.proximal, j, size))


def relinked(arm: Arm, j: int, **changes: float) -> Arm:
    """The arm with these added to the values of link j, counted from 1."""
    link = arm.links[j - 1]
    moved = replace(link, **{key: getattr(link, key) + v for key, v in changes.items()})
    return replace(arm, links=(*arm.links[: j - 1], moved, *arm.links[j:]))


def _urdf_joint(name: str, links: tuple[str, str], origin: str, axis: str, rest: str) -> str:
    parent, child = links
    return (
        f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin {origin}/><axis xyz="{axis}"/>{rest}</joint><link name="{child}"/>\n'
    )


def _limits(box: Array) -> str:
    return f'<limit lower="{box[0]:g}" upper="{box[1]:g}" effort="1000" velocity="2"/>'


def _palletiser_urdf() -> str:
    """The drawing with joints that mimic others for what the bars do."""
    wide = _limits(np.array([-3.0, 3.0]))
    J1, J2, J3, J4 = map(_limits, PALLETISER_BOX)
    rows = (
        ("J1", ("base", "table"), 'xyz="0 0 0.8"', "0 0 1", J1),
        ("J2", ("table", "lower_arm"), 'xyz="0.3 0 0"', "0 1 0", J2),
        ("elbow", ("lower_arm", "plate"), 'xyz="0 0 1"', "0 1 0", _mimic("J2") + wide),
        ("J3", ("plate", "forearm"), 'xyz="0 0 0"', "0 1 0", J3),
        ("wrist", ("forearm", "hand"), 'xyz="1.1 0 0"', "0 1 0", _mimic("J3") + wide),
        ("J4", ("hand", "gripper"), f'xyz="0.2 0 0" rpy="{np.pi} 0 0"', "0 0 1", J4),
    )
    joints = "".join(_urdf_joint(*row) for row in rows)
    mount = '<parent link="gripper"/><child link="flange"/><origin xyz="0 0 0.15"/>'
    return (
        f'<robot name="palletiser"><link name="base"/>\n{joints}'
        f'<joint name="mount" type="fixed">{mount}</joint><link name="flange"/></robot>\n'
    )


def _mimic(joint: str) -> str:
    return f'<mimic joint="{joint}" multiplier="-1"/>'


PALLETISER_URDF = _palletiser_urdf()
