"""Progress of long work on stderr: one line that changes on a terminal, else a line at times."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Self, TextIO

from loopcal.cli.output import log, shown, silence
from loopcal.errors import InputError, UsageError
from loopcal.presentation.shown import with_unit

if TYPE_CHECKING:
    from loopcal.estimation.result import FitResult
    from loopcal.execution.executor import Executor


AFTER, ON_TERMINAL, ELSEWHERE = 2.0, 0.2, 10.0
"""Seconds until the first line, and between lines."""


class _Line:
    """A context that leaves a clean line behind."""

    def __init__(self, stream: TextIO | None = None) -> None:
        self.stream = stream or sys.stderr
        self.terminal = self.stream.isatty()
        self.began = time.monotonic()
        self.due = self.began + AFTER
        self.shown = 0

    def show(self, line: Callable[[float], str]) -> None:
        """Show what `line` makes of the seconds since the beginning, if it is time to."""
        now = time.monotonic()
        if now < self.due:
            return
        self.due = now + (ON_TERMINAL if self.terminal else ELSEWHERE)
        text = shown(line(now - self.began))
        # Blanks cover the end of a longer line before.
        self._write("\r" + text.ljust(self.shown) if self.terminal else text + "\n")
        self.shown = len(text) if self.terminal else 0

    def waiting(self) -> None:
        """Say what is waited for after an interrupt."""
        self.clear()
        log("waiting for running pieces to finish")

    def clear(self) -> None:
        """Leave the line empty."""
        if self.shown:
            self._write("\r" + " " * self.shown + "\r")
            self.shown = 0

    def _write(self, text: str) -> None:
        try:
            self.stream.write(text)
            self.stream.flush()
        except OSError:  # a full disk shall not end the work
            silence(self.stream)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.clear()


class Progress(_Line):
    """Called by the solver at every iteration."""

    fitted_words = ""
    """The accuracy of the fit, once it is there."""

    def __call__(self, iteration: int, chi_squared: float, decrease: float) -> None:
        """Show iteration, chi-squared and its predicted decrease, if it is time to."""
        self.show(
            lambda _: (
                f"iteration {iteration}: chi-squared {chi_squared:.6g}, expected decrease "
                f"{decrease:.2g}"
            )
        )

    def pieces(self, what: str, done: int, total: int) -> None:
        """Show how many of the folds, or of other pieces, are done, if it is time to."""
        self.show(lambda _: f"{self.fitted_words}{done} of {total} {what}")

    def fitted(self, result: FitResult) -> None:
        """Show the accuracy of the fit while it is judged; on a terminal at once."""
        accuracy = result.accuracy_after
        if accuracy is not None:
            self.fitted_words = f"fitted: error {with_unit(accuracy.rms, accuracy.unit)} rms; "
        if self.terminal:
            self.due = 0.0
        self.show(lambda _: f"{self.fitted_words}judging")


class Stages(_Line):
    """Called when another stage begins; on a terminal it is shown at once."""

    def __call__(self, what: str, percent: int) -> None:
        """Show what is done, and how much of the work was done before."""
        if self.terminal:
            self.due = 0.0
        self.show(lambda _: f"{what}: {percent} %")


class Counted(_Line):
    """Called when another piece of work is done."""

    def __call__(self, done: int, total: int) -> None:
        """Show how much is done and what time the rest will take, if it is time to."""
        self.show(
            lambda since: f"{done} of {total} fits, {_time(since / done * (total - done))} left"
        )


def _time(seconds: float) -> str:
    """A duration in its two largest units.

    >>> _time(7.2), _time(92), _time(7500)
    ('7 s', '1 min 32 s', '2 h 05 min')
    """
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02} min"


# Who does the work of a command: the options --workers and --cluster.


def executor_of(
    workers: int | None, cluster: str | None, *, waiting: Callable[[], None] | None = None
) -> Executor | None:
    """The executor that the options ask for, None where they ask for none.

    waiting: workers of this machine are threads, which tell by it that they are waited for;
    without it processes.

    Raises UsageError for both options or an empty one, InputError for a file that states no
    scheduler.
    """
    if workers is None and cluster is None:
        return None
    from loopcal.execution.cluster import Cluster
    from loopcal.execution.local import Processes, Threads

    if cluster is None:
        assert workers is not None
        return Processes(workers) if waiting is None else Threads(workers, waiting)
    if workers is not None:
        raise UsageError(
            "--workers and --cluster exclude each other: --workers is for this machine only",
            remedy="give only one of them",
        )
    if not cluster.strip():
        raise UsageError(
            "--cluster names no scheduler",
            code="no-scheduler",
            remedy="give its address, such as tcp://host:8786, or the file it writes",
        )
    return Cluster(_stated(cluster) if cluster.endswith(".json") else cluster)


def try_cluster(executor: Executor) -> None:
    """See whether a cluster is there, and say what is waited for and what was found.

    Raises UsageError where it cannot be used at all, InputError where it is not there.
    """
    from loopcal.execution.cluster import Cluster

    if isinstance(executor, Cluster):
        log(f"connecting to {executor.name}")
        log(executor.ready())


def _stated(path: str) -> str:
    """The address in the file that a scheduler writes for its clients."""
    try:
        return str(json.loads(Path(path).read_text("utf-8"))["address"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        reason = getattr(error, "strerror", None) or "it states no address"
        raise InputError(
            f"this is not a scheduler file ({reason})",
            code="wrong-file-type",
            place=path,
            remedy="give the file written by dask scheduler --scheduler-file FILE, or "
            "tcp://HOST:PORT",
        ) from None
