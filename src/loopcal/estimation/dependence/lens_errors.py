"""What no lens model describes: a smooth error over the image, which all images of a camera share.

A sensor behind a dome, or a lens whose elements are off their axis, bends rays as no model does.
Over the image (W, H) this is a field of waves, of amplitudes b ~ N(0, t L), for du and for dv,

    cos(pi m u / W) cos(pi n v / H),   L_mn ~ (1 + l^2 (m^2 pi^2 / W^2 + n^2 pi^2 / H^2) / 4)^-3,

less the lens that fits it best over the whole image, so that the parameters mean this lens; t is
the mean square of what is left. All corners of all images share b:

    E = D dp + Z b + v,   Z = T F - D_lens c,

F the waves where the lens puts the corners, T the whitening, c the best lens of each wave. (Waves
where the corners were read, less a lens that says where they are, are noise: they would explain E
by itself.) The estimate stays. In directions z with D^T D + P = I its covariance gains t A L A^T,
A = D^T Z. The images show t and l: by C = Z^T Z - A^T A and g = Z^T E - A^T (D^T E), with s the
variance of v,

    -2 log = nu log s + log |I + r L C| + (|E|^2 - r g^T (L^-1 + r C)^-1 g) / s,   t = r s,

where the best s stands for itself. What is gained is averaged over a grid of r and l. C, g and E
here are those without priors. L is the spectrum of a Matern covariance of order 2 (Stein 1999).

The field moves an estimate by M b, M = (H + P)^-1 D^T Z. Two sets of images of one camera have the
same b: the difference of their estimates gains (M_1 - M_2) t L (M_1 - M_2)^T
(`statistics.lens_fields`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.document.findings import LensErrorEntry
from loopcal.estimation.cameras.pixels import by_value, pixels, rays
from loopcal.estimation.problem.pose_equations import PoseEquations, pose_equations
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.products import rows_times
from loopcal.estimation.solve.kernel import TurnedImages
from loopcal.estimation.solve.solution import Solution
from loopcal.estimation.solve.sweep import Sweeper
from loopcal.mechanisms.cameras.lens import FRAME, LENSES, Intrinsics
from loopcal.mechanisms.instruments.camera import all_cameras
from loopcal.mechanisms.mechanism import PIXELS

# docs/decisions/0166.
_LENGTHS = (0.15, 0.3, 0.6)
"""In widths of the image."""
_SIZES = 2.0 ** np.arange(-6.0, 3.1, 0.5)
"""Roots of r, in sds of a pixel."""
_NONE = 19.0
"""Odds beforehand that there is no such error."""
# Chosen, not derived: the shortest waves are 0.4 of the image long.
_WAVES = 6
"""Of a side of the image, the constant among them."""
_WEAK = 1e-4
"""Share of the prior's precision in the likelihood: what contradicts it is no such error."""
# Chosen, not derived: of 100 corners 72 waves then take 11 MB.
_AT_ONCE = 128
"""Images of a sweep."""
# Chosen, not derived: five points in the shortest half wave.
_GRID = 25
"""Points of a side of the image at which waves and lens are compared."""


@dataclass(frozen=True, eq=False)
class LensErrors:
    """moved: M (n, w) [SI]; spectrum: (w,) the mean of t L; entries: what each lens leaves; eyes,
    field: (w,) the mean of b, 0 of a camera whose images rather show none."""

    moved: Array
    spectrum: Array
    entries: tuple[LensErrorEntry, ...]
    eyes: tuple[_Eye, ...]
    field: Array

    @property
    def covariance(self) -> Array:
        """(n, n) [SI] what that of the estimate gains."""
        return np.asarray((self.moved * self.spectrum) @ self.moved.T)

    def through(self, S: Array) -> Array:
        """(N, m, m) what that of S (N, m, n) times the estimate gains."""
        return np.asarray(rows_times(S, self.covariance) @ np.swapaxes(S, -1, -2))

    def left(
        self, problem: Problem, at: Solution, equations: tuple[PoseEquations, ...]
    ) -> tuple[PoseEquations, ...]:
        """The equations of a fit as its residuals without the mean field leave them.

        Images that stand alike see the same of the field, so that their residuals are alike.
        """
        if not self.field.any():
            return equations
        shift = np.zeros_like(problem.readings)
        for eye, part in zip(self.eyes, _parts(self.eyes), strict=True):
            u, v = (eye.rows[j::2] for j in (0, 1))
            at_lens = problem.readings + at.corrections
            F = eye.waves(np.nan_to_num(at_lens[u]), np.nan_to_num(at_lens[v]))
            for rows, b in zip((u, v), np.split(self.field[part], 2), strict=True):
                shift[rows] = np.tensordot(b, F, 1)
        made = replace(problem, readings=problem.readings - shift)
        # The loops stay closed. What the parameters would take of the field leaves as well.
        bare = pose_equations(made, at.parameters, at.corrections + shift)
        root = at.spectrum.root
        step = root @ (root.T @ (_gradient(bare) - _gradient(equations)))
        return tuple(replace(block, E=block.E - block.D @ step) for block in bare)


