"""Reverse mode against independent derivatives: differences of order 8, and the complex step."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from numpy.typing import NDArray

from loopcal.expressions.derivative import _reverse, linearise
from loopcal.expressions.engine import NumpyEngine
from loopcal.expressions.graph import Graph
from loopcal.expressions.tape import Tape
from loopcal.expressions.trace import trace
from loopcal.expressions.vectors import rotate, vector
from tests.reference.plain_tape import complex_step, difference, loop_values
from tests.reference.random_loops import PARAMETERS, QUANTITIES, RandomLoops, random_loops

Array = NDArray[np.float64]
POINTS = 1000


def linearised(tape: Tape, x: Array, p: Array) -> Any:
    """The engine's f and derivatives by all inputs at x (k, N) and p (n,)."""
    engine = NumpyEngine(linearise(tape, tape.quantities, tape.parameters), x.shape[1])
    return engine.evaluate(p, x)


# operation, lower and upper end of its arguments, step of the differences
ONE_ARGUMENT: dict[str, tuple[Callable[[Any], Any], float, float]] = {
    "neg": (lambda a: -a, -3, 3),
    "plus a number": (lambda a: a + 1.5, -3, 3),
    "number minus": (lambda a: 1.5 - a, -3, 3),
    "times a number": (lambda a: a * 2.5, -3, 3),
    "number over": (lambda a: 2.5 / a, 0.5, 3),
    "over a number": (lambda a: a / 2.5, -3, 3),
    "square": (lambda a: a**2, 0.1, 3),
    "cube": (lambda a: a**3, -3, -0.1),
    "negative power": (lambda a: a**-3, 0.5, 3),
    "reciprocal": (lambda a: a**-1, -3, -0.5),
    "fractional power": (lambda a: a**1.7, 0.5, 3),
    "negative fractional power": (lambda a: a**-0.7, 0.5, 3),
    "root as power": (lambda a: a**0.5, 0.5, 3),
    "to the power of a": (lambda a: 1.7**a, -3, 3),
    "a to the a": (lambda a: a**a, 0.5, 3),
    "sqrt": (np.sqrt, 0.5, 3),
    "sin": (np.sin, -1.2, 1.2),
    "cos": (np.cos, 0.3, 2.8),
    "tan": (np.tan, -1.0, 1.0),
    "arcsin": (np.arcsin, -0.7, 0.7),
    "arccos": (np.arccos, -0.7, 0.7),
    "arctan": (np.arctan, -3, 3),
    "exp": (np.exp, -3, 3),
    "log": (np.log, 0.5, 3),
    "abs of negative": (abs, -3, -0.5),
    "abs of positive": (np.abs, 0.5, 3),
}


@pytest.mark.parametrize("name", ONE_ARGUMENT)
def test_every_operation_of_one_argument(name: str) -> None:
    function, low, high = ONE_ARGUMENT[name]
    tape = trace(lambda x, p: [function(x["a"])], quantities="a", parameters=())
    a = np.random.default_rng(1).uniform(low, high, POINTS)
    slope = linearised(tape, a[None], np.zeros(0)).by_quantity[0, 0]
    assert slope == pytest.approx(difference(function, a, 5e-3), rel=1e-8, abs=1e-12)


TWO_ARGUMENTS: dict[str, Callable[[Any, Any], Any]] = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": lambda a, b: a / b,
    "pow": lambda a, b: a**b,
    "np.power": np.power,
    "hypot": np.hypot,
    "arctan2": np.arctan2,
    "arctan2, left half": lambda a, b: np.arctan2(a, -b),
    "arctan2, lower half": lambda a, b: np.arctan2(-a, b),
}


@pytest.mark.parametrize("name", TWO_ARGUMENTS)
def test_every_operation_of_two_arguments(name: str) -> None:
    function = TWO_ARGUMENTS[name]
    tape = trace(lambda x, p: [function(x["a"], x["b"])], quantities="ab", parameters=())
    a, b = np.random.default_rng(2).uniform(0.5, 2.5, (2, POINTS))
    slopes = linearised(tape, np.array([a, b]), np.zeros(0)).by_quantity[:, 0]
    by_a = difference(lambda v: function(v, b), a, 5e-3)
    by_b = difference(lambda v: function(a, v), b, 5e-3)
    assert slopes[0] == pytest.approx(by_a, rel=1e-8, abs=1e-12)
    assert slopes[1] == pytest.approx(by_b, rel=1e-8, abs=1e-12)


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_rotations_by_vector_and_angle(axis: str) -> None:
    tape = trace(
        lambda x, p: rotate(axis, x["t"], [x["a"], x["b"], x["c"]]),
        quantities="abct",
        parameters=(),
    )
    at = np.random.default_rng(3).uniform(-3, 3, (4, POINTS))
    slopes = linearised(tape, at, np.zeros(0)).by_quantity

    def value(i: int, v: Array) -> Array:
        moved = at.copy()
        moved[i] = v
        a, b, c, t = moved
        cos, sin, one, zero = np.cos(t), np.sin(t), np.ones(POINTS), np.zeros(POINTS)
        R = {
            "x": [[one, zero, zero], [zero, cos, -sin], [zero, sin, cos]],
            "y": [[cos, zero, sin], [zero, one, zero], [-sin, zero, cos]],
            "z": [[cos, -sin, zero], [sin, cos, zero], [zero, zero, one]],
        }[axis]
        return np.einsum("ijn,jn->in", np.array(R), np.array([a, b, c]))

    for i in range(4):
        expected = difference(partial(value, i), at[i], 0.02)
        assert slopes[i] == pytest.approx(expected, rel=1e-8, abs=1e-11)


