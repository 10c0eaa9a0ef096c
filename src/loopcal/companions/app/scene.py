"""A machine in a pose as a figure in space shows it: limbs, cameras, boards, and what touches."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.figures.figure import names, numbers, spots
from loopcal.files.machines.meshes import DrawnLinks
from loopcal.mechanisms.chain import product
from loopcal.mechanisms.instruments.camera import CameraEntry, all_cameras
from loopcal.mechanisms.mechanism import Family, Mechanism
from loopcal.mechanisms.skeleton import drawn_in, skeleton
from loopcal.report.sighted import Readings, body_pose, camera_places, centres

SIGHT = 0.15
"""Length of a camera's pyramid over its distance from the board."""
INK = {"camera": "#0072b2", "board": "#b5340a", "touch": "#d55e00", "body": "#7b828c"}
"""Colours of the lines, on either ground."""
_EDGES = [0, 1, 2, 0, 3, 2, 3, 4, 0, 4, 1]
"""The way along a pyramid: its tip, then its four corners."""


@dataclass(frozen=True, eq=False)
class Scene:
    """What is drawn of a machine; it moves from pose to pose, and its traces stay.

    links: the shapes of its links, drawn in place of capsules.
    """

    mechanism: Mechanism
    links: DrawnLinks | None = None

    @cached_property
    def _cameras(self) -> list[tuple[CameraEntry, Family]]:
        families = {family.name: family for family in self.mechanism.families}
        entries = all_cameras(self.mechanism)
        return [(one, families[one.instrument]) for one in entries if one.instrument in families]

    @cached_property
    def _touching(self) -> list[tuple[Family, Array, Array]]:
        """What touches on two bodies of a tree, with the centres (3,) on either."""
        if self.mechanism.tree is None:
            return []
        every = [(f, *centres(self.mechanism, f)) for f in self.mechanism.families]
        return [
            (family, first, second)
            for family, first, second in every
            if family.form == "gap" and first is not None and second is not None
        ]

    def traces(self, joints: Mapping[str, float]) -> list[dict[str, Any]]:
        """The limbs as a body, and lines for the rest; joints: readings of a pose [m, rad]."""
        return self._body(joints) + [
            spots(
                "lines+text",
                at.T,
                line={"color": INK[kind], "width": 4},
                text=names(labels),
                textfont={"color": INK[kind], "size": 12},
                hoverinfo="skip",
                connectgaps=False,
                name=kind,
            )
            for kind, at, labels in self._lines(joints)
        ]

    def moved(self, joints: Mapping[str, float]) -> list[Array]:
        """(k, 3) the points of these traces in another pose."""
        limbs = self.limbs(joints)
        shape = self._placed(joints)
        if shape is None and limbs is not None:
            shape = vertices(limbs)
        return ([] if shape is None else [shape]) + [at for _, at, _ in self._lines(joints)]

    def _body(self, joints: Mapping[str, float]) -> list[dict[str, Any]]:
        """The links as they look, or a capsule for each; none of a machine without limbs."""
        placed = self._placed(joints)
        if self.links is not None and placed is not None:
            return [body(placed, self.links.faces) | {"flatshading": True}]
        limbs = self.limbs(joints)
        return [] if limbs is None else [capsules(limbs)]

    def _placed(self, joints: Mapping[str, float]) -> Array | None:
        """(n, 3) the corners of the links' shapes."""
        if self.links is None or not self.links.corners:
            return None
        T = product(drawn_in(self.mechanism), {}, self.mechanism.parameters.nominal)
        return self.links.placed(joints) @ T[:3, :3].T + T[:3, 3]

    def limbs(self, joints: Mapping[str, float]) -> Array | None:
        """(k, 3) the skeleton of the machine [m]; NaN where a joint is not read."""
        points = self.skeleton(joints)
        return points if points is not None and points.shape[1] == 3 else None

    def skeleton(self, joints: Mapping[str, float]) -> Array | None:
        """The same, of a machine in a plane (k, 2)."""
        if self.mechanism.tree is not None:
            joints = {**dict.fromkeys(self.mechanism.joints, np.nan), **joints}
        try:
            return skeleton(self.mechanism, joints)
        except KeyError:
            return None  # a joint that was not read in this pose

    def _lines(self, joints: Mapping[str, float]) -> Iterator[tuple[str, Array, list[str]]]:
        """Kind, points (k, 3) of one broken line, and the label at each of them."""
        one = {name: np.array([value]) for name, value in joints.items()}
        pyramids: dict[str, Array] = {}
        boards: dict[str, Array] = {}
        gaps: dict[str, Array] = {}
        for entry, family in self._cameras:
            T_camera, T_board = (T[0] for T in camera_places(self.mechanism, entry, family, one))
            corners = entry.board.xyz @ T_board[:3, :3].T + T_board[:3, 3]
            length = SIGHT * float(np.linalg.norm(corners.mean(axis=0) - T_camera[:3, 3]))
            boards.setdefault(entry.board.name, _outline(entry, corners))
            pyramids.setdefault(entry.name, _pyramid(entry, T_camera, length))
        for family, first, second in self._touching:
            ends = [self._at(b, p, one) for b, p in ((family.on, first), (family.against, second))]
            gaps[family.name] = np.array(ends)
        for kind, pieces in (("camera", pyramids), ("board", boards), ("touch", gaps)):
            if pieces:
                yield kind, *_pen(pieces)

    def _at(self, body: str, point: Array, one: Readings) -> Array:
        T = body_pose(self.mechanism, one, body)[0]
        at: Array = T[:3, :3] @ point + T[:3, 3]
        return at


