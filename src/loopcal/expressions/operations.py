"""The elementary operations of a tape, each described once.

An operation is its name, functions of plain numbers and of arrays of poses,
text, and where it is defined. Everything else (tracing, derivatives, engines, printing, domain
errors) reads this table.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Operation:
    """One elementary operation.

    scalar evaluates one number, array one NumPy array of poses; text is a format string over
    its arguments, binding how tightly it binds (1 sums, 2 products, 3 powers, 4 functions);
    undefined states, for plain arguments, why value or derivative does not exist
    (None where they do).
    """

    name: str
    scalar: Callable[..., float]
    array: np.ufunc | None
    text: str
    binding: int = 4
    undefined: Callable[..., str | None] = lambda *arguments: None


def _hypot_undefined(a: float, b: float) -> str | None:
    return "has no derivative where both arguments are zero" if a == b == 0.0 else None


def _power_undefined(a: float, b: float) -> str | None:
    if a < 0.0 and b != int(b):
        return f"of a negative number ({a:.6g}) to the fractional power {b:.6g}"
    if a == 0.0 and b < 1.0:
        return f"of zero to the power {b:.6g}"
    return None


def _sqrt_undefined(a: float) -> str | None:
    if a < 0.0:
        return f"of a negative number ({a:.6g})"
    return "has no derivative at zero" if a == 0.0 else None


def _arc_undefined(a: float) -> str | None:
    if abs(a) > 1.0:
        return f"of a number outside -1 to 1 ({a:.6g})"
    return "has no derivative at -1 and 1" if abs(a) == 1.0 else None


def _sign(a: float) -> float:
    return math.copysign(1.0, a) if a != 0.0 else 0.0


_ALL = [
    Operation("add", lambda a, b: a + b, np.add, "{} + {}", 1),
    Operation("sub", lambda a, b: a - b, np.subtract, "{} - {}", 1),
    Operation("mul", lambda a, b: a * b, np.multiply, "{}*{}", 2),
    Operation(
        "div",
        lambda a, b: a / b,
        np.divide,
        "{}/{}",
        2,
        lambda a, b: "by zero" if b == 0.0 else None,
    ),
    Operation("neg", lambda a: -a, np.negative, "-{}", 1),
    Operation("pow", lambda a, b: a**b, np.power, "{}**{}", 3, _power_undefined),
    Operation("square", lambda a: a * a, np.square, "square({})"),
    Operation("sqrt", math.sqrt, np.sqrt, "sqrt({})", undefined=_sqrt_undefined),
    Operation("sin", math.sin, np.sin, "sin({})"),
    Operation("cos", math.cos, np.cos, "cos({})"),
    Operation("tan", math.tan, np.tan, "tan({})"),
    Operation("arcsin", math.asin, np.arcsin, "arcsin({})", undefined=_arc_undefined),
    Operation("arccos", math.acos, np.arccos, "arccos({})", undefined=_arc_undefined),
    Operation("arctan", math.atan, np.arctan, "arctan({})"),
    Operation("arctan2", math.atan2, np.arctan2, "arctan2({}, {})", undefined=_hypot_undefined),
    Operation("hypot", math.hypot, np.hypot, "hypot({}, {})", undefined=_hypot_undefined),
    Operation("exp", math.exp, np.exp, "exp({})"),
    Operation(
        "log",
        math.log,
        np.log,
        "log({})",
        undefined=lambda a: f"of a number that is not positive ({a:.6g})" if a <= 0.0 else None,
    ),
    Operation("abs", abs, np.absolute, "abs({})"),
    Operation("sign", _sign, np.sign, "sign({})"),
    # A plane rotation of (a, b) by the angle c, kept whole until derivatives are taken:
    # d turn_cos/dc = -turn_sin and d turn_sin/dc = turn_cos, far cheaper than through cos and sin.
    Operation(
        "turn_cos",
        lambda a, b, c: a * math.cos(c) - b * math.sin(c),
        None,
        "turn_cos({}, {}, {})",
    ),
    Operation(
        "turn_sin",
        lambda a, b, c: a * math.sin(c) + b * math.cos(c),
        None,
        "turn_sin({}, {}, {})",
    ),
]
OPERATIONS: dict[str, Operation] = {operation.name: operation for operation in _ALL}

LEAVES = ("constant", "quantity", "known", "parameter")
"""Operations without arguments: a number, a reading, a known constant of the pose, a parameter."""


def evaluate_scalar(name: str, *arguments: float) -> float:
    """One operation on plain numbers; outside its domain the result is NaN, as in NumPy."""
    try:
        value = OPERATIONS[name].scalar(*arguments)
    except (ValueError, ZeroDivisionError, OverflowError):
        return math.nan
    return math.nan if isinstance(value, complex) else float(value)
