"""Another day: the machine is held as it was calibrated, and only what may have moved is found.

An instrument that was carried elsewhere has another placement, a target that was mounted anew
other coordinates. With everything else held, these are found by damped Gauss-Newton steps on

    sum_i e_i^T W_i^-1 e_i,   e_i = -f(x_i, p),   W = J_x Sigma J_x^T,

e_i the misclosure of a pose at its readings, W what the noise of its readings explains of it.
Instruments that see points begin where these are best aligned.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.errors import InputError, NoTrustworthyResult, listed
from loopcal.estimation.dependence.dependence import joint_rows
from loopcal.estimation.noise.linear_model import linear_model
from loopcal.estimation.prediction import output_differences
from loopcal.estimation.problem.alignment import placed
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.solve.kernel import eliminate
from loopcal.estimation.solve.sweep import Sweeper
from loopcal.lazy import cached_property
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.statistics.calibrated import ResidualVariance
from loopcal.statistics.predictive import unmeasured_corrections
from loopcal.statistics.run_order import WAYS, ways

CAMERAS = "cameras"
"""All cameras that sit beside the machine, or that it carries."""
IN_PROPORTION = " in proportion"
"""Behind the name of a reading: all that it reads is larger by the same share."""

# Chosen, not derived: a cap, and what shows which start is best.
_STEPS, _ROUGHLY = 100, 4
"""Steps at most, and those that tell which of several starts is best."""
_SETTLED = 1e-9
"""Share of the sum of squares: a step that promises to lower it by less is not taken."""
# Chosen, not derived: of unit columns; a step is then shorter than rounding shows.
_MOST_DAMPING = 1e12
# A mean square is about 1 where machine and sds are right.
ASTRAY, _STARTS = 100.0, 10
"""A mean square from which on a misfit is gross; then so many other starts are tried."""
# Chosen, not derived: at this pace 100 steps leave a third of a misfit, which stays gross.
_PACE, _SLOW = 10, 0.9
"""Of a mean square three times as gross, so many steps leave less than this share, or are the last
ones."""
# Chosen, not derived: far above rounding, far below a direction that poses show.
DETERMINED = 1e-9
"""Singular values so far below the largest are of directions that these poses do not show."""


def freed(mechanism: Mechanism, remounted: bool | Sequence[str] = False) -> tuple[str, ...]:
    """The parameters that are found anew: where every instrument stands, and what was mounted anew.

    Cameras stay where they were calibrated, and so does what sits on a moving body: a ball that
    another one touches, a plate. remounted: True for everything that instruments look
    at; or names of instruments, targets or parameters (globs). Raises InputError for a name that is
    none of these.
    """
    names = [n for family in mechanism.families for n in family.standing]
    if mechanism.placement is not None:
        names += mechanism.placement.parameters
    # Where a camera stands beside the machine is what was calibrated.
    cameras = {p.owner for p in mechanism.parameters if p.role == "lens"}
    names = [n for n in names if mechanism.parameters[n].owner not in cameras]
    names = [n for n in names if mechanism.parameters[n].role != "mounting"]
    patterns = remounted if not isinstance(remounted, bool) else mounted(mechanism, remounted)
    for name in (patterns,) if isinstance(patterns, str) else patterns:
        names += _named(mechanism, name)
    return tuple(n for n in mechanism.parameters.names if n in names)


def mounted(mechanism: Mechanism, remounted: bool = True) -> tuple[str, ...]:
    """The parameters of everything that instruments look at, none where nothing was remounted.

    Raises InputError where nothing says which these are.
    """
    parameters = tuple(n for family in mechanism.families for n in family.mounted)
    if remounted and not parameters:
        raise InputError(
            f"nothing says what is mounted on {mechanism.name!r}",
            code="missing-key",
            remedy="name the parameters of what was mounted anew",
        )
    return parameters if remounted else ()


def _named(mechanism: Mechanism, name: str) -> tuple[str, ...]:
    """The parameters of an instrument's mounting, of where a camera sits, of a target, or that a
    name or glob matches."""
    eyes = {p.owner for p in mechanism.parameters if p.role == "lens"}
    eyes = eyes if name == CAMERAS else eyes & {name}
    places = tuple(
        p.name
        for p in mechanism.parameters
        if p.owner in eyes and p.role in ("placement", "mounting")
    )
    if places:
        return places
    families = {family.name: family.mounted for family in mechanism.families}
    if name in families and name not in mechanism.parameters.names:
        return families[name]
    owned = tuple(p.name for p in mechanism.parameters if p.owner == name)
    if owned and name not in mechanism.parameters.names:
        return owned
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
    there; anew: (n_all,) whether a parameter is found anew.
    """

    problem: Problem
    parameters: Array
    corrections: Array
    rows: tuple[Rows, ...]
    anew: NDArray[np.bool_]

    @cached_property
    def e(self) -> Array:
        """(R,) the whitened misclosures of all poses."""
        return np.concatenate([rows.e.ravel() for rows in self.rows])

    @cached_property
    def J(self) -> Array:
        """(R, n_all) the whitened equations."""
        return np.concatenate([rows.J.reshape(-1, rows.J.shape[2]) for rows in self.rows])

    @cached_property
    def row_poses(self) -> NDArray[np.intp]:
        """(R,) the pose of each equation."""
        return np.concatenate([np.repeat(rows.poses, rows.e.shape[1]) for rows in self.rows])

    @cached_property
    def merit(self) -> float:
        """The sum of squares; infinite where a loop has no value."""
        with np.errstate(all="ignore"):  # steps may lead anywhere; what is not finite is refused
            finite = np.isfinite(self.e).all() and np.isfinite(self.J).all()
            return float(self.e @ self.e) if finite else np.inf

    @property
    def directions(self) -> Array:
        """(n_all, g) the unit steps of what is found anew."""
        return np.eye(len(self.anew))[:, self.anew]

    @property
    def measured(self) -> Array:
        """(c, N) [SI] what is compared with computed outputs."""
        mechanism = self.problem.mechanism
        rows = [mechanism.tape.quantities.index(q) for q in mechanism.compared]
        return self.problem.readings[rows]

    @cached_property
    def differences(self) -> Array:
        """(c, N) [SI] computed minus measured outputs."""
        return output_differences(self.problem, self.parameters, self.corrections)

    def columns(self, names: Sequence[str]) -> Array:
        """(R, m) how the whitened equations change with parameters, zeros of readings, readings
        `IN_PROPORTION` and delays (`WAYS`).

        A zero is what a true value exceeds its reading by; its column has the sign of those of J.
        """
        mechanism = self.problem.mechanism
        order, parameters = mechanism.tape.quantities, mechanism.parameters.names
        stems = [name.removesuffix(IN_PROPORTION) for name in names]
        joints = [order[i] for i in joint_rows(self.problem)] if {*names} & {*WAYS} else []
        read = list(dict.fromkeys([*(stem for stem in stems if stem in order), *joints]))
        zeros = dict(zip(read, self._zero_columns([order.index(q) for q in read]).T, strict=True))
        columns = []
        for name, stem in zip(names, stems, strict=True):
            if name in WAYS:
                way = ways(self.problem, WAYS[name])
                # Play errs by the sign of the way, and no play must look like a delay.
                way = (way - np.abs(way).mean(axis=0) * np.sign(way))[self.row_poses]
                columns.append(sum(zeros[q] * way[:, i] for i, q in enumerate(joints)))
            elif stem not in zeros:
                columns.append(self.J[:, parameters.index(name)])
            elif name == stem:
                columns.append(zeros[stem])
            else:
                columns.append(
                    zeros[stem] * self.problem.readings[order.index(stem)][self.row_poses]
                )
        return np.array(columns).reshape(len(names), len(self.e)).T

    def _zero_columns(self, quantities: Sequence[int]) -> Array:
        if not quantities:
            return np.zeros((len(self.e), 0))
        sweeper = Sweeper(self.problem)
        by_block = []
        for (pattern, block), rows in zip(
            sweeper.blocks(self.parameters, self.corrections), self.rows, strict=True
        ):
            values = sweeper.loop_values(pattern, block)
            unmeasured = list(block.noise.unmeasured)
            by_quantity = values.by_quantity
            if block.noise.predicted:  # what is missing says nothing
                by_quantity = by_quantity * np.isfinite(block.noise.sd[list(block.noise.predicted)])
            by_reading = by_quantity[list(quantities)]
            if unmeasured:
                by_reading = eliminate(by_quantity[unmeasured]).apply(by_reading)
            columns = by_reading[:, len(unmeasured) :].transpose(2, 1, 0)
            by_block.append(np.linalg.solve(rows.root, columns).reshape(-1, len(quantities)))
        return np.concatenate(by_block)


