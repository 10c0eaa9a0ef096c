"""The graph keeps every subexpression once, folds constants, and simplifies only exactly."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from loopcal.expressions.graph import Graph
from loopcal.expressions.tape import Tape
from loopcal.expressions.trace import trace


def traced(function: Callable[..., Any]) -> Tape:
    return trace(function, quantities=("a", "b"), parameters=("k",))


def names(function: Callable[..., Any]) -> list[str]:
    """The operations of a traced function, leaves left out."""
    leaves = ("quantity", "parameter", "constant")
    return [name for name, _ in traced(function).operations if name not in leaves]


def test_a_shared_subexpression_is_stored_once() -> None:
    shared = names(lambda x, p: (np.sin(x.a + p.k) * x.b, np.sin(x.a + p.k) + x.b))
    assert sorted(shared) == ["add", "add", "mul", "sin"]


def test_sums_and_products_are_the_same_in_either_order() -> None:
    assert names(lambda x, p: (x.a + p.k) - np.cos(p.k + x.a)) == ["add", "cos", "sub"]
    assert names(lambda x, p: (x.a * x.b) - np.cos(x.b * x.a)) == ["mul", "cos", "sub"]


def test_differences_are_not_the_same_in_either_order() -> None:
    assert names(lambda x, p: (x.a - x.b) * (x.b - x.a)) == ["sub", "sub", "mul"]


def test_constants_are_folded() -> None:
    tape = traced(lambda x, p: x.a * (2.0 * np.sin(0.5) + 1.0))
    constants = [payload[0] for name, payload in tape.operations if name == "constant"]
    assert constants == [2.0 * math.sin(0.5) + 1.0]


def test_constants_are_folded_in_the_graph_itself() -> None:
    graph = Graph()
    node = graph.apply("hypot", graph.constant(3.0), graph.constant(4.0))
    assert graph.operations[node] == ("constant", (5.0,))


def test_what_overflows_or_is_undefined_is_not_folded() -> None:
    graph = Graph()
    zero = graph.constant(0.0)
    for node in (graph.apply("log", zero), graph.apply("exp", graph.constant(1e4))):
        assert graph.operations[node][0] != "constant"


def test_both_zeros_are_one_constant() -> None:
    graph = Graph()
    assert graph.constant(0.0) == graph.constant(-0.0)


@pytest.mark.parametrize(
    "function",
    [
        lambda x, p: x.a + 0.0,
        lambda x, p: 0 + x.a,
        lambda x, p: x.a - 0,
        lambda x, p: x.a * 1,
        lambda x, p: 1.0 * x.a,
        lambda x, p: x.a / 1.0,
        lambda x, p: x.a**1,
        lambda x, p: 0.0 - (0.0 - x.a),
        lambda x, p: x.a + 0.0 * x.b,
        lambda x, p: x.a + 0.0 / x.b,
        lambda x, p: x.a * x.b**0,
        lambda x, p: -1 * (-x.a),
    ],
)
def test_neutral_elements_leave_nothing_behind(function: Callable[..., Any]) -> None:
    assert names(function) == []


@pytest.mark.parametrize(
    ("function", "kept"),
    [
        (lambda x, p: 0 - x.a, ["neg"]),
        (lambda x, p: x.a * -1, ["neg"]),
        (lambda x, p: x.a + -x.b, ["sub"]),
        (lambda x, p: -x.b + x.a, ["sub"]),
        (lambda x, p: x.a - -x.b, ["add"]),
        (lambda x, p: x.a * x.a, ["square"]),
        (lambda x, p: x.a**2, ["square"]),
        (lambda x, p: x.a**0.5, ["sqrt"]),
        (lambda x, p: x.a**-1, ["div"]),
        (lambda x, p: (-x.a) * (-x.b), ["mul"]),
    ],
)
def test_simple_forms_replace_costly_ones(function: Callable[..., Any], kept: list[str]) -> None:
    assert names(function) == kept


def test_what_no_loop_needs_is_not_on_the_tape() -> None:
    def loops(x: Any, p: Any) -> Any:
        np.exp(x.b)
        return x.a

    assert names(loops) == []
