"""Both engines give, for every width of a block, what plain Python gives pose by pose."""

from __future__ import annotations

import math
import threading
from collections import Counter
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from loopcal.expressions import engine as numpy_engine
from loopcal.expressions import graph as operations
from loopcal.expressions.derivative import linearise
from loopcal.expressions.engine import Engine, NumpyEngine, engine_class, engine_for
from loopcal.expressions.graph import Graph
from loopcal.expressions.tape import Tape
from loopcal.expressions.trace import trace
from tests.reference.plain_tape import complex_step

Array = NDArray[np.float64]
WIDTHS = (1, 2, 63, 64, 65, 127, 1000, 4095, 4096)


def loops(x: Any, p: Any, m: Any = np) -> tuple[Any, Any]:
    """Something of everything; m is numpy while tracing and math for plain numbers."""
    angle_of = np.arctan2 if m is np else math.atan2
    turn = x.a + p.k * x.c
    reach = m.sqrt(p.l * p.l + x.b * x.b) + m.exp(-p.k)
    along = reach * m.cos(turn) - x.b / (2.0 + m.sin(x.a))
    return along, m.hypot(reach, turn) * angle_of(x.b, p.l)


TAPE = trace(loops, quantities=("a", "b"), pose_constants=("c",), parameters=("k", "l"))
P = np.array([0.4, 1.3])


def readings(width: int) -> tuple[Array, Array]:
    rng = np.random.default_rng(width)
    return rng.uniform(-2, 2, (2, width)), rng.uniform(-1, 1, (1, width))


class Pose:
    def __init__(self, **values: float) -> None:
        self.__dict__.update(values)

    def __getattr__(self, name: str) -> float:
        raise AttributeError(name)


def pose_by_pose(x: Array, known: Array, p: Array) -> Array:
    columns = []
    for (a, b), (c,) in zip(x.T.tolist(), known.T.tolist(), strict=True):
        columns.append(loops(Pose(a=a, b=b, c=c), Pose(k=p[0], l=p[1]), math))
    return np.array(columns).T


pytestmark = pytest.mark.usefixtures("each_engine")


def new_engine(tape: Tape, size: int) -> Engine:
    return engine_class()(linearise(tape, tape.quantities, tape.parameters), size)


@pytest.mark.parametrize("width", WIDTHS)
def test_a_block_equals_plain_python_pose_by_pose(width: int) -> None:
    engine = new_engine(TAPE, 4096)
    x, known = readings(width)
    assert engine.evaluate(P, x, known).f == pytest.approx(pose_by_pose(x, known, P), rel=1e-14)


@pytest.mark.parametrize("width", [1, 64, 65, 4096])
def test_derivatives_of_a_block_equal_the_complex_step(width: int) -> None:
    engine = new_engine(TAPE, width)
    x, known = readings(width)
    values, expected = engine.evaluate(P, x, known), complex_step(TAPE, x, P, known)
    assert values.by_quantity == pytest.approx(expected.by_quantity, rel=1e-12, abs=1e-14)
    assert values.by_parameter == pytest.approx(expected.by_parameter, rel=1e-12, abs=1e-14)


def test_one_engine_serves_blocks_of_changing_width_and_parameters() -> None:
    engine = new_engine(TAPE, 4096)
    for width in (4096, 1, 65, 4096, 130, 64):
        for p in (P, P + 1.0):
            x, known = readings(width)
            values = engine.evaluate(p, x, known)
            assert values.f.shape == (2, width)
            assert values.f == pytest.approx(pose_by_pose(x, known, p), rel=1e-14)


def test_no_pose_is_no_work() -> None:
    engine = new_engine(TAPE, 64)
    values = engine.evaluate(P, np.zeros((2, 0)), np.zeros((1, 0)))
    assert values.f.shape == (2, 0)
    assert values.by_quantity.shape == (2, 2, 0)


def test_more_poses_than_the_engine_holds_go_block_by_block() -> None:
    x, known = readings(5000)
    engine = new_engine(TAPE, 4096)
    parts = [
        engine.evaluate(P, x[:, part], known[:, part]).f.copy()
        for part in (slice(0, 4096), slice(4096, 5000))
    ]
    assert np.hstack(parts) == pytest.approx(pose_by_pose(x, known, P), rel=1e-14)


