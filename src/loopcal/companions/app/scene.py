"""A machine in a pose as a figure in space shows it: limbs, cameras, boards, and what touches."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.companions.app.capsules import body, capsules, vertices
from loopcal.figures.figure import names, numbers, spots
from loopcal.files.machines.drawn_links import DrawnLinks
from loopcal.mechanisms.chain import product
from loopcal.mechanisms.instruments.camera import CameraEntry, all_cameras
from loopcal.mechanisms.mechanism import PIXELS, Family, Mechanism
from loopcal.mechanisms.outputs import point_outputs, points
from loopcal.mechanisms.placement import inverse
from loopcal.mechanisms.skeleton import drawn_in, skeleton, tree_poses
from loopcal.mechanisms.station import Station

Array = NDArray[np.float64]
Readings = Mapping[str, Array]
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
        values = {p.name: p.nominal for p in self.mechanism.parameters}
        T = product(drawn_in(self.mechanism), {}, values)
        at: Array = self.links.placed(joints) @ T[:3, :3].T + T[:3, 3]
        return at

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
        T = _pose(self.mechanism, one, body)[0]
        at: Array = T[:3, :3] @ point + T[:3, 3]
        return at


def _pen(pieces: Mapping[str, Array]) -> tuple[Array, list[str]]:
    """Points (k, 3) of one line, NaN between its pieces, and the label at each."""
    lifted = np.full((1, 3), np.nan)
    line = [part for piece in pieces.values() for part in (piece, lifted)]
    labels = [text for label, piece in pieces.items() for text in (label, *[""] * len(piece))]
    return np.vstack(line), labels


def centres(mechanism: Mechanism, family: Family) -> tuple[Array | None, Array | None]:
    """(3,) each: what is looked at on the one body, and the point on the other one that it is
    looked at from; None where that is no point."""
    parameters = {p.name: p for p in mechanism.parameters}
    mounted = [parameters[n] for n in family.mounted if parameters[n].unit == "m"]
    first = [p.nominal for p in mounted if p.role == "mounting"]
    second = [parameters[n].nominal for n in family.standing]
    return (
        np.array(first) if len(first) == 3 else None,
        np.array(second) if len(second) == 3 else None,
    )


def camera_places(
    mechanism: Mechanism, entry: CameraEntry, family: Family, readings: Readings
) -> tuple[Array, Array]:
    """T_drawn_camera and T_drawn_board (N, 4, 4) at readings (N,)."""
    T_on, T_against = (_pose(mechanism, readings, b) for b in (family.on, family.against))
    if entry.on_body:
        return T_on @ entry.T_eye, T_against @ inverse(entry.T_board)
    return T_against @ inverse(entry.T_eye), T_on @ entry.T_board


def _pose(mechanism: Mechanism, readings: Readings, body: str) -> Array:
    """T_drawn_body (N, 4, 4); NaN where nothing places the body."""
    count = len(next(iter(readings.values()), ()))
    constants = mechanism.pose_constants
    # A quaternion that is not read is that of no turn.
    unturned = {name: np.full(count, float(name.endswith("w"))) for name in constants}
    T = tree_poses(mechanism, {**unturned, **_implied(mechanism, count), **readings}, body)
    return np.full((count, 4, 4), np.nan) if T is None else T


def _implied(mechanism: Mechanism, count: int) -> Readings:
    return {name: np.full(count, value) for name, value in mechanism.implied.items()}


def _pyramid(entry: CameraEntry, T: Array, length: float) -> Array:
    """(11, 3) a line along the edges of a camera's pyramid of sight."""
    lens = entry.intrinsics
    width, height = lens.image or (2.0 * lens.cx, 2.0 * lens.cy)
    across = np.array([width / lens.fx, height / lens.fy]) / 2.0
    ends = [[x, y, 1.0] for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    corners = np.vstack([np.zeros(3), np.array(ends) * [*across, 1.0]]) * length
    line: Array = (corners @ T[:3, :3].T + T[:3, 3])[_EDGES]
    return line


def _outline(entry: CameraEntry, corners: Array) -> Array:
    """A board's edge, or a star of the points of a thing that is not flat."""
    board = entry.board
    if not board.planar or len(board.points) < 4:
        middle = corners.mean(axis=0)
        return np.array([end for corner in corners for end in (middle, corner)])
    x, y = board.xyz[:, 0], board.xyz[:, 1]
    at = [int(np.argmin(a * x + b * y)) for a, b in ((1, 1), (-1, 1), (-1, -1), (1, -1), (1, 1))]
    return corners[at]


# Where the poses were measured, and by how much the machine misses it there.


@dataclass(frozen=True, eq=False)
class Sighting:
    """Places (3, N) [m] of what an instrument read, NaN where it did not, and computed minus
    measured there (3, N) [m], NaN where it reads no place."""

    instrument: str
    at: Array
    along: Array


def sightings(
    mechanism: Mechanism, readings: Readings, differences: Readings
) -> tuple[Sighting, ...]:
    """By instrument, in the frame in which the machine is drawn; none of machines in a plane."""
    count = len(next(iter(readings.values()), ()))
    every = (_sighted(mechanism, one, readings, differences) for one in mechanism.families)
    return tuple(one for one in every if one is not None and one.at.shape == (3, count))


def _sighted(
    mechanism: Mechanism, family: Family, readings: Readings, differences: Readings
) -> Sighting | None:
    if not {*family.readings} & {*differences}:
        return None
    if family.form == PIXELS:
        return _of_image(mechanism, family, readings, differences)
    read = point_outputs(mechanism, family)
    if read and {*read} <= readings.keys() and {*read} <= differences.keys():
        measured = np.array([readings[q] for q in read])
        computed = measured + np.array([differences[q] for q in read])
        if len(read) != 3:
            return None
        return _placed(
            mechanism, family, readings, points(family, measured), points(family, computed)
        )
    return _of_target(mechanism, family, readings, differences)


def _placed(
    mechanism: Mechanism, family: Family, readings: Readings, measured: Array, computed: Array
) -> Sighting:
    """Points that an instrument states in its frame (3, N)."""
    values = {p.name: p.nominal for p in mechanism.parameters}
    steps = family.placement.steps if isinstance(family.placement, Station) else ()
    root = "" if mechanism.tree is None else mechanism.tree.root
    if family.against in ("base", root) and steps == drawn_in(mechanism):
        return Sighting(family.name, measured, computed - measured)
    T = _pose(mechanism, readings, family.against) @ inverse(product(steps, {}, values))
    at, to = (
        np.einsum("nij,jn->in", T[:, :3, :3], p) + T[:, :3, 3].T for p in (measured, computed)
    )
    return Sighting(family.name, at, to - at)


def _of_target(
    mechanism: Mechanism, family: Family, readings: Readings, differences: Readings
) -> Sighting | None:
    """What touches, or is read along a length: where the target is on its body."""
    first, second = centres(mechanism, family)
    if first is None:
        return None
    off = differences[next(q for q in family.readings if q in differences)]
    at = _points(_pose(mechanism, readings, family.on), first)
    at = np.where(np.isfinite(off), at, np.nan)
    if family.form != "gap" or second is None:
        return Sighting(family.name, at, np.full_like(at, np.nan))
    apart = at - _points(_pose(mechanism, readings, family.against), second)
    return Sighting(family.name, at, off * apart / np.linalg.norm(apart, axis=0))


def _of_image(
    mechanism: Mechanism, family: Family, readings: Readings, differences: Readings
) -> Sighting | None:
    """The middle of the board; a mean error of its corners [px] is one across the view there."""
    entry = next((c for c in all_cameras(mechanism) if c.instrument == family.name), None)
    if entry is None:
        return None
    T_camera, T_board = camera_places(mechanism, entry, family, readings)
    at = _points(T_board, entry.board.xyz.mean(axis=0))
    lost = np.full(at.shape[1], np.nan)
    off = np.array(
        [[differences.get(q, lost) for q in family.readings[i::2]] for i in range(2)]
    )  # (2, points, N)
    seen = np.isfinite(off).all(axis=0)
    mean = np.where(seen, off, 0.0).sum(axis=1) / np.where(
        seen.any(axis=0), seen.sum(axis=0), np.nan
    )
    depth = np.einsum("ni,in->n", T_camera[:, :3, 2], at - T_camera[:, :3, 3].T)
    lens = entry.intrinsics
    across = mean * depth / np.array([[lens.fx], [lens.fy]])
    along = np.einsum("nij,jn->in", T_camera[:, :3, :2], across)
    return Sighting(entry.instrument, np.where(seen.any(axis=0), at, np.nan), along)


def _points(T: Array, point: Array) -> Array:
    """(3, N) a point of a body at its places (N, 4, 4)."""
    at: Array = (T[:, :3, :3] @ point + T[:, :3, 3]).T
    return at


def joined(every: Sequence[Sighting], count: int) -> Array | None:
    """(3, N) the place of each pose by the first instrument that read it; None without any."""
    at = np.full((3, count), np.nan)
    for one in every:
        at = np.where(np.isfinite(at), at, one.at)
    return at if np.isfinite(at).any() else None


def restyled(every: Sequence[Array], first: int) -> list[Any]:
    """What `restyle` of plotly makes of traces with these points, the first one's number on."""
    update = {k: [numbers(at[:, i]) for at in every] for i, k in enumerate("xyz")}
    return [update, [*range(first, first + len(every))]]
