"""The block kernel: the loops of a block of poses, reduced to whitened equations in parameters.

For each pose, with the loops linearised at the corrected readings x = reading + correction,

    f + J_x (dx) + J_p (dp) = 0,   correction + dx ~ N(0, Sigma),   Sigma = S S^T,

unmeasured quantities are eliminated by projecting onto the left null space of their columns of
J_x (Householder reflections), and the rest is whitened: with G = J_x S and the QR decomposition
G^T = Q R, L = R^T,

    D = L^-1 J_p,   E = L^-1 (J_x correction - f),   E - D dp ~ N(0, I).

|E|^2 is the least weighted square of corrections that close the linearised loops at these
parameters, reached by correction = S Q E. Seed (3.19) to (3.30); Wampler, Hollerbach and Arai
(1995), section III. QR by modified Gram-Schmidt (Bjorck 1967) keeps the digits that forming
J Sigma J^T would lose where sensors differ by orders of magnitude.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.estimation.solve.block import Block, BlockNoise
from loopcal.estimation.solve.scratch import scratch
from loopcal.expressions.engine import LoopValues

# This and ROUNDED_AWAY: some 450 eps. Chosen, not derived.
SINGULAR = 1e-13
"""A loop whose uncertain part is this small beside its own row cannot be closed."""
# Leaves eps / REORTHOGONAL of orthogonality: thirty roundings, for few second projections.
REORTHOGONAL = 0.03
"""A row of which projections left no more than this is made orthogonal once more."""


ROUNDED_AWAY = 1e-13
"""Eliminating may leave this much of a derivative's length as rounding."""


@dataclass(frozen=True)
class Whitened:
    """A block of b poses, linearised and whitened.

    rows: (n + 1, r, b), the n columns of D and last E, r = loop equations left after elimination;
    G: (r, k', b) whitened loadings L^-1 J_x S of the measured quantities (orthonormal rows);
    correction: (k, b) new corrections with these parameters held [SI]; singular: (b,) poses
    whose loops cannot close. rows and G are overwritten by the next block.
    """

    rows: Array
    G: Array
    correction: Array
    singular: NDArray[np.bool_]

    @property
    def D(self) -> Array:
        """Whitened derivatives by the parameters, (n, r, b)."""
        part: Array = self.rows[:-1]
        return part

    @property
    def E(self) -> Array:
        """Whitened misclosure, (r, b)."""
        part: Array = self.rows[-1]
        return part


def whiten(values: LoopValues, block: Block) -> Whitened:
    """Whitened equations of a block, and the corrections that close its linearised loops.

    Without derivatives by parameters D is empty, and the rest is the same at a third of the cost.

    values: at the corrected readings of the block.
    """
    if block.noise.predicted:
        return whiten_images(values, block)
    correction, noise = block.corrections, block.noise
    f, D = values.f, values.by_parameter
    J, now = _measured(values.by_quantity, noise), _measured(correction, noise)
    reflections = Elimination()
    if noise.unmeasured:
        reflections = eliminate(values.by_quantity[list(noise.unmeasured)])
        turned = reflections.matrix(f.shape)
        f, J = np.einsum("cjb,cb->jb", turned, f), combined(turned, J, "turned J")
        D = without_rounding(turned[:, len(noise.unmeasured) :], D)
    skip = len(noise.unmeasured)
    G = loadings(J[:, skip:], noise)
    L, singular = orthonormalise(G)
    misclosure = np.einsum("kmb,kb->mb", J[:, skip:], now, out=scratch("misclosure", *L.shape[1:]))
    misclosure -= f[skip:]
    rows = scratch("rows", len(D) + 1, *misclosure.shape)
    substitute(L, misclosure, out=rows[-1])
    if len(D):
        inverse = inverse_triangle(L)
        for i in range(len(L)):
            np.einsum("jb,njb->nb", inverse[i, : i + 1], D[:, : i + 1], out=rows[:-1, i])
    new = unload(G, rows[-1], noise)
    if skip:
        remainder = f[:skip] + np.einsum("kmb,kb->mb", J[:, :skip], new - now)
        measured, new = new, correction.copy()
        new[list(noise.measured)] = measured
        # The eliminated rows say f + J (new - now) + R du = 0, R the triangle of `reflections`.
        new[list(noise.unmeasured)] -= reflections.solve(remainder)
    return Whitened(rows, G, new, singular)


