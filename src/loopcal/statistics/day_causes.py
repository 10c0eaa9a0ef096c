"""What may have changed between a calibration and another day, and in which directions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.statistics.another_day import Day
from loopcal.statistics.innovation import Linearised
from loopcal.statistics.possible_changes import BETWEEN_DAYS, Possible, as_learnt, possible
from loopcal.statistics.replacing import Replaced


@dataclass(frozen=True, eq=False)
class Causes:
    """What may have changed of all that is held: causes with m directions in all.

    names: (n,) of what they move; W: (n, m) by how much; owner: (m,) the cause of each direction;
    units: (m,) of the directions.
    """

    causes: tuple[Possible, ...]
    names: tuple[str, ...]
    W: Array
    owner: NDArray[np.intp]
    units: NDArray[np.str_]

    @classmethod
    def of(cls, day: Day, linear: Linearised) -> Causes:
        """Without what is placed anew."""
        placement, problem = linear.placement, linear.placement.problem
        anew = dict(zip(problem.mechanism.parameters.names, placement.anew, strict=True))
        causes, before = list[Possible](), day.calibrated
        for one in possible(problem, BETWEEN_DAYS):
            held = tuple(n for n in one.names if not anew.get(n))
            if held and (held == one.names or not one.parts):
                one = replace(one, names=held)
                causes += as_learnt(one, before.prior_sd, before.covariance.matrix, linear)
        directions = [(i, d) for i, one in enumerate(causes) for d in one.directions]
        names = tuple(dict.fromkeys(n for _, d in directions for n in d))
        W = np.zeros((len(names), len(directions)))
        for column, (_, direction) in enumerate(directions):
            for name, amount in direction.items():
                W[names.index(name), column] = amount
        owner = np.array([i for i, _ in directions], dtype=np.intp)
        units = np.array([unit for one in causes for unit in one.part_units(problem)], dtype=str)
        return cls(tuple(causes), names, W, owner, units)

    def columns(self, placement: Replaced) -> Array:
        """(R, m)"""
        return np.asarray(placement.columns(self.names) @ self.W)

    def changes(self, t: Array) -> dict[str, float]:
        """By name [SI], of changes t (m,)."""
        moved = self.W @ t
        return {self.names[i]: float(moved[i]) for i in np.flatnonzero(moved).tolist()}

    def joined(self, chosen: Sequence[int], j: int) -> tuple[int, ...]:
        """With a further cause, which may be one of them in more parts."""
        return (*(i for i in chosen if self.causes[i].called != self.causes[j].called), j)

    def rows(self, i: int) -> NDArray[np.intp]:
        """The directions of a cause."""
        return np.flatnonzero(self.owner == i)
