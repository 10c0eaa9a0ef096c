"""What the poses of an earlier calibration say near other parameters than its own.

A covariance describes a calibration near its end p_0. Poses that determine some directions poorly
leave a long and curved valley, and later readings may lead far along it. With E and D the whitened
misclosures and equations of the earlier poses at p, and M what its prior added to its information,

    I(p) = D^T D + M,   m(p) = p + I(p)^-1 (D^T E - D_0^T E_0 - M (p - p_0)),

they say N(m, I^-1) there. At p_0, and everywhere in a linear problem, m = p_0 and I^-1 is the
stored covariance R R^T, from which M follows: R^T M R = 1 - R^T D_0^T D_0 R.

Away from p, coordinates follow the valley. With e the whitened loop values of the poses at the
readings that close them at p,

    phi(q) = q + I^-1 D^T (e(q) - D (q - p))

is the point that the poses would take q for if they were linear.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.estimation.noise.linear_model import ModelBlock, linear_model
from loopcal.estimation.problem.pose_equations import pose_equations
from loopcal.estimation.problem.problem import Problem, taken
from loopcal.estimation.problem.starting import start_corrections
from loopcal.estimation.solve.gauss_newton import NEGLIGIBLE
from loopcal.estimation.solve.sweep import Sweeper
from loopcal.statistics.another_day import day_problem, noise_of
from loopcal.statistics.calibrated import Calibrated
from loopcal.statistics.innovation import root_of
from loopcal.statistics.replacing import least_squares

_MOST = 3000
"""Poses; more determine the parameters so well that the covariance describes them."""
_PLACINGS = 3
"""Linearisations that find where an instrument stood."""
_SHARE = 1e-9
"""Of the information: a prior that adds less adds nothing."""


@dataclass(frozen=True, eq=False)
class Sloped:
    """values (q,) and their derivatives (q, n) by the parameters: of coordinates phi(q) - p, or of
    what a prior says in units of its sds."""

    values: Array
    slopes: Array


@dataclass(frozen=True, eq=False)
class Seen:
    """The coordinates phi: at parameters p (n_all,), with readings that close the loops there.

    roots: of the covariance of the loop values, by block; D: (R, n_all); back: (n_all, R).
    """

    problem: Problem
    centre: Array
    roots: Sequence[Array]
    D: Array
    back: Array

    def at(self, parameters: Array) -> Sloped:
        """Of parameters (n_all,); these themselves where a loop has no value."""
        step = parameters - self.centre
        blocks = _blocks(self.problem, parameters)
        e = -_rows(self.roots, [block.e[:, :, None] for block in blocks])[:, 0]
        J = _rows(self.roots, [block.J for block in blocks])
        one = np.eye(len(step))
        if not (np.isfinite(e).all() and np.isfinite(J).all()):
            return Sloped(step, one)
        values = step + self.back @ (e - self.D @ step)
        return Sloped(values, one + self.back @ (J - self.D))


@dataclass(frozen=True, eq=False)
class Around:
    """What earlier poses say near centre (n_all,): mean (n_all,), covariance root root^T.

    carried: R in these coordinates, phi_0'^-1 R with phi_0 the coordinates at p_0, both (n_all, r);
    seen: None where the coordinates are the parameters themselves; D: (R, n_all) of the poses;
    estimated: (n_all,) what the calibration did not hold.
    """

    centre: Array
    mean: Array
    root: Array
    carried: Array
    seen: Seen | None
    D: Array | None
    estimated: NDArray[np.bool_]

    def follows(self, anew: NDArray[np.bool_]) -> Array:
        """(n_all, n_all) the earlier parameters from those of today, as steps: what was placed anew
        (n_all,) moves so that the earlier loops stay closed."""
        moves, then = np.diag((~anew).astype(float)), anew & self.estimated
        if self.D is not None:
            moves[np.ix_(then, ~anew)] = -least_squares(self.D[:, then], self.D[:, ~anew])
        return moves


@dataclass(frozen=True, eq=False)
class Earlier:
    """The poses of an earlier calibration, None where they are not there.

    root: R (n_all, r) with inverse (r, n_all); added: (r, r) R^T M R; pull: (r,) R^T D_0^T E_0;
    estimated: (n_all,) what it did not hold; moved: (n_all,) by how much today's machine is
    elsewhere; seen: the coordinates at p_0; kept: positions of the poses whose loops close.
    """

    begin: Array
    root: Array
    inverse: Array
    estimated: NDArray[np.bool_]
    moved: Array
    problem: Problem | None = None
    kept: NDArray[np.intp] | None = None
    added: Array | None = None
    pull: Array | None = None
    seen: Seen | None = None

    @classmethod
    def of(cls, calibrated: Calibrated, moved: Mapping[str, float] = {}) -> Earlier:
        """Of a calibration, at its own sds; moved: what changed since, by name [SI]."""
        parameters = calibrated.mechanism.parameters
        begin = np.array([p.nominal for p in parameters])
        # Rounding left in the rows of what was held would be scaled up to unit length below.
        root = root_of(calibrated.unwidened) * calibrated.estimated[:, None]
        # Metres and radians side by side: rows of unit length keep the pseudo-inverse from
        # preferring one.
        scale = np.linalg.norm(root, axis=1)
        scale = np.where(scale > 0.0, scale, 1.0)
        inverse = np.linalg.pinv(root / scale[:, None]) / scale
        changed = np.array([moved.get(name, 0.0) for name in parameters.names])
        bare = cls(begin, root, inverse, calibrated.estimated, changed)
        if calibrated.poses is None or len(calibrated.poses) > _MOST:
            return bare
        problem = day_problem(calibrated, calibrated.poses, noise_of(calibrated))
        sweeper = Sweeper(problem)
        closed = sweeper.close(begin, start_corrections(sweeper, begin), NEGLIGIBLE, 1.0)
        kept = np.flatnonzero(~closed.open)
        one = replace(bare, problem=taken(problem, kept), kept=kept)
        E, D = one._equations(begin)
        D = D @ root
        f, V = np.linalg.eigh(D.T @ D)
        # R^T M R = 1 - R^T D_0^T D_0 R; what is left of it below the share is rounding.
        left = np.where(1.0 - f > _SHARE, 1.0 - f, 0.0)
        seen = one._seen(begin, root)
        return replace(one, added=(V * left) @ V.T, pull=D.T @ E, seen=seen)

    def at_sds(self, calibrated: Calibrated) -> Earlier:
        """The same poses at other sds of their readings, with the same prior."""
        return replace(self, problem=self._poses(calibrated))

    def _poses(self, calibrated: Calibrated) -> Problem | None:
        if self.kept is None or calibrated.poses is None:
            return None
        return taken(day_problem(calibrated, calibrated.poses, noise_of(calibrated)), self.kept)

    def prior(self, parameters: Array) -> Sloped:
        """What the earlier calibration knew beside its poses, of steps from parameters (n_all,)."""
        assert self.added is not None
        assert self.pull is not None
        values, V = np.linalg.eigh(self.added)
        kept = values > _SHARE
        root = np.sqrt(values[kept])
        rows = (root[:, None] * V[:, kept].T) @ self.inverse
        away = self.inverse @ (parameters - self.begin)
        return Sloped(-(root * (V[:, kept].T @ away)) - V[:, kept].T @ self.pull / root, rows)

    def linear(
        self, calibrated: Calibrated, parameters: Array, components: Sequence[Sequence[int]]
    ) -> tuple[ModelBlock, ...]:
        """The poses, with loadings at the calibration's sds, linearised where their loops close at
        parameters (n_all,)."""
        problem = self._poses(calibrated)
        assert problem is not None
        return linear_model(
            problem, parameters, self._closed(parameters), components, compressed=False
        ).blocks

    def wider(self, calibrated: Calibrated) -> Array:
        """(r, r) by how much the stated covariance is larger, in shares of the own one."""
        stated: Array = self.inverse @ calibrated.covariance.matrix @ self.inverse.T
        return stated - self.inverse @ calibrated.unwidened @ self.inverse.T

    def around(self, centre: Array) -> Around:
        """Near parameters (n_all,); without poses, near the calibration itself."""
        if self.problem is None or self.added is None or self.pull is None:
            at = self.begin, self.begin, self.root, self.root
            return Around(*at, None, None, self.estimated)
        E, D = self._equations(centre)
        if not (np.isfinite(E).all() and np.isfinite(D).all()):
            return self.around(self.begin)
        step, DR = self.inverse @ (centre - self.begin), D @ self.root
        values, vectors = np.linalg.eigh(DR.T @ DR + self.added)
        if centre is not self.begin and not values.min(initial=1.0) > _SHARE:
            return self.around(self.begin)  # so far off the poses determine less
        # In units of R the information is DR^T DR + added, and R half half^T R^T its inverse.
        half = vectors / np.sqrt(np.maximum(values, _SHARE))
        root, pull = self.root @ half, DR.T @ E - self.pull - self.added @ step
        carried = self.root
        if self.seen is not None:
            carried = least_squares(self.seen.at(centre).slopes, self.root)
        mean = centre + root @ (half.T @ pull)
        seen = self._seen(centre, root)
        return Around(centre, mean, root, carried, seen, D, self.estimated)

    def beside(self, today: Array, anew: NDArray[np.bool_]) -> Around:
        """Near the machine of today (n_all,), where that stood then: what was placed anew since
        (n_all,) is found from the earlier poses."""
        return self.around(self.parameters_then(today, anew))

    def parameters_then(self, today: Array, anew: NDArray[np.bool_]) -> Array:
        """The machine of today (n_all,) with what was placed anew since, or moved, where it stood
        then."""
        parameters, then = np.where(anew, self.begin, today - self.moved), anew & self.estimated
        for _ in range(_PLACINGS if self.problem is not None and then.any() else 0):
            E, D = self._equations(parameters)
            parameters[then] += least_squares(D[:, then], E[:, None])[:, 0]
        return parameters

    def _closed(self, parameters: Array) -> Array:
        """The corrections of all poses that close their loops."""
        assert self.problem is not None
        sweeper = Sweeper(self.problem)
        begun = start_corrections(sweeper, parameters)
        return sweeper.close(parameters, begun, NEGLIGIBLE, 1.0).corrections

    def _equations(self, parameters: Array) -> tuple[Array, Array]:
        """E (R,) and D (R, n_all) of all poses where their loops close."""
        assert self.problem is not None
        blocks = pose_equations(self.problem, parameters, self._closed(parameters))
        E = np.concatenate([block.E.ravel() for block in blocks])
        return E, np.concatenate([block.D.reshape(-1, block.D.shape[2]) for block in blocks])

    def _seen(self, centre: Array, root: Array) -> Seen | None:
        """None where some quantity has no reading: its elimination has no smooth basis."""
        problem = self.problem
        if problem is None or any(pattern.unmeasured for pattern in problem.patterns):
            return None
        zero = np.zeros_like(problem.readings)
        corrections = Sweeper(problem).close(centre, zero, NEGLIGIBLE, 1.0).corrections
        problem = replace(problem, readings=problem.readings + corrections)
        blocks = _blocks(problem, centre)
        try:
            roots = [np.asarray(np.linalg.cholesky(block.fixed)) for block in blocks]
        except np.linalg.LinAlgError:
            return None
        D = _rows(roots, [block.J for block in blocks])
        return Seen(problem, centre, roots, D, root @ (D @ root).T)


def _blocks(problem: Problem, parameters: Array) -> Sequence[ModelBlock]:
    return linear_model(
        problem, parameters, np.zeros_like(problem.readings), (), compressed=False
    ).blocks


def _rows(roots: Sequence[Array], parts: Sequence[Array]) -> Array:
    """(R, c) of (b, r, c) each, whitened."""
    whitened = [np.linalg.solve(L, part) for L, part in zip(roots, parts, strict=True)]
    return np.concatenate([rows.reshape(-1, rows.shape[2]) for rows in whitened])
