"""A rule of the verdict: what speaks against a result, and what to do."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from loopcal.document.result_document import ResultDocument


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
