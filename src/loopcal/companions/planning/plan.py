"""Which poses to measure: candidates, their information under the stated noise, and the choice.

How far any choice could still be better: the continuous optimum and its bound.

Let every candidate be measured w_i times, 0 <= w_i <= 1 and sum w_i = n, fractions allowed. The
criterion f is convex in w. With its slopes -g_i at any w,

    f(v) >= f(w) - (the n largest g_i added up - sum w_i g_i)   for every such v,

so also for the best choice of n poses. The weights follow multiplicative steps w_i (g_i / mean)^a
(Silvey, Titterington and Torsney 1978), capped at 1. a = 1/2 lowers f always, and grows as long as
it does.

An order of poses with short joint travel: nearest neighbour, then 2-opt; out by every second
pose of it, back by the others. The joints then do not show the number of the pose, so that a
linear drift of the instrument looks like no error of the machine.

All joints move at once. So the way between two poses is as long as the longest of their moves, each
in shares of its range.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.companions.planning.candidates import (
    Candidates,
    blank_in,
    closed_at,
    drawn,
    in_shares,
    ranges_of,
    reached,
    stated_candidates,
    too_few,
    typical_sds,
    with_sds,
)
from loopcal.companions.planning.information import (
    Information,
    closed_corrections,
    end_point_rows,
    end_point_unit,
    information,
    placed_anew,
    rows_of,
    white_error,
)
from loopcal.companions.planning.occasions import occasions, serving
from loopcal.companions.planning.planned import (
    CALIBRATE,
    CRITERIA,
    REPEAT,
    VALIDATE,
    Plan,
    expected_curve,
    expected_of,
    random_sets,
    to_validate,
)
from loopcal.companions.planning.search import (
    Chosen,
    Criterion,
    choose,
    criterion_value,
    inverse,
    linear_aim,
    test_variances,
)
from loopcal.errors import InputError, unknown_name
from loopcal.estimation.noise.learning import with_model
from loopcal.estimation.problem.problem import Problem, build_problem
from loopcal.estimation.solve.scratch import one_blas_thread
from loopcal.estimation.steps import started
from loopcal.execution.executor import Progress
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise, NoiseLike
from loopcal.measurements.plan_settings import PlanSettings
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.structure.smooth import vectors_for
from loopcal.mechanisms.structure.structured import EFFECT, structured

TESTS = 300
"""Poses at which the end point is predicted."""
# A choice at the nominal machine may suit no other, so draws from the prior are averaged in; 200
# candidates show whether they matter.
_DRAWS, _LOOKED_AT = 3, 200
# Chosen, not derived: repeats are then a fifth of the poses at most.
_RUN = 10
"""Poses from which on the first is repeated in the middle and at the end."""
_DEPENDS = 0.05
"""So much of a candidate's equations must change with a draw of the parameters to count."""


def plan(
    mechanism: Mechanism,
    poses: int = 30,
    *,
    noise: NoiseLike,
    candidates: Dataset | Mapping[str, Any] | None = None,
    existing: Dataset | None = None,
    criterion: str | None = None,
    settings: PlanSettings | None = None,
    progress: Progress | None = None,
) -> Plan:
    """The poses that show most of the machine, with what they promise.

    candidates: poses to choose among [SI], by default random ones (`PlanSettings`); existing: poses
    already measured, which the plan adds to. criterion: "I", the mean variance of the predicted end
    point over test poses, is the default where there is an end point; "G" is the largest. "D" is
    the determinant of the covariance of the parameters, the default elsewhere; "A" its trace in
    relative units. The placement of instruments is estimated but does not count. Fedorov's exchange
    (1972) from a greedy start; the stated efficiency is a bound. Raises InputError for what cannot
    be used.

    >>> from loopcal.measurements.plan_settings import PlanSettings
    >>> from loopcal.mechanisms.planar import planar_two_link
    >>> arm = planar_two_link()
    >>> where = PlanSettings({"phi2": (-1.0, 1.0), "phi3": (0.3, 2.0)}, number=200)
    >>> made = plan(arm, 10, noise={"*": 1e-4}, settings=where)
    >>> made.count, made.use.count("validate"), made.use.count("repeat"), made.efficiency > 0.8
    (10, 2, 2, True)
    """
    settings, sensor_noise = settings or PlanSettings(), Noise.of(noise)
    if sensor_noise is None or not sensor_noise.entries:
        raise InputError(
            "no noise is given",
            code="missing-sd",
            remedy="give the sds of the readings [SI], such as noise={'*': 1e-4}",
        )
    if poses < 1:
        raise InputError(
            f"{poses} poses are requested", code="invalid-value", remedy="request at least one"
        )
    how = _criterion(mechanism, criterion)
    assumed = settings.model_error == "structured" and EFFECT not in mechanism.effects
    if assumed:
        count = poses + (0 if existing is None else len(existing))
        mechanism = structured(mechanism, discrepancy=vectors_for(count))
    with one_blas_thread():
        measured = None if existing is None else measured_poses(mechanism, existing, sensor_noise)
        if measured is not None:
            mechanism = measured.start
        pool = _pool(mechanism, candidates, existing, settings)
        if len(pool.driven) < poses:
            raise too_few(len(pool.driven), pool.considered, pool.refused, poses)
        made = pooled(mechanism, pool, measured, sensor_noise, settings)
        best = choose(made.draws, poses, how, progress=progress)
        again = settings.repeats
        return _planned(mechanism, pool, made, best, existing, how, repeats=again, assumed=assumed)


