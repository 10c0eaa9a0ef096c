"""Where the instrument sees the machine stand: the best rigid motion between two point sets."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from loopcal.arrays import Array
from loopcal.errors import InputError
from loopcal.estimation.prediction import output_differences
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.solve.sweep import Sweeper
from loopcal.expressions.engine import Stage
from loopcal.mechanisms.mechanism import Family, Mechanism, Placement
from loopcal.mechanisms.outputs import POLAR, point_outputs, points

# Chosen, not derived: outside any machine that fits on a floor, so that all its points are ahead.
ASIDE = 10.0
"""Where a station that reads angles is thought to stand until it is placed [m]."""
# docs/decisions/0023.
TURNED = math.pi / 4.0
"""From a placement in the plane that is off by more [rad], fits may end at negative lengths."""
# docs/decisions/0052 for the first.
_GROSS, _ROUNDS = 10.0, 10
"""Points so many times as far off as the middle one say nothing of where an instrument stands."""


@dataclass(frozen=True)
class RigidMotion:
    """p -> rotation @ p + shift; rms: of what it leaves [m]."""

    rotation: Array
    shift: Array
    rms: float


def align(points: Array, targets: Array) -> RigidMotion:
    """The rotation and shift that bring points (d, N) nearest to targets (d, N), d = 2 or 3.

    Least squares by singular values; columns with NaN are left out. Source: Kabsch (1976),
    Umeyama (1991). Raises InputError if fewer than d points are left, or they coincide.
    """
    return _aligned(*_complete(points, targets))


def _aligned(P: Array, T: Array) -> RigidMotion:
    """The same where no number is missing."""
    d = len(P)
    if P.shape[1] < d:
        raise InputError(
            f"{P.shape[1]} measured points are too few to place the instrument",
            code="too-few-poses",
            remedy=f"measure at least {d} points, or start from the nominal placement",
        )
    R, shift, s = _nearest(P, T)
    # d - 1 directions are enough: det = 1 gives the last axis of a rotation.
    if s[d - 2] <= 1e-9 * max(float(s[0]), 1e-300):
        raise InputError(
            "the measured points coincide or lie on a line, so they do not determine the "
            "instrument's orientation",
            code="too-few-poses",
            remedy="measure poses that spread in space, or start from the nominal placement",
        )
    left = R @ P + shift[:, None] - T
    return RigidMotion(R, shift, float(np.sqrt(np.square(left).sum(axis=0).mean())))


def align_most(points: Array, targets: Array) -> RigidMotion:
    """`align` without gross errors: points that are then far off beside the middle one.

    They are found by repetition, as one of them may turn and shift all others.
    """
    P, T = _complete(points, targets)
    for _ in range(_ROUNDS):
        if P.shape[1] < len(points):
            break
        R, shift, _ = _nearest(P, T)
        off = np.abs(R @ P + shift[:, None] - T).max(axis=0)
        good = off <= _GROSS * np.median(off)
        if good.all():
            break
        P, T = P[:, good], T[:, good]
    return _aligned(P, T)


def _complete(points: Array, targets: Array) -> tuple[Array, Array]:
    """Both without the columns in which a number is missing."""
    good = np.isfinite(points).all(axis=0) & np.isfinite(targets).all(axis=0)
    return points[:, good], targets[:, good]


def _nearest(P: Array, T: Array) -> tuple[Array, Array, Array]:
    """Rotation and shift that bring P nearest to T, and the singular values that tell of it."""
    centre_p, centre_t = P.mean(axis=1), T.mean(axis=1)
    U, s, Vt = np.linalg.svd((T - centre_t[:, None]) @ (P - centre_p[:, None]).T)
    signs = np.ones(len(P))
    signs[-1] = np.sign(np.linalg.det(U @ Vt))  # a rotation, not a reflection
    R = (U * signs) @ Vt
    return R, centre_t - R @ centre_p, s


def can_be_placed(mechanism: Mechanism) -> bool:
    """Whether the start may be moved: all placement parameters are free and have flat priors."""
    placements = [placement for _, placement in _stations(mechanism)]
    parameters = [mechanism.parameters[name] for p in placements for name in p.parameters]
    return bool(parameters) and all(not p.fixed and np.isinf(p.prior_sd) for p in parameters)


def sought(mechanism: Mechanism) -> tuple[tuple[str, ...], ...]:
    """The parameters of each place on a body from which points are read: no drawing states it,
    and readings say where a fit begins."""
    standing = {family.standing: None for family, _ in _stations(mechanism)}
    return tuple(
        names
        for names in standing
        if names
        and all(
            (p := mechanism.parameters[name]).role == "mounting"
            and not p.fixed
            and np.isinf(p.prior_sd)
            for name in names
        )
    )


def begun(problem: Problem, start: str | Mapping[str, float]) -> Mechanism:
    """The machine where a fit with this start begins: as stated, or placed.

    "auto" places a machine whose placement is free: one that instruments look at, or an own loop
    in space. One in the plane stays where it was stated, unless it is turned far away: a fit from
    there would end at the mirrored machine, with negative lengths.
    """
    mechanism = problem.mechanism
    if start == "align":
        return placed(problem)[0]
    if start != "auto" or not can_be_placed(mechanism):
        return mechanism
    if mechanism.families or len(mechanism.outputs) == 3:
        return placed(problem)[0]
    try:
        machine, motion = placed(problem)
    except InputError:  # too few points: not known to be turned
        return mechanism
    # A rotation of the plane by an angle a has the trace 2 cos a.
    return machine if np.trace(motion.rotation) < 2.0 * math.cos(TURNED) else mechanism


def placed(problem: Problem) -> tuple[Mechanism, RigidMotion]:
    """The nominal machine moved to where each instrument that reads points sees it.

    As `placed_values`.
    """
    values, motion = placed_values(problem)
    return problem.mechanism.with_nominal(values), motion


def placed_values(problem: Problem) -> tuple[dict[str, float], RigidMotion]:
    """All parameters of the nominal machine where each instrument that reads points sees it.

    Gross errors take no part. An instrument without readings stays at its nominal place, unless
    none has any. The motion is that of the last of them. Raises InputError if the
    mechanism cannot say how its parameters change with its placement.
    """
    mechanism = problem.mechanism
    stations = _stations(mechanism)
    if not stations:
        raise InputError(
            f"the mechanism {mechanism.name!r} cannot be placed by aligning points",
            code="unsupported",
            remedy='start from the nominal parameters (fit.start = "nominal")',
        )
    begun = dict(zip(mechanism.parameters.names, problem.start.tolist(), strict=True))
    values = dict(begun)
    for family, placement in stations:
        if family.form in POLAR:  # angles to a machine that stands over its station are none
            aside = np.full(len(family.readings), ASIDE)
            values = placement.moved(values, np.eye(len(aside)), aside)
    alike: dict[tuple[str, ...], list[tuple[Array, Array, Placement]]] = {}
    for family, computed, measured in seen_points(problem, np.array(list(values.values()))):
        stands = _placement(mechanism, family)
        assert stands is not None
        alike.setdefault(stands.parameters, []).append((computed, measured, stands))
    if all(_lost(computed, measured) for s in alike.values() for computed, measured, _ in s):
        reason = open_loops(problem)
        if reason is not None:
            raise reason
    together = {
        names: (np.hstack([s[0] for s in seen]), np.hstack([s[1] for s in seen]))
        for names, seen in alike.items()
    }
    read = {names: seen for names, seen in together.items() if _complete(*seen)[0].size}
    for names, (computed, measured) in (read or together).items():
        motion = align_most(computed, measured)
        values = alike[names][0][2].moved(values, motion.rotation, motion.shift)
    values |= {name: begun[name] for names in together.keys() - read.keys() for name in names}
    return values, motion


def _lost(computed: Array, measured: Array) -> bool:
    """Whether the loops give no more than a few of the points (d, N) that were measured."""
    read, closed = (np.isfinite(p).all(axis=0).sum() for p in (measured, computed))
    return bool(closed < len(computed) <= read)


def seen_points(problem: Problem, parameters: Array) -> list[tuple[Family, Array, Array]]:
    """Points (d, N) [m] computed at parameters (n_all,) and measured, by instrument that can be
    placed; NaN where one of them is not known."""
    mechanism = problem.mechanism
    stations = _stations(mechanism)
    if not stations:
        return []
    differences = output_differences(problem, parameters)
    by_family = []
    for family, _ in stations:
        outputs = point_outputs(mechanism, family)
        measured = problem.readings[[mechanism.tape.quantities.index(q) for q in outputs]]
        computed = measured + differences[[mechanism.outputs.index(q) for q in outputs]]
        by_family.append((family, points(family, computed), points(family, measured)))
    return by_family


def _stations(mechanism: Mechanism) -> list[tuple[Family, Placement]]:
    """The instruments that read points, with what tells where they stand."""
    if not mechanism.families:
        if mechanism.placement is None or len(mechanism.outputs) not in (2, 3):
            return []
        return [(Family("", mechanism.tape.loops, mechanism.outputs), mechanism.placement)]
    placements = [(family, _placement(mechanism, family)) for family in mechanism.families]
    return [(f, p) for f, p in placements if p is not None and point_outputs(mechanism, f)]


def _placement(mechanism: Mechanism, family: Family) -> Placement | None:
    """What tells where an instrument stands: the machine's own, where there is no other."""
    return (mechanism.placement if len(mechanism.families) <= 1 else None) or family.placement


