"""What was learnt of the model error: terms, groups of parameters that share one prior sd."""

from __future__ import annotations

from dataclasses import dataclass

from loopcal.document.bounds import Count, Size


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
