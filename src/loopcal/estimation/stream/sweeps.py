"""Calibration of more poses than memory holds: the same solver over chunks that come and go.

A sweep adds up over poses, so it can take them chunk by chunk. Nothing is kept of a pose between
sweeps: its corrections are found again from its readings, which costs an evaluation or two more
and needs no memory. What a sweep returns in their place only says whether the loops were closed.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.estimation.problem.enough import refuse_too_few
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.solve.in_memory import cannot_close
from loopcal.estimation.solve.merit import Evaluation, Failed
from loopcal.estimation.solve.reduction import Accumulator
from loopcal.estimation.solve.sweep import NEAR
from loopcal.estimation.stream.pieces import SweepPiece, Swept, Task
from loopcal.execution.executor import Crew, in_order

Array = NDArray[np.float64]


@dataclass(frozen=True)
class StreamedProblem(Problem):
    """A stream as the solver and statistics see it: with some of its poses in memory, or none.

    counted: loop equations of the whole stream; total: its poses; named: the ids of some.
    """

    counted: int = 0
    total: int = 0
    named: Mapping[int, str] = field(default_factory=dict)

    @property
    def equations(self) -> int:
        """Loop equations over all poses, less the unmeasured quantities they determine."""
        return self.counted

    @property
    def count(self) -> int:
        """How many poses the stream has."""
        return self.total

    def pose(self, number: int) -> str:
        """The id of a pose, where it is known, else its number from 1."""
        return self.named.get(number, str(number + 1))


class StreamMerit:
    """The merit over the poses of a stream, its chunks evaluated by a crew and added in order.

    Its state says whether loops are closed; corrections are found anew from the readings. first:
    the problem of the first chunk; equations: of the whole stream, sizes: poses of each chunk, both
    known from the first evaluation on.
    """

    def __init__(self, task: Task, crew: Crew, first: Problem) -> None:
        prior_sd = np.full(len(first.free), np.inf) if task.exact else first.prior_sd
        self.unknowns = replace(first.unknowns, prior_sd=prior_sd)
        self.task, self.crew = task, crew
        self.evaluations = 0
        self.equations = 0
        self.sizes: list[int] = []
        self._units = first.units

    def first(self, parameters: Array) -> Evaluation[bool]:
        """The evaluation to begin from.

        Raises InputError where a loop has no value or cannot be corrected, and for too few
        equations.
        """
        found = self._evaluated(parameters, triangular=False, closing=None, first=True)
        if found.singular:
            raise cannot_close(found.singular)
        refuse_too_few(found.equations, found.poses, self.unknowns)
        return found

    def evaluate(
        self,
        parameters: Array,
        state: bool,
        *,
        triangular: bool = False,
        closing: float | None = None,
        contraction: float = 1.0,
    ) -> Evaluation[bool]:
        """The evaluation at parameters (n_all,), from the readings of every chunk.

        contraction is not used: it says nothing of steps that begin anew.
        """
        closing = NEAR if closing is None and state else closing
        return self._evaluated(parameters, triangular=triangular, closing=closing)

    def close(
        self, parameters: Array, state: bool, tolerance: float, contraction: float
    ) -> bool | None:
        """Nothing to do: the loops of a chunk are closed when its corrections are asked for."""
        return True

    def _evaluated(
        self, parameters: Array, *, triangular: bool, closing: float | None, first: bool = False
    ) -> Evaluation[bool]:
        data = Accumulator(len(self.unknowns.free), triangular, self._units)
        parts = [
            SweepPiece(number, parameters, triangular, closing, first)
            for number in range(self.task.stream.count)
        ]
        step = contraction = rounding = 0.0
        equations, sizes, singular, late = 0, list[int](), Failed(), Failed()
        with contextlib.closing(self.crew(parts)) as outcomes:
            for part in in_order(outcomes):
                assert isinstance(part, Swept)
                found = part.found
                data.add_other(found.data)
                step, contraction = max(step, found.step), max(contraction, found.contraction)
                rounding = found.rounding
                singular, late = singular + found.singular, late + found.late
                sizes.append(found.poses)
                equations += found.equations
                self.evaluations += part.evaluations
        self.sizes, self.equations = sizes, equations
        return Evaluation(
            data,
            state=closing is not None,
            proposal=True,
            step=step,
            contraction=contraction,
            closing=closing,
            rounding=rounding,
            equations=equations,
            poses=sum(sizes),
            singular=singular,
            late=late,
        )
