"""What was learnt of the model error: terms, groups of parameters that share one prior sd."""

from __future__ import annotations

from dataclasses import dataclass

from loopcal.document.bounds import Count, Size

# p = 0.0008: half of chi-squared(1), as a variance of 0 is at the boundary (Self and Liang 1987).
DECISIVE = 10.0
"""Gain in -2 log restricted likelihood from which a model without the term is wrong."""
_CLEAR, _MOST = 3.0, 3
"""Sds from which a part is told, and how many of a term."""


@dataclass(frozen=True)
class TermPart:
    """What a term does at one joint; of a smooth discrepancy: at all of them."""

    joints: tuple[str, ...]
    """The joints concerned, or "base"."""
    unit: str
    """SI unit of size and sd."""
    size: Size
    """The largest over the measured poses; of a smooth discrepancy the rms over them."""
    sd: Size | None
    """Of the size; null: unknown."""
    pose: str | None
    """The pose where it is so large; null: an rms."""
    words: str
    """In a sentence."""

    @property
    def clear(self) -> bool:
        """Whether it is more than its uncertainty."""
        return self.sd is not None and self.size > _CLEAR * self.sd


@dataclass(frozen=True)
class TermEntry:
    """One term and its learnt scale."""

    name: str
    unit: str
    """SI unit of scale and interval."""
    scale: Size
    """The learnt prior sd that its parameters share."""
    interval: tuple[Size, Size | None] | None
    """95 % interval of the scale; null: unknown; an upper end of null: unbounded."""
    expected: Size | None
    """The sd stated for it, median of its prior."""
    columns: Count
    """Its estimated parameters."""
    effective: Size
    """Degrees of freedom that the data use of them: from 0, no effect, to their number."""
    gain: float | None
    """By how much the term lowers -2 log of the restricted likelihood; null: unknown."""
    words: str
    """What it means for the machine, in a sentence."""
    effects: tuple[str, ...] = ()
    """Those of its parameters that are no dimension of the drawing: single ones say little."""
    parts: tuple[TermPart, ...] = ()
    """What it does joint by joint, the largest first."""

    @property
    def spared(self) -> float:
        """Degrees of freedom that it uses although the data need nothing of it; else its scale."""
        needed = self.gain is None or self.gain >= DECISIVE
        return 1.0 if needed else self.effective

    @property
    def sentences(self) -> tuple[str, ...]:
        """What the term does to the machine, a sentence per joint, where the data need it."""
        if self.gain is None or self.gain < DECISIVE:
            return ()
        return tuple(part.words for part in self.parts if part.clear)[:_MOST]
