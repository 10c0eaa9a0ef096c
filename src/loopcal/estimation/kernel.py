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

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loopcal.estimation.scratch import scratch
from loopcal.expressions.engine import LoopValues
from loopcal.measurements.noise import CovarianceBlock

Array = NDArray[np.float64]
SINGULAR = 1e-13
"""A loop whose uncertain part is this small beside its own row cannot be closed."""


@dataclass(frozen=True)
class BlockNoise:
    """Uncertainty of a block: sd (k, 1) or (k, b), full-covariance blocks, unmeasured rows."""

    sd: Array
    blocks: tuple[CovarianceBlock, ...]
    unmeasured: tuple[int, ...]
    measured: tuple[int, ...]


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


def whiten(values: LoopValues, correction: Array, noise: BlockNoise) -> Whitened:
    """Whitened equations of a block, and the corrections that close its linearised loops.

    Without derivatives by parameters D is empty, and the rest is the same at a third of the cost.

    values at readings + correction, correction: (k, b) [SI].
    """
    f, jacobian, D = values.f, values.by_quantity, values.by_parameter
    measured = list(noise.measured)
    J = jacobian if len(measured) == len(jacobian) else jacobian[measured]
    reflections = Elimination()
    if noise.unmeasured:
        reflections = eliminate(jacobian[list(noise.unmeasured)])
        f, J, D = (reflections.apply(part) for part in (f, J, D))
    skip = len(noise.unmeasured)
    G = loadings(J[:, skip:], noise)
    L, singular = orthonormalise(G)
    now = correction if len(measured) == len(correction) else correction[measured]
    misclosure = np.einsum("kmb,kb->mb", J[:, skip:], now) - f[skip:]
    rows = scratch("rows", len(D) + 1, *misclosure.shape)
    forward(L, D[:, skip:], rows[:-1])
    forward(L, misclosure[None], rows[-1:])
    new = np.zeros_like(correction)
    new[measured] = unload(G, rows[-1], noise)
    if skip:
        step = new[measured] - now
        remainder = f[:skip] + np.einsum("kmb,kb->mb", J[:, :skip], step)
        unmeasured = list(noise.unmeasured)
        new[unmeasured] = correction[unmeasured] - reflections.solve(remainder)
    return Whitened(rows, G, new, singular)


def unweighted(values: LoopValues, correction: Array, noise: BlockNoise) -> Whitened:
    """The same reduction for exact sensors: D = J_p, E = -f, no corrections (seed 3.1 to 3.6).

    Unmeasured quantities are still eliminated, and found in the least squares of their loops.
    """
    f, D = values.f, values.by_parameter
    new = correction
    if noise.unmeasured:
        unmeasured = list(noise.unmeasured)
        reflections = eliminate(values.by_quantity[unmeasured])
        f, D = reflections.apply(f), reflections.apply(D)
        new = correction.copy()
        new[unmeasured] -= reflections.solve(f[: len(unmeasured)])
    skip = len(noise.unmeasured)
    r, b = f.shape[0] - skip, f.shape[1]
    rows = scratch("rows", len(D) + 1, r, b)
    rows[:-1] = D[:, skip:]
    np.negative(f[skip:], out=rows[-1])
    return Whitened(rows, np.zeros((r, 0, b)), new, np.zeros(b, dtype=bool))


def loadings(J: Array, noise: BlockNoise) -> Array:
    """G = J S for a block: (r, k', b), from J (k', r, b)."""
    sd = noise.sd if len(noise.measured) == len(noise.sd) else noise.sd[list(noise.measured)]
    G = scratch("loadings", J.shape[1], J.shape[0], J.shape[2])
    np.multiply(J.transpose(1, 0, 2), sd, out=G)
    for block in noise.blocks:
        rows = [noise.measured.index(i) for i in block.indices]
        subscripts = "crb,cd->rdb" if block.factor.ndim == 2 else "crb,bcd->rdb"
        G[:, rows] = np.einsum(subscripts, J[rows], block.factor)
    return G


def unload(G: Array, E: Array, noise: BlockNoise) -> Array:
    """correction = S Q E, (k', b), from orthonormal rows G = Q^T."""
    normalised = np.einsum("rkb,rb->kb", G, E)
    sd = noise.sd if len(noise.measured) == len(noise.sd) else noise.sd[list(noise.measured)]
    correction = normalised * sd
    for block in noise.blocks:
        rows = [noise.measured.index(i) for i in block.indices]
        subscripts = "cd,db->cb" if block.factor.ndim == 2 else "bcd,db->cb"
        correction[rows] = np.einsum(subscripts, block.factor, normalised[rows])
    result: Array = correction
    return result


def orthonormalise(G: Array) -> tuple[list[list[Array]], NDArray[np.bool_]]:
    """L with G = L Q^T, leaving Q^T in G: modified Gram-Schmidt over the rows.

    G: (r, k', b). L[i][j], j <= i: (b,). A row that loses length is swept a second time, which
    makes Q orthonormal to rounding ("twice is enough", Parlett 1980, section 6.9). Rows that
    lie in the span of the ones before are marked singular.
    """
    L: list[list[Array]] = []
    singular = np.zeros(G.shape[2], dtype=bool)
    for i, row in enumerate(G):
        before = length = np.einsum("kb,kb->b", row, row)
        entries = [np.zeros_like(before) for _ in range(i)]
        for _ in range(2 if i else 0):
            for j in range(i):
                overlap = np.einsum("kb,kb->b", row, G[j])
                row -= np.multiply(overlap, G[j], out=scratch("projection", *row.shape))
                entries[j] += overlap
            length = np.einsum("kb,kb->b", row, row)
            if not np.any(length < 0.25 * before):
                break
        bad = ~(length > SINGULAR**2 * before)
        if bad.any():
            singular |= bad
            length = np.where(bad, 1.0, length)
        length = np.sqrt(length)
        row *= 1.0 / length
        L.append([*entries, length])
    return L, singular


def forward(L: Sequence[Sequence[Array]], right: Array, out: Array) -> None:
    """L^-1 applied to the second axis of right, (c, r, b), written to out."""
    term = scratch("forward", len(right), right.shape[2])
    for i, row in enumerate(L):
        rest = right[:, i]
        for j in range(i):
            np.multiply(row[j], out[:, j], out=term)
            rest = np.subtract(rest, term, out=out[:, i])
        np.multiply(rest, 1.0 / row[i], out=out[:, i])


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
        v[0] += np.copysign(length, v[0])
        square = np.einsum("mb,mb->b", v, v)
        scale = np.where(square > 0.0, 2.0 / np.where(square > 0.0, square, 1.0), 0.0)
        weight = np.einsum("mb,cmb->cb", v, A[j:, j:]) * scale
        A[j:, j:] -= v * weight[:, None, :]
        vectors.append(v)
        scales.append(scale)
    triangle = tuple(tuple(A[j, i] for j in range(i, u)) for i in range(u))
    return Elimination(tuple(vectors), tuple(scales), triangle)
