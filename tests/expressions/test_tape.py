"""A tape is a value: it prints as formulas, travels as JSON, and is compared by what it says."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given

from loopcal.expressions.tape import Tape
from loopcal.expressions.trace import trace
from tests.reference.machines import two_link
from tests.reference.plain_tape import FUNCTIONS, loop_values
from tests.reference.random_loops import PARAMETERS, QUANTITIES, RandomLoops, random_loops


def traced(loops: RandomLoops) -> Tape:
    return trace(loops, quantities=QUANTITIES, parameters=PARAMETERS)


ARM = trace(
    two_link,
    quantities=("xP", "yP", "phi2", "phi3"),
    parameters=("xA", "yA", "l2", "l3", "phi20", "phi30"),
    loops=("xP", "yP"),
)


def printed_values(tape: Tape, x: Any, p: Any) -> list[Any]:
    """The loops by letting Python run what the tape prints."""
    scope: dict[str, Any] = {**FUNCTIONS, "x": SimpleNamespace(**x), "p": SimpleNamespace(**p)}
    values = []
    for line in str(tape).splitlines():
        _, separator, formula = line.partition(": ")
        if separator and formula.endswith(" = 0"):
            values.append(eval(formula.removesuffix(" = 0"), scope))
        else:
            exec(line, scope)
    return values


def test_the_two_link_arm_prints_as_its_equations() -> None:
    assert str(ARM).splitlines() == [
        "t1 = x.phi2 + p.phi20",
        "t2 = p.phi30 + x.phi3 + t1",
        "xP: p.xA + p.l2*cos(t1) + p.l3*cos(t2) - x.xP = 0",
        "yP: p.yA + p.l2*sin(t1) + p.l3*sin(t2) - x.yP = 0",
    ]


@given(random_loops())
def test_what_is_printed_evaluates_to_the_same(loops: RandomLoops) -> None:
    tape = traced(loops)
    x, p = [0.3, -0.8, 1.1], [0.7, -0.4]
    values = printed_values(
        tape, dict(zip(QUANTITIES, x, strict=True)), dict(zip(PARAMETERS, p, strict=True))
    )
    expected = loop_values(tape, x, p)
    assert values == pytest.approx(expected, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize(
    ("function", "text"),
    [
        (lambda x, p: (x.a**x.b) ** p.k, "(x.a**x.b)**p.k"),
        (lambda x, p: x.a ** (x.b**p.k), "x.a**(x.b**p.k)"),
        (lambda x, p: x.a - (x.b - p.k), "x.a - (x.b - p.k)"),
        (lambda x, p: x.a - x.b - p.k, "x.a - x.b - p.k"),
        (lambda x, p: x.a / (x.b / p.k), "x.a/(x.b/p.k)"),
        (lambda x, p: x.a / (x.b * p.k), "x.a/(x.b*p.k)"),
        (lambda x, p: (x.a + x.b) * p.k, "p.k*(x.a + x.b)"),
        (lambda x, p: -(x.a + x.b), "-(x.a + x.b)"),
        (lambda x, p: -(x.a * x.b), "-x.a*x.b"),
        (lambda x, p: (-x.a) ** 3, "(-x.a)**3.0"),
        (lambda x, p: x.a * -2, "x.a*(-2.0)"),
        (lambda x, p: np.sin(x.a - p.k) * 0.1, "sin(x.a - p.k)*0.1"),
    ],
)
def test_brackets_stand_where_they_are_needed(function: Any, text: str) -> None:
    tape = trace(function, quantities=("a", "b"), parameters=("k",))
    assert str(tape) == f"loop 1: {text} = 0"


def test_tapes_are_equal_by_value_and_differ_in_any_constant() -> None:
    def tape(number: float) -> Tape:
        return trace(lambda x, p: x.a * number, quantities="a", parameters=())

    assert tape(2.5) == tape(2.5)
    assert hash(tape(2.5)) == hash(tape(2.5))
    assert tape(2.5) != tape(2.5000000000000004)


def test_equal_tapes_are_one_tape_while_it_is_in_use() -> None:
    """A tape is the key of what is made of it: equal ones would be compared at every look-up."""
    again = trace(two_link, quantities=ARM.quantities, parameters=ARM.parameters, loops=ARM.loops)
    assert again is ARM
    assert again.only([0]) is ARM.only([0])


def test_a_tape_cannot_be_changed() -> None:
    with pytest.raises(AttributeError):
        ARM.outputs = (0,)  # type: ignore[misc]


def test_each_loop_tells_what_it_depends_on() -> None:
    along_x, along_y = ARM.depends_on()
    assert along_x == {"xP", "phi2", "phi3", "xA", "l2", "l3", "phi20", "phi30"}
    assert along_y == {"yP", "phi2", "phi3", "yA", "l2", "l3", "phi20", "phi30"}
