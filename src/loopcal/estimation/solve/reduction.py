"""The parameter system: what all blocks add up to, and its solution by singular values.

Blocks contribute either normal equations, summed, or the triangle of a QR decomposition,
stacked and reduced again (TSQR; Demmel et al. 2012), which keeps twice the digits where the
scaled condition number is large. Both end as the same spectrum.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array, svd
from loopcal.lazy import cached_property
from loopcal.presentation.shown import brief

# Eigenvalues of a matrix with unit diagonal are right to some n eps, singular values
# thus to its root: 1.5e-7 for n = 100.
RANK_TOLERANCE, SUMMED_TOLERANCE = 1e-10, 1e-6
"""Directions with a singular value this much below the largest are not determined; from normal
equations, whose rounding hides singular values up to the root of n eps, it shows only so far."""
# docs/decisions/0012.
ROUNDING = 2e-15
"""A column this short beside others in its unit is what cancelled terms leave: no effect at all."""
SQUARED = 1e-150
"""The square of a smaller singular value is no number any more."""
# Chosen, not derived: sds a million times those of the best direction.
WEAK = 1e-6
"""Directions with a singular value this far below the largest are determined, but hardly."""
# Chosen, not derived: real parameters keep most of their effect from start to end.
_VANISHED, _LOOSE = 1e-4, 1e-2
"""A parameter whose effect on the loops shrinks to this share of what it was has run away, unless
data and prior still determine it."""
WAITING = 4
"""Rows wait until they are so many times the parameters: a decomposition costs by what it is
stacked on, too, and of many small ones most would be that."""
DAMPED, _ROUNDS = 1e-9, 8
"""Squares of singular values of unit columns are right to some n eps: far below this."""
LARGE = 100
"""From so many parameters on SciPy's linear algebra makes up for loading it."""
# Normal equations square it: 1e8 leaves about eight of the sixteen digits of a double
# (docs/decisions/0002).
WELL_CONDITIONED = 1e4
"""Up to this scaled condition number normal equations lose nothing that iterating cannot mend."""
# Squared 1e-12: far above rounding, 1e-16 times the rows and columns.
TWICE = 1e6
"""Up to this condition a triangle from products is right once it is computed twice."""
overflowing = np.errstate(over="ignore", invalid="ignore", divide="ignore")
"""Of what is evaluated at trial points: where these are far off no number is left, and who
evaluates sets the pose aside or declines the step."""


class Accumulator:
    """Adds up the whitened equations of blocks: |E - D dp|^2 over all poses.

    triangular: keep a QR triangle instead of normal equations; units: of the parameters, where
    they are known.
    """

    def __init__(self, parameters: int, triangular: bool, units: Sequence[str] = ()) -> None:
        self.triangular, self.units = triangular, tuple(units)
        size = parameters + 1
        self._total = np.zeros((size, size))
        self._rows: list[Array] = []
        self._reduced = False

    def add(self, rows: Array) -> None:
        """Add a block's equations, (n + 1, r, b): the columns of D, last E."""
        rows = rows.reshape(len(rows), -1)
        if not self.triangular:
            self._total += rows @ rows.T
            return
        self._rows.append(rows.T.copy())
        if sum(len(block) for block in self._rows) >= WAITING * len(self._total):
            self._reduce()

    def add_total(self, total: Array) -> None:
        """Add a block's equations, their products already summed over loops and poses."""
        self._total += total

    def add_other(self, other: Accumulator) -> None:
        """Add what another accumulator of the same kind has gathered."""
        if self.triangular:
            self._rows.append(other.total)
            self._reduce()
        else:
            self._total += other.total

    def divide(self, factor: float) -> None:
        """Divide the variances of all equations by a factor, if these are summed."""
        assert not self.triangular
        self._total /= factor

    def _reduce(self) -> None:
        self._total, self._rows, self._reduced = triangle(*self.blocks), [], True

    @property
    def total(self) -> Array:
        """Of all equations the normal ones, or the triangle of D with E, (n + 1, n + 1)."""
        if self._rows:
            self._reduce()
        return self._total

    @property
    def blocks(self) -> list[Array]:
        """Rows of n + 1 columns whose products add up to those of all equations."""
        return [self._total, *self._rows] if self._reduced or not self._rows else self._rows

    @property
    def products(self) -> Array:
        """[D E]^T [D E] over all poses, (n + 1, n + 1)."""
        return self.total.T @ self.total if self.triangular else self.total

    @property
    def squares(self) -> Array:
        """Squares of the columns of D and of E, summed over all equations, (n + 1,)."""
        if not self.triangular:
            return np.diag(self._total)
        return np.asarray(sum(np.square(block).sum(axis=0) for block in self.blocks))

    @property
    def lengths(self) -> Array:
        """Lengths of the columns of D, (n,): the effect of each parameter in sds per unit [SI]."""
        return np.asarray(np.sqrt(self.squares[:-1]))

    @property
    def chi_squared(self) -> float:
        """|E|^2 over all poses."""
        if not self.triangular:
            return float(self._total[-1, -1])
        return float(sum(block[:, -1] @ block[:, -1] for block in self.blocks))

    @property
    def finite(self) -> bool:
        """Whether no equation has a number missing."""
        sums = self.squares if self.triangular else self._total
        # what is too large for its square is a number all the same
        return math.isfinite(sums.sum()) or all(np.isfinite(b).all() for b in self.blocks)


