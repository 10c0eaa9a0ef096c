"""Which parameters no reading can distinguish, from the Jacobian at random poses.

A machine described joint by joint has more parameters than its motion shows: a shift along the
last axis does what the tool's length does. One of each such set has to be left at its nominal
value. Parameters are gone through in an order of preference. One is redundant where its change of
all readings is a combination of the changes by those kept before it:

    |c - K (K^+ c)| <= ALIKE |c|,   c its column of the Jacobian, K the columns kept so far.

Neither units nor steepness may decide, so the Jacobian is balanced first: each loop by its usual
size, then steeper poses of a loop (a camera close to its target), then each column. Rank does not
change by that.

Khalil and Gautier (1991) choose base parameters thus, by a QR decomposition; for serial arms
4 R + 2 P + 6 remain where a pose is measured (Mooring, Roth and Driels 1991).

Poses in which a mechanism is looked at before there are any readings: random ones.

Loops that predict a reading are looked at where the joints stand by chance. What touches by
construction, a ball in its socket, does so in few poses: from random ones the joints are moved,
by Newton's method, to where the gap is closed, the thing touched being placed within reach first.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from loopcal.arrays import Array
from loopcal.errors import InputError
from loopcal.expressions.engine import Stage, engine_for
from loopcal.mechanisms.limits import listed_joints, stated_limits
from loopcal.mechanisms.mechanism import PIXELS, Family, Mechanism
from loopcal.mechanisms.parameters import BEYOND
from loopcal.mechanisms.station import Station

ALIKE = 5e-5
"""Remainders below count as none. Of robots' URDFs with parameters of their axes, the largest that
must be none is 5e-6 (right angles written as 1.5708). The smallest that is some is 4e-4 (axes 0.4
mm apart). Without these parameters the two are 4e-12 and 6e-3."""
ROUNDING = 1e-14
"""A column this short beside others in its unit, of a plain number beside any, has no effect."""
# Chosen, not derived: what a calibrated machine differs from its drawing (5 mrad) leaves less.
EXCHANGED = 0.01
"""Share of a change that steps of other parameters may leave and still follow it."""
# Chosen, not derived: several times what machines differ from their drawings.
GUESSED = {"m": 4e-3, "rad": 0.05}
"""Prior sds from which a parameter is known worse than any dimension of a machine."""
# Chosen, not derived: far above rounding, far below `ALIKE`, of columns of length 1.
_NOTHING = 1e-9
# Rows and columns are scaled in turn; a rough balance is enough, because rank does not change.
_BALANCINGS = 4
# At most so many names in a sentence, and the least share of a combination that is worth a name.
_NAMED, _SHARE = 3, 1e-3
_TURNED = 3
"""Points that show every turn of a board."""


@dataclass(frozen=True)
class Redundant:
    """A parameter that others make superfluous: `instead` do together what it does.

    instead: empty where the parameter changes no reading at all.
    """

    parameter: str
    instead: tuple[str, ...]

    @property
    def words(self) -> str:
        """One sentence."""
        if not self.instead:
            return f"{self.parameter!r} is fixed: it changes no reading."
        named = [repr(name) for name in self.instead[:_NAMED]]
        if more := len(self.instead) - len(named):
            named.append(f"{more} more")
        if len(named) == 1:
            return f"{self.parameter!r} is fixed: indistinguishable from {named[0]}."
        together = f"{', '.join(named[:-1])} and {named[-1]}"
        return f"{self.parameter!r} is fixed: indistinguishable from a combination of {together}."


def fix_redundant(
    mechanism: Mechanism,
    *,
    keep: Sequence[str] = (),
    stated: Iterable[str] | None = None,
    readings: Mapping[str, Array] | None = None,
    unmeasured: Sequence[str] = (),
) -> Mechanism:
    """The mechanism with those parameters fixed that no readings could distinguish from others.

    What stays free is determined by readings in enough poses; `remarks` say why each of the
    others is fixed. Gone through are first those in `keep` (names or globs), which stay free in any
    case. Of an arm its instruments' parameters follow, then the joints' from base to tip. One is
    fixed where it does to the readings what those before it do together. Parameters with a prior
    sd are left free, and make room for others unless they are guessed (`GUESSED`). Joint zeros go
    ahead of all else of the joints: machines are mastered worse than they are machined, and a
    length in the place of a zero has its error, times the link. It is decided at the nominal
    values, at random poses within the joints' limits. A value of 0 of an arm's instruments is taken
    as unknown, as that of a target, and moved off; stated: names of those that are meant, unless
    they are guesses (default: all but what is free and 0; where a station stands never matters).

    Where readings must fit each other, as those of parallel machines, give them, quantity -> (N,)
    [SI], say those of a `Simulation`; unmeasured: names or globs of quantities without a sensor.

    Raises InputError for such a machine without readings, and for names that are not there.
    Source: Khalil and Gautier (1991).
    """
    if mechanism.home and readings is None:
        raise InputError(
            f"the quantities of {mechanism.name!r} cannot vary freely, because the loops "
            f"constrain them",
            code="undetermined-quantities",
            remedy="give consistent readings, such as readings=simulate(...).quantities",
        )
    kept = [name for key in keep for name in mechanism.parameters.matching(key)]
    chain = {step.parameter for step in (mechanism.tree.steps if mechanism.tree else ())}
    instrument_parameters = [
        p.name
        for p in mechanism.parameters
        if chain and p.name not in chain and p.role not in BEYOND
    ]
    if stated is None:
        stated = [p.name for p in mechanism.parameters if p.fixed or p.nominal != 0.0]
    # A guess of 0 is none of a value: a target there may sit on axes that then seem to do nothing.
    guesses = {n for n in guessed(mechanism) if mechanism.parameters[n].nominal == 0.0}
    believed = {*(n for n in stated if n not in guesses)}
    believed |= {n for f in mechanism.families for n in _station(f)}
    joints = listed_joints(mechanism)
    superfluous = redundant(
        mechanism,
        ranges=stated_limits(joints),
        first=[*kept, *instrument_parameters, *mechanism.parameters.of_role("zero")],
        unsure=[n for n in instrument_parameters if n not in believed],
        readings=readings,
        unmeasured=[q for key in unmeasured for q in mechanism.quantity_group(key)],
    )
    return without_redundant(mechanism, superfluous, but=kept)


def distinguished(mechanism: Mechanism) -> Mechanism:
    """The mechanism with those parameters fixed that their prior sds alone hold, in any poses.

    Prior knowledge keeps the others of a redundant set free in `fix_redundant`; poses are judged by
    what they could tell without it. Whatever is no dimension of the machine stays as it is, and so
    does a loop of the user's: its parameters are those that the user asks for.
    """
    drawn = [
        p.name
        for p in mechanism.parameters
        if not p.fixed and p.prior_sd < math.inf and p.role not in BEYOND
    ]
    if not drawn or mechanism.home or mechanism.tree is None:
        return mechanism
    flat = mechanism.parameters.with_prior(dict.fromkeys(drawn, math.inf))
    held = fix_redundant(mechanism.with_parameters(flat)).parameters
    names = [p.name for p in mechanism.parameters if held[p.name].fixed and not p.fixed]
    return mechanism.with_parameters(mechanism.parameters.with_fixed(names))


def _station(family: Family) -> tuple[str, ...]:
    """Where an instrument stands, or a board whose every turn shows: what of it, never matters."""
    if family.form == PIXELS and len(family.readings) < 2 * _TURNED:
        return ()
    return family.placement.parameters if isinstance(family.placement, Station) else ()


def redundant(
    mechanism: Mechanism,
    *,
    ranges: Mapping[str, tuple[float, float]] | None = None,
    first: Sequence[str] = (),
    unsure: Sequence[str] = (),
    unmeasured: Sequence[str] = (),
    readings: Mapping[str, Array] | None = None,
) -> tuple[Redundant, ...]:
    """The free parameters without prior that need not be estimated.

    A prior that is wider than `GUESSED` is no knowledge: what a parameter of `first` with such a
    prior does, no other need do.

    ranges: quantity -> limits [SI] of the random poses (half a turn or 0.5 m to either side);
    readings: quantity -> (N,) values [SI] in place of random ones, for machines whose quantities
    must fit each other; first: names to be kept before all others, which come in the mechanism's
    order; unsure: parameters whose nominal values say little, such as coordinates at 0; they are
    moved by chance or to where they can be touched; unmeasured: quantities without a sensor.
    """
    free = [p.name for p in mechanism.parameters if not p.fixed and math.isinf(p.prior_sd)]
    wide = guessed(mechanism)
    order = [n for n in dict.fromkeys((*first, *free)) if n in free or n in wide]
    if not free:
        return ()
    looked_at = samples(mechanism, ranges=ranges or {}, unsure=unsure, readings=readings or {})
    parts = [_columns(mechanism, sample, order, unmeasured) for sample in looked_at]
    units = [mechanism.parameters[name].unit for name in order]
    chosen = _chosen(order, units, np.concatenate(parts))
    superfluous = [one for one in chosen if one.parameter in free]
    return tuple(sorted(superfluous, key=lambda one: free.index(one.parameter)))


def guessed(mechanism: Mechanism) -> list[str]:
    """The parameters whose prior is wider than `GUESSED`."""
    return [
        p.name
        for p in mechanism.parameters
        if not p.fixed and GUESSED.get(p.unit, math.inf) <= p.prior_sd < math.inf
    ]


def without_redundant(
    mechanism: Mechanism, superfluous: Sequence[Redundant], *, but: Sequence[str] = ()
) -> Mechanism:
    """The mechanism with these parameters fixed and the reasons among its remarks.

    but: parameters that stay free all the same.
    """
    fixed = [r for r in superfluous if r.parameter not in set(but)]
    parameters = mechanism.parameters.with_fixed([r.parameter for r in fixed])
    remarks = (*mechanism.remarks, *(r.words for r in fixed))
    return replace(mechanism, parameters=parameters, remarks=remarks)


def exchanged(
    mechanism: Mechanism,
    names: Sequence[str],
    among: Sequence[str],
    *,
    readings: Mapping[str, Array] | None = None,
    unmeasured: Sequence[str] = (),
) -> Mapping[str, Array]:
    """Steps (m,) [SI] of the parameters `among` that do what a unit change of each name does.

    names: parameters, and quantities whose zero changes; readings, unmeasured: as in
    `fix_redundant`. They are the least squares |J v - c| over the poses. A name is left out where
    no step does the same.
    """
    joints = listed_joints(mechanism)
    looked_at = samples(mechanism, ranges=stated_limits(joints), unsure=(), readings=readings or {})
    zeros = [name for name in names if name in mechanism.quantities]
    others = [name for name in names if name not in zeros]
    parts = [_columns(mechanism, s, [*among, *others], unmeasured, zeros) for s in looked_at]
    columns = np.concatenate(parts)
    J, C = columns[:, : len(among)], columns[:, len(among) :]
    lengths = _or_one(np.linalg.norm(J, axis=0))
    steps = np.linalg.lstsq(J / lengths, C, rcond=_NOTHING)[0] / lengths[:, None]
    left = np.linalg.norm(C - J @ steps, axis=0)
    same = left <= EXCHANGED * np.linalg.norm(C, axis=0)
    every = zip([*others, *zeros], steps.T, same.tolist(), strict=True)
    return {name: step for name, step, followed in every if followed}


def _columns(
    mechanism: Mechanism,
    sample: Sample,
    names: Sequence[str],
    unmeasured: Sequence[str],
    zeros: Sequence[str] = (),
) -> Array:
    """The loops' balanced derivatives by these parameters, and by the zeros of these quantities
    behind them (loops * poses, n).

    Unmeasured quantities are eliminated.

    A pose without derivatives, outside the domain of a loop, has no part in it.
    """
    tape = mechanism.tape
    engine = engine_for(tape, tuple(names), sample.readings.shape[1])
    # Random poses may leave the domain of a loop; these are dropped below.
    with np.errstate(all="ignore"):
        values = engine.evaluate(sample.parameters, sample.readings, sample.pose_constants)
    J = values.by_parameter[:, sample.loops].transpose(2, 1, 0)
    X = values.by_quantity[:, sample.loops].transpose(2, 1, 0)
    J = np.concatenate([J, X[:, :, [tape.quantities.index(q) for q in zeros]]], axis=2)
    defined = np.isfinite(J).all(axis=(1, 2)) & np.isfinite(X).all(axis=(1, 2))
    J, X = _balanced(J[defined], X[defined])
    if unmeasured:
        U = X[:, :, [tape.quantities.index(q) for q in unmeasured]]
        # The unmeasured quantities take up whatever lies in the span of U: I - U U^+ projects it
        # out.
        J, _ = _balanced(J - U @ (np.linalg.pinv(U) @ J), X)
    return J.reshape(-1, len(names) + len(zeros))


def _balanced(J: Array, X: Array) -> tuple[Array, Array]:
    """Derivatives by parameters (N, m, n) and quantities (N, m, k), loops and poses balanced.

    Rows of a loop are divided by their usual length, longer ones by their own, in columns of equal
    length. A loop that rounding alone makes depend on parameters depends on none.
    """
    if not J.size:
        return J, X
    by_parameter, by_quantity = (
        np.median(np.abs(D).max(axis=2, initial=0.0), axis=0)[:, None] for D in (J, X)
    )
    J = np.where(by_parameter > ROUNDING * by_quantity, J, 0.0)
    rows, columns = np.ones((*J.shape[:2], 1)), np.ones(J.shape[2])
    for _ in range(_BALANCINGS):
        lengths = np.linalg.norm(J / columns, axis=2, keepdims=True)
        rows = _or_one(np.maximum(lengths, np.median(lengths, axis=0)))
        columns = _or_one(np.linalg.norm(J / rows, axis=(0, 1)))
    return J / rows, X / rows


def _or_one(lengths: Array) -> Array:
    return np.where(lengths > 0.0, lengths, 1.0)


def _chosen(names: Sequence[str], units: Sequence[str], columns: Array) -> tuple[Redundant, ...]:
    """Gram and Schmidt, in the order of the columns: kept columns are Q R, Q orthonormal."""
    norms = np.linalg.norm(columns, axis=0)
    alike = [[u == unit or unit == "1" for u in units] for unit in units]
    # Lengths compare within one unit only; a plain number has none to compare by.
    least = ROUNDING * np.where(alike, norms, 0.0).max(axis=1, initial=0.0)
    kept: list[int] = []
    Q, R = np.empty((len(columns), 0)), np.empty((0, 0))
    superfluous = []
    for i, name in enumerate(names):
        if norms[i] <= least[i]:
            superfluous.append(Redundant(name, ()))
            continue
        unit_column = columns[:, i] / norms[i]
        within = Q.T @ unit_column
        rest = unit_column - Q @ within
        again = Q.T @ rest  # twice is enough (Kahan and Parlett)
        within, rest = within + again, rest - Q @ again
        size = float(np.linalg.norm(rest))
        if size > ALIKE:
            kept.append(i)
            Q = np.column_stack([Q, rest / size])
            R = np.block([[R, within[:, None]], [np.zeros((1, len(R))), np.array([[size]])]])
            continue
        shares = np.linalg.solve(R, within)
        greatest = np.argsort(-np.abs(shares), kind="stable").tolist()
        leading = [k for k in greatest if abs(shares[k]) > _SHARE]
        leading[:_NAMED] = sorted(leading[:_NAMED])
        superfluous.append(Redundant(name, tuple(names[kept[k]] for k in leading)))
    return tuple(superfluous)


# [m, rad] off values that say little: large beside rounding, small beside any machine.
_OFF = 0.1
# Half a turn to either side covers every angle; half a metre is the stroke of a usual slide.
_SPAN = {"m": 0.5, "rad": math.pi}
# A gap [m] that counts as closed, Newton steps to it, and the longest of them [m, rad].
_CLOSED, _STEPS, _NEAR = 1e-9, 30, 0.3


@dataclass(frozen=True)
class Sample:
    """Some loops (their positions) at parameters (n,), readings (k, N) and constants (c, N)."""

    loops: Sequence[int]
    parameters: Array
    readings: Array
    pose_constants: Array


def samples(
    mechanism: Mechanism,
    *,
    ranges: Mapping[str, tuple[float, float]],
    unsure: Sequence[str],
    readings: Mapping[str, Array],
) -> list[Sample]:
    """What to look at: the loops that hold in any pose, and those of each thing that is touched.

    ranges, unsure, readings: see `redundancy.redundant`.
    """
    draw = np.random.default_rng(0)
    tape = mechanism.tape
    # Three times as many equations as parameters: rank is then that of generic poses.
    count = max(60, 3 * len(mechanism.parameters) // len(tape.loops))
    count = len(next(iter(readings.values()))) if readings else count
    values = dict(readings)
    for variable in mechanism.variables:
        if variable.name not in values:
            span = _SPAN.get(variable.unit, 1.0)
            limits = ranges.get(variable.first or variable.name, (-span, span))
            values[variable.name] = draw.uniform(*limits, count)
    nominal = {p.name: p.nominal for p in mechanism.parameters}
    nominal |= {name: nominal[name] + _OFF * draw.uniform(0.5, 1.0) for name in unsure}
    p = np.array([nominal[name] for name in tape.parameters])
    x = np.array([values[q] for q in tape.quantities])
    pose_constants = _measured(
        mechanism, p, x, {name: values[name] for name in tape.pose_constants}
    )
    touched = [f for f in mechanism.families if f.form == "gap"]
    apart = {loop for family in touched for loop in family.loops}
    free = [i for i, loop in enumerate(tape.loops) if loop not in apart]
    sampled = [Sample(free, p, x, pose_constants)] if free else []
    return [
        *sampled,
        *(_touching(mechanism, f, Sample([], p, x, pose_constants), unsure) for f in touched),
    ]


def _measured(mechanism: Mechanism, p: Array, x: Array, pose_constants: dict[str, Array]) -> Array:
    """The known constants, orientations as they would be measured: not half a turn away."""
    tape, size = mechanism.tape, x.shape[1]
    engine = engine_for(tape, (), size, ())
    for orientation in mechanism.orientations:
        turns = [tape.loops.index(turn) for turn in orientation.turns]
        read = x[[tape.quantities.index(turn) for turn in orientation.turns]]
        q = np.vstack([np.ones(size), np.zeros((3, size))])
        pose_constants |= orientation.written(q)
        values = engine.evaluate(p, x, np.array([*pose_constants.values()]), Stage.VALUES)
        q[1:] = 0.5 * (values.f[turns] + read)
        pose_constants |= orientation.written(q)
    return np.array([*pose_constants.values()]).reshape(-1, size)


def _touching(
    mechanism: Mechanism, family: Family, anywhere: Sample, unsure: Sequence[str]
) -> Sample:
    """Poses in which what touches does; poses as they are where none can be found."""
    tape, size = mechanism.tape, anywhere.readings.shape[1]
    loops = [tape.loops.index(loop) for loop in family.loops]
    involved = {name for i in loops for name in tape.depends_on()[i]}
    placed = [n for n in unsure if n in involved]
    joints = [q for q in mechanism.quantities if q in involved and q not in family.readings]
    engine = engine_for(tape, tuple(placed), size, tuple(joints))
    p, x = anywhere.parameters.copy(), anywhere.readings.copy()
    rows = [tape.quantities.index(q) for q in joints]
    x[[tape.quantities.index(q) for q in family.readings]] = 0.0

    if placed:  # the first pose touches
        where = [tape.parameters.index(name) for name in placed]
        for _ in range(_STEPS):
            values = engine.evaluate(p, x, anywhere.pose_constants)
            A = values.by_parameter[:, loops, 0].T
            p[where] -= np.linalg.pinv(A) @ values.f[loops, 0]
    spread = x[rows] - x[rows][:, :1]
    # Other poses begin near the first one, where a closed gap is within reach.
    x[rows] = x[rows][:, :1] + _NEAR * spread
    for _ in range(_STEPS):
        values = engine.evaluate(p, x, anywhere.pose_constants)
        U = np.moveaxis(values.by_quantity[:, loops], 2, 0).transpose(0, 2, 1)
        step = np.linalg.pinv(U) @ values.f[loops].T[:, :, None]
        x[rows] -= np.clip(step[:, :, 0].T, -_NEAR, _NEAR)
    values = engine.evaluate(p, x, anywhere.pose_constants)
    closed = np.abs(values.f[loops]).max(axis=0) < _CLOSED
    if closed.mean() < 0.5:
        return Sample(loops, anywhere.parameters, anywhere.readings, anywhere.pose_constants)
    return Sample(loops, p, x[:, closed], anywhere.pose_constants[:, closed])