@dataclass(frozen=True, eq=False)
class Measured:
    """Poses already measured; corrections: that close their loops; start: the mechanism with its
    instruments placed."""

    problem: Problem
    corrections: Array
    start: Mechanism


@dataclass(frozen=True, eq=False)
class Pooled:
    """What the candidates say: at the nominal machine first, then at further draws of its
    parameters; problem: the candidates as readings."""

    draws: tuple[Information, ...]
    problem: Problem


def _criterion(mechanism: Mechanism, stated: str | None) -> Criterion:
    how = stated or ("I" if mechanism.outputs else "D")
    if how not in CRITERIA:
        raise unknown_name(f"there is no criterion {how!r}", how, CRITERIA)
    if how in ("I", "G") and not mechanism.outputs:
        raise InputError(
            f"{mechanism.name!r} predicts no end point, which the criterion {how} needs",
            code="no-outputs",
            remedy="use criterion D or A",
        )
    return how  # type: ignore[return-value]


def measured_poses(mechanism: Mechanism, existing: Dataset, noise: Noise) -> Measured:
    """Poses already measured, as a plan adds to them."""
    machine, data = with_model(mechanism, existing, noise)
    problem = started(machine, data, noise, "auto")
    values = dict(zip(machine.parameters.names, problem.start.tolist(), strict=True))
    return Measured(problem, closed_corrections(problem), mechanism.with_nominal(values))


def _pool(
    mechanism: Mechanism,
    candidates: Dataset | Mapping[str, Any] | None,
    existing: Dataset | None,
    settings: PlanSettings,
) -> Candidates:
    if candidates is not None:
        stated = candidates if isinstance(candidates, Dataset) else Dataset.from_arrays(candidates)
        return stated_candidates(mechanism, stated, settings)
    ranges = ranges_of(mechanism, settings.ranges, existing)
    if existing is not None and not settings.occasions:
        settings = replace(settings, occasions=occasions(mechanism, existing))
    return drawn(mechanism, ranges, settings)


def pooled(
    mechanism: Mechanism,
    pool: Candidates,
    measured: Measured | None,
    noise: Noise,
    settings: PlanSettings,
) -> Pooled:
    """The information of candidates: at the nominal machine, and at draws from the prior where the
    equations depend on it."""
    tests = _tests(mechanism, pool, settings)
    first = _at(mechanism, pool, tests, measured, noise)
    draws = [first.information]
    rng = np.random.default_rng(settings.seed)
    some = np.unique(np.linspace(0, len(pool.driven) - 1, _LOOKED_AT).astype(np.intp))
    for number in range(_DRAWS):
        values = {
            p.name: p.nominal + p.prior_sd * float(rng.standard_normal())
            for p in mechanism.parameters
            if not p.fixed and np.isfinite(p.prior_sd)
        }
        if not values:
            break
        other = mechanism.with_nominal(values)
        if number == 0 and not _depends(first, other, pool.take(some), some, noise):
            break
        if reached(other, pool.driven).all():
            draws.append(_at(other, pool, tests, measured, noise).information)
    return Pooled(tuple(draws), first.problem)


@dataclass(frozen=True, eq=False)
class _Drawn:
    information: Information
    problem: Problem
    rows: Array


def _tests(mechanism: Mechanism, pool: Candidates, settings: PlanSettings) -> Candidates:
    """The poses whose end point counts."""
    if settings.region:
        ranges = ranges_of(mechanism, {**settings.ranges, **settings.region}, None)
        return drawn(mechanism, ranges, PlanSettings(number=TESTS, seed=settings.seed + 1))
    index = np.unique(np.linspace(0, len(pool.even) - 1, TESTS).astype(np.intp))
    return pool.take(pool.even[index])


