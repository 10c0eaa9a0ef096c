"""The machines of the gauntlet as they truly are, in code of their own.

Nothing here is loopcal's: forward kinematics, sag, gears, backlash and warming are written again
with NumPy, so that an error of loopcal's models cannot hide in the truth that judges them.
Lengths are m, angles rad, masses kg; a pose is a row.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
GRAVITY = 9.81


def turn(axis: int, angle: Array | float) -> Array:
    """Rotation matrices (..., 3, 3) about the x, y or z axis (0, 1, 2)."""
    angle = np.asarray(angle, dtype=float)
    R = np.zeros((*angle.shape, 3, 3))
    i, j, k = axis, (axis + 1) % 3, (axis + 2) % 3
    R[..., i, i] = 1.0
    R[..., j, j] = R[..., k, k] = np.cos(angle)
    R[..., j, k], R[..., k, j] = -np.sin(angle), np.sin(angle)
    return R


def turned_by(vectors: Array) -> Array:
    """Rotation matrices (N, 3, 3) of rotation vectors (N, 3), by Rodrigues' formula."""
    angle = np.linalg.norm(vectors, axis=1)
    u = vectors / np.where(angle > 0.0, angle, 1.0)[:, None]
    K = np.zeros((len(vectors), 3, 3))
    K[:, 0, 1], K[:, 0, 2], K[:, 1, 2] = -u[:, 2], u[:, 1], -u[:, 0]
    K -= K.transpose(0, 2, 1)
    s, c = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    R: Array = np.eye(3) + s * K + (1.0 - c) * (K @ K)
    return R


def random_placement(rng: np.random.Generator, away: float) -> tuple[Array, Array]:
    """A rotation matrix about z, tilted a little, and a shift: where an instrument stands."""
    R = turn(2, rng.uniform(-3.1, 3.1)) @ turned_by(rng.normal(0.0, 0.02, (1, 3)))[0]
    return R, away * rng.uniform(-1.0, 1.0, 3) + np.array([away, 0.0, 0.0])


@dataclass(frozen=True)
class Link:
    """A joint and the link behind it.

    Rz(q + offset) Tz(d) Tx(a) Rx(alpha), and Ry(beta) behind it for an axis that is parallel to
    the next one; slides: d moves instead of q.
    """

    a: float = 0.0
    d: float = 0.0
    alpha: float = 0.0
    offset: float = 0.0
    beta: float | None = None
    slides: bool = False
    mass: float = 5.0
    sign: int = 1


