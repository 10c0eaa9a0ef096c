"""Meshes of a robot's links, for pictures: STL, OBJ and COLLADA, as a URDF names them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from itertools import pairwise
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.errors import InputError
from loopcal.files.machines.safe_xml import children, read_xml
from loopcal.files.machines.urdf import UrdfRobot
from loopcal.files.tables.raw import bytes_of
from loopcal.files.toml.reader import shown
from loopcal.mechanisms.chain import Step, product
from loopcal.mechanisms.placement import inverse

Triangles = NDArray[np.float64]
"""(n, 3, 3) corners of triangles [m]."""
MOST_TRIANGLES, MOST_BYTES = 2_000_000, 100_000_000
"""Of one file: a link drawn from CAD has some 100,000 triangles in 5 MB."""
_CORNERS = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
_HEAD = 84
"""Bytes of a binary STL ahead of its triangles."""


def read_mesh(path: str | Path) -> Triangles:
    """The triangles of a mesh file; COLLADA states its unit, the others are in metres.

    Raises InputError for what is no such mesh, or has more than two million triangles.
    """
    reader = READERS.get(Path(path).suffix.lower())
    if reader is None:
        raise _no_mesh(path, "its ending is not .stl, .obj or .dae")
    try:
        triangles = np.asarray(reader(path), dtype=float).reshape(-1, 3, 3)
    except (ValueError, IndexError, KeyError, TypeError, AttributeError) as error:
        raise _no_mesh(path, str(error)) from None
    if not 0 < len(triangles) <= MOST_TRIANGLES:
        raise _no_mesh(path, f"it has {len(triangles):,} triangles")
    if not np.isfinite(triangles).all():
        raise _no_mesh(path, "a corner is no finite number")
    return triangles


def mesh_file(folder: Path, filename: str) -> Path | None:
    """The file of a folder that a URDF means: the one with the longest end of its path.

    package://ROBOT/meshes/base.stl is ROBOT/meshes/base.stl, meshes/base.stl or base.stl there.
    """
    parts = [p for p in PurePosixPath(filename.partition("://")[2] or filename).parts if p != "/"]
    if ".." in parts or filename.startswith(("http:", "https:")):
        return None
    top = folder.resolve()
    ends = (top.joinpath(*parts[i:]) for i in range(len(parts)))
    # A link may lead out of the folder.
    return next((e for e in ends if e.is_file() and e.resolve().is_relative_to(top)), None)


def _no_mesh(path: str | Path, why: str) -> InputError:
    return InputError(
        f"this is no mesh that can be drawn: {why}",
        code="wrong-file-type",
        place=shown(path),
        remedy="export the link as STL from CAD; without it the robot is drawn as capsules",
    )


def _content(path: str | Path) -> bytes:
    content = bytes_of(path, MOST_BYTES)
    if len(content) > MOST_BYTES:
        raise _no_mesh(path, f"it is larger than {MOST_BYTES // 1_000_000} MB")
    return content


def _stl(path: str | Path) -> Any:
    content = _content(path)
    count = int.from_bytes(content[80:_HEAD], "little")
    if len(content) == _HEAD + count * _CORNERS.itemsize:
        return np.frombuffer(content, _CORNERS, count, _HEAD)["corners"]
    words = content.split()
    at = [i for i, word in enumerate(words) if word == b"vertex"]
    return [[float(v) for v in words[i + 1 : i + 4]] for i in at]


def _obj(path: str | Path) -> Any:
    corners: list[list[float]] = []
    faces: list[tuple[int, int, int]] = []
    for line in _content(path).decode("utf-8", "replace").splitlines():
        kind, *values = line.split() or [""]
        if kind == "v":
            corners.append([float(v) for v in values[:3]])
        elif kind == "f":
            # Numbers begin at 1; negative ones count from the last corner.
            at = [int(value.partition("/")[0]) for value in values]
            index = [i - 1 if i > 0 else len(corners) + i for i in at]
            faces += [(index[0], a, b) for a, b in pairwise(index[1:])]
    return np.array(corners, dtype=float)[np.array(faces, dtype=int).reshape(-1, 3)]


def _dae(path: str | Path) -> Any:
    """The geometries of the scene, each where its nodes put it.

    Which axis is up is not followed: RViz and Gazebo draw the meshes of a URDF as they are.
    """
    root = read_xml(path, "COLLADA", "export the link as STL")
    try:
        from collada import Collada
        from collada.common import DaeBrokenRefError, DaeError, DaeUnsupportedError
        from lxml import etree
    except ImportError:
        raise InputError(
            "COLLADA is read by pycollada, which is not installed",
            code="missing-dependency",
            place=shown(path),
            remedy="pip install 'loopcal[app]'",
        ).then("pip install 'loopcal[app]'") from None
    # A node whose material is lacking would be left out, and materials are not drawn.
    for element in [*root.iter("{*}bind_material", "{*}library_effects", "{*}library_images")]:
        element.getparent().remove(element)
    try:
        file = Collada(
            BytesIO(etree.tostring(root)), ignore=[DaeBrokenRefError, DaeUnsupportedError]
        )
    except DaeError as error:
        raise ValueError(str(error)) from None
    scene = [] if file.scene is None else list(file.scene.objects("geometry"))
    pieces, count = [], 0
    for geometry in scene or [one.bind(np.eye(4), {}) for one in file.geometries]:
        for part in geometry.primitives():
            triangles = _fans(part)
            # A few nodes may name one large geometry any number of times.
            count += len(triangles)
            if count > MOST_TRIANGLES:
                raise ValueError("its scene has too many triangles")
            pieces.append(triangles)
    return float(file.assetInfo.unitmeter or 1.0) * np.concatenate(pieces) if pieces else []


def _fans(part: Any) -> Array:
    """Triangles of a part of a geometry, polygons as fans; none of lines."""
    if hasattr(part, "triangleset"):
        counts = part.original.vcounts
        if counts.sum() != len(part.vertex_index) or counts.min(initial=0) < 0:
            raise ValueError("its polygons are not as large as stated")
        part = part.triangleset()
    none: Array = np.zeros((0, 3, 3))
    return part.vertex[part.vertex_index] if hasattr(part, "ntriangles") else none


READERS: Mapping[str, Callable[[str | Path], Any]] = {".stl": _stl, ".obj": _obj, ".dae": _dae}
"""By ending."""


def simplified(triangles: Triangles, most: int) -> Triangles:
    """At most so many triangles that look alike: corners within one cell of a grid become one.

    The grid is halved or doubled until they fit; what keeps no area is left out.
    """
    size = float(np.ptp(triangles.reshape(-1, 3), axis=0).max()) or 1.0
    cells = 64
    while len(triangles) > most and cells >= 2:
        coarse = _clustered(triangles, size / cells)
        if len(coarse) <= most:
            return coarse
        cells = int(cells / 1.4)
    return triangles[:most]


def _clustered(triangles: Triangles, cell: float) -> Triangles:
    corners = triangles.reshape(-1, 3)
    place = np.floor((corners - corners.min(axis=0)) / cell).astype(np.int64)
    _, index, count = np.unique(place, axis=0, return_inverse=True, return_counts=True)
    index = index.reshape(-1)
    sums = np.stack([np.bincount(index, column) for column in corners.T], axis=1)
    means = np.asarray(sums / count[:, None], dtype=float)
    faces = index.reshape(-1, 3)
    apart = (np.diff(np.sort(faces, axis=1), axis=1) > 0).all(axis=1)
    _, first = np.unique(np.sort(faces[apart], axis=1), axis=0, return_index=True)
    return means[faces[apart][first]]


def box(size: Sequence[float]) -> Triangles:
    """A box about the origin, with these edges [m]."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * 0.5
    quads = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    faces = [(q[0], q[i], q[i + 1]) for q in quads for i in (1, 2)]
    edges: Triangles = (corners * np.asarray(size, dtype=float))[np.array(faces)]
    return edges


# What the links of a URDF look like, and where they are in a pose.


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
