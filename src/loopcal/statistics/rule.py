"""A rule of the verdict: what speaks against a result, and what to do."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from loopcal.document.result_document import ResultDocument

RARE = 1e-3
"""p-value of a single test from which a result is not sound: several tests are made."""
LOOSE = 0.25
"""Chi-squared per degree of freedom of sds twice as large as the readings show."""
COLUMN_FAULT = "column-fault"
"""The code of a file at fault: nothing that follows from it means anything."""


@dataclass(frozen=True)
class Said:
    """What a rule found: in a sentence, and the figure behind it."""

    words: str
    number: float | None = None


@dataclass(frozen=True)
class Rule:
    """One finding that speaks against a result.

    passed: False where the result is not sound, None where the question stays open; finds: what
    there is to say, None where the rule does not apply; next: what to do.
    """

    code: str
    passed: bool | None
    finds: Callable[[ResultDocument], Said | None]
    next: str
