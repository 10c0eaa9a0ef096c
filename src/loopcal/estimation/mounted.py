"""Where an instrument stands and what it looks at, found from the frames of a body.

Only the nominal machine takes part, as rotations R (N, 3, 3) and origins o (N, 3) of its body. What
no drawing states is found by least squares over nine tenths of the poses, so that gross errors do
not bend it (least trimmed squares, Rousseeuw 1984). S and t place the machine in the instrument's
frame, u and X place the target on the body, A is a point fixed beside the machine:

    point   S (o + R u) + t = m                pose   the same, and S R X = M
    length  |o + R u - A| + c = l          planar  the first two of S (o + R u) + t = m

What the machine misses is common to its poses and does not average out. Where they hardly turn the
body, u takes up such errors and runs metres away. Hence the mean square of what is left, `COMMON`
times as large, weighs against what is known of mountings, u ~ N(0, `NEAR`^2): poses that turn the
body determine u, others leave it at the body's origin. The misfits are those of the free fit.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.errors import InputError
from loopcal.estimation.problem.alignment import align
from loopcal.mechanisms.chain import last_frame
from loopcal.mechanisms.frame import ChainFrame

# docs/decisions/0052.
KEPT = 0.9
"""The share of the poses that decides."""
# docs/decisions/0056: a guess, wide enough that a tool of any usual size is inside.
NEAR, TURNED = 0.2, 1.0
"""Prior sds of a mounting that nobody states: it is within so much [m] of the body's origin, and
turned by so much [rad] from where the readings say."""
# Chosen, not derived: larger holds mountings at the body's origin, smaller lets them run away.
COMMON = 5.0
"""How many times as large as what remains the errors are that placement and mounting take up."""
# Chosen, not derived: caps of an alternation that starts in closed form, for their time.
_ROUNDS, _STEPS = 4, 12
_LITTLE, _SLOW = 0.3, 0.98
"""A fit that leaves more than this share of the spread, or so many radians, ends where a step gains
less than 2 %."""
_MOST = 5_000
"""Poses that decide at most: a drawing is off by far more than so many leave open."""
# Chosen, not derived: as well as drawings usually fit; other starts are not tried below.
_WELL = 0.02
# Chosen, not derived: each alternation costs one alignment, and few poses determine no target.
_TURNS, _FEWEST = 100, 8
"""Alternations that tell two targets apart, and the poses that each must have."""
_FACES = tuple(
    np.array(rows, dtype=np.float64)
    for rows in (
        ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
        ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
        ((0, 1, 0), (0, 0, 1), (1, 0, 0)),
        ((0, -1, 0), (0, 0, 1), (-1, 0, 0)),
        ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
        ((-1, 0, 0), (0, 0, 1), (0, 1, 0)),
    )
)
"""S of stations that look at a plane of the base: down and up, then along x and y, both ways."""
_CLEARER = 0.5
"""A way to face that leaves at least so little of the misfit takes the place of one before it."""
_WEAK = 1e-6
"""A direction of the placement that the poses determine so much less than others stays as it is."""


# Chosen, not derived: leaves out a twentieth on each side, more than gross errors are.
_MIDDLE = (0.05, 0.95)


def extent(points: Array) -> float:
    """How far [m] the middle nine tenths of points (N, 3) reach along their longest axis; 0 of
    none."""
    complete = points[np.isfinite(points).all(axis=1)]
    if not len(complete):
        return 0.0
    return float(np.ptp(np.quantile(complete, _MIDDLE, axis=0), axis=0).max())


@dataclass(frozen=True, eq=False)
class Bodies:
    """Frames of the body in the machine's base: rotations (N, 3, 3), origins (N, 3) [m]."""

    rotations: Array
    origins: Array

    @property
    def complete(self) -> NDArray[np.bool_]:
        """(N,) whether all joints were read."""
        return np.asarray(np.isfinite(self.origins).all(axis=1))

    @cached_property
    def extent(self) -> float:
        """How far [m] the origins move along the axis on which they move most."""
        return extent(self.origins)

    def take(self, which: NDArray[np.intp] | NDArray[np.bool_] | slice) -> Bodies:
        """In these poses."""
        return Bodies(self.rotations[which], self.origins[which])

    def at(self, targets: Array) -> Array:
        """(N, 3) the points of the body at one place on it, (3,), or at one for each pose."""
        return self.origins + (self.rotations @ targets[..., None])[..., 0]


