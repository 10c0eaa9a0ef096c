"""Meshes of a robot's links, for pictures: STL, OBJ and COLLADA, as a URDF names them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError
from loopcal.files.machines.safe_xml import children, local, read_xml
from loopcal.files.tables.raw import bytes_of
from loopcal.files.toml.reader import shown

Array = NDArray[np.float64]
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
    """The geometries of the scene, each where its nodes put it."""
    root = read_xml(path, "COLLADA", "export the link as STL")
    every = {e.get("id"): e for e in root.iter() if isinstance(e.tag, str) and e.get("id")}
    scale, turn = 1.0, np.eye(4)
    for asset in children(root, "asset"):
        for unit in children(asset, "unit"):
            scale = float(unit.get("meter", 1.0))
        for up in children(asset, "up_axis"):
            turn = _UP.get((up.text or "").strip(), turn)
    pieces: list[Array] = []
    for scene in _inside(root, "visual_scene"):
        _nodes(scene, every, turn, pieces)
    if not pieces:  # geometries that no scene places
        pieces = [t for g in _inside(root, "geometry") for t in _geometry(g, every)]
    return scale * np.concatenate(pieces) if pieces else []


_UP = {
    "Y_UP": np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]]),
    "X_UP": np.array([[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]),
}


def _inside(root: Any, tag: str) -> list[Any]:
    return [e for e in root.iter() if isinstance(e.tag, str) and local(e) == tag]


def _nodes(parent: Any, every: Mapping[str, Any], T: Array, pieces: list[Array]) -> None:
    for node in children(parent, "node"):
        placed = T @ _transform(node)
        for instance in children(node, "instance_geometry"):
            geometry = every.get(str(instance.get("url")).removeprefix("#"))
            for triangles in [] if geometry is None else _geometry(geometry, every):
                pieces.append(triangles @ placed[:3, :3].T + placed[:3, 3])
                # A few nodes may name one large geometry any number of times.
                if sum(map(len, pieces)) > MOST_TRIANGLES:
                    raise ValueError("its scene has too many triangles")
        _nodes(node, every, placed, pieces)


def _transform(node: Any) -> Array:
    """The product of a node's transforms, in the order in which they stand."""
    T = np.eye(4)
    for element in node:
        kind = local(element) if isinstance(element.tag, str) else ""
        values = _floats(element) if kind in ("matrix", "translate", "scale", "rotate") else []
        if kind == "matrix":
            T = T @ np.array(values).reshape(4, 4)
        elif kind == "translate":
            T = T @ np.block([[np.eye(3), np.array([values]).T], [np.zeros((1, 3)), 1.0]])
        elif kind == "scale":
            T = T @ np.diag([*values, 1.0])
        elif kind == "rotate":
            T = T @ _about(np.array(values[:3]), np.radians(values[3]))
    return T


def _about(axis: Array, angle: float) -> Array:
    """Rodrigues' formula as (4, 4)."""
    x, y, z = axis / np.linalg.norm(axis)
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    T = np.eye(4)
    T[:3, :3] += np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K
    return T


def _geometry(geometry: Any, every: Mapping[str, Any]) -> list[Array]:
    pieces = []
    for kind in ("triangles", "polylist", "polygons"):
        for part in _inside(geometry, kind):
            inputs = {i.get("semantic"): i for i in children(part, "input")}
            vertices = every[inputs["VERTEX"].get("source").removeprefix("#")]
            (position,) = (
                i for i in children(vertices, "input") if i.get("semantic") == "POSITION"
            )
            source = every[position.get("source").removeprefix("#")]
            (values,) = children(source, "float_array")
            corners = np.array(_floats(values)).reshape(-1, 3)
            stride = 1 + max(int(i.get("offset", 0)) for i in children(part, "input"))
            first = int(inputs["VERTEX"].get("offset", 0))
            for p in children(part, "p"):
                index = np.array((p.text or "").split(), dtype=int)[first::stride]
                pieces.append(corners[_fans(part, kind, index)])
    return pieces


def _fans(part: Any, kind: str, index: Any) -> Any:
    """(n, 3) corners of triangles, of polygons as fans."""
    if kind == "triangles":
        return index.reshape(-1, 3)
    counts = [len(index)]
    if kind == "polylist":
        (stated,) = children(part, "vcount")
        counts = [int(n) for n in (stated.text or "").split()]
        if sum(counts) != len(index) or min(counts, default=0) < 0:
            raise ValueError("its polygons are not as large as stated")
    ends = np.cumsum(counts)
    fans = [
        (index[end - n], index[i], index[i + 1])
        for n, end in zip(counts, ends.tolist(), strict=True)
        for i in range(end - n + 1, end - 1)
    ]
    return np.array(fans, dtype=int).reshape(-1, 3)


def _floats(element: Any) -> list[float]:
    return [float(v) for v in (element.text or "").split()]


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
    coarse: Triangles = means[faces[apart][first]]
    return coarse


def box(size: Sequence[float]) -> Triangles:
    """A box about the origin, with these edges [m]."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * 0.5
    quads = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    faces = [(q[0], q[i], q[i + 1]) for q in quads for i in (1, 2)]
    edges: Triangles = (corners * np.asarray(size, dtype=float))[np.array(faces)]
    return edges
