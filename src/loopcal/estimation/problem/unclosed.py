"""Loops of a machine itself that its readings and dimensions leave open, in words."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from loopcal.errors import InputError
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.solve.sweep import Sweeper
from loopcal.expressions.engine import Stage

# Chosen, not derived: below the noise of any instrument, above what closing leaves.
_OPEN = 1e-6
"""Loops that stay this far from zero [m, rad] are open."""


def open_loops(problem: Problem) -> InputError | None:
    """What to say where the loops without any instrument cannot close from the parameters' start.

    Readings are held, and what nobody reads is searched from home; None where all loops close,
    or where there are more of them than unread quantities, which then need not agree.
    """
    mechanism = problem.mechanism
    seen = {loop for family in mechanism.families for loop in family.loops}
    names, poses, worst = mechanism.tape.loops, 0, (0.0, "", "")
    inputs = mechanism.tape.depends_on()
    for pattern in problem.patterns:
        loops = tuple(i for i in pattern.loops if names[i] not in seen)
        present = frozenset().union(*(inputs[i] for i in loops))
        unread = tuple(i for i in pattern.unmeasured if mechanism.tape.quantities[i] in present)
        if not loops or len(unread) != len(loops):
            continue
        alone = replace(pattern, loops=loops, unmeasured=unread)
        sweeper = Sweeper(replace(problem, patterns=(alone,)))
        index = np.arange(len(problem.poses))[pattern.poses]
        for begin in range(0, len(index), problem.block):
            some = index[begin : begin + problem.block]
            start = np.zeros((len(problem.readings), len(some)))
            block = sweeper.searched(alone, sweeper.block(alone, some, problem.start, start))
            values = sweeper.loop_values(alone, block, Stage.VALUES)
            f = np.abs(values.f)
            gap = f.max(axis=0)
            poses += int((gap > _OPEN).sum())
            most = int(gap.argmax())
            if gap[most] > worst[0]:
                loop = names[loops[int(f[:, most].argmax())]]
                worst = (float(gap[most]), loop, problem.poses[int(some[most])])
    if not poses:
        return None
    return InputError(
        f"the machine's loops cannot close in {poses} poses with its nominal dimensions: at pose "
        f"{worst[2]!r} the loop {worst[1]!r} stays {worst[0]:.3g} away from zero",
        code="open-loops",
        remedy="check the units of the readings and the nominal values of the parameters in that "
        "loop, above all lengths and offsets; check that `home` is near the measured poses",
    )
