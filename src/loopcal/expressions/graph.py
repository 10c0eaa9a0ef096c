"""The graph a tape is built in: every subexpression once, constants folded, zeros gone.

`Graph.apply` is the only way to make a node, for the tracer and for the derivative alike, so
both profit from the same simplifications. They are the exact ones: x + 0, x * 1, x * 0, --x,
-(x - y), cos(-x), sin(-x).

The elementary operations of a tape, each described once.

An operation is its name, functions of plain numbers and of arrays of poses,
text, and where it is defined. Everything else (tracing, derivatives, engines, printing, domain
errors) reads this table.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

Node = int
Step = tuple[str, tuple[Any, ...]]
"""An operation with the nodes of its arguments, or a leaf with its payload."""
_PLAIN, _SPECIAL = frozenset({"add", "sub", "mul", "div"}), frozenset({"constant", "neg"})
"""Operations that are simplified beside these arguments only, but for the product of equals."""


class Graph:
    """A growing directed acyclic graph of operations; a node is its position.

    operations[i] is the step that makes node i. It may begin as those of a tape, which are in it
    as they are.
    """

    def __init__(self, operations: Iterable[Step] = ()) -> None:
        self.operations: list[Step] = [*operations]
        self._nodes: dict[Step, Node] = {step: i for i, step in enumerate(self.operations)}

    def leaf(self, kind: str, payload: float) -> Node:
        """A constant (payload: its value) or an input (payload: its position)."""
        return self._intern(kind, (payload,))

    def constant(self, value: float) -> Node:
        """The node of a number; 0.0 and -0.0 are one."""
        return self._intern("constant", (value + 0.0,))

    def apply(self, name: str, *arguments: Node) -> Node:
        """The node of an operation on nodes, simplified where the result is the same number."""
        operations = self.operations
        if name in _PLAIN:  # nine of ten
            a, b = arguments
            if (
                operations[a][0] not in _SPECIAL
                and operations[b][0] not in _SPECIAL
                and (a != b or name != "mul")
            ):
                key = name, arguments
                if a > b and (name == "add" or name == "mul"):
                    key = name, (b, a)
                node = self._nodes.get(key)  # as _intern, of which this is most of the calls
                if node is None:
                    node = self._nodes[key] = len(operations)
                    operations.append(key)
                return node
        values: list[float | None] = []
        for kind, payload in [operations[a] for a in arguments]:
            values.append(payload[0] if kind == "constant" else None)
        if None not in values:
            folded = evaluate_scalar(name, *(v for v in values if v is not None))
            if math.isfinite(folded):
                return self.constant(folded)
        simplified = self._simplify(name, arguments, values)
        if simplified is not None:
            return simplified
        if name in ("add", "mul") and arguments[0] > arguments[1]:
            arguments = (arguments[1], arguments[0])
        return self._intern(name, arguments)

    def _intern(self, name: str, payload: tuple[Any, ...]) -> Node:
        key = (name, payload)
        node = self._nodes.get(key)
        if node is None:
            node = len(self.operations)
            self.operations.append(key)
            self._nodes[key] = node
        return node

    def _negated(self, node: Node) -> Node | None:
        name, arguments = self.operations[node]
        return arguments[0] if name == "neg" else None

    def _simplify(
        self, name: str, arguments: tuple[Node, ...], values: list[float | None]
    ) -> Node | None:
        match name:
            case "add" | "sub":
                return self._simplify_sum(name, *arguments, *values)
            case "mul":
                return self._simplify_product(*arguments, *values)
            case "div" if values[1] == 1.0 or values[0] == 0.0:
                return arguments[0]
            case "neg":
                return self._simplify_negative(arguments[0])
            case "cos" | "sin":
                return self._simplify_symmetric(name, arguments[0])
            case "pow":
                return self._simplify_power(arguments[0], values[1])
            case "turn_cos" | "turn_sin":
                return self._simplify_turn(name, arguments, values)
        return None

    def _simplify_negative(self, a: Node) -> Node | None:
        name, arguments = self.operations[a]
        if name == "sub":
            return self.apply("sub", arguments[1], arguments[0])
        return self._negated(a)

    def _simplify_symmetric(self, name: str, a: Node) -> Node | None:
        inner = self._negated(a)
        if inner is None:
            return None
        function = self.apply(name, inner)
        return function if name == "cos" else self.apply("neg", function)

    def _simplify_sum(
        self, name: str, a: Node, b: Node, value_a: float | None, value_b: float | None
    ) -> Node | None:
        if value_b == 0.0:
            return a
        if value_a == 0.0:
            return b if name == "add" else self.apply("neg", b)
        minus_b = self._negated(b)
        if minus_b is not None:
            return self.apply("sub" if name == "add" else "add", a, minus_b)
        minus_a = self._negated(a)
        if name == "add" and minus_a is not None:
            return self.apply("sub", b, minus_a)
        return None

    def _simplify_product(
        self, a: Node, b: Node, value_a: float | None, value_b: float | None
    ) -> Node | None:
        for node, value in ((b, value_a), (a, value_b)):
            if value == 0.0:
                return self.constant(0.0)
            if value == 1.0:
                return node
            if value == -1.0:
                return self.apply("neg", node)
        for node, other in ((a, b), (b, a)):
            inner = self._negated(node)
            if inner is not None:
                return self.apply("neg", self.apply("mul", inner, other))
        return self.apply("square", a) if a == b else None

    def _simplify_power(self, base: Node, exponent: float | None) -> Node | None:
        match exponent:
            case 0.0:
                return self.constant(1.0)
            case 1.0:
                return base
            case 2.0:
                return self.apply("square", base)
            case -1.0:
                return self.apply("div", self.constant(1.0), base)
            case 0.5:
                return self.apply("sqrt", base)
        return None

    def _simplify_turn(
        self, name: str, arguments: tuple[Node, ...], values: list[float | None]
    ) -> Node | None:
        a, b, angle = arguments
        cosine, sine = self.apply("cos", angle), self.apply("sin", angle)
        first, second = (cosine, sine) if name == "turn_cos" else (sine, cosine)
        if values[0] == 0.0 and values[1] == 0.0:
            return self.constant(0.0)
        if values[1] == 0.0:
            return self.apply("mul", a, first)
        if values[0] == 0.0:
            product = self.apply("mul", b, second)
            return self.apply("neg", product) if name == "turn_cos" else product
        if values[2] is not None:
            return self.lower_turn(name, a, b, angle)
        return None

    def lower_turn(self, name: str, a: Node, b: Node, angle: Node) -> Node:
        """A plane rotation written with cos and sin, for evaluation."""
        cosine, sine = self.apply("cos", angle), self.apply("sin", angle)
        if name == "turn_cos":
            return self.apply("sub", self.apply("mul", a, cosine), self.apply("mul", b, sine))
        return self.apply("add", self.apply("mul", a, sine), self.apply("mul", b, cosine))


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

LEAVES = frozenset({"constant", "quantity", "known", "parameter"})
"""Operations without arguments: a number, a reading, a known constant of the pose, a parameter."""


def evaluate_scalar(name: str, *arguments: float) -> float:
    """One operation on plain numbers; outside its domain the result is NaN, as in NumPy."""
    try:
        value = OPERATIONS[name].scalar(*arguments)
    except (ValueError, ZeroDivisionError, OverflowError):
        return math.nan
    return math.nan if isinstance(value, complex) else float(value)
