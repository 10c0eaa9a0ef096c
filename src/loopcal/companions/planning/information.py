"""What each candidate pose would say of the parameters, in coordinates that suit all of them.

The rows of a pose are its whitened equations D (r, n), those that calibration itself uses. With
M = sum over all candidates D^T D + poses already measured + prior = (root root^T)^-1, z is the
step dp = root z; directions that nothing determines are left out. In z a set of poses has the
information M_0 + sum Z_i^T Z_i, Z_i = D_i root. With C the inverse of that sum, the covariance of
the parameters is root C root^T.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array, span
from loopcal.estimation.cameras.at_board import sight_of
from loopcal.estimation.problem.pose_equations import pose_equations
from loopcal.estimation.problem.problem import Problem, Weighting
from loopcal.estimation.problem.starting import start_corrections
from loopcal.estimation.sensitivity import output_sensitivity
from loopcal.estimation.solve.reduction import Accumulator, spectrum
from loopcal.estimation.solve.sweep import NEAR, Sweeper
from loopcal.lazy import cached_property
from loopcal.mechanisms.mechanism import PIXELS, Mechanism
from loopcal.mechanisms.outputs import POLAR, Seen, cartesian_slopes, distance_unit, seen_outputs

# Small beside any information that counts, large beside rounding of sums: inverses exist.
RIDGE = 1e-7
"""Information of one average candidate times this stands in where nothing else does."""
_ROWS = 20_000
"""Poses whose rows are triangulated at once."""
_NULL = 1e-9


@dataclass(frozen=True, eq=False)
class Information:
    """What candidates say at one draw of the parameters.

    rows: (N, r, k) of the candidates; start: (k, k) of the prior, of poses already measured and
    of the ridge; tests: (T, o, k) how the end point moves at T poses [SI]; root: (n, k) [SI];
    nuisance: (k, s) directions that move no parameter of interest; interest: (n,) which do count;
    ridge: the part of `start` that is no information; white: rms [SI] by which the model error of
    single poses moves the end point, which no calibration lowers.
    """

    rows: Array
    start: Array
    tests: Array
    root: Array
    nuisance: Array
    interest: NDArray[np.bool_]
    ridge: float
    white: float = 0.0

    def of(self, chosen: NDArray[np.intp] | list[int]) -> Array:
        """Information (k, k) of these candidates and the start."""
        some = self.rows[chosen].reshape(-1, self.rows.shape[2])
        return self.start + some.T @ some

    def without(self, parameters: NDArray[np.bool_]) -> Information:
        """The same where these parameters (n,) are known, at the same candidates."""
        basis = _unmoved(self.root[parameters])
        root = self.root @ basis
        return replace(
            self,
            rows=self.rows @ basis,
            start=basis.T @ self.start @ basis,
            tests=self.tests @ basis,
            root=root,
            nuisance=_unmoved(root[self.interest]),
        )

    @cached_property
    def mean_test(self) -> Array:
        """(k, k) mean over the test poses of T^T T: tr(C G) is the mean variance."""
        flat = self.tests.reshape(-1, self.tests.shape[2])
        return flat.T @ flat / len(self.tests)

    @cached_property
    def relative(self) -> Array:
        """(k, k): tr(C G) adds up the variances of parameters, each in units of that after all
        candidates were measured."""
        interest_root = self.root[self.interest]
        # root root^T is the covariance after all candidates, so its row norms are those sds.
        least = np.sqrt(np.square(interest_root).sum(axis=1))
        scaled = interest_root[least > 0.0] / least[least > 0.0, None]
        total: Array = scaled.T @ scaled
        return total


def rows_of(problem: Problem, parameters: Array, corrections: Array) -> Array:
    """Whitened equations (N, r, n) of every pose [1/SI]; rows that a pose lacks are zero."""
    parts = pose_equations(problem, parameters, corrections)
    most = max((part.D.shape[1] for part in parts), default=0)
    rows = np.zeros((problem.count, most, len(problem.free)))
    for part in parts:
        rows[part.poses, : part.D.shape[1]] = part.D
    return np.nan_to_num(rows, nan=0.0, posinf=0.0, neginf=0.0)


def end_point_rows(problem: Problem, parameters: Array, x: Array, pose_constants: Array) -> Array:
    """How the end point moves with the parameters at closed poses x (k, T): (T, o, n) [SI].

    Lengths where any instrument sees a point, its range and angles as coordinates; else angles. Of
    images it is where they put the board.
    """
    mechanism = problem.mechanism
    names = mechanism.tape.quantities
    still = (*mechanism.disturbances, *mechanism.unused)
    sds = np.broadcast_to(problem.uncertainty.sd, (len(names), problem.count))
    unread = [i for i, sd in enumerate(sds) if np.isinf(sd).all() and names[i] not in still]
    S = output_sensitivity(
        mechanism, parameters, problem.names, x, pose_constants, unread
    ).by_parameter
    parts, seen = [], []
    for one in _seen(mechanism):
        outputs = [q for q in (one.position or one.turns) if q in mechanism.outputs]
        part = S[:, [mechanism.outputs.index(q) for q in outputs]]
        if _by_image(mechanism, one):
            sight = sight_of(mechanism, one.instrument, parameters, x, pose_constants)
            part = sight.slopes[:, :, : S.shape[1]] @ np.nan_to_num(S)
        elif one.form in POLAR:
            at = x[[mechanism.tape.quantities.index(q) for q in outputs]]
            part = cartesian_slopes(at) @ part
        # A board is judged where an image shows it.
        lost = np.isinf(sds[[names.index(q) for q in outputs]]).all(axis=0)
        shown = np.asarray(~lost | lost.all())
        parts.append(np.where(shown[:, None, None], part, 0.0))
        seen.append(shown)
    # Several seen points count as their mean square, so their number does not change the criterion.
    count = np.maximum(np.sum(seen, axis=0), 1)
    rows = np.concatenate(parts, axis=1) / np.sqrt(count)[:, None, None]
    finite: Array = rows[np.isfinite(rows).all(axis=(1, 2))]
    return finite


def end_point_unit(mechanism: Mechanism) -> str:
    """SI unit of the rows of `end_point_rows`."""
    by_image = any(_by_image(mechanism, one) for one in _seen(mechanism))
    return "m" if by_image else distance_unit(mechanism)


def _by_image(mechanism: Mechanism, one: Seen) -> bool:
    return one.form == PIXELS and mechanism.body is not None


def white_error(problem: Problem) -> float:
    """Rms [SI] by which the model error of single poses moves the end point; 0 without any."""
    mechanism = problem.mechanism
    rows = [mechanism.tape.quantities.index(q) for q in mechanism.disturbances]
    seen = _seen(mechanism)
    if not rows or not seen:
        return 0.0
    sds = np.broadcast_to(problem.uncertainty.sd, problem.readings.shape)[rows]
    # One sd for all coordinates, of which each seen point has so many.
    count = sum(len(one.position or one.turns) for one in seen) / len(seen)
    return float(np.sqrt(count * np.square(sds).mean()))


def _seen(mechanism: Mechanism) -> list[Seen]:
    """The points that instruments see, where none sees any the turns."""
    seen = [one for one in seen_outputs(mechanism) if one.position or one.turns]
    return [one for one in seen if one.position] or seen


def placed_anew(tests: Array, stands: NDArray[np.bool_]) -> Array:
    """How the end point moves (T, o, n) beside what placing the instruments anew makes up for.

    The machine's own parameters may trade against the placement without harm to its accuracy; what
    is left depends on no choice of the base frame. stands: (n,) the parameters of placements.
    """
    flat = tests.reshape(-1, tests.shape[2])
    U = span(flat[:, stands], _NULL)
    flat = flat - U @ (U.T @ flat)
    return np.where(stands, 0.0, flat).reshape(tests.shape)


def information(
    problem: Problem,
    rows: Array,
    measured: Array,
    tests: Array,
    counts: NDArray[np.bool_],
    white: float = 0.0,
) -> Information:
    """Everything in z. rows: (N, r, n) of candidates; measured: (E, r, n); tests: (T, o, n);
    counts: (n,) which parameters are of interest: the others are a nuisance; white: as there."""
    n = rows.shape[2]
    data = Accumulator(n, True, problem.units)
    for part in (*_parts(rows), *_parts(measured)):
        flat = part.reshape(-1, n).T
        data.add(np.vstack([flat, np.zeros((1, flat.shape[1]))])[:, :, None])
    root = spectrum(data, np.zeros(n), problem.prior_sd).root
    k = root.shape[1]
    Z = np.ascontiguousarray(rows @ root)
    before = (measured @ root).reshape(-1, k)
    prior = root / problem.prior_sd[:, None]
    ridge = RIDGE / max(len(rows), 1)
    start = before.T @ before + prior.T @ prior + ridge * np.eye(k)
    nuisance = _unmoved(root[counts])
    return Information(Z, start, tests @ root, root, nuisance, counts, ridge, white)


def _parts(rows: Array) -> list[Array]:
    return [rows[i : i + _ROWS] for i in range(0, len(rows), _ROWS)]


def _unmoved(parameter_root: Array) -> Array:
    """(k, s) an orthonormal basis of the z that move none of these parameters (q, k)."""
    length = np.linalg.norm(parameter_root, axis=1)
    scaled = parameter_root[length > 0.0] / length[length > 0.0, None]
    k = parameter_root.shape[1]
    if not len(scaled):
        return np.eye(k)
    _, s, Vt = np.linalg.svd(scaled, full_matrices=True)
    rank = int((s > _NULL * s.max()).sum())
    return Vt[rank:].T


def closed_corrections(problem: Problem) -> Array:
    """Corrections (k, N) that close the loops of measured poses at the parameters of the start."""
    exact = Sweeper(problem.weighted(Weighting.ALIKE))
    corrections = start_corrections(exact, problem.start)
    return exact.close(problem.start, corrections, NEAR, 1.0).corrections
