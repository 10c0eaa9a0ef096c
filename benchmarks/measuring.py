"""Times of programs that do the same, taken in turns so that a busy machine is fair to all."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

TURN = 0.1
"""How long a turn is at least [s]: what is short runs several times in it, so that the caches the
program before it left do not decide."""
LONG = 5.0
"""A run that takes longer [s] is its own measurement: what it sets up once is nothing beside it."""


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


def taken(begin: float, done: object) -> float:
    """Wall time since `begin` [s], or what the program tells that leaves its own start out."""
    since, told = time.perf_counter() - begin, getattr(done, "seconds", None)
    return since if told is None else float(told)


def rounds_for(seconds: float) -> int:
    """How often to time what takes so long [s]; 0 if it has been timed by that."""
    if seconds > LONG:
        return 0
    return 3 if seconds > 1.0 else 5 if seconds > 0.1 else 15


def in_turns(
    programs: Mapping[str, Callable[[], object]], rounds: int | Mapping[str, int]
) -> dict[str, Times]:
    """Times of programs that take turns, so many rounds, or of each so many.

    Every program must have run once before: what is set up only once does not count.
    """
    if isinstance(rounds, int):
        rounds = dict.fromkeys(programs, rounds)
    seconds: dict[str, list[float]] = {name: [] for name in programs}
    for turn in range(max(rounds.values(), default=0)):
        for name, program in programs.items():
            if turn < rounds[name]:
                seconds[name] += _turn(program)
    return {name: Times(tuple(found)) for name, found in seconds.items()}


def _turn(program: Callable[[], object]) -> list[float]:
    began, seconds = time.perf_counter(), list[float]()
    while not seconds or time.perf_counter() - began < TURN:
        begin = time.perf_counter()
        seconds.append(taken(begin, program()))
    return seconds