def _gradient(equations: Sequence[PoseEquations]) -> Array:
    """D^T E (n,)."""
    parts = [np.einsum("brn,br->n", one.D, one.E) for one in equations]
    return np.asarray(np.sum(parts, axis=0))


class _Learnt(NamedTuple):
    """spectrum: (w,) the mean of t L; rms [px]: of the mean field, where there is one; gain: of -2
    log; field: (w,) the mean of b, 0 where there is rather none."""

    spectrum: Array
    rms: float
    gain: float
    field: Array


@dataclass(frozen=True, eq=False)
class _Eye:
    """A camera: rows (c,) of u of its corners, those of v follow; size: of its images [px];
    lens: positions of its estimated parameters; best: (w, lens) c; left: (w, w) mean products, over
    image and directions, of the waves less the lens; seen: the same where its corners are. Half of
    the waves are of u."""

    name: str
    rows: NDArray[np.intp]
    size: tuple[float, float]
    lens: NDArray[np.intp]
    best: Array
    left: Array
    seen: Array

    def waves(self, u: Array, v: Array) -> Array:
        """(w / 2, ...) at pixels."""
        return waves(u / self.size[0], v / self.size[1])


def _numbers() -> tuple[Array, Array]:
    """m and n (w / 2,)."""
    m, n = np.meshgrid(np.arange(float(_WAVES)), np.arange(float(_WAVES)))
    return m.ravel(), n.ravel()


def waves(x: Array, y: Array) -> Array:
    """(w / 2, ...) at places over the image, each from 0 to 1."""
    m, n = (np.pi * one.reshape(-1, *(1,) * x.ndim) for one in _numbers())
    return np.asarray(np.cos(m * x) * np.cos(n * y))


def lens_errors(problem: Problem, solution: Solution) -> LensErrors | None:
    """What they mean for the covariance of an estimate; dp = root z, root^T (H + P) root = I.

    None without cameras whose lens is estimated, and without redundancy.
    """
    parameters, root = solution.parameters, solution.spectrum.root
    eyes = _eyes(problem, parameters)
    if not eyes:
        return None
    sums = _Sums.of(problem, solution.parameters, solution.corrections, eyes)
    weak = _WEAK * problem.precision
    away = problem.nominal - parameters[problem.free]
    pull = np.where(weak > 0.0, weak * away, 0.0)
    toward = root.T @ (sums.DE + pull)
    inverse = np.linalg.inv(root.T @ (sums.DD + np.diag(weak)) @ root)
    square = sums.EE + float(pull @ away) - float(toward @ inverse @ toward)
    freedom = sums.count - root.shape[1]
    if freedom <= 0 or not square > 0.0:
        return None
    moved, spectra, entries, means = _moved(sums, solution, eyes), [], [], []
    for eye, part, pixel in zip(eyes, _parts(eyes), sums.pixels, strict=True):
        ZE = sums.ZE[part] - eye.best @ sums.DE[eye.lens]
        cross = eye.best @ sums.DZ[eye.lens, part]
        ZZ = sums.ZZ[part, part] - cross - cross.T
        ZZ += eye.best @ sums.DD[np.ix_(eye.lens, eye.lens)] @ eye.best.T
        A = root.T @ _by_field(sums, eye, part)
        taken = A.T @ inverse
        learnt = _learnt(eye, ZZ - taken @ A, ZE - taken @ toward, (square, freedom, pixel))
        spectra.append(learnt.spectrum)
        means.append(learnt.field)
        of_waves = tuple(learnt.spectrum.tolist()), tuple(map(tuple, moved[:, part].tolist()))
        entries.append(LensErrorEntry(eye.name, learnt.rms, learnt.gain, eye.size, *of_waves))
    return LensErrors(moved, np.concatenate(spectra), tuple(entries), eyes, np.concatenate(means))