@dataclass(frozen=True)
class Directions:
    """What a parameter system's singular value decomposition finds; the fields of `Spectrum`."""

    vectors: Array
    singular_values: Array
    components: Array
    kept: NDArray[np.bool_]


@dataclass(frozen=True)
class Summed:
    """Scaled normal equations: matrix (n, n) with ones on its diagonal, gradient (n,)."""

    matrix: Array
    gradient: Array

    @property
    def normal(self) -> Array:
        """The matrix of the normal equations, (n, n)."""
        return self.matrix

    def times(self, z: Array) -> Array:
        """The matrix of the normal equations times scaled steps, (n,) or (n, h)."""
        return self.matrix @ z

    def directions(self) -> Directions:
        """By an eigendecomposition."""
        values, vectors = np.linalg.eigh(self.matrix)
        # They are squares of singular values, but rounding may leave the smallest below zero.
        s = np.sqrt(np.maximum(values, 0.0))
        kept = _kept(s, SUMMED_TOLERANCE)
        components = np.divide(vectors.T @ self.gradient, s, out=np.zeros(len(s)), where=kept)
        return Directions(vectors, s, components, kept)

    def removed(self, solution: Array) -> float:
        """How much of chi-squared the full step is predicted to remove."""
        return float(solution @ self.gradient)

    def solution(self) -> Array | None:
        """The full step (n,), if the matrix is well conditioned; costs a fifth of `directions`.

        The condition number is at most |matrix| |inverse| in Frobenius' norm.
        """
        step, condition = self._solved
        return step if condition <= WELL_CONDITIONED**2 else None

    @property
    def ill_conditioned(self) -> bool:
        """Whether the inverse shows that the matrix is: in Frobenius' norm |matrix| |inverse| is at
        most n times the condition number."""
        condition = self._solved[1]
        return len(self.matrix) * WELL_CONDITIONED**2 < condition < math.inf

    @cached_property
    @overflowing
    def _solved(self) -> tuple[Array | None, float]:
        """The full step (n,), and |matrix| |inverse|, infinite where there is no inverse."""
        if len(self.matrix) >= LARGE:
            return self._by_cholesky()
        try:
            inverse = np.linalg.inv(self.matrix)
        except np.linalg.LinAlgError:
            return None, math.inf
        back = inverse.ravel()
        return np.asarray(inverse @ self.gradient), self._condition(float(back @ back))

    def _by_cholesky(self) -> tuple[Array | None, float]:
        """Of a large matrix in half the time, from one half of it and of its inverse."""
        from scipy.linalg.lapack import dpotrf, dpotri, dpotrs

        factor, failed = dpotrf(self.matrix.T, lower=1)  # the other half is zero
        if failed:
            return None, math.inf
        solution = np.asarray(dpotrs(factor, self.gradient, lower=1)[0], dtype=np.float64)
        half = dpotri(factor, lower=1, overwrite_c=1)[0]
        back, diagonal = half.T.ravel(), np.diag(half)
        # An entry beside the diagonal is in one half only, so its square counts twice.
        return solution, self._condition(float(2.0 * (back @ back) - diagonal @ diagonal))

    def _condition(self, inverse: float) -> float:
        """|matrix| |inverse|; inverse: squares of its inverse, summed."""
        flat = self.matrix.ravel()
        return math.sqrt((flat @ flat) * inverse)


def inverse_of_upper(R: Array) -> Array:
    """R^-1 of an upper triangle (n, n), whose elimination needs no exchange of rows."""
    if len(R) < LARGE:
        return np.asarray(np.linalg.inv(R))
    from scipy.linalg.lapack import dtrtri

    return np.asarray(dtrtri(R)[0])


