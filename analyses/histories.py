"""How often a history reports a change, names it right and dates it, on machines whose truth is
known: false alarms, steps, drifts, and scatter beyond the stated sds.

    python -m analyses.histories [DRAWS]

Times are random over three years. Sizes are in sds of one calibration. The machine has 20
parameters, of which one changes; without a change all 20 are judged.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from loopcal.companions.life.courses import Change, Course, changes

PARAMETERS = 20
Generator = np.random.Generator


@dataclass
class Rates:
    """What was reported of some draws, in shares of these."""

    draws: int = 0
    ways: Counter[str] = field(default_factory=Counter)
    dated: int = 0
    """Steps between whose two calibrations the true one lies."""
    held: int = 0
    """Sizes whose interval holds the true one."""

    def add(self, seen: tuple[Change, ...], at: int | None, size: float) -> None:
        """What was seen of a draw with a step before calibration `at`, or a drift, of this size."""
        self.draws += 1
        self.ways.update({str(one.way) for one in seen} or {"none"})
        for one in seen:
            wanted = "drift" if at is None else "step"
            if one.way == wanted and one.half is not None:
                self.dated += at is not None and one.after < at <= one.before
                self.held += abs(one.size - size) <= one.half

    def share(self, *ways: str) -> float:
        """Of draws with one of these ways."""
        return sum(self.ways[way] for way in ways) / self.draws


def times(rng: Generator, number: int) -> np.ndarray:
    """[years]"""
    return np.sort(rng.uniform(0.0, 3.0, number))


def unchanged(rng: Generator, number: int) -> bool:
    """Whether a machine that does not change is reported as changed."""
    t = times(rng, number)
    courses = (Course(t, rng.normal(size=number), np.ones(number)) for _ in range(PARAMETERS))
    return any(changes(one, PARAMETERS) for one in courses)


def stepped(rng: Generator, number: int, size: float, event: bool = False) -> Rates:
    """One machine with a step, at a noted event or not."""
    at = int(rng.integers(1, number))
    values = rng.normal(size=number) + size * (np.arange(number) >= at)
    noted = frozenset([at] if event else [])
    course = Course(times(rng, number), values, np.ones(number), noted)
    return _one(course, at, size)


def drifting(rng: Generator, number: int, size: float) -> Rates:
    """One machine that drifts steadily by a size over all its time."""
    t = times(rng, number)
    values = rng.normal(size=number) + size * (t - t[0]) / (t[-1] - t[0])
    return _one(Course(t, values, np.ones(number)), None, size)


def scattering(rng: Generator, number: int, factor: float) -> Rates:
    """One machine whose calibrations scatter by a multiple of their sds."""
    values = factor * rng.normal(size=number)
    return _one(Course(times(rng, number), values, np.ones(number)), None, 0.0)


def _one(course: Course, at: int | None, size: float) -> Rates:
    rates = Rates()
    rates.add(changes(course, PARAMETERS), at, size)
    return rates


def over(draws: int, draw: Callable[[Generator], Rates], seed: int = 1) -> Rates:
    """The rates of many draws."""
    rng, rates = np.random.default_rng(seed), Rates()
    for _ in range(draws):
        one = draw(rng)
        rates.draws += one.draws
        rates.ways += one.ways
        rates.dated += one.dated
        rates.held += one.held
    return rates


def main() -> None:
    """Print the table."""
    draws = int(sys.argv[1]) if len(sys.argv) > 1 else 400
    rng = np.random.default_rng(1)
    for number in (2, 5, 8, 16):
        alarms = sum(unchanged(rng, number) for _ in range(draws))
        print(f"{number:2d} calibrations, no change: {alarms} of {draws} machines reported")
    print("\ncalibrations  truth             seen  step  drift  scatter  dated right  size held")
    for number in (5, 8, 16):
        worlds: dict[str, Callable[[Generator], Rates]] = {}
        for size in (4.0, 6.0, 10.0):
            worlds[f"step {size:g}"] = partial(stepped, number=number, size=size)
            worlds[f"step {size:g}, event"] = partial(stepped, number=number, size=size, event=True)
        for size in (6.0, 10.0, 20.0):
            worlds[f"drift {size:g}"] = partial(drifting, number=number, size=size)
        worlds["scatter 3"] = partial(scattering, number=number, factor=3.0)
        for name, draw in worlds.items():
            rates = over(draws, draw)
            named = max(rates.ways["step" if "step" in name else "drift"], 1)
            cells = [1.0 - rates.share("none"), rates.share("step")]
            cells += [rates.share("drift"), rates.share("scatter")]
            cells += [rates.dated / named, rates.held / named]
            row = "".join(f"{100 * cell:8.0f}" for cell in cells)
            print(f"{number:12d}  {name:14}{row}", flush=True)


if __name__ == "__main__":
    main()
