"""Random loop functions for laws that must hold for every tape; their values stay moderate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from hypothesis import strategies as st

QUANTITIES = ("a", "b", "c")
PARAMETERS = ("k", "l")

# Every operation, kept inside its domain and away from where it is not smooth.
UNARY: tuple[Callable[[Any], Any], ...] = (
    lambda a: -a,
    lambda a: a + 0.5,
    lambda a: 0.25 - a,
    lambda a: a * -1.5,
    lambda a: 3.0 / (2.5 + np.cos(a)),
    np.sin,
    np.cos,
    lambda a: np.tan(0.7 * np.sin(a)),
    lambda a: np.arcsin(0.9 * np.sin(a)),
    lambda a: np.arccos(0.9 * np.cos(a)),
    np.arctan,
    lambda a: np.sqrt(np.square(a) + 0.3),
    lambda a: np.exp(np.sin(a)),
    lambda a: np.log(1.5 + np.sin(a)),
    lambda a: abs(2.0 + np.sin(a)),
    lambda a: np.sin(a) ** 3,
    lambda a: (1.5 + np.cos(a)) ** -2.5,
    lambda a: 1.7 ** np.sin(a),
)
BINARY: tuple[Callable[[Any, Any], Any], ...] = (
    lambda a, b: a + b,
    lambda a, b: a - b,
    lambda a, b: np.sin(a) * b,
    lambda a, b: a / (2.0 + np.sin(b)),
    lambda a, b: (1.5 + np.sin(a)) ** np.cos(b),
    lambda a, b: np.hypot(a, 1.0 + np.square(np.sin(b))),
    lambda a, b: np.arctan2(np.sin(a), 1.5 + np.cos(b)),
    lambda a, b: np.arctan2(1.5 + np.sin(a), b),
)


@dataclass(frozen=True)
class RandomLoops:
    """Steps of a program on a growing list of values; the last `loops` values are the loops."""

    steps: tuple[tuple[int, int, int], ...]
    loops: int

    def __call__(self, x: Any, p: Any) -> list[Any]:
        values = [*(x[i] for i in range(len(QUANTITIES))), *(p[i] for i in range(len(PARAMETERS)))]
        for operation, first, second in self.steps:
            a = values[first % len(values)]
            if operation < len(UNARY):
                values.append(UNARY[operation](a))
            else:
                values.append(BINARY[operation - len(UNARY)](a, values[second % len(values)]))
        # every loop must contain a quantity
        return [v + (0.5 + i) * x[0] for i, v in enumerate(values[-self.loops :])]


def random_loops() -> st.SearchStrategy[RandomLoops]:
    """Programs of up to 14 operations with one to three loops."""
    step = st.tuples(
        st.integers(0, len(UNARY) + len(BINARY) - 1), st.integers(0, 30), st.integers(0, 30)
    )
    return st.builds(
        RandomLoops, st.lists(step, min_size=1, max_size=14).map(tuple), st.integers(1, 3)
    )
