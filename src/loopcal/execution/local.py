"""Work on the cores of this machine: by processes, or by threads of this one."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import Any

from loopcal.errors import InputError, UsageError
from loopcal.execution.executor import Done, Executor, InProcess, Piece, Shared, Value, done


def cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@dataclass(frozen=True)
class _Local(Executor):
    """Workers on this machine, by default one for each core.

    Raises UsageError for fewer than one.
    """

    workers: int = field(default_factory=cores)

    def __post_init__(self) -> None:
        if self.workers < 1:
            raise UsageError(f"{self.workers} workers do no work", remedy="give 1 or more")


@dataclass(frozen=True)
class Threads(_Local):
    """Threads of this process: nothing is copied, and Python itself runs in one at a time.

    >>> from loopcal.execution.executor import gathered
    >>> gathered(Threads(2), pow, 2, range(5))
    [1, 2, 4, 8, 16]
    """

    def run(
        self, work: Callable[[Shared, Piece], Value], shared: Shared, pieces: Sequence[Piece]
    ) -> Generator[Done[Value], None, None]:
        """What became of every piece, in the order of completion."""
        pool = ThreadPoolExecutor(self.workers)
        try:
            waiting = {pool.submit(done, work, shared, piece, n) for n, piece in enumerate(pieces)}
            for future in as_completed(waiting):
                waiting.discard(future)
                yield future.result()
        finally:
            pool.shutdown(cancel_futures=True)

    def ready(self) -> str:
        """Where pieces will be done."""
        return f"{self.workers} threads"


@dataclass(frozen=True)
class Processes(_Local):
    """Processes of this machine, fresh ones for every run.

    They are started by importing the main module anew: a script that uses them does its work
    under `if __name__ == "__main__":`. They end with this process, however it ends.
    """

    def run(
        self, work: Callable[[Shared, Piece], Value], shared: Shared, pieces: Sequence[Piece]
    ) -> Generator[Done[Value], None, None]:
        """What became of every piece, in the order of completion.

        Raises InputError where a worker is killed.
        """
        workers = min(self.workers, len(pieces))
        if workers <= 1:
            yield from InProcess().run(work, shared, pieces)
            return
        spawning = get_context("spawn")
        ending, alive = spawning.Pipe(duplex=False)
        pool = ProcessPoolExecutor(
            workers, mp_context=spawning, initializer=_begin, initargs=(ending, work, shared)
        )
        try:
            waiting = {pool.submit(_work, piece, n) for n, piece in enumerate(pieces)}
            for future in as_completed(waiting):
                waiting.discard(future)
                yield future.result()
        except BrokenProcessPool:
            raise InputError(
                "a worker ended before its work was done, killed or out of memory",
                remedy="use fewer workers (--workers); a study goes on where it was",
            ) from None
        except BaseException:
            alive.close()  # nobody waits for the pieces that are being done
            raise
        finally:
            pool.shutdown(cancel_futures=True)
            alive.close()
            ending.close()

    def ready(self) -> str:
        """Where pieces will be done."""
        return f"{self.workers} processes"


_given: dict[str, Any] = {}
"""What this worker process works with."""


def _begin(ending: Connection, work: Any, shared: Any) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent stops its workers
    threading.Thread(target=_end_with, args=(ending,), daemon=True).start()
    _given.update(work=work, shared=shared)


def _end_with(parent: Connection) -> None:
    """The parent's end of the pipe is closed when the work is to end, or the parent has died."""
    parent.poll(None)
    os._exit(1)


def _work(piece: Any, number: int) -> Done[Any]:
    return done(_given["work"], _given["shared"], piece, number)
