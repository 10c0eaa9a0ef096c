"""The one way to understand the files that the nominal machine fits; or a question to the user."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from loopcal.errors import InputError, listed
from loopcal.estimation.mounted import origin_rms
from loopcal.files.recognition.fields import names_of
from loopcal.files.recognition.joins import Fields
from loopcal.files.recognition.layouts import Layout
from loopcal.presentation.shown import significant
from loopcal.workflow.beginning.objections import NOTHING, Case, contradiction, objection, shifted
from loopcal.workflow.beginning.searching import (
    CLEARLY,
    PLAUSIBLE,
    Machine,
    Understood,
    every_way,
)

USUAL = 0.02
"""A nominal machine misses its readings by a smaller share of their spread; units that a header
states and that leave more are doubted."""
COMPUTED = 0.02
"""Points that lie so near the machine's own nominal coordinates were computed from its joints."""

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
    if poses < 5:
        words, remedy = f"{poses} poses are too few", "measure at least 5 poses"
    elif still:
        words = f"{listed(still)} stands still in all {poses} poses"
        remedy = "move it, or name a --base or --tip that leaves it out"
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
    )


def understood(
    machine: Machine, layouts: Sequence[Layout], fields: Fields, ask: Ask | None
) -> Understood:
    """The meaning of the columns that the placed nominal machine fits clearly best.

    ask: asks where several fit; None refuses. Raises InputError where none fits, several do, a
    stated unit contradicts the readings, or rows do not belong together.
    """
    ways = sorted(every_way(machine, layouts), key=lambda u: u.share)
    case = Case(machine, layouts, fields, ways)
    if not ways or not ways[0].share <= USUAL:
        wrong = contradiction(case)
        if wrong is not None:
            raise wrong.error()
    if not ways:
        raise undetermined(machine, layouts)
    best = ways[0]
    if fields.by_order and (displaced := shifted(case, ways[:1])):
        raise displaced.error()
    # Written so that NaN is not plausible either.
    if not best.share <= PLAUSIBLE:
        wrong = objection(case)
        if wrong is not None:
            raise wrong.error()
    rivals = [u for u in ways[1:] if u.share < min(CLEARLY * best.share, NOTHING)]
    # Readings without noise: at such a misfit rounding alone separates the ways.
    if rivals and best.share > 1e-9:
        best = _asked([best, *rivals], ask)
    return _finished(best)


def _asked(rivals: Sequence[Understood], ask: Ask | None) -> Understood:
    """The choice of the user among meanings that fit about as well.

    Raises InputError with all of them where nobody can be asked.
    """
    common = set.intersection(*(set(u.words) for u in rivals))
    answers = [
        f"{'; '.join(w for w in u.words if w not in common) or u.layout.how} "
        f"(misfit {significant(100.0 * u.share, 2)} % of the spread of the readings)"
        for u in rivals
    ]
    if ask is not None:
        return rivals[ask("The readings fit in several ways. Which is right?", answers)]
    raise InputError(
        f"the readings fit in {len(rivals)} ways: {' -- or -- '.join(answers[:4])}",
        code="unknown-unit",
        remedy='state units in the headers ("x [mm]", "J1 [deg]"), or name the columns',
    )


def _finished(best: Understood) -> Understood:
    """With the fits of all poses, the computed instruments left out, and what the data decided."""
    seen = tuple(m.fitted(best.bodies) for m in best.seen)
    remarks = []
    kept = []
    for meaning in seen:
        names = names_of(meaning.seen.position)
        if meaning.seen.kind == "point" and meaning.fit is not None:
            off = origin_rms(best.bodies, meaning.position)
            if off < COMPUTED * meaning.fit.spread:
                size = f"{significant(1e3 * off, 2)} mm"
                remarks.append(
                    f"{names} equal the nominal machine's own coordinates to {size}: computed by "
                    "the controller, not measured"
                )
                if len(seen) > 1:
                    continue
        kept.append(meaning)
    return replace(best, seen=tuple(kept or seen), remarks=tuple(remarks))