@dataclass(frozen=True, eq=False)
class Mounted:
    """What was found.

    place: computes `targets`; turn: X of a pose, (3, 3); stands: S of what reads x and y alone;
    anchor: A, (3,) [m]; zero: c [m]; away: (N,) distances [m] (of several targets the root of the
    sum of squares); turned: (N,) angles [rad] of a pose; spread: median distance [m] of the
    readings from their middle.
    """

    away: Array
    spread: float
    place: Callable[[], Array]
    turn: Array | None = None
    stands: Array | None = None
    anchor: Array | None = None
    zero: float = 0.0
    turned: Array | None = None

    @cached_property
    def targets(self) -> Array:
        """(K, 3) [m] on the body, held near it as the head of this module says."""
        return self.place()

    @property
    def shares(self) -> Array:
        """(N,) misfits as shares of the spread, with the angles of a pose in rad."""
        shares = self.away / max(self.spread, 1e-12)
        return shares if self.turned is None else np.hypot(shares, self.turned)

    @property
    def share(self) -> float:
        """Rms of the better nine tenths; infinite where nothing was read."""
        return _rms(self.shares)

    @property
    def rms(self) -> float:
        """Rms [m] of the better nine tenths of the distances."""
        return _rms(self.away)


def _rms(away: Array) -> float:
    distances = np.sort(away[np.isfinite(away)])
    if not distances.size:
        return float("inf")
    return float(np.sqrt(np.square(distances[: max(int(KEPT * distances.size), 1)]).mean()))


def see_points(bodies: Bodies, measured: Array, rounds: int = _ROUNDS) -> Mounted:
    """Targets (K of them) on one body, seen as points (K, N, 3) [m] from one station.

    Raises InputError where the points do not determine where the instrument stands.
    """
    rows = _deciding(np.isfinite(measured).all(axis=(0, 2)) & bodies.complete)
    some, seen = bodies.take(rows), measured[:, rows]
    spread = _spread(measured[0])
    # A body whose origin hardly moves says little of how the station is turned: targets aside do.
    still, aside = bodies.extent < spread, spread * np.vstack([np.eye(3), -np.eye(3)])
    first = np.zeros(3) if bodies.extent > _WEAK * spread else aside[0]
    placed, good = _trimmed(some, seen, first, rounds)
    for start in aside if still else ():
        if _rms(placed.away(some, seen)) <= _WELL * spread:
            break
        other, rest = _trimmed(some, seen, start, rounds)
        if _rms(other.away(some, seen)) < _rms(placed.away(some, seen)):
            placed, good = other, rest

    def place() -> Array:
        # From the free fit on, whose misfit is that of the machine: from the body's origin it would
        # be that of the mounting, and hold a target there that is mounted far from it.
        return _points(some.take(good), seen[:, good], placed.targets, COMMON, spread).targets

    return Mounted(placed.away(bodies, measured), spread, place)


@dataclass(frozen=True, eq=False)
class _Placed:
    """Targets (K, 3) on a body that a station sees turned by S and shifted by t."""

    targets: Array
    S: Array
    t: Array

    @classmethod
    def on(cls, bodies: Bodies, measured: Array, targets: Array) -> _Placed:
        """As these poses are aligned best."""
        seen = np.array([bodies.at(u) for u in targets])
        motion = align(seen.reshape(-1, 3).T, measured.reshape(-1, 3).T)
        return cls(targets, motion.rotation, motion.shift)

    def points(self, bodies: Bodies) -> Array:
        """(K, N, 3) the targets as the station sees them."""
        return np.array([bodies.at(u) for u in self.targets]) @ self.S.T + self.t

    def away(self, bodies: Bodies, measured: Array) -> Array:
        """(N,) distances from what was measured; of several targets the root of their squares."""
        distances: Array = np.sqrt(np.square(self.points(bodies) - measured).sum(axis=(0, 2)))
        return distances


def _trimmed(
    bodies: Bodies, measured: Array, aside: Array, rounds: int
) -> tuple[_Placed, NDArray[np.bool_]]:
    """The fit of the better nine tenths of the poses, begun with all targets `aside`, and which."""
    good, spread = np.ones(measured.shape[1], dtype=np.bool_), _spread(measured[0])
    placed = _Placed(np.tile(aside, (len(measured), 1)), np.eye(3), np.zeros(3))
    for _ in range(rounds):
        placed = _points(bodies.take(good), measured[:, good], placed.targets, spread=spread)
        good = _better(placed.away(bodies, measured))
    return placed, good


