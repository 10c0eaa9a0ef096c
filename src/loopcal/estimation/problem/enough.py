"""Whether there are equations enough to calibrate from: the calibration index.

In a pose with k quantities in m loops a mechanism has the mobility M = k - m; with u of them
unmeasured, S = k - u are sensed. C = S - M = m - u equations are left for the parameters.
Hollerbach and Wampler (1996).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from loopcal.errors import InputError

if TYPE_CHECKING:
    from loopcal.estimation.problem.problem import Pattern, Problem


def refuse_too_few(problem: Problem) -> None:
    """Raises InputError where the loops determine no parameter, or fewer than are estimated."""
    for pattern in problem.patterns:
        if len(pattern.unmeasured) > len(pattern.loops):
            raise _blind(problem, pattern)
    if problem.equations <= 0:
        raise _without_redundancy(problem)
    informed = sum(math.isfinite(sd) for sd in problem.prior_sd)
    needed = len(problem.free) - informed
    if problem.equations < needed:
        raise InputError(
            f"{problem.equations} loop equations ({len(problem.poses)} poses) cannot determine "
            f"{needed} parameters without prior knowledge",
            code="too-few-poses",
            remedy="measure more poses, fix parameters, or give them a finite prior sd",
        )


def _blind(problem: Problem, pattern: Pattern) -> InputError:
    """A pose whose unmeasured quantities could stand anywhere."""
    first = 0 if isinstance(pattern.poses, slice) else int(pattern.poses[0])
    names = _unmeasured(problem, pattern)
    return InputError(
        f"pose {problem.poses[first]!r} has {len(names)} unmeasured quantities "
        f"({', '.join(names)}) and only {len(pattern.loops)} loop equations to find them: its "
        f"calibration index is {_words(problem, pattern)}",
        code="undetermined-quantities",
        remedy="measure more quantities in this pose, or exclude it",
    )


def _without_redundancy(problem: Problem) -> InputError:
    """Sensors that just say where the machine stands leave nothing to learn from."""
    if not problem.patterns:
        return InputError(
            "no pose has readings from which a loop could be closed",
            code="no-data",
            remedy="give the columns of the instrument's readings, or measure with it",
        )
    pattern = problem.patterns[0]
    names = _unmeasured(problem, pattern)
    unread = f" such as {names[0]}" if names else ""
    return InputError(
        f"{problem.mechanism.name!r} cannot be calibrated from these sensors: its calibration "
        f"index is {_words(problem, pattern)}. They say where the machine stands and nothing more, "
        "so any parameters would fit",
        code="undetermined-quantities",
        remedy="add an instrument, or read a passive joint or another quantity that has no sensor"
        f"{unread}: each adds one equation to every pose",
    )


def _unmeasured(problem: Problem, pattern: Pattern) -> list[str]:
    return [problem.mechanism.tape.quantities[i] for i in pattern.unmeasured]


def _words(problem: Problem, pattern: Pattern) -> str:
    k = len(problem.mechanism.tape.quantities) - len(pattern.absent)
    m, u = len(pattern.loops), len(pattern.unmeasured)
    return f"C = S - M = {k - u} sensed - {k - m} of mobility = {m - u} in every such pose"