def _parts(eyes: Sequence[_Eye]) -> list[slice]:
    """The waves of each camera among those of all."""
    ends = np.cumsum([len(eye.left) for eye in eyes]).tolist()
    return [slice(end - len(eye.left), end) for eye, end in zip(eyes, ends, strict=True)]


def _by_field(sums: _Sums, eye: _Eye, part: slice) -> Array:
    """D^T Z (n, w) of the waves of a camera."""
    return np.asarray(sums.DZ[:, part] - sums.DD[:, eye.lens] @ eye.best.T)


def _moved(sums: _Sums, solution: Solution, eyes: Sequence[_Eye]) -> Array:
    """M (n, w)."""
    root = solution.spectrum.root
    DZ = [_by_field(sums, eye, part) for eye, part in zip(eyes, _parts(eyes), strict=True)]
    return np.asarray(root @ (root.T @ np.hstack(DZ)))


def _learnt(eye: _Eye, C: Array, g: Array, noise: tuple[float, int, float]) -> _Learnt:
    """From what the images show; noise: |E|^2, nu, and the sd of a pixel [px]."""
    square, freedom, pixel = noise
    m, n = _numbers()
    width, height = eye.size
    k2 = np.tile(np.pi**2 * (m**2 + (n * width / height) ** 2), 2)
    criteria, fields, sizes, spectra = [], [], [], []
    for length in _LENGTHS:
        L = (1.0 + 0.25 * length**2 * k2) ** -3
        spectra.append(L / (L @ np.diag(eye.left)))
        half = np.sqrt(spectra[-1])
        values, vectors = np.linalg.eigh(half[:, None] * C * half)
        basis = half[:, None] * vectors
        values, along = np.maximum(values, 0.0), basis.T @ g
        for r in np.square(pixel * _SIZES).tolist():
            share = r / (1.0 + r * values)
            s = max(square - float(share @ np.square(along)), 1e-12 * square) / freedom
            criteria.append(freedom * math.log(s) + float(np.log1p(r * values).sum()))
            fields.append(basis @ (share * along))
            sizes.append(r * s)
    least = min(criteria)
    gain = freedom * math.log(square / freedom) - least
    weights = np.exp(-0.5 * (np.array(criteria) - least))
    mean = weights @ np.array(fields) / weights.sum()
    weights /= weights.sum() + _NONE * len(weights) * math.exp(-0.5 * gain)
    shares = (weights * np.array(sizes)).reshape(len(_LENGTHS), -1).sum(axis=1)
    rms = math.sqrt(max(float(mean @ eye.seen @ mean), 0.0))
    likely = weights.sum() > 0.5
    return _Learnt(np.asarray(shares @ np.array(spectra)), rms, gain, likely * mean)


@dataclass(frozen=True, eq=False)
class _Sums:
    """Over all images, of D (n columns), E, and the waves T F (w columns) of all cameras; pixels:
    the sd of a pixel of each camera [px]."""

    DD: Array
    DE: Array
    EE: float
    DZ: Array
    ZZ: Array
    ZE: Array
    count: int
    pixels: tuple[float, ...]

    @classmethod
    def of(
        cls, problem: Problem, parameters: Array, corrections: Array, eyes: Sequence[_Eye]
    ) -> _Sums:
        n, w = len(problem.free), sum(len(eye.left) for eye in eyes)
        products, count, read = np.zeros((n + 1 + w,) * 2), 0, np.zeros((len(eyes), 2))
        sweeper, uv = Sweeper(problem), np.nan_to_num(problem.readings)
        for pattern, block in sweeper.blocks(parameters, corrections, min(problem.most, _AT_ONCE)):
            if not pattern.predicted:
                continue
            values = sweeper.loop_values(pattern, block)
            turned = TurnedImages.of(values, block, exact=sweeper.alike)
            place = {int(q): i for i, q in enumerate(block.noise.predicted)}
            # Where the lens puts them: waves of noisy pixels, less those of the lens, are noise.
            at_lens = uv[:, block.poses] + block.corrections
            moved, start = np.zeros((w, *turned.slope.shape)), 0
            for i, eye in enumerate(eyes):
                rows = [r for r in eye.rows.reshape(-1, 2).tolist() if r[0] in place]
                if rows:
                    F = eye.waves(*(at_lens[[r[j] for r in rows]] for j in (0, 1)))
                    for j in (0, 1):
                        at = [place[r[j]] for r in rows]
                        first = start + j * len(F)
                        moved[first : first + len(F), at] = -turned.slope[at] * F
                        weight = turned.weight[at] * turned.slope[at]
                        read[i] += np.square(weight).sum(), np.count_nonzero(weight)
                start += len(eye.left)
            columns = np.concatenate([values.by_parameter, turned.misclosure[None], moved])
            flat = turned.left(columns).reshape(len(columns), -1)
            products += flat @ flat.T
            count += int((turned.weight > 0.0).sum()) - turned.unmeasured * turned.slope.shape[1]
        D, Z = slice(0, n), slice(n + 1, None)
        return cls(
            products[D, D],
            products[D, n],
            float(products[n, n]),
            products[D, Z],
            products[Z, Z],
            products[Z, n],
            count,
            tuple(np.sqrt(read[:, 1] / np.maximum(read[:, 0], 1e-300)).tolist()),
        )