def without_rounding(turned: Array, D: Array) -> Array:
    """Derivatives by parameters (n, m, b) in the loops that reflections leave, (n, r, b).

    What only rounding left of a derivative is made zero: a parameter that an unmeasured quantity
    makes up for would else seem determined, if badly.
    """
    length = np.sqrt(np.einsum("nmb,nmb->nb", D, D))[:, None, :]
    left = combined(turned, D, "left")
    left[np.abs(left) < ROUNDED_AWAY * length] = 0.0
    return left


def combined(turned: Array, rows: Array, name: str) -> Array:
    """sum_c rows[n, c] turned[c], (n, r, b), from rows (n, m, b) and columns turned (m, r, b).

    A parameter or reading of a machine with many loops is in one of them or few. Loops in which
    a derivative is zero in all poses cost nothing. Overwritten by the next call for `name`.
    """
    out = scratch(name, len(rows), *turned.shape[1:])
    occurrences: NDArray[np.bool_] = np.any(rows, axis=2)
    for row, occurs, combination in zip(rows, occurrences, out, strict=True):
        loops = np.flatnonzero(occurs)
        if len(loops) == 1:
            np.multiply(turned[loops[0]], row[loops[0]], out=combination)
        else:
            np.einsum("cjb,cb->jb", turned[loops], row[loops], out=combination)
    return out


def _measured(rows: Array, noise: BlockNoise) -> Array:
    """The rows of the measured quantities; no copy where all are."""
    return rows[list(noise.measured)] if noise.unmeasured else rows


def unweighted(values: LoopValues, block: Block) -> Whitened:
    """The same reduction for exact sensors: D = J_p, E = -f, no corrections (seed 3.1 to 3.6).

    Unmeasured quantities are still eliminated, and found in the least squares of their loops.
    """
    if block.noise.predicted:
        return whiten_images(values, block, exact=True)
    correction, noise = block.corrections, block.noise
    f, D = values.f, values.by_parameter
    new = correction
    if noise.unmeasured:
        unmeasured = list(noise.unmeasured)
        reflections = eliminate(values.by_quantity[unmeasured])
        D = without_rounding(reflections.matrix(f.shape)[:, len(unmeasured) :], D)
        f = reflections.apply(f)
        new = correction.copy()
        new[unmeasured] -= reflections.solve(f[: len(unmeasured)])
    skip = len(noise.unmeasured)
    r, b = f.shape[0] - skip, f.shape[1]
    rows = scratch("rows", len(D) + 1, r, b)
    rows[:-1] = D
    np.negative(f[skip:], out=rows[-1])
    return Whitened(rows, np.zeros((r, 0, b)), new, np.zeros(b, dtype=bool))


def loadings(J: Array, noise: BlockNoise) -> Array:
    """G = J S for a block: (r, k', b), from J (k', r, b); overwritten by the next block."""
    G = scratch("loadings", J.shape[1], J.shape[0], J.shape[2])
    np.multiply(J.transpose(1, 0, 2), _measured_sd(noise), out=G)
    for block in noise.blocks:
        rows = [noise.measured.index(i) for i in block.indices]
        subscripts = "crb,cd->rdb" if block.factor.ndim == 2 else "crb,bcd->rdb"
        G[:, rows] = np.einsum(subscripts, J[rows], block.factor)
    return G


def _measured_sd(noise: BlockNoise) -> Array:
    return _measured(noise.sd, noise)


def unload(G: Array, E: Array, noise: BlockNoise) -> Array:
    """correction = S Q E, (k', b), from orthonormal rows G = Q^T."""
    normalised = np.einsum("rkb,rb->kb", G, E, out=scratch("normalised", *G.shape[1:]))
    correction: Array = normalised * _measured_sd(noise)
    for block in noise.blocks:
        rows = [noise.measured.index(i) for i in block.indices]
        subscripts = "cd,db->cb" if block.factor.ndim == 2 else "bcd,db->cb"
        correction[rows] = np.einsum(subscripts, block.factor, normalised[rows])
    return correction


