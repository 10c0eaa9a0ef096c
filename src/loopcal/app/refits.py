"""Fits from where the last result ended, in a separate process.

It writes nothing, so the folder has the last complete result until a calibration replaces it.
"""

from __future__ import annotations

import threading
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from loopcal.errors import LoopcalError
from loopcal.statistics.continued import Ending
from loopcal.workflow.refitting import Refit, run_refit


@dataclass(frozen=True)
class Asked:
    """What is fitted: the text of a project, from where the result of this time ended [ns];
    method: instead of the project's."""

    text: str
    result: int | None
    method: str | None = None


class Refits:
    """Runs one fit at a time; the latest wins. context: that the processes come from."""

    def __init__(self, context: Any, function: str | None = None) -> None:
        self._context, self._function = context, function
        self._lock = threading.Lock()
        self._process: Any = None
        self.asked: Asked | None = None
        self.found: Refit | None = None
        self.going = False

    def begin(self, asked: Asked, project: Path, ending: Ending) -> None:
        """Fit; a fit that goes on is of use no longer."""
        with self._lock:
            if self._process is not None:
                self._process.kill()
            heard, said = self._context.Pipe(duplex=False)
            self.asked, self.found, self.going = asked, None, True
            given = (project, ending, asked.method, self._function, said)
            self._process = self._context.Process(target=_refit, args=given, daemon=True)
            self._process.start()
            said.close()
        own = (asked, self._process, heard)
        threading.Thread(target=self._listen, args=own, daemon=True).start()

    def _listen(self, asked: Asked, process: Any, heard: Connection) -> None:
        found = None
        with suppress(EOFError, OSError):
            found = heard.recv()
        process.join()
        with self._lock:
            if self.asked is asked:
                self.found, self.going = found, False

    def end(self) -> None:
        """End a fit that goes on."""
        with self._lock:
            if self._process is not None:
                self._process.kill()


def _refit(
    project: Path, ending: Ending, method: str | None, function: str | None, said: Connection
) -> None:
    """In the child: fit; where that cannot be done, the calibration says why."""
    with suppress(LoopcalError):
        said.send(run_refit(project, ending, method=method, function=function))