def replaced(
    problem: Problem,
    names: Sequence[str],
    places: Mapping[str, float] = {},
    *,
    residual: ResidualVariance | None = None,
    components: Sequence[Sequence[int]] = (),
) -> Replaced:
    """The machine of a problem, at its start, placed anew by the problem's poses.

    problem: of which every parameter counts as estimated; names: of what is found anew; places:
    roughly, of some of it, where another search may begin; residual: of every loop equation, where
    the readings are taken as exact; components: quantities whose noise is kept apart in the rows.
    Raises NoTrustworthyResult where a loop has no value.
    """
    search = _Search(problem, names, residual, components)
    lowest = search.lowest(search.begun())
    if lowest.merit > ASTRAY * len(lowest.e):
        starts = search.elsewhere(lowest.parameters, places)
        others = [search.lowest(start, _ROUGHLY) for start in starts]
        near = min(others, key=lambda one: one.merit, default=None)
        if near is not None and (end := search.lowest(near.parameters)).merit < lowest.merit:
            lowest = end
    if not np.isfinite(lowest.merit):
        raise NoTrustworthyResult(
            "the machine cannot be placed by these readings: some loop has no value wherever the "
            "search went",
            code="not-verified",
            remedy="check that the readings belong to this machine, and their columns and units",
        )
    return lowest


