"""Work on the cores of this machine: by processes, or by threads of this one."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from loopcal.errors import InputError, UsageError
from loopcal.execution.executor import (
    Crew,
    Done,
    Executor,
    InProcess,
    Window,
    Work,
    counted,
    done,
)
from loopcal.expressions.choice import cores, engine_threads
from loopcal.import_path import elsewhere

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

MOST_WORKERS = 1024


@dataclass(frozen=True)
class _Local(Executor):
    """Workers on this machine, by default one for each core.

    Raises UsageError for fewer than one, or more than 1,024.
    """

    workers: int = field(default_factory=cores)

    def __post_init__(self) -> None:
        if not 1 <= self.workers <= MOST_WORKERS:
            raise UsageError(
                f"workers is {self.workers}, outside 1 to {MOST_WORKERS}",
                remedy=f"give a number from 1 to {MOST_WORKERS}",
            )

    @property
    def _share(self) -> int:
        """Engine threads of a worker: processes together fill the cores; threads share one pool."""
        return max(1, cores() // self.workers)


@dataclass(frozen=True)
class Threads(_Local):
    """Threads of this process: nothing is copied, and Python itself runs in one at a time.

    waiting: called where the work is interrupted and pieces that are being done are waited for.

    >>> from loopcal.execution.executor import gathered
    >>> gathered(Threads(2), pow, 2, range(5))
    [1, 2, 4, 8, 16]
    """

    waiting: Callable[[], None] | None = field(default=None, compare=False, repr=False)

    @contextmanager
    def crew(self, work: Work, shared: Any) -> Generator[Crew, None, None]:
        """Threads that end with the context."""
        pool = ThreadPoolExecutor(self.workers)

        def begin(piece: Any, number: int) -> Future[Done[Any]]:
            return pool.submit(_shared_out, work, shared, piece, number, self._share)

        try:
            yield lambda pieces: _finished(begin, pieces, self.workers)
        except KeyboardInterrupt:
            if self.waiting:
                self.waiting()
            raise
        finally:
            pool.shutdown(cancel_futures=True)

    def ready(self) -> str:
        """Where pieces will be done."""
        return counted(self.workers, "thread")


@dataclass(frozen=True)
class Processes(_Local):
    """Processes of this machine, fresh ones for every crew.

    They are started by importing the main module anew: a script that uses them does its work
    under `if __name__ == "__main__":`. They end with this process, however it ends.
    """

    def run(
        self, work: Work, shared: Any, pieces: Sequence[Any]
    ) -> Generator[Done[Any], None, None]:
        """What became of every piece; a single one is not worth a process."""
        if len(pieces) <= 1:
            return InProcess().run(work, shared, pieces)
        return super().run(work, shared, pieces)

    @contextmanager
    def crew(self, work: Work, shared: Any) -> Generator[Crew, None, None]:
        """Processes that end with the context; a single one is this one.

        Runs raise InputError where a worker is killed, or none could begin.
        """
        if self.workers == 1:
            with InProcess().crew(work, shared) as process:
                yield process
            return
        from concurrent.futures.process import BrokenProcessPool, ProcessPoolExecutor
        from multiprocessing import get_context

        # Forked beside other threads, a process may hold a lock that is never released.
        spawning = get_context("spawn")
        ending, alive = spawning.Pipe(duplex=False)
        arguments = ending, work, shared, self._share
        with elsewhere():
            pool = ProcessPoolExecutor(
                self.workers, mp_context=spawning, initializer=_begin, initargs=arguments
            )

        some_done = False

        def begin(piece: Any, number: int) -> Future[Done[Any]]:
            return pool.submit(_work, piece, number)

        def outcomes(pieces: Sequence[Any]) -> Generator[Done[Any], None, None]:
            nonlocal some_done
            with closing(_finished(begin, pieces, self.workers)) as finished:
                for outcome in finished:
                    some_done = True
                    yield outcome

        try:
            with elsewhere():
                yield outcomes
        except BrokenProcessPool:
            raise _ended(some_done) from None
        except BaseException:
            alive.close()  # nobody waits for the pieces that are being done
            raise
        finally:
            # Workers end with the pipe: closed first, it would end pieces that are being done.
            pool.shutdown(cancel_futures=True)
            alive.close()
            ending.close()

    def ready(self) -> str:
        """Where pieces will be done."""
        return counted(self.workers, "process")


def _ended(some_done: bool) -> InputError:
    """What it means that a process ended, once some pieces were done or before any was."""
    if some_done:
        return InputError(
            "a worker ended early: killed or out of memory",
            code="worker-lost",
            remedy="use fewer workers (--workers); a study or stream resumes",
        )
    return InputError(
        "a worker ended before any work was done: killed, out of memory, or the script started "
        "workers again when each worker imported it",
        code="worker-lost",
        remedy='in a script, put the work under if __name__ == "__main__":, otherwise use fewer '
        "workers (--workers)",
    )


def _finished(
    begin: Callable[[Any, int], Future[Done[Any]]], pieces: Sequence[Any], workers: int
) -> Generator[Done[Any], None, None]:
    """What became of every piece, in the order of completion."""
    window = Window(len(pieces))
    waiting: set[Future[Done[Any]]] = set()
    try:
        while True:
            waiting |= {begin(pieces[number], number) for number in window.next(workers)}
            if not waiting:
                return
            finished, waiting = wait(waiting, return_when=FIRST_COMPLETED)
            while finished:
                outcome = finished.pop().result()
                window.take(outcome.number)
                yield outcome
    finally:
        for future in waiting:
            future.cancel()


def _shared_out(work: Any, shared: Any, piece: Any, number: int, threads: int) -> Done[Any]:
    with engine_threads(threads):
        return done(work, shared, piece, number)


_job: dict[str, Any] = {}
"""What this worker process works with."""


def _begin(ending: Connection, work: Any, shared: Any, threads: int) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent stops its workers
    threading.Thread(target=_end_with, args=(ending,), daemon=True).start()
    _job.update(work=work, shared=shared, threads=threads)


def _end_with(parent: Connection) -> None:
    """The parent's end of the pipe is closed when the work is to end, or the parent has died."""
    parent.poll(None)
    os._exit(1)


def _work(piece: Any, number: int) -> Done[Any]:
    return _shared_out(_job["work"], _job["shared"], piece, number, _job["threads"])
