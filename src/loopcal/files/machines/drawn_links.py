"""What the links of a URDF look like, and where they are in a pose."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.errors import InputError
from loopcal.files.machines.meshes import box, mesh_file, read_mesh, simplified
from loopcal.files.machines.safe_xml import children
from loopcal.files.machines.urdf import UrdfRobot
from loopcal.mechanisms.chain import Step, product
from loopcal.mechanisms.placement import inverse

MOST_DRAWN = 3_000
"""Triangles of a whole robot: as many turn without a graphics processor."""
SIDES = 16
"""Corners of a cylinder's rings."""
FEWEST = 40
"""Triangles of a link, however many links there are."""


@dataclass(frozen=True, eq=False)
class DrawnLinks:
    """The links of a robot with their shapes.

    corners: by link (n, 3) [m] in its frame; faces: (m, 3) positions of corners, of all links one
    behind the other; absent: meshes that the folder does not have, or that cannot be read; chain:
    each joint as parent, child and steps, parents first; base: the link that does not move.
    """

    corners: Mapping[str, Array]
    faces: NDArray[np.intp]
    absent: tuple[str, ...]
    chain: tuple[tuple[str, str, tuple[Step, ...]], ...]
    nominal: Mapping[str, float]
    base: str

    def placed(self, joints: Mapping[str, float]) -> Array:
        """(n, 3) [m] the corners of all links in the base; joints that are not read are at 0."""
        T = {self.chain[0][0] if self.chain else self.base: np.eye(4)}
        for parent, child, steps in self.chain:
            at = {s.joint: joints.get(s.joint, 0.0) for s in steps if s.joint}
            at = {name: v if np.isfinite(v) else 0.0 for name, v in at.items()}
            T[child] = T[parent] @ product(steps, at, self.nominal)
        T_base_root = inverse(T.get(self.base, np.eye(4)))
        placed = [
            at @ (T_base_link := T_base_root @ T[link])[:3, :3].T + T_base_link[:3, 3]
            for link, at in self.corners.items()
        ]
        return np.vstack(placed)


def read_links(path: Path, base: str | None = None) -> DrawnLinks | None:
    """The shapes that a URDF names and the folder around it has; None where it has none of them.

    Raises InputError for what is no URDF.
    """
    robot = UrdfRobot.read(path)
    chain, nominal = robot.moving()
    links = [chain[0][0], *(child for _, child, _ in chain)] if chain else []
    shapes: dict[str, list[Array]] = {}
    absent: list[str] = []
    for link in links:
        for visual in children(robot.links[link], "visual"):
            try:
                triangles = _shape(visual, path.parent, absent.append)
            except InputError as error:
                absent.append(error.text)
                continue
            except (TypeError, ValueError):  # a size that is absent or no number
                absent.append(f"the shape of {link}")
                continue
            if triangles is not None:
                T = robot.origin(visual)
                shapes.setdefault(link, []).append(triangles @ T[:3, :3].T + T[:3, 3])
    if not shapes:
        return None if not absent else DrawnLinks({}, _NO_FACES, tuple(absent), chain, nominal, "")
    most = max(MOST_DRAWN // len(shapes), FEWEST)
    corners, faces, count = {}, [], 0
    for link, some in shapes.items():
        triangles = simplified(np.concatenate(some), most)
        at, index = np.unique(triangles.reshape(-1, 3).round(6), axis=0, return_inverse=True)
        corners[link] = at
        faces.append(index.reshape(-1, 3) + count)
        count += len(at)
    root = chain[0][0]
    return DrawnLinks(corners, np.vstack(faces), tuple(absent), chain, nominal, base or root)


_NO_FACES = np.zeros((0, 3), dtype=np.intp)


def _shape(visual: Any, folder: Path, absent: Callable[[str], None]) -> Array | None:
    """The triangles of one <visual> in its frame."""
    for geometry in children(visual, "geometry"):
        for mesh in children(geometry, "mesh"):
            filename = str(mesh.get("filename"))
            file = mesh_file(folder, filename)
            if file is None:
                absent(filename.rpartition("/")[2])
                return None
            scale = [float(v) for v in (mesh.get("scale") or "1 1 1").split()]
            triangles: Array = read_mesh(file) * np.array(scale)
            return triangles
        for stated in children(geometry, "box"):
            return box([float(v) for v in str(stated.get("size")).split()])
        for stated in children(geometry, "cylinder"):
            return _round(float(stated.get("radius")), float(stated.get("length")))
        for stated in children(geometry, "sphere"):
            radius = float(stated.get("radius"))
            return _round(radius, radius)
    return None


def _round(radius: float, length: float) -> Array:
    """A cylinder about z, its middle at the origin; a sphere is drawn as one."""
    angle = np.linspace(0.0, 2.0 * np.pi, SIDES + 1)
    ring = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(SIDES + 1)])
    up = np.array([0.0, 0.0, 0.5 * length])
    pieces = []
    for a, b in pairwise(ring):
        pieces += [[a - up, b - up, b + up], [a - up, b + up, a + up]]
        pieces += [[up, a + up, b + up], [-up, b - up, a - up]]
    return np.array(pieces)
