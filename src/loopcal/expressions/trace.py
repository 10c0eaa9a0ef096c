"""Tracing: a plain Python function f(x, p) is called once and leaves its tape behind.

The function is called with stand-ins that record what is done with them: arithmetic, powers,
NumPy's functions of one number. What cannot be recorded (a branch on a value, math.sin) raises
TraceError and says what to write instead.
"""

from __future__ import annotations

import math
import numbers
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, SupportsIndex

import numpy as np

from loopcal.errors import Code, InputError, nearest
from loopcal.expressions.graph import Graph, Node
from loopcal.expressions.tape import Tape


class TraceError(InputError):
    """A loop function does something a tape cannot hold."""

    usual_code: Code = "untraceable-function"


_UFUNCS: dict[str, str] = {
    "add": "add", "subtract": "sub", "multiply": "mul", "divide": "div", "true_divide": "div",
    "negative": "neg", "power": "pow", "float_power": "pow", "square": "square", "sqrt": "sqrt",
    "sin": "sin", "cos": "cos", "tan": "tan", "arcsin": "arcsin", "arccos": "arccos",
    "arctan": "arctan", "arctan2": "arctan2", "hypot": "hypot", "exp": "exp", "log": "log",
    "absolute": "abs", "fabs": "abs",
}  # fmt: skip
_METHODS = ("sin", "cos", "tan", "arcsin", "arccos", "arctan", "sqrt", "square", "exp", "log")
_NO_BRANCH = (
    "a loop is traced once, so it cannot branch on a value; write it as one formula, "
    "for example with np.abs, np.hypot or np.arctan2, or make two mechanisms"
)
_NO_STEP = "a step has no derivative; angles need no wrapping, since sin and cos are periodic"


class Scalar:
    """A number of a loop being traced: an input, or what the function made of inputs."""

    __slots__ = ("graph", "node")
    __hash__ = object.__hash__

    def __init__(self, graph: Graph, node: Node) -> None:
        self.graph = graph
        self.node = node

    def _apply(self, name: str, *arguments: Any) -> Any:
        nodes = []
        for argument in arguments:
            if isinstance(argument, Scalar):
                if argument.graph is not self.graph:
                    raise TraceError(
                        "the loop function uses a value of another trace",
                        remedy="use only the x and p that the function is given",
                    )
                nodes.append(argument.node)
            elif isinstance(argument, (float, numbers.Real)):  # most are floats, a quick answer
                number = float(argument)
                if not math.isfinite(number):
                    raise TraceError(
                        f"the loop contains the constant {number}",
                        remedy="use finite numbers only",
                    )
                nodes.append(self.graph.constant(number))
            else:
                return NotImplemented
        return Scalar(self.graph, self.graph.apply(name, *nodes))

    def turned(self, part: str, a: Any, b: Any, angle: Any) -> Scalar:
        """One coordinate of (a, b) turned by an angle: part "turn_cos" or "turn_sin"."""
        result: Scalar = self._apply(part, a, b, angle)
        return result

    def __add__(self, other: Any) -> Any:
        return self._apply("add", self, other)

    def __radd__(self, other: Any) -> Any:
        return self._apply("add", other, self)

    def __sub__(self, other: Any) -> Any:
        return self._apply("sub", self, other)

    def __rsub__(self, other: Any) -> Any:
        return self._apply("sub", other, self)

    def __mul__(self, other: Any) -> Any:
        return self._apply("mul", self, other)

    def __rmul__(self, other: Any) -> Any:
        return self._apply("mul", other, self)

    def __truediv__(self, other: Any) -> Any:
        return self._apply("div", self, other)

    def __rtruediv__(self, other: Any) -> Any:
        return self._apply("div", other, self)

    def __pow__(self, other: Any) -> Any:
        return self._apply("pow", self, other)

    def __rpow__(self, other: Any) -> Any:
        return self._apply("pow", other, self)

    def __neg__(self) -> Any:
        return self._apply("neg", self)

    def __pos__(self) -> Scalar:
        return self

    def __abs__(self) -> Any:
        return self._apply("abs", self)

    def hypot(self, other: Any) -> Any:
        """np.hypot of object arrays calls this for each element."""
        return self._apply("hypot", self, other)

    def arctan2(self, other: Any) -> Any:
        """np.arctan2 of object arrays calls this for each element."""
        return self._apply("arctan2", self, other)

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        name = ufunc.__name__
        if name in _COMPARISONS:
            _refuse_branch()
        if name in _STEPS:
            _refuse_step()
        if method != "__call__" or options or name not in _UFUNCS:
            raise TraceError(
                f"np.{name} cannot be recorded on a tape",
                remedy="use + - * / ** and np." + ", np.".join(sorted(set(_UFUNCS))),
            )
        if any(isinstance(value, np.ndarray) and value.ndim for value in inputs):
            # NumPy has no loops for objects here, so the operation is applied to each element.
            each = np.frompyfunc(
                lambda *arguments: self._apply(_UFUNCS[name], *arguments), ufunc.nin, 1
            )
            objects = [
                np.asarray(v, dtype=object) if isinstance(v, np.ndarray) else _boxed(v)
                for v in inputs
            ]
            return each(*objects)
        return self._apply(_UFUNCS[name], *(v.item() if _zero_d(v) else v for v in inputs))

    def __float__(self) -> float:
        raise TraceError(
            "a traced value was turned into a plain number",
            remedy="use np.sin instead of math.sin, and no float(), int() or round()",
        )

    __int__ = __index__ = __complex__ = __float__

    def _stepped(self, *other: Any) -> Any:
        _refuse_step()

    __round__ = __floor__ = __ceil__ = __trunc__ = _stepped
    __mod__ = __rmod__ = __floordiv__ = __rfloordiv__ = __divmod__ = __rdivmod__ = _stepped

    def __bool__(self) -> bool:
        _refuse_branch()
        return False

    def __eq__(self, other: object) -> bool:
        _refuse_branch()
        return False

    def _compare(self, other: object) -> bool:
        _refuse_branch()
        return False

    __lt__ = __le__ = __gt__ = __ge__ = __ne__ = _compare

    def __repr__(self) -> str:
        return f"<traced value {self.node}>"


