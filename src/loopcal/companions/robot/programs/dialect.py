"""A dialect of robot programs: which files it has, how it is read and marked, how it is written."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from loopcal.arrays import Array
from loopcal.companions.robot.programs.coordinates import JointAxes
from loopcal.companions.robot.programs.program import Program, written

WAIT = 3.0
"""Seconds at each pose."""


@dataclass(frozen=True, eq=False)
class Stops:
    """Poses to drive to.

    name: of the program; ids: of the poses, with what each is for; values: (N, n) in degrees and
    millimetres, in pulses, or in SI, as the format has them; units: deg or mm of each joint; words:
    lines of a comment at its head.
    """

    name: str
    ids: Sequence[str]
    values: Array
    units: Sequence[str]
    words: Sequence[str]

    def texts(self, decimals: int) -> list[list[str]]:
        """(N, n) with so many decimals."""
        return [[written(v, decimals) for v in row] for row in self.values.tolist()]


@dataclass(frozen=True)
class Drive:
    """How a dialect drives to poses.

    write: the lines of a program; longest: characters of its name; si, pulses: whether its numbers
    are SI or pulses, instead of degrees and millimetres; ended: how lines end.
    """

    write: Callable[[Stops], list[str]]
    longest: int
    si: bool = False
    pulses: bool = False
    ended: str = "\r\n"


@dataclass(frozen=True)
class ProgramDialect:
    """A kind of program.

    kind: as messages call it, that of its `Program`; targets, configuration: what is corrected and
    kept, its row in docs/how-to/correct-a-program.md; endings: of its files, the first of those
    that are written; read(text, name, axes): its targets; drive: how poses are driven to, None
    where nothing is written; comment, head: what begins a comment, and behind what the mark of a
    corrected program stands, none where there is no place.
    """

    kind: str
    targets: str
    configuration: str
    endings: tuple[str, ...]
    read: Callable[[str, str, JointAxes], Program]
    drive: Drive | None = None
    comment: str = ""
    head: re.Pattern[str] | None = None