def least_squares(A: Array, b: Array, damping: float = 0.0) -> Array:
    """x (n, m) of the least |A x - b|, without directions that A (R, n) does not show; damping:
    keeps it short (Marquardt 1963)."""
    scale = np.linalg.norm(A, axis=0)
    scale = np.where(scale > 0.0, scale, 1.0)
    rows, n = A / scale, A.shape[1]
    if damping:
        # Rows below each other: A^T A would square the condition number.
        rows = np.vstack([rows, np.sqrt(damping) * np.eye(n)])
        b = np.concatenate([b, np.zeros((n, b.shape[1]))])
    return np.linalg.lstsq(rows, b, rcond=DETERMINED)[0] / scale[:, None]


@dataclass(frozen=True)
class _Search:
    """The poses, what is free, and how loop equations are weighted."""

    problem: Problem
    names: Sequence[str]
    residual: ResidualVariance | None
    components: Sequence[Sequence[int]]

    @property
    def _free(self) -> list[int]:
        order = self.problem.mechanism.parameters.names
        return [order.index(name) for name in self.names]

    def begun(self) -> Array:
        """Where points are best aligned; as calibrated where no points are seen, or too few."""
        values, free = self.problem.start.copy(), self._free
        try:
            parameters = placed(self.problem)[0].parameters
        except InputError:
            return values
        values[free] = [parameters[name].nominal for name in self.names]
        return values

    def at(self, values: Array, near: Replaced | None = None) -> Replaced:
        """The machine there; near: at a place nearby, from which loops are closed."""
        problem = self.problem
        if near is not None:
            problem = replace(problem, first_corrections=near.corrections)
        anew = np.zeros(len(values), dtype=bool)
        anew[self._free] = True
        with np.errstate(all="ignore"):  # steps may lead anywhere
            corrections = unmeasured_corrections(problem, values)
            rows = tuple(self.rows(values, corrections))
        return Replaced(self.problem, values, corrections, rows, anew)

    def lowest(self, values: Array, steps: int = _STEPS) -> Replaced:
        """The lowest place near one, or that after so many steps."""
        lowest, damping, free = self.at(values), 1e-3, self._free
        before = np.inf
        for number in range(steps):
            if not free or not damping < _MOST_DAMPING or not np.isfinite(lowest.merit):
                break
            if number % _PACE == 0:
                if lowest.merit > max(_SLOW * before, 3.0 * ASTRAY * len(lowest.e)):
                    break
                before = lowest.merit
            A = lowest.J[:, free]
            step = least_squares(A, lowest.e[:, None], damping)[:, 0]
            promised = lowest.merit - float(np.square(lowest.e - A @ step).sum())
            if promised <= _SETTLED * lowest.merit:
                break
            trial = lowest.parameters.copy()
            trial[free] += step
            tried = self.at(trial, lowest)
            if tried.merit < lowest.merit:
                lowest, damping = tried, 0.1 * damping
            else:
                damping *= 10.0
        return lowest

    def elsewhere(self, place: Array, places: Mapping[str, float]) -> Iterator[Array]:
        """Other starts: as images alone say, or else for points such as anchors that no aligned
        points say anything of."""
        mechanism = self.problem.mechanism
        if places:
            values = place.copy()
            values[[mechanism.parameters.names.index(name) for name in places]] = [*places.values()]
            yield values
            return
        names = [n for f in mechanism.families if f.placement is None for n in f.standing]
        free = [i for i in self._free if mechanism.parameters.names[i] in names]
        draw = np.random.default_rng(0)
        for _ in range(_STARTS if free else 0):
            values = place.copy()
            # 1 m or 1 rad at least, for an anchor may be calibrated at 0.
            reach = 1.0 + np.abs(self.problem.start[free])
            values[free] = self.problem.start[free] + reach * draw.uniform(-1.0, 1.0, len(free))
            yield values

    def rows(self, values: Array, corrections: Array) -> list[Rows]:
        problem = self.problem
        model = linear_model(problem, values, corrections, self.components, compressed=False)
        everything = np.arange(len(problem.poses))
        by_block = []
        for (pattern, poses), block in zip(problem.blocks(), model.blocks, strict=True):
            W = block.fixed + block.G @ block.G.transpose(0, 2, 1)
            if self.residual is not None:
                W = self.residual.value * np.broadcast_to(np.eye(W.shape[1]), W.shape)
                if self.residual.shared:
                    names = [problem.mechanism.tape.quantities[i] for i in pattern.predicted]
                    # Corners that were not detected say nothing.
                    read = np.any(block.J, axis=2, keepdims=True)
                    root = self.residual.root(names)[:, : -len(names)] * read
                    W = W + root @ np.swapaxes(root, 1, 2)
            # NaN makes the merit infinite, and a step to such a place is refused.
            columns = np.concatenate([block.rows, block.G], axis=2)
            L, whitened = W, np.full_like(columns, np.nan)
            try:
                if np.isfinite(W).all():
                    L = np.asarray(np.linalg.cholesky(W))
                    whitened = np.asarray(np.linalg.solve(L, columns))
            except np.linalg.LinAlgError:
                _refuse_exact(problem)  # otherwise the machine is so far away that it has no value
            n = block.J.shape[2]
            by_block.append(
                Rows(
                    everything[poses],
                    whitened[:, :, n],
                    whitened[:, :, :n],
                    whitened[:, :, n + 1 :],
                    block.owner,
                    np.asarray(L),
                )
            )
        return by_block


def _refuse_exact(problem: Problem) -> None:
    names = problem.mechanism.tape.quantities
    exact = [q for q, sd in zip(names, problem.uncertainty.sd, strict=True) if not sd.any()]
    if not exact:
        return
    raise InputError(
        f"some loop equations contain exact readings alone ({listed(exact)}), so nothing says how "
        "well they should close",
        code="missing-sd",
        remedy="give these readings their sd",
    )
