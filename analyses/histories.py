"""How often a history reports a change, names it right and dates it, on machines whose truth is
known: false alarms, steps, drifts, and scatter beyond the stated sds.

    python -m analyses.histories [DRAWS]

Times are random over three years. The machine has 20 parameters, of which one changes; sizes are in
sds that one calibration states of it. Parameters are independent, or as correlated as those of a
machine whose zeros no single calibration determines: the sds of combinations differ by a factor of
100.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from loopcal.companions.life.courses import Cause, Change, Course, Said, changes

PARAMETERS = 20
Generator = np.random.Generator
Array = np.ndarray


@dataclass
class Rates:
    """What was reported of some draws, in shares of these."""

    draws: int = 0
    ways: Counter[str] = field(default_factory=Counter)
    dated: int = 0
    """Steps between whose two calibrations the true one lies."""
    held: int = 0
    """Sizes whose interval holds the true one."""
    alone: int = 0
    """Draws in which the parameter that changed is named, and no other."""
    among: int = 0
    """Draws in which it is among those of each change."""

    def add(self, seen: tuple[Change, ...], at: int | None, size: float, which: int) -> None:
        """What was seen of a draw with a step before calibration `at`, or a drift, of this size."""
        self.draws += 1
        self.ways.update({str(one.way) for one in seen} or {"none"})
        self.alone += bool(seen) and all(one.causes == (which,) for one in seen)
        self.among += bool(seen) and all(which in one.causes for one in seen)
        for one in seen:
            wanted = "drift" if at is None else "step"
            if one.way == wanted and one.half is not None and one.causes[0] == which:
                self.dated += at is not None and one.after < at <= one.before
                self.held += abs(one.size - size) <= one.half

    def share(self, *ways: str) -> float:
        """Of draws with one of these ways."""
        return sum(self.ways[way] for way in ways) / self.draws


def times(rng: Generator, number: int) -> Array:
    """[years]"""
    return np.sort(rng.uniform(0.0, 3.0, number))


def covariance(rng: Generator, correlated: bool) -> Array:
    """(20, 20) of one calibration, each parameter with an sd of 1."""
    if not correlated:
        return np.eye(PARAMETERS)
    axes = np.linalg.qr(rng.normal(size=(PARAMETERS, PARAMETERS)))[0]
    C = (axes * np.logspace(0.0, -4.0, PARAMETERS)) @ axes.T
    sd = np.sqrt(np.diag(C))
    return np.asarray(C / np.outer(sd, sd))


def course(
    rng: Generator,
    t: Array,
    change: Array | float = 0.0,
    *,
    correlated: bool = False,
    factor: float = 1.0,
    events: frozenset[int] = frozenset(),
) -> Course:
    """Calibrations at times t of a machine whose first parameter changes by so much at each;
    factor: by how much it scatters more than stated."""
    one, every = np.eye(PARAMETERS), np.arange(PARAMETERS)
    values, each = np.zeros((len(t), PARAMETERS)), []
    values[:, 0] += change
    for value in values:
        C = covariance(rng, correlated)
        noise = np.linalg.cholesky(C) @ rng.normal(size=PARAMETERS)
        noise[0] *= factor
        each.append(Said.of(value + noise, C, every, PARAMETERS))
    causes = tuple(Cause(f"p_{i}", "1", one[:, [i]]) for i in every)
    return Course(t, tuple(each), (*causes, Cause("several", "1", one, together=True)), events)


def unchanged(rng: Generator, number: int, correlated: bool = False) -> bool:
    """Whether a machine that does not change is reported as changed."""
    return bool(changes(course(rng, times(rng, number), correlated=correlated)))


def stepped(
    rng: Generator, number: int, size: float, event: bool = False, correlated: bool = False
) -> Rates:
    """One machine with a step, at a noted event or not."""
    at = int(rng.integers(1, number))
    by, noted = size * (np.arange(number) >= at), frozenset([at] if event else [])
    t = times(rng, number)
    return _one(course(rng, t, by, correlated=correlated, events=noted), at, size)


def drifting(rng: Generator, number: int, size: float, correlated: bool = False) -> Rates:
    """One machine that drifts steadily by a size over all its time."""
    t = times(rng, number)
    by = size * (t - t[0]) / (t[-1] - t[0])
    return _one(course(rng, t, by, correlated=correlated), None, size)


def scattering(rng: Generator, number: int, factor: float) -> Rates:
    """One machine of which a parameter scatters by a multiple of its sds."""
    return _one(course(rng, times(rng, number), factor=factor), None, 0.0)


def _one(machine_course: Course, at: int | None, size: float) -> Rates:
    rates = Rates()
    rates.add(changes(machine_course), at, size, 0)
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
        rates.alone += one.alone
        rates.among += one.among
    return rates


def main() -> None:
    """Print the table."""
    draws = int(sys.argv[1]) if len(sys.argv) > 1 else 400
    rng = np.random.default_rng(1)
    for correlated in (False, True):
        for number in (2, 5, 8, 16):
            alarms = sum(unchanged(rng, number, correlated) for _ in range(draws))
            how = "correlated" if correlated else "independent"
            print(f"{number:2d} calibrations, {how}, no change: {alarms} of {draws}", flush=True)
    print("\ncalibrations  truth               seen  step drift scatter alone among dated  held")
    for number in (8, 16):
        worlds: dict[str, Callable[[Generator], Rates]] = {}
        for size in (4.0, 6.0, 10.0) if number == 8 else (4.0,):
            worlds[f"step {size:g}"] = partial(stepped, number=number, size=size)
        worlds["step 6, event"] = partial(stepped, number=number, size=6.0, event=True)
        for size in (6.0, 10.0) if number == 8 else (6.0,):
            worlds[f"drift {size:g}"] = partial(drifting, number=number, size=size)
        for size in (0.5, 1.0) if number == 8 else (0.5,):
            name = f"step {size:g}, correlated"
            worlds[name] = partial(stepped, number=number, size=size, correlated=True)
        worlds["drift 1, correlated"] = partial(drifting, number=number, size=1.0, correlated=True)
        worlds["scatter 3"] = partial(scattering, number=number, factor=3.0)
        for name, draw in worlds.items():
            rates = over(draws, draw)
            named = max(rates.ways["step" if "step" in name else "drift"], 1)
            cells = [1.0 - rates.share("none"), rates.share("step")]
            cells += [rates.share("drift"), rates.share("scatter")]
            cells += [rates.alone / draws, rates.among / draws]
            cells += [rates.dated / named, rates.held / named]
            row = "".join(f"{100 * cell:6.0f}" for cell in cells)
            print(f"{number:12d}  {name:20}{row}", flush=True)


if __name__ == "__main__":
    main()
