"""What poses of another day say of a calibration: is the difference more than both explain?

At a machine that is held, with its instruments placed anew, the whitened misclosures are

    e = F d + A h + v,   h ~ N(0, 1),   v ~ N(0, 1),

F the columns of what was placed anew (flat), A A^T the covariance of the machine's parameters
where these poses see it. The square of what no d explains, in the metric of its covariance,

    chi^2 = min over d, h of |e - F d - A h|^2 + |h|^2,   degrees of freedom: R - rank F,

is the innovation of the machine (Bar-Shalom, Li and Kirubarajan, Estimation with Applications to
Tracking and Navigation, 2001, section 5.4). Where sds were learnt it follows F instead. The noise
has 2 / sum_a (sum_j w_j d_ja)^2 degrees of freedom (Satterthwaite 1946), w_j the share of a learnt
component in the variance and d_ja its relative change along the independent error a; where these
are not known 1 / sum_j (w_j^2 / nu_j), nu_j = 2 s_j^4 / var(s_j^2). The machine's covariance has
slopes D_a for the errors of learnt scales; along the axis i of A in the metric of S its variance
has

    1 / nu_i = 1 / nu_noise + sum_a (D_a)_ii^2 / 2,

and F has the denominator of Fai and Cornelius (`loopcal.small_samples`).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array, svd
from loopcal.document.fit import NoiseEntry
from loopcal.lazy import cached_property
from loopcal.mechanisms.structure.smooth import FurtherWaves, wave_errors
from loopcal.small_samples import f_tail
from loopcal.statistics.calibrated import Calibrated
from loopcal.statistics.replacing import DETERMINED, Replaced

# Chosen, not derived: far above rounding, far below a step that counts.
_UNSEEN = 1e-9
"""An undetermined step that moves the loops by less of what its parts move does not count."""
_TAKEN_UP = 1e-6
"""A share of a pose's variance that is rounding: the placement takes up all of it."""
# The mean is nu / (nu - 2), here 11 at most: chosen, not derived.
_FEWEST = 2.2
"""Degrees of freedom, at least: below 2 the mean of F has no bound."""


@dataclass(frozen=True)
class Innovation:
    """The square of the innovation [sds] with its degrees of freedom.

    learnt_freedom: degrees of freedom of the learnt variances, None where all are stated; p_value:
    of a value at least this large if the machine is unchanged, None without degrees of freedom.
    """

    value: float
    degrees_of_freedom: int
    learnt_freedom: float | None
    p_value: float | None

    @classmethod
    def of(cls, value: float, freedom: int, learnt: float | None) -> Innovation:
        """With its p-value."""
        if freedom <= 0:
            return cls(value, max(freedom, 0), learnt, None)
        denominator = math.inf if learnt is None else learnt
        return cls(value, freedom, learnt, f_tail(value, freedom, denominator))


