"""What a learnt model error does to the machine, joint by joint, at the measured poses.

Each effect is a function of the pose that is linear in the parameters of its term,

    u(q) = sum_i c_i h_i(q),    sd(u) = sqrt(h^T Cov h),

and is told where it is largest: by how much a joint gives way under gravity, and how far a gear is
out of round. A smooth discrepancy is told by its rms, and by the joints on which it depends.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from loopcal.arrays import Array
from loopcal.document.choice import TermEntry, TermPart
from loopcal.estimation.noise.term_scales import TermVariances
from loopcal.estimation.problem.problem import Problem
from loopcal.expressions.engine import LoopValues, engine_for
from loopcal.expressions.tape import Tape
from loopcal.expressions.trace import trace
from loopcal.mechanisms.effects.effect import RUN_DRIFTS
from loopcal.mechanisms.parameters import BEYOND
from loopcal.mechanisms.structure.sag import BASE, COUPLINGS, Column, Sag, Structure
from loopcal.mechanisms.structure.smooth import DISCREPANCY, Smooth
from loopcal.mechanisms.structure.structured import ORDERS
from loopcal.presentation.shown import enumerated, significant, with_unit

if TYPE_CHECKING:
    from loopcal.mechanisms.mechanism import Mechanism


# Chosen, not derived: an even function of six joints gives each a sixth.
_COUNTS = 0.2
"""Share of the variance of a smooth function from which a joint counts among its arguments."""
# Chosen, not derived.
_ALIKE = 0.95
"""Cosine from which two turns are alike: nine tenths of one, by variance, is the other."""
_NOTHING = 1e-12
"""So little [rad] is what the arithmetic leaves of a turn that is none."""
_TERMS = {DISCREPANCY: "m", "discrepancy_turns": "rad"}


@dataclass(frozen=True, eq=False)
class _Fitted:
    """Parameters by name, the covariance (n, n) of those estimated, readings of N poses [SI]."""

    values: Mapping[str, float]
    names: tuple[str, ...]
    covariance: Array
    readings: Mapping[str, Array]
    poses: tuple[str, ...]

    def sd(self, slopes: Mapping[str, float]) -> float:
        """Of a quantity with these derivatives by parameters."""
        h = np.array([slopes.get(name, 0.0) for name in self.names])
        return math.sqrt(max(float(h @ self.covariance @ h), 0.0))


def with_parts(
    terms: Sequence[TermEntry],
    problem: Problem,
    parameters: Array,
    corrections: Array,
    covariance: Array,
) -> tuple[TermEntry, ...]:
    """The terms with what each does; the largest first.

    parameters: (n_all,); corrections: (k, N); covariance: (n, n) of the estimated parameters [SI].
    """
    mechanism = problem.mechanism
    structure = mechanism.structure or Structure()
    read = dict(zip(mechanism.tape.quantities, problem.readings + corrections, strict=True))
    read |= dict(zip(mechanism.tape.pose_constants, problem.pose_constants, strict=True))
    at = _Fitted(
        dict(zip(mechanism.parameters.names, parameters.tolist(), strict=True)),
        problem.names,
        covariance,
        read,
        problem.poses,
    )
    parts_by_term: dict[str, list[TermPart]] = {}
    if structure.sag is not None:
        for name in dict.fromkeys(c.term for c in structure.columns):
            parts_by_term[name] = _under_gravity(
                at, structure.sag, [c for c in structure.columns if c.term == name]
            )
    parts_by_term["harmonics"] = [_out_of_round(at, joint) for joint in structure.joints]
    for name, unit in _TERMS.items():
        parts_by_term[name] = [
            part for smooth in structure.smooth.values() for part in _remaining(at, smooth, unit)
        ]
    for name in RUN_DRIFTS:
        parts_by_term[name] = _drifts(at, mechanism, name)
    return tuple(
        replace(
            term,
            parts=tuple(sorted(parts_by_term.get(term.name, ()), key=lambda part: -part.size)),
        )
        for term in terms
    )


def _under_gravity(at: _Fitted, arm: Sag, columns: Sequence[Column]) -> list[TermPart]:
    """By how much base and joints give way under gravity, or couplings are off."""
    joints = [j for j in arm.names if any(c.joint == j for c in columns)]
    read = (*arm.units, arm.payload) if arm.payload else tuple(arm.units)
    if not joints or not all(q in at.readings for q in read):
        return []

    def turns(x: Any, p: Any) -> list[Any]:
        link_turns = arm.link_turns(columns, x, p)
        # a tape needs a reading in every row, and some of these are zero in every pose
        return [component + x[read[0]] for j in joints for component in link_turns[j]]

    def along(x: Any, p: Any) -> list[Any]:
        link_turns = arm.link_turns(columns, x, p)
        return [sum(link_turns[j] @ np.array([x[name] for name in ways[j]]) for j in joints)]

    x = np.array([at.readings[q] for q in read])
    ways = {j: tuple(f"{j} along {axis}" for axis in "xyz") for j in joints}
    values = np.array(list(at.values.values()))
    link_turns = _evaluated(trace(turns, quantities=read, parameters=tuple(at.values)), values, x).f
    turned = (link_turns - x[0]).reshape(len(joints), 3, -1)
    sizes = np.nan_to_num(np.linalg.norm(turned, axis=1))
    poses = sizes.argmax(axis=1)
    largest = sizes.max(axis=1)
    # each joint in the pose where it gives way most, along the way it gives there
    ahead = np.zeros((len(joints), 3, len(joints)))
    for i in np.flatnonzero(largest > _NOTHING).tolist():
        ahead[i, :, i] = turned[i, :, poses[i]] / largest[i]
    names = tuple(name for j in joints for name in ways[j])
    tape = trace(along, quantities=read, pose_constants=names, parameters=tuple(at.values))
    directions: Array = ahead.reshape(len(names), -1)
    slopes = _evaluated(tape, values, x[:, poses], directions, at.names).by_parameter[:, 0]
    parts = []
    for i, joint in enumerate(joints):
        size, pose = float(largest[i]), int(poses[i])
        if not size > _NOTHING:
            continue
        sd = at.sd(dict(zip(at.names, slopes[:, i].tolist(), strict=True)))
        who = "the base" if joint == BASE else joint
        way = "about its axis" if columns[0].about_joint else "across its axis"
        way = "" if joint == BASE else f" {way}"
        across, coupled = not columns[0].about_joint, columns[0].term == COUPLINGS
        other = _same_way(at, arm, joint, pose, ahead[i, :, i]) if across else ""
        does = f"{who} gives way{way}"
        if other:
            does = f"{who}{way} or {other} about its axis gives way"
        does = f"the coupling of {joint} is off" if coupled else f"under gravity {does}"
        words = f"{does} by up to {_turn(size, sd, at.poses[pose])}"
        owners = (joint, other) if other else (joint,)
        parts.append(TermPart(owners, "rad", size, sd, at.poses[pose], words))
    return parts


def _same_way(at: _Fitted, arm: Sag, joint: str, pose: int, turned: Array) -> str:
    """The next joint, if the link ahead of it turns (3,) as that joint would by giving way: then
    these readings hardly show which of the two does."""
    x = {q: float(read[pose]) for q, read in at.readings.items()}
    behind = arm.next_axis(joint, x, at.values)
    if behind is None:
        return ""
    name, axis = behind
    return name if abs(float(turned @ axis)) > _ALIKE else ""


def _evaluated(
    tape: Tape,
    values: Array,
    x: Array,
    pose_constants: Array | None = None,
    names: tuple[str, ...] = (),
) -> LoopValues:
    """A tape at readings x (k, N) and known constants (c, N), with derivatives by parameters."""
    engine = engine_for(tape, names, x.shape[1], ())
    return engine.evaluate(
        values, x, np.empty((0, x.shape[1])) if pose_constants is None else pose_constants
    )


def _out_of_round(at: _Fitted, joint: str) -> TermPart:
    """By how much a joint turns by more or less than its encoder says."""
    q = at.readings[joint]
    h: dict[str, Array] = {}
    for k in ORDERS:
        h |= {f"{joint}_cos{k:g}": np.cos(k * q), f"{joint}_sin{k:g}": np.sin(k * q)}
    off = np.abs(sum((at.values[name] * row for name, row in h.items()), np.zeros(len(q))))
    pose = int(np.argmax(np.nan_to_num(off)))
    sd = at.sd({name: float(row[pose]) for name, row in h.items()})
    size = float(off[pose])
    words = f"gear or encoder of {joint} is off by up to {_turn(size, sd, at.poses[pose])}"
    return TermPart((joint,), "rad", size, sd, at.poses[pose], words)


def _drifts(at: _Fitted, mechanism: Mechanism, term: str) -> list[TermPart]:
    """By how much each coordinate of an instrument drifts over the run."""
    members = {name for one in mechanism.terms if one.name == term for name in one.parameters}
    parts = []
    for p in (p for p in mechanism.parameters if p.name in members and p.name in at.names):
        size = at.values[p.name]
        words = f"{p.changes} drifts by {_shown(size, p.unit)} over the run"
        parts.append(TermPart((p.changes,), p.unit, abs(size), at.sd({p.name: 1.0}), None, words))
    return parts


def _shown(size: float, si: str) -> str:
    return with_unit(size, si, 2) if si == "m" else f"{significant(1e3 * size, 2)} mrad"


def _remaining(at: _Fitted, smooth: Smooth, unit: str) -> list[TermPart]:
    """How large a smooth discrepancy is, and on which joints it depends."""
    axes = ("x", "y", "z") if unit == "m" else ("rx", "ry", "rz")
    rows = [smooth.coefficients(axis) for axis in axes]
    rows = [row for row in rows if row and row[0] in at.values]
    if not rows:
        return []
    features = np.array(smooth.features(at.readings))
    # what is the same everywhere belongs to the placement
    features -= features.mean(axis=1, keepdims=True)
    c = np.array([[at.values[name] for name in row] for row in rows])
    f = c @ features
    size = math.sqrt(float(np.square(f).sum(axis=0).mean()))
    if not size > 0.0:
        return []
    slopes = (f @ features.T) / (f.shape[1] * size)
    names = [name for row in rows for name in row]
    sd = at.sd(dict(zip(names, slopes.ravel().tolist(), strict=True)))
    joints = _depends_on(at, smooth, c)
    where = "all joints" if set(joints) == set(smooth.joints) else enumerated(joints)
    of_body = f" of {smooth.body}" if smooth.body else ""
    words = f"what remains unexplained{of_body}: {_shown(size, unit)} rms, smooth in {where}"
    return [TermPart(joints, unit, size, sd, None, words)]


def _depends_on(at: _Fitted, smooth: Smooth, c: Array) -> tuple[str, ...]:
    """The joints of which a smooth function c F(q) is a function, by Sobol's total indices.

    T_d = E |f(q) - f(q')|^2 / (2 var f), q' as q with the reading of joint d from another pose
    (Jansen 1999). It is the share of the variance that goes where the other joints are known.
    """
    q = {joint: at.readings[joint] for joint in smooth.joints}
    f = c @ np.array(smooth.features(q))
    spread = float(f.var(axis=1).sum())
    # One permutation for all joints: shares then differ by joint, not by draw.
    other = np.random.default_rng(0).permutation(f.shape[1])
    share = {}
    for joint, reading in q.items():
        off = f - c @ np.array(smooth.features(q | {joint: reading[other]}))
        share[joint] = float(np.square(off).sum(axis=0).mean()) / (2.0 * spread)
    counts = [joint for joint in smooth.joints if share[joint] >= _COUNTS]
    return tuple(counts) or smooth.joints


def _turn(size: float, sd: float, pose: str) -> str:
    return f"{significant(1e3 * size, 2)} mrad (sd {significant(1e3 * sd, 2)} mrad, pose {pose})"


# What a calibration says of each term: the scale it learnt, how sure, and what it gains.

_QUANTILE = 1.959963984540054
"""Of the normal distribution, for 95 %."""
Worth = Callable[[TermVariances, int, Sequence[int]], float]
"""Of a term, where others are absent: `gain` or `support`."""


def term_entries(mechanism: Mechanism, learnt: TermVariances) -> tuple[TermEntry, ...]:
    """What the last linearisation says of each term, as a document holds it.

    The interval is from the curvature of the criterion by the logarithm of the scale.
    """
    system, at, sds, present = learnt.system, learnt.at, learnt.sds, learnt.beside_noise
    entries = []
    for i, term in enumerate(system.terms):
        unit = mechanism.parameters[term.parameters[0]].unit
        # The sds are those of log sd^2, twice those of log sd.
        scale, spread = float(at.scales[i]), math.exp(0.5 * _QUANTILE * sds[1 + i])
        words = term.words or f"{term.name} deviate from nominal by {{scale}} (sd)"
        entries.append(
            TermEntry(
                term.name,
                unit,
                scale,
                (scale / spread, scale * spread),
                term.sd,
                int((system.owner == i).sum()),
                max(float(at.freedom[i]), 0.0),
                gain(present, i),
                words.replace("{scale}", with_unit(scale, unit, 2, fine=True)),
                tuple(n for n in term.parameters if mechanism.roles.get(n) in BEYOND),
            )
        )
    return tuple(entries)


def idle(
    learnt: TermVariances, least: float, worth: Worth, *, keep: Collection[str] = ()
) -> set[str]:
    """The terms that are worth at most so much, taken out one after the other, the idlest first.

    Of two that say the same each gains nothing beside the other: one stays. worth: `gain` or
    `support`; keep: terms that do.
    """
    system, present = learnt.system, learnt.beside_noise
    absent: dict[int, str] = {}
    while True:
        worths = {
            i: worth(present, i, [*absent])
            for i, term in enumerate(system.terms)
            if term.name not in keep and i not in absent
        }
        i = min(worths, key=lambda k: worths[k], default=-1)
        if i < 0 or worths[i] > least:
            return {*absent.values()}
        absent[i] = system.terms[i].name
        present = present.without([*absent])


def gain(present: TermVariances, term: int, absent: Sequence[int] = ()) -> float:
    """By how much the criterion is lower with a term than without it, others being absent.

    present: with all terms, and all noise free to have a factor. Without a term the other terms and
    that factor make up for it where they can.
    """
    without, at = present.without([*absent, term]).at, present.at
    lower = without.criterion - at.criterion
    return lower - float(without.penalties[term] - at.penalties[term])


def support(present: TermVariances, term: int, absent: Sequence[int] = ()) -> float:
    """2 log of how much more probable the readings are with a term than without it.

    Of its scale all that its prior expects counts, not the best alone: with z the log of the scale
    and sd(z) by the curvature, the integral over z is L p(z) sd(z) (2 pi)^(1/2) (Laplace), so

        support = gain - ((z - log median)/spread)^2 + 2 log(sd(z)/spread).

    Readings that say nothing of a term leave it at 0, such as show that there is none far below.
    Arguments as in `gain`. Kass and Raftery 1995.
    """
    sd = 0.5 * float(present.sds[1 + term]) / present.system.terms[term].spread
    return gain(present, term, absent) - float(present.at.penalties[term]) + 2.0 * math.log(sd)
