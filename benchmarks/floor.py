"""Where the compiled engine's time goes, beside what its arithmetic alone would take.

Processor time of one thread for a pose of the six-axis arm: a sweep with all derivatives, whitening
and sums, the part of it up to the whitened rows, the tape alone, and a closing. Beside them the
floating-point operations of each, and how long they take if every cycle does two vectors of them.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from problems import six_axis

from loopcal.estimation.problem import build_problem
from loopcal.estimation.sweep import Sweeper
from loopcal.expressions.compiled_engine import program_for
from loopcal.expressions.derivative import linearise
from loopcal.expressions.loop_values import Stage
from loopcal.expressions.tape import Tape

POSES, REPEATS = 4096, 60
LANES = 8
COSTS = {"turn": 6, "plus": 3, "minus": 3, "sincos": 62}
"""Operations of an instruction; all others count one."""


@dataclass(frozen=True)
class Share:
    """A part of the work of a pose: processor time [s], and its floating-point operations."""

    name: str
    seconds: float
    operations: int

    def floor(self, hertz: float) -> float:
        """Time [s] with a full vector of products and one of sums in every cycle."""
        return self.operations / (2 * LANES * hertz)


def clock() -> float:
    """Cycles per second as the system tells them, 0 if it does not."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    told = [float(line.split(":")[1]) for line in lines if line.startswith("cpu MHz")]
    return told[0] * 1e6 if told else 0.0


def measure() -> list[Share]:
    """The shares, each containing the ones below it but for the closing."""
    os.environ["LOOPCAL_ENGINE"], os.environ["LOOPCAL_THREADS"] = "compiled", "1"
    arm = six_axis(POSES)
    problem = build_problem(arm.mechanism, arm.dataset, arm.noise)
    sweeper = Sweeper(problem)
    sweeper.at(problem.start)
    (pattern, poses), zeros = next(problem.blocks(POSES)), np.zeros_like(problem.readings)
    kernel, noise = sweeper.kernel(pattern), sweeper.noise(pattern, poses)
    given = (problem.readings, zeros, problem.known, noise)
    m, k, n = 3, 9, len(problem.free)
    tape = _tape(problem.mechanism.tape, problem.names)
    closing = _tape(problem.mechanism.tape, ())
    whitening = _whitening(m, k, n)
    engine = sweeper.engine(pattern)
    return [
        Share(
            "a sweep",
            _timed(lambda: kernel.equations(*given, summed=True)),
            tape + whitening + m * (n + 1) * (n + 2),
        ),
        Share(
            "of it up to whitened rows",
            _timed(lambda: kernel.equations(*given, summed=False)),
            tape + whitening,
        ),
        Share(
            "of that the tape",
            _timed(lambda: engine.evaluate(problem.readings, problem.known, Stage.BY_PARAMETER)),
            tape,
        ),
        Share("a closing", _timed(lambda: kernel.corrected(*given)), closing + _whitening(m, k, 0)),
    ]


def _tape(tape: Tape, parameters: tuple[str, ...]) -> int:
    program = program_for(linearise(tape, tape.quantities, parameters))
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