_COMPARISONS = (
    "less", "less_equal", "greater", "greater_equal", "equal", "not_equal",
    "maximum", "minimum", "fmax", "fmin", "sign",
)  # fmt: skip
_STEPS = ("floor", "ceil", "rint", "trunc", "remainder", "fmod", "floor_divide", "divmod")


def _refuse_branch() -> None:
    raise TraceError("a traced value is compared with another", remedy=_NO_BRANCH)


def _refuse_step() -> None:
    raise TraceError("a traced value is rounded or wrapped", remedy=_NO_STEP)


def _zero_d(value: Any) -> bool:
    return isinstance(value, np.ndarray) and value.ndim == 0


def _boxed(value: Any) -> Any:
    """An object array holding one thing, so that NumPy broadcasts it without looking inside."""
    box = np.empty((), dtype=object)
    box[()] = value
    return box


def _method(name: str) -> Callable[[Scalar], Scalar]:
    def call(self: Scalar) -> Scalar:
        result: Scalar = self._apply(name, self)
        return result

    call.__name__ = name
    call.__doc__ = f"np.{name} of an object array calls this for each element."
    return call


for _name in _METHODS:
    setattr(Scalar, _name, _method(_name))


class Inputs:
    """The x or the p that a loop function is given: its inputs by name, or in order."""

    def __init__(self, names: Sequence[str], scalars: Sequence[Scalar], what: str) -> None:
        self._scalars = dict(zip(names, scalars, strict=True))
        self._what = what

    def __getattr__(self, name: str) -> Scalar:
        return self[name]

    def __getitem__(self, key: str | SupportsIndex) -> Scalar:
        if isinstance(key, str):
            if key not in self._scalars:
                raise TraceError(
                    f"the loop uses {self._what} {key!r}, which is not declared",
                    remedy=nearest(key, self._scalars),
                )
            return self._scalars[key]
        everything = list(self._scalars.values())
        try:
            return everything[key]
        except (IndexError, TypeError):
            raise TraceError(
                f"the loop uses {self._what} number {key!r} of {len(everything)}",
                remedy="use a name, or a whole number from 0 on",
            ) from None

    def __iter__(self) -> Iterator[Scalar]:
        return iter(self._scalars.values())

    def __len__(self) -> int:
        return len(self._scalars)


def trace(
    function: Callable[[Inputs, Inputs], Iterable[Any]],
    *,
    quantities: Sequence[str],
    parameters: Sequence[str],
    pose_constants: Sequence[str] = (),
    loops: Sequence[str] | None = None,
) -> Tape:
    """The tape of f(x, p), whose values are zero where the loops close.

    x holds the quantities and the known constants of the pose by name, p the parameters.
    loops names the equations ("loop 1", ... if not given).

    Raises TraceError where the function does what a tape cannot hold.
    """
    if not callable(function):
        raise TraceError(
            f"the loops are {function!r:.40}, which is no function",
            remedy="give a function f(x, p) that returns the loop equations",
        )
    graph = Graph()
    x_names = [*quantities, *pose_constants]
    leaves = [
        Scalar(graph, graph.leaf(kind, i))
        for kind, names in (
            ("quantity", quantities),
            ("known", pose_constants),
            ("parameter", parameters),
        )
        for i in range(len(names))
    ]
    x = Inputs(x_names, leaves[: len(x_names)], "quantity")
    p = Inputs(parameters, leaves[len(x_names) :], "parameter")
    equations = _equations(function(x, p))
    names = loops or [f"loop {i + 1}" for i in range(len(equations))]
    if len(names) != len(equations):
        raise TraceError(
            f"{len(equations)} loop equations are returned but {len(names)} names are given",
            remedy="name every equation once",
        )
    for name, equation in zip(names, equations, strict=True):
        if not isinstance(equation, Scalar):
            raise TraceError(
                f"{name} is {equation!r} and contains neither readings nor parameters",
                remedy="return one formula per loop equation",
            )
    tape = Tape.from_graph(
        graph,
        [equation.node for equation in equations],
        quantities=quantities,
        pose_constants=pose_constants,
        parameters=parameters,
        loops=names,
    )
    for name, inputs in zip(names, tape.depends_on(), strict=True):
        if not inputs.intersection(quantities):
            raise TraceError(
                f"{name} contains no measured quantity",
                remedy="every loop equation must contain at least one quantity",
            )
    return tape


def _equations(returned: Any) -> list[Any]:
    if isinstance(returned, Scalar):
        return [returned]
    if returned is None or not isinstance(returned, Iterable):
        raise TraceError(
            f"the loop function returned {returned!r}",
            remedy="return the loop equations as a tuple of formulas that are zero when closed",
        )
    equations = list(np.ravel(np.asarray(list(returned), dtype=object)))
    if not equations:
        raise TraceError("the loop function returned no equation", remedy="return at least one")
    return equations
