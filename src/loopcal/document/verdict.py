"""The verdict on a calibration: four questions, each with an answer, a number and a next step."""

from __future__ import annotations

from dataclasses import dataclass


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
