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
_PLACES, _ARRAYS = ("first", "current", "lowest"), ("effects", "recent")


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


@dataclass(frozen=True)
class Checkpoint(Generic[State]):
    """What the solver keeps at the beginning of an iteration: all it needs to go on exactly.

    first, current, lowest: where the search began, is, and was lowest; effects: (n,) lengths of the
    parameters' columns at the beginning; recent: (h, 2, n) [SI], the steps and moves that led here,
    as `Course` keeps them; before: the decrement one iteration ago; floor: the decrement that
    rounding hides; noted: the merit when progress was last looked at; triangular: whether the
    parameter system is kept as a triangle; iterations, evaluations: done so far; stage, earlier: of
    a robust fit, which fit of several this is, and the iterations before it.
    """

    first: Place[State]
    current: Place[State]
    lowest: Place[State]
    effects: Array
    recent: Array | None
    damping: float
    before: float
    floor: float
    noted: float
    triangular: bool
    iterations: int
    evaluations: int
    stage: int = 0
    earlier: int = 0

    def document(self) -> dict[str, Any]:
        """The checkpoint in plain lists, numbers and names; the state must be such itself."""
        fields = asdict(self)
        for place in (fields[name] for name in _PLACES):
            place["parameters"] = place["parameters"].tolist()
        for name in _ARRAYS:
            fields[name] = None if fields[name] is None else fields[name].tolist()
        return fields

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
