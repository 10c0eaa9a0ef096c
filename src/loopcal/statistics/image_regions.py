"""How images are predicted whose board stands where no other image has one.

A lens is as good as its model where corners were. Regions of the image left out one by one show
what it is worth elsewhere. They are judged after the choice, by the chosen calibration alone.
"""

from __future__ import annotations

from loopcal.errors import NoTrustworthyResult
from loopcal.execution.executor import Executor
from loopcal.statistics.folds import image_regions
from loopcal.statistics.judged import Judged
from loopcal.statistics.validation import Plan, Validation, left_out, pooled


def image_validation(
    taken: Judged, plan: Plan, executor: Executor | None = None
) -> Validation | None:
    """The chosen calibration on regions of the image; None without cameras, or with few images."""
    case, whole = taken.entrant.case, taken.whole
    parts = image_regions(case.mechanism, case.data, plan.groups)
    if parts is None or whole is None:
        return None
    (made,) = left_out([(case, whole)], parts.indices, executor, stepped=True)
    try:
        return pooled(whole, made, Plan(parts, None, plan.groups), case.data)
    except NoTrustworthyResult:
        return None
