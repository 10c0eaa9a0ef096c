"""What candidates risk at poses they have not seen, and which of two predicts better.

The risk of a pose is its squared distance there; without outputs it is minus twice the log density
of its loops. It is known where the pose was left out at random, and where it was with its region.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from loopcal.arrays import Array
from loopcal.document import choice as rule
from loopcal.estimation.accuracy import by_pose, deviations
from loopcal.estimation.result import FitResult
from loopcal.statistics.folds import Index
from loopcal.statistics.gain import Gain
from loopcal.statistics.judged import Judged
from loopcal.statistics.validation import Outcome, Plan, Predicted


def rms_over(one: Judged, made: Sequence[Outcome]) -> float:
    """Root mean square distance over some parts; zero without outputs: all may go on."""
    assert one.whole is not None
    if not one.whole.mechanism.outputs:
        return 0.0
    parts = [risks_of_part(one.whole, p) for p in made if isinstance(p, Predicted)]
    values = np.concatenate(parts) if parts else np.empty(0)
    values = values[np.isfinite(values)]
    return math.sqrt(float(values.mean())) if values.size else math.inf


def risks_of_part(whole: FitResult, part: Predicted) -> Array:
    """(n,) squared distances; without outputs minus twice the log densities."""
    distances = by_pose(deviations(whole.mechanism, part.measured, part.differences))
    if distances is not None:
        return np.square(distances)
    stated = part.stated(whole.drifting)
    density = None if stated is None else stated.log_density
    return np.full(len(part.index), np.nan) if density is None else -2.0 * density


def risk_of(one: Judged, plan: Plan, poses: int) -> Array:
    """(2, N): risk where the pose was left out at random, and with its region; NaN if unknown."""
    risks = np.full((2, poses), np.nan)
    if one.whole is not None:
        for number, part in enumerate(one.made):
            if isinstance(part, Predicted):
                row = int(number >= len(plan.random.indices))
                risks[row, part.index] = risks_of_part(one.whole, part)
    return risks


def beats(rival: Array, taken: Array, plan: Plan) -> bool:
    """By the rule of the verdict."""
    gain = Gain.in_rms(taken[0], rival[0], plan.groups)
    if gain is None:
        return False
    return rule.beats(gain.difference, gain.sd, rms_of(rival[1]), rms_of(taken[1]))


def rms_of(risk: Array) -> float | None:
    """Of the poses where it is known; None where at none."""
    values = risk[np.isfinite(risk)]
    return math.sqrt(max(float(values.mean()), 0.0)) if values.size else None


def mean_risk(risk: Array) -> float:
    """Mean risk over both ways to leave a pose out."""
    rows = [row[np.isfinite(row)] for row in risk]
    return (
        # A mean of means: one of the ways may know more poses than the other.
        float(np.mean([row.mean() for row in rows if row.size]))
        if any(map(len, rows))
        else math.inf
    )


def significantly_better(
    risk: Array, other: Array, plan: Plan, enough: Callable[[Iterable[bool]], bool]
) -> bool:
    """Whether a candidate is significantly better than another, in all or any of both ways."""
    ways = zip(risk, other, _clusters(plan), strict=False)
    gains = [Gain.of(one, two, clusters) for one, two, clusters in ways]
    clustered = [gain for gain in gains if gain.clusters]
    return all(gain.difference > 0.0 for gain in clustered) and enough(
        gain.better is True for gain in clustered
    )


def predicts_as_well(risk: Array, best: Array, plan: Plan) -> bool:
    """Whether a candidate predicts within one paired standard error of another, in both ways."""
    ways = zip(best, risk, _clusters(plan), strict=False)
    gains = [Gain.in_rms(one, two, clusters) for one, two, clusters in ways]
    return all(gain is None or gain.difference <= gain.sd for gain in gains)


def _clusters(plan: Plan) -> list[Index]:
    """(N,) labels of poses whose errors belong together: at random, and in regions where any."""
    if plan.blocked is None:
        return [plan.groups]
    region = np.zeros(len(plan.groups), dtype=np.intp)
    for number, index in enumerate(plan.blocked.indices):
        region[index] = number
    return [plan.groups, region]
