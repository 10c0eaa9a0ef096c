"""The one way to understand the files that the nominal machine fits; or a question to the user."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from loopcal.errors import InputError, listed
from loopcal.files.recognition.fields import names_of
from loopcal.files.recognition.headers import words
from loopcal.files.recognition.joins import Fields
from loopcal.files.recognition.layouts import Layout
from loopcal.presentation.shown import significant
from loopcal.workflow.beginning.counting import Case
from loopcal.workflow.beginning.misplaced_rows import mixed_targets, swapped_targets
from loopcal.workflow.beginning.objections import contradiction, objection, shifted, unplaced
from loopcal.workflow.beginning.searching import (
    CLEARLY,
    NOTHING,
    PLAUSIBLE,
    Machine,
    Understood,
    closes,
    every_way,
    in_proportion,
)
from loopcal.workflow.beginning.weighing import CONVINCING, compared_joints, measured_only

USUAL = 0.02
"""A nominal machine misses its readings by a smaller share of their spread; units that a header
states and that leave more are doubted."""
_ATTAINED = frozenset(words("performance", "measured"))
_COMMANDED = frozenset(words("performance", "commanded")) | frozenset(
    words("columns", "unmeasured")
)

_MIXED = 4
"""Ways with joints in units of their own that are looked at closely."""

Ask = Callable[[str, Sequence[str]], int]
"""Asks which answer is right and returns its number, counted from 0."""


def undetermined(machine: Machine, layouts: Sequence[Layout]) -> InputError:
    """That no place of the instrument follows from the readings, and what they lack."""
    joints = layouts[0].joints if layouts else ()
    poses = max((int(np.isfinite(joint.values).sum()) for joint in joints), default=0)
    still = [
        name
        for name, joint in zip(machine.joints, joints, strict=False)
        if np.isfinite(joint.values).any() and not np.nanmax(joint.values) > np.nanmin(joint.values)
    ]
    follows = ""
    if poses < 5:
        words = f"{poses} poses are too few"
        remedy = "measure at least 5 poses, better 30; a project without readings plans them"
        follows = "loopcal init ROBOT --out planned"
    elif still:
        words = f"{listed(still)} stands still in all {poses} poses"
        remedy = "move it, or name a --base or --tip that leaves it out"
    elif machine.frame is not None and not closes(machine, layouts):
        words = "with the columns and units as they are, its loops do not close in most poses"
        remedy = (
            "check which column belongs to which joint, its sign and its zero, and the dimensions "
            "and the home of the machine"
        )
    elif set(machine.units) == {"m"}:
        words = "no joint turns, so nothing shows where the target is mounted"
        remedy = "begin with loopcal new, and state or fix the mounting in [mechanism.parameters]"
    else:
        words = f"{poses} poses were tried in all units and orders"
        remedy = "check that joints and instrument are of the same poses, and measure others"
    return InputError(
        f"the readings determine no place of the instrument: {words}",
        code="too-few-poses",
        remedy=remedy,
    ).then(follows)


def understood(
    machine: Machine,
    layouts: Sequence[Layout],
    fields: Fields,
    ask: Ask | None,
    ways: Sequence[Understood],
) -> Understood:
    """The meaning of the columns that the placed nominal machine fits clearly best.

    ask: asks where several fit; None refuses; ways: to read the columns, the best first.
    Raises InputError where none fits, several do, a stated unit contradicts the readings, or rows
    do not belong together.
    """
    ways = list(ways)
    if not ways or not ways[0].share <= USUAL:
        mixed = sorted(every_way(machine, layouts, mixed=True), key=lambda u: u.share)[:_MIXED]
        ways += [replace(u, seen=tuple(m.fitted(u.bodies) for m in u.seen)) for u in mixed]
        ways.sort(key=lambda u: u.share)
    case = Case(machine, layouts, fields, ways)
    if not ways or not ways[0].share <= USUAL:
        wrong = contradiction(case)
        if wrong is not None:
            raise wrong.error()
    if not ways:
        wrong = unplaced(case)
        raise undetermined(machine, layouts) if wrong is None else wrong.error()
    best = ways[0]
    if fields.by_order and (displaced := shifted(case, ways[:1])):
        raise displaced.error()
    if swapped := swapped_targets(best):
        raise swapped
    if best.share > USUAL and (two := mixed_targets(best)):
        raise two
    # Written so that NaN is not plausible either.
    if not best.share <= PLAUSIBLE:
        wrong = objection(case)
        if wrong is not None:
            raise wrong.error()
    near = [u for u in ways if u.share < min(max(CLEARLY * best.share, USUAL), NOTHING)]
    best, remarks = _joints_chosen(machine, near or [best], ask)
    rivals = [
        u
        for u in near
        if u is not best
        and u.layout.joints == best.layout.joints
        and u.layout.seen == best.layout.seen
        and u.share < CLEARLY * best.share
    ]
    # Slides and points in one wrong unit fit as well.
    best, *rivals = _in_proportion(machine, [best, *rivals])
    # Readings without noise: at such a misfit rounding alone separates the ways.
    if rivals and best.share > 1e-9:
        best = _asked([best, *rivals], ask)
    best = replace(best, seen=tuple(m.fitted(best.bodies) for m in best.seen))
    best, further = measured_only(machine, [best, *near], best)
    _refuse_out_of_plane(machine, best)
    return replace(best, remarks=(*remarks, *_alternatives(best, ways), *further))


def _refuse_out_of_plane(machine: Machine, way: Understood) -> None:
    """Raise InputError for readings in space, or of a mirrored frame, of a machine in a plane."""
    if machine.dimension == 3:
        return
    for meaning in way.seen:
        columns = names_of(meaning.seen.position)
        if meaning.seen.kind != "planar" or meaning.fit is None or meaning.fit.stands is None:
            error = InputError(
                f"{columns} are no x and y of a point, and the machine moves in a plane",
                code="unsupported",
                remedy="state x and y in the plane in which the machine moves, without z",
            )
            if meaning.seen.kind == "point":
                error.offering("--leave-out", meaning.seen.position[2].label)
            raise error
        if meaning.fit.stands[2, 2] < 0.0:
            raise InputError(
                f"{columns} form a left-handed frame: only mirrored the nominal machine fits",
                code="implausible-readings",
                remedy="the columns are exchanged, or one has the wrong sign: correct it. If the "
                "joints count the other way round, state all of them so with --joints",
            ).offering("--joints", ",".join(f"-{f.label}" for f in way.layout.joints))


def _in_proportion(machine: Machine, ways: list[Understood]) -> list[Understood]:
    """Of ways with slides in several units those in which the body moves about as far as the
    machine is long; all where none does, or where angles differ too."""
    each = [tuple(zip(way.units, way.kinds, strict=True)) for way in ways]
    if len({tuple(u for u, si in units if si != "m") for units in each}) > 1:
        return ways
    return in_proportion(machine, ways, [way.bodies.extent for way in ways])


def _alternatives(best: Understood, ways: Sequence[Understood]) -> tuple[str, ...]:
    """What else each inference could be, where that fits too: a sentence for each."""
    others = [u for u in ways if u.layout.joints == best.layout.joints and u.units != best.units]
    next_best = min(others, key=lambda u: u.share, default=None)
    likely = [(next_best.joint_words, next_best.share)] if next_best else []
    for meaning in best.seen:
        for other in best.others:
            if other.seen is meaning.seen:
                words = "; ".join(w for w in other.words if w not in meaning.words)
                likely.append((words, other.share))
    return tuple(
        f"Alternative, next best: {words}: misfit {significant(100.0 * share, 2)} %."
        for words, share in likely
        if words and share < max(CLEARLY * best.share, USUAL)
    )


def _joints_chosen(
    machine: Machine, near: Sequence[Understood], ask: Ask | None
) -> tuple[Understood, tuple[str, ...]]:
    """The way with the columns that are the joints, of those that fit the nominal machine about
    as well, and why.

    Of one set of joints the way that uses the most columns of instruments is taken: an angle that
    does not belong to a range would not fit. Raises InputError where several sets of joints fit as
    well and `ask` is None.
    """
    sets: dict[tuple[int, ...], Understood] = {}
    for way in sorted(near, key=_columns, reverse=True):
        sets.setdefault(tuple(map(id, way.layout.joints)), way)
    if len(sets) == 1:
        return next(iter(sets.values())), ()
    ways = [replace(w, seen=tuple(m.fitted(w.bodies) for m in w.seen)) for w in sets.values()]
    if set(machine.units) == {"m"}:
        # Slides and the points that they move look alike.
        ways.sort(key=lambda w: min(f.table for f in w.layout.joints))
        best = _asked(ways, ask)
        return next(w for w in sets.values() if w.layout.joints == best.layout.joints), ()
    compared = compared_joints(machine, [measured_only(machine, ways, w)[0] for w in ways])
    best = compared[0][1]
    near = [w for worse, w in compared[1:] if worse < CONVINCING]
    others = listed([names_of(w.layout.joints) for _, w in compared[1:]])
    if near:
        best = _measured_by_name([best, *near]) or _asked([best, *near], ask)
        words = "by their names: the readings do not distinguish them"
    else:
        words = "with the others the machine fits clearly worse, also once it is calibrated"
    chosen = next(w for w in sets.values() if w.layout.joints == best.layout.joints)
    return chosen, (f"The joints are {names_of(best.layout.joints)}, not {others}: {words}.",)


def _columns(way: Understood) -> tuple[int, float]:
    return sum(len((*s.position, *s.turned)) for s in way.layout.seen), -way.share


def _measured_by_name(ways: Sequence[Understood]) -> Understood | None:
    """The only one whose columns are named as measured, or not as commanded; else None."""

    def named(way: Understood, kind: frozenset[str]) -> bool:
        return all(kind & {*f.stem.split("_")} for f in way.layout.joints)

    for some in (
        [w for w in ways if named(w, _ATTAINED)],
        [w for w in ways if not named(w, _COMMANDED)],
    ):
        if len(some) == 1:
            return some[0]
    return None


def _asked(rivals: Sequence[Understood], ask: Ask | None) -> Understood:
    """The choice of the user among meanings that fit about as well.

    Raises InputError with all of them where `ask` is None.
    """
    common = set.intersection(*(set(u.words) for u in rivals))
    answers = [
        f"{'; '.join(w for w in u.words if w not in common) or u.layout.how} "
        f"(misfit {significant(100.0 * u.share, 2)} % of the spread of the readings)"
        for u in rivals
    ]
    if ask is not None:
        return rivals[ask("The readings fit in several ways. Which is right?", answers)]
    columns = [",".join(f.label for f in one.layout.joints) for one in rivals]
    error = InputError(
        f"the readings fit in {len(rivals)} ways: {' -- or -- '.join(answers[:4])}",
        code="unknown-unit",
        remedy='state units in the headers ("x [mm]", "J1 [deg]"), or name the columns of the '
        "joints with --joints, or columns that take no part with --leave-out",
    )
    raise error if len({*columns}) == 1 else error.offering("--joints", columns[0])