def orthonormalise(G: Array) -> tuple[Array, NDArray[np.bool_]]:
    """L with G = L Q^T, leaving Q^T in G: modified Gram-Schmidt over the rows.

    G: (r, k', b). L: (r, r, b), only entries [i, j], j <= i, are set; overwritten by the next
    block. L is exact to rounding without more; a row left with less than REORTHOGONAL of its
    length is swept a second time ("twice is enough", Parlett 1980, section 6.9), so that Q^T is
    orthonormal to eps / REORTHOGONAL, times that again where each of three rows nearly lies in
    the span of the ones before. Rows that lie there altogether are marked singular.
    """
    L = scratch("triangle", len(G), len(G), G.shape[2])
    singular = np.zeros(G.shape[2], dtype=bool)
    for i, row in enumerate(G):
        _project(row, G[:i], L[i])
        length = np.einsum("kb,kb->b", row, row, out=L[i, i])
        # Pythagoras: what is left and the overlaps make up the row as it was.
        before = length + np.einsum("jb,jb->b", L[i, :i], L[i, :i]) if i else length
        if not np.all(length > REORTHOGONAL**2 * before):
            again = scratch("again", i, G.shape[2])
            _project(row, G[:i], again)
            L[i, :i] += again
            np.einsum("kb,kb->b", row, row, out=length)
            bad = ~(length > SINGULAR**2 * before)
            singular |= bad
            # Dividing by 1 keeps NaN out of the sums over all poses; the pose is marked singular.
            length[bad] = 1.0
        np.sqrt(length, out=length)
        np.multiply(row, 1.0 / length, out=row)
    return L, singular


def _project(row: Array, basis: Array, overlaps: Array) -> None:
    """Take from row (k', b) its part in the span of orthonormal rows; overlaps: (i, b) or more."""
    part = scratch("projection", *row.shape)
    for j, unit in enumerate(basis):
        overlap = np.einsum("kb,kb->b", row, unit, out=overlaps[j])
        np.subtract(row, np.multiply(overlap, unit, out=part), out=row)


def substitute(L: Array, right: Array, out: Array) -> None:
    """L^-1 right, (r, b), for lower triangles L (r, r, b), written to out.

    Loops then close to rounding however small the last rows of L; a product with L^-1 would
    lose as many digits as L is ill-conditioned.
    """
    for i in range(len(L)):
        rest = right[i]
        for j in range(i):
            rest = np.subtract(
                rest, np.multiply(L[i, j], out[j], out=scratch("term", len(rest))), out=out[i]
            )
        np.divide(rest, L[i, i], out=out[i])


def inverse_triangle(L: Array) -> Array:
    """L^-1 of lower triangles (r, r, b), only entries [i, j], j <= i; overwritten by the next."""
    inverse = scratch("inverse", *L.shape)
    for i in range(len(L)):
        pivot = np.divide(1.0, L[i, i], out=inverse[i, i])
        for j in range(i):
            total = np.einsum("kb,kb->b", L[i, j:i], inverse[j:i, j], out=inverse[i, j])
            np.multiply(total, -pivot, out=total)
    return inverse


@dataclass(frozen=True)
class Elimination:
    """Householder reflections that triangularise the columns of the unmeasured quantities.

    vectors[j]: (m - j, b), scales[j]: (b,); triangle[i][j], i <= j: (b,).
    """

    vectors: tuple[Array, ...] = ()
    scales: tuple[Array, ...] = ()
    triangle: tuple[tuple[Array, ...], ...] = ()

    def apply(self, part: Array) -> Array:
        """The reflections applied along the loop axis: (m, b) or (c, m, b); a new array."""
        out = np.array(part)
        stacked = out[None] if out.ndim == 2 else out
        for j, (v, scale) in enumerate(zip(self.vectors, self.scales, strict=True)):
            weight = np.einsum("mb,cmb->cb", v, stacked[:, j:]) * scale
            stacked[:, j:] -= v * weight[:, None, :]
        return out

    def matrix(self, shape: tuple[int, ...]) -> Array:
        """What becomes of each of m loops, (m, m, b), for loop values of the shape (m, b)."""
        m, b = shape
        identity = np.zeros((m, m, b))
        identity[np.arange(m), np.arange(m)] = 1.0
        return self.apply(identity)

    def undo(self, part: Array) -> Array:
        """What the reflections made of some columns (c, m, b), back to those; a new array."""
        out = np.array(part)
        every = list(enumerate(zip(self.vectors, self.scales, strict=True)))
        for j, (v, scale) in reversed(every):
            weight = np.einsum("mb,cmb->cb", v, out[:, j:]) * scale
            out[:, j:] -= v * weight[:, None, :]
        return out

    def solve(self, right: Array) -> Array:
        """The unmeasured quantities' steps from their u triangular rows; (u, b).

        A quantity on which a pose's loops do not depend at all stays where it is.
        """
        u = len(self.vectors)
        out = np.zeros((u, right.shape[1]))
        for i in range(u - 1, -1, -1):
            rest = right[i] - sum(self.triangle[i][j - i] * out[j] for j in range(i + 1, u))
            pivot = self.triangle[i][0]
            flat = np.abs(pivot) < 1e-12
            out[i] = np.where(flat, 0.0, rest / np.where(flat, 1.0, pivot))
        return out


