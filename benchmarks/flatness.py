"""loopcal's time per pose over the number of poses, all sizes in turns: a busy minute is shared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from measuring import Times, in_turns
from problems import six_axis
from programs import PROGRAMS
from threadpoolctl import threadpool_limits

FROM, DEMANDED = 10_000, 1.3
"""Poses from where on the time per pose has to be flat, and within how much."""


@dataclass(frozen=True)
class Flatness:
    """Times of a six-axis solve by number of poses."""

    times: dict[int, Times]

    @property
    def per_pose(self) -> dict[int, float]:
        """Medians over the number of poses [s]."""
        return {poses: times.median / poses for poses, times in self.times.items()}

    @property
    def ratio(self) -> float:
        """The longest time per pose beside the shortest."""
        return max(self.per_pose.values()) / min(self.per_pose.values())


def measure(poses: Sequence[int], rounds: int) -> Flatness:
    """Solve problems of these sizes in turns, with the first of the programs."""
    runs = {str(count): PROGRAMS[0].prepare(six_axis(count)) for count in poses}
    with threadpool_limits(1, user_api="blas"):
        for run in runs.values():
            run()
        times = in_turns(runs, rounds)
    return Flatness({int(count): found for count, found in times.items()})
