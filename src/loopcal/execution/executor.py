"""One interface for work in pieces, whoever does it, and the plainest one: here, one by one.

A piece is a pure function of what all pieces share and of itself, so where and in which order
pieces are done, or done again after a worker was lost, changes no value.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, closing, contextmanager
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from loopcal.errors import LoopcalError

Shared = TypeVar("Shared")
Piece = TypeVar("Piece")
Value = TypeVar("Value")
Progress = Callable[[int, int], None]
"""Called with how many pieces are done, and how many there are."""
AHEAD = 3
"""Pieces for each worker, done or being done, beyond the first that nobody has taken yet: enough
that no worker waits, so few that values do not pile up where whoever takes them is slow."""


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


Work = Callable[[Any, Any], Any]
"""What is done: of what all pieces share, and a piece."""
Crew = Callable[[Sequence[Any]], Generator[Done[Any], None, None]]
"""Workers that know their work: what became of every piece, once, in the order of completion."""


class Executor(ABC):
    """Does work in pieces.

    >>> list(InProcess().run(pow, 2, [3, 4]))
    [Done(number=0, outcome=8), Done(number=1, outcome=16)]
    """

    @abstractmethod
    def crew(self, work: Work, shared: Any) -> AbstractContextManager[Crew]:
        """Workers who are told once what they work with, for as many runs as are wanted.

        work: a function at the top of a module, whose value follows from what it is given alone:
        no clock, no random number, of the disk at most files that nobody changes. All of them can
        be pickled. Runs raise InputError where workers are lost for good. Closing a run leaves the
        rest of its pieces undone; leaving the context ends the work.
        """

    def run(
        self, work: Callable[[Shared, Piece], Value], shared: Shared, pieces: Sequence[Piece]
    ) -> Generator[Done[Value], None, None]:
        """What became of work(shared, piece) for every piece: a crew of one run."""
        with self.crew(work, shared) as done_by:
            yield from done_by(pieces)

    def ready(self) -> str:
        """Where pieces will be done, in words; raises what a run would, before any work."""
        return "in this process"


@dataclass(frozen=True)
class InProcess(Executor):
    """One piece after the other, here."""

    @contextmanager
    def crew(self, work: Work, shared: Any) -> Generator[Crew, None, None]:
        """This process itself."""

        def one_by_one(pieces: Sequence[Any]) -> Generator[Done[Any], None, None]:
            for number, piece in enumerate(pieces):
                yield done(work, shared, piece, number)

        yield one_by_one


def done(
    work: Callable[[Shared, Piece], Value], shared: Shared, piece: Piece, number: int
) -> Done[Value]:
    """Do one piece; a user's mistake is its outcome, a fault of ours is raised."""
    try:
        return Done(number, work(shared, piece))
    except LoopcalError as error:
        return Done(number, error)


def in_order(outcomes: Iterable[Done[Value]]) -> Iterator[Value]:
    """The values of all pieces in their order, each as soon as those before it are there.

    Raises the error of the first piece that has one, whichever was done first.
    """
    early: dict[int, Done[Value]] = {}
    following = 0
    for outcome in outcomes:
        early[outcome.number] = outcome
        while following in early:
            yield early.pop(following).value
            following += 1


def gathered(
    executor: Executor | None,
    work: Callable[[Shared, Piece], Value],
    shared: Shared,
    pieces: Sequence[Piece],
    progress: Progress | None = None,
) -> list[Value]:
    """The values of all pieces in their order, by an executor (None: in this process).

    Raises what `in_order` raises.
    """
    with closing((executor or InProcess()).run(work, shared, pieces)) as outcomes:
        return list(in_order(_reported(outcomes, len(pieces), progress)))


def _reported(
    outcomes: Iterable[Done[Value]], count: int, progress: Progress | None
) -> Iterator[Done[Value]]:
    for number, outcome in enumerate(outcomes, 1):
        yield outcome
        if progress:
            progress(number, count)


def counted(number: int, what: str) -> str:
    """So many of them.

    >>> counted(1, "thread"), counted(2, "process")
    ('1 thread', '2 processes')
    """
    return f"{number} {what}" + ("" if number == 1 else "es" if what.endswith("s") else "s")


class Window:
    """Which pieces may be begun: none too far ahead of the first that nobody has taken yet."""

    def __init__(self, count: int) -> None:
        self.count, self.begun, self.first = count, 0, 0
        self._taken: set[int] = set()

    def next(self, workers: int) -> range:
        """The numbers of the pieces that so many workers may begin now."""
        end = max(self.begun, min(self.count, self.first + AHEAD * workers))
        begin, self.begun = self.begun, end
        return range(begin, end)

    def take(self, number: int) -> None:
        """Somebody takes what became of this piece."""
        self._taken.add(number)
        while self.first in self._taken:
            self._taken.remove(self.first)
            self.first += 1
