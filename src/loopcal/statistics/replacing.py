"""Another day: the machine is held as it was calibrated, and only what may have moved is found.

An instrument that was carried elsewhere has another placement, a target that was mounted anew
other coordinates. With everything else held, these are found by damped Gauss-Newton steps on

    sum_i e_i^T W_i^-1 e_i,   e_i = -f(x_i, p),   W = J_x Sigma J_x^T,

e_i the misclosure of a pose at its readings, W what the noise of its readings explains of it.
Instruments that see points begin where these are best aligned.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError, NoTrustworthyResult, listed
from loopcal.estimation.noise.linear_model import linear_model
from loopcal.estimation.problem.alignment import placed
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.solve.kernel import eliminate
from loopcal.estimation.solve.sweep import Sweeper
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.station import Station
from loopcal.statistics.gauge import carried, gauge, moved, rotation_by
from loopcal.statistics.predictive import found_unmeasured

Array = NDArray[np.float64]
_STEPS, _ROUGHLY = 100, 4
"""Steps at most, and those that tell which of several starts is best."""
_SETTLED = 1e-9
"""Share of the sum of squares: a step that promises to lower it by less is not taken."""
_MOST_DAMPING = 1e12
_ASTRAY, _STARTS = 100.0, 10
"""A mean square from which on other starts are tried, and how many."""
DETERMINED = 1e-9
"""Singular values so far below the largest are of directions that these poses do not show."""


@dataclass(frozen=True)
class Freedom:
    """What may have changed since a calibration.

    names: parameters that are found anew; whole: whether the machine is moved as a whole, because
    its placement is spread over the parameters of the machine itself.
    """

    names: tuple[str, ...]
    whole: bool = False

    @classmethod
    def of(cls, mechanism: Mechanism, remounted: bool | Sequence[str] = False) -> Freedom:
        """Where every instrument stands, and what was mounted anew.

        remounted: True for everything that instruments look at; or names of instruments, targets
        or parameters (globs). Raises InputError for a name that is none of these.
        """
        names = [n for family in mechanism.families for n in family.standing]
        placement = mechanism.placement
        if isinstance(placement, Station):
            names += placement.parameters
        given = remounted if not isinstance(remounted, bool) else mounted(mechanism, remounted)
        for name in (given,) if isinstance(given, str) else given:
            names += _named(mechanism, name)
        order = mechanism.parameters.names
        whole = placement is not None and not isinstance(placement, Station)
        return cls(tuple(n for n in order if n in names), whole)


def mounted(mechanism: Mechanism, remounted: bool = True) -> tuple[str, ...]:
    """The parameters of everything that instruments look at, none where nothing was remounted.

    Raises InputError where nothing says which these are.
    """
    its = tuple(n for family in mechanism.families for n in family.mounted)
    if remounted and not its:
        raise InputError(
            f"nothing says what is mounted on {mechanism.name!r}",
            code="missing-key",
            remedy="name the parameters of what was mounted anew",
        )
    return its if remounted else ()


def _named(mechanism: Mechanism, name: str) -> tuple[str, ...]:
    """The parameters of an instrument's mounting, of a target, or that a name or glob matches."""
    families = {family.name: family.mounted for family in mechanism.families}
    if name in families and name not in mechanism.parameters.names:
        return families[name]
    prefixed = tuple(n for n in mechanism.parameters.names if n.startswith(f"{name}_"))
    if prefixed and name not in mechanism.parameters.names:
        return prefixed
    return mechanism.parameters.matching(name)


@dataclass(frozen=True)
class Rows:
    """Whitened equations of some poses: e (b, r), J (b, r, n_all), noise (b, r, K) of components.

    poses: positions; owner: (K,) the component of each column; root: (b, r, r) of the covariance
    by which they are whitened.
    """

    poses: NDArray[np.intp]
    e: Array
    J: Array
    noise: Array
    owner: NDArray[np.intp]
    root: Array


@dataclass(frozen=True, eq=False)
class Replaced:
    """A held machine whose instruments were placed anew.

    parameters: (n_all,); corrections: (k, N) [SI] of what no sensor reads; rows: the equations
    there; directions: (n_all, g) along which parameters may change; anew: (n_all,) whether a
    parameter is found anew by itself; carry: (n_all, n_all) how the
    parameters change with those of the machine where it was calibrated, None for not at all;
    exact: whether the readings are taken as exact.
    """

    problem: Problem
    parameters: Array
    corrections: Array
    rows: tuple[Rows, ...]
    directions: Array
    anew: NDArray[np.bool_]
    carry: Array | None = None
    exact: bool = False

    @property
    def e(self) -> Array:
        """(R,) the whitened misclosures of all poses."""
        return np.concatenate([rows.e.ravel() for rows in self.rows])

    @property
    def J(self) -> Array:
        """(R, n_all) the whitened equations."""
        return np.concatenate([rows.J.reshape(-1, rows.J.shape[2]) for rows in self.rows])

    def brought(self, steps: Array) -> Array:
        """Parameter steps (n_all, s) of the machine where it was calibrated, as they are here."""
        return steps if self.carry is None else self.carry @ steps


