"""Executors give the same outcomes, each once, whoever does the work and in whatever order."""

from __future__ import annotations

import pickle
import subprocess
import sys
import threading
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from threadpoolctl import threadpool_info

import loopcal as lc
from loopcal.document.result_document import ResultDocument
from loopcal.estimation.solve.scratch import one_blas_thread
from loopcal.execution import local
from loopcal.execution.executor import (
    AHEAD,
    Executor,
    InProcess,
    Window,
    gathered,
    in_order,
)
from loopcal.execution.forked import Forked
from loopcal.execution.local import Processes, Threads
from loopcal.expressions import choice
from loopcal.files.project.new_project import write_new_project
from loopcal.files.project.templates import TEMPLATES
from loopcal.workflow.calibration import Listeners, Request, run_calibration
from tests.execution import pieces
from tests.execution.pieces import Backwards
from tests.reference.simulated import planar_arm
from tests.refusals import refused

FORKS = sys.platform == "linux"
LOCAL = [
    InProcess(),
    Threads(1),
    Threads(2),
    Processes(1),
    Processes(2),
    *([Forked(1), Forked(3)] if FORKS else []),
]


@pytest.mark.parametrize("executor", [None, *LOCAL, Backwards()], ids=str)
def test_values_come_in_the_order_of_the_pieces_and_each_is_counted(
    executor: Executor | None,
) -> None:
    told: list[tuple[int, int]] = []
    found = gathered(executor, pieces.scaled, 0.1, list(range(20)), lambda *seen: told.append(seen))
    assert found == [0.1 * piece for piece in range(20)]
    assert told == [(i + 1, 20) for i in range(20)]


@pytest.mark.parametrize("executor", [*LOCAL, Backwards()], ids=str)
def test_there_may_be_no_pieces(executor: Executor) -> None:
    assert gathered(executor, pieces.scaled, 1.0, []) == []


@pytest.mark.parametrize("executor", [*LOCAL, Backwards()], ids=str)
def test_the_first_error_is_told_whichever_happened_first(executor: Executor) -> None:
    with refused("invalid-value", "3 is"):
        gathered(executor, pieces.odd_refused, "here", [0, 2, 3, 4, 5, 7])


@pytest.mark.parametrize("executor", LOCAL, ids=str)
def test_a_fault_of_ours_stays_one(executor: Executor) -> None:
    with pytest.raises(ZeroDivisionError):
        gathered(executor, pieces.faulty, None, [1, 2])


@pytest.mark.parametrize("executor", LOCAL, ids=str)
def test_work_may_be_left_before_its_end(executor: Executor) -> None:
    before = threading.active_count()
    with closing(executor.run(pieces.scaled, 1.0, range(50))) as finished:
        first = next(finished)
    assert first.value == first.number
    assert threading.active_count() == before


def test_a_process_that_dies_is_a_message() -> None:
    with refused("worker-lost"):
        gathered(Processes(2), pieces.killing, 0, [1, 2])
    with refused("worker-lost") as told:
        gathered(Processes(2), pieces.killing, 2 * AHEAD, range(2 * AHEAD + 1))
    assert "fewer workers" in str(told.value.remedy)


