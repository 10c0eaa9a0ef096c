"""Times of programs that do the same, taken in turns so that a busy machine is fair to all."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np


class DisagreementError(Exception):
    """Programs that should find the same do not."""


@dataclass(frozen=True)
class Times:
    """Wall times of repeated runs [s]."""

    seconds: tuple[float, ...]

    @property
    def median(self) -> float:
        """The middle one [s]."""
        return float(np.median(self.seconds))

    @property
    def best(self) -> float:
        """The shortest [s]."""
        return min(self.seconds)


def in_turns(
    programs: Mapping[str, Callable[[], object]],
    *,
    rounds: int,
    often: Sequence[str] = (),
    times_often: int = 5,
) -> dict[str, Times]:
    """Times of programs run one after the other, so many rounds; `often` more than once in each.

    Every program must have run once before: what is set up only once does not count.
    """
    seconds: dict[str, list[float]] = {name: [] for name in programs}
    for _ in range(rounds):
        for name, program in programs.items():
            for _ in range(times_often if name in often else 1):
                begin = time.perf_counter()
                program()
                seconds[name].append(time.perf_counter() - begin)
    return {name: Times(tuple(found)) for name, found in seconds.items()}