@settings(max_examples=300)
@given(random_loops())
def test_random_tapes_meet_the_complex_step(loops: RandomLoops) -> None:
    tape = trace(loops, quantities=QUANTITIES, parameters=PARAMETERS)
    rng = np.random.default_rng(4)
    x, p = rng.uniform(-1.5, 1.5, (len(QUANTITIES), 20)), rng.uniform(-1.5, 1.5, len(PARAMETERS))
    found, expected = linearised(tape, x, p), complex_step(tape, x, p)
    value = loop_values(tape, x, np.broadcast_to(p[:, None], (len(p), 20)))
    assert found.f == pytest.approx(value, rel=1e-12, abs=1e-12)
    assert found.by_quantity == pytest.approx(expected.by_quantity, rel=1e-8, abs=1e-10)
    assert found.by_parameter == pytest.approx(expected.by_parameter, rel=1e-8, abs=1e-10)


def test_derivatives_come_only_for_the_inputs_asked_for_in_their_order() -> None:
    tape = trace(lambda x, p: (x.a * p.k, x.b * p.l), quantities=("a", "b"), parameters=("k", "l"))
    engine = NumpyEngine(linearise(tape, ("b",), ("l", "k")), 1)
    values = engine.evaluate(np.array([5.0, 7.0]), np.array([[2.0], [3.0]]))
    assert values.f.ravel().tolist() == [10.0, 21.0]
    assert values.by_quantity.tolist() == [[[0.0], [7.0]]]
    assert values.by_parameter.tolist() == [[[0.0], [3.0]], [[2.0], [0.0]]]


def test_an_input_that_no_loop_contains_has_derivative_zero() -> None:
    tape = trace(lambda x, p: (x["a"],), quantities="ab", parameters="k")
    values = linearised(tape, np.array([[2.0], [3.0]]), np.array([1.0]))
    assert values.by_quantity.ravel().tolist() == [1.0, 0.0]
    assert values.by_parameter.ravel().tolist() == [0.0]


def test_arcsin_keeps_its_digits_near_one() -> None:
    tape = trace(lambda x, p: (np.arcsin(x["a"]),), quantities="a", parameters=())
    gap = 2.0**-40  # 1 - gap is exact
    slope = linearised(tape, np.array([[1.0 - gap]]), np.zeros(0)).by_quantity.item()
    assert slope == pytest.approx((gap * (2.0 - gap)) ** -0.5, rel=1e-15)


def test_the_derivative_of_a_chain_costs_a_few_times_its_value() -> None:
    def chain(x: Any, p: Any) -> Any:
        v = vector(x["a"], 0.3, 0.4)
        for i in range(6):
            v = rotate("xyz"[i % 3], x[i] + p[i], v)
        return v

    names = [f"q{i}" for i in range(5)]
    tape = trace(chain, quantities=("a", *names), parameters=tuple(f"k{i}" for i in range(6)))
    jacobian = linearise(tape, tape.quantities, tape.parameters).tape
    assert len(jacobian.operations) < 3 * 4 * len(tape.operations)  # three sweeps, four times each


def test_the_derivative_of_many_loops_costs_as_much_for_each_as_that_of_one() -> None:
    class Counted(set[int]):
        asked = 0

        def __contains__(self, node: object) -> bool:
            Counted.asked += 1
            return super().__contains__(node)

    graph = Graph()
    inputs = [graph.leaf("quantity", i) for i in range(100)]
    loops = [graph.apply("mul", a, graph.apply("sin", a)) for a in inputs]
    useful = Counted({*range(len(graph.operations))})
    gradients = [_reverse(graph, loop, inputs, useful) for loop in loops]
    assert [g[i] != graph.constant(0.0) for i, g in enumerate(gradients)] == [True] * 100
    assert Counted.asked == 3 * 100  # both factors, and the argument of the sine
