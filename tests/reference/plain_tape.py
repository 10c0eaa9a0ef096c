"""A tape evaluated the plain way, pose by pose or in arrays, on real or complex numbers.

The engines are compared with it, and its complex step is the derivative that reverse mode must
meet: Im f(x + ih) / h with h = 1e-40 is exact to rounding (Squire and Trapp 1998).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.expressions.tape import Tape

STEP = 1e-40


def _arctan2(y: Any, x: Any) -> Any:
    if not (np.iscomplexobj(y) or np.iscomplexobj(x)):
        return np.arctan2(y, x)
    # the angle of x + iy turns by Im((x - iy)(dx + i dy)) / |x + iy|^2
    y, x = np.asarray(y, dtype=complex), np.asarray(x, dtype=complex)
    radius = x.real**2 + y.real**2
    return np.arctan2(y.real, x.real) + 1j * (x.real * y.imag - y.real * x.imag) / radius


FUNCTIONS: Mapping[str, Callable[..., Any]] = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": lambda a, b: a / b,
    "neg": lambda a: -a,
    "pow": lambda a, b: a**b,
    "square": lambda a: a * a,
    "sqrt": np.sqrt,
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "arcsin": np.arcsin,
    "arccos": np.arccos,
    "arctan": np.arctan,
    "arctan2": _arctan2,
    "hypot": lambda a, b: np.sqrt(a * a + b * b),
    "exp": np.exp,
    "log": np.log,
    "abs": lambda a: a * np.sign(np.real(a)),
    "sign": lambda a: np.sign(np.real(a)),
    "turn_cos": lambda a, b, c: a * np.cos(c) - b * np.sin(c),
    "turn_sin": lambda a, b, c: a * np.sin(c) + b * np.cos(c),
}
"""Every operation of a tape, written out once more and apart from the engine."""


def loop_values(tape: Tape, x: Any, p: Any, known: Any = ()) -> NDArray[Any]:
    """f (m, ...) from rows of x, p and known, in numbers or arrays of one shape."""
    inputs = {"quantity": x, "known": known, "parameter": p}
    values: list[Any] = []
    for name, payload in tape.operations:
        if name == "constant":
            values.append(payload[0])
        elif name in inputs:
            values.append(inputs[name][int(payload[0])])
        else:
            values.append(FUNCTIONS[name](*(values[int(a)] for a in payload)))
    return np.array(np.broadcast_arrays(*(values[o] for o in tape.outputs)))


@dataclass(frozen=True)
class Slopes:
    """by_quantity (k, m, N) and by_parameter (n, m, N)."""

    by_quantity: NDArray[np.float64]
    by_parameter: NDArray[np.float64]


def complex_step(
    tape: Tape, x: NDArray[np.float64], p: NDArray[np.float64], known: Any = ()
) -> Slopes:
    """Derivatives of the loops by every quantity and parameter; x (k, N), p (n,) or (n, N)."""
    p = np.broadcast_to(p if p.ndim == 2 else p[:, None], (len(p), x.shape[1]))

    def slopes(which: int) -> NDArray[np.float64]:
        rows = []
        for i in range(len((x, p)[which])):
            moved = [x.astype(complex), p.astype(complex)]
            moved[which][i] += 1j * STEP
            rows.append(np.imag(loop_values(tape, moved[0], moved[1], known)) / STEP)
        return np.array(rows).reshape(len(rows), len(tape.loops), x.shape[1])

    return Slopes(slopes(0), slopes(1))


_WEIGHTS = {1: 4 / 5, 2: -1 / 5, 3: 4 / 105, 4: -1 / 280}
"""Central difference of order 8."""


def difference(function: Callable[[Any], Any], at: Any, step: float) -> Any:
    """df/dx of a function of one variable by central differences of order 8."""
    total = sum(
        w * (function(at + i * step) - function(at - i * step)) for i, w in _WEIGHTS.items()
    )
    return total / step
