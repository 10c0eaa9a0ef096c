"""Runs command lines in a process of their own, forked from one that has loopcal loaded.

A run that is cancelled, crashes or is killed takes nothing with it: what a command writes, it
writes whole or not at all. Each run has a fresh process, so memory does not grow from run to run.
A run ends where its server has ended: nothing goes on that no page shows.
"""

from __future__ import annotations

import io
import multiprocessing
import multiprocessing.forkserver
import os
import shlex
import signal
import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any, TextIO

from loopcal.errors import LoopcalError
from loopcal.execution.forked import waits_only
from loopcal.expressions.choice import cores, engine_threads

Command = Callable[[Sequence[str]], int]
"""`loopcal.cli.run.main`: a command line in, its exit code out."""
LINES = 2_000
"""So many lines of a run are kept; of more the last ones."""
LONGEST = 2_000_000
"""Characters of output that are kept."""
PRELOADED = [
    *("numpy", "polars", "scipy.linalg", "loopcal.workflow.calibration"),
    *("loopcal.workflow.projects", "loopcal.files.project.project_schema"),
    "loopcal.workflow.beginning.initial",
    *("loopcal.files.machines.registry", "loopcal.report.page"),
]
"""What the warm process loads beside the command itself."""
WRITTEN = (0, 4)
"""Exit codes of a run that has written what it makes."""
_GRACE = 3.0
"""Seconds that a cancelled run has to end by itself."""


class Busy(LoopcalError):
    """Another run goes on in this folder."""


@dataclass(eq=False)
class Run:
    """One run; code: its exit code, None while it goes on; progress: the latest line of it."""

    action: Action
    lines: list[str] = field(default_factory=list)
    output: str = ""
    """What it printed on stdout, where it is not too long."""
    progress: str = ""
    code: int | None = None
    cancelled: bool = False
    began: float = field(default_factory=time.monotonic)

    @property
    def text(self) -> str:
        """What the command printed."""
        return "\n".join(self.lines)

    def add_output(self, stream: str, text: str) -> None:
        """Take what the process printed; a carriage return begins a line of progress."""
        if stream == "stderr" and text.startswith("\r"):
            self.progress = text.strip()
            return
        if stream == "stdout" and len(self.output) < LONGEST:
            self.output += text
        self.lines += text.splitlines()
        del self.lines[:-LINES]


class Worker:
    """Runs one action at a time.

    begun: called before a run begins; ended: called in a thread when it is over, before another
    one can begin; tell: called when a run has said something.
    """

    def __init__(
        self,
        command: Command,
        begun: Callable[[Action], Any],
        ended: Callable[[Run], Any],
        tell: Callable[[], Any] = lambda: None,
    ) -> None:
        names = multiprocessing.get_all_start_methods()
        # A fork of the server would inherit the locks of its threads, held for ever.
        self.context: Any = multiprocessing.get_context(
            "forkserver" if "forkserver" in names else "spawn"
        )
        if "forkserver" in names:
            self.context.set_forkserver_preload([command.__module__, *PRELOADED])
            multiprocessing.forkserver.ensure_running()  # loads while the user looks
        self._command = command
        self._begun, self._ended, self._tell = begun, ended, tell
        self._lock = threading.Lock()
        self._process: BaseProcess | None = None
        self.run: Run | None = None

    @property
    def busy(self) -> bool:
        """Whether a run goes on."""
        return self.run is not None and self.run.code is None

    def start(self, action: Action, folder: str) -> Run:
        """Begin a run. Raises Busy while another one goes on."""
        with self._lock:
            if self.busy:
                assert self.run is not None
                raise Busy(f"{self.run.action.what} goes on; cancel it or wait")
            self._begun(action)
            heard, said = self.context.Pipe()
            run = Run(action)
            process = self.context.Process(
                target=_work, args=(self._command, action.words, folder, said)
            )
            process.start()
            # The child alone holds this end now: recv ends where the child dies.
            said.close()
            self.run, self._process = run, process
        threading.Thread(target=self._listen, args=(run, process, heard), daemon=True).start()
        return run

    def cancel(self) -> None:
        """End the run; what it has not finished is not written."""
        with self._lock:
            run, process = self.run, self._process
        if run is None or process is None or run.code is not None:
            return
        run.cancelled = True
        process.terminate()
        threading.Thread(target=_killed_late, args=(process,), daemon=True).start()

    def _listen(self, run: Run, process: BaseProcess, heard: Connection) -> None:
        while True:
            try:
                stream, text = heard.recv()
            except (EOFError, OSError):
                break
            run.add_output(stream, text)
            self._tell()
        process.join()
        with self._lock:
            code = process.exitcode if process.exitcode is not None else -1
            # A run may come to its end ahead of the signal.
            run.cancelled = run.cancelled and code not in WRITTEN
            run.code = code
            self._ended(run)


def _killed_late(process: BaseProcess) -> None:
    process.join(_GRACE)
    if process.is_alive():
        process.kill()


class _Said:
    """A text stream whose lines go to the server."""

    encoding = "utf-8"

    def __init__(self, name: str, connection: Connection) -> None:
        self.name, self.connection, self.begun = name, connection, ""

    def write(self, text: str) -> int:
        """Send what makes whole lines, or a line of progress."""
        self.begun += text
        if self.begun.startswith("\r") or "\n" in self.begun:
            whole, newline, rest = self.begun.rpartition("\n")
            self._send(whole if newline else rest)
            self.begun = rest if newline else ""
        return len(text)

    def _send(self, text: str) -> None:
        with suppress(OSError):  # the server is gone
            self.connection.send((self.name, text))

    def flush(self) -> None:
        """Nothing is kept back but the beginning of a line."""

    def isatty(self) -> bool:
        """Progress comes often, as on a terminal; data are plain."""
        return self.name == "stderr"

    def close(self) -> None:
        """Send what is left."""
        if self.begun.strip():
            self._send(self.begun)


def _work(command: Command, words: tuple[str, ...], folder: str, said: Connection) -> None:
    """In the child: run the command line."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # so that what is begun is undone
    watcher = threading.Thread(target=_ends_with, args=(said,), daemon=True)
    watcher.start()
    os.chdir(folder)
    out, error = _Said("stdout", said), _Said("stderr", said)
    streams: list[TextIO] = [out, error]  # type: ignore[list-item]
    sys.stdout, sys.stderr = streams
    with waits_only(watcher), engine_threads(cores()):
        code = command(words)
    out.close()
    error.close()
    # What libraries print as the process ends has no reader any more.
    sys.stdout = sys.stderr = io.StringIO()
    raise SystemExit(code)


def _ends_with(server: Connection) -> None:
    """In the child: interrupt the run where the server is gone."""
    with suppress(EOFError, OSError):
        server.recv()  # the server sends nothing: this returns when it has ended
    signal.raise_signal(signal.SIGTERM)
    time.sleep(_GRACE)
    os._exit(1)


# An action of the app: a command line of loopcal in the project's folder.


@dataclass(frozen=True)
class Action:
    """words: what follows `loopcal` on the command line; what: a few words for the user.

    Whoever types `command` in the folder gets the same files.
    """

    what: str
    words: tuple[str, ...]

    @property
    def command(self) -> str:
        """As it is typed."""
        return f"loopcal {shlex.join(self.words)}"