def _points(
    bodies: Bodies, measured: Array, targets: Array, common: float = 0.0, spread: float = math.inf
) -> _Placed:
    """Placement and targets (K, 3) that fit some poses, all of them read; spread: of readings that
    may not be of this body."""
    (K, n, _), before, little = measured.shape, np.inf, _LITTLE * spread
    for _ in range(_STEPS):
        now = _Placed.on(bodies, measured, targets)
        placed = now.points(bodies)
        left = measured - placed
        rms = float(np.sqrt(np.square(left).sum() / (K * n)))
        if little < rms and _SLOW * before < rms:
            return now  # of points that are not of this body nothing is left to be gained
        before = rms
        J = np.zeros((K, n, 3, 6 + 3 * K))
        # A small turn w moves v by w x v = -[v] w.
        J[..., :3] = -_cross(placed - now.t)
        J[..., 3:6] = np.eye(3)
        for k in range(K):
            J[k, ..., 6 + 3 * k : 9 + 3 * k] = now.S @ bodies.rotations
        step = _held(J.reshape(-1, 6 + 3 * K), left.reshape(-1), targets.reshape(-1), K * n, common)
        moved = step[6:].reshape(K, 3)
        targets = targets + moved
        if np.abs(moved).max() < 1e-7:
            break
    return _Placed.on(bodies, measured, targets)


@dataclass(frozen=True, eq=False)
class TwoTargets:
    """Points of two targets on one body in turn.

    second: (N,) the points of the fewer, False where nothing was read; apart: between the targets
    [m]; share: rms of the better nine tenths of what is left, as a share of the spread.
    """

    second: NDArray[np.bool_]
    apart: float
    share: float


def two_targets(bodies: Bodies, measured: Array) -> TwoTargets | None:
    """Points (N, 3) [m] told apart as those of two targets that one station sees.

    In turn each point is taken to the nearer target on the body, each target to the mean of its
    points there, and the station to where all are aligned best (k-means, Lloyd 1982). None where
    one of the targets has too few points, or the points do not align.
    """
    rows = np.flatnonzero(np.isfinite(measured).all(axis=1) & bodies.complete)
    some, seen = bodies.take(rows), measured[rows]
    if len(rows) < 2 * _FEWEST:
        return None
    try:
        placed = _points(some, seen[None], np.zeros((1, 3)))
        second = np.zeros(len(rows), dtype=np.bool_)
        for number in range(_TURNS):
            base = (seen - placed.t) @ placed.S - some.origins
            on_body = np.einsum("nji,nj->ni", some.rotations, base)
            if number == 0:
                about = on_body - np.median(on_body, axis=0)
                second = about @ np.linalg.svd(about, full_matrices=False)[2][0] > 0.0
            else:
                away = np.linalg.norm(on_body[None] - placed.targets[:, None], axis=2)
                second = away[1] < away[0]
            if min(second.sum(), (~second).sum()) < _FEWEST:
                return None
            targets = np.array([on_body[~second].mean(axis=0), on_body[second].mean(axis=0)])
            motion = align(some.at(targets[second.astype(np.intp)]).T, seen.T)
            placed = _Placed(targets, motion.rotation, motion.shift)
    except InputError:
        return None
    left = seen - (some.at(placed.targets[second.astype(np.intp)]) @ placed.S.T + placed.t)
    fewer = second if 2 * second.sum() <= len(rows) else ~second
    which = np.zeros(len(measured), dtype=np.bool_)
    which[rows[fewer]] = True
    apart = float(np.linalg.norm(placed.targets[1] - placed.targets[0]))
    return TwoTargets(which, apart, _rms(np.linalg.norm(left, axis=1)) / max(_spread(seen), 1e-12))


