"""Find the zero and the counts per turn of joints whose encoders read counts.

A joint stands at q = s c + z where its encoder counts c. The nominal machine and the points m that
an instrument has read of it determine s and z of every joint, the target u, and where the
instrument stands:

    min  sum |S (o(q) + R(q) u) + t - m|^2.

Many random starts are improved together (Levenberg and Marquardt), the better ones to the end.
A machine that is only nominal leaves an error in s, which the project estimates as a scale.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.files.recognition.conditions import Conditions
from loopcal.files.recognition.fields import Field, names_of
from loopcal.files.recognition.layouts import Layout
from loopcal.files.recognition.meanings import Meaning, meanings
from loopcal.units import from_si
from loopcal.workflow.beginning.searching import Machine, as_large

COUNTS, WHOLE = 1e4, 1e3
"""Joint readings beyond this are in no unit of angle; whole numbers beyond the other."""
_SPANS = {"rad": (0.5, 6.0), "m": (0.05, 3.0)}
"""Between these a joint moves in a calibration [rad, m]: where the search begins, not where it has
to end."""
_POSES, _STARTS, _BATCHES, _SEED = 40, 240, 3, 0
"""Of such starts one in thirty leads to the machine (six-axis arms)."""
_FIRST, _ROUNDS, _BEST = 6, 25, 24
_FITS, _STEP = 0.02, 1e-6
_EQUAL = 1.5
"""Solutions that leave so little more than the best are of the same machine seen another way."""
SD = 0.02
"""Prior sd of the scale that is left: four times the largest error (0.5 %) of simulated fits."""


@dataclass(frozen=True, eq=False)
class Counted:
    """columns: as --joints states them; layout: the columns that were read."""

    columns: str
    layout: Layout

    def stated(self, conditions: Conditions, machine: Machine) -> Conditions:
        """With the scale of each joint to be estimated, and words on it."""
        effect = {"type": "scale", "joints": [*machine.joints]}
        parameters = {f"{n}_scale": {"value": 0.0, "unit": "1", "sd": SD} for n in machine.joints}
        table = dict(conditions.table)
        table["effect"] = [*table.get("effect", ()), effect]
        words = (
            f"{names_of(self.layout.joints)} read like counts of encoders. Their zeros and counts "
            "per turn were found by trying, and the scale that is left of each joint is estimated. "
            f"Where you know the counts per turn, state them in --joints '{self.columns}'."
        )
        return replace(
            conditions,
            table={**table, "parameters": parameters},
            remarks=(*conditions.remarks, words),
        )


def counted(machine: Machine, layouts: Sequence[Layout]) -> Counted | None:
    """How encoders count, where columns without a unit read so; None where nothing fits."""
    for layout in layouts:
        if machine.frame is not None or not reads_counts(layout.joints):
            continue
        for seen in layout.seen:
            for meaning in meanings(seen):
                if meaning.in_space and not meaning.inverted:
                    done = _solved(machine, layout, meaning)
                    if done is not None:
                        return done
    return None


def reads_counts(columns: Sequence[Field]) -> bool:
    """Whether columns without a unit read beyond all angles, whole numbers sooner."""
    largest = max(float(np.nanmax(np.abs(f.values), initial=0.0)) for f in columns)
    whole = all(f.resolution() >= 1.0 for f in columns if f.span)
    return largest > (WHOLE if whole else COUNTS) and not any(f.unit for f in columns)


@dataclass(frozen=True, eq=False)
class _Starts:
    """Scales (S, n) of normal counts, zeros (S, n), targets (S, 3)."""

    scales: Array
    zeros: Array
    targets: Array

    @classmethod
    def random(cls, rng: np.random.Generator, units: Sequence[str]) -> _Starts:
        low, high = np.log([_SPANS[si] for si in units]).T
        size = (_STARTS, len(units))
        scales = 0.5 * np.exp(rng.uniform(low, high, size)) * rng.choice([-1.0, 1.0], size)
        turn = np.where([si == "rad" for si in units], np.pi / 2, 0.5)
        return cls(scales, rng.uniform(-turn, turn, size), np.zeros((_STARTS, 3)))

    def moved(self, steps: Array) -> _Starts:
        n = self.scales.shape[1]
        by = np.split(steps[:, : 2 * n + 3], [n, 2 * n], axis=1)
        return _Starts(self.scales + by[0], self.zeros + by[1], self.targets + by[2])

    def where(self, ok: NDArray[np.bool_], other: _Starts) -> _Starts:
        """These where ok, the others elsewhere."""
        pairs = zip(self.parts, other.parts, strict=True)
        return _Starts(*(np.where(ok[:, None], a, b) for a, b in pairs))

    def taken(self, index: NDArray[np.intp]) -> _Starts:
        return _Starts(*(part[index] for part in self.parts))

    def order(self, i: int) -> tuple[float, int]:
        """Of solutions of one machine first those with the target near its body, then those whose
        joints count forwards: a wrist has two."""
        return round(float(np.linalg.norm(self.targets[i])), 2), int((self.scales[i] < 0.0).sum())

    @property
    def parts(self) -> tuple[Array, Array, Array]:
        return self.scales, self.zeros, self.targets


def _solved(machine: Machine, layout: Layout, meaning: Meaning) -> Counted | None:
    """The scales and zeros with which the points of one instrument fit."""
    counts = np.array([f.values for f in layout.joints]).T
    rows = np.flatnonzero(
        np.isfinite(counts).all(axis=1) & np.isfinite(meaning.position).all(axis=1)
    )
    rows = rows[np.unique(np.linspace(0, len(rows) - 1, min(len(rows), _POSES)).astype(int))]
    if 3 * len(rows) <= 2 * counts.shape[1] + 9:
        return None
    low, high = counts[rows].min(axis=0), counts[rows].max(axis=0)
    if (low == high).any():
        return None
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    search = _Search(machine, (counts[rows] - middle) / half, meaning.position[rows])
    rng = np.random.default_rng(_SEED)
    for _ in range(_BATCHES):
        starts = _Starts.random(rng, machine.units)
        # In another unit of length no joint that moves as joints do explains the points.
        if not as_large(meaning, machine.bodies(search.joints(starts))):
            return None
        improved, shares = search.improved(starts)
        good = np.flatnonzero(shares <= max(_EQUAL * shares.min(), 1e-9))
        if shares.min() <= _FITS:
            i = min(map(int, good), key=improved.order)
            scale = improved.scales[i] / half
            zero = improved.zeros[i] - scale * middle
            return Counted(_columns(layout, machine.units, scale, zero), layout)
    return None


def _columns(layout: Layout, units: Sequence[str], scale: Array, zero: Array) -> str:
    parts = []
    for f, si, s, z in zip(layout.joints, units, scale, zero, strict=True):
        of, turn = ("deg", 2.0 * np.pi) if si == "rad" else ("mm", np.inf)
        z = z - turn * np.round(z / turn) if np.isfinite(turn) else z
        s, z = from_si(s, of), from_si(z, of)
        factor = np.format_float_positional(abs(s), 7, fractional=False, trim="-")
        parts.append(f"{'-' if s < 0.0 else ''}{f.label}*{factor}{z:+.4f}")
    return ",".join(parts)


@dataclass(frozen=True, eq=False)
class _Search:
    """machine; counts: (N, n) from -1 to 1; points: (N, 3) [m]."""

    machine: Machine
    counts: Array
    points: Array

    def joints(self, at: _Starts) -> dict[str, Array]:
        """Readings [SI] of all starts, one behind the other."""
        q = at.scales[:, None] * self.counts + at.zeros[:, None]
        return {n: q[..., k].ravel() for k, n in enumerate(self.machine.joints)}

    def improved(self, at: _Starts) -> tuple[_Starts, Array]:
        """The best starts at their least squares, and their misfits as shares of the spread."""
        damping = np.full(len(at.scales), 1e-2)
        left, J = self._linear(at)
        for i in range(_ROUNDS):
            A, g = J.transpose(0, 2, 1) @ J, np.einsum("srp,sr->sp", J, left)
            d = np.einsum("spp->sp", A)
            each = np.arange(d.shape[1])
            A[:, each, each] = d + damping[:, None] * (d + 1e-6 * d.max(axis=1, keepdims=True))
            ahead = at.moved(-np.linalg.solve(A, g[..., None])[..., 0])
            new, ahead_J = self._linear(ahead)
            ok = np.square(new).sum(axis=1) < np.square(left).sum(axis=1)
            at = ahead.where(ok, at)
            left = np.where(ok[:, None], new, left)
            J = np.where(ok[:, None, None], ahead_J, J)
            damping = np.where(ok, damping / 5.0, damping * 4.0)
            if i == _FIRST:
                best = np.argsort(np.square(left).sum(axis=1))[:_BEST]
                at, left, J, damping = at.taken(best), left[best], J[best], damping[best]
        about = self.points - self.points.mean(axis=0)
        shares = np.sqrt(np.square(left).sum(axis=1) / np.square(about).sum())
        return at, shares

    def _linear(self, at: _Starts) -> tuple[Array, Array]:
        """Residuals (S, 3N) of points placed by alignment, and their derivatives by scales, zeros,
        targets and the placement."""
        S, N, n = len(at.scales), *self.counts.shape
        joints = self.joints(at)
        R, body = self._body(joints, at.targets)
        about = body - body.mean(axis=1, keepdims=True)
        aimed = self.points - self.points.mean(axis=0)
        U, _, Vt = np.linalg.svd(np.einsum("sni,nj->sij", about, aimed))
        signs = np.ones((S, 3))
        signs[:, 2] = np.sign(np.linalg.det(U @ Vt))
        turn = np.einsum("sji,sj,skj->sik", Vt, signs, U)
        placed = np.einsum("sij,snj->sni", turn, about)
        J = np.empty((S, N, 3, 2 * n + 9))
        for k, name in enumerate(self.machine.joints):
            moved = self._body({**joints, name: joints[name] + _STEP}, at.targets)[1]
            J[..., n + k] = np.einsum("sij,snj->sni", turn, (moved - body) / _STEP)
            J[..., k] = J[..., n + k] * self.counts[None, :, k, None]
        J[..., 2 * n : 2 * n + 3] = turn[:, None] @ R
        for k, axis in enumerate(np.eye(3)):
            J[..., 2 * n + 3 + k] = np.cross(axis, placed)
            J[..., 2 * n + 6 + k] = axis
        return (placed - aimed).reshape(S, -1), J.reshape(S, 3 * N, -1)

    def _body(self, joints: Mapping[str, Array], targets: Array) -> tuple[Array, Array]:
        """Rotations (S, N, 3, 3) and places of the targets (S, N, 3)."""
        bodies = self.machine.bodies(dict(joints))
        shape = (len(targets), len(self.counts))
        R = bodies.rotations.reshape(*shape, 3, 3)
        return R, bodies.origins.reshape(*shape, 3) + np.einsum("snij,sj->sni", R, targets)
