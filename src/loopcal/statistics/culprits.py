"""What is at fault where images do not fit: the robot, the lens or the board.

Each is freed alone, with its priors, while all else is held as stated; where things stand is always
free. The same images are left out as in the choice of a method, so what predicts them better than
the machine as stated has what the statement lacks. The chosen calibration has all of them freed.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

from loopcal.document.choice import Candidate
from loopcal.execution.executor import Executor
from loopcal.mechanisms.mechanism import PIXELS
from loopcal.statistics.case import Case, Entrant, instruments_alone, nominal_case, unstated_lenses
from loopcal.statistics.gain import Gain
from loopcal.statistics.judged import Judged, fitted
from loopcal.statistics.risks import risk_of
from loopcal.statistics.validation import Plan, left_out, pooled

PARTS = {"lens": "lens", "print": "board"}
"""By the role of a parameter what it belongs to; the rest is the robot's."""


def culprits(
    case: Case,
    judged: Sequence[Judged],
    taken: Judged,
    plan: Plan,
    moved: Collection[str] = (),
    executor: Executor | None = None,
) -> tuple[Candidate, ...]:
    """The machine as stated, it with each of these freed, and the chosen calibration.

    judged: the candidates of the choice, with the nominal machine; moved: parameters of what
    slipped during the run. Differences are to the machine as stated. Empty for a machine without
    cameras, and where the nominal machine was not validated.
    """
    held = next((one for one in judged if one.entrant.drawn and one.made), None)
    if held is None or not any(f.form == PIXELS for f in case.mechanism.families):
        return ()
    freed, plan = _freed(case, moved), replace(plan, blocked=None)
    if not freed:
        return ()
    alone = [fitted(Entrant(name, one)) for name, one in freed.items()]
    able = [(one.entrant.case, one.whole) for one in alone if one.whole and not one.failed]
    made = iter(left_out(able, plan.indices, executor, stepped=True))
    alone = [one if one.failed else replace(one, made=tuple(next(made))) for one in alone]
    count = len(plan.random.indices)
    first, *others = (replace(one, made=one.made[:count]) for one in (held, *alone, taken))
    return (_judged(first, first, plan), *(_judged(one, first, plan) for one in others))


def _freed(case: Case, moved: Collection[str]) -> dict[str, Case]:
    """The nominal machine with what belongs to the robot, the lens, the board."""
    mechanism = case.fit.with_prior(case.mechanism)
    placed = {*mechanism.parameters.of_role("placement", "mounting"), *moved}
    placed |= instruments_alone(mechanism) | unstated_lenses(mechanism)
    groups: dict[str, list[str]] = {}
    for p in mechanism.parameters:
        if not p.fixed and p.name not in placed:
            groups.setdefault(PARTS.get(p.role, "robot"), []).append(p.name)
    return {
        part: replace(nominal_case(case, (*moved, *groups[part])), trusted=True)
        for part in ("robot", "lens", "board")
        if part in groups
    }


def _judged(one: Judged, first: Judged, plan: Plan) -> Candidate:
    """One of them on the images not used, beside the machine as stated."""
    if not one.made or one.whole is None:
        return Candidate(one.name, None, None, None, None, one.failed)
    data = one.entrant.case.data
    accuracy = pooled(one.whole, one.made, plan, data, stating=False).accuracy
    mine, base = (risk_of(j, plan, len(data))[0] for j in (one, first))
    gain = Gain.in_rms(base, mine, plan.groups)
    return Candidate(
        one.name,
        None if accuracy is None else accuracy.distances,
        None,
        None if gain is None else gain.difference,
        None if gain is None else gain.sd,
    )
