"""Where the poses were measured, and by how much the machine misses it there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from loopcal.arrays import Array
from loopcal.mechanisms.chain import product
from loopcal.mechanisms.instruments.camera import CameraEntry, all_cameras
from loopcal.mechanisms.mechanism import PIXELS, Family, Mechanism
from loopcal.mechanisms.outputs import point_outputs, points
from loopcal.mechanisms.placement import inverse
from loopcal.mechanisms.skeleton import drawn_in, tree_poses
from loopcal.mechanisms.station import Station
from loopcal.report.source import Source

Readings = Mapping[str, Array]


@dataclass(frozen=True, eq=False)
class Sighting:
    """Places (d, N) [m] of what an instrument read, NaN where it did not, and computed minus
    measured there (d, N) [m], NaN where it reads no place; d is 3, of a machine in a plane 2."""

    instrument: str
    at: Array
    along: Array


def sightings(
    mechanism: Mechanism, readings: Readings, differences: Readings
) -> tuple[Sighting, ...]:
    """By instrument, in the frame in which the machine is drawn."""
    every = (_sighted(mechanism, one, readings, differences) for one in mechanism.families)
    return tuple(one for one in every if one is not None)


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
        at, to = points(family, measured), points(family, computed)
        if len(at) == 2 and mechanism.body is not None and not mechanism.body.planar:
            # x and y alone, in space: drawn on the level from which the machine's height counts
            level = 0.0 * at[:1]
            at, to = np.vstack([at, level]), np.vstack([to, level])
        return _placed(mechanism, family, readings, at, to) if len(read) > 1 else None
    return _of_target(mechanism, family, readings, differences)


def _placed(
    mechanism: Mechanism, family: Family, readings: Readings, measured: Array, computed: Array
) -> Sighting:
    """Points that an instrument states in its frame (d, N)."""
    values = mechanism.parameters.nominal
    steps = family.placement.steps if isinstance(family.placement, Station) else ()
    root = "" if mechanism.tree is None else mechanism.tree.root
    if family.against in ("base", root) and steps == drawn_in(mechanism):
        return Sighting(family.name, measured, computed - measured)
    T = body_pose(mechanism, readings, family.against) @ inverse(product(steps, {}, values))
    d = len(measured)  # a plane is that of x and y
    at, to = (
        np.einsum("nij,jn->in", T[:, :d, :d], p) + T[:, :d, 3].T for p in (measured, computed)
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
    at = _points(body_pose(mechanism, readings, family.on), first)
    at = np.where(np.isfinite(off), at, np.nan)
    if family.form != "gap" or second is None:
        return Sighting(family.name, at, np.full_like(at, np.nan))
    apart = at - _points(body_pose(mechanism, readings, family.against), second)
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
    return (T[:, :3, :3] @ point + T[:, :3, 3]).T


def joined(every: Sequence[Sighting]) -> Sighting | None:
    """Each pose by the first instrument that read a place and an error, else a place; None without
    any place."""
    first, *others = every or (None,)
    if first is None:
        return None
    d = min(len(one.at) for one in every)  # what reads x and y alone is drawn in their plane
    at, along = first.at[:d], first.along[:d]
    for one in (Sighting(o.instrument, o.at[:d], o.along[:d]) for o in others):
        lacking = ~np.isfinite(at + along).all(axis=0)
        better = np.isfinite(one.at + one.along).all(axis=0) | ~np.isfinite(at).all(axis=0)
        at, along = (
            np.where(lacking & better, new, old) for new, old in ((one.at, at), (one.along, along))
        )
    return Sighting(first.instrument, at, along) if np.isfinite(at).any() else None


def seen(source: Source, differences: Readings) -> Sighting | None:
    """Where the poses were measured and by how much the machine misses it; None: nothing says so.

    Loops of a user's own are seen by their outputs, as far as these are two or three lengths.
    """
    table, mechanism = source.table, source.mechanism
    every = {**table.pose_constants, **table.readings}
    if mechanism is not None and mechanism.families:
        return joined(sightings(mechanism, every, differences))
    units = getattr(source.document.mechanism or mechanism, "quantities", {})
    lengths = [q for q in differences if units.get(q, "m") == "m"]
    if len(lengths) not in (2, 3) or not {*lengths} <= table.readings.keys():
        return None
    at, along = (np.array([of[q] for q in lengths]) for of in (table.readings, differences))
    return Sighting("", at, along)


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
    T_on, T_against = (body_pose(mechanism, readings, b) for b in (family.on, family.against))
    if entry.on_body:
        return T_on @ entry.T_eye, T_against @ inverse(entry.T_board)
    return T_against @ inverse(entry.T_eye), T_on @ entry.T_board


def body_pose(mechanism: Mechanism, readings: Readings, body: str) -> Array:
    """T_drawn_body (N, 4, 4); NaN where nothing places the body."""
    count = len(next(iter(readings.values()), ()))
    constants = mechanism.pose_constants
    # A quaternion that is not read is that of no turn.
    unturned = {name: np.full(count, float(name.endswith("w"))) for name in constants}
    implied = {name: np.full(count, value) for name, value in mechanism.implied.items()}
    T = tree_poses(mechanism, {**unturned, **implied, **readings}, body)
    return np.full((count, 4, 4), np.nan) if T is None else T
