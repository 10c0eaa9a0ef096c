"""A run is one process that can be cancelled, killed and left alone, and nothing of it stays."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator
from multiprocessing import forkserver
from pathlib import Path

import pytest

from loopcal.app.worker import Action, Busy, Run, Worker
from tests.app.plain_command import command


class Told:
    """What a worker told, and when a run of it is over."""

    def __init__(self) -> None:
        self.order: list[str] = []
        self.over = threading.Event()
        self.worker = Worker(command, self.begun, self.ended)

    def begun(self, action: Action) -> None:
        self.over.clear()
        self.order.append(f"begun {action.words[0]}")

    def ended(self, run: Run) -> None:
        self.order.append(f"ended {run.action.words[0]} {run.code}")
        self.over.set()

    def ran(self, folder: Path, *words: str) -> Run:
        run = self.worker.start(Action("do", words), str(folder))
        assert self.over.wait(120)
        return run


@pytest.fixture
def told() -> Iterator[Told]:
    found = Told()
    yield found
    found.worker.cancel()
    assert not found.worker.busy or found.over.wait(120)


def said(run: Run, text: str) -> None:
    """Wait until a run has said something."""
    for _ in range(600):
        if text in run.text:
            return
        threading.Event().wait(0.05)
    raise AssertionError(run.text)


def test_a_run_prints_in_its_folder_and_ends_with_its_code(told: Told, tmp_path: Path) -> None:
    run = told.ran(tmp_path, "print", "a", "b")
    assert run.code == 0
    assert run.text.splitlines() == ["a b", f"where {tmp_path}"]
    assert told.ran(tmp_path, "fail").code == 3
    assert told.order == ["begun print", "ended print 0", "begun fail", "ended fail 3"]


def test_a_second_run_waits_for_the_first(told: Told, tmp_path: Path) -> None:
    run = told.worker.start(Action("first", ("wait",)), str(tmp_path))
    with pytest.raises(Busy, match="first goes on"):
        told.worker.start(Action("second", ("print",)), str(tmp_path))
    said(run, "waiting")


def test_a_cancelled_run_undoes_what_it_has_begun(told: Told, tmp_path: Path) -> None:
    run = told.worker.start(Action("first", ("wait",)), str(tmp_path))
    said(run, "waiting")
    told.worker.cancel()
    assert told.over.wait(120)
    assert run.cancelled
    assert (tmp_path / "undone").read_text() == "yes"
    assert told.ran(tmp_path, "print").code == 0


def test_a_killed_run_leaves_the_worker_usable(told: Told, tmp_path: Path) -> None:
    run = told.ran(tmp_path, "die")
    assert run.code is not None
    assert run.code < 0
    assert not run.cancelled
    assert told.ran(tmp_path, "print").code == 0


@pytest.mark.skipif(
    "forkserver" not in multiprocessing.get_all_start_methods(), reason="no warm process here"
)
def test_a_killed_warm_process_is_started_again(told: Told, tmp_path: Path) -> None:
    assert told.ran(tmp_path, "print").code == 0
    warm: int = getattr(forkserver, "_forkserver")._forkserver_pid  # noqa: B009
    os.kill(warm, signal.SIGKILL)
    os.waitid(os.P_PID, warm, os.WEXITED | os.WNOWAIT)
    assert told.ran(tmp_path, "print", "again").text.startswith("again")


def test_what_is_kept_of_a_long_output_is_its_end() -> None:
    run = Run(Action("do", ("print",)))
    for i in range(5000):
        run.add_output("stdout", f"line {i}")
    assert len(run.lines) == 2000
    assert run.lines[-1] == "line 4999"
    run.add_output("stderr", "\r12 of 40 fits")
    assert run.progress == "12 of 40 fits"