def test_a_script_that_starts_processes_unguarded_is_told_of_the_guard(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(
        "import loopcal as lc\nfrom loopcal.execution.executor import gathered\n"
        "gathered(lc.Processes(2), pow, 2, [1, 2])\n",
        "utf-8",
    )
    done = subprocess.run(
        [sys.executable, str(script)], capture_output=True, text=True, check=False, timeout=60
    )
    assert "put the work under if __name__ ==" in done.stderr


def test_threads_tell_that_they_are_waited_for() -> None:
    told: list[str] = []
    executor = Threads(2, waiting=lambda: told.append("waiting"))
    with executor.crew(pieces.scaled, 1.0) as done_by:
        list(done_by([1.0]))
    assert not told
    with pytest.raises(KeyboardInterrupt), executor.crew(pieces.scaled, 1.0):
        raise KeyboardInterrupt
    assert told == ["waiting"]


@pytest.mark.parametrize("executor", LOCAL, ids=str)
def test_a_crew_does_several_runs(executor: Executor) -> None:
    with executor.crew(pieces.scaled, 0.5) as done_by:
        for _ in range(3):
            assert list(in_order(done_by([2, 4, 6]))) == [1.0, 2.0, 3.0]
        with closing(done_by(range(50))) as left:
            next(left)
        with pytest.raises(TypeError):
            list(done_by([None]))


def test_values_that_nobody_takes_do_not_pile_up() -> None:
    begun: list[int] = []
    with closing(Threads(2).run(pieces.noted, begun, range(100))) as finished:
        for taken in range(1, 40):
            next(finished)
            assert len(begun) <= taken + 2 * AHEAD
        assert len(begun) >= 39


def test_no_piece_is_begun_far_ahead_of_the_first_that_is_missing() -> None:
    window = Window(20)
    assert window.next(2) == range(2 * AHEAD)
    for number in range(1, 2 * AHEAD):
        window.take(number)
        assert not window.next(2)  # the first takes long
    window.take(0)
    assert window.next(2) == range(2 * AHEAD, 4 * AHEAD)
    assert not window.next(1)  # fewer workers than before
    assert window.next(99) == range(4 * AHEAD, 20)


@pytest.mark.skipif(not choice.AVAILABLE, reason="installed without a compiler")
@pytest.mark.parametrize(
    ("executor", "threads"),
    [(Threads(1), 4), (Threads(2), 2), (Threads(3), 1), (Threads(9), 1), (Processes(2), 2)],
    ids=str,
)
def test_workers_share_the_cores_with_their_engines(
    executor: Executor, threads: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("LOOPCAL_THREADS", raising=False)
    monkeypatch.setattr(local, "cores", lambda: 4)
    alone = choice.use_threads()
    assert set(gathered(executor, pieces.engine_threads, None, range(6))) == {threads}
    assert choice.use_threads() == alone
    monkeypatch.setenv("LOOPCAL_THREADS", "3")
    assert set(gathered(executor, pieces.engine_threads, None, range(6))) == {3}


@pytest.mark.parametrize("kind", [Processes, Threads])
def test_workers_are_counted_from_1(kind: type[Processes] | type[Threads]) -> None:
    with refused("invalid-usage", "workers is 0", "1 to 1024"):
        kind(0)


def test_threads_share_the_limit_on_linear_algebra() -> None:
    def limits() -> list[int]:
        return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]

    before = limits()
    assert gathered(Threads(2), pieces.blas_threads, None, list(range(8))) == [1] * 8
    assert limits() == before
    with one_blas_thread():
        with one_blas_thread():
            pass
        assert max(limits()) == 1  # the inner one does not lift what the outer one holds
    assert limits() == before


ARM = planar_arm(30)
SDS = {"xP": 1e-4, "yP": 1e-4, "phi2": 1e-3, "phi3": 1e-3}
DATA = ARM.read(SDS, seed=3)


@pytest.mark.parametrize("executor", [Threads(2), Processes(2), Backwards()], ids=str)
def test_validation_is_the_same_to_the_bit(executor: Executor) -> None:
    how: dict[str, Any] = {"noise": lc.Noise(SDS), "folds": 5, "method": "implicit-loop"}
    here = lc.validate(ARM.truth, DATA, **how)
    found = lc.validate(ARM.truth, DATA, executor=executor, **how)
    assert found.accuracy == here.accuracy
    assert found.log_likelihood == here.log_likelihood
    np.testing.assert_array_equal(found.distances, here.distances)
    np.testing.assert_array_equal(found.by_pose, here.by_pose)


@pytest.mark.parametrize("method", ["implicit-loop", "least-squares"])
def test_profiles_are_the_same_to_the_bit(method: str) -> None:
    noise = None if method == "least-squares" else lc.Noise(SDS)
    result = lc.calibrate(ARM.truth, DATA, noise=noise, method=method)
    here = lc.intervals(result)
    assert None not in here.values()
    for executor in (Threads(2), Backwards()):
        assert lc.intervals(result, executor=executor) == here
    some = lc.intervals(result, ["l?"], executor=Processes(2))
    assert some == {name: here[name] for name in ("l2", "l3")}


def test_a_calibration_is_the_same_whoever_does_its_pieces(tmp_path: Path) -> None:
    project = Path(__file__).resolve().parents[2] / "examples" / "planar" / "project.toml"
    told: list[tuple[str, int, int]] = []
    shared: list[Executor] = []

    def calibrated(executor: Executor | None) -> ResultDocument:
        done = run_calibration(
            project,
            Request(folds=5, profile=["l?"], method="implicit-loop"),
            out=tmp_path / "result",
            executor=executor,
            listeners=Listeners(sharing=shared.append, pieces=lambda *seen: told.append(seen)),
        )
        return done.written.document

    assert calibrated(Backwards()) == calibrated(None)
    once = [("folds", i + 1, 5) for i in range(5)] + [("intervals", i + 1, 2) for i in range(2)]
    assert told == once + once
    assert shared == [Backwards()]
    with refused("invalid-usage", "--folds"):
        run_calibration(
            project,
            Request(method="implicit-loop"),
            out=tmp_path / "alone",
            executor=Threads(2),
            listeners=Listeners(sharing=shared.append),
        )
    assert shared == [Backwards()]


def test_compared_models_are_the_same_whoever_fits_them() -> None:
    arm = lc.planar_two_link().with_nominal({"l2": 0.8})
    models = {"loose": lc.Model()}
    how: dict[str, Any] = {"noise": lc.Noise(SDS), "folds": 3, "method": "implicit-loop"}
    found = [
        lc.compare_models(arm, DATA, models, executor=executor, **how)
        for executor in (InProcess(), Backwards())
    ]
    first, second = ([m.validation for m in one.models] for one in found)
    for a, b in zip(first, second, strict=True):
        assert a is not None
        assert b is not None
        assert a.log_likelihood == b.log_likelihood


@pytest.mark.parametrize("kind", [kind for kind in TEMPLATES if kind != "function"])
def test_every_machine_can_travel(kind: str, tmp_path: Path) -> None:
    write_new_project(tmp_path / kind, kind)
    mechanism = lc.read_project(tmp_path / kind / "project.toml").mechanism
    arrived = pickle.loads(pickle.dumps(mechanism))
    assert str(arrived.tape) == str(mechanism.tape)
    assert arrived.parameters == mechanism.parameters