def exchanged_targets(bodies: Bodies, one: Array, other: Array) -> NDArray[np.bool_]:
    """(N,) where two targets on one body, points (N, 3) [m] each, stand in each other's columns.

    Half-way between them nothing is exchanged: that point places the station. The way w_i on the
    body from one target to the other is then v, or -v where they are exchanged, in the fewer poses;
    True only where |w_i + v| < |v| / 3, and nowhere unless as many tenths as decide are so near v
    or -v.
    """
    which = np.zeros(len(one), dtype=np.bool_)
    rows = np.flatnonzero(np.isfinite(one + other).all(axis=1) & bodies.complete)
    if len(rows) < 2 * _FEWEST:
        return which
    some, middle = bodies.take(rows), 0.5 * (one + other)[rows]
    try:
        placed = _points(some, middle[None], np.zeros((1, 3)))
    except InputError:
        return which
    way = np.einsum("nji,nj->ni", some.rotations, (other - one)[rows] @ placed.S)
    back = way @ np.linalg.svd(way, full_matrices=False)[2][0] > 0.0
    back = back if 2 * back.sum() <= len(rows) else ~back
    forth = np.where(back[:, None], -way, way)
    v = np.median(forth, axis=0)
    near = np.linalg.norm(forth - v, axis=1) < np.linalg.norm(v) / 3.0
    if near.mean() >= KEPT:
        which[rows[back & near]] = True
    return which


def see_poses(bodies: Bodies, measured: Array, turns: Array, rounds: int = _ROUNDS) -> Mounted:
    """A frame on the body, seen as positions (N, 3) [m] and rotations M (N, 3, 3)."""
    spread = max(_spread(measured), 1e-12)
    read = np.isfinite(measured).all(axis=1) & np.isfinite(turns).all(axis=(1, 2)) & bodies.complete
    _better(np.where(read, 0.0, np.nan))
    decides = np.isin(np.arange(len(read)), _deciding(read))
    good = decides
    near = np.zeros(3)
    for _ in range(rounds):
        S, X = _hand_eye(bodies.rotations[good], turns[good])
        n = int(good.sum())
        J = np.concatenate([np.tile(np.eye(3), (n, 1, 1)), S @ bodies.rotations[good]], axis=2)
        rest = measured[good] - bodies.origins[good] @ S.T
        columns, left = J.reshape(-1, 6), rest.reshape(-1)
        near = _held(columns, left, np.zeros(3), n, COMMON)[3:]
        solution = np.linalg.lstsq(columns, left, rcond=_WEAK)[0]
        t, u = solution[:3], solution[3:]
        off = bodies.at(u) @ S.T + t - measured
        away = np.sqrt(np.square(off).sum(axis=1))
        M = np.swapaxes(turns, 1, 2) @ S @ bodies.rotations @ X
        cosine = np.clip((np.trace(M, axis1=1, axis2=2) - 1.0) / 2.0, -1.0, 1.0)
        turned = np.arccos(cosine)
        good = decides & _better(np.hypot(away / spread, turned))
    return Mounted(away, spread, lambda: near[None], turn=X, turned=turned)


def _held(J: Array, left: Array, at: Array, count: int, common: float) -> Array:
    """The Gauss-Newton step of columns J, the last of which move what is mounted, now `at`.

    It is held near the body with `common`, as the head of this module says; count: of readings.
    """
    free = np.linalg.lstsq(J, left, rcond=_WEAK)[0]
    if not common:
        return np.asarray(free, dtype=np.float64)
    remains = float(np.sqrt(np.square(left - J @ free).sum() / count))
    # |left|^2 / (count (common remains)^2) + |u|^2 / NEAR^2, times the first denominator.
    weight = np.sqrt(count) * common * remains / NEAR
    held = np.hstack([np.zeros((at.size, J.shape[1] - at.size)), weight * np.eye(at.size)])
    rows, rest = np.vstack([J, held]), np.concatenate([left, -weight * at])
    step: Array = np.linalg.lstsq(rows, rest, rcond=_WEAK)[0]
    return step


def _hand_eye(R: Array, M: Array) -> tuple[Array, Array]:
    """The rotations S and X for which S R X = M holds best, for R and M (N, 3, 3).

    At first the matrices S and X^T of given length that agree best (singular vectors of the sum of
    the products of M and R), then each in turn as a rotation. Source: Shah (2013).
    """
    n, before = len(R), np.inf
    # Sums of M_ij R_lk over the poses, as a matrix of the pairs (i, l) and (j, k).
    products = M.reshape(n, 9).T @ R.reshape(n, 9)
    both = products.reshape(3, 3, 3, 3).transpose(0, 2, 1, 3).reshape(9, 9)
    U, _, Vt = np.linalg.svd(both)
    S, Y = U[:, 0].reshape(3, 3), Vt[0].reshape(3, 3)
    sign = np.sign(np.linalg.det(S)) or 1.0
    S, Y = _rotation(sign * S), _rotation(sign * Y)
    for _ in range(30):
        last = Y
        S = _rotation((both @ Y.ravel()).reshape(3, 3))
        seen = (S.ravel() @ both).reshape(3, 3)
        Y = _rotation(seen)
        away = np.sqrt(max(3.0 - float((Y * seen).sum()) / n, 0.0))  # rms [rad] where it is small
        if np.abs(Y - last).max() < 1e-12 or (away > _LITTLE and _SLOW * before < away):
            break  # as `_points` does
        before = away
    return S, Y.T


