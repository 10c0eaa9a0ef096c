"""Whether there are equations enough to calibrate from: the calibration index.

In a pose with k quantities in m loops a mechanism has the mobility M = k - m; with u of them
unmeasured, S = k - u are sensed. C = S - M = m - u equations are left for the parameters.
Hollerbach and Wampler (1996).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from loopcal.errors import InputError
from loopcal.estimation.problem.patterns import Pattern
from loopcal.estimation.problem.unknowns import Unknowns
from loopcal.mechanisms.mechanism import Mechanism


def refuse_too_few(equations: int, poses: int, unknowns: Unknowns) -> None:
    """Raises InputError where fewer parameters can be determined than are estimated."""
    # A finite prior is one more equation.
    needed = len(unknowns.free) - int(np.isfinite(unknowns.prior_sd).sum())
    if equations < needed:
        raise InputError(
            f"{equations} loop equations ({poses} poses) cannot determine {needed} parameters "
            "without prior knowledge",
            code="too-few-poses",
            remedy="measure more poses, fix parameters, or give them a finite prior sd",
        )


def refuse_without_redundancy(
    mechanism: Mechanism, patterns: Sequence[Pattern], poses: Sequence[str]
) -> None:
    """Raises InputError where the loops of some pose cannot find what is unmeasured there.

    Likewise where the loops of all poses find that and nothing else. poses: their ids.
    """
    for pattern in patterns:
        if len(pattern.unmeasured) > len(pattern.loops):
            raise _blind(mechanism, pattern, poses)
    if sum(pattern.equations(len(poses)) for pattern in patterns) <= 0:
        raise _without_redundancy(mechanism, patterns)


def _blind(mechanism: Mechanism, pattern: Pattern, poses: Sequence[str]) -> InputError:
    """A pose whose unmeasured quantities could stand anywhere."""
    first = 0 if isinstance(pattern.poses, slice) else int(pattern.poses[0])
    names = _unmeasured(mechanism, pattern)
    return InputError(
        f"pose {poses[first]!r} has {len(names)} unmeasured quantities "
        f"({', '.join(names)}) and only {len(pattern.loops)} loop equations to find them: its "
        f"calibration index is {_words(mechanism, pattern)}",
        code="undetermined-quantities",
        remedy="measure more quantities in this pose, or exclude it",
    )


def _without_redundancy(mechanism: Mechanism, patterns: Sequence[Pattern]) -> InputError:
    """Sensors that just say where the machine stands leave nothing to learn from."""
    if not patterns:
        return InputError(
            "no pose has enough readings to close a loop",
            code="no-data",
            remedy="name the columns of the instrument's readings",
        )
    pattern = patterns[0]
    names = _unmeasured(mechanism, pattern)
    unread = f" such as {names[0]}" if names else ""
    return InputError(
        f"{mechanism.name!r} cannot be calibrated from these sensors: its calibration "
        f"index is {_words(mechanism, pattern)}. They measure only the position of the machine, "
        f"so any parameters would fit",
        code="undetermined-quantities",
        remedy="add an instrument, or read a passive joint or another quantity that has no sensor"
        f"{unread}: each adds one equation to every pose",
    )


def _unmeasured(mechanism: Mechanism, pattern: Pattern) -> list[str]:
    return [mechanism.tape.quantities[i] for i in pattern.unmeasured]


def _words(mechanism: Mechanism, pattern: Pattern) -> str:
    k = len(mechanism.tape.quantities) - len(pattern.absent)
    m, u = len(pattern.loops), len(pattern.unmeasured)
    return f"C = S - M = {k - u} sensed - {k - m} of mobility = {m - u} in every such pose"