@dataclass(frozen=True)
class Stacked:
    """A scaled triangle: matrix (n, n) and its right-hand side (n,)."""

    matrix: Array
    right: Array

    @property
    def gradient(self) -> Array:
        """The right-hand side of the normal equations, (n,)."""
        return np.asarray(self.matrix.T @ self.right)

    @cached_property
    def normal(self) -> Array:
        """The matrix of the normal equations, (n, n)."""
        return np.asarray(self.matrix.T @ self.matrix)

    def times(self, z: Array) -> Array:
        """The matrix of the normal equations times scaled steps, (n,) or (n, h)."""
        return self.matrix.T @ (self.matrix @ z)

    def directions(self) -> Directions:
        """By a singular value decomposition, which has twice the digits."""
        U, s, Vt = svd(self.matrix)
        kept = _kept(s, RANK_TOLERANCE)
        return Directions(Vt.T, s, np.where(kept, U.T @ self.right, 0.0), kept)

    def removed(self, solution: Array) -> float:
        """How much of chi-squared the full step is predicted to remove: it leaves nothing."""
        return float(self.right @ self.right)

    @overflowing
    def solution(self) -> Array | None:
        """The full step (n,), if all directions are determined; costs a tenth of `directions`."""
        if not np.diag(self.matrix).all():
            return None
        inverse = inverse_of_upper(self.matrix)
        flat, back = self.matrix.ravel(), inverse.ravel()
        # As in `Summed.solution`: the condition is no larger.
        determined = bool((flat @ flat) * (back @ back) < RANK_TOLERANCE**-2)
        return np.asarray(inverse @ self.right) if determined else None


