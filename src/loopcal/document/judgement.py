"""Facts and findings: what was found out, which question it answers, and what to do.

An analysis states facts: a code, numbers with units, a place. `loopcal.document.catalogue` holds a
row for each code, which turns a fact into a finding with its sentence and its next step.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Literal

from loopcal.presentation.rounding import significant
from loopcal.presentation.shown import chance, percent, with_unit

Severity = Literal["refuse", "caution", "info"]
Question = Literal["sound", "valid", "better", "tolerance", "consistent"]
SEVERITIES: tuple[Severity, ...] = ("refuse", "caution", "info")
"""The gravest first."""


@dataclass(frozen=True)
class Figure:
    """A number behind a finding."""

    value: float
    unit: str = "1"
    """SI unit, "1" for a ratio or a count."""

    def __format__(self, form: str) -> str:
        """For people: "3" significant digits, "1%" decimals of a percentage, "p" a probability.

        >>> f"{Figure(0.00123456, 'm'):2}, {Figure(0.512):1%}, {Figure(3e-9):p}"
        '1.2 mm, 51.2 %, 3e-09'
        """
        if form == "p":
            return chance(self.value)
        if form.endswith("%"):
            return percent(self.value, int(form[:-1] or 0))
        digits = int(form or 3)
        if self.unit == "1":
            return significant(self.value, digits)
        return with_unit(self.value, self.unit, digits)


@dataclass(frozen=True)
class Where:
    """What a finding speaks of, by names; all empty: the calibration as a whole."""

    poses: tuple[str, ...] = ()
    readings: tuple[str, ...] = ()
    parameters: tuple[str, ...] = ()
    targets: tuple[str, ...] = ()
    files: tuple[str, ...] = ()


@dataclass(frozen=True)
class Fact:
    """What an analysis found out; the first number is the one that decides."""

    code: str
    numbers: Mapping[str, Figure] = field(default_factory=dict)
    place: Where = Where()
    texts: Mapping[str, str] = field(default_factory=dict)
    """Names and phrases for its sentence."""


def fact(
    code: str, place: Where = Where(), numbers: Mapping[str, float | Figure] = {}, **texts: str
) -> Fact:
    """A fact; plain numbers are ratios or counts."""
    figures = {n: v if isinstance(v, Figure) else Figure(v) for n, v in numbers.items()}
    return Fact(code, figures, place, texts)


@dataclass(frozen=True)
class NextStep:
    """What to do about a finding."""

    words: str
    command: str | None = None
    """A command line to copy; null: none does it alone."""


@dataclass(frozen=True)
class Finding:
    """One thing that was found out about a result."""

    code: str
    """Stable, for programs; docs/explanation/verdict.md describes each."""
    severity: Severity
    """refuse: the answer is no; caution: it stays open; info: no objection."""
    question: Question | None
    """The question that it answers; null: none."""
    place: Where
    numbers: Mapping[str, Figure]
    words: str
    next: NextStep | None
    """Null: nothing is to be done."""
    title: str = ""
    """The finding in one line; empty: written by an earlier version."""

    @property
    def mark(self) -> str:
        """no, open or yes: the answer that it leads to."""
        return {"refuse": "no", "caution": "open", "info": "yes"}[self.severity]

    @property
    def number(self) -> float | None:
        """The figure that decides."""
        return next((figure.value for figure in self.numbers.values()), None)


def answered(findings: Iterable[Finding]) -> bool | None:
    """What the findings on a question answer: False where one refuses, None where one leaves it
    open, else True."""
    severities = {one.severity for one in findings}
    return False if "refuse" in severities else None if "caution" in severities else True