@dataclass(frozen=True, eq=False)
class PoseSquares:
    """Of each pose (N,): its square, chi-squared with `loops` (N,) degrees of freedom."""

    squares: Array
    loops: NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Linearised:
    """The equations of a held machine that was placed anew, and how the placement answers to them.

    e (R,), F (R, g + d), A (R, r); root: (n_all, r) with root root^T the covariance of the
    parameters that are held; solve: (g + d, R) the least squares of F; rank: of F; factor: by
    how much the residuals of the calibration are larger than its stated variances; slopes:
    (a, r, r) changes of the covariance of h per sd of each error of learnt scales; noise: degrees
    of freedom of learnt sds, inf where all are stated; further_waves: whose amplitudes are the
    first of h.
    """

    placement: Replaced
    e: Array
    F: Array
    A: Array
    root: Array
    solve: Array
    rank: int
    factor: float
    slopes: Array
    noise: float
    further_waves: tuple[FurtherWaves, ...] = ()

    @classmethod
    def of(
        cls,
        placement: Replaced,
        calibrated: Calibrated,
        moved: Array | None = None,
        drift: Array | None = None,
    ) -> Linearised:
        """Undetermined steps of the calibration are as free as the placement; moved: (R, q) the
        columns of further changes that are; drift: (R, p) those of changes by one sd, which are
        held as the machine is."""
        J, f = placement.J / np.sqrt(calibrated.factor), calibrated.factor
        held = ~placement.anew[:, None]
        waves = _WavesLeft.at(placement, calibrated)
        spread = root_of(f * (calibrated.covariance.matrix - waves.moved @ waves.moved.T))
        root = spread * held
        loose = calibrated.undetermined * held
        seen = np.linalg.norm(J @ loose, axis=0)
        single = np.linalg.norm(J, axis=0) @ np.abs(loose)
        loose = loose[:, seen > _UNSEEN * np.maximum(single, 1e-300)]
        F = np.hstack([J @ placement.directions, J @ loose])
        if moved is not None:
            F = np.hstack([F, moved / np.sqrt(f)])
        # Columns of length 1: the cut on s is then free of their units.
        scale = np.linalg.norm(F, axis=0)
        scale = np.where(scale > 0.0, scale, 1.0)
        U, s, Vt = svd(F / scale)
        kept = s > DETERMINED * s.max(initial=0.0)
        solve = (Vt[kept].T / s[kept]) @ U[:, kept].T / scale[:, None]
        A, rank, noise = J @ root, int(kept.sum()), _noise_freedom(calibrated, placement)
        slopes = _slopes(calibrated, spread, ~placement.anew)
        e = placement.e / np.sqrt(f)
        drift = np.zeros((len(e), 0)) if drift is None else drift / np.sqrt(f)
        w, p = waves.left.shape[1], drift.shape[1]
        A, root = np.hstack([waves.left, A, drift]), np.pad(root, ((0, 0), (w, p)))
        root[:, :w] = -waves.moved * held
        slopes = np.pad(slopes, ((0, 0), (w, p), (w, p)))
        return cls(placement, e, F, A, root, solve, rank, f, slopes, noise, waves.held)

    def unsurer(self, freedom: float) -> Linearised:
        """The same where the noise has also this many degrees of freedom, of another cause."""
        inverse = 1.0 / self.noise + 1.0 / freedom
        return self if not inverse else replace(self, noise=1.0 / inverse)

    def spanned(self, names: Sequence[str], columns: Array) -> Array:
        """(R, d) independent columns of these, and of what the names change (`Replaced.columns`);
        the columns as they are where there are none."""
        if not names:
            return columns
        each = self.placement.columns(names) / np.sqrt(self.factor)
        U, s, _ = svd(np.hstack([columns, each]))
        return np.asarray(U[:, s > DETERMINED * s.max(initial=0.0)])

    @cached_property
    def left(self) -> Array:
        """(R,) what the placement leaves of e."""
        return np.asarray(self.e - self.F @ (self.solve @ self.e))

    @cached_property
    def _spread(self) -> Array:
        """(R, r) what the placement leaves of A."""
        return np.asarray(self.A - self.F @ (self.solve @ self.A))

    @cached_property
    def _axes(self) -> tuple[Array, Array, Array]:
        """U (R, k), s (k,), V^T (k, r) of A = U s V^T: the axes of S = 1 + A A^T."""
        return svd(self._spread)

    def _halved(self, a: Array) -> Array:
        """S^-1/2 a, so that squares of large columns that A explains stay positive."""
        # S^-1/2 = 1 - U (1 - (1 + s^2)^-1/2) U^T.
        U, s, _ = self._axes
        return np.asarray(a - (U * (1.0 - 1.0 / np.hypot(1.0, s))) @ (U.T @ a))

    def _along(self, a: Array) -> Array:
        """A^T S^-1 a."""
        # A^T S^-1 = V s / (1 + s^2) U^T.
        U, s, Vt = self._axes
        return np.asarray((Vt.T * (s / (1.0 + np.square(s)))) @ (U.T @ a))

    def weighed(self, a: Array, b: Array) -> Array:
        """a^T S^-1 b, S = 1 + A A^T, of what the placement leaves: (R, p), (R, q) -> (p, q)."""
        return np.asarray(self._halved(a).T @ self._halved(b))

    def by_pose(self) -> PoseSquares:
        """The squares of what the placement leaves of single poses, in their own covariance."""
        count = len(self.placement.problem.poses)
        squares, loops, begin = np.full(count, np.nan), np.zeros(count, dtype=np.intp), 0
        for rows in self.placement.rows:
            b, r = rows.e.shape
            span = slice(begin, begin + b * r)
            e = self.left[span].reshape(b, r, 1)
            A = self._spread[span].reshape(b, r, self.A.shape[1])
            F = self.F[span].reshape(b, r, self.F.shape[1])
            solve = self.solve[:, span].reshape(len(self.solve), b, r).transpose(1, 0, 2)
            # What F takes up of white noise leaves a projector, which is its own covariance.
            S = np.eye(r) - F @ solve + A @ A.transpose(0, 2, 1)
            values, vectors = np.linalg.eigh(0.5 * (S + S.transpose(0, 2, 1)))
            kept = values > _TAKEN_UP
            z = (vectors.transpose(0, 2, 1) @ e)[:, :, 0]
            terms = np.where(kept, np.square(z) / np.where(kept, values, 1.0), 0.0)
            squares[rows.poses] = terms.sum(axis=1)
            loops[rows.poses] = kept.sum(axis=1)
            begin += b * r
        return PoseSquares(squares, loops)

    def innovation(self, without: float = 0.0, fewer: int = 0) -> Innovation:
        """The statistic; without: what changes explain of it, so many fewer degrees of freedom."""
        value = float(self.weighed(self.left[:, None], self.left[:, None])[0, 0]) - without
        count = len(self.e) - self.rank - fewer
        return Innovation.of(max(value, 0.0), count, self._denominator(count))

    def freedom(self, U: Array) -> Array:
        """(m,) degrees of freedom of the variance of a change along each column U (R, m)."""
        U = U - self.F @ (self.solve @ U)
        along, size = self._along(U), np.square(self._halved(U)).sum(axis=0)
        changes = (along * (self.slopes @ along)).sum(axis=1)
        changes = changes / np.where(size > 0.0, size, 1.0)
        return _freedoms(np.square(changes).sum(axis=0), self.noise)

    def denominator(self, U: Array) -> float | None:
        """Of F of changes along columns U (R, m) together, where U^T S^-1 U = 1; None for
        chi-squared."""
        along = self._along(U)
        Z = along.T @ self.slopes @ along
        _, axes = np.linalg.eigh((Z @ Z).sum(axis=0))
        return self._by_axes(along @ axes, U.shape[1])

    def _denominator(self, count: int) -> float | None:
        """Of F with so many degrees of freedom; None for chi-squared."""
        _, s, Vt = self._axes
        return self._by_axes(Vt.T * (s / np.sqrt(1.0 + np.square(s))), count)

    def _by_axes(self, V: Array, count: int) -> float | None:
        """Of F, V (r, m) the axes A^T S^-1/2; further ones have the noise alone."""
        if count <= 0 or (not len(self.slopes) and np.isinf(self.noise)):
            return None
        changes = (V * (self.slopes @ V)).sum(axis=1)
        nu = _freedoms(np.square(changes).sum(axis=0), self.noise)[:count]
        # nu / (nu - 2), written so that it is 1 for infinite nu.
        means = 1.0 / (1.0 - 2.0 / np.maximum(nu, _FEWEST))
        rest = 1.0 / (1.0 - 2.0 / max(self.noise, _FEWEST))
        mean = float(means.sum()) + (count - len(nu)) * rest
        excess = mean - count
        return 2.0 * mean / excess if excess > 1e-9 * count else None


