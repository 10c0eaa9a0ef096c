"""The programs that are compared: loopcal in several ways, and others that solve the same.

Each is prepared for a problem before its time is taken: it is loaded, readings are as it wants
them, models are traced. Each goes up to the number of poses that it does in reasonable time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from shutil import which

import ours
from problems import Fit, Problem

from loopcal.expressions.choice import AVAILABLE

Run = Callable[[], Fit]
ALL, THREADS = 1_000_000, 2


@dataclass(frozen=True)
class Program:
    """Something that calibrates: prepare(problem) gives what is timed.

    most: poses; needs: a package or a command; demanded: how many times loopcal's time it takes at
    1,000 poses of the six-axis arm, at least.
    """

    name: str
    most: int
    prepare: Callable[[Problem], Run]
    needs: str = ""
    demanded: float | None = None

    @property
    def installed(self) -> bool:
        """Whether it can run here."""
        return not self.needs or bool(find_spec(self.needs) or which(self.needs))


def _ours(make: Callable[[Problem], Run], engine: str, threads: int) -> Callable[[Problem], Run]:
    return lambda problem: ours.on_engine(engine, make(problem), threads)


def _module(name: str) -> Callable[[Problem], Run]:
    return lambda problem: partial(import_module(name).calibrate, problem)


def odrpack_on_tape(problem: Problem) -> Run:
    """odrpack, given loopcal's own model and derivatives."""
    import odrpack_explicit as odr

    return partial(odr.calibrate, odr.on_tape(problem))


COMPILED = [
    Program("loopcal, 2 threads", ALL, _ours(ours.solver, "compiled", THREADS)),
    Program("loopcal, 1 thread", ALL, _ours(ours.solver, "compiled", 1)),
]
NUMPY = Program("loopcal, NumPy engine", ALL, _ours(ours.solver, "numpy", 1))
WHOLE = Program("loopcal, calibrate()", ALL, _ours(ours.calibrator, ours.BEST, THREADS))
PROGRAMS = [
    *(COMPILED if AVAILABLE else []),
    NUMPY,
    WHOLE,
    Program(
        "odrpack, NumPy by hand", 10_000, _module("odrpack_explicit"), "odrpack", demanded=150.0
    ),
    Program("odrpack, loopcal's tape", 100_000, odrpack_on_tape, "odrpack"),
    Program("seed's loop, NumPy", 10_000, _module("seed_program"), demanded=400.0),
    Program("seed's loop, GNU Octave", 1_000, _module("octave_program"), needs="octave-cli"),
    Program("scipy least_squares", 10_000, _module("scipy_least_squares")),
    Program("sparse KKT, SuperLU", 10_000, _module("sparse_kkt")),
    Program("gtsam, Python factors", 100_000, _module("gtsam_factors"), needs="gtsam"),
    Program("pyceres, Python costs", 10_000, _module("pyceres_costs"), needs="pyceres"),
]
"""The first is the one that all others are compared with."""
