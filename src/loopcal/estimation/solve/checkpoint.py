"""The points of a search, and what an interrupted fit resumes from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Generic

import numpy as np

from loopcal.arrays import Array
from loopcal.estimation.solve.course import Course
from loopcal.estimation.solve.merit import Evaluation, State
from loopcal.estimation.solve.reduction import Spectrum

_PLACES = ("first", "current", "lowest")


@dataclass(frozen=True)
class Place(Generic[State]):
    """An evaluated point, without the arrays by pose: what it takes to evaluate it again."""

    parameters: Array
    state: State
    closing: float | None
    merit: float


@dataclass(frozen=True)
class Point(Generic[State]):
    """A trial: parameters, evaluation, merit and parameter system; closed: how well loops are."""

    parameters: Array
    evaluation: Evaluation[State]
    merit: float
    spectrum: Spectrum | None
    closed: float | None

    @property
    def place(self) -> Place[State]:
        """What it takes to evaluate the point again."""
        return Place(self.parameters, self.evaluation.state, self.evaluation.closing, self.merit)


@dataclass
class Checkpoint(Generic[State]):
    """The state of a search at the beginning of an iteration: all it needs to go on exactly.

    The search changes it in place: copies would take a twentieth of the time of a small fit.
    first, current, lowest: where the search began, is, and was lowest; effects: (n,) lengths of the
    parameters' columns at the beginning; floor: the decrement that rounding hides; course: how far
    the next step may go; before: the decrement one iteration ago; noted: the merit when progress
    was last looked at; triangular: whether the parameter system is kept as a triangle; iterations,
    evaluations: done so far; stage, earlier: of a robust fit, which fit of several this is, and the
    iterations before it.
    """

    first: Place[State]
    current: Place[State]
    lowest: Place[State]
    effects: Array
    floor: float
    course: Course = field(default_factory=Course)
    before: float = np.inf
    noted: float = np.inf
    triangular: bool = False
    iterations: int = 0
    evaluations: int = 0
    stage: int = 0
    earlier: int = 0

    @classmethod
    def at(cls, start: Point[State], floor: float) -> Checkpoint[State]:
        """Where a search begins."""
        place = start.place
        return cls(place, place, place, start.evaluation.data.lengths, floor)

    def document(self) -> dict[str, Any]:
        """The checkpoint in plain lists, numbers and names; the state must be such itself."""
        return {name: _plain(value) for name, value in asdict(self).items()}

    @classmethod
    def read(cls, document: Mapping[str, Any]) -> Checkpoint[Any]:
        """The checkpoint from its document. Raises TypeError or KeyError for any other."""
        places = {
            name: Place(**{**document[name], "parameters": np.array(document[name]["parameters"])})
            for name in _PLACES
        }
        course, effects = document["course"], np.array(document["effects"])
        recent = None if course["recent"] is None else np.array(course["recent"])
        course = Course(**{**course, "recent": recent})
        return cls(**{**document, **places, "course": course, "effects": effects})


def _plain(value: Any) -> Any:
    """Arrays as lists, however deep."""
    if isinstance(value, dict):
        return {name: _plain(part) for name, part in value.items()}
    return value.tolist() if isinstance(value, np.ndarray) else value