def _rotation(matrix: Array) -> Array:
    """The rotation nearest to a matrix (3, 3)."""
    U, _, Vt = np.linalg.svd(matrix)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(U @ Vt)) or 1.0])
    nearest: Array = (U * signs) @ Vt
    return nearest


def see_planar(bodies: Bodies, measured: Array, rounds: int = _ROUNDS) -> Mounted:
    """A target on the body, of which a station reads x and y (N, 2) [m] alone.

    Begins from each way in which a plane of the base may face the station, from above first. What
    turns the station out of that plane stays where the poses do not show it.
    """
    read = np.isfinite(measured).all(axis=1) & bodies.complete
    spread = max(_spread(measured), 1e-12)
    _better(np.where(read, 0.0, np.nan))
    decides = np.isin(np.arange(len(read)), _deciding(read))
    best: Mounted | None = None
    for faces in _FACES:
        good, S, u = decides, faces, np.zeros(3)
        for _ in range(rounds):
            S, t, u = _planar(bodies.take(good), measured[good], S, u)
            away = np.linalg.norm(bodies.at(u) @ S[:2].T + t - measured, axis=1)
            good = decides & _better(np.where(read, away, np.nan))
        some, seen = bodies.take(good), measured[good]

        def place(some: Bodies = some, seen: Array = seen, S: Array = S, u: Array = u) -> Array:
            return _planar(some, seen, S, u, COMMON)[2][None]

        fit = Mounted(np.where(read, away, np.nan), spread, place, stands=S)
        if best is None or fit.share < _CLEARER * best.share:
            best = fit
    assert best is not None
    return best


def _planar(
    bodies: Bodies, measured: Array, S: Array, u: Array, common: float = 0.0
) -> tuple[Array, Array, Array]:
    """S (3, 3), t (2,) and u (3,) from these: first turned in the plane, then as `_points`."""
    n, t = len(measured), np.zeros(2)
    for number in range(_STEPS):
        placed = bodies.at(u) @ S.T
        if number == 0:
            motion = align(placed[:, :2].T, measured.T)
            about = np.eye(3)
            about[:2, :2] = motion.rotation
            S, placed, t = about @ S, placed @ about.T, motion.shift
        left = measured - placed[:, :2] - t
        # A small turn w moves v by w x v = -[v] w.
        J = np.concatenate(
            [-_cross(placed), np.tile(np.eye(3), (n, 1, 1)), S @ bodies.rotations], axis=2
        )
        J = np.delete(J[:, :2], 5, axis=2)
        step = _held(J.reshape(2 * n, 8), left.reshape(-1), u, 2 * n, common)
        S, t, u = _rotation(S + _cross(step[:3]) @ S), t + step[3:5], u + step[5:]
        if np.abs(step).max() < 1e-7:
            break
    return S, t, u


def see_lengths(bodies: Bodies, measured: Array) -> Mounted:
    """A target on the body at lengths (N,) [m] from a fixed point, with an unknown zero.

    Begins where it is linear: l^2 - o^2 = -2 o A + 2 l c + (A^2 - c^2).
    """
    decides = np.isfinite(measured) & bodies.complete
    decides = np.isin(np.arange(len(decides)), _deciding(decides))
    good, o = decides, bodies.origins
    A, c, u = np.zeros(3), 0.0, np.zeros(3)
    middle = np.median(measured[good])
    spread = float(np.median(np.abs(measured[good] - middle)))
    for first in (True, *(False,) * _ROUNDS):
        if first:
            J = np.column_stack([-2.0 * o, 2.0 * measured, np.ones(len(o))])[good]
            b = (np.square(measured) - np.square(o).sum(axis=1))[good]
            # Columns in metres beside one without unit: rcond compares lengths that must be alike.
            scale = np.linalg.norm(J, axis=0)
            scale = np.where(scale > 0.0, scale, 1.0)  # of a body that turns about one point
            solution = np.linalg.lstsq(J / scale, b, rcond=1e-9)[0] / scale
            A, c = solution[:3], float(solution[3])
        else:
            for _ in range(_STEPS):
                to = bodies.at(u) - A
                length = np.sqrt(np.square(to).sum(axis=1))
                unit = to / length[:, None]
                on_body = np.einsum("ni,nij->nj", unit, bodies.rotations)
                J = np.column_stack([-unit, np.ones(len(o)), on_body])[good]
                b = (measured - length - c)[good]
                step = _held(J, b, u, len(b), COMMON)
                size = np.abs(step).max()
                step = step * min(1.0, 0.5 / max(size, 1e-12))
                A, c, u = A + step[:3], c + float(step[3]), u + step[4:]
                if size < 1e-7:
                    break
        to = bodies.at(u) - A
        away = np.abs(np.sqrt(np.square(to).sum(axis=1)) + c - measured)
        good = decides & _better(away)
    return Mounted(away, spread, lambda: u[None], anchor=A, zero=c)