# Loops of a machine itself that its readings and dimensions leave open, in words.

# Chosen, not derived: below the noise of any instrument, above what closing leaves.
_OPEN = 1e-6
"""Loops that stay this far from zero [m, rad] are open."""


def open_loops(problem: Problem) -> InputError | None:
    """What to say where the loops without any instrument cannot close from the parameters' start.

    Readings are held, and what nobody reads is searched from home; None where all loops close,
    or where there are more of them than unread quantities, which then need not agree.
    """
    mechanism = problem.mechanism
    seen = {loop for family in mechanism.families for loop in family.loops}
    names, poses, worst = mechanism.tape.loops, 0, (0.0, "", "")
    inputs = mechanism.tape.depends_on("quantity")
    for pattern in problem.patterns:
        loops = tuple(i for i in pattern.loops if names[i] not in seen)
        present = frozenset().union(*(inputs[i] for i in loops))
        unread = tuple(i for i in pattern.unmeasured if mechanism.tape.quantities[i] in present)
        if not loops or len(unread) != len(loops):
            continue
        alone = replace(pattern, loops=loops, unmeasured=unread)
        sweeper = Sweeper(replace(problem, patterns=(alone,)))
        index = np.arange(len(problem.poses))[pattern.poses]
        for begin in range(0, len(index), problem.block):
            some = index[begin : begin + problem.block]
            start = np.zeros((len(problem.readings), len(some)))
            block = sweeper.searched(alone, sweeper.block(alone, some, problem.start, start))
            values = sweeper.loop_values(alone, block, Stage.VALUES)
            f = np.abs(values.f)
            gap = f.max(axis=0)
            poses += int((gap > _OPEN).sum())
            most = int(gap.argmax())
            if gap[most] > worst[0]:
                loop = names[loops[int(f[:, most].argmax())]]
                worst = (float(gap[most]), loop, problem.poses[int(some[most])])
    if not poses:
        return None
    return InputError(
        f"the machine's loops cannot close in {poses} poses with its nominal dimensions: at pose "
        f"{worst[2]!r} the loop {worst[1]!r} stays {worst[0]:.3g} away from zero",
        code="open-loops",
        remedy="check the units of the readings and the nominal values of the parameters in that "
        "loop, above all lengths and offsets; check that `home` is near the measured poses",
    )
