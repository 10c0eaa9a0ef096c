"""One interface for work in pieces, whoever does it, and the plainest one: here, one by one.

A piece is a pure function of what all pieces share and of itself, so where and in which order
pieces are done, or done again after a worker was lost, changes no value.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Generic, TypeVar

from loopcal.errors import LoopcalError

Shared = TypeVar("Shared")
Piece = TypeVar("Piece")
Value = TypeVar("Value")
Progress = Callable[[int, int], None]
"""Called with how many pieces are done, and how many there are."""


@dataclass(frozen=True)
class Done(Generic[Value]):
    """What became of the piece of this number: its value, or the error it ended with."""

    number: int
    outcome: Value | LoopcalError

    @property
    def value(self) -> Value:
        """Its value; raises its error, if it ended with one."""
        if isinstance(self.outcome, LoopcalError):
            raise self.outcome
        return self.outcome


class Executor(ABC):
    """Does work in pieces.

    >>> list(InProcess().run(pow, 2, [3, 4]))
    [Done(number=0, outcome=8), Done(number=1, outcome=16)]
    """

    @abstractmethod
    def run(
        self, work: Callable[[Shared, Piece], Value], shared: Shared, pieces: Sequence[Piece]
    ) -> Generator[Done[Value], None, None]:
        """What became of work(shared, piece) for every piece, once, in the order of completion.

        work: a function at the top of a module, and no clock, disk or random number that is not
        in what it is given; shared goes to every worker once. All of them can be pickled.
        Raises InputError where workers are lost for good. Closing the generator ends the work.
        """

    def ready(self) -> str:
        """Where pieces will be done, in words; raises what `run` would, before any work."""
        return "in this process"


@dataclass(frozen=True)
class InProcess(Executor):
    """One piece after the other, here."""

    def run(
        self, work: Callable[[Shared, Piece], Value], shared: Shared, pieces: Sequence[Piece]
    ) -> Generator[Done[Value], None, None]:
        """What became of every piece, in their order."""
        for number, piece in enumerate(pieces):
            yield done(work, shared, piece, number)


def done(
    work: Callable[[Shared, Piece], Value], shared: Shared, piece: Piece, number: int
) -> Done[Value]:
    """Do one piece; a user's mistake is its outcome, a fault of ours is raised."""
    try:
        return Done(number, work(shared, piece))
    except LoopcalError as error:
        return Done(number, error)


def gathered(
    executor: Executor | None,
    work: Callable[[Shared, Piece], Value],
    shared: Shared,
    pieces: Sequence[Piece],
    progress: Progress | None = None,
) -> list[Value]:
    """The values of all pieces in their order, by an executor (None: in this process).

    Raises the error of the first piece that has one, whichever was done first.
    """
    outcomes: dict[int, Done[Value]] = {}
    values: list[Value] = []
    with closing((executor or InProcess()).run(work, shared, pieces)) as found:
        for outcome in found:
            outcomes[outcome.number] = outcome
            while len(values) in outcomes:
                values.append(outcomes.pop(len(values)).value)
            if progress:
                progress(len(values) + len(outcomes), len(pieces))
    return values