def see_planes(
    bodies: Bodies, normals: Array, ranges: Array, n: Array | None = None
) -> tuple[Array, Array, float]:
    """T_body_camera (4, 4), and the plane n . p = c [m] that a camera on the body sees.

    normals (N, 3), ranges (N,): of the plane in the camera's frame. R_i X n_i = n is best for X
    and n in turn, from n along each axis unless it is stated; c - n . (o_i + R_i t) = range_i is
    linear in c and t, of which the least step is taken.
    """
    R, o = bodies.rotations, bodies.origins
    free, ways = n is None, []
    for start in np.concatenate([np.eye(3), -np.eye(3)]) if n is None else n[None]:
        along, X = start, np.eye(3)
        for _ in range(_STEPS):
            X = _rotation(np.einsum("nji,j,nk->ik", R, along, normals))
            seen = np.einsum("nij,nj->i", R, normals @ X.T) / len(R)
            if free:
                along = seen / np.linalg.norm(seen)
        ways.append((float(seen @ along), along, X))
    _, along, X = max(ways, key=lambda way: way[0])
    J = np.column_stack([np.ones(len(R)), -along @ R])
    c, *t = np.linalg.lstsq(J, ranges + o @ along, rcond=_WEAK)[0].tolist()
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = X, t
    return T, along, c


def evenly(positions: NDArray[np.intp], most: int) -> NDArray[np.intp]:
    """So many of these positions at most, evenly spread."""
    at = np.linspace(0, len(positions) - 1, min(len(positions), most)).astype(np.intp)
    return positions[np.unique(at)]


def _deciding(read: NDArray[np.bool_]) -> NDArray[np.intp]:
    """The poses that decide, of those that were read."""
    return evenly(np.flatnonzero(read), _MOST)


def _better(away: Array) -> NDArray[np.bool_]:
    """The poses that decide; nine tenths of those that were read. Raises InputError for few."""
    distances = away[np.isfinite(away)]
    if distances.size < 5:
        raise InputError(
            f"{distances.size} poses are too few to recognise what was read",
            code="too-few-poses",
            remedy="measure at least 5 poses",
        )
    at = math.ceil(KEPT * (distances.size - 1))
    return np.asarray(away <= np.partition(distances, at)[at])


def _cross(v: Array) -> Array:
    """(..., 3, 3) matrices with [v] w = v x w."""
    out = np.zeros((*v.shape, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = v[..., 2], -v[..., 1], v[..., 0]
    return out


def _spread(points: Array) -> float:
    """Median distance [m] of points (N, 3) from their middle."""
    complete = points[np.isfinite(points).all(axis=1)]
    if not len(complete):
        return 0.0
    off = complete - np.median(complete, axis=0)
    return float(np.median(np.sqrt(np.square(off).sum(axis=1))))


def origin_rms(bodies: Bodies, measured: Array) -> float:
    """Rms [m] of points (N, 3) beside the body's origin itself, in the machine's base.

    Near zero for what a controller computed; an instrument stands elsewhere.
    """
    return _rms(np.sqrt(np.square(bodies.origins - measured).sum(axis=1)))


def bodies_of(frame: ChainFrame, count: int) -> Bodies:
    """The bodies of a chain whose joints are readings (N,) of `count` poses."""
    R, origins = last_frame(frame.steps, frame.joints, frame.parameters, count)
    # Where a joint was not read, nothing is known of the body, even if its origin stands still.
    origins[~np.isfinite(R).all(axis=(1, 2))] = np.nan
    return Bodies(R, origins)