def _problem(
    mechanism: Mechanism,
    driven: Dataset,
    noise: Noise,
    typical: Mapping[str, float],
    blank: Mapping[str, NDArray[np.bool_]],
) -> Problem:
    closed = closed_at(mechanism, driven, blank)
    return as_problem(mechanism, with_sds(closed, typical), noise)


def as_problem(mechanism: Mechanism, closed: Dataset, noise: Noise) -> Problem:
    """Closed candidates as readings of a calibration."""
    machine, data = with_model(mechanism, closed, noise)
    return build_problem(machine, data, noise, whole=False)


def _at(
    mechanism: Mechanism,
    pool: Candidates,
    tests: Candidates,
    measured: Measured | None,
    noise: Noise,
) -> _Drawn:
    typical = {} if measured is None else typical_sds(measured.problem)
    problem = _problem(mechanism, pool.driven, noise, typical, blank_in(pool.closed))
    rows = rows_of(problem, problem.start, np.zeros(problem.readings.shape))
    before = np.empty((0, *rows.shape[1:]))
    if measured is not None:
        parameters = problem.start
        before = rows_of(
            replace(measured.problem, start=parameters), parameters, measured.corrections
        )
    T, white = np.empty((0, 1, rows.shape[2])), 0.0
    if mechanism.outputs:
        some = tests.take(np.flatnonzero(reached(mechanism, tests.driven)))
        # The end point is anywhere; behind a camera there are no pixels of it.
        unseen = {
            q: blank
            for q, blank in blank_in(some.closed).items()
            if q not in mechanism.outputs or mechanism.quantities[q] == "px"
        }
        at = _problem(mechanism, some.driven, noise, typical, unseen)
        white = white_error(at)
        T = end_point_rows(at, at.start, at.readings, at.pose_constants)
    roles = [mechanism.roles.get(n, "placement") for n in problem.names]
    counts = np.array([role not in ("placement", "model error") for role in roles])
    stands = np.array([role == "placement" for role in roles])
    made = information(problem, rows, before, placed_anew(T, stands), counts, white)
    return _Drawn(made, problem, rows)


def _depends(
    first: _Drawn, other: Mechanism, pool: Candidates, some: NDArray[np.intp], noise: Noise
) -> bool:
    """Whether a draw of the parameters changes what these candidates say."""
    if not reached(other, pool.driven).all():
        return True
    problem = _problem(other, pool.driven, noise, {}, blank_in(pool.closed))
    rows = rows_of(problem, problem.start, np.zeros(problem.readings.shape))
    nominal_rows = first.rows[some] @ first.information.root
    drawn_rows = rows @ first.information.root
    return bool(np.linalg.norm(drawn_rows - nominal_rows) > _DEPENDS * np.linalg.norm(nominal_rows))


