"""The points of a serial arm that instruments measured, as chains, with their derivatives.

A point t of the body is seen at p = S_1 S_2 ... S_n t, the steps from the instrument to the body.
The derivative of p by the amount of a step about (along) the axis e through o is e x (p - o) (e).
By a joint's reading, a zero offset of it, or a parameter it is the sum over the steps of that name.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loopcal.mechanisms.chain import Step, frames
from loopcal.mechanisms.mechanism import Family, Mechanism
from loopcal.mechanisms.outputs import point_outputs, points
from loopcal.mechanisms.station import Station

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SeenPoint:
    """A point of the body as one instrument sees it: steps, and the names of its coordinates."""

    family: Family
    outputs: tuple[str, ...]
    steps: tuple[Step, ...]
    target: tuple[str, ...]

    def measured(self, readings: Mapping[str, Array]) -> Array:
        """(N, 3) [m] of readings of its outputs, NaN where absent."""
        return points(self.family, np.array([readings[q] for q in self.outputs])).T


@dataclass(frozen=True, eq=False)
class Traced:
    """points: (N, 3) [m]; by: joint or parameter -> their derivative (N, 3)."""

    points: Array
    by: Mapping[str, Array]


def seen_points(mechanism: Mechanism) -> tuple[SeenPoint, ...]:
    """The points in space that instruments see of an arm; none of other machines."""
    seen = []
    for family in mechanism.families if mechanism.chain else ():
        outputs = point_outputs(mechanism, family)
        target = tuple(n for n in family.mounted if mechanism.parameters[n].unit == "m")
        if len(outputs) != 3 or len(target) not in (0, 3):
            continue
        stands = family.placement
        station = stands.steps if isinstance(stands, Station) else ()
        seen.append(SeenPoint(family, outputs, (*station, *mechanism.chain), target))
    return tuple(seen)


def traced(
    steps: Sequence[Step],
    target: Sequence[str],
    joints: Mapping[str, Array],
    values: Mapping[str, float],
) -> Traced:
    """A point at the end of a chain, at joint readings (N,) and parameter values [SI]."""
    *ahead, (R, o) = frames(steps, joints, values)
    t = np.array([values[n] for n in target] or [0.0, 0.0, 0.0])
    p = o + R @ t
    by: dict[str, Array] = {name: R[:, :, i] for i, name in enumerate(target)}
    for step, (axes, origin) in zip(steps, ahead, strict=True):
        axis = axes[:, :, "xyz".index(step.motion[1])]
        column = axis if step.motion[0] == "t" else np.cross(axis, p - origin)
        for name, weight in ((step.parameter, step.sign), (step.joint, step.direction)):
            if name is not None:
                by[name] = by.get(name, 0.0) + weight * column
    return Traced(p, by)
