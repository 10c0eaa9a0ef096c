"""The points of a search, and what an interrupted fit resumes from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Generic

import numpy as np
from numpy.typing import NDArray

from loopcal.estimation.solve.merit import Evaluation, State
from loopcal.estimation.solve.reduction import Spectrum

Array = NDArray[np.float64]
_PLACES, _ARRAYS = ("first", "current", "lowest"), ("effects", "last_step", "recent")


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
    found: Evaluation[State]
    merit: float
    spectrum: Spectrum | None
    closed: float | None

    @property
    def place(self) -> Place[State]:
        """What it takes to evaluate the point again."""
        return Place(self.parameters, self.found.state, self.found.closing, self.merit)


@dataclass(frozen=True)
class Checkpoint(Generic[State]):
    """What the solver keeps at the beginning of an iteration: all it needs to go on exactly.

    first, current, lowest: where the search began, is, and was lowest; effects: (n,) lengths of the
    parameters' columns at the beginning; last_step: (n,) [SI], None where there is none; recent:
    (h, 2, n) [SI], the steps and moves that led here, as `Course` keeps them; before: the decrement
    one iteration ago; floor: the decrement that rounding hides; away: iterations since the lowest
    point; descend: whether the merit must fall at every step; triangular: whether the parameter
    system is kept as a triangle; iterations, evaluations: done so far; stage, earlier: of a robust
    fit, which of its fits this is, and the iterations before it.
    """

    first: Place[State]
    current: Place[State]
    lowest: Place[State]
    effects: Array
    last_step: Array | None
    recent: Array | None
    damping: float
    before: float
    floor: float
    away: int
    descend: bool
    triangular: bool
    iterations: int
    evaluations: int
    stage: int = 0
    earlier: int = 0

    def document(self) -> dict[str, Any]:
        """The checkpoint in plain lists, numbers and names; the state must be such itself."""
        found = asdict(self)
        for place in (found[name] for name in _PLACES):
            place["parameters"] = place["parameters"].tolist()
        for name in _ARRAYS:
            found[name] = None if found[name] is None else found[name].tolist()
        return found

    @classmethod
    def read(cls, document: Mapping[str, Any]) -> Checkpoint[Any]:
        """The checkpoint from its document. Raises TypeError or KeyError for any other."""
        places = {
            name: Place(**{**document[name], "parameters": np.array(document[name]["parameters"])})
            for name in _PLACES
        }
        arrays = {
            name: None if document[name] is None else np.array(document[name]) for name in _ARRAYS
        }
        return cls(**{**document, **places, **arrays})