def replaced(
    problem: Problem,
    freedom: Freedom,
    *,
    variance: float | None = None,
    components: Sequence[Sequence[int]] = (),
) -> Replaced:
    """The machine of a problem, at its start, placed anew by the problem's poses.

    Raises NoTrustworthyResult where a loop has no value. problem: of which every parameter counts
    as estimated; variance: of every loop equation, where
    the readings are taken as exact; components: quantities whose noise is told apart in the rows.
    """
    search = _Search(problem, freedom, variance, components)
    place, found = search.lowest(search.begun())
    if found.merit > _ASTRAY * len(found.e):
        others = [search.lowest(start, _ROUGHLY) for start in search.elsewhere(place)]
        near = min(others, key=lambda one: one[1].merit, default=None)
        if near is not None and (end := search.lowest(near[0]))[1].merit < found.merit:
            place, found = end
    if not np.isfinite(found.merit):
        raise NoTrustworthyResult(
            "the machine cannot be placed by these readings: some loop has no value wherever the "
            "search went",
            code="not-verified",
            remedy="check that the readings belong to this machine, and their columns and units",
        )
    return replace(found.replaced, carry=search.carry(place)) if freedom.whole else found.replaced


def zero_columns(here: Replaced, quantities: Sequence[str]) -> Array:
    """(R, q) how the whitened equations change with the zeros of these readings.

    A zero is what a true value exceeds its reading by; columns have the sign of those of J.
    """
    sweeper = Sweeper(here.problem, exact=here.exact)
    sweeper.at(here.parameters)
    order = here.problem.mechanism.tape.quantities
    found = []
    for (pattern, block), rows in zip(sweeper.blocks(here.corrections), here.rows, strict=True):
        values = sweeper.engine(pattern).evaluate(block.corrected, block.known)
        unmeasured = list(block.noise.unmeasured)
        by_reading = values.by_quantity[[order.index(q) for q in quantities]]
        if unmeasured:
            by_reading = eliminate(values.by_quantity[unmeasured]).apply(by_reading)
        columns = by_reading[:, len(unmeasured) :].transpose(2, 1, 0)
        found.append(np.linalg.solve(rows.root, columns).reshape(-1, len(quantities)))
    return np.concatenate(found)


def _damped(A: Array, e: Array, damping: float) -> Array:
    """The step that lowers |e - A step|, kept short by the damping (Marquardt 1963)."""
    scale = np.linalg.norm(A, axis=0)
    scale = np.where(scale > 0.0, scale, 1.0)
    rows = np.vstack([A / scale, np.sqrt(damping) * np.eye(A.shape[1])])
    right = np.concatenate([e, np.zeros(A.shape[1])])
    step: Array = np.linalg.lstsq(rows, right, rcond=DETERMINED)[0] / scale
    return step


@dataclass(frozen=True)
class _Place:
    """Where a search stands: a motion of the whole machine, then values (n_all,) before it."""

    rotation: Array
    shift: Array
    values: Array


@dataclass(frozen=True)
class _Found:
    replaced: Replaced
    e: Array
    J: Array
    directions: Array
    merit: float


