"""What an interrupted fit resumes from: the solver's state at the beginning of an iteration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Generic

import numpy as np
from numpy.typing import NDArray

from loopcal.estimation.solve.merit import State

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Place(Generic[State]):
    """An evaluated point, without the arrays by pose: what it takes to evaluate it again."""

    parameters: Array
    state: State
    closing: float | None
    merit: float


@dataclass(frozen=True)
class Checkpoint(Generic[State]):
    """What the solver keeps at the beginning of an iteration: all it needs to go on exactly.

    first, current: where the search began, and where it is; before: the decrement one iteration
    ago; floor: the decrement that rounding hides; triangular: whether the parameter system is
    kept as a triangle; iterations, evaluations: done so far; stage, earlier: of a robust fit, which
    of its fits this is, and the iterations before it.
    """

    first: Place[State]
    current: Place[State]
    damping: float
    before: float
    floor: float
    triangular: bool
    iterations: int
    evaluations: int
    stage: int = 0
    earlier: int = 0

    def document(self) -> dict[str, Any]:
        """The checkpoint in plain lists, numbers and names; the state must be such itself."""
        found = asdict(self)
        for place in found["first"], found["current"]:
            place["parameters"] = place["parameters"].tolist()
        return found

    @classmethod
    def read(cls, document: Mapping[str, Any]) -> Checkpoint[Any]:
        """The checkpoint from its document. Raises TypeError or KeyError for any other."""
        places = {
            name: Place(**{**document[name], "parameters": np.array(document[name]["parameters"])})
            for name in ("first", "current")
        }
        return cls(**{**document, **places})
