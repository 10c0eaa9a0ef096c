"""A calibration by a stated method, in which repeats of a pose that share its error count once.

Whether they share it is asked as the choice of a method asks: of the fit of the means with the
structured model error that comes closest to the outputs, since a plain fit of few poses may learn
sds that hide it. Where no such fit is made, as without stated sds, the fit of the method tells.
"""

from __future__ import annotations

from dataclasses import dataclass

from loopcal.estimation.result import FitResult
from loopcal.estimation.solve.solver import Progress
from loopcal.statistics.case import Case, entrants
from loopcal.statistics.folds import Scheme
from loopcal.statistics.judged import begun, closest, fitted, tells
from loopcal.statistics.shared_repeats import Means


@dataclass(frozen=True, eq=False)
class ByPose:
    """case, scheme: with means of repeats where these share an error, else as asked; result: the
    calibration of the case."""

    case: Case
    scheme: Scheme | None
    result: FitResult

    @classmethod
    def of(
        cls, case: Case, scheme: Scheme | None = None, progress: Progress | None = None
    ) -> ByPose:
        """Of a case as it was asked for; progress: called at every iteration."""
        for means in Means.each(case, scheme):
            if means.shared(_asked(means.case)):
                return cls.of(means.case, means.scheme, progress)
        return cls(case, scheme, case.calibrated(progress=progress))


def _asked(case: Case) -> FitResult:
    """The fit of means that says whether repeats share an error."""
    rivals = entrants(Case(case.mechanism, case.data, case.noise, case.fit.changed(method="auto")))
    best = closest([fitted(begun(one, None)) for one in rivals if tells(one)])
    return best.whole if best is not None and best.whole is not None else case.calibrated()
