"""Fits from where the last result ended, in a separate process.

It writes nothing, so the folder has the last complete result until a calibration replaces it. The
process stays for the next fit: one that has just begun takes longer to load than to fit.
"""

from __future__ import annotations

import asyncio
import signal
import threading
from collections.abc import AsyncGenerator, Callable
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from loopcal.errors import LoopcalError
from loopcal.statistics.continued import Ending
from loopcal.workflow.projects import Refit, run_refit


@dataclass(frozen=True)
class Asked:
    """What is fitted: the text of a project, from where the result of this time ended [ns];
    method: instead of the project's; readings: another value whenever their files have changed."""

    text: str
    result: int | None
    method: str | None = None
    readings: object = None


@dataclass(frozen=True, eq=False)
class _Fitter:
    """The process, and the connection to it."""

    process: Any
    connection: Connection


class Refits:
    """Runs one fit at a time; the latest wins.

    context: that the process comes from; tell: called when a fit has ended.
    """

    def __init__(self, context: Any, tell: Callable[[], Any], function: str | None = None) -> None:
        self._context, self._tell, self._function = context, tell, function
        self._lock = threading.Lock()
        self._fitter: _Fitter | None = None
        self.asked: Asked | None = None
        self.refit: Refit | None = None
        self.going = False

    def begin(self, asked: Asked, project: Path, ending: Ending) -> None:
        """Fit, unless that was asked last; another fit that goes on is of use no longer."""
        with self._lock:
            if asked == self.asked:
                return
            if self.going:
                self._end()
            self.asked, self.refit, self.going = asked, None, True
            if self._fitter is None:
                self._fitter = self._started()
            with suppress(OSError):  # killed a moment ago: the thread that listens says so
                self._fitter.connection.send((project, ending, asked.method))

    @property
    def process(self) -> Any:
        """The process that waits for the next fit, or fits; None where there is none."""
        with self._lock:
            return None if self._fitter is None else self._fitter.process

    def _end(self) -> None:
        if self._fitter is not None:
            self._fitter.process.kill()
        self._fitter, self.going = None, False

    def _started(self) -> _Fitter:
        connection, other = self._context.Pipe()
        process = self._context.Process(target=_fit, args=(self._function, other), daemon=True)
        process.start()
        # The child alone holds this end now: recv ends where the child dies.
        other.close()
        fitter = _Fitter(process, connection)
        threading.Thread(target=self._listen, args=(fitter,), daemon=True).start()
        return fitter

    def _listen(self, fitter: _Fitter) -> None:
        with suppress(EOFError, OSError):
            while True:
                self._received(fitter, fitter.connection.recv())
        fitter.process.join()
        fitter.connection.close()
        self._gone(fitter)

    def _received(self, fitter: _Fitter, refit: Refit | None) -> None:
        with self._lock:
            if self._fitter is not fitter:
                return  # another one fits what was asked since
            self.refit, self.going = refit, False
        self._tell()

    def _gone(self, fitter: _Fitter) -> None:
        with self._lock:
            if self._fitter is not fitter:
                return
            self._fitter, self.going = None, False
        self._tell()


def _fit(function: str | None, server: Connection) -> None:
    """In the child: fit what is asked until the server has ended; where that cannot be done, the
    calibration says why."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # of the terminal: the server ends this process
    with suppress(EOFError, OSError):
        while True:
            project, ending, method = server.recv()
            refit = None
            with suppress(LoopcalError):
                refit = run_refit(project, ending, method=method, function=function)
            server.send(refit)


# How pages learn that something has changed: by one subscription each.

APART = 0.02
"""Least seconds between two updates of a page."""


class News:
    """Tells every page that there is something new in the folder, in the run or in the first fit.

    What it is, a page sees for itself (`view.Part`): one that comes late has missed nothing.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._heard: tuple[Callable[[], Any], ...] = ()

    def subscribe(self, hear: Callable[[], Any]) -> Callable[[], None]:
        """Call `hear` from now on, in any thread; what is returned ends that."""
        with self._lock:
            self._heard += (hear,)

        def end() -> None:
            with self._lock:
                self._heard = tuple(one for one in self._heard if one is not hear)

        return end

    async def each(self) -> AsyncGenerator[None, None]:
        """Once now, and whenever there is something new; much at a time counts once."""
        new, loop = asyncio.Event(), asyncio.get_running_loop()
        new.set()

        def hear() -> None:
            with suppress(RuntimeError):  # the server is ending
                loop.call_soon_threadsafe(new.set)

        end = self.subscribe(hear)
        try:
            while True:
                await new.wait()
                # Cleared ahead of the drawing: what happens meanwhile is new again.
                new.clear()
                yield
                await asyncio.sleep(APART)
        finally:
            end()

    def tell(self) -> None:
        """There is something new."""
        for hear in self._heard:
            hear()
