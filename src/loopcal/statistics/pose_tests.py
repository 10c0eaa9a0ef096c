"""Tests of poses and readings: what one row of data says against all the others.

For the pose's whitened equations E = D dp + v with the parameters known from the *other* poses to
a covariance C, the misclosure has the covariance 1 + D C D^T (times the variance factor). With W
its inverse and y = W E,

    t = y^T W^-1 y ~ chi-squared(r),   w_j = -x_j^T y / sqrt(x_j^T W x_j) ~ N(0, 1),

x_j the column of reading j: t asks whether the pose fits, w_j (Baarda 1968) whether reading j is
wrong; -w_j is also the reading's correction over the sd of that correction. Where an image stood is
read once, and hundreds of corners hide an error of it in t. So its joints, or the six readings of
its place, are tested together: with X their columns, y^T X (X^T W X)^-1 X^T y. For a pose that took
part in the fit W = 1 - D C D^T and y = E with C of all poses, which is the same thing.
Where the scale comes from residuals, t / r follows F and w_j Student's t.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from loopcal import chi_squared
from loopcal.arrays import Array
from loopcal.estimation.problem.pose_equations import PoseEquations, pose_equations
from loopcal.estimation.problem.problem import Problem, left_unmeasured, taken
from loopcal.estimation.products import rows_times
from loopcal.estimation.redundancy import UNCONTROLLED
from loopcal.estimation.solve.gauss_newton import NEGLIGIBLE, Closed
from loopcal.estimation.solve.sweep import Sweeper

# An sd from ten values is sure to 22 %. The rest is chosen, not derived, as in `ordered_system`.
_POINT, _ENOUGH, _HUBER, _ROUNDS = 3, 10, 1.5, 4
"""Equations that a point gives; poses for each equation from which their scatter is known; from so
many sds on a pose counts less, in so many rounds."""

# Chosen, not derived: fewer equations, or images, do not show how scales differ.
_IMAGE, _IMAGES = 8, 5
_NORMAL = 1.4826
"""sd of a normal variable over its median absolute deviation."""


@dataclass(frozen=True)
class PoseTests:
    """Statistics of N poses.

    t: (N,) chi-squared of the pose, freedom: (N,) its degrees of freedom; w: (k, N) of each
    reading, NaN where it cannot be tested; sd: (k, N) of the size of its error [SI]; denominator:
    degrees of freedom of the scale, inf where it is known; images: those by which the scale of one
    image differs from that of another, inf where they are alike; shared, sharing: (N,) chi-squared
    of what all corners of an image share, and its degrees of freedom, 0 for other poses; places:
    degrees of freedom of the scale of that, inf where it is known; least: (N,) the least share of
    the scatter of an equation that the parameters do not account for.
    """

    t: Array
    freedom: NDArray[np.intp]
    w: Array
    sd: Array
    denominator: float = math.inf
    images: float = math.inf
    shared: Array = field(default_factory=lambda: np.zeros(0))
    sharing: NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    places: float = math.inf
    least: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def of_pose(self) -> float:
        """Degrees of freedom of the scale of one pose."""
        relative = 1.0 / self.denominator + 1.0 / self.images
        return 1.0 / relative if relative else math.inf

    @property
    def p_pose(self) -> Array:
        """Probability of such a t where the pose is good, (N,)."""
        return tail(self.t, self.freedom, self.of_pose)

    @property
    def p_shared(self) -> Array:
        """Probability of such an error of what corners share where it is good, (N,)."""
        return tail(self.shared, self.sharing, self.places)


@dataclass(frozen=True)
class Fitted:
    """Where a fit stands: parameters (n_all,), corrections (k, N) [SI], covariance (n, n) at a
    variance factor of 1, the factor itself with its degrees of freedom, inf where it is known.

    images: degrees of freedom by which the scales of images differ (`scatter_of_images`), inf where
    they are alike; alike: number of equations r -> (r, r) by which those of a pose are turned to be
    independent and alike, where the scale of errors that several targets share comes from the
    residuals; blocks: the equations of all poses of the fit where they are at hand.
    """

    parameters: Array
    corrections: Array
    covariance: Array
    factor: float
    denominator: float = math.inf
    images: float = math.inf
    alike: Mapping[int, Array] = field(default_factory=dict)
    blocks: tuple[PoseEquations, ...] = ()

    def equations(self, problem: Problem) -> tuple[PoseEquations, ...]:
        """Of every pose where the fit stands."""
        if self.blocks:
            return self.blocks
        return self.turned(pose_equations(problem.where_closed, self.parameters, self.corrections))

    def turned(self, blocks: Sequence[PoseEquations]) -> tuple[PoseEquations, ...]:
        """Blocks as they were whitened, with equations that are independent and alike."""
        return tuple(self._turned(block) for block in blocks)

    def _turned(self, block: PoseEquations) -> PoseEquations:
        T = self.alike.get(block.E.shape[1])
        if T is None or block.beside is not None:
            return block
        return replace(block, E=block.E @ T.T, D=T @ block.D, X=T @ block.X)


def independent(blocks: Sequence[PoseEquations], kept: NDArray[np.bool_]) -> dict[int, Array]:
    """What makes the equations of a pose independent and alike, by their number.

    From the scatter of the poses that are kept (N,), those that fit badly counting less (Huber).
    Only where a pose has more equations than one point gives.
    """
    whitenings = {}
    for block in blocks:
        E, r = block.E[kept[block.poses]], block.E.shape[1]
        if r <= _POINT or len(E) <= 2 * r or block.beside is not None:
            continue
        # of few poses partly as if the equations were alike: their scatter is unsure itself
        share, weights = min(1.0, len(E) / (_ENOUGH * r)), np.ones(len(E))
        for _ in range(_ROUNDS):
            weighted = weights[:, None] * E
            values, vectors = np.linalg.eigh(weighted.T @ weighted / len(E))
            values = share * values + (1.0 - share) * values.mean()
            values = np.maximum(values, 1e-9 * max(float(values[-1]), 1e-300))
            away = np.sqrt(np.square(E @ (vectors / np.sqrt(values))).mean(axis=1))
            weights = np.sqrt(np.minimum(1.0, _HUBER / np.maximum(away, 1e-300)))
        # The mean square stays, for the variance factor measures that.
        whitenings[r] = math.sqrt(values.mean()) * (vectors / np.sqrt(values)) @ vectors.T
    return whitenings


def scatter_of_images(ratios: Array, equations: NDArray[np.intp]) -> float:
    """Degrees of freedom nu of the scales of images, from |E|^2 / r (N,) and r (N,).

    Blur, light and distance make corners of one image scatter more than those of another. With
    variances of inverse chi-squared, |E|^2 / r follows F(r, nu), and its logarithm has about the
    variance 2 / r + 2 / nu. The median absolute deviation measures that, bad images or not.
    """
    able = (equations >= _IMAGE) & np.isfinite(ratios) & (ratios > 0.0)
    if able.sum() < _IMAGES:
        return math.inf
    logs = np.log(ratios[able])
    variance = (_NORMAL * float(np.median(np.abs(logs - np.median(logs))))) ** 2
    further = variance - float((2.0 / equations[able]).mean())
    return 2.0 / further if further > 0.0 else math.inf


def tail(t: Array, freedom: NDArray[np.intp], denominator: float = math.inf) -> Array:
    """Probability of a chi-squared above t; 1 without freedom to test, 0 for an infinite t.

    denominator: degrees of freedom of its scale, where that was learnt: t / freedom follows F.
    """
    some = freedom > 0
    square, size = np.maximum(t, 0.0), np.where(some, freedom, 1)
    if math.isinf(denominator):
        p = np.where(some, chi_squared.tail(square, size), 1.0)
    else:
        from scipy.special import fdtrc

        p = np.where(some, fdtrc(size, denominator, square / size), 1.0)
    return np.where(np.isfinite(t), p, 0.0)


def pose_tests(problem: Problem, fit: Fitted, fitted: NDArray[np.bool_]) -> PoseTests:
    """The tests of all poses; fitted: (N,) those that took part in the fit."""
    equations = fit.equations(problem)
    k, N = problem.readings.shape
    t, freedom = np.zeros(N), np.zeros(N, dtype=np.intp)
    w, sd = np.full((k, N), np.nan), np.full((k, N), np.nan)
    shared, sharing = np.zeros(N), np.zeros(N, dtype=np.intp)
    least = np.ones(N)
    for block in equations:
        if block.E.shape[1]:
            tests = _block(block, fit, fitted[block.poses])
            t[block.poses], freedom[block.poses] = tests.t, tests.freedom
            w[:, block.poses], sd[:, block.poses] = tests.w, tests.sd
            shared[block.poses], sharing[block.poses] = tests.shared, tests.sharing
            least[block.poses] = tests.least
    hidden = np.isinf(np.broadcast_to(problem.uncertainty.sd, w.shape))
    w[hidden] = np.nan
    # Of what few images say of their places, the parameters take up as many numbers.
    said = float(max(sharing[fitted].sum() - len(fit.covariance), fitted.sum(), 1))
    places = math.inf if math.isinf(fit.denominator) else said
    scales = fit.denominator, fit.images
    return PoseTests(t, freedom, w, sd, *scales, shared, sharing, places, least)


def _block(block: PoseEquations, fit: Fitted, fitted: NDArray[np.bool_]) -> PoseTests:
    # By the root of C, in units of the sds: an image has many more equations than parameters.
    unit = np.sqrt(np.maximum(np.diag(fit.covariance), 1e-300))
    sizes, directions = np.linalg.eigh(fit.covariance / unit / unit[:, None])
    root = unit[:, None] * directions * np.sqrt(np.maximum(sizes, 0.0))
    vectors, singular, _ = np.linalg.svd(rows_times(block.D, root), full_matrices=False)
    # The eigenvalues of W: what the other poses leave to test in each direction; 1 in all others.
    # With the pose in C, 1 - D C D^T is the inverse of 1 + D C D^T without it (Woodbury).
    values = np.square(singular)
    redundancy = np.where(fitted[:, None], 1.0 - values, 1.0 / (1.0 + values))
    open_ = redundancy > UNCONTROLLED
    turned = np.einsum("brs,br->bs", vectors, block.E)
    y = np.where(open_, turned * np.where(fitted[:, None], 1.0, redundancy), 0.0)
    rest = np.maximum(np.square(block.E).sum(axis=1) - np.square(turned).sum(axis=1), 0.0)
    t = ((np.square(y) / np.where(open_, redundancy, 1.0)).sum(axis=1) + rest) / fit.factor
    X = np.swapaxes(vectors, 1, 2) @ block.X
    whole = block.squares.T
    lost = 1.0 - np.where(open_, redundancy, 0.0)
    power = whole - np.einsum("bs,bsk->kb", lost, np.square(X))
    along = np.einsum("brk,br->kb", block.X, block.E)
    along -= np.einsum("bsk,bs->kb", X, turned - y)
    possible = (power > UNCONTROLLED * whole) & (power > 0.0)
    length = np.sqrt(np.where(possible, power, 1.0))
    scale = np.sqrt(fit.factor)
    w = np.where(possible, -along / length / scale, np.nan)
    freedom = block.count - (~open_).sum(axis=1)
    shared, sharing = _shared(block, X, lost, along)
    sd = np.where(possible, scale / length, np.nan)
    shared = shared / fit.factor
    least = redundancy.min(axis=1, initial=1.0)
    return PoseTests(t, freedom, w, sd, shared=shared, sharing=sharing, least=least)


def _shared(
    block: PoseEquations, turned: Array, lost: Array, along: Array
) -> tuple[Array, NDArray[np.intp]]:
    """Chi-squared (b,) of all that the pixels of an image share, at a variance factor of 1, and its
    degrees of freedom; turned: (b, s, k) columns X along the directions of which the share lost is
    not tested, along: (k, b) X^T y."""
    if block.beside is None:
        return np.zeros(len(block.poses)), np.zeros(len(block.poses), dtype=np.intp)
    mine = ~block.beside.squares.any(axis=0) & block.X.any(axis=(0, 1))
    X, aside = block.X[:, :, mine], turned[:, :, mine]
    W = np.swapaxes(X, 1, 2) @ X - np.swapaxes(aside, 1, 2) @ (lost[:, :, None] * aside)
    # Where the image tests nothing of a column, rounding alone is on the diagonal.
    least = np.maximum(UNCONTROLLED * np.square(X).sum(axis=1), 1e-300)
    unit = np.sqrt(np.maximum(np.diagonal(W, axis1=1, axis2=2), least))
    sizes, directions = np.linalg.eigh(W / unit[:, :, None] / unit[:, None, :])
    b = np.einsum("bij,bi->bj", directions, along[mine].T / unit)
    open_ = sizes > UNCONTROLLED
    chi = np.where(open_, np.square(b) / np.where(open_, sizes, 1.0), 0.0).sum(axis=1)
    return chi, open_.sum(axis=1)


@dataclass(frozen=True)
class Trials:
    """Rows of data tried instead of those that were read: their tests, and corrections (k, V)."""

    tests: PoseTests
    corrections: Array


def try_rows(
    problem: Problem,
    fit: Fitted,
    poses: Sequence[int],
    readings: Array,
    without: NDArray[np.bool_],
) -> Trials:
    """The tests of V changed rows against a fit that they took no part in.

    poses: (V,) which pose each is a version of; readings: (k, V) [SI]; without: (k, V) readings
    taken as unmeasured, so that the loops find them. The statistic of a row whose loops do not
    close, or are too few to find what is unmeasured, is infinite.
    """
    index = np.asarray(poses, dtype=np.intp)
    rows = replace(taken(problem, index), readings=readings)
    few = np.zeros(len(index), dtype=bool)
    for pattern in left_unmeasured(rows, without).patterns:
        few[pattern.poses] = len(pattern.unmeasured) > len(pattern.loops)
    rows = left_unmeasured(rows, without & ~few)
    hidden = np.isinf(np.broadcast_to(problem.uncertainty.sd, problem.readings.shape))
    start = np.where(hidden, fit.corrections, 0.0)[:, index]
    closed = settle(rows, fit.parameters, start)
    none = np.zeros(len(index), dtype=bool)
    other = replace(fit, corrections=closed.corrections, blocks=())
    tests = pose_tests(rows, other, none)
    t = np.where(few | closed.open | ~np.isfinite(tests.t), np.inf, tests.t)
    return Trials(replace(tests, t=t), closed.corrections)


def misfit_of_rows(
    problem: Problem, fit: Fitted, poses: Sequence[int], readings: Array, without: NDArray[np.bool_]
) -> Array:
    """The statistics (V,) of rows as `try_rows`, linearised where they stand."""
    index = np.asarray(poses, dtype=np.intp)
    rows = left_unmeasured(replace(taken(problem, index), readings=readings), without)
    none = np.zeros(len(index), dtype=bool)
    held = replace(fit, corrections=np.zeros_like(readings), blocks=())
    return pose_tests(rows, held, none).t


def settle(problem: Problem, parameters: Array, start: Array) -> Closed:
    """Corrections (k, N) that close the loops at these parameters.

    Poses whose loops do not close are open, and keep the corrections they started with.
    """
    closed = Sweeper(problem).close(parameters, start, NEGLIGIBLE, 1.0)
    return replace(closed, corrections=np.where(closed.open, start, closed.corrections))
