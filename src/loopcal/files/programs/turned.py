"""Targets whose numbers are axes in degrees, or x, y, z in millimetres and three turns in degrees.

KUKA and Fanuc write both so, each under its own keys.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loopcal.files.programs.joint_axes import JointAxes
from loopcal.files.programs.poses_text import pose_of_turns, turns_of_pose
from loopcal.files.programs.program import Number, ProgramTarget, Span, written

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Turned:
    """axes: of the arm; pose: keys of x, y, z and the turns about z, y, x; joint: letter ahead of
    the number of a joint; decimals: written at least."""

    axes: JointAxes
    pose: Sequence[str]
    joint: str
    decimals: int

    def target(
        self,
        name: str,
        line: int,
        stated: Mapping[str, Number | None],
        states: Mapping[str, int],
        literal: Span,
    ) -> ProgramTarget | None:
        """The target of stated numbers; None where one that it needs is missing.

        states: of the configuration, which a joint target does not need; literal: all of it.
        """
        joint = f"{self.joint}1" in stated
        count = len(self.axes.joints)
        keys = [f"{self.joint}{i}" for i in range(1, count + 1)] if joint else self.pose
        numbers = tuple(n for key in keys if (n := stated.get(key)) is not None)
        if len(numbers) < len(keys):
            return None
        values = np.array([number.value for number in numbers])
        step = np.array([10.0 ** -max(number.decimals, self.decimals) for number in numbers])
        if joint:
            q = values * self.axes.scale
            step = step * self.axes.scale
            return ProgramTarget(name, line, False, numbers, q, None, step, literal=literal)
        # Reversed: numbers turn about z, y, x, the steps of a pose are about x, y, z.
        step = np.concatenate([1e-3 * step[:3], np.radians(step[:2:-1])])
        pose = pose_of_turns(values.tolist())
        return ProgramTarget(name, line, True, numbers, None, pose, step, states, literal)

    def write(self, target: ProgramTarget, joints: Array, pose: Array) -> list[str]:
        """The new texts of its numbers."""
        values = turns_of_pose(pose) if target.cartesian else (joints / self.axes.scale).tolist()
        return [
            written(v, max(n.decimals, self.decimals))
            for v, n in zip(values, target.numbers, strict=True)
        ]
