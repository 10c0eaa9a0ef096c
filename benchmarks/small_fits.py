"""Small fits beside odrpack, which gets loopcal's tape: one, and a Monte Carlo study of many."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import ours
from measuring import DisagreementError, Times, in_turns
from problems import Fit, planar
from programs import odrpack_on_tape

POSES, DRAWS = 100, 1_000
DEMANDED = 1.0
"""How many times odrpack's time loopcal may take."""
AGREED = 1e-9
"""Largest relative difference of chi-squared."""


@dataclass(frozen=True)
class Small:
    """The same fits by loopcal and by odrpack."""

    fits: str
    ours: Times
    odrpack: Times

    @property
    def ratio(self) -> float:
        """loopcal's time beside odrpack's."""
        return self.ours.median / self.odrpack.median


def measure(draws: int = DRAWS) -> list[Small]:
    """The planar arm; raises DisagreementError unless both programs find the same."""
    drawn = [planar(POSES, seed) for seed in range(1, draws + 1)]
    mine = [ours.solver(problem) for problem in drawn]
    theirs = [odrpack_on_tape(problem) for problem in drawn]
    title = f"Monte Carlo: {draws:,} fits of {POSES} poses"
    return [
        compared(f"one fit of {POSES} poses", mine[:1], theirs[:1], rounds=9),
        compared(title, mine, theirs, rounds=3),
    ]


def compared(
    fits: str, mine: list[Callable[[], Fit]], theirs: list[Callable[[], Fit]], rounds: int
) -> Small:
    """Both in turns; raises DisagreementError unless every chi-squared is the same."""
    programs: dict[str, Callable[[], list[Fit]]] = {
        "ours": ours.on_engine(ours.BEST, lambda: [f() for f in mine], 1),
        "odrpack": lambda: [f() for f in theirs],
    }
    for one, other in zip(programs["ours"](), programs["odrpack"](), strict=True):
        apart = abs(one.chi_squared / other.chi_squared - 1.0)
        if not apart <= AGREED:
            raise DisagreementError(f"{fits}: chi-squared differs by {apart:.2g} from odrpack's")
    return Small(fits, **in_turns(programs, rounds=rounds))
