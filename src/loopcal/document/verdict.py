"""The verdict on a calibration: four questions, each with an answer, a number and a next step."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from loopcal.presentation.wrapped import wrapped

QUESTIONS = ("sound", "valid", "better", "tolerance")
"""The four questions, in the order in which they are asked."""


@dataclass(frozen=True)
class Answer:
    """The answer to one of the four questions."""

    passed: bool | None
    """Null: undecided, or not asked."""
    code: str
    """The kind of the answer: stable, for programs."""
    number: float | None
    """What the answer rests on [SI, or a ratio]; null: no number."""
    words: str
    """The answer in a sentence."""
    next: str | None
    """What to do next; null: nothing."""

    @property
    def mark(self) -> str:
        """yes, no or open."""
        return "open" if self.passed is None else "yes" if self.passed else "no"


@dataclass(frozen=True)
class Verdict:
    """Whether a calibration can be used, and for what."""

    sound: Answer
    """Converged, and noise and model are consistent."""
    valid: Answer
    """Where: the predicted sd in the working region beside that at the measured poses."""
    better: Answer
    """Better than the nominal machine, placed and mounted, and than plain least squares."""
    tolerance: Answer
    """Good enough for the stated tolerance."""
    headline: str
    """The worst of the answers in one sentence."""

    @property
    def grade(self) -> str:
        """good, care or bad: of the worst answer."""
        asked = [a.passed for a in self.answers.values() if a.code != "no-tolerance"]
        return "bad" if False in asked else "care" if None in asked else "good"

    @property
    def answers(self) -> dict[str, Answer]:
        """By question."""
        return {name: getattr(self, name) for name in QUESTIONS}

    def lines(self) -> list[str]:
        """The headline, and a line for each question with what to do."""
        return [*wrapped(self.headline), *answer_lines(self.answers)]


def answer_lines(answers: Mapping[str, Answer]) -> list[str]:
    """A line for each question that was asked, and what to do."""
    found = []
    wide = max(map(len, answers))
    for name, answer in answers.items():
        if answer.code == "no-tolerance":
            continue
        head, margin = f"  {name:<{wide}}  {answer.mark:<4}  ", " " * (wide + 10)
        found += wrapped(answer.words, head, margin)
        if answer.next:
            found += wrapped(answer.next, margin, margin)
    return found