@dataclass(frozen=True)
class Spectrum:
    """The parameter system of data and prior, and its own directions.

    The step dp = scale * (directions @ z) turns it into independent equations
    singular_values * z = components; scale: (n,) [SI], singular_values, components: (n,).
    kept: which directions data and prior determine; components of the others are 0.

    The directions are computed when first used. The full step of normal equations that are well
    conditioned needs none, nor does that of a triangle whose directions are all determined.
    """

    __repr__ = brief

    scale: Array
    equations: Summed | Stacked

    @cached_property
    def _directions(self) -> Directions:
        return self.equations.directions()

    @cached_property
    def _solution(self) -> Array | None:
        return self.equations.solution()

    @property
    def directions(self) -> Array:
        """Directions of scaled parameters, the columns of (n, n)."""
        return self._directions.vectors

    @property
    def singular_values(self) -> Array:
        """Of the column-scaled system, (n,)."""
        return self._directions.singular_values

    @property
    def components(self) -> Array:
        """The right-hand side along the directions, (n,)."""
        return self._directions.components

    @property
    def kept(self) -> NDArray[np.bool_]:
        """Which directions data and prior determine, (n,)."""
        return self._directions.kept

    @property
    def rank(self) -> int:
        """Number of directions that are determined."""
        return len(self.scale) if self._solution is not None else int(self.kept.sum())

    @property
    def condition(self) -> float:
        """Largest over smallest singular value of the column-scaled system, inf if singular."""
        smallest = float(self.singular_values.min())
        return float(self.singular_values.max()) / smallest if smallest > 0.0 else np.inf

    @property
    def well_conditioned(self) -> bool:
        """Whether normal equations lose nothing that iterating cannot recover."""
        if isinstance(self.equations, Summed):
            if self._solution is not None:
                return True
            if self.equations.ill_conditioned:
                return False
        return self.condition <= WELL_CONDITIONED

    @cached_property
    def decrement(self) -> float:
        """How much of chi-squared the full step is predicted to remove."""
        if self._solution is not None:
            return self.equations.removed(self._solution)
        return float(self.components @ self.components)

    def step(self, damping: float = 0.0, after: Array | None = None) -> Array:
        """The step dp [SI] damped as Levenberg and Marquardt do; undetermined directions rest.

        after: the steps (n,) [SI] that led here; their sum with this one is what is damped.
        """
        if not damping and self._solution is not None:
            return self.scale * self._solution
        if self._summed_up(damping):
            led = np.zeros(len(self.scale)) if after is None else after / self.scale
            return np.asarray(
                self.scale * self._damped(damping, self.equations.gradient - damping * led)
            )
        s = self.singular_values
        right = s * self.components
        if after is not None:
            # From |s z - c|^2 + damping |after + z|^2: (s^2 + damping) z = s c - damping after.
            right = right - damping * (self.directions.T @ (after / self.scale))
        z = np.zeros(len(s))
        np.divide(right, s * s + damping, out=z, where=self.kept)
        return self.scale * (self.directions @ z)

    def predicted(self, damping: float = 0.0) -> float:
        """How much of chi-squared that step is predicted to remove."""
        if not damping:
            return self.decrement
        if self._summed_up(damping):
            # |E - D dp|^2 falls by z . g + damping |z|^2, because (N + damping) z = g.
            z = self._damped(damping, self.equations.gradient)
            return float(z @ self.equations.gradient + damping * (z @ z))
        s2 = np.square(self.singular_values)
        # c^2 - (c - s z)^2 with z = s c / (s^2 + damping), along each direction.
        share = 1.0 - np.square(damping / np.maximum(s2 + damping, 1e-300))
        return float(share @ np.square(self.components))

    @cached_property
    def weakest(self) -> float:
        """The square of the least singular value of a determined direction, 1 at most."""
        if not self._summed_up(np.inf):
            return float(np.square(self.singular_values[self.kept].min(initial=1.0)))
        # By inverse iteration; what damping asks of it is its size.
        z, length = np.ones(len(self.scale)), 1.0
        for _ in range(_ROUNDS):
            z = self._damped(0.0, z / np.linalg.norm(z))
            length = float(np.linalg.norm(z))
        return min(1.0 / length, 1.0)

    def _summed_up(self, damping: float) -> bool:
        """Whether normal equations serve for a damped step: in a tenth of the time that singular
        values take, where the damping is above what rounding leaves of their squares."""
        wide = len(self.scale) >= LARGE and damping >= DAMPED
        return wide and self._solution is not None and self._factor(0.0) is not None

    def _damped(self, damping: float, right: Array) -> Array:
        """(N + damping)^-1 right, N the matrix of the normal equations."""
        from scipy.linalg.lapack import dpotrs

        factor = self._factor(damping)
        assert factor is not None
        return np.asarray(dpotrs(factor, right, lower=1)[0], dtype=np.float64)

    def _factor(self, damping: float) -> Array | None:
        """The Cholesky factor of N + damping; None where rounding leaves none."""
        if damping not in self._factors:
            from scipy.linalg.lapack import dpotrf

            shifted = self.equations.normal + damping * np.eye(len(self.scale))
            factor, failed = dpotrf(shifted, lower=1, overwrite_a=1)
            self._factors[damping] = None if failed else factor
        return self._factors[damping]

    @cached_property
    def _factors(self) -> dict[float, Array | None]:
        return {}

    @cached_property
    def root(self) -> Array:
        """(n, rank) [SI]: dp = root z over the determined directions, D^T D + prior = I in z."""
        kept = self.kept
        along: Array = self.scale[:, None] * self.directions[:, kept]
        return along / self.singular_values[kept]

    @overflowing
    def covariance(self) -> Array:
        """(sum D^T D + prior)^-1 over the determined directions, (n, n) [SI]; symmetric."""
        return self.root @ self.root.T


def spectrum(data: Accumulator, offset: Array, prior_sd: Array) -> Spectrum:
    """The spectrum of data and prior: offset = nominal - current value, prior_sd may be inf."""
    n, precision = len(prior_sd), 1.0 / prior_sd
    stated = bool(precision.any())
    prior_misfit = np.where(precision, offset, 0.0) * precision if stated else precision
    if data.triangular:
        R = triangle(*data.blocks, np.column_stack([np.diag(precision), prior_misfit]))
        scale = _scale(np.sqrt(np.square(R[:, :n]).sum(axis=0)), data.units)
        return Spectrum(scale, Stacked(R[:n, :n] * scale, R[:n, n]))
    H, g = data.total[:n, :n], data.total[:n, n]
    if stated:
        H, g = H.copy(), g + prior_misfit * precision
        H.reshape(-1)[:: n + 1] += np.square(precision)  # a view of its diagonal
    scale = _scale(np.sqrt(H.diagonal()), data.units)
    return Spectrum(scale, Summed(H * scale * scale[:, None], scale * g))


def _kept(s: Array, tolerance: float) -> NDArray[np.bool_]:
    return s > max(tolerance * float(s.max(initial=0.0)), SQUARED)


def triangle(*blocks: Array) -> Array:
    """R of the QR decomposition of stacked blocks of rows, square."""
    rows = np.vstack(blocks)
    large = rows.shape[1] >= LARGE and len(rows) >= WAITING * rows.shape[1]
    R = _by_products(rows) if large else None
    if R is None:
        R = np.asarray(np.linalg.qr(rows, mode="r"), dtype=np.float64)
    missing = R.shape[1] - len(R)
    return np.vstack([R, np.zeros((missing, R.shape[1]))]) if missing else R


