"""A plain function leaves a tape that means the same; what a tape cannot hold is explained."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from loopcal.errors import Code, InputError
from loopcal.expressions.trace import TraceError, trace
from tests.reference.plain_tape import loop_values
from tests.refusals import refused

QUANTITIES, PARAMETERS = ("a", "b"), ("k", "l")
A, B, K, L = 0.3, 0.7, 1.3, 2.1


class Named:
    """Plain numbers by name and position, as a traced function sees its inputs."""

    def __init__(self, **values: float) -> None:
        self.__dict__.update(values)

    def __getitem__(self, key: Any) -> Any:
        return self.__dict__[key] if isinstance(key, str) else list(self.__dict__.values())[key]

    def __getattr__(self, name: str) -> Any:
        raise AttributeError(name)


X, P = Named(a=A, b=B), Named(k=K, l=L)

ONE_LOOP: dict[str, Callable[[Any, Any], Any]] = {
    "sum": lambda x, p: x.a + p.k,
    "sum with a number": lambda x, p: 2 + x.a + 3.5,
    "difference": lambda x, p: x.a - p.k,
    "reflected difference": lambda x, p: 2 - x.a,
    "product": lambda x, p: x.a * p.k,
    "reflected product": lambda x, p: 3 * x.a,
    "quotient": lambda x, p: x.a / p.k,
    "reflected quotient": lambda x, p: 3 / x.a,
    "sign": lambda x, p: -x.a + +x.b,
    "absolute value": lambda x, p: abs(x.a - 1),
    "square": lambda x, p: x.a**2,
    "cube": lambda x, p: x.a**3,
    "negative power": lambda x, p: x.a**-3,
    "reciprocal": lambda x, p: x.a**-1,
    "fractional power": lambda x, p: x.a**1.5,
    "root as a power": lambda x, p: x.a**0.5,
    "zeroth power": lambda x, p: x.b + x.a**0,
    "first power": lambda x, p: x.a**1,
    "traced power": lambda x, p: x.a**x.b,
    "power of a power": lambda x, p: (x.a**x.b) ** p.k,
    "power to a power": lambda x, p: x.a ** (x.b**p.k),
    "reflected power": lambda x, p: 2**x.a,
    "power of a negative number": lambda x, p: (-x.a - 1) ** 3,
    "np.float64 ahead": lambda x, p: np.float64(2.5) * x.a,
    "np.float64 behind": lambda x, p: x.a / np.float64(2.5),
    "np.float64 power": lambda x, p: np.float64(2.5) ** x.a,
    "np.float32 and np.int64": lambda x, p: np.float32(0.5) + x.a * np.int64(3),
    "number in an array of no dimension": lambda x, p: np.array(2.0) * x.a - np.array(3.0),
    "by key": lambda x, p: x["a"] - p["l"],
    "by position": lambda x, p: x[0] - p[1] + x[-1],
    "by a slice": lambda x, p: sum(x[0:2]) - p[np.int64(0)],
    "by iteration": lambda x, p: sum(v * w for v, w in zip((*x,), (*p,), strict=True)),
    "np.sin": lambda x, p: np.sin(x.a),
    "np.cos": lambda x, p: np.cos(x.a),
    "np.tan": lambda x, p: np.tan(x.a),
    "np.arcsin": lambda x, p: np.arcsin(x.a),
    "np.arccos": lambda x, p: np.arccos(x.a),
    "np.arctan": lambda x, p: np.arctan(x.a),
    "np.arctan2": lambda x, p: np.arctan2(x.a, -x.b),
    "np.arctan2 with a number": lambda x, p: np.arctan2(0.3, x.b),
    "np.sqrt": lambda x, p: np.sqrt(x.a),
    "np.square": lambda x, p: np.square(x.a),
    "np.exp": lambda x, p: np.exp(x.a),
    "np.log": lambda x, p: np.log(x.a),
    "np.hypot": lambda x, p: np.hypot(x.a, p.l),
    "np.abs": lambda x, p: np.abs(x.a - 1),
    "np.fabs": lambda x, p: np.fabs(x.a - 1),
    "np.add and its kin": lambda x, p: np.add(
        np.subtract(x.a, 1.0), np.multiply(np.divide(x.b, p.k), np.negative(p.l))
    ),
    "np.power": lambda x, p: np.power(x.a, 2.5),
    "np.float_power": lambda x, p: np.float_power(x.a, 2.5),
    "np.sum": lambda x, p: np.sum([x.a, x.b, p.k]),
    "np.dot": lambda x, p: np.dot([x.a, x.b], [p.k, p.l]),
    "np.linalg.norm": lambda x, p: np.linalg.norm([x.a, x.b]),
    "a matrix": lambda x, p: (np.array([[1.0, 2.0], [3.0, 4.0]]) @ np.array([x.a, x.b]))[1],
}


@pytest.mark.parametrize("name", ONE_LOOP)
def test_the_tape_means_what_the_function_means(name: str) -> None:
    function = ONE_LOOP[name]
    x, p = X, P
    if "iteration" in name:
        expected = A * K + B * L
    elif "slice" in name:
        expected = A + B - K
    else:
        expected = function(x, p)
    tape = trace(function, quantities=QUANTITIES, parameters=PARAMETERS)
    (value,) = loop_values(tape, [A, B], [K, L])
    assert value == pytest.approx(expected, rel=1e-15, abs=0)


ARRAYS: dict[str, Callable[[Any, Any], Any]] = {
    "array ahead": lambda x, p: np.array([1.0, 2.0]) * x.a,
    "array behind": lambda x, p: x.a - np.array([1.0, 2.0]),
    "array as base": lambda x, p: np.array([1.5, 2.0]) ** x.a,
    "array of traced values": lambda x, p: np.array([x.a, x.b]) + np.array([p.k, p.l]),
    "function of an array": lambda x, p: np.sin(np.array([x.a, x.b])),
    "function of array and value": lambda x, p: np.hypot(x.a, np.array([1.0, 2.0])),
    "hypot of arrays": lambda x, p: np.hypot(np.array([x.a, x.b]), np.array([p.k, p.l])),
    "arctan2 of arrays": lambda x, p: np.arctan2(np.array([x.a, x.b]), np.array([p.k, 0.4])),
    "matrix product": lambda x, p: np.array([[1.0, 2.0], [3.0, 4.0]]) @ np.array([x.a, x.b]),
    "tuple": lambda x, p: (x.a - p.k, x.b - p.l),
    "generator": lambda x, p: (v - p.k for v in (x.a, x.b)),
}


@pytest.mark.parametrize("name", ARRAYS)
def test_arrays_on_either_side_give_one_loop_per_element(name: str) -> None:
    function = ARRAYS[name]
    tape = trace(function, quantities=QUANTITIES, parameters=PARAMETERS)
    expected = list(function(X, P))
    assert loop_values(tape, [A, B], [K, L]) == pytest.approx(expected, rel=1e-15)


def test_a_two_dimensional_array_is_read_row_by_row() -> None:
    tape = trace(
        lambda x, p: np.array([[x.a, x.b], [x.a + 1, x.b + 1]]), quantities="ab", parameters=()
    )
    assert loop_values(tape, [A, B], []).tolist() == [A, B, A + 1, B + 1]


def test_a_single_formula_is_one_loop() -> None:
    assert trace(lambda x, p: abs(x["a"]), quantities="a", parameters=()).loops == ("loop 1",)


def test_known_constants_of_the_pose_stand_beside_the_quantities() -> None:
    tape = trace(
        lambda x, p: (x.a * x.c - p.k,), quantities="a", pose_constants="c", parameters="k"
    )
    assert loop_values(tape, [2.0], [5.0], [3.0]).tolist() == [1.0]
    assert str(tape) == "loop 1: x.a*x.c - p.k = 0"


def test_loops_carry_the_names_given() -> None:
    tape = trace(lambda x, p: (x.a, x.b), quantities="ab", parameters=(), loops=("u", "v"))
    assert tape.loops == ("u", "v")


BRANCHES: dict[str, Callable[[Any, Any], Any]] = {
    "if": lambda x, p: x.a if x.a > 0 else x.b,
    "truth": lambda x, p: x.a if x.a else x.b,
    "equality": lambda x, p: x.a if x.a == 1 else x.b,
    "inequality": lambda x, p: x.a if x.a != 1 else x.b,
    "reflected comparison": lambda x, p: x.a if p.k <= x.a else x.b,
    "comparison with np.float64": lambda x, p: x.a if np.float64(1) >= x.a else x.b,
    "membership": lambda x, p: x.a if x.a in (1, 2) else x.b,
    "min": lambda x, p: min(x.a, x.b),
    "sorted": lambda x, p: sorted([x.a, x.b]),
    "np.where": lambda x, p: np.where(x.a > 0, x.a, x.b),
    "np.where of a truth": lambda x, p: np.where(x.a, x.a, x.b),
    "np.maximum": lambda x, p: np.maximum(x.a, 0.0),
    "np.minimum": lambda x, p: np.minimum(0.0, x.a),
    "np.clip": lambda x, p: np.clip(x.a, 0.0, 1.0),
    "np.sign": lambda x, p: np.sign(x.a),
}


@pytest.mark.parametrize("name", BRANCHES)
def test_a_branch_on_a_value_says_what_to_write_instead(name: str) -> None:
    with refused("untraceable-function") as caught:
        trace(BRANCHES[name], quantities=QUANTITIES, parameters=PARAMETERS)
    for instead in ("np.abs", "np.hypot", "np.arctan2", "two mechanisms"):
        assert instead in str(caught.value)


STEPS: dict[str, Callable[[Any, Any], Any]] = {
    "modulus": lambda x, p: x.a % (2 * math.pi),
    "reflected modulus": lambda x, p: 2 % x.a,
    "whole division": lambda x, p: x.a // 2,
    "divmod": lambda x, p: divmod(x.a, 2)[1],
    "round": lambda x, p: round(x.a),
    "round to digits": lambda x, p: round(x.a, 3),
    "math.floor": lambda x, p: math.floor(x.a),
    "np.floor": lambda x, p: np.floor(x.a),
    "np.mod": lambda x, p: np.mod(x.a, 2.0),
    "np.rint": lambda x, p: np.rint(x.a),
}


@pytest.mark.parametrize("name", STEPS)
def test_rounding_and_wrapping_are_refused_because_they_have_no_derivative(name: str) -> None:
    with refused("untraceable-function") as caught:
        trace(STEPS[name], quantities=QUANTITIES, parameters=PARAMETERS)
    assert "angles need no wrapping" in str(caught.value)


NUMBERS: dict[str, Callable[[Any, Any], Any]] = {
    "float": lambda x, p: float(x.a),
    "int": lambda x, p: int(x.a),
    "complex": lambda x, p: complex(x.a),
    "np.float64": lambda x, p: np.float64(x.a),
    "math.sin": lambda x, p: math.sin(x.a),
    "math.hypot": lambda x, p: math.hypot(x.a, 1.0),
    "an array of floats": lambda x, p: np.array([x.a, x.b], dtype=float),
    "an index": lambda x, p: [1.0, 2.0][x.a],
}


@pytest.mark.parametrize("name", NUMBERS)
def test_a_plain_number_is_refused_and_numpy_named_instead(name: str) -> None:
    with refused("untraceable-function") as caught:
        trace(NUMBERS[name], quantities=QUANTITIES, parameters=PARAMETERS)
    assert "np.sin instead of math.sin" in str(caught.value)


UNRECORDED: dict[str, Callable[[Any, Any], Any]] = {
    "np.sinh": lambda x, p: np.sinh(x.a),
    "np.log1p": lambda x, p: np.log1p(x.a),
    "np.isnan": lambda x, p: np.isnan(x.a),
    "into an array": lambda x, p: np.add(x.a, x.b, out=np.zeros(1)),
}


@pytest.mark.parametrize("name", UNRECORDED)
def test_functions_without_a_derivative_here_list_those_that_have_one(name: str) -> None:
    with refused("untraceable-function") as caught:
        trace(UNRECORDED[name], quantities=QUANTITIES, parameters=PARAMETERS)
    assert "np.arctan2" in str(caught.value)


@pytest.mark.parametrize(
    ("function", "code", "stated"),
    [
        (lambda x, p: x.aa, "untraceable-function", ("'aa'", "'a'")),
        (lambda x, p: x.a + p["kk"], "untraceable-function", ("'kk'", "'k'")),
        (lambda x, p: x.a + p.z, "untraceable-function", ("'z'", "'k'", "'l'")),
        (lambda x, p: x[2], "untraceable-function", ("2",)),
        (lambda x, p: x.a * math.inf, "untraceable-function", ("inf",)),
        (lambda x, p: x.a * np.nan, "untraceable-function", ("nan",)),
        (lambda x, p: None, "untraceable-function", ("None",)),
        (lambda x, p: 3.0, "untraceable-function", ("3.0",)),
        (lambda x, p: (), "untraceable-function", ()),
        (lambda x, p: (x.a, 1.0), "untraceable-function", ("2", "1.0")),
        (lambda x, p: "ab", "untraceable-function", ("1", "'a'")),
        (lambda x, p: (x.a, p.k), "untraceable-function", ("2",)),
        (lambda x, p: p.k * p.l, "untraceable-function", ("1",)),
    ],
)
def test_what_cannot_be_a_loop_is_named(
    function: Callable[..., Any], code: Code, stated: tuple[str, ...]
) -> None:
    with refused(code, *stated):
        trace(function, quantities=QUANTITIES, parameters=PARAMETERS)


def test_names_of_loops_must_be_as_many_as_the_loops() -> None:
    with refused("untraceable-function", "2 loop", "1 names"):
        trace(lambda x, p: (x.a, x.b), quantities="ab", parameters=(), loops=("u",))


def test_values_of_another_trace_are_refused() -> None:
    kept = []

    def first(x: Any, p: Any) -> Any:
        kept.append(x.a)
        return x.a

    trace(first, quantities="a", parameters=())
    with refused("untraceable-function"):
        trace(lambda x, p: x.a + kept[0], quantities="a", parameters=())


def test_a_trace_error_is_bad_input() -> None:
    assert issubclass(TraceError, InputError)