@dataclass(frozen=True, eq=False)
class Arm:
    """A serial arm with all that troubles real ones; every trouble is zero unless it is given.

    yielding: rad per N m about each joint's axis; bending: the same about the two other axes;
    gears: (joints, 4) amplitude and phase of the first and second order; backlash: rad by which a
    joint lags; expansion: per kelvin, of all lengths.
    """

    links: tuple[Link, ...]
    tool_mass: float = 10.0
    yielding: float = 0.0
    bending: float = 0.0
    gears: Array | None = None
    backlash: float = 0.0
    expansion: float = 0.0

    def perturbed(self, rng: np.random.Generator, length: float, angle: float) -> Arm:
        """The arm as it was built: lengths and angles off by these sds."""

        def off(link: Link) -> Link:
            dl, da = length * rng.standard_normal(2), angle * rng.standard_normal(3)
            return replace(
                link,
                a=link.a + dl[0],
                d=link.d + dl[1] * (link.beta is None),
                alpha=link.alpha + da[0],
                offset=link.offset + da[1] * (not link.slides),
                beta=None if link.beta is None else link.beta + da[2],
            )

        return replace(self, links=tuple(off(link) for link in self.links))

    def flange(self, q: Array, warmth: Array | None = None) -> tuple[Array, Array]:
        """R (N, 3, 3) and o (N, 3) of the last frame in the base, at readings q (N, n)."""
        q = self._moved(q)
        scale = 1.0 if warmth is None else 1.0 + self.expansion * warmth
        give = np.zeros((len(q), len(self.links), 3))
        for _ in range(3 if self.yielding or self.bending else 0):
            give = self._given(q, scale, give)
        frames = self._frames(q, scale, give)
        R, o, _ = frames[-1]
        return R, o

    def _moved(self, q: Array) -> Array:
        moved = q.copy()
        if self.gears is not None:
            first, one, second, two = self.gears.T
            moved = moved + first * np.sin(q + one) + second * np.sin(2.0 * q + two)
        if self.backlash:
            ahead = np.sign(np.diff(q, axis=0, prepend=q[:1] - 1.0))
            moved = moved + 0.5 * self.backlash * ahead
        return moved

    def _frames(
        self, q: Array, scale: Array | float, give: Array
    ) -> list[tuple[Array, Array, Array]]:
        """R, o behind each link, and the joint's axis (N, 3) ahead of it, all in the base."""
        R, o = np.broadcast_to(np.eye(3), (len(q), 3, 3)), np.zeros((len(q), 3))
        scale = np.broadcast_to(scale, len(q))
        out = []
        for j, link in enumerate(self.links):
            axis = R[:, :, 2]
            R = turned_by(give[:, j]) @ R
            angle = link.offset + (0.0 if link.slides else link.sign * q[:, j])
            R = R @ turn(2, np.broadcast_to(angle, len(q)))
            along = link.d * scale + (link.sign * q[:, j] if link.slides else 0.0)
            o = o + along[:, None] * R[:, :, 2] + (link.a * scale)[:, None] * R[:, :, 0]
            R = R @ turn(0, link.alpha)
            if link.beta is not None:
                R = R @ turn(1, link.beta)
            out.append((R, o, axis))
        return out

    def _given(self, q: Array, scale: Array | float, give: Array) -> Array:
        """The rotation vectors (N, n, 3) by which each joint gives way under the weight behind."""
        frames = self._frames(q, scale, give)
        origins = [np.zeros((len(q), 3)), *(o for _, o, _ in frames)]
        weights = [link.mass for link in self.links]
        weights[-1] += self.tool_mass
        out = np.zeros_like(give)
        down = np.array([0.0, 0.0, -GRAVITY])
        for j in range(len(self.links)):
            moment = np.zeros((len(q), 3))
            for k in range(j, len(self.links)):
                centre = 0.5 * (origins[k] + origins[k + 1])
                moment += np.cross(centre - origins[j], weights[k] * down)
            axis = frames[j][2]
            about = np.einsum("ni,ni->n", moment, axis)[:, None] * axis
            out[:, j] = self.yielding * about + self.bending * (moment - about)
        return out


SIX = Arm(
    (
        Link(a=0.15, d=0.45, alpha=-np.pi / 2, mass=60.0),
        Link(a=0.60, alpha=0.0, offset=-np.pi / 2, beta=0.0, mass=40.0),
        Link(a=0.12, alpha=-np.pi / 2, mass=25.0),
        Link(d=0.64, alpha=np.pi / 2, mass=15.0),
        Link(alpha=-np.pi / 2, mass=8.0),
        Link(d=0.10, mass=3.0),
    )
)
SEVEN = Arm(
    (
        Link(d=0.36, alpha=-np.pi / 2),
        Link(alpha=np.pi / 2),
        Link(d=0.42, alpha=np.pi / 2),
        Link(alpha=-np.pi / 2),
        Link(d=0.40, alpha=-np.pi / 2),
        Link(alpha=np.pi / 2),
        Link(d=0.126),
    ),
    tool_mass=3.0,
)
SCARA = Arm(
    (
        Link(a=0.325, beta=0.0),
        Link(a=0.225, beta=0.0),
        Link(slides=True),
        Link(d=0.05),
    ),
    tool_mass=1.0,
)
UR = Arm(
    (
        Link(d=0.1625, alpha=np.pi / 2, mass=4.0),
        Link(a=-0.425, beta=0.0, mass=8.0),
        Link(a=-0.3922, beta=0.0, mass=3.0),
        Link(d=0.1333, alpha=np.pi / 2, mass=1.5),
        Link(d=0.0997, alpha=-np.pi / 2, mass=1.5),
        Link(d=0.0996, mass=0.5),
    ),
    tool_mass=3.0,
)
IRB = Arm(
    (
        Link(d=0.29, alpha=-np.pi / 2, mass=8.0),
        Link(a=0.27, offset=-np.pi / 2, beta=0.0, mass=6.0),
        Link(a=0.07, alpha=-np.pi / 2, mass=4.0),
        Link(d=0.302, alpha=np.pi / 2, mass=2.0),
        Link(alpha=-np.pi / 2, mass=1.0),
        Link(d=0.072, mass=0.3),
    ),
    tool_mass=1.0,
)
PLANAR = Arm((Link(a=0.8), Link(a=0.6)))
BOXES: dict[str, Array] = {
    "six": np.array([[-2.6, 2.6], [-1.0, 1.2], [-1.2, 1.0], [-2.6, 2.6], [-1.8, 1.8], [-2.9, 2.9]]),
    "seven": np.array([[-2.9, 2.9], [-1.6, 1.6]] * 3 + [[-2.9, 2.9]]),
    "scara": np.array([[-2.2, 2.2], [-2.2, 2.2], [0.0, 0.2], [-3.0, 3.0]]),
    "ur": np.array([[-2.8, 2.8], [-2.6, -0.4], [-2.2, 2.2], [-2.5, 2.5], [-2.5, 2.5], [-3.0, 3.0]]),
    "irb": np.array([[-2.4, 2.4], [-1.2, 1.4], [-1.5, 0.9], [-2.5, 2.5], [-1.8, 1.8], [-3.0, 3.0]]),
    "planar": np.array([[-3.0, 3.0], [-2.5, 2.5]]),
}


