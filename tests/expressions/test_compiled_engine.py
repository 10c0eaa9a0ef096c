"""The compiled engine gives what NumPy gives, whatever the width, the threads and the poses."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from loopcal.expressions import choice
from loopcal.expressions.compiled_engine import CompiledEngine, prepared
from loopcal.expressions.derivative import linearise
from loopcal.expressions.domain import LoopValues, Stage
from loopcal.expressions.engine import NumpyEngine, engine_for
from loopcal.expressions.rewriting import varying
from loopcal.expressions.tape import Tape
from loopcal.expressions.trace import trace
from loopcal.mechanisms.planar import motoman_ma1400
from tests.reference.random_loops import PARAMETERS, QUANTITIES, RandomLoops, random_loops
from tests.refusals import refused

Array = NDArray[np.float64]
built = pytest.mark.skipif(not choice.AVAILABLE, reason="the compiled engine was not built")
if choice.AVAILABLE:
    from loopcal.expressions import _compiled


def run(
    kind: type[NumpyEngine] | type[CompiledEngine],
    tape: Tape,
    x: Array,
    p: Array,
    stage: Stage = Stage.BY_PARAMETER,
) -> LoopValues:
    one = kind(linearise(tape, tape.quantities, tape.parameters), x.shape[1])
    values = one.evaluate(p, x, None, stage)
    return LoopValues(values.f.copy(), values.by_quantity.copy(), values.by_parameter.copy())


def parts(values: LoopValues) -> tuple[Array, Array, Array]:
    return values.f, values.by_quantity, values.by_parameter


def alike(ours: LoopValues, theirs: LoopValues, tolerance: float = 1e-12) -> None:
    for a, b in zip(parts(ours), parts(theirs), strict=True):
        assert a.shape == b.shape
        finite = np.isfinite(b)
        assert np.array_equal(finite, np.isfinite(a))
        scale = 1.0 + abs(b[finite])
        assert np.all(abs(a[finite] - b[finite]) <= tolerance * scale)


@built
@given(random_loops(), st.integers(0, 2**32 - 1))
def test_random_tapes_give_the_same_on_both_engines(loops: RandomLoops, seed: int) -> None:
    tape = trace(loops, quantities=QUANTITIES, parameters=PARAMETERS)
    rng = np.random.default_rng(seed)
    x, p = rng.uniform(-2, 2, (3, int(rng.integers(1, 70)))), rng.uniform(-2, 2, 2)
    alike(run(CompiledEngine, tape, x, p), run(NumpyEngine, tape, x, p))


@built
@pytest.mark.parametrize("stage", Stage)
@pytest.mark.parametrize("width", [1, 15, 16, 17, 127, 129, 5000])
def test_an_arm_gives_the_same_on_both_engines(width: int, stage: Stage) -> None:
    mechanism = motoman_ma1400()
    rng = np.random.default_rng(width)
    x = rng.uniform(-3, 3, (9, width))
    p = np.array([q.nominal for q in mechanism.parameters]) + 0.01
    ours = run(CompiledEngine, mechanism.tape, x, p, stage)
    alike(ours, run(NumpyEngine, mechanism.tape, x, p, stage), 1e-14)


@built
@pytest.mark.usefixtures("restored")
def test_widths_and_threads_give_the_same_bits() -> None:
    mechanism = motoman_ma1400()
    x = np.random.default_rng(1).uniform(-20, 20, (9, 3001))
    p = np.array([q.nominal for q in mechanism.parameters]) + 0.01
    found = []
    for width in _compiled.widths():
        for threads in (1, 2, 5):
            _compiled.use_width(width)
            _compiled.use_threads(threads)
            found.append([a.tobytes() for a in parts(run(CompiledEngine, mechanism.tape, x, p))])
    assert all(one == found[0] for one in found)


@built
@pytest.mark.usefixtures("restored")
def test_sine_and_cosine_are_right_to_an_ulp_for_every_angle() -> None:
    """libm is right to half an ulp or little more; angles where reduction is hard among them."""
    rng = np.random.default_rng(2)
    near = np.arange(-3000.0, 3000.0) * (np.pi / 2)
    angles = np.concatenate(
        [
            rng.uniform(-4, 4, 20_000),
            rng.uniform(-1e5, 1e5, 20_000),
            np.exp(rng.uniform(-700, 700, 5_000)),
            near,
            np.nextafter(near, np.inf),
            [6381956970095103.0 * 2.0**797, 5e-324, -0.0, 131071.5, 131072.0, 131073.0],
        ]
    )
    tape = trace(lambda x, p: (np.sin(x["a"]), np.cos(x["a"])), quantities="a", parameters=())
    for width in _compiled.widths():
        _compiled.use_width(width)
        found = run(CompiledEngine, tape, angles[None], np.zeros(0), Stage.VALUES).f
        for ours, exact in zip(found, (np.sin(angles), np.cos(angles)), strict=True):
            assert np.all(abs(ours - exact) <= np.spacing(abs(exact)))


@built
def test_no_angle_gives_no_number() -> None:
    tape = trace(lambda x, p: (np.sin(x["a"]) + np.cos(x["a"]),), quantities="a", parameters=())
    x = np.array([[0.0, np.nan, np.inf, -np.inf, 1.0]])
    values = run(CompiledEngine, tape, x, np.zeros(0))
    assert np.isnan(values.f[0]).tolist() == [False, True, True, True, False]


DOMAINS: dict[str, Any] = {
    "sqrt": lambda a, k: np.sqrt(a) + k,
    "log": lambda a, k: np.log(a) * k,
    "arcsin": lambda a, k: np.arcsin(a) + k,
    "arccos": lambda a, k: k - np.arccos(a),
    "division": lambda a, k: k / a,
    "power": lambda a, k: a**k,
    "to the power": lambda a, k: k**a,
    "hypot": lambda a, k: np.hypot(a, k),
    "arctan2": lambda a, k: np.arctan2(a, k),
    "abs": lambda a, k: abs(a) * k,
    "exp": lambda a, k: np.exp(100.0 * a) - k,
    "tan": lambda a, k: np.tan(a) * k,
    "of a parameter": lambda a, k: a / k + np.sqrt(k) * np.log(k) + a * (1.0 / k) ** 2,
    "overflow of a parameter": lambda a, k: a / np.exp(900.0 * abs(k)) + k**-400.0 * a,
}


@built
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("name", DOMAINS)
def test_outside_a_domain_both_engines_give_no_number_alike(name: str) -> None:
    tape = trace(lambda x, p: (DOMAINS[name](x["a"], p["k"]),), quantities="a", parameters="k")
    x = np.array([[-1e300, -9.0, -1.0, -0.5, -0.0, 0.0, 0.5, 1.0, 9.0, 1e300, np.inf, np.nan]])
    for k in (-1.5, -1.0, 0.0, 0.5, 2.0):
        ours, theirs = (run(e, tape, x, np.array([k])) for e in (CompiledEngine, NumpyEngine))
        for a, b in zip(parts(ours), parts(theirs), strict=True):
            assert np.array_equal(np.isnan(a), np.isnan(b))
            same = ~np.isnan(b)
            assert a[same] == pytest.approx(b[same], rel=1e-12)


def test_rotations_are_made_whole_and_angles_once() -> None:
    mechanism = motoman_ma1400()
    linearisation = linearise(mechanism.tape, mechanism.tape.quantities, mechanism.tape.parameters)
    names = [one.name for one in prepared(linearisation)[2].instructions]
    assert names.count("sincos") == 6
    assert names.count("turn") >= 60
    operations = linearisation.tape.operations
    varying_operations = sum(
        v and name not in ("quantity", "known")
        for v, (name, _) in zip(varying(operations), operations, strict=True)
    )
    assert (varying_operations, len(names)) == (559, 156)  # fewer than 600: record 0001


def test_the_environment_chooses_the_engine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LOOPCAL_ENGINE", "numpy")
    assert choice.chosen_engine() == "numpy"
    assert choice.in_words() == "numpy"
    monkeypatch.setenv("LOOPCAL_ENGINE", "nunpy")
    with refused("unknown-name", "did you mean 'numpy'"):
        choice.chosen_engine()
    monkeypatch.setenv("LOOPCAL_ENGINE", "")
    monkeypatch.setattr(choice, "AVAILABLE", False)
    assert choice.chosen_engine() == "numpy"
    monkeypatch.setenv("LOOPCAL_ENGINE", "compiled")
    with refused("missing-dependency"):
        choice.chosen_engine()


def test_an_engine_of_other_sources_is_replaced_by_numpy_with_a_warning(tmp_path: Path) -> None:
    """Whatever the library is: here one that states no interface, as those before the number."""
    code = (
        "import sys, types; name = 'loopcal.expressions._compiled'; "
        "sys.modules[name] = types.ModuleType(name); "
        "from loopcal.cli import main; sys.exit(main(sys.argv[1:]))"
    )
    project = Path(__file__).parents[2] / "examples" / "planar" / "project.toml"
    command = [sys.executable, "-c", code, "calibrate", str(project), "--no-report"]
    env = {k: v for k, v in os.environ.items() if k != "LOOPCAL_ENGINE"}
    for chosen, exit_code in (({}, 0), ({"LOOPCAL_ENGINE": "compiled"}, 2)):
        done = subprocess.run(
            [*command, "--out", str(tmp_path / "out")],
            capture_output=True,
            text=True,
            env=env | chosen,
            check=False,
        )
        assert done.returncode == exit_code, done.stderr
        assert done.stderr.count("built from another version of loopcal's sources") == 1
        assert "make install" in done.stderr
        assert "Traceback" not in done.stderr


@built
def test_the_number_of_the_interface_is_raised_with_its_signatures() -> None:
    """If this fails, raise INTERFACE in choice.py and module.cpp, then add its digest here."""
    stub = Path(choice.__file__).with_name("_compiled.pyi").read_bytes()
    assert {choice.INTERFACE: hashlib.sha256(stub).hexdigest()[:12]} == {3: "f7c05ae6090b"}
    assert _compiled.INTERFACE == choice.INTERFACE


@built
@pytest.mark.usefixtures("restored")
def test_the_environment_sets_the_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LOOPCAL_ENGINE", "compiled")
    monkeypatch.setenv("LOOPCAL_THREADS", "3")
    assert choice.in_words() == f"compiled, {_compiled.width()}, 3 threads"
    monkeypatch.setenv("LOOPCAL_THREADS", "1024")
    assert choice.use_threads() == 1024
    monkeypatch.setenv("LOOPCAL_THREADS", "")
    assert choice.use_threads() == choice.cores()


@pytest.mark.usefixtures("each_engine")
@pytest.mark.parametrize("wrong", ["0", "two", "-1", "1025", "2147483648", "1" + 5000 * "0"])
def test_a_number_of_threads_that_is_none_is_told(
    wrong: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("LOOPCAL_THREADS", wrong)
    with refused("invalid-usage", "LOOPCAL_THREADS"):
        choice.in_words()
    with refused("invalid-usage", "LOOPCAL_THREADS"):
        engine_for(trace(lambda x, p: [x["a"]], quantities="a", parameters=()), (), 1)


@built
def test_a_tape_without_loops_has_no_values() -> None:
    """As of a limb that no instrument sees from its root."""
    tape = trace(lambda x, p: (p["p"] - x["q"],), quantities="q", parameters="p")
    tape = replace(tape, loops=(), outputs=())
    for kind in (NumpyEngine, CompiledEngine):
        values = kind(linearise(tape, ("q",), ("p",)), 4).evaluate(np.zeros(1), np.zeros((1, 3)))
        assert values.f.shape == (0, 3)