@dataclass(frozen=True)
class _Search:
    """The poses, what is free, and how loop equations are weighted."""

    problem: Problem
    freedom: Freedom
    variance: float | None
    components: Sequence[Sequence[int]]

    @property
    def _size(self) -> int:
        return len(self.problem.mechanism.outputs) if self.freedom.whole else 3

    @property
    def _free(self) -> list[int]:
        order = self.problem.mechanism.parameters.names
        return [order.index(name) for name in self.freedom.names]

    def begun(self) -> _Place:
        """Where points are best aligned; as calibrated where no points are seen, or too few."""
        start, d = self.problem.start, self._size
        stays = _Place(np.eye(d), np.zeros(d), start)
        station = self.problem.mechanism.placement
        anew = isinstance(station, Station) and {*station.parameters} <= {*self.freedom.names}
        if not (self.freedom.whole or anew):
            return stays
        try:
            mechanism, motion = placed(self.problem)
        except InputError:
            return stays
        if self.freedom.whole:
            return _Place(motion.rotation, motion.shift, start)
        there = np.array([p.nominal for p in mechanism.parameters])
        return replace(stays, values=there)

    def at(self, place: _Place, near: _Found | None = None) -> _Found:
        """The equations at a place; their merit is infinite where a loop has no value.

        near: at a place nearby, from which loops are closed.
        """
        problem, mechanism = self.problem, self.problem.mechanism
        if near is not None:
            problem = replace(problem, found=near.replaced.corrections)
        values = place.values
        unit = np.eye(len(values))[:, self._free]
        if self.freedom.whole:
            values = moved(mechanism, place.values, place.rotation, place.shift)
            if unit.shape[1]:
                unit = self.carry(place) @ unit
            unit = np.hstack([gauge(mechanism, values, self._centre), unit])
        corrections = found_unmeasured(problem, values, exact=self.variance is not None)
        rows = tuple(self.rows(values, corrections))
        anew = np.zeros(len(values), dtype=bool)
        anew[self._free] = True
        found = Replaced(
            self.problem, values, corrections, rows, unit, anew, None, self.variance is not None
        )
        e, J = found.e, found.J
        finite = np.isfinite(e).all() and np.isfinite(J).all()
        return _Found(found, e, J, unit, float(e @ e) if finite else np.inf)

    def lowest(self, here: _Place, steps: int = _STEPS) -> tuple[_Place, _Found]:
        """The lowest place near one, or that after so many steps."""
        found, damping = self.at(here), 1e-3
        for _ in range(steps):
            if not found.directions.shape[1] or not damping < _MOST_DAMPING:
                break
            if not np.isfinite(found.merit):
                break
            A = found.J @ found.directions
            step = _damped(A, found.e, damping)
            promised = found.merit - float(np.square(found.e - A @ step).sum())
            if promised <= _SETTLED * found.merit:
                break
            tried = self.at(trial := self.stepped(here, step), found)
            if tried.merit < found.merit:
                here, found, damping = trial, tried, 0.1 * damping
            else:
                damping *= 10.0
        return here, found

    def elsewhere(self, place: _Place) -> Iterator[_Place]:
        """Other starts, for points such as anchors that no aligned points say anything of."""
        mechanism = self.problem.mechanism
        names = [n for f in mechanism.families if f.placement is None for n in f.standing]
        free = [i for i in self._free if mechanism.parameters.names[i] in names]
        draw = np.random.default_rng(0)
        for _ in range(_STARTS if free else 0):
            values = place.values.copy()
            reach = 1.0 + np.abs(self.problem.start[free])
            values[free] = self.problem.start[free] + reach * draw.uniform(-1.0, 1.0, len(free))
            yield replace(place, values=values)

    def carry(self, place: _Place) -> Array:
        """How the parameters there change with those of the machine where it was calibrated."""
        return carried(self.problem.mechanism, place.values, place.rotation, place.shift)

    @property
    def _centre(self) -> Array:
        names = self.problem.mechanism.tape.quantities
        rows = [names.index(q) for q in self.problem.mechanism.outputs]
        centre: Array = self.problem.readings[rows].mean(axis=1)
        return centre

    def stepped(self, place: _Place, step: Array) -> _Place:
        """The place after a step along the directions."""
        values = place.values.copy()
        if not self.freedom.whole:
            values[self._free] += step
            return replace(place, values=values)
        d = self._size
        turns = 1 if d == 2 else 3
        values[self._free] += step[turns + d :]
        R, centre = rotation_by(step[:turns]), self._centre
        shift = R @ (place.shift - centre) + centre + step[turns : turns + d]
        return _Place(R @ place.rotation, shift, values)

    def rows(self, values: Array, corrections: Array) -> list[Rows]:
        problem = self.problem
        model = linear_model(problem, values, corrections, self.components)
        everything = np.arange(len(problem.poses))
        found = []
        for (_, poses), block in zip(problem.blocks(), model.blocks, strict=True):
            W = block.fixed + block.G @ block.G.transpose(0, 2, 1)
            if self.variance is not None:
                W = self.variance * np.broadcast_to(np.eye(W.shape[1]), W.shape)
            if np.isfinite(W).all():
                try:
                    L = np.linalg.cholesky(W)
                except np.linalg.LinAlgError:
                    raise _exact(problem) from None
                whitened = np.linalg.solve(L, block.columns)
            else:  # a loop has no value here
                L = W
                whitened = np.full_like(block.columns, np.nan)
            n = block.J.shape[2]
            found.append(
                Rows(
                    everything[poses],
                    whitened[:, :, n],
                    whitened[:, :, :n],
                    whitened[:, :, n + 1 :],
                    block.owner,
                    np.asarray(L),
                )
            )
        return found


def _exact(problem: Problem) -> InputError:
    names = problem.mechanism.tape.quantities
    exact = [q for q, sd in zip(names, problem.uncertainty.sd, strict=True) if not sd.any()]
    return InputError(
        f"some loop equations contain exact readings alone ({listed(exact)}), so nothing says how "
        "well they should close",
        code="missing-sd",
        remedy="give these readings their sd",
    )
