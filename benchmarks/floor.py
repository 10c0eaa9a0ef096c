"""Where the compiled engine's time goes, beside what its arithmetic alone would take.

Time of one thread for a pose of the six-axis arm: a sweep with all derivatives, whitening and sums,
the part of it up to the whitened rows, the tape alone, a closing, and a whole solve. Beside them
the floating-point operations, and how long they take if every cycle does two vectors of them.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from ours import on_engine
from problems import six_axis

from loopcal.estimation.problem.problem import build_problem
from loopcal.estimation.solve.in_memory import InMemory
from loopcal.estimation.solve.merit import Evaluation
from loopcal.estimation.solve.solver import solve_with
from loopcal.estimation.solve.sweep import Sweeper
from loopcal.expressions.choice import in_words
from loopcal.expressions.compiled_engine import prepared
from loopcal.expressions.derivative import linearise
from loopcal.expressions.domain import Stage
from loopcal.expressions.tape import Tape

POSES, REPEATS = 4096, 60
SOLVED, SOLVES = 100_000, 5
LANES = {"AVX-512": 8, "AVX2": 4}
"""Numbers in a vector; else 2."""
COSTS = {"turn": 6, "plus": 3, "minus": 3, "sincos": 62}
"""Operations of an instruction; all others count one."""
COPIED = 25_000_000
"""Numbers, more than any cache holds."""


@dataclass(frozen=True)
class Share:
    """A part of the work of a pose: its time [s], and its floating-point operations.

    times: how often a solve does it.
    """

    name: str
    seconds: float
    operations: int
    times: float | None = None


@dataclass(frozen=True)
class Floor:
    """The shares, and what the machine could do.

    lanes: numbers in a vector; hertz: cycles per second, 0 where not told; copied: bytes per second
    that one thread reads and writes in memory; moved: bytes that one pass over a pose reads or
    writes there.
    """

    shares: list[Share]
    solve: Share
    lanes: int
    hertz: float
    copied: float
    moved: int

    def least(self, share: Share) -> float:
        """Time [s] with a full vector of products and one of sums in every cycle."""
        return share.operations / (2 * self.lanes * self.hertz)


class _Counted(Sweeper):
    """A sweeper that counts its sweeps."""

    sweeps = 0

    def sweep(self, *given: Any, **more: Any) -> Evaluation[Any]:
        """As any sweep."""
        self.sweeps += 1
        return super().sweep(*given, **more)


def measure() -> Floor:
    """The shares, each containing the ones below it but for the closing, and the whole solve."""
    return on_engine("compiled", _measured, threads=1)()


def _measured() -> Floor:
    arm = six_axis(POSES)
    problem = build_problem(arm.mechanism, arm.dataset, arm.noise)
    sweeper = Sweeper(problem)
    pattern, block = next(sweeper.blocks(problem.start, most=POSES))
    kernel = sweeper.kernel(pattern)
    m, k, n = 3, 9, len(problem.free)
    tape = _tape(problem.mechanism.tape, problem.names)
    closing = _tape(problem.mechanism.tape, ()) + _whitening(m, k, 0)
    rows = tape + _whitening(m, k, n)
    found = [
        _timed(run)
        for run in (
            lambda: kernel.equations(block, summed=True),
            lambda: kernel.equations(block, summed=False),
            lambda: sweeper.loop_values(pattern, block, Stage.BY_PARAMETER),
            lambda: kernel.corrected(block),
        )
    ]
    seconds, sweeps, closings = _solve()
    whole = rows + m * (n + 1) * (n + 2)
    shares = [
        Share("a sweep", found[0], whole, sweeps),
        Share("of it up to whitened rows", found[1], rows),
        Share("of that the tape", found[2], tape),
        Share("a closing", found[3], closing, closings),
    ]
    solve = Share("a whole solve", seconds, round(sweeps * whole + closings * closing))
    width = next((lanes for name, lanes in LANES.items() if name in in_words()), 2)
    return Floor(shares, solve, width, _clock(), _copied(), 3 * 8 * k)


def _solve() -> tuple[float, int, float]:
    """The least time of a solve per pose [s], its sweeps, and its closings of all poses."""
    arm, least = six_axis(SOLVED), np.inf
    for _ in range(SOLVES):
        begin = time.perf_counter()
        sweeper = _Counted(build_problem(arm.mechanism, arm.dataset, arm.noise))
        found = solve_with(InMemory(sweeper))
        least = min(least, time.perf_counter() - begin)
    return least / SOLVED, sweeper.sweeps, found.status.evaluations - sweeper.sweeps


def _clock() -> float:
    """Cycles per second as the system tells them, 0 if it does not."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    told = [float(line.split(":")[1]) for line in lines if line.startswith("cpu MHz")]
    return told[0] * 1e6 if told else 0.0


def _copied() -> float:
    """Bytes per second that go from memory to memory, counted there and back."""
    some, other = np.zeros(COPIED), np.ones(COPIED)
    least = np.inf
    for _ in range(5):
        begin = time.perf_counter()
        np.copyto(some, other)
        least = min(least, time.perf_counter() - begin)
    return 2 * some.nbytes / least


def _tape(tape: Tape, parameters: tuple[str, ...]) -> int:
    _, _, program = prepared(linearise(tape, tape.quantities, parameters))
    return sum(COSTS.get(one.name, 1) for one in program.instructions)


def _whitening(m: int, k: int, n: int) -> int:
    """Loadings, Gram-Schmidt, E, D and corrections of one pose."""
    orthonormal = sum(4 * i * k + 3 * k for i in range(m))
    return m * k + orthonormal + 2 * m * k + m * (m + 1) + n * m * m + (2 * m + 1) * k


def _timed(run: Callable[[], object]) -> float:
    """The least processor time [s] of a run, per pose."""
    least = np.inf
    for _ in range(REPEATS):
        begin = time.thread_time()
        run()
        least = min(least, time.thread_time() - begin)
    return least / POSES