class _WavesLeft(NamedTuple):
    """Errors that a discrepancy has no waves for. left: (R, w) columns by which they move the
    equations beside what the fit made of them; moved: (n_all, w) that; held: the waves, moving
    what is held alone."""

    left: Array
    moved: Array
    held: tuple[FurtherWaves, ...]

    @classmethod
    def at(cls, placement: Replaced, calibrated: Calibrated) -> _WavesLeft:
        problem, n = placement.problem, len(calibrated.nominal)
        waves = calibrated.further_waves
        if not waves:
            return cls(np.zeros((len(placement.e), 0)), np.zeros((n, 0)), ())
        names, every = problem.mechanism.tape.quantities, problem.mechanism.parameters.names
        x = problem.readings + placement.corrections
        stays = np.diag((~placement.anew).astype(float))
        held = tuple(one.through(stays) for one in waves)
        left = []
        for rows in placement.rows:
            readings = dict(zip(names, x[:, rows.poses], strict=True))
            errors = wave_errors(held, rows.J, rows.J, readings, every)
            left.append(errors.left.reshape(rows.e.size, errors.left.shape[2]))
        return cls(np.concatenate(left), np.hstack([one.moved for one in waves]), held)


def _freedoms(changes: Array, noise: float) -> Array:
    # Independent relative variances add: half the square of slopes, and 1 / nu of the noise.
    inverse = 0.5 * changes + 1.0 / noise
    return np.where(inverse > 0.0, 1.0 / np.where(inverse > 0.0, inverse, 1.0), np.inf)


