"""Points read so far off that no machine of this size can have been there.

A number that stands for a missing reading, a lost decimal point or a damaged file: a fit would be
about this pose alone, and its loops could not be closed. Smaller gross errors are for the tests
of outliers, which name the reading to blame.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError
from loopcal.estimation.problem.alignment import seen_points
from loopcal.estimation.problem.problem import Problem
from loopcal.presentation.rounding import significant

Array = NDArray[np.float64]
# docs/decisions/0052 for the first.
_FAR, _LONG, _FEW, _NAMED = 30.0, 10.0, 0.1, 5


def refuse_unreachable(problem: Problem, parameters: Array) -> None:
    """Raise InputError for points measured where the machine cannot be.

    That is 30 times as far from the computed point, in some coordinate, as half of all points are
    from the instrument's origin. Where this holds of more than a tenth of the poses, the machine
    or a unit is wrong, which others report better.

    parameters: (n_all,) where the machine stands as measured, at least roughly.
    """
    if not _long(problem):
        return
    for family, computed, measured in seen_points(problem, parameters):
        complete = np.isfinite(computed).all(axis=0) & np.isfinite(measured).all(axis=0)
        if not complete.any():
            continue
        size = float(np.median(np.abs(measured[:, complete]).max(axis=0)))
        off = np.where(complete, np.abs(computed - measured).max(axis=0), 0.0)
        far = np.flatnonzero(off > _FAR * size)
        if not 0 < len(far) <= _FEW * complete.sum():
            continue
        names = [q for q in family.readings if q in problem.mechanism.outputs]
        words = [
            f"pose {problem.pose(int(i))!r} ({', '.join(names)} place the point "
            f"{significant(off[i], 3)} m from the machine's prediction)"
            for i in far[:_NAMED]
        ]
        more = f" and {len(far) - _NAMED} more" if len(far) > _NAMED else ""
        raise InputError(
            f"implausible readings: {'; '.join(words)}{more}; half of the points have all "
            f"coordinates within {significant(size, 3)} m",
            code="implausible-readings",
            remedy="correct or blank these readings, or exclude the poses (data.exclude)",
        )


def _long(problem: Problem) -> bool:
    """Whether any length read is so large that points are worth computing to be compared."""
    units = problem.mechanism.quantities
    lengths = [i for i, q in enumerate(problem.mechanism.tape.quantities) if units[q] == "m"]
    longest = np.fmax.reduce(np.abs(problem.readings[lengths]), axis=0, initial=0.0)
    return bool(longest.max(initial=0.0) > _LONG * np.median(longest))
