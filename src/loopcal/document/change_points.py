"""Change points: what moved between two poses, by how much, and the lines that model it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from loopcal.document.bounds import Count, Probability, Size
from loopcal.presentation.shown import enumerated, with_unit

Moved = Literal["target", "station", "joint", "reading"]
_WORDS = {
    "target": "the target {names} moved on the body",
    "station": "the instrument or the machine's base moved ({names})",
    "joint": "the zero of the joint {names} changed",
    "reading": "the zero of {names} changed",
}


@dataclass(frozen=True)
class Change:
    """By how much one parameter or reading changed."""

    size: float
    """[unit]"""
    sd: Size
    unit: str


@dataclass(frozen=True)
class ChangePoint:
    """Something changed between two poses that follow each other, and stayed so."""

    shape: Literal["step", "ramp"]
    """Whether it changed at once, or all along the run in proportion to the number of the pose."""
    pose: str
    """The first pose after the change; of a ramp the first of all."""
    after: str
    """The last pose before it; of a ramp the last of all."""
    number: Count
    """Of that first pose in the order of the poses, from 1."""
    moved: Moved
    changes: Mapping[str, Change]
    """Parameter or reading -> its change."""
    gain: Size
    """What chi-squared falls by, in units of the scatter of the residuals."""
    p_value: Probability
    """Of a gain at least so large in independent errors, corrected for the search."""
    alternatives: tuple[str, ...] = ()
    """Parameters or readings whose change would explain it about as well."""
    moves: Size | None = None
    """Rms distance [unit] over the poses by which all of it moves the end point; null: unknown."""
    unit: str = ""
    """Of moves."""
    modelled: bool = False
    """Whether the result has it as an effect, as the method "auto" gives it where it is certain."""

    @property
    def names(self) -> tuple[str, ...]:
        """What changed: parameters or readings."""
        return tuple(self.changes)

    @property
    def what(self) -> str:
        """When it changed, and what."""
        text = f"{when([self])} {_WORDS[self.moved].format(names=', '.join(self.names))}"
        return f"{text} (or else {'; '.join(self.alternatives)})" if self.alternatives else text

    @property
    def sizes(self) -> str:
        """By how much, and how sure."""
        # Parts within their noise would read as moves; all are shown only where none is clear.
        clear = {n: c for n, c in self.changes.items() if abs(c.size) >= 3.0 * c.sd}
        moved = (clear or self.changes).items()
        sizes = ", ".join(f"{name} by {with_unit(c.size, c.unit)}" for name, c in moved)
        return f"{sizes}, p = {self.p_value:.2g}"

    def __str__(self) -> str:
        return f"{self.what}: {self.sizes}"


@dataclass(frozen=True)
class ChangePoints:
    """What a search for change points found."""

    found: tuple[ChangePoint, ...]
    """In the order of the poses."""
    level: Probability
    """Of finding any in independent errors."""
    poses: Count
    """Poses that were searched; 0: too many or too few."""
    toml: str = ""
    """The lines of a project or mechanism file that model them."""
    unsure: tuple[ChangePoint, ...] = ()
    """Steps without a sharp edge: a slow drift or a smooth model error explains them as well."""


def when(points: Sequence[ChangePoint]) -> str:
    """When these changes happened."""
    steps = [point.pose for point in points if point.shape == "step"]
    words = [f"from pose{'s' if len(steps) > 1 else ''} {enumerated(steps)} on"] if steps else []
    return " and ".join(words + ["over the whole run"] * (len(steps) < len(points)))


def hold(points: Sequence[ChangePoint]) -> str:
    """For which state of a machine with these changes predictions hold."""
    if any(point.shape == "ramp" for point in points):
        return "Predictions hold for the end of the run."
    return "Predictions hold after the last change."
