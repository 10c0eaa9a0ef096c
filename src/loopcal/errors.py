"""The errors a user can meet, each with the exit code it ends the command with.

An error says what is wrong, why that stops us, and what to do about it:

>>> raise InputError("sd is -0.1 mrad; an sd cannot be negative",
...                  place="arm.toml: noise.theta_1", remedy="give 0 for an exact sensor")
Traceback (most recent call last):
    ...
loopcal.errors.InputError: arm.toml: noise.theta_1: sd is -0.1 mrad; an sd cannot be negative
  What to do: give 0 for an exact sensor
"""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches


class LoopcalError(Exception):
    """Root of all errors raised on purpose; by itself it means a fault of ours (exit code 1)."""

    exit_code = 1

    def __init__(
        self, message: str, *, place: str | None = None, remedy: str | None = None
    ) -> None:
        self.message = message
        self.place = place
        self.remedy = remedy
        super().__init__(message)

    def __str__(self) -> str:
        text = f"{self.place}: {self.message}" if self.place else self.message
        return f"{text}\n  What to do: {self.remedy}" if self.remedy else text

    def at(self, place: str) -> LoopcalError:
        """The same error with the place filled in, for callers that know the file."""
        joined = f"{place}: {self.place}" if self.place else place
        return type(self)(self.message, place=joined, remedy=self.remedy)


class UsageError(LoopcalError):
    """A command called with arguments that do not go together (exit code 2)."""

    exit_code = 2


class InputError(LoopcalError):
    """A file, column, unit, value or key that cannot be used as it stands (exit code 3)."""

    exit_code = 3


class DomainError(InputError):
    """An operation of a loop equation met a value outside its domain (exit code 3)."""


class NoTrustworthyResult(LoopcalError):
    """The fit ended, but its result does not meet what was asked of it (exit code 4)."""

    exit_code = 4


def nearest(name: str, known: Iterable[str]) -> str:
    """A remedy naming the known spelling nearest to `name`, or all of them.

    >>> nearest("collumns", ["columns", "file"])
    "did you mean 'columns'?"
    """
    choices = list(known)
    folded = {choice.casefold(): choice for choice in reversed(choices)}
    close = get_close_matches(name.casefold(), folded, n=1, cutoff=0.6)
    if close:
        return f"did you mean {folded[close[0]]!r}?"
    return "known are " + ", ".join(repr(c) for c in choices) if choices else "none is known here"
