"""Which of several columns was measured: sets of joints, and points that a controller computed.

Commanded joints and points fit the nominal machine to millimetres, as measured ones do. What tells
them apart is what remains once the machine's constants may move: chain constants p near their
drawing, the target u and the station S, t are estimated by

    min  sum |S (o(p) + R(p) u) + t - m|^2 / sigma^2 + |p - drawing|^2 / s^2

from the points m of one instrument. Two sets of joints differ by n log of the ratio of these sums,
twice a log likelihood. A computed point leaves no more than rounding; a commanded one fits the
drawing better than the machine that another instrument has measured.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.errors import InputError
from loopcal.estimation.mounted import Bodies, Mounted, bodies_of, evenly, origin_rms, see_points
from loopcal.estimation.problem.alignment import align
from loopcal.files.recognition.fields import names_of
from loopcal.files.recognition.meanings import Meaning
from loopcal.mechanisms.frame import ChainFrame
from loopcal.presentation.shown import with_unit
from loopcal.units import unit
from loopcal.workflow.beginning.searching import CLEARLY, Machine, Understood

CONVINCING = 10.0
"""Twice a log likelihood by which one set of joints has to be better (odds of 150 to 1)."""
MICROMETRES = 3e-6
"""Points that lie so near [m] what joints give were computed: no instrument on a robot does."""
AS_DRAWN = 5e-5
"""No robot follows its drawing to so little [m]; the best miss it by a tenth of a mm."""
COMPUTED = 0.02
"""Points in the machine's own base and on its own origin are off by a smaller share of the spread.
"""
_ROUNDING = 1.5
"""Computed points may leave so many times what rounding allows."""
_POSES, _ROUNDS = 120, 4
_OFF = {"length": 2e-3, "angle": 4e-3}
"""Sds [m, rad] of chain constants about their drawing: a few times those of real machines."""
_READ = 5e-5
"""The sd [m] of readings against which these weigh."""
_STEP = 1e-6


@dataclass(frozen=True, eq=False)
class Refined:
    """bodies: of the machine whose constants fit best, in all poses; rms: [m] per point; cost: the
    sum of squares that remains [m^2]; count: of coordinates.

    multiples: of coupled joints; rows: (N,) the poses that decided; left: (R,) residuals, those of
    the drawing behind those of the points; derivatives: (R, P) by all that is estimated;
    by_joints: (3N, n) of the points by the readings of joints.
    """

    bodies: Bodies
    rms: float
    cost: float
    count: int
    multiples: Array
    rows: NDArray[np.intp]
    left: Array
    derivatives: Array
    by_joints: Array


def refined(
    machine: Machine,
    way: Understood,
    meaning: Meaning,
    coupled: Sequence[tuple[str, str]] = (),
) -> Refined | None:
    """The machine that points of one instrument determine; None for other readings, and for too
    few poses.

    coupled: pairs of joints, of which the first moves by a multiple of the second too, to be
    estimated.
    """
    if not meaning.in_space or meaning.fit is None:
        return None
    readable = np.isfinite(meaning.position).all(axis=1) & way.bodies.complete
    rows = np.flatnonzero(readable)
    good = meaning.fit.away[rows] <= np.quantile(meaning.fit.away[rows], 0.9, method="higher")
    rows = evenly(rows[good], _POSES)
    chain = machine.mechanism.chain
    names = dict.fromkeys(step.parameter for step in chain if step.parameter)
    in_chain = [machine.mechanism.parameters[name] for name in names]
    nominal = {p.name: p.nominal for p in machine.mechanism.parameters}
    sds = np.array([_OFF.get(p.dimension, 1e-3) for p in in_chain])
    measured = meaning.position[rows]
    few = {name: q[rows] for name, q in way.joints.items()}

    def bodies(at: Array, read: Mapping[str, Array]) -> Bodies:
        """In all poses at one (P,) or several (k, P) sets of constants, one set after the other."""
        sets, count = np.atleast_2d(at), len(next(iter(read.values())))
        each = np.repeat(sets, count, axis=0).T
        moved = {p.name: p.nominal + d for p, d in zip(in_chain, each, strict=False)}
        q = {name: np.tile(values, len(sets)) for name, values in read.items()}
        for (name, other), k in zip(coupled, each[len(in_chain) :], strict=True):
            q[name] = q[name] + k * np.tile(read[other], len(sets))
        return bodies_of(ChainFrame(chain, q, nominal | moved), len(sets) * count)

    at = np.zeros(len(in_chain) + len(coupled))
    weight = np.concatenate([_READ / sds, np.zeros(len(coupled))])
    left, A = np.empty(0), np.empty((0, 0))
    try:
        for _ in range(_ROUNDS):
            begun, now = at, bodies(at, few)
            target = see_points(now, measured[None], 1).targets[0]
            missed, placement, S = _aligned(now, measured, target)
            # Columns of the placement stand beside them: it need not follow every constant.
            ahead = bodies(at + _STEP * np.eye(len(at)), few).at(target).reshape(len(at), -1, 3)
            moved_by = ((ahead - now.at(target)) @ S.T).reshape(len(at), -1).T / _STEP
            J = np.hstack([placement, moved_by])
            prior = np.hstack([np.zeros((len(at), placement.shape[1])), np.diag(weight)])
            rhs = np.concatenate([-missed, -weight * at])
            A = np.vstack([J, prior])
            step = np.linalg.lstsq(A, rhs, rcond=1e-12)[0]
            left = missed + J @ step
            at = at + step[placement.shape[1] :]
        by_joints = [
            _derivative(bodies(begun, {**few, name: q + _STEP}), measured, target, missed)
            for name, q in few.items()
        ]
    except (InputError, np.linalg.LinAlgError):
        return None
    penalty = float(np.square(weight * at).sum())
    squares = float(left @ left)
    rms = float(np.sqrt(3.0 * squares / max(left.size - 9, 1)))
    return Refined(
        bodies(at, way.joints),
        rms,
        squares + penalty,
        left.size,
        at[len(in_chain) :],
        rows,
        np.concatenate([left, weight * at]),
        A,
        np.hstack(by_joints),
    )


def _derivative(ahead: Bodies, measured: Array, target: Array, missed: Array) -> Array:
    """(3N, 1) how residuals, here `missed`, change to those a small step ahead."""
    shifted: Array = (_aligned(ahead, measured, target)[0] - missed)[:, None] / _STEP
    return shifted


def _aligned(bodies: Bodies, measured: Array, target: Array) -> tuple[Array, Array, Array]:
    """Residuals (3N,) of points placed by alignment, the columns of placement and target, and the
    rotation of the placement."""
    body = bodies.at(target)
    motion = align(body.T, measured.T)
    placed = body @ motion.rotation.T
    left = placed + motion.shift - measured
    J = np.zeros((len(body), 3, 9))
    # A small turn w moves v by w x v.
    for k, axis in enumerate(np.eye(3)):
        J[:, :, k] = np.cross(axis, placed)
    J[:, :, 3:6] = np.eye(3)
    J[:, :, 6:] = motion.rotation @ bodies.rotations
    return left.reshape(-1), J.reshape(-1, 9), motion.rotation


def computed(ways: Sequence[Understood], meaning: Meaning) -> tuple[float, bool] | None:
    """How near [m] points lie to what the joints of one of these ways give on the nominal machine,
    where they were computed from them; else None. The second says whether this is beyond doubt.

    Points in the machine's own base that lie on its own last origin are a controller's, though an
    instrument may have been set up so. Wherever it stands, none sees a machine as drawn.
    """
    if not meaning.in_space:
        return None
    doubtful = None
    for way in ways:
        fit = meaning.fitted(way.bodies).fit
        if fit is None:
            continue
        if fit.rms <= _allowed(way, meaning):
            return fit.rms, True
        off = origin_rms(way.bodies, meaning.position)
        if off < COMPUTED * fit.spread:
            doubtful = off, False
    return doubtful


def _allowed(way: Understood, meaning: Meaning) -> float:
    """What computed points may leave [m]: micrometres, or the rounding of both sides."""
    steps = [f.resolution() * unit(f.unit or meaning.length).factor for f in meaning.seen.position]
    lever = float(np.nanmax(np.linalg.norm(_about(way.bodies.origins), axis=1)))
    for f, kind, of in zip(way.layout.joints, way.kinds, way.units, strict=True):
        steps.append(f.resolution() * unit(of).factor * (lever if kind == "rad" else 1.0))
    # A rounded number is off by its step over the root of 12.
    rounding = float(np.sqrt(np.square(steps).sum() / 12.0))
    return max(MICROMETRES, min(_ROUNDING * rounding, AS_DRAWN))


def _about(points: Array) -> Array:
    off: Array = points - np.nanmean(points, axis=0)
    return off


def measured_only(
    machine: Machine, ways: Sequence[Understood], best: Understood
) -> tuple[Understood, tuple[str, ...]]:
    """The best way without points that were computed or commanded, and what to say of them."""
    if not any(m.in_space for m in best.seen):
        return best, ()
    remarks, kept = [], []
    for meaning in best.seen:
        near = computed(ways, meaning)
        if near is not None:
            remarks.append(
                f"{names_of(meaning.seen.position)} equal the nominal machine to "
                f"{with_unit(near[0], 'm', 2)}: computed by the controller, not measured"
            )
        if near is None or (len(best.seen) == 1 and not near[1]):
            kept.append(meaning)
    if not kept:
        raise InputError(
            f"no instrument has measured: {remarks[0]}",
            code="implausible-readings",
            remedy="name the file with the readings of an instrument too",
        )
    fits = {id(m): refined(machine, best, m) for m in kept} if len(kept) > 1 else {}
    bad = {
        i
        for i, other in enumerate(kept)
        if any(
            _commanded(best, m, fits[id(m)], other, fits[id(other)])
            for m in kept
            if m is not other and id(m) in fits
        )
    }
    for i in sorted(bad):
        remarks.append(
            f"{names_of(kept[i].seen.position)} follow the drawing, not the machine that other "
            "columns measured: commanded or computed"
        )
    kept = [m for i, m in enumerate(kept) if i not in bad]
    gone = [f for m in best.seen if m not in kept for f in (*m.seen.position, *m.seen.turned)]
    layout = replace(
        best.layout, seen=tuple(m.seen for m in kept), ignored=(*best.layout.ignored, *gone)
    )
    return replace(best, seen=tuple(kept), layout=layout), tuple(remarks)


def _commanded(
    way: Understood, meaning: Meaning, fit: Refined | None, other: Meaning, exact: Refined | None
) -> bool:
    """Whether other points follow the drawing (or another model) where this instrument shows that
    the machine does not."""
    if fit is None or exact is None:
        return False
    if other.seen.station:  # the same columns in other rows: measured as these are
        return False
    drawn, drawn_other = (_rms(m.fitted(way.bodies).fit) for m in (meaning, other))
    if drawn < CLEARLY * fit.rms:
        return False  # this instrument shows no deviation from the drawing
    if exact.rms <= _allowed(way, other) < fit.rms:
        return True  # exact, on constants of a controller
    on_it = _rms(other.fitted(fit.bodies).fit)
    return CLEARLY * drawn_other < on_it


def _rms(fit: Mounted | None) -> float:
    return fit.rms if fit else float("inf")


def compared_joints(machine: Machine, ways: Sequence[Understood]) -> list[tuple[float, Understood]]:
    """Sets of joints by what remains, the best first: twice a log likelihood less than the best."""
    costs = []
    for way in ways:
        fits = [refined(machine, way, m) for m in way.seen]
        costs.append(
            sum(f.count * float(np.log(max(f.cost, 1e-30))) for f in fits if f is not None)
        )
    least = min(costs)
    return sorted(
        ((cost - least, way) for cost, way in zip(costs, ways, strict=True)), key=lambda one: one[0]
    )