def _eyes(problem: Problem, parameters: Array) -> tuple[_Eye, ...]:
    mechanism = problem.mechanism
    names = mechanism.parameters.names
    value = dict(zip(names, parameters.tolist(), strict=True))
    free = {names[i]: j for j, i in enumerate(problem.free)}
    quantities = mechanism.tape.quantities
    rows: dict[str, list[int]] = {}
    lenses: dict[str, Intrinsics] = {}
    families = {f.name: f for f in mechanism.families if f.form == PIXELS}
    for entry in all_cameras(mechanism):
        family = families.get(entry.instrument)
        if family is not None:
            rows.setdefault(entry.name, []).extend(quantities.index(q) for q in family.readings)
            lenses[entry.name] = entry.intrinsics
    eyes = []
    for name, stated in lenses.items():
        keys = [k for k in (*FRAME, *LENSES[stated.lens]) if f"{name}_{k}" in free]
        if not keys:
            continue
        at = {k: value[f"{name}_{k}"] for k in (*FRAME, *LENSES[stated.lens])}
        index = np.array(rows[name])
        lens = Intrinsics.of(stated.lens, at, stated.image)
        u, v = _corners(problem, index)
        width, height = lens.image or (2.0 * lens.cx, 2.0 * lens.cy)
        size = max(u.max(initial=0.0) + 1.0, width), max(v.max(initial=0.0) + 1.0, height)
        edges = [np.linspace(0.0, side, _GRID + 1) for side in size]
        corners = np.histogram2d(v, u, edges[::-1])[0].ravel()
        place = np.array([free[f"{name}_{k}"] for k in keys])
        best, left = _best(lens, keys, size)
        products = (
            left.T @ (weight[:, None] * left) / max(weight.sum(), 1.0)
            for weight in (np.ones(len(left)), np.tile(corners, 2))
        )
        eyes.append(_Eye(name, index, size, place, best, *products))
    return tuple(eyes)


def _corners(problem: Problem, rows: NDArray[np.intp]) -> tuple[Array, Array]:
    """u and v [px] of all that were read."""
    sd = np.broadcast_to(problem.uncertainty.sd, problem.readings.shape)[rows]
    u, v = problem.readings[rows[0::2]], problem.readings[rows[1::2]]
    read = np.isfinite(sd[0::2]) & np.isfinite(u) & np.isfinite(v)
    return u[read], v[read]


def _best(lens: Intrinsics, keys: Sequence[str], size: tuple[float, float]) -> tuple[Array, Array]:
    """c and what it leaves of the waves, over a grid of the whole image, of u and then of v."""
    x, y = np.meshgrid(*((np.arange(_GRID) + 0.5) / _GRID,) * 2)
    uv = np.column_stack([x.ravel(), y.ravel()]) * size
    P = np.column_stack([rays(lens, uv), np.ones(len(uv))])
    tangents = by_value(lens.lens, P, lens.values, keys).transpose(1, 0, 2).reshape(-1, len(keys))
    F = np.kron(np.eye(2), waves(x.ravel(), y.ravel()).T)
    # Where the lens turns back before the corner of the image there is no ray.
    shown = np.abs(pixels(lens.lens, P, lens.values) - uv).max(axis=1) < 1.0
    tangents, F = (one * np.tile(shown, 2)[:, None] for one in (tangents, F))
    scale = np.maximum(np.sqrt(np.square(tangents).sum(axis=0)), 1e-300)
    c = np.linalg.lstsq(tangents / scale, F, rcond=1e-9)[0] / scale[:, None]
    return c.T, F - tangents @ c
