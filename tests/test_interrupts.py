"""Ctrl-C is heard while the engine works, within a long call too, and leaves nothing half done."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import pytest

from loopcal.expressions.choice import AVAILABLE, ENGINES
from loopcal.expressions.compiled_engine import CompiledEngine
from loopcal.expressions.derivative import linearise
from loopcal.expressions.domain import Stage
from loopcal.expressions.trace import trace
from tests.command_line import environment, run

if AVAILABLE:
    from loopcal.expressions import _compiled

PLANAR = Path(__file__).parents[1] / "examples" / "planar" / "project.toml"
HEARD = 10.0
"""Seconds in which the process must end; what it does would take many times as long."""
ENGINE = [
    pytest.param(
        name,
        marks=pytest.mark.skipif(
            name == "compiled" and not AVAILABLE, reason="the compiled engine was not built"
        ),
    )
    for name in ENGINES
]

ONE_CALL = """
import numpy as np
from loopcal.expressions.compiled_engine import CompiledEngine
from loopcal.expressions.derivative import linearise
from loopcal.expressions.domain import Stage
from loopcal.expressions.trace import trace

def loops(x, p):
    a = x.a
    for _ in range(2000):
        a = np.exp(-np.arctan(a))
    return [a]

engine = CompiledEngine(linearise(trace(loops, quantities="a", parameters=()), (), ()), 4_000_000)
x = np.linspace(-1.0, 1.0, 4_000_000)[None]
print("begun", flush=True)
engine.evaluate(np.zeros(0), x, None, Stage.VALUES)
print("ended", flush=True)
"""

SOLVES = """
import numpy as np
from loopcal.estimation.problem.problem import build_problem
from loopcal.estimation.solve.solver import solve
from loopcal.measurements.noise import Noise
from tests.reference.simulated import ma1400

arm = ma1400(20_000)
sds = dict.fromkeys(arm.truth.quantities, 0.0001)
problem = build_problem(arm.off(2e-3, 2e-3), arm.read(sds), Noise(sds))
before = solve(problem).parameters
print("begun", flush=True)
try:
    while True:
        solve(problem)
except KeyboardInterrupt:
    assert np.array_equal(solve(problem).parameters, before)
    raise
"""

COMMAND = """
import sys
from loopcal.cli.run import main
from loopcal.estimation.solve.sweep import Sweeper

sweep = Sweeper.sweep

def long(*arguments, **options):
    print("begun", flush=True)
    for _ in range(1_000_000):
        found = sweep(*arguments, **options)
    return found

Sweeper.sweep = long
sys.exit(main(sys.argv[1:]))
"""

HEARS = "import signal\nsignal.signal(signal.SIGINT, signal.default_int_handler)\n"
"""A process in the background of a shell is deaf to an interrupt, and so is what it starts."""


def interrupted(program: str, *arguments: str, engine: str) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of a program that gets SIGINT once it has begun."""
    command = [sys.executable, "-c", HEARS + program, *arguments]
    with subprocess.Popen(
        command,
        env=environment(LOOPCAL_ENGINE=engine, LOOPCAL_THREADS="2"),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        line = process.stdout.readline()
        time.sleep(0.2)  # well into what has begun
        process.send_signal(signal.SIGINT)
        try:
            out, error = process.communicate(timeout=HEARD)
        except subprocess.TimeoutExpired:
            process.kill()
            pytest.fail("the interrupt was not heard")
    assert line == "begun\n", error
    return process.returncode, out, error


@pytest.mark.skipif(not AVAILABLE, reason="the compiled engine was not built")
def test_one_long_call_of_the_engine_is_interrupted() -> None:
    code, out, error = interrupted(ONE_CALL, engine="compiled")
    assert code == -signal.SIGINT
    assert out == ""
    assert error.rstrip().endswith("KeyboardInterrupt")


def slow(x: Any, p: Any) -> list[Any]:
    a = x["a"]
    for _ in range(300):
        a = np.exp(-np.arctan(a))
    return [a]


def roomy(x: Any, p: Any) -> list[Any]:
    sines = [np.sin((1.0 + 0.01 * i) * x["a"]) for i in range(200)]
    return [sum(one * two for one, two in zip(sines, reversed(sines), strict=True))]


@pytest.mark.skipif(not AVAILABLE, reason="the compiled engine was not built")
@pytest.mark.parametrize("threads", [1, 2])
def test_a_signal_handler_may_evaluate_another_engine_within_a_call(threads: int) -> None:
    x = np.linspace(-1.0, 1.0, 200_000)[None]
    outer, inner = (
        CompiledEngine(linearise(trace(f, quantities="a", parameters=()), (), ()), x.shape[1])
        for f in (slow, roomy)
    )
    before = _compiled.threads()
    _compiled.use_threads(threads)
    expected = [one.evaluate(np.zeros(0), x, None, Stage.VALUES).f.copy() for one in (outer, inner)]
    begun, heard = False, []

    def handler(number: int, frame: FrameType | None) -> None:
        heard.append((begun, inner.evaluate(np.zeros(0), x, None, Stage.VALUES).f.copy()))

    replaced = signal.signal(signal.SIGALRM, handler)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.05)
        begun = True
        found = outer.evaluate(np.zeros(0), x, None, Stage.VALUES).f.copy()
        begun = False
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, replaced)
        _compiled.use_threads(before)
    assert [within for within, _ in heard] == [True]
    assert np.array_equal(heard[0][1], expected[1])
    assert np.array_equal(found, expected[0])


def test_the_command_is_interrupted_while_it_is_loaded(tmp_path: Path) -> None:
    (tmp_path / "typer.py").write_text("raise KeyboardInterrupt", "utf-8")
    done = run("--version", env={"PYTHONPATH": str(tmp_path)})
    assert (done.returncode, done.stdout) == (130, "")
    assert done.stderr == "loopcal: interrupted\n"


@pytest.mark.parametrize("engine", ENGINE)
def test_solves_are_interrupted_and_can_begin_anew(engine: str) -> None:
    code, out, error = interrupted(SOLVES, engine=engine)
    assert code == -signal.SIGINT
    assert out == ""
    assert error.rstrip().endswith("KeyboardInterrupt")


@pytest.mark.parametrize("engine", ENGINE)
def test_the_command_ends_with_a_line_and_leaves_the_result_it_found(
    engine: str, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    calibrate = ["calibrate", str(PLANAR), "--no-report", "--out", str(out)]
    assert run(*calibrate).returncode == 0
    before = {path: path.read_bytes() for path in sorted(out.iterdir())}
    code, _, error = interrupted(COMMAND, *calibrate, engine=engine)
    assert code == 130
    assert error.splitlines()[-1] == "loopcal: interrupted"
    assert "Traceback" not in error
    assert {path: path.read_bytes() for path in sorted(out.iterdir())} == before
