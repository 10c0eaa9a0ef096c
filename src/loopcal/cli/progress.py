"""Progress of long work on stderr: one line that changes on a terminal, else a line at times."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from types import TracebackType
from typing import TYPE_CHECKING, Self, TextIO

from loopcal.cli.output import log, shown, silence
from loopcal.presentation.shown import with_unit

if TYPE_CHECKING:
    from loopcal.estimation.result import Result

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

    def fitted(self, result: Result) -> None:
        """Show the accuracy of the fit while it is judged; on a terminal at once."""
        accuracy = result.accuracy_after
        if accuracy is not None:
            self.fitted_words = f"fitted: error {with_unit(accuracy.rms, accuracy.unit)} rms; "
        if self.terminal:
            self.due = 0.0
        self.show(lambda _: f"{self.fitted_words}judging")


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