def test_a_block_of_one_gives_the_bits_of_a_wide_block() -> None:
    """Otherwise the result would depend on how poses are cut into blocks."""
    engine = new_engine(TAPE, 1024)
    x, known = readings(1024)
    wide = engine.evaluate(P, x, known).f.copy()
    single = np.hstack([engine.evaluate(P, x[:, [i]], known[:, [i]]).f.copy() for i in range(100)])
    assert single == pytest.approx(wide[:, :100], rel=1e-15)


def test_what_depends_on_parameters_alone_is_evaluated_once_per_parameters(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    counted: Counter[str] = Counter()
    plain = operations.evaluate_scalar

    def counting(name: str, *arguments: float) -> float:
        counted[name] += 1
        return plain(name, *arguments)

    monkeypatch.setattr(numpy_engine, "evaluate_scalar", counting)
    tape = trace(
        lambda x, p: (x["a"] * np.sin(p["k"]), x["a"] + np.sin(p["k"]) ** 3),
        quantities="a",
        parameters="k",
    )
    engine = NumpyEngine(linearise(tape, (), ()), 64)
    assert not counted
    for _ in range(3):
        engine.evaluate(np.array([0.5]), np.ones((1, 64)))
    assert counted == {"sin": 1, "pow": 1}
    engine.evaluate(np.array([0.6]), np.ones((1, 64)))
    assert counted == {"sin": 2, "pow": 2}


def test_outputs_that_are_alike_constant_or_a_reading_itself() -> None:
    tape = trace(
        lambda x, p: (x["a"], x["a"] - p["k"], x["a"] - p["k"], x["a"]),
        quantities="a",
        pose_constants="c",
        parameters="k",
    )
    engine = new_engine(tape, 256)
    for width in (3, 256, 5):
        for k in (2.0, 3.0):
            a = np.arange(width, dtype=float)
            values = engine.evaluate(np.array([k]), a[None], np.ones((1, width)))
            assert values.f.tolist() == [list(a), list(a - k), list(a - k), list(a)]
            assert values.by_quantity.tolist() == [[[1.0] * width] * 4]
            assert values.by_parameter.tolist() == [
                [[0.0] * width, [-1.0] * width, [-1.0] * width, [0.0] * width]
            ]


def test_values_outside_a_domain_come_out_as_nan_without_a_warning() -> None:
    tape = trace(lambda x, p: (np.sqrt(x["a"]), np.log(x["a"])), quantities="a", parameters=())
    engine = new_engine(tape, 2)
    values = engine.evaluate(np.zeros(0), np.array([[-1.0, 4.0]]))
    assert np.isnan(values.f[:, 0]).all()
    assert values.f[:, 1].tolist() == [2.0, math.log(4.0)]


def test_each_thread_has_its_own_engine_and_one_thread_keeps_its() -> None:
    here = engine_for(TAPE, ("k",), 64)
    assert engine_for(TAPE, ("k",), 64) is here
    assert engine_for(TAPE, ("l",), 64) is not here
    there: list[Engine] = []
    thread = threading.Thread(target=lambda: there.append(engine_for(TAPE, ("k",), 64)))
    thread.start()
    thread.join()
    assert there[0] is not here


def test_threads_do_not_disturb_each_other() -> None:
    x, known = readings(512)
    expected = {k: pose_by_pose(x, known, np.array([k, 1.3])) for k in (0.1, 0.7)}
    wrong: list[float] = []

    def work(k: float) -> None:
        engine = engine_for(TAPE, ("k", "l"), 512)
        for _ in range(50):
            if not np.allclose(
                engine.evaluate(np.array([k, 1.3]), x, known).f, expected[k], rtol=1e-13
            ):
                wrong.append(k)

    threads = [threading.Thread(target=work, args=(k,)) for k in (0.1, 0.7)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong


def test_equal_tapes_share_an_engine_and_different_ones_do_not() -> None:
    def tape(number: float) -> Tape:
        return trace(lambda x, p: (x["a"] * number,), quantities="a", parameters="k")

    assert engine_for(tape(2.0), (), 8) is engine_for(tape(2.0), (), 8)
    assert engine_for(tape(2.0), (), 8) is not engine_for(tape(3.0), (), 8)


def test_an_engine_at_work_outlives_those_of_a_study() -> None:
    at_work = engine_for(TAPE, ("k",), 8)
    graph = Graph()
    for i in range(80):
        loop = graph.apply("add", graph.leaf("quantity", 0), graph.constant(float(i)))
        tape = Tape.from_graph(graph, [loop], quantities="a", parameters=(), loops="f")
        engine_for(tape, (), 8)
        assert engine_for(TAPE, ("k",), 8) is at_work
