"""What the poses of a fit determine: its rank, and the directions in which nothing does."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.solve.reduction import spectrum, undetermined
from loopcal.estimation.solve.solver import Solution


@dataclass(frozen=True)
class Undetermined:
    """A direction in which neither data nor prior say anything: {parameter: share}, and words."""

    combination: Mapping[str, float]
    words: str

    @classmethod
    def of(cls, combination: Mapping[str, float]) -> Undetermined:
        """The direction, in words too."""
        names = [repr(name) for name in combination]
        listed = ", ".join(names[:-1]) + f" and {names[-1]}"
        words = (
            f"{names[0]} has no effect that these poses could show"
            if len(names) == 1
            else f"{listed} cannot be told apart by these poses"
        )
        return cls(MappingProxyType(dict(combination)), words)


@dataclass(frozen=True)
class Identifiability:
    """What can be told from these poses.

    rank: directions determined by data and prior, of `parameters` estimated ones; data_rank: by
    the data alone; condition_number: largest over smallest singular value of the column-scaled
    system, None if singular.
    """

    rank: int
    parameters: int
    data_rank: int
    condition_number: float | None
    not_identifiable: tuple[Undetermined, ...]

    @classmethod
    def of(cls, problem: Problem, solution: Solution) -> Identifiability:
        """At a solution, by its parameter system with and without the prior."""
        system = alone = solution.spectrum
        count = len(problem.free)
        if np.isfinite(problem.prior_sd).any():
            alone = spectrum(solution.data, np.zeros(count), np.full(count, np.inf))
        condition = system.condition
        return cls(
            system.rank,
            count,
            alone.rank,
            condition if system.rank == count and math.isfinite(condition) else None,
            tuple(Undetermined.of(c) for c in undetermined(system, problem.names)),
        )

    @property
    def loose(self) -> frozenset[str]:
        """The parameters that take part in a direction that is not determined."""
        return frozenset(name for u in self.not_identifiable for name in u.combination)

    def warnings(self) -> tuple[str, ...]:
        """What the reader must know of each of these directions."""
        return tuple(
            f"Not identifiable: {loose.words}. The fit moves along such a direction as little as "
            "it can; fix a parameter, give it a prior sd, or measure other poses."
            for loose in self.not_identifiable
        )
