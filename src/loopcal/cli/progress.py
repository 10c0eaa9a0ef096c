"""Progress of a long fit on stderr: one line that changes on a terminal, else a line at times."""

from __future__ import annotations

import sys
import time
from types import TracebackType
from typing import TextIO

AFTER, ON_TERMINAL, ELSEWHERE = 2.0, 0.2, 10.0
"""Seconds until the first line, and between lines."""


class Progress:
    """Called by the solver at every iteration; a context that leaves a clean line behind."""

    def __init__(self, stream: TextIO | None = None) -> None:
        self.stream = stream or sys.stderr
        self.terminal = self.stream.isatty()
        self.due = time.monotonic() + AFTER
        self.shown = 0

    def __call__(self, iteration: int, chi_squared: float, decrease: float) -> None:
        """Show iteration, chi-squared and its predicted decrease, if it is time to."""
        now = time.monotonic()
        if now < self.due:
            return
        self.due = now + (ON_TERMINAL if self.terminal else ELSEWHERE)
        line = f"iteration {iteration}: chi-squared {chi_squared:.6g}, to gain {decrease:.2g}"
        if self.terminal:
            self.stream.write("\r" + line.ljust(self.shown))
            self.shown = len(line)
        else:
            self.stream.write(line + "\n")
        self.stream.flush()

    def __enter__(self) -> Progress:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self.shown:
            self.stream.write("\r" + " " * self.shown + "\r")
            self.stream.flush()
