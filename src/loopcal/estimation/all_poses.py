"""What all poses of a stream say, beside the arrays of its result, which show only some of them."""

from __future__ import annotations

from dataclasses import dataclass

from loopcal.estimation.accuracy import Accuracy
from loopcal.estimation.solve.robust import RobustSums


@dataclass(frozen=True)
class AllPoses:
    """What all poses of a stream say, where the arrays of its result show only some of them.

    poses: how many there are.
    """

    poses: int
    accuracy_before: Accuracy | None
    accuracy_after: Accuracy | None
    model_discrepancy: float | None
    robust: RobustSums
