"""How probable readings are that a fit has not seen.

Linearised where the readings stand, the misclosure of a pose has the covariance

    W + J_p Cov_p J_p^T,   W = J_x Sigma J_x^T,

W the noise of the readings, Cov_p the uncertainty of the fitted parameters. Offsets of printed
points count as parameters (`printed`). Least squares knows no Sigma; its residual variance, the
same for every loop equation, stands for W.

The covariance of poses that a fit has not seen, but whose run it has.

Where errors drift along a run (`estimation.dependence.serial`), the level of the drift is in the
parameters already: an offset of the wire moves the anchor. A pose of the same run shares that
level. In directions z of the parameters with D^T D + P = I, and u the drift, its misclosure is

    E_i = v_i + X_i u_i - D_i z,   z = -sum_j D_j^T (X_j u_j + v_j) + prior part,

over the poses j of the fit; so with A_j = X_j^T D_j and R_ij = cov(u_i, u_j)

    cov E_i = s^2 I + X_i R_ii X_i^T + D_i V D_i^T - X_i K_i D_i^T - (X_i K_i D_i^T)^T,
    V = s^2 D^T D + P + sum_jl A_j^T R_jl A_l,   K_i = sum_j R_ij A_j.

Without the last two terms level and drift would count twice, as they do for a pose of another day.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.document.findings import PrintedEntry
from loopcal.estimation.dependence.dependence import Drifting
from loopcal.estimation.dependence.seen import Errors, seen
from loopcal.estimation.fit import used_noise, weighed
from loopcal.estimation.noise.estimation import scaled
from loopcal.estimation.noise.learning import typical_sd, with_model
from loopcal.estimation.noise.linear_model import LinearModel, ModelBlock, linear_model
from loopcal.estimation.problem.constants import standing, standing_exact, with_latest
from loopcal.estimation.problem.pose_equations import pose_equations
from loopcal.estimation.problem.problem import Problem, build_problem
from loopcal.estimation.problem.starting import start_corrections
from loopcal.estimation.products import rows_times
from loopcal.estimation.result import FitResult
from loopcal.estimation.solve.gauss_newton import NEGLIGIBLE
from loopcal.estimation.solve.sweep import Sweeper
from loopcal.estimation.steps import begun_near
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise
from loopcal.mechanisms.structure.smooth import wave_errors
from loopcal.small_samples import LearntCovariance, f_limit
from loopcal.statistics.calibrated import waves_without_drift
from loopcal.statistics.printed import Offsets

if TYPE_CHECKING:
    from loopcal.estimation.dependence.image_errors import ImageErrors

# Chosen, not derived: far above rounding, far below an effect that counts.
_UNPREDICTABLE = 1e-6
"""A direction that the fit left open moves a loop, beside the largest effect of any direction."""
# The level that all pages state.
LEVEL = 0.95
"""Stated probability of a region."""


@dataclass(frozen=True)
class Held:
    """Poses a fit has not seen, at its parameters: problem.start; corrections (k, N) [SI].

    Only quantities that were not measured are corrected, to where their loops close.
    """

    problem: Problem
    corrections: Array


def held_problem(
    fit: FitResult,
    data: Dataset,
    noise: Noise | None,
    near: Mapping[str, Array] | None = None,
) -> Held:
    """The poses of a data set at the parameters and sds that a fit of others found.

    near: values (N,) [SI] from which the search for what no sensor reads begins.
    """
    mechanism = fit.mechanism
    data = with_latest(mechanism, data)
    noise = used_noise(fit.fit, mechanism, data, noise)
    if noise is not None:
        data = weighed(fit.fit, data)
        mechanism, data = with_model(mechanism, data, noise)
    # Nothing is estimated here: with informative priors any number of poses will do.
    machine = mechanism.with_parameters(mechanism.parameters.with_prior({"*": 1.0}))
    problem = build_problem(machine, data, noise, fit.value, whole=False)
    # A joint that moved in the fit has errors also where it stands still in these poses.
    readings = np.hstack([fit.problem.readings, problem.readings])
    uncertainty = standing_exact(machine, readings, problem.uncertainty)
    problem = replace(problem, prior_sd=fit.problem.prior_sd, uncertainty=uncertainty)
    if noise is not None and noise.estimate:
        each = range(len(problem.readings))
        problem = scaled(problem, [(i,) for i in each], _ratios(fit.problem, problem))
    if near:
        problem = begun_near(problem, near)
    return Held(problem, unmeasured_corrections(problem, problem.start))


def unmeasured_corrections(problem: Problem, parameters: Array) -> Array:
    """Corrections (k, N) [SI] of what no sensor reads, to where the loops close; else zero.

    parameters: (n_all,).
    """
    corrections = np.zeros_like(problem.readings)
    if not any(pattern.unmeasured for pattern in problem.patterns):
        return corrections
    sweeper = Sweeper(problem)
    begun = start_corrections(sweeper, parameters)
    closed = sweeper.close(parameters, begun, NEGLIGIBLE, 1.0).corrections
    for pattern in problem.patterns:
        for row in pattern.unmeasured:
            corrections[row, pattern.poses] = closed[row, pattern.poses]
    return corrections


def _ratios(learnt: Problem, stated: Problem) -> Array:
    """(k,) by how much larger variances are learnt than stated, where poses have the reading.

    Of a joint that stood still in the fit nothing was learnt.
    """
    ratios = np.ones(len(stated.readings))
    still = standing(learnt.mechanism, learnt.readings)
    for i in np.setdiff1d(np.arange(len(ratios)), still):
        before, after = typical_sd(stated, i), typical_sd(learnt, i)
        if before and after is not None:
            ratios[i] = (after / before) ** 2
    return ratios


@dataclass(frozen=True)
class Predictive:
    """What a fit stated of the misclosures of poses that it has not seen, and what they were.

    log_density (N,): log N(misclosure; 0, W + J Cov_p J^T); zero for a pose without loops,
    None where the poses also say where the instrument stands. squares
    (N,): misclosure^2 over that covariance, F-distributed but for a factor with `loops` (N,) and
    `denominator` (N,) degrees of freedom.
    """

    log_density: Array | None
    squares: Array
    loops: NDArray[np.intp]
    denominator: Array

    def inside(self, level: float = LEVEL) -> Array:
        """(N,) 1 where the measured point lies in its stated region, 0 outside, NaN without one."""
        inside = np.full(len(self.squares), np.nan)
        for loops in np.unique(self.loops[self.loops > 0]):
            at = self.loops == loops
            inside[at] = self.squares[at] <= f_limit(level, int(loops), self.denominator[at])
        return inside


def predictive(
    fit: FitResult, held: Held, drifting: Drifting | None = None, run: Run | None = None
) -> Predictive | None:
    """What the fit stated of these poses; None where their misclosures have no density.

    drifting: the drift that its covariance allows for; run: where the poses stand in its run, None
    for another one.
    """
    problem, offsets, shared = held.problem, None, None
    if fit.printed is not None:
        problem = _with_points(problem, fit.printed)
        offsets = Offsets.of(fit.printed, problem.names, fit.estimated)
    if drifting is not None and run is not None:
        shared = SameRun.of(fit, problem, held.corrections, drifting, run)
    learnt = () if shared is not None else fit.learnt_noise
    waves = () if shared is not None or drifting is not None else waves_without_drift(fit)
    x = dict(
        zip(problem.mechanism.tape.quantities, problem.readings + held.corrections, strict=True)
    )
    images, unit_variance = fit.image_errors, 0.0
    if images is None:
        model = linear_model(problem, problem.start, held.corrections, [c for c, _ in learnt])
    else:
        model = _with_shared(problem, held.corrections, images)
        unit_variance = images.sd**2
    if fit.fit.solver.exact and images is None:
        variance = fit.fit.solver.unit_variance(fit.information.chi_squared, fit.freedom)
        if variance is None:
            return None
        unit_variance = variance
    system = fit.spectrum
    free = system.scale[:, None] * system.directions[:, ~system.kept]
    limit = _UNPREDICTABLE * float(system.singular_values.max(initial=0.0))
    scale = math.sqrt(unit_variance) if unit_variance else 1.0
    density, squares = np.zeros((2, len(problem.poses)))
    loops = np.zeros(len(problem.poses), dtype=np.intp)
    denominator = np.full(len(problem.poses), math.inf)
    for (_, poses), block in zip(problem.blocks(), model.blocks, strict=True):
        r, beside, alone = block.e.shape[1], np.zeros(()), block.J
        W = block.fixed + block.G @ np.swapaxes(block.G, -1, -2) + unit_variance * np.eye(r)
        if offsets is not None:
            JR = rows_times(block.J, offsets.root)
            beside = JR @ np.swapaxes(JR, -1, -2)
            block = block.by(rows_times(block.J, offsets.carried[:, : len(fit.estimated)]))
        if shared is not None:
            noise = np.broadcast_to(np.eye(r), W.shape) if unit_variance else W
            total = LearntCovariance.certain(
                shared.covariance(np.arange(len(problem.poses))[poses], noise, block.J)
            )
        else:
            covariance = fit.covariance_through(block.J, drifting)
            slopes = np.zeros((len(covariance.slopes), *W.shape))
            if unit_variance and len(slopes):
                # A variance from nu residuals has the relative sd sqrt(2 / nu).
                if images is None:
                    slopes += math.sqrt(2.0 / fit.freedom) * W
                else:  # the variance of single pixels comes from thousands of them
                    slopes += math.sqrt(2.0 / images.freedom) * block.fixed
            elif len(slopes):
                for j, (_, relative) in enumerate(learnt):
                    G = block.G[:, :, block.owner == j]
                    slopes += np.multiply.outer(relative, G @ np.swapaxes(G, -1, -2))
            total = covariance.plus(LearntCovariance(W + beside, W + beside, slopes))
            at = {q: row[poses] for q, row in x.items()}
            changed = wave_errors(waves, alone, block.J, at, fit.estimated).changed
            total = replace(total, matrix=total.matrix + changed)
        densities = _densities(block, W, total.matrix, free, limit / scale)
        if densities is None:
            return None
        # Rows of an image on which nothing acts but the corners' noise, and the division by it.
        spare = block.equations - r
        aside = spare * math.log(2.0 * math.pi * (unit_variance or 1.0)) + block.scale
        density[poses], squares[poses] = densities[0] - 0.5 * aside, densities[1]
        loops[poses], denominator[poses] = block.equations, total.denominator
    return Predictive(density, squares, loops, denominator)


def _with_points(problem: Problem, printed: PrintedEntry) -> Problem:
    """The same with the offsets of points of prints among what is estimated."""
    place = {name: i for i, name in enumerate(problem.mechanism.parameters.names)}
    rows = np.array([place[name] for name in printed.names], dtype=np.intp)
    return replace(
        problem,
        free=np.concatenate([problem.free, rows]),
        nominal=np.concatenate([problem.nominal, problem.start[rows]]),
        prior_sd=np.concatenate([problem.prior_sd, printed.prior]),
    )


def _with_shared(problem: Problem, corrections: Array, images: ImageErrors) -> LinearModel:
    """The model of images with what all pixels of one share; its rows vary by what is beside it."""
    blocks = []
    for block in pose_equations(problem, problem.start, corrections, images.factor):
        rows = np.concatenate([block.D, block.E[:, :, None]], axis=2)
        nothing, owner = np.zeros((*block.E.shape, 0)), np.zeros(0, dtype=np.intp)
        spare = (block.count - block.E.shape[1])[:, None]
        blocks.append(ModelBlock(rows, images.shared(block), nothing, owner, spare))
    unused = np.zeros(len(problem.free))
    return LinearModel(tuple(blocks), unused, unused, np.zeros(0))


def _densities(
    block: ModelBlock, W: Array, covariance: Array, free: Array, limit: float
) -> tuple[Array, Array] | None:
    """Log densities and squares of the poses of a block, whose own noise is W (b, r, r)."""
    r = block.e.shape[1]
    try:
        L = np.linalg.cholesky(W)
        if np.any(np.abs(np.linalg.solve(L, block.J @ free)) > limit):
            return None  # the fit cannot say where these loops are
        L = np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError:
        return None  # a loop without any uncertainty
    z = np.linalg.solve(L, block.e[:, :, None])[:, :, 0]
    # log |C| = 2 sum log L_rr: half of it.
    volume = np.log(np.einsum("brr->br", L)).sum(axis=1)
    squares: Array = np.square(z).sum(axis=1)
    density: Array = -0.5 * squares - volume - 0.5 * r * math.log(2.0 * math.pi)
    return density, squares


Positions = NDArray[np.intp]
# The correlations of 3000 poses by pairs take 72 MB.
_MOST = 3000
"""Poses of a run whose correlations are computed pair by pair."""


@dataclass(frozen=True)
class Run:
    """Positions in one run: fitted (N,) of the poses of a fit, held (n,) of those it predicts."""

    fitted: Positions
    held: Positions

    def ordered(self, fit: Problem, held: Problem) -> Run:
        """Numbers in the order of measuring: by the known time if there is one, else as given."""
        times = [i for i, unit in enumerate(fit.mechanism.pose_constants.values()) if unit == "s"]
        when = np.concatenate([self.fitted, self.held]).astype(float)
        if len(times) == 1:
            when = np.concatenate([fit.pose_constants[times[0]], held.pose_constants[times[0]]])
        # Twice gives ranks; stable, so that equal times stay in the order of the rows.
        number = np.argsort(np.argsort(when, kind="stable"), kind="stable")
        return Run(number[: len(self.fitted)], number[len(self.fitted) :])


@dataclass(frozen=True, eq=False)
class SameRun:
    """What poses of the same run share with a fit.

    white: variance of an equation; level: of a drifting reading in units of its sd; V (k, k),
    K (n, q, k), X (n, R, q) whitened; root (m, k).
    """

    white: float
    level: float
    V: Array
    K: Array
    X: Array
    root: Array

    @classmethod
    def of(
        cls, fit: FitResult, held: Problem, corrections: Array, drifting: Drifting, run: Run
    ) -> SameRun | None:
        """Of poses that a fit has not seen; None where they are too many, or images."""
        problem, solution = fit.problem, fit.solution
        if len(run.fitted) != len(problem.poses) or len(run.fitted) > _MOST:
            return None
        if any(pattern.predicted for pattern in held.patterns):
            return None  # the equations of images are turned by themselves
        run, drift, root = run.ordered(problem, held), drifting.drift, solution.spectrum.root
        A = seen(problem, fit.pose_equations(), root, drifting.readings).A
        N, q, k = A.shape
        P = root.T @ (problem.precision[:, None] * root)
        flat = A.reshape(N, q * k)
        along = (_kernel(drift.lengths, drift.sizes, run.fitted, run.fitted) @ flat).reshape(-1, k)
        K = _kernel(drift.lengths, drift.sizes, run.held, run.fitted) @ flat
        return cls(
            drift.white,
            float(drift.sizes.sum()),
            # D^T D = I - P in these directions.
            drift.white * (np.eye(k) - P) + P + A.reshape(-1, k).T @ along,
            K.reshape(-1, q, k),
            _effects(fit, held, corrections, drifting.readings),
            root,
        )

    def covariance(self, poses: Positions, W: Array, J: Array) -> Array:
        """(b, r, r) of the misclosures of these poses.

        W (b, r, r): their noise at the sds of the fit; J (b, r, m): derivatives by parameters.
        """
        D, r = rows_times(J, self.root), W.shape[1]
        # W = L L^T: L takes the whitened effects back to the units of the misclosures.
        X = np.linalg.cholesky(W) @ self.X[poses, :r]
        shared = X @ self.K[poses] @ np.swapaxes(D, -1, -2)
        noise = self.white * W + self.level * X @ np.swapaxes(X, -1, -2)
        fitted = rows_times(D, self.V) @ np.swapaxes(D, -1, -2)
        return noise + fitted - shared - np.swapaxes(shared, -1, -2)


def _kernel(lengths: Array, sizes: Array, rows: Positions, columns: Positions) -> Array:
    """cov(u_i, u_j) of poses with these numbers."""
    apart = np.abs(rows[:, None] - columns[None, :]).astype(float)
    kernel: Array = np.zeros_like(apart)
    # AR(1) of several lengths (record 0050); poses apart by d correlate as exp(-d / length).
    for length, size in zip(lengths.tolist(), sizes.tolist(), strict=True):
        if size > 0.0:
            kernel += size * np.exp(-apart / length)
    return kernel


def _effects(fit: FitResult, held: Problem, corrections: Array, readings: tuple[str, ...]) -> Array:
    """(n, R, q) what an error of one sd of these readings does to the whitened equations."""
    errors = Errors.of(fit.problem, readings)
    equations = pose_equations(held, held.start, corrections)
    most = max((block.E.shape[1] for block in equations), default=0)
    effects = np.zeros((len(held.poses), most, errors.modes.shape[1]))
    for block in equations:
        # What was not read carries no drift.
        effects[block.poses, : block.E.shape[1]] = errors.effects(held, block)
    return effects
