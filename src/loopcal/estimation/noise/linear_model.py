"""The calibration linearised at a fit: a mixed linear model in the parameters' steps.

For each pose, after elimination of what is unmeasured,

    e = J dp + sum_j G_j u_j + v,   u_j ~ N(0, s_j I),   v ~ N(0, V_0),

e = J_x correction - f, J = J_p. G_j holds the loadings of component j: its columns of J_x times
their stated sds. s_j is its variance ratio (1 at the stated sds), V_0 the covariance of the sensors
whose sds are given. The misclosure then has the covariance V = V_0 + sum_j s_j G_j G_j^T. Searle,
Casella and McCulloch, Variance Components (1992), chapter 6.

All columns [J e] and G are whitened. The products of [J e] reduce the poses to a
triangle, or its QR decomposition where their rounding would show; prior terms are further rows of
it. Sums over poses go by loadings: a component with one column costs one column, not a matrix V_j
for every pose.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array, svd
from loopcal.estimation.problem.problem import Problem, Weighting
from loopcal.estimation.products import rows_times, rows_times_upper
from loopcal.estimation.solve.block import Block
from loopcal.estimation.solve.kernel import eliminate, loadings, shared_loads
from loopcal.estimation.solve.reduction import WELL_CONDITIONED, inverse_of_upper, triangle
from loopcal.estimation.solve.sweep import Sweeper
from loopcal.expressions.engine import LoopValues
from loopcal.lazy import cached_property

# The information takes them to the fourth power, and doubles end at 1e308.
_LARGEST = 1e70
"""Where columns are whitened to more than this V counts as singular."""
# Chosen, not derived: squared 1e-14, some 50 roundings.
KEPT = 1e-7
"""Directions of a triangle with a singular value this far below the largest do not count."""


@dataclass(frozen=True)
class ModelBlock:
    """b poses: rows [J e] (b, r, n + 1), fixed (b, r, r) = V_0 and the loadings G (b, r, K).

    owner: (K,) the component of each column of G, in ascending order; spare: (b, c + 1) further
    rows on which nothing acts but the noise of one component, last that of none, with the variance
    1 at its stated sd; scale: (b,) log of the product of the variances by which rows were divided.
    """

    rows: Array
    fixed: Array
    G: Array
    owner: NDArray[np.intp]
    spare: Array = field(default_factory=lambda: np.zeros((1, 0)))
    scale: Array = field(default_factory=lambda: np.zeros(1))

    @property
    def equations(self) -> Array:
        """(b,) or (1,) rows, spare ones with them."""
        return np.asarray(self.e.shape[1] + self.spare.sum(axis=1))

    def spare_of(self, components: int) -> Array:
        """(c,) spare rows of the components over all poses."""
        return self.spare.sum(axis=0)[:components] if self.spare.size else np.zeros(components)

    def by(self, J: Array) -> ModelBlock:
        """The same poses with derivatives (b, r, n) by other parameters."""
        return replace(self, rows=np.concatenate([J, self.e[:, :, None]], axis=2))

    @property
    def J(self) -> Array:
        """(b, r, n)."""
        return self.rows[:, :, :-1]

    @cached_property
    def alone(self) -> NDArray[np.intp] | None:
        """(r,) of each row the column of G that acts on it alone, by 1, as the noise of a corner;
        None where a row has none, or V_0 acts besides."""
        rows = self.G.shape[1]
        which = np.flatnonzero(np.count_nonzero(self.G, axis=1).max(axis=0, initial=0) == 1)
        if len(which) != rows or not rows or self.fixed.any():
            return None
        at = self.G[0][:, which].argmax(axis=0)
        if len({*at.tolist()}) < rows or not (self.G[:, at, which] == 1.0).all():
            return None
        return np.asarray(which[np.argsort(at)])

    @property
    def e(self) -> Array:
        """(b, r)."""
        return self.rows[:, :, -1]


@dataclass(frozen=True)
class LinearModel:
    """All poses, the prior as precision (n,) and its offset nominal - present value (n,).

    spreads: (c,) how well the stated sd of each component is known, as the sd of its logarithm;
    inf: it says nothing.
    """

    blocks: tuple[ModelBlock, ...]
    precision: Array
    offset: Array
    spreads: Array

    @property
    def components(self) -> int:
        """c, how many there are."""
        return len(self.spreads)

    @property
    def products(self) -> int:
        """How many numbers the sum [J e]^T [J e] multiplies."""
        return sum(block.rows.size for block in self.blocks) * (len(self.precision) + 1)


@dataclass(frozen=True)
class MixedFit:
    """The restricted likelihood at some variances x, here ratios (c,).

    criterion: -2 log of it, up to a constant; score: (c,) derivatives of its logarithm by x;
    information: (c, c) expected negative second derivatives; fresh: whether these are of this x,
    not of one near by; parted: whether stated sds part what only shows in a sum.
    """

    x: Array
    criterion: float
    score: Array
    information: Array
    fresh: bool = True
    parted: bool = False


def linear_model(
    problem: Problem,
    parameters: Array,
    corrections: Array,
    components: Sequence[Sequence[int]],
    spreads: Sequence[float] = (),
    *,
    compressed: bool = True,
) -> LinearModel:
    """The linearised model with one variance component for each list of quantity positions.

    spreads: of the components (see `LinearModel`), by default all inf.
    The reweighted fit has J_p where the readings stand, all others where they were corrected to.
    compressed: without the rows of images on which nothing but their own noise acts; otherwise the
    rows are the loops of each pose.
    """
    sweeper = Sweeper(problem)
    blocks = []
    for pattern, block in sweeper.blocks(parameters, corrections):
        noise, values = block.noise, sweeper.loop_values(pattern, block)
        unmeasured, measured = list(noise.unmeasured), list(noise.measured)
        f, J, D = values.f.copy(), values.by_quantity[measured], values.by_parameter
        columns = values.by_quantity[unmeasured]
        if problem.weighting is Weighting.READ:
            D = sweeper.loop_values(pattern, block.read).by_parameter
        if noise.predicted and compressed:
            blocks.append(_of_images(values, D, block, components, problem.loops_alike))
            continue
        sd = np.broadcast_to(noise.sd[list(noise.predicted)], (len(noise.predicted), block.count))
        missing = np.isinf(sd)  # empty but for images
        if missing.any():
            J, columns = J * ~missing, columns * ~missing
            f[missing] = 0.0
            D = np.where(missing, 0.0, D)
            noise = replace(noise, uncertainty=noise.uncertainty.of_read)
        skip = len(unmeasured)
        if skip:
            reflections = eliminate(columns)
            f, J, D = (reflections.apply(part) for part in (f, J, D))
        e = np.einsum("kmb,kb->mb", J[:, skip:], block.corrections[measured]) - f[skip:]
        G = loadings(J[:, skip:], noise).transpose(2, 0, 1)
        joined = np.empty((*e.T.shape, len(D) + 1))
        joined[:, :, :-1], joined[:, :, -1] = D[:, skip:].transpose(2, 1, 0), e.T
        places = [[measured.index(i) for i in c if i in noise.measured] for c in components]
        members = [i for c in places for i in c]
        rest = G[:, :, [i for i in range(len(measured)) if i not in members]]
        if missing.any():
            # They say nothing, and get a variance of 1 on which nothing depends.
            silent = missing * np.eye(len(missing))[:, :, None]
            silent = reflections.apply(silent) if skip else silent
            rest = np.concatenate([rest, silent[:, skip:].transpose(2, 1, 0)], axis=2)
        blocks.append(
            ModelBlock(
                joined,
                rest @ rest.transpose(0, 2, 1),
                np.ascontiguousarray(G[:, :, members]),
                np.array([j for j, c in enumerate(places) for _ in c], dtype=np.intp),
            )
        )
    present = parameters[problem.free]
    precision = 1.0 / np.square(problem.prior_sd)
    offset = problem.nominal - present
    by_component = np.array(spreads or [np.inf] * len(components), dtype=float)
    return LinearModel(tuple(blocks), precision, offset, by_component)


def _of_images(
    values: LoopValues,
    D: Array,
    block: Block,
    components: Sequence[Sequence[int]],
    exact: bool,
) -> ModelBlock:
    """The block of images, a row for each direction in which more acts than the corners' noise.

    Rows are divided by the sds of their own readings, whose loadings are then 1: any rotation of
    the rows of one component leaves them so. By the triangle of all other columns, of which there
    are few, they keep as many rows as there are columns. A missing reading counts as a row of
    nothing but noise, and is taken off again.
    """
    noise, corrections = block.noise, block.corrections
    predicted, unmeasured = list(noise.predicted), list(noise.unmeasured)
    shared = [] if exact else list(noise.shared)
    J = values.by_quantity
    m, b = values.f.shape
    slope, sd = J[predicted, np.arange(m)], np.broadcast_to(noise.sd[predicted], (m, b))
    missing = np.isinf(sd)
    weight = np.where(missing, 0.0, 1.0 if exact else 1.0 / (np.abs(slope) * sd))
    e = -values.f
    if not exact:
        e = e + slope * corrections[predicted]
        e += np.einsum("smb,sb->mb", J[shared], corrections[shared])
    loads = shared_loads(J, noise) if shared else J[:0]
    every = np.concatenate([J[unmeasured], loads, D, e[None]]) * weight
    owner = {q: j for j, positions in enumerate(components) for q in positions}
    of_row = np.array([owner.get(q, -1) for q in predicted])
    parts, loaded, owners = [], [], []
    spare = np.zeros((b, len(components) + 1))
    width = len(every)
    for j in sorted({*of_row.tolist()}):
        rows = every[:, of_row == j].transpose(2, 1, 0)
        spare[:, j] -= missing[of_row == j].sum(axis=0)
        if rows.shape[1] > width:
            spare[:, j] += rows.shape[1] - width
            rows = np.asarray(np.linalg.qr(rows, mode="r"))
        parts.append(rows)
        loaded.append(rows.shape[1])
        owners += [j] * rows.shape[1]
    stacked = np.concatenate(parts, axis=1).transpose(2, 1, 0)
    alone = np.repeat(np.eye(len(owners))[:, :, None], b, axis=2) * (0.0 if exact else 1.0)
    u, s = len(unmeasured), len(shared)
    columns = np.concatenate([stacked[u:], alone])
    if u:
        reflections = eliminate(stacked[:u])
        columns = reflections.apply(columns)[:, u:]
    of_column = np.array([*(owner.get(q, -1) for q in shared), *owners], dtype=np.intp)
    G = np.concatenate([columns[:s], columns[-len(owners) :]]).transpose(2, 1, 0)
    order = np.argsort(of_column, kind="stable")
    G, of_column = G[:, :, order], of_column[order]
    rest = G[:, :, of_column < 0]
    scale = np.where(missing, 0.0, -2.0 * np.log(np.where(missing, 1.0, weight))).sum(axis=0)
    return ModelBlock(
        np.ascontiguousarray(columns[s : s + len(D) + 1].transpose(2, 1, 0)),
        rest @ rest.transpose(0, 2, 1),
        np.ascontiguousarray(G[:, :, of_column >= 0]),
        of_column[of_column >= 0],
        spare,
        scale,
    )


@dataclass(frozen=True)
class Joined:
    """The whitened columns of all blocks at some ratios (c,).

    rows: (b, r, n + 1) each, W = L^-1 G: (b, r, K) each; volume: sum log|V|; sums: `total`, where
    the fit at these ratios has it.
    """

    ratios: Array
    rows: list[Array]
    W: list[Array]
    volume: float
    sums: Array | None = None

    @cached_property
    def total(self) -> Array:
        """[J e]^T [J e] over all poses, (n + 1, n + 1)."""
        if self.sums is not None:
            return self.sums
        flat = [rows.reshape(-1, rows.shape[2]) for rows in self.rows]
        return np.asarray(sum(rows.T @ rows for rows in flat))


def fit(model: LinearModel, ratios: Array, information: Array | None = None) -> MixedFit | None:
    """The restricted likelihood at these variance ratios; None where some V is singular."""
    joined = whitened(model, ratios)
    return None if joined is None else mixed_fit(model, joined, information)


def mixed_fit(model: LinearModel, joined: Joined, information: Array | None = None) -> MixedFit:
    """The restricted likelihood where the columns are whitened.

    -2 log L = sum log|V| + log|H| + residual, H = sum J^T V^-1 J + prior (Patterson and
    Thompson 1971) + sum (log s_j / (2 spread_j))^2. With P the projector
    V^-1 - V^-1 J H^-1 J^T V^-1 and r = e - J dp, the data's
    score_j = (|G_j^T V^-1 r|^2 - tr G_j^T P G_j) / 2, information_jk = |G_j^T P G_k|^2 / 2.
    information: one from near by that will do, at a third of the cost.
    """
    solved, fresh = _solved(model, joined), information is None
    if information is None:
        at = _projected(model, joined, solved)
        information, taken_up = at.information, np.trace(at.first, axis1=1, axis2=2)
    else:
        taken_up = np.zeros(model.components)
        for block, rows, W in zip(model.blocks, joined.rows, joined.W, strict=True):
            Y = _taken_up(_inner(rows, W, solved), W)
            squares = np.einsum("bkn,bkn->k", Y, Y)
            taken_up += np.equal.outer(np.arange(model.components), block.owner) @ squares
    off = _off_stated(model.spreads, joined.ratios)
    score = _score(model, joined, solved.root @ solved.along, taken_up)
    score += stated_score(model.spreads, joined.ratios)
    criterion = joined.volume + solved.log_volume + solved.residual + float(off @ off)
    parted = bool(np.isfinite(model.spreads).any())
    return MixedFit(joined.ratios, criterion, score, information, fresh, parted)


def stated_score(spreads: Array, ratios: Array) -> Array:
    """(c,) what the stated sds add to the score by the ratios."""
    return np.asarray(-0.5 * _off_stated(spreads, ratios) / spreads / _above_zero(ratios))


def _off_stated(spreads: Array, ratios: Array) -> Array:
    """(c,) how far the sds are from those stated, in spreads; a component left out is not off."""
    return np.asarray(0.5 * np.log(_above_zero(ratios)) / spreads)


def _above_zero(ratios: Array) -> Array:
    """The ratios (c,), 1 for those of components that are left out."""
    return np.where(ratios > 0.0, ratios, 1.0)


@dataclass(frozen=True)
class Projected:
    """What the parameters take up of each component.

    H^-1 = root root^T, (n, rank); inner: D root, (b, r, rank), or Y = W^T D root, (b, K, rank),
    whichever has fewer rows, W (b, r, K) and owner: (K,) the component of each column, all by
    block; first: (c, rank, rank) = sum Y_j^T Y_j over all poses; information: (c, c) on the ratios.
    """

    root: Array
    inner: tuple[Array, ...]
    W: tuple[Array, ...]
    owners: tuple[NDArray[np.intp], ...]
    first: Array
    information: Array

    def second(self, weights: Array) -> Array:
        """(rank, rank) sum_jk w_jk root^T J^T V^-1 V_j V^-1 V_k V^-1 J root, w (c, c) symmetric."""
        rank = self.root.shape[1]
        total = np.zeros((rank, rank))
        for inner, W, owner in zip(self.inner, self.W, self.owners, strict=True):
            turned = np.swapaxes(W, 1, 2)
            weighed = weights[np.ix_(owner, owner)] * (turned @ W)
            if not _by_columns(W):
                weighed = W @ weighed @ turned
            total += (weighed @ inner).reshape(-1, rank).T @ inner.reshape(-1, rank)
        return total


def projected(model: LinearModel, ratios: Array) -> Projected | None:
    """What the parameters take up at these variance ratios; None where some V is singular."""
    joined = whitened(model, ratios)
    return None if joined is None else _projected(model, joined, _solved(model, joined))


@dataclass(frozen=True)
class _Solved:
    """The least |R z - right|, R^T R = H, over the directions that are determined.

    root: H^-1 = root root^T; along: the solution in its directions; residual: what is left of the
    squares; log_volume: log of the determinant of H, up to a constant; upper: whether root is an
    upper triangle.
    """

    root: Array
    along: Array
    residual: float
    log_volume: float
    upper: bool


def _solved(model: LinearModel, joined: Joined) -> _Solved:
    """The whitened columns with the prior, solved for the parameters."""
    prior = _prior_rows(model)
    total = joined.total + prior.T @ prior
    scale = 1.0 / np.sqrt(np.maximum(np.diag(total), 1e-300))
    solved = None
    with suppress(np.linalg.LinAlgError):
        R = np.asarray(np.linalg.cholesky(total * scale * scale[:, None]).T, dtype=np.float64)
        solved = _by_triangle(R, scale, WELL_CONDITIONED)
    if solved is None:
        # products would square the condition and leave the criterion some seven digits
        R = triangle(prior, *(rows.reshape(-1, rows.shape[2]) for rows in joined.rows))
        solved = _by_triangle(R * scale, scale, 1.0 / KEPT) or _by_directions(R)
    return solved


def _by_triangle(R: Array, scale: Array, most: float) -> _Solved | None:
    """By the triangle of [J e] with its columns scaled; None where its condition is not surely at
    most so much."""
    n = len(scale) - 1
    if len(R) <= n or not np.diag(R)[:n].all():
        return None
    inverse = inverse_of_upper(R[:n, :n])
    # In Frobenius' norm the product is no less than the condition number.
    if not np.linalg.norm(R[:n, :n]) * np.linalg.norm(inverse) <= most:
        return None
    column_scale, size = scale[:n], 1.0 / scale[n]
    log_volume = 2.0 * float(np.log(np.abs(np.diag(R)[:n])).sum() - np.log(column_scale).sum())
    # The last pivot of the triangle of [J e] is the length of what J leaves of e.
    residual = float(R[n, n] * size) ** 2
    return _Solved(column_scale[:, None] * inverse, R[:n, n] * size, residual, log_volume, True)


def _by_directions(R: Array) -> _Solved:
    """By the singular values of the triangle, where some directions may not be determined."""
    n = R.shape[1] - 1
    scale = 1.0 / np.maximum(np.linalg.norm(R[:, :n], axis=0), 1e-150)
    U, values, Vt = svd(R[:, :n] * scale)
    kept = values > KEPT * values[0]
    root = scale[:, None] * Vt[kept].T / values[kept]
    log_volume = 2.0 * float(np.log(values[kept]).sum() - np.log(scale).sum())
    along = U[:, kept].T @ R[:, n]
    left = R[:, n] - U[:, kept] @ along
    return _Solved(root, along, float(left @ left), log_volume, False)


def _prior_rows(model: LinearModel) -> Array:
    """The prior as further rows of [J e]."""
    prior = np.sqrt(model.precision)
    return np.column_stack([np.diag(prior), prior * model.offset])


def whitened(model: LinearModel, ratios: Array, sums: Array | None = None) -> Joined | None:
    """The columns of all poses whitened; None where some V is singular.

    sums: [J e]^T [J e] of all poses, where a fit at these ratios has added them up.
    """
    every, W, log_V = [], [], 0.0
    for block in model.blocks:
        spare = block.spare_of(model.components)
        if np.any(spare[ratios == 0.0]):
            return None
        log_V += float(spare @ np.log(_above_zero(ratios)) + block.scale.sum())
        root = _near_diagonal(block, ratios) or _dense(block, ratios)
        if root is None:
            return None
        log_V += root.log_volume
        rows, turned = root.times(block.rows), root.times(block.G)
        # not of absolute values, which are as large an array again
        ends = [
            end for one in (rows, turned) for end in (-one.min(initial=0.0), one.max(initial=0.0))
        ]
        if not all(end < _LARGEST for end in ends):
            return None
        every.append(rows)
        W.append(turned)
    return Joined(ratios, every, W, log_V, sums)


class _Root(NamedTuple):
    """times: of X (b, r, m) the product R X, R V R^T = 1 by pose; log_volume: log det V of all."""

    times: Callable[[Array], Array]
    log_volume: float


def _dense(block: ModelBlock, ratios: Array) -> _Root | None:
    """R = L^-1 of V = L L^T; None where V is singular."""
    V = block.fixed + (block.G * ratios[block.owner]) @ block.G.transpose(0, 2, 1)
    try:
        L = np.linalg.cholesky(V)
    except np.linalg.LinAlgError:
        return None
    # NumPy solves no stacks of triangles: an inverse and a product serve the whole block.
    inverse = np.linalg.inv(L)
    log_V = 2.0 * float(np.log(np.einsum("brr->br", L)).sum())
    return _Root(lambda X: np.asarray(inverse @ X), log_V)


def _near_diagonal(block: ModelBlock, ratios: Array) -> _Root | None:
    """R of V = S (1 + U U^T) S, S diagonal and U (b, r, k) of few columns, as those of images are:
    the cube of their rows is left out. With U^T U = Q diag(l) Q^T

        R = (1 + U Q diag(g) Q^T U^T) S^-1,   g = (1 / sqrt(1 + l) - 1) / l.

    None where V has no such form.
    """
    if block.alone is None:
        return None
    others = np.ones(len(block.owner), dtype=bool)
    others[block.alone] = False
    variances = ratios[block.owner[block.alone]]
    if others.sum() >= len(variances) or not (variances > 0.0).all():
        return None
    S = np.sqrt(variances)[:, None]
    U = block.G[:, :, others] * np.sqrt(ratios[block.owner[others]]) / S
    turned = U.transpose(0, 2, 1)
    values, Q = np.linalg.eigh(turned @ U)
    size = np.sqrt(1.0 + np.maximum(values, 0.0))
    core = (Q * (-1.0 / (size * (1.0 + size)))[:, None, :]) @ Q.transpose(0, 2, 1)

    def times(X: Array) -> Array:
        scaled = X / S
        return np.asarray(scaled + U @ (core @ (turned @ scaled)))

    log_V = len(U) * float(np.log(variances).sum()) + 2.0 * float(np.log(size).sum())
    return _Root(times, log_V)


def _projected(model: LinearModel, joined: Joined, solved: _Solved) -> Projected:
    """With C = W^T W and Q = Y Y^T by pose."""
    root = solved.root
    rank, count = root.shape[1], model.components
    pairs, first, every = np.zeros((count, count)), np.zeros((count, rank, rank)), []
    for block, rows, W in zip(model.blocks, joined.rows, joined.W, strict=True):
        turned = W.transpose(0, 2, 1)
        inner = _inner(rows, W, solved)
        Y = _taken_up(inner, W)
        C, Q = turned @ W, Y @ Y.transpose(0, 2, 1)
        members = np.equal.outer(np.arange(count), block.owner).astype(float)  # (c, K)
        # |C - Q|^2 = C C - 2 C Q + Q Q; the last part joins all pairs of poses, hence `first`.
        pairs += members @ np.einsum("bkl,bkl->kl", C, C - 2.0 * Q) @ members.T
        for j in range(count):
            part = Y[:, columns(block.owner, j)]
            Y_j = part.reshape(part.shape[0] * part.shape[1], rank)
            first[j] += Y_j.T @ Y_j
        every.append(inner)
    flat = first.reshape(count, rank * rank)
    owners = tuple(block.owner for block in model.blocks)
    information = 0.5 * (pairs + flat @ flat.T)
    spare = sum(block.spare_of(count) for block in model.blocks)
    information += np.diag(0.5 * spare / np.square(_above_zero(joined.ratios)))
    # curvature of the prior in the logarithm
    information += np.diag(np.square(0.5 / model.spreads / _above_zero(joined.ratios)))
    return Projected(root, tuple(every), tuple(joined.W), owners, first, information)


def _by_columns(W: Array) -> bool:
    """Whether the columns of W (b, r, K) are fewer than its rows."""
    return bool(W.shape[2] < W.shape[1])


def _inner(rows: Array, W: Array, solved: _Solved) -> Array:
    """D root of a block, or W^T D root where that has fewer rows."""
    times = rows_times_upper if solved.upper else rows_times
    D = rows[:, :, : len(solved.root)]
    return times(W.transpose(0, 2, 1) @ D if _by_columns(W) else D, solved.root)


def _taken_up(inner: Array, W: Array) -> Array:
    """Y = W^T D root (b, K, rank) of a block."""
    return inner if _by_columns(W) else np.asarray(W.transpose(0, 2, 1) @ inner)


def columns(owner: NDArray[np.intp], which: int) -> slice:
    """Where the columns of a component stand, which are beside each other."""
    first, last = np.searchsorted(owner, [which, which + 1]).tolist()
    return slice(first, last)


def _score(model: LinearModel, joined: Joined, dp: Array, taken_up: Array) -> Array:
    """taken_up: (c,) = tr G_j^T V^-1 J H^-1 J^T V^-1 G_j over all poses."""
    n, score = len(dp), 0.5 * taken_up
    for block, rows, W in zip(model.blocks, joined.rows, joined.W, strict=True):
        r = rows[:, :, n] - rows[:, :, :n] @ dp
        misfit = np.square(np.einsum("brk,br->bk", W, r)).sum(axis=0)
        members = np.equal.outer(np.arange(model.components), block.owner).astype(float)
        score += 0.5 * members @ (misfit - np.square(W).sum(axis=(0, 1)))
        score -= 0.5 * block.spare_of(model.components) / _above_zero(joined.ratios)
    return np.asarray(score)