def eliminate(columns: Array) -> Elimination:
    """Householder reflections for the columns (u, m, b) of the unmeasured quantities."""
    A = np.array(columns)
    vectors: list[Array] = []
    scales: list[Array] = []
    u = len(A)
    for j in range(u):
        v = A[j, j:].copy()
        length = np.sqrt(np.einsum("mb,mb->b", v, v))
        # The other sign would cancel digits where the column is nearly along the first axis.
        v[0] += np.copysign(length, v[0])
        square = np.einsum("mb,mb->b", v, v)
        scale = np.where(square > 0.0, 2.0 / np.where(square > 0.0, square, 1.0), 0.0)
        weight = np.einsum("mb,cmb->cb", v, A[j:, j:]) * scale
        A[j:, j:] -= v * weight[:, None, :]
        vectors.append(v)
        scales.append(scale)
    triangle = tuple(tuple(A[j, i] for j in range(i, u)) for i in range(u))
    return Elimination(tuple(vectors), tuple(scales), triangle)


# Images: poses with many loops, each of which predicts one pixel coordinate.


def whiten_images(values: LoopValues, block: Block, *, exact: bool = False) -> Whitened:
    """The same equations where each loop i has its own reading y_i, with the slope a_i.

        f + a y + J_s dx_s + J_u du + J_p dp = 0,   y_i ~ N(0, sd_i),   x_s = S_s z,  z ~ N(0, 1).

    Weighted by w_i = 1 / (|a_i| sd_i), 0 where y_i is missing, the columns of unmeasured
    quantities and, above ones of their own, of shared readings are triangularised:

        [ w J_u  w J_s S_s ]         [ R ]
        [   0        1     ]  =  H   [ 0 ],

    and what H leaves of w J_p and w e below R are D and E. This is Woodbury's inverse of the
    covariance sd^2 + J_s S_s S_s^T J_s^T in the form that squares nothing; it costs some
    m (u + s) operations for each parameter, where the covariance of m loops costs m^2.

    exact: every reading is, and only missing ones are found. G is empty.
    """
    noise, correction, J = block.noise, block.corrections, values.by_quantity
    turned = TurnedImages.of(values, block, exact=exact)
    D, u, s = values.by_parameter, turned.unmeasured, turned.shared
    right = turned.apply(turned.misclosure)
    rows = np.concatenate([turned.left(D), right[None, u + s :]])
    steps = turned.reflections.solve(right[: u + s])
    unmeasured, shared = list(noise.unmeasured), [] if exact else list(noise.shared)
    new = correction.copy() if exact else np.zeros_like(correction)
    new[unmeasured] = correction[unmeasured] + steps[:u]
    new[shared] = noise.sd[shared] * steps[u:]
    for covariance in noise.blocks if s else ():
        places = [u + shared.index(i) for i in covariance.indices]
        subscripts = "cd,db->cb" if covariance.factor.ndim == 2 else "bcd,db->cb"
        new[list(covariance.indices)] = np.einsum(subscripts, covariance.factor, steps[places])
    rest = turned.misclosure - np.einsum("umb,ub->mb", J[unmeasured], steps[:u])
    rest -= np.einsum("smb,sb->mb", J[shared], new[shared])
    rest /= turned.slope
    predicted = list(noise.predicted)
    missing = turned.weight == 0.0
    new[predicted] = (
        np.where(missing, correction[predicted] + rest, new[predicted]) if exact else rest
    )
    return Whitened(
        rows, np.zeros((len(rows[0]), 0, block.count)), new, np.zeros(block.count, bool)
    )


