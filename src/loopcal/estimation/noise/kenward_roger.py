"""What learning the variances adds to the covariance of the parameters.

Phi = H^-1, H = sum J^T V^-1 J + prior, is the covariance of the parameters at known variances. At
variance ratios learnt from the same readings, with the covariance W,

    Phi + 2 Lambda,   Lambda = sum_ij W_ij X_i^T P X_j,   X_j = V_j V^-1 J Phi,
    P = V^-1 - V^-1 J Phi J^T V^-1

(Kenward and Roger 1997): the estimates move with the ratios, by Lambda, and Phi at the estimated
ratios is too small on average, by Lambda again. Prior terms are further rows of J, so parameters
with a prior take part as random effects. dPhi/ds_j = Phi M_j Phi with M_j = J^T V^-1 V_j V^-1 J
are the slopes that Student's t needs (`loopcal.small_samples`).

The rows of a term's parameters in the prior are loadings of the term's variance. W is the inverse
of the information, ratios at zero included: there by chance, they are as unsure as others. No ratio
is more unsure than the whole noise would be, were it all this component's. The parameters of a term
share their sd only roughly: what poses of one region say of it holds for another to a factor
exp(+- `ELSEWHERE`), however many these poses are.

All is done in directions z, dp = root z, in which H is the identity: with Z_j = root^T M_j root and
the products of the rows of two components, Q_jk = root^T J^T V^-1 V_j V^-1 V_k V^-1 J root,

    Lambda = root (sum_jk W_jk (Q_jk - Z_j Z_k)) root^T,

which no pose adds to. Where one factor is common to all noise, the sums of the fit say these too.

What a smooth discrepancy of a few waves cannot follow, as an error that neighbours share.

The discrepancy is a sum of the waves of largest weight (`mechanisms.structure.smooth`). The waves
that follow are errors of the machine too. To the fit they are noise, but alike in neighbouring
poses, so that they do not average out: far from the measured poses the fit is less sure than
independent errors would make it. With E = D z + v, D^T D + P = I, and Z the rows of the waves that
follow, of amplitudes tau b, b ~ N(0, I),

    E = D z + Z tau b + v,   cov v = sigma^2 I,   cov z = P + sigma^2 H + tau^2 B B^T,

H = D^T D, B = D^T Z: a sandwich with the covariance of these errors inside. The fit's residuals
e = Q E, Q = I - D D^T, with what the prior leaves of them, have the moments

    E e^T e     = sigma^2 tr Q^2      + tau^2 tr Z^T Q^2 Z + tr P H,
    E |Z^T e|^2 = sigma^2 tr Z^T Q^2 Z + tau^2 tr C^2      + tr B^T P B,   C = Z^T Z - B^T B,

from which sigma^2 and tau^2 follow; tau^2 is taken as 0 where it comes out below.

Source: Rao (1971), estimation of variance components by quadratic forms.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.estimation.dependence.joint_waves import joint_waves
from loopcal.estimation.dependence.pose_errors import PoseErrors, pose_errors
from loopcal.estimation.dependence.seen import Seen
from loopcal.estimation.noise.linear_model import projected
from loopcal.estimation.noise.variances import owners
from loopcal.estimation.problem.pose_equations import PoseEquations
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.products import rows_times
from loopcal.lazy import cached_property
from loopcal.mechanisms.structure.smooth import FurtherWaves, Smooth
from loopcal.small_samples import LearntCovariance

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from loopcal.estimation.noise.estimation import NoiseEstimate
    from loopcal.estimation.problem.pose_equations import PoseEquations


# Chosen, not derived: a variance that the data leave open must not make all others unsure.
_WIDEST = 3.0
"""Sd of a ratio, at most, in units of the one that would explain all noise."""
# Of a matrix with ones on its diagonal: no direction is a thousand times as unsure as alone.
# Chosen, not derived.
_RIDGE = 1e-6
# docs/decisions/0049.
ELSEWHERE = 0.5
"""Sd of the natural logarithm by which the sd of a term differs from one region to another."""
# Satterthwaite (1946): 2 / share^2 degrees of freedom, here 2,200.
_CERTAIN = 0.03
"""A change of the variances by less than this share leaves thousands of degrees of freedom."""


@dataclass(frozen=True, eq=False)
class LearntParameters:
    """What learning the variances means for the parameters, in the directions of `root`.

    root: (n, k), H^-1 = root root^T; errors: (c + t, a) changes of each sensor's variance ratio and
    of each term's log variance along each independent error; relative: (c, a) those of sensors as
    shares of their variances, where ratios at zero are held there; sensors: (c, k, k) = Z_j of
    sensors; loadings: those of the terms, Z_j = loading^T loading; added: (k, k) what the
    covariance of z gains by it; shared: (k, k) what it gains by errors that neighbouring poses
    share, None without any; alike: the same of stated poses, or of joints seen by cameras, and how
    that changes by one sd of it, along the last of `errors`; waves: those that `shared` has.
    """

    root: Array
    errors: Array
    relative: Array
    sensors: Array
    loadings: tuple[Array, ...]
    added: Array
    shared: Array | None = None
    alike: PoseErrors | None = None
    waves: tuple[FurtherWaves, ...] = ()

    @property
    def gained(self) -> Array:
        """(k, k) all that the covariance of z gains."""
        gained = self.added if self.shared is None else self.added + self.shared
        return gained if self.alike is None else gained + self.alike.gained

    @cached_property
    def plain(self) -> Array:
        """(n, n) covariance of the parameters as if the variances were known."""
        return np.asarray(self.root @ self.root.T)

    @cached_property
    def matrix(self) -> Array:
        """(n, n) covariance of the parameters."""
        return np.asarray(self.plain + self.root @ self.gained @ self.root.T)

    @cached_property
    def covariance(self) -> LearntCovariance:
        """The covariance of the parameters, and how sure it is itself."""
        first = np.concatenate([self.sensors, *((u.T @ u)[None] for u in self.loadings)])
        along = np.tensordot(self.errors.T, first, 1)
        if self.alike is not None:
            along[-1] = self.alike.slope
        return LearntCovariance(self.matrix, self.plain, self.root @ along @ self.root.T)

    def through(self, S: Array) -> LearntCovariance:
        """Of S times the parameters, S (N, m, n); cheaper than by `covariance`."""
        R = rows_times(S, self.root)
        turned = np.swapaxes(R, -1, -2)
        plain = R @ turned
        parts = [rows_times(R, sensor) @ turned for sensor in self.sensors]
        for loading in self.loadings:
            T = rows_times(R, loading.T)
            parts.append(T @ np.swapaxes(T, -1, -2))
        slopes = np.tensordot(self.errors.T, np.array(parts).reshape(len(parts), *plain.shape), 1)
        if self.alike is not None:
            slopes[-1] = rows_times(R, self.alike.slope) @ turned
        added = rows_times(R, self.gained) @ turned
        return LearntCovariance(plain + added, plain, slopes)


@dataclass(frozen=True, eq=False)
class _Term:
    """The estimated parameters of a term, and what is known beforehand of its log variance."""

    index: NDArray[np.intp]
    precision: float


@dataclass(frozen=True, eq=False)
class _Sensors:
    """What the readings say of c sensor components, in directions z.

    root: (n, k); first: (c, k, k) = Z_j; ratios: (c,) learnt ones; information: (c, c) on them;
    second: sum_jk W_jk Q_jk, (k, k), of a symmetric W (c, c).
    """

    root: Array
    first: Array
    ratios: Array
    information: Array
    second: Callable[[Array], Array]


def learnt_parameters(
    estimate: NoiseEstimate, equations: Sequence[PoseEquations] = ()
) -> LearntParameters:
    """The covariance of the parameters at learnt variances of sensors and terms.

    Over the directions that data and prior determine; with what neighbouring poses share, where the
    equations of the poses are given.
    """
    owner, stated = owners(estimate.problem), estimate.problem.mechanism.learnt_terms
    # A log variance has twice the sd of a log sd: precision 1 / (2 spread)^2.
    terms = [
        _Term(np.flatnonzero(owner == i), 0.25 / term.spread**2) for i, term in enumerate(stated)
    ]
    prior = 1.0 / estimate.problem.prior_sd
    learnt = estimate.variances
    sensors = _by_sums(estimate, prior) if learnt.by_sums else _by_pose(estimate)
    U = [prior[term.index, None] * sensors.root[term.index] for term in terms]
    first = np.concatenate([sensors.first, *((u.T @ u)[None] for u in U)])
    errors = _errors(sensors, first, terms)
    along = np.tensordot(errors.T, first, 1)
    matters = np.linalg.norm(along, axis=(1, 2)) > _CERTAIN
    relative = _relative(errors, sensors.ratios)[:, matters]
    errors, along = errors[:, matters], along[matters]
    c, W = len(sensors.ratios), errors @ errors.T
    added = sensors.second(W[:c, :c])
    # The prior rows of a term are in no other term, and V_j = V there: Q_jj = Z_j, Q_jk = 0.
    added += np.tensordot(np.diag(W)[c:], first[c:], 1)
    # W = errors errors^T turns sum_jk W_jk Z_j Z_k into a sum of squares along the errors.
    flat = along.reshape(-1, len(added))
    added -= flat.T @ flat
    at, root = estimate.solution, sensors.root
    where = estimate.problem, at.parameters, equations, root
    alike = pose_errors(*where) or joint_waves(*where)
    if alike is not None:  # the last error is that of what poses share
        errors, relative = (np.pad(one, ((0, 0), (0, 1))) for one in (errors, relative))
    by_waves = gains_by_waves(estimate.problem, at.corrections, equations, root)
    prints = None if estimate.prints is None else estimate.prints.gained(root)
    shares = [one.matrix for one in by_waves] + ([] if prints is None else [prints])
    return LearntParameters(
        root,
        errors,
        relative,
        sensors.first,
        tuple(U),
        2.0 * added,
        sum(shares[1:], shares[0]) if shares else None,
        alike,
        tuple(one.waves for one in by_waves),
    )


def _relative(errors: Array, ratios: Array) -> Array:
    """(c, a) changes of the sensors' variances along each independent error, as shares of them.

    A variance at zero has no share to change by. What it could take from others is theirs: what
    their errors have in common with its own is left out, which is as if it were known.
    """
    of_sensors, zero = errors[: len(ratios)], ratios <= 0.0
    alone = of_sensors - of_sensors @ np.linalg.pinv(of_sensors[zero]) @ of_sensors[zero]
    return np.asarray(alone / np.where(zero, 1.0, ratios)[:, None])


def _by_sums(estimate: NoiseEstimate, prior: Array) -> _Sensors:
    """Of one factor of all noise, or of none: V_0 = V / s, so all is the share of the readings."""
    root, ratios = estimate.solution.spectrum.root, estimate.variances.ratios
    informed = prior[:, None] * root
    share = np.eye(root.shape[1]) - informed.T @ informed
    each = 1.0 / ratios
    first = np.multiply.outer(each, share)
    # tr (1 - D D^T)^2 with share = D^T D: the information on the log variance is half of it.
    count = estimate.solution.equations - 2.0 * np.trace(share) + np.square(share).sum()
    information = 0.5 * count * np.outer(each, each)
    return _Sensors(root, first, ratios, information, lambda W: float(each @ W @ each) * share)


def _by_pose(estimate: NoiseEstimate) -> _Sensors:
    """Of any components, from the rows of all poses."""
    ratios = estimate.ratios
    at = projected(estimate.model, ratios)
    assert at is not None  # the estimate was made there
    return _Sensors(at.root, at.first, ratios, at.information, at.second)


def _errors(sensors: _Sensors, first: Array, terms: Sequence[_Term]) -> Array:
    """A root (c + t, c + t) of the covariance W of ratios and log variances of terms."""
    c = len(sensors.ratios)
    flat = first.reshape(len(first), int(np.prod(first.shape[1:])))
    information = 0.5 * flat @ flat.T
    information[:c, :c] = sensors.information
    for j, term in enumerate(terms, c):
        # tr (1 - Z)^2 = len - 2 tr Z + tr Z^2; the products above hold the last part already.
        term_information = 0.5 * (len(term.index) - 2.0 * np.trace(first[j]))
        information[j, j] += term_information + term.precision
        # 1 / information[j, j] grows by (2 ELSEWHERE)^2, the variance of a log variance.
        alike = 1.0 / math.hypot(1.0, 2.0 * ELSEWHERE * math.sqrt(max(information[j, j], 0.0)))
        information[j] *= alike
        information[:, j] *= alike
    size = np.sqrt(np.maximum(np.diag(information), 0.0))
    shown = size > 0.0
    scale = np.where(shown, size, 1.0)
    widest = _WIDEST * max(float((sensors.ratios * size[:c]).sum()), 1.0)
    flattest = np.where(np.arange(len(size)) < c, widest**-2, 0.0)
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale) + np.diag(flattest))
    root = vectors / np.sqrt(np.maximum(values, _RIDGE))
    errors: Array = np.where(shown, 1.0 / scale, 0.0)[:, None] * root
    # No variance is below zero: what two share goes no further than to where one of them vanishes.
    present = sensors.ratios > 0.0
    shares = np.abs(errors[:c][present] / sensors.ratios[present, None])
    errors /= np.maximum(shares.max(axis=0, initial=0.0), 1.0)
    return errors


# docs/decisions/0049.
_MOST = 60
"""Vectors k of the discrepancy and of the waves that follow, together."""


class GainByWaves(NamedTuple):
    """waves: those that the discrepancy of a body leaves out; matrix: (k, k) what the covariance
    of z gains by them, tau^2 B B^T + (sigma^2 - 1) H."""

    waves: FurtherWaves
    matrix: Array


def gains_by_waves(
    problem: Problem, corrections: Array, equations: Sequence[PoseEquations], root: Array
) -> tuple[GainByWaves, ...]:
    """By the waves that the discrepancies leave out, by body.

    equations: of the poses where the fit ended; root: (n, k), dp = root z. None without a
    discrepancy or equations, where a loop joins two poses, and where no such waves are seen.
    """
    structure = problem.mechanism.structure
    if structure is None or any(v.first is not None for v in problem.mechanism.variables):
        return ()
    each = (_of_body(problem, corrections, equations, root, s) for s in structure.smooth.values())
    return tuple(one for one in each if one is not None)


def _of_body(
    problem: Problem,
    corrections: Array,
    equations: Sequence[PoseEquations],
    root: Array,
    smooth: Smooth,
) -> GainByWaves | None:
    following = smooth.following(_MOST)
    axes = len(smooth.columns(problem.names))
    if not following.harmonics or not axes or not equations:
        return None
    names = problem.mechanism.tape.quantities
    readings = {q: problem.readings[i] + corrections[i] for i, q in enumerate(names)}
    further = np.array(following.features(readings))
    N, k = len(problem.poses), root.shape[1]
    y, A, M = np.zeros((N, axes)), np.zeros((N, axes, k)), np.zeros((N, axes, axes))
    square, count = 0.0, 0
    for block in equations:
        some = {q: row[block.poses] for q, row in readings.items()}
        X = smooth.shifted(block.D, some, problem.names).transpose(0, 2, 1)
        y[block.poses] = np.einsum("bqr,br->bq", X, block.E)
        A[block.poses] = rows_times(X @ block.D, root)
        M[block.poses] = X @ np.swapaxes(X, 1, 2)
        square, count = square + float(np.square(block.E).sum()), count + int(block.count.sum())
    informed = root / problem.prior_sd[:, None]
    H = np.eye(k) - informed.T @ informed
    sums = _Sums.of(Seen(y, A, M), further.T)
    gained = _gained(sums, H, square, count)
    if gained is None:
        return None
    waves = FurtherWaves(smooth, gained.sd, gained.sd * root @ sums.B)
    return GainByWaves(waves, gained.matrix)


@dataclass(frozen=True)
class _Sums:
    """Over all poses: B = D^T Z (k, w), ZZ = Z^T Z (w, w) and seen = Z^T E (w,)."""

    B: Array
    ZZ: Array
    seen: Array

    @classmethod
    def of(cls, shifts: Seen, G: Array) -> _Sums:
        """Of poses as shifts of the body see them, and waves G (N, f): Z = X G, axis by axis."""
        q, f = shifts.y.shape[1], G.shape[1]
        ZZ = np.zeros((q, f, q, f))
        for a, b in combinations_with_replacement(range(q), 2):
            ZZ[a, :, b] = (G * shifts.M[:, a, b, None]).T @ G
            ZZ[b, :, a] = ZZ[a, :, b]
        B = np.concatenate([shifts.A[:, a].T @ G for a in range(q)], axis=1)
        return cls(B, ZZ.reshape(q * f, q * f), (shifts.y.T @ G).ravel())


class _Gained(NamedTuple):
    """matrix: (k, k) what the covariance of z gains; sd: tau."""

    matrix: Array
    sd: float


def _gained(sums: _Sums, H: Array, square: float, count: int) -> _Gained | None:
    """square: E^T E of so many equations."""
    B = sums.B
    BB, HB = B.T @ B, H @ B
    C = sums.ZZ - BB
    cross = float(np.trace(sums.ZZ) - 2.0 * np.trace(BB) + np.sum(B * HB))
    trace, squares = float(np.trace(H)), float(np.sum(H * H))
    system = np.array([[count - 2.0 * trace + squares, cross], [cross, float(np.sum(C * C))]])
    moments = [
        square - (trace - squares),
        float(sums.seen @ sums.seen) - float(np.trace(BB) - np.sum(B * HB)),
    ]
    white, waves = np.linalg.solve(system, moments)
    if not (waves > 0.0 and white > 0.0):
        return None
    # P + H = 1 holds H at variance 1 already, so only the difference is gained.
    return _Gained(waves * (B @ B.T) + (white - 1.0) * H, math.sqrt(waves))