def _planned(
    mechanism: Mechanism,
    pool: Candidates,
    made: Pooled,
    best: Chosen,
    existing: Dataset | None,
    how: Criterion,
    *,
    repeats: bool,
    assumed: bool,
) -> Plan:
    draw, names = made.draws[0], made.problem.names
    chosen = list(best.poses)
    bound = certificate(made.draws, chosen, how)
    curve = expected_curve(draw, names, chosen, how)
    marked = to_validate(made.draws, chosen, how)
    shares = in_shares(pool.driven)[:, chosen]
    order = out_and_back(route(shares))
    again = (len(order) // 2, len(order)) if repeats and len(order) >= _RUN else ()
    use = [VALIDATE if chosen[i] in marked else CALIBRATE for i in order]
    for at in reversed(again):
        order.insert(at, order[0])
        use.insert(at, REPEAT)
    way, before = travel(shares, order), travel(shares, list(range(len(chosen))))
    ids = [int(name) for name in pool.driven.poses if name.isdecimal()]
    highest = max(ids, default=len(pool.driven))
    taken = _numbered(pool.take([chosen[i] for i in order]), highest)
    kept = [i for i in chosen if i not in marked]
    roles = mechanism.roles
    shown = [n for n in names if n in roles and roles[n] != "model error"]
    units = {n: mechanism.parameters[n].unit for n in shown}
    serves = serving(mechanism, taken.closed)
    named = {name for kind in serves for name in kind}
    idle = [f for f in mechanism.families if serves and f.name not in named]
    # What an instrument alone says is not expected of poses that it does not serve.
    aside = {n for f in idle for n in (*f.mounted, *f.standing)}
    fitted = expected_of(draw, names, draw.of(kept), len(kept))
    bends = np.array([roles.get(n) == "model error" for n in names])
    rigid = None
    if assumed and bends.any():
        unbent = draw.without(bends)
        rigid = expected_of(unbent, names, unbent.of(chosen), len(chosen))
    return Plan(
        taken.driven,
        taken.closed,
        tuple(use),
        0 if existing is None else len(existing),
        len(pool.driven),
        pool.considered,
        pool.refused,
        how,
        bound.efficiency,
        curve,
        fitted,
        random_sets(draw, names, pool.even, curve[-1]) if mechanism.outputs else None,
        way,
        way / before if before else 1.0,
        len(made.draws),
        end_point_unit(mechanism),
        units,
        _remarks(curve[-1].parameters, {n: u for n, u in units.items() if n not in aside}),
        rigid,
        serves,
        tuple(f.name for f in idle),
    )


def _remarks(sds: Mapping[str, float | None], units: Mapping[str, str]) -> tuple[str, ...]:
    loose = [n for n in units if sds[n] is None]
    if not loose:
        return ()
    return (
        f"These poses do not determine {', '.join(map(repr, loose))}. Plan more poses, widen the "
        "ranges, or state how well these are known ([prior]).",
    )


_CLOSE = 1e-3
"""Share of the criterion that the bound may still miss."""
# Floating-point operations spent on the bound: some seconds on one core.
_EFFORT = 1.5e10
_FEWEST, _MOST = 12, 400
# Of G: the step of the multiplicative weights of test poses is just below 1.
_PEAK = 60.0
_POWER, _GROWS, _STEEPEST = 0.5, 1.4, 8.0
# Measured: of 60,000 rows of 40 columns the products take a fifth of the time of one piece.
_AT_ONCE = 512
"""Rows that are multiplied at a time."""


@dataclass(frozen=True)
class Certificate:
    """bound: no choice of so many candidates has a smaller criterion; value: of the choice;
    efficiency: bound over value, of D the root of the ratio of determinants, at most 1."""

    value: float
    bound: float
    efficiency: float


def certificate(
    draws: Sequence[Information], chosen: Sequence[int], criterion: Criterion
) -> Certificate:
    """The bound for as many candidates as were chosen."""
    n = len(chosen)
    N = len(draws[0].rows)
    value = float(np.mean([criterion_value(d, d.of(list(chosen)), criterion) for d in draws]))
    # Begun half at the choice, half even: no weight is 0, from which a multiplicative step never
    # rises.
    w = np.full(N, 0.5 * n / N)
    w[list(chosen)] += 0.5
    w = _capped(w, n)
    work = 4.0 * draws[0].rows.size * draws[0].rows.shape[2] * len(draws)
    best, mix, power, before = -np.inf, None, _POWER, np.inf
    for _ in range(int(np.clip(_EFFORT / max(work, 1.0), _FEWEST, _MOST))):
        f, g, mix = _slopes(draws, w, criterion, mix)
        largest = np.partition(g, N - n)[N - n :].sum()
        # The inequality above holds at every w, so the best bound on the way counts.
        best = max(best, f - (float(largest) - float(w @ g)))
        if value - best <= _CLOSE * _scale(value, draws, criterion):
            break
        power = min(_GROWS * power, _STEEPEST) if f < before else _POWER
        mean, before = float(w @ g) / n, f
        w = _capped(w * np.power(np.maximum(g, 1e-12 * mean) / mean, power), n)
    best = min(best, value)
    if criterion == "D":
        q = draws[0].root.shape[1] - draws[0].nuisance.shape[1]
        return Certificate(value, best, float(np.exp((best - value) / max(q, 1))))
    return Certificate(value, best, max(best, 0.0) / value if value > 0.0 else 1.0)


def _scale(value: float, draws: Sequence[Information], criterion: Criterion) -> float:
    return float(draws[0].root.shape[1]) if criterion == "D" else value


def _capped(w: Array, n: int) -> Array:
    """Weights of this proportion, none above 1, that add up to n."""
    w = w * (n / w.sum())
    fixed = np.zeros(len(w), dtype=bool)
    while (over := (w > 1.0) & ~fixed).any():
        fixed |= over
        left = n - int(fixed.sum())
        rest = float(w[~fixed].sum())
        w = np.where(fixed, 1.0, w * (left / rest if rest > 0.0 else 0.0))
    return w


def _slopes(
    draws: Sequence[Information], w: Array, criterion: Criterion, mix: list[Array] | None
) -> tuple[float, Array, list[Array]]:
    """f, g (N,) at weights, and for G the weights of the test poses that make f linear."""
    f, g = 0.0, np.zeros(len(w))
    mixes: list[Array] = []
    for number, d in enumerate(draws):
        flat = d.rows.reshape(-1, d.rows.shape[2])
        each = np.repeat(w, d.rows.shape[1])[:, None]
        total = d.start + sum((flat[i] * each[i]).T @ flat[i] for i in _in_cache(len(flat)))
        C = inverse(total)
        if criterion == "D":
            f += criterion_value(d, total, criterion)
            V = d.nuisance
            # The slope of log det(V^T M V), what the nuisance parameters take up of it.
            inner = V @ inverse(V.T @ total @ V) @ V.T if V.shape[1] else 0.0
            H = C - inner
        elif criterion == "G":
            v = test_variances(d, C)
            now = np.full(len(v), 1.0 / len(v)) if mix is None else mix[number]
            now = now * np.exp(_PEAK / (1.0 + _PEAK) * (v / v.max() - 1.0))
            now = now / now.sum()
            mixes.append(now)
            aim = np.einsum("t,tok,tol->kl", now, d.tests, d.tests, optimize=True)
            f += float(now @ v)
            H = C @ aim @ C
        else:
            aim_of = linear_aim(d, criterion)
            assert aim_of is not None
            f += float((C * aim_of).sum())
            H = C @ aim_of @ C
        of_row = [np.einsum("ij,ij->i", flat[i] @ H, flat[i]) for i in _in_cache(len(flat))]
        g += np.concatenate(of_row).reshape(len(w), -1).sum(axis=1)
    return f / len(draws), g / len(draws), mixes


def _in_cache(rows: int) -> list[slice]:
    """Some rows after others, so few that products of them stay in the processor's cache."""
    return [slice(i, i + _AT_ONCE) for i in range(0, rows, _AT_ONCE)]


# 2-opt of dozens of poses settles in a few rounds; the bound keeps ties from going on forever.
_ROUNDS = 50


def route(joints: Array) -> list[int]:
    """Order of poses (j, n), the first one first; joints in shares of their ranges."""
    n = joints.shape[1]
    if n < 3:
        return list(range(n))
    away = np.abs(joints[:, :, None] - joints[:, None, :]).max(axis=0)
    order = _nearest(away)
    for _ in range(_ROUNDS):
        if not _uncrossed(order, away):
            break
    return order


def out_and_back(order: list[int]) -> list[int]:
    """Every second pose of a way, and back by the others."""
    return order[::2] + order[1::2][::-1]


def _numbered(taken: Candidates, highest: int) -> Candidates:
    """With ids of their own for poses that are measured again: beyond the candidates' numbers."""
    names = list(taken.driven.poses)
    for number, at in enumerate(i for i, name in enumerate(names) if name in names[:i]):
        names[at] = f"{highest + 1 + number}"
    driven, closed = (replace(d, poses=tuple(names)) for d in (taken.driven, taken.closed))
    return replace(taken, driven=driven, closed=closed)


def travel(joints: Array, order: list[int]) -> float:
    """Length of the way through the poses in this order."""
    at = joints[:, order]
    return float(np.abs(np.diff(at, axis=1)).max(axis=0).sum()) if at.shape[1] > 1 else 0.0


def _nearest(away: Array) -> list[int]:
    order, left = [0], set(range(1, len(away)))
    while left:
        near = min(left, key=lambda j: (away[order[-1], j], j))
        order.append(near)
        left.remove(near)
    return order


def _uncrossed(order: list[int], away: Array) -> bool:
    """Turn round parts of the way that are shorter so; whether any was."""
    n, changed = len(order), False
    for i in range(n - 2):
        at = np.array(order)
        a, b = at[i], at[i + 1]
        c = at[i + 2 :]
        after = np.append(at[i + 3 :], -1)
        # the way ends anywhere: turning round its end drops one link only
        old = away[a, b] + np.where(after >= 0, away[c, after], 0.0)
        new = away[a, c] + np.where(after >= 0, away[b, after], 0.0)
        j = int(np.argmax(old - new))
        if old[j] - new[j] > 1e-12:
            end = i + 2 + j
            order[i + 1 : end + 1] = order[i + 1 : end + 1][::-1]
            changed = True
    return changed
