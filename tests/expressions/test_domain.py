"""A value outside an operation's domain is traced back to loop, pose and operation."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from loopcal.errors import DomainError
from loopcal.expressions.domain import explain_domain
from loopcal.expressions.trace import trace

CASES: dict[str, tuple[Callable[[Any, Any], Any], float, str]] = {
    "sqrt": (lambda x, p: np.sqrt(x.a - p.k), 0.5, "sqrt of a negative number (-0.5)"),
    "sqrt at zero": (lambda x, p: np.sqrt(x.a - p.k), 1.0, "sqrt has no derivative at zero"),
    "division": (lambda x, p: 1.0 / (x.a - p.k), 1.0, "division by zero"),
    "log": (lambda x, p: np.log(x.a), -2.0, "log of a number that is not positive (-2)"),
    "log of zero": (lambda x, p: np.log(x.a), 0.0, "log of a number that is not positive (0)"),
    "arcsin": (lambda x, p: np.arcsin(x.a), 1.5, "arcsin of a number outside -1 to 1 (1.5)"),
    "arccos": (lambda x, p: np.arccos(x.a), -2.0, "arccos of a number outside -1 to 1 (-2)"),
    "arcsin at one": (lambda x, p: np.arcsin(x.a), 1.0, "arcsin has no derivative at -1 and 1"),
    "power": (
        lambda x, p: x.a**1.5,
        -4.0,
        "power of a negative number (-4) to the fractional power 1.5",
    ),
    "power of zero": (lambda x, p: x.a**-3, 0.0, "power of zero to the power -3"),
    "hypot": (
        lambda x, p: np.hypot(x.a, x.b - 1.0),
        0.0,
        "hypot has no derivative where both arguments are zero",
    ),
    "arctan2": (
        lambda x, p: np.arctan2(x.a, x.b - 1.0),
        0.0,
        "arctan2 has no derivative where both arguments are zero",
    ),
    "overflow": (lambda x, p: np.exp(x.a), 1e4, "exp of 10000 is not finite"),
}


@pytest.mark.parametrize("name", CASES)
def test_the_error_names_operation_loop_and_pose(name: str) -> None:
    function, value, words = CASES[name]
    tape = trace(
        lambda x, p: (x.a + x.b, function(x, p)),
        quantities=("a", "b"),
        parameters=("k",),
        loops=("length", "angle"),
    )
    x = np.array([[0.3 if "arc" in name else 3.0] * 2 + [value], [1.0] * 3])
    x[1, :2] = 2.0
    error = explain_domain(tape, x, np.zeros((0, 3)), np.array([1.0]), ("p1", "p2", "p3"))
    assert isinstance(error, DomainError)
    assert error.message == f"{words} in loop equation 'angle' at pose 'p3'"
    assert error.remedy is not None
    assert "data.exclude" in error.remedy


def test_an_operation_shared_by_loops_is_told_by_the_first_of_them() -> None:
    tape = trace(
        lambda x, p: (x["b"], 1 + np.sqrt(x["a"]), 2 * np.sqrt(x["a"])),
        quantities="ab",
        parameters=(),
    )
    error = explain_domain(tape, np.array([[-1.0], [0.0]]), np.zeros((0, 1)), np.zeros(0), ("7",))
    assert "'loop 2' at pose '7'" in str(error)


def test_parameters_alone_may_be_what_is_wrong() -> None:
    tape = trace(lambda x, p: (x["a"] - np.log(p["k"]),), quantities="a", parameters="k")
    error = explain_domain(tape, np.ones((1, 1)), np.zeros((0, 1)), np.array([-1.0]), ("7",))
    assert "log of a number that is not positive (-1)" in str(error)


def test_known_constants_are_looked_at_too() -> None:
    tape = trace(lambda x, p: (x["a"] / x["c"],), quantities="a", pose_constants="c", parameters=())
    error = explain_domain(tape, np.ones((1, 2)), np.array([[1.0, 0.0]]), np.zeros(0), ("1", "2"))
    assert "division by zero in loop equation 'loop 1' at pose '2'" in str(error)


def test_a_value_that_is_defined_but_has_no_slope_is_found_in_the_derivative() -> None:
    tape = trace(lambda x, p: (x["a"] ** p["k"],), quantities="a", parameters="k", loops=("u",))
    error = explain_domain(tape, np.array([[-2.0]]), np.zeros((0, 1)), np.array([2.0]), ("7",))
    assert (
        error.message == "log of a number that is not positive (-2) in the derivative of "
        "loop equation 'u' at pose '7'"
    )
