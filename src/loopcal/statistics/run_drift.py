"""A drift of the instrument along the run, where the joints tell the order of the poses.

There a drift does what an error of the machine does, and no reading says which it is. So each place
of an instrument has a drift that is linear in the order of the poses, as a term whose sd is learnt.
What the poses cannot tell from the machine makes the machine's parameters uncertain. Predictions
are of the machine as the instrument saw it in the middle of the run.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from loopcal.errors import InputError
from loopcal.mechanisms.effects.drift import Drift
from loopcal.mechanisms.effects.effect import RUN_DRIFT, RUN_DRIFT_TURNS, with_effects
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.structure.structured import driven_joints
from loopcal.mechanisms.terms import Term
from loopcal.statistics.case import Case
from loopcal.statistics.changes import pose_numbers
from loopcal.statistics.run_order import told_by_joints

COLUMN = "share_of_run"
"""The known constant from -1/2 at the first pose to 1/2 at the last: no file has it."""
SDS = {"m": 1e-4, "rad": 1e-4}
"""Median of the learnt sd [SI]: by so much trackers and cameras drift in an hour or two."""
_NAMES = {"m": RUN_DRIFT, "rad": RUN_DRIFT_TURNS}
_WORDS = "the instrument drifts by {scale} over the run"


def with_run_drift(case: Case) -> Case:
    """The case with a drift of its instruments where the joints tell the order of the poses.

    Itself elsewhere, under a robust loss, and where an instrument cannot drift: one that compares
    two poses, or whose drift is modelled already.
    """
    mechanism, data = case.mechanism, case.data
    joints = [q for q in driven_joints(mechanism) if q in data.readings]
    if case.fit.robust_loss is not None or not joints:
        return case
    if told_by_joints(np.column_stack([data.readings[q] for q in joints])) is None:
        return case
    drift = Drift(drifting(mechanism), COLUMN, name=RUN_DRIFT, until=0.0)
    try:
        made = with_effects(mechanism, [drift])
    except InputError:
        return case
    by_unit: dict[str, list[str]] = {}
    for name in made.effects.get(RUN_DRIFT, ()):
        by_unit.setdefault(made.parameters[name].unit, []).append(name)
    terms = [Term(_NAMES[u], tuple(n), SDS[u], words=_WORDS) for u, n in by_unit.items()]
    numbers = pose_numbers(data)
    share = (numbers - numbers[0]) / (numbers[-1] - numbers[0]) - 0.5
    dated = data.with_readings({COLUMN: share}, units={COLUMN: "1"})
    return replace(case, mechanism=made.with_terms(*terms), data=dated)


def drifting(mechanism: Mechanism) -> tuple[str, ...]:
    """What drifts: the coordinates of each place of an instrument, or else the zeros of readings.

    A tracker that turns moves what it sees by less than it is far: its coordinates stand for that.
    """
    names: list[str] = []
    for family in mechanism.families:
        if family.form == "closure":
            continue
        placed = family.standing if family.placement is not None else ()
        lengths = [n for n in placed if mechanism.parameters[n].unit == "m"]
        names += lengths or [q for q in family.readings if q not in mechanism.turns]
    return tuple(dict.fromkeys(names or mechanism.outputs))