def _pen(pieces: Mapping[str, Array]) -> tuple[Array, list[str]]:
    """Points (k, 3) of one line, NaN between its pieces, and the label at each."""
    lifted = np.full((1, 3), np.nan)
    line = [part for piece in pieces.values() for part in (piece, lifted)]
    labels = [text for label, piece in pieces.items() for text in (label, *[""] * len(piece))]
    return np.vstack(line), labels


def _pyramid(entry: CameraEntry, T: Array, length: float) -> Array:
    """(11, 3) a line along the edges of a camera's pyramid of sight."""
    lens = entry.intrinsics
    width, height = lens.image or (2.0 * lens.cx, 2.0 * lens.cy)
    across = np.array([width / lens.fx, height / lens.fy]) / 2.0
    ends = [[x, y, 1.0] for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    corners = np.vstack([np.zeros(3), np.array(ends) * [*across, 1.0]]) * length
    return (corners @ T[:3, :3].T + T[:3, 3])[_EDGES]


def _outline(entry: CameraEntry, corners: Array) -> Array:
    """A board's edge, or a star of the points of a thing that is not flat."""
    board = entry.board
    if not board.planar or len(board.points) < 4:
        middle = corners.mean(axis=0)
        return np.array([end for corner in corners for end in (middle, corner)])
    x, y = board.xyz[:, 0], board.xyz[:, 1]
    at = [int(np.argmin(a * x + b * y)) for a, b in ((1, 1), (-1, 1), (-1, -1), (1, -1), (1, 1))]
    return corners[at]


def restyled(every: Sequence[Array], first: int) -> list[Any]:
    """What `restyle` of plotly makes of traces with these points, the first one's number on."""
    update = {k: [numbers(at[:, i]) for at in every] for i, k in enumerate("xyz")}
    return [update, [*range(first, first + len(every))]]


# The machine as a body: a capsule about each line of its skeleton, as triangles of one mesh.


SIDES = 12
"""Corners of a ring. The rounding is seen, and a scene of software stays quick."""
THICK = 0.03
"""Radius over the length of the longest limb: as slender as an arm, and links stay apart."""
COLOUR = "#9db0b8"
# Latitudes of the rings of the two half spheres; between the middle two lies the cylinder.
_LATITUDES = np.radians([-90.0, -45.0, 0.0, 0.0, 45.0, 90.0])


def capsules(points: Array) -> dict[str, Any]:
    """The trace for a skeleton (k, 3) [m], whose lines are parted by rows of NaN.

    Its triangles depend on k alone, so that a machine that moves keeps them: a line of no length,
    or none at all, has a capsule of no size.
    """
    return body(vertices(points), _triangles(len(points) - 1))


def body(corners: Array, faces: NDArray[np.intp]) -> dict[str, Any]:
    """The trace of a body with these corners (n, 3) [m] and triangles (m, 3)."""
    i, j, k = faces.T.tolist()
    return {
        **{"type": "mesh3d", "color": COLOUR, "hoverinfo": "skip", "flatshading": False},
        **dict(zip("xyz", map(numbers, corners.T), strict=True)),
        **{"i": i, "j": j, "k": k},
        "lighting": {"ambient": 0.55, "diffuse": 0.7, "specular": 0.1},
    }


def vertices(points: Array) -> Array:
    """(n, 3) the corners [m] of its capsules, line by line and ring by ring."""
    begin, end = points[:-1], points[1:]
    lengths = np.nan_to_num(np.linalg.norm(end - begin, axis=1))
    radius = THICK * _longest(lengths, np.isfinite(points).all(axis=1))
    extended = lengths > 1e-9
    axis = np.zeros_like(begin)
    axis[extended] = (end - begin)[extended] / lengths[extended, None]
    axis[~extended, 2] = 1.0
    # Across the axis: from the coordinate along which it extends least.
    least = np.eye(3)[np.argmin(np.abs(axis), axis=1)]
    u = np.cross(axis, least)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v = np.cross(axis, u)
    angle = np.arange(SIDES) * (2.0 * np.pi / SIDES)
    around = np.cos(angle)[:, None] * u[:, None] + np.sin(angle)[:, None] * v[:, None]
    first = np.nanmean(points, axis=0)
    size = radius * extended
    rings = []
    for ring, latitude in enumerate(_LATITUDES):
        middle = np.where(extended[:, None], begin if ring < len(_LATITUDES) // 2 else end, first)
        middle = middle + (size * np.sin(latitude))[:, None] * axis
        rings.append(middle[:, None] + (size * np.cos(latitude))[:, None, None] * around)
    return np.stack(rings, axis=1).reshape(-1, 3)


def _longest(lengths: Array, finite: Any) -> float:
    """Of the runs of lines between rows of NaN."""
    limb = np.cumsum(~finite)[:-1]
    return float(np.bincount(limb, lengths).max(initial=0.0))


def _triangles(lines: int) -> NDArray[np.intp]:
    """(m, 3) positions of corners: two triangles between each two neighbours of two rings."""
    corner = np.arange(SIDES)
    after = (corner + 1) % SIDES
    band = np.vstack(
        [
            np.column_stack([corner, after, after + SIDES]),
            np.column_stack([corner, after + SIDES, corner + SIDES]),
        ]
    )
    count = len(_LATITUDES)
    steps = (np.arange(lines)[:, None] * count + np.arange(count - 1)).ravel() * SIDES
    return (band[None] + steps[:, None, None]).reshape(-1, 3)