@dataclass(frozen=True)
class TurnedImages:
    """Images with the columns of unmeasured and shared readings triangularised (`whiten_images`).

    weight, slope, misclosure: (m, b); reflections: of m + s rows; unmeasured, shared: u and s.
    """

    weight: Array
    slope: Array
    misclosure: Array
    reflections: Elimination
    unmeasured: int
    shared: int

    @classmethod
    def of(cls, values: LoopValues, block: Block, *, exact: bool) -> TurnedImages:
        """Of the loops at the corrected readings of a block."""
        noise, correction, J = block.noise, block.corrections, values.by_quantity
        predicted, unmeasured = list(noise.predicted), list(noise.unmeasured)
        shared = [] if exact else list(noise.shared)
        u, s, (m, b) = len(unmeasured), len(shared), values.f.shape
        slope, sd = J[predicted, np.arange(m)], np.broadcast_to(noise.sd[predicted], (m, b))
        weight = np.where(np.isinf(sd), 0.0, 1.0 if exact else 1.0 / (np.abs(slope) * sd))
        columns = np.zeros((u + s, m + s, b))
        columns[:u, :m] = J[unmeasured] * weight
        columns[u:, :m] = (shared_loads(J, noise) if s else J[:0]) * weight
        columns[np.arange(u, u + s), np.arange(m, m + s)] = 1.0
        misclosure = -values.f
        if not exact:
            misclosure += slope * correction[predicted]
            misclosure += np.einsum("smb,sb->mb", J[shared], correction[shared])
        return cls(weight, slope, misclosure, eliminate(columns), u, s)

    def apply(self, part: Array) -> Array:
        """The reflections of weighted columns (c, m, b) or of one (m, b)."""
        below = np.zeros((*part.shape[:-2], self.shared, part.shape[-1]))
        return self.reflections.apply(np.concatenate([part * self.weight, below], axis=-2))

    def left(self, columns: Array) -> Array:
        """What they leave of columns (c, m, b) below the triangle, (c, m - u, b)."""
        left = self.apply(columns)[:, self.unmeasured + self.shared :]
        if self.unmeasured:
            length = np.sqrt(np.square(columns * self.weight).sum(axis=1))[:, None, :]
            left[np.abs(left) < ROUNDED_AWAY * length] = 0.0
        return left

    def effects(self, Q: Array) -> Array:
        """What each pixel does along directions Q (b, m - u, q) of these rows, (b, q, m)."""
        u_s, m = self.unmeasured + self.shared, len(self.slope)
        rows = np.zeros((Q.shape[2], m + self.shared, len(Q)))
        rows[:, u_s:] = Q.transpose(2, 1, 0)
        along = self.reflections.undo(rows)[:, :m] * (self.weight * self.slope)
        return np.asarray(along.transpose(2, 0, 1))

    @property
    def squares(self) -> Array:
        """(b, m) squares of what each pixel does to all of these rows."""
        u_s, m = self.unmeasured + self.shared, len(self.slope)
        above = np.zeros((u_s, m + self.shared, self.slope.shape[1]))
        above[np.arange(u_s), np.arange(u_s)] = 1.0
        left = 1.0 - np.square(self.reflections.undo(above)[:, :m]).sum(axis=0)
        squares: Array = (np.square(self.weight * self.slope) * np.maximum(left, 0.0)).T
        return squares


def shared_loads(J: Array, noise: BlockNoise) -> Array:
    """J_s S_s, (s, m, b), of the readings that all loops of an image share."""
    shared = list(noise.shared)
    loads: Array = J[shared] * noise.sd[shared][:, None]
    for covariance in noise.blocks:
        rows = [shared.index(i) for i in covariance.indices]
        subscripts = "crb,cd->drb" if covariance.factor.ndim == 2 else "crb,bcd->drb"
        loads[rows] = np.einsum(subscripts, J[list(covariance.indices)], covariance.factor)
    return loads