def _by_products(rows: Array) -> Array | None:
    """The triangle of rows by Cholesky twice; None where the first one is not safe.

    Rows solved by a first R are orthonormal but for what squaring lost, which the R of these mends:
    as exact as reflections at two thirds of their cost (CholeskyQR2; Yamamoto et al. 2015).
    """
    from scipy.linalg.blas import dtrsm

    scale = np.sqrt(np.square(rows).sum(axis=0))
    with suppress(np.linalg.LinAlgError):
        rows = rows / np.maximum(scale, SQUARED)
        first = np.asarray(np.linalg.cholesky(rows.T @ rows).T, dtype=np.float64)
        # In Frobenius' norm the product is no less than the condition number.
        if np.linalg.norm(first) * np.linalg.norm(inverse_of_upper(first)) <= TWICE:
            turned = dtrsm(1.0, first, rows.T, trans_a=1, overwrite_b=1)
            second = np.linalg.cholesky(turned @ turned.T).T
            return np.asarray(second @ (first * scale), dtype=np.float64)
    return None


def _scale(lengths: Array, units: tuple[str, ...]) -> Array:
    """What makes columns of these lengths alike.

    Of a parameter without effect rounding leaves a column where terms should cancel. It is known
    by the columns of other parameters in the same unit, and stays as short beside them.
    """
    # Columns of unit length: within a factor root n of the least condition that any scaling of
    # columns reaches (van der Sluis 1969).
    if lengths.min(initial=np.inf) > ROUNDING * lengths.max(initial=0.0):
        return np.asarray(1.0 / lengths)
    most = np.where(_alike(units, len(lengths)), lengths, 0.0).max(axis=1)
    return 1.0 / np.where(lengths > ROUNDING * most, lengths, np.where(most > 0.0, most, 1.0))


@lru_cache(maxsize=64)
def _alike(units: tuple[str, ...], n: int) -> NDArray[np.bool_]:
    """Which of n columns are lengths in the same unit, (n, n); a plain number may be anything."""
    if not units:
        return np.eye(n, dtype=bool)
    names = np.array(units)
    alike: NDArray[np.bool_] = (names[:, None] == names) & (names != "1")
    return alike | np.eye(n, dtype=bool)


def undetermined(
    spectrum: Spectrum, names: Sequence[str], shown: float = 0.05
) -> tuple[dict[str, float], ...]:
    """The directions that neither data nor prior determine, each as {parameter: share}.

    Shares are in scaled units, the largest 1; those below `shown` are left out.
    """
    loose = np.flatnonzero(~spectrum.kept)
    # Directions of one null space are arbitrary up to rotation: the reduced echelon form
    # names the fewest parameters in each.
    basis = _echelon(spectrum.directions[:, loose].T)
    combinations = []
    for direction in basis:
        largest = np.abs(direction).max()
        combination = {
            name: float(share / largest)
            for name, share in zip(names, direction, strict=True)
            if abs(share) >= shown * largest
        }
        combinations.append(combination)
    return tuple(combinations)


def hardly_determined(spectrum: Spectrum, names: Sequence[str]) -> tuple[str, ...]:
    """The parameters in the weakest of the determined directions, none if it is not weak."""
    s = np.where(spectrum.kept, spectrum.singular_values, np.inf)
    weakest = int(np.argmin(s))
    if not s[weakest] < WEAK * float(spectrum.singular_values.max(initial=0.0)):
        return ()
    shares = np.abs(spectrum.directions[:, weakest])
    return tuple(n for n, s in zip(names, shares, strict=True) if s >= 0.05 * shares.max())


def vanished(spectrum: Spectrum, lengths: Array, before: Array) -> NDArray[np.bool_]:
    """Which parameters have lost their effect and are not determined, (n,).

    lengths, before: (n,) of their columns here and where the search began.
    """
    short = np.asarray(lengths < _VANISHED * before)
    if not short.any():
        return short
    loose = np.square(spectrum.directions[:, ~spectrum.kept]).sum(axis=1) > _LOOSE
    return np.asarray(short & loose)


def _echelon(rows: Array) -> Array:
    rows = rows.copy()
    for i in range(len(rows)):
        column = int(np.argmax(np.abs(rows[i])))
        rows[i] /= rows[i, column]
        for j in range(len(rows)):
            if j != i:
                rows[j] -= rows[j, column] * rows[i]
    return rows