def drawn(box: Array, poses: int, rng: np.random.Generator) -> Array:
    """Joint readings (N, n), uniform in a box (n, 2)."""
    return box[:, 0] + rng.random((poses, len(box))) * (box[:, 1] - box[:, 0])


def corner(box: Array, share: float, rng: np.random.Generator) -> Array:
    """A box of this share of each joint's range, somewhere within."""
    width = box[:, 1] - box[:, 0]
    low = box[:, 0] + rng.random(len(box)) * width * (1.0 - share)
    return np.column_stack([low, low + share * width])


@dataclass(frozen=True, eq=False)
class Hexapod:
    """Six legs between base joints a (6, 3) and platform joints b (6, 3), with their zeros (6,)."""

    a: Array
    b: Array
    zero: Array = field(default_factory=lambda: np.full(6, 0.55))

    def legs(self, R: Array, P: Array) -> Array:
        """What the legs read, (N, 6), with the platform at R (N, 3, 3), P (N, 3)."""
        joints = P[:, None, :] + np.einsum("nij,kj->nki", R, self.b)
        read: Array = np.linalg.norm(joints - self.a, axis=2) - self.zero
        return read


def ring(radius: float, degrees: Sequence[float]) -> Array:
    """Points (n, 3) on a circle in the plane z = 0."""
    angles = np.radians(degrees)
    return radius * np.column_stack([np.cos(angles), np.sin(angles), 0.0 * angles])


@dataclass(frozen=True, eq=False)
class Delta:
    """Three rails along z from feet (3, 3), rods (3,) to a platform that never turns."""

    feet: Array
    rods: Array

    def slides(self, P: Array) -> Array:
        """What the carriages read, (N, 3), with the platform at P (N, 3)."""
        across = P[:, None, :2] - self.feet[None, :, :2]
        rise = np.sqrt(self.rods**2 - np.square(across).sum(axis=2))
        read: Array = P[:, 2:] + rise
        return read


@dataclass(frozen=True, eq=False)
class FiveBar:
    """Two arms from a (2, 2) by proximal (2,) and distal (2,) links that meet in P."""

    a: Array
    proximal: Array
    distal: Array

    def angles(self, P: Array) -> Array:
        """What the two motors read, (N, 2), elbows outwards."""
        out = []
        for i, side in enumerate((1.0, -1.0)):
            way = P - self.a[i]
            r = np.linalg.norm(way, axis=1)
            cosine = (self.proximal[i] ** 2 + r**2 - self.distal[i] ** 2) / (
                2.0 * self.proximal[i] * r
            )
            out.append(np.arctan2(way[:, 1], way[:, 0]) + side * np.arccos(cosine))
        return np.column_stack(out)

    def distal_frame(self, P: Array) -> Array:
        """R (N, 2, 2) of the distal link of the first arm, x from the elbow to P."""
        angle = self.angles(P)[:, 0]
        elbow = self.a[0] + self.proximal[0] * np.column_stack([np.cos(angle), np.sin(angle)])
        u = (P - elbow) / np.linalg.norm(P - elbow, axis=1)[:, None]
        return np.stack([u, np.column_stack([-u[:, 1], u[:, 0]])], axis=2)