def _slopes(calibrated: Calibrated, root: Array, held: NDArray[np.bool_]) -> Array:
    """(a, r, r) in the basis of a root; none for a method that learns one variance for all."""
    slopes, r = calibrated.covariance.slopes, root.shape[1]
    if calibrated.residual is not None or not len(slopes):
        return np.zeros((0, r, r))
    inverse = np.linalg.pinv(root)
    return np.asarray(inverse @ (calibrated.factor * slopes * np.outer(held, held)) @ inverse.T)


def root_of(covariance: Array) -> Array:
    """(n, r) a square root of a covariance, scaled first, without what is zero."""
    sd = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    scale = np.where(sd > 0.0, sd, 1.0)
    values, vectors = np.linalg.eigh(covariance / scale / scale[:, None])
    kept = values > 1e-14 * max(float(values.max(initial=0.0)), 1e-300)
    root: Array = scale[:, None] * vectors[:, kept] * np.sqrt(values[kept])
    return root


def components_of(calibrated: Calibrated, quantities: Sequence[str]) -> list[list[int]]:
    """Positions of the quantities of each learnt sd above zero."""
    return [
        [quantities.index(q) for q in entry.quantities if q in quantities]
        for entry in _learnt(calibrated)
    ]


def _learnt(calibrated: Calibrated) -> list[NoiseEntry]:
    return [entry for entry in calibrated.noise if entry.source == "estimated" and entry.sd > 0.0]


def _noise_freedom(calibrated: Calibrated, placement: Replaced) -> float:
    """Degrees of freedom of the sds that weigh these poses; inf where all are stated.

    Components that no reading tells apart, such as an instrument and a white error of the model,
    are unsure alone and sure together. The errors of all are added along their common axes.
    """
    if calibrated.rejected is not None and calibrated.factor > 1.0:
        return float(calibrated.rejected.degrees_of_freedom)
    if calibrated.residual is not None:
        return float(calibrated.residual.freedom)
    entries = _learnt(calibrated)
    if not entries:
        return np.inf
    shares = np.zeros(len(entries))
    for rows in placement.rows:
        squares = np.square(rows.noise).sum(axis=(0, 1))
        np.add.at(shares, rows.owner, squares)
    shares /= max(len(placement.e), 1)
    if all(entry.slopes for entry in entries):
        changes = shares @ np.array([entry.slopes for entry in entries])
        total = 0.5 * float(changes @ changes)
    else:
        inverse = [_inverse_freedom(entry.sd, entry.sd_of_sd) for entry in entries]
        total = float(np.square(shares) @ np.array(inverse))
    return 1.0 / total if total > 0.0 else np.inf


def noise_freedoms(calibrated: Calibrated, joints: Collection[str]) -> tuple[float, float]:
    """Degrees of freedom of the least sure variance of these quantities, and of that of the
    others; inf where all are stated."""
    inverse = [0.0, 0.0]
    for entry in _learnt(calibrated):
        which = 0 if set(joints) & set(entry.quantities) else 1
        inverse[which] = max(inverse[which], _inverse_freedom(entry.sd, entry.sd_of_sd))
    of_joints, of_others = (1.0 / one if one > 0.0 else math.inf for one in inverse)
    return of_joints, of_others


def _inverse_freedom(sd: float, sd_of_sd: float | None) -> float:
    """1 / nu, nu = 2 s^4 / var(s^2), with var(s^2) = 4 s^2 var(s); 0 where it is not known."""
    return 2.0 * ((sd_of_sd or 0.0) / sd) ** 2
