"""Forked copies change no value, come back with it alone, and leave nothing behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import loopcal as lc
from loopcal.execution.executor import InProcess, gathered
from loopcal.execution.forked import Forked, process_cores, waits_only
from loopcal.execution.local import Threads
from tests.command_line import environment
from tests.execution import pieces
from tests.reference.simulated import planar_arm
from tests.test_interrupts import HEARD, HEARS

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="forks on Linux alone")

SLEEPS = """
from loopcal.execution.executor import gathered
from loopcal.execution.forked import Forked
from tests.execution import pieces
gathered(Forked(3), pieces.sleeping, 60.0, range(3))
"""


def own_threads_are(monkeypatch: pytest.MonkeyPatch, threads: list[threading.Thread]) -> None:
    monkeypatch.setattr(threading, "enumerate", lambda: threads)
    monkeypatch.setenv("LOOPCAL_THREADS", "2")


LOOKS = 500
"""Looks at a process that should end, 0.02 s apart."""


def ended(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"


def waited(pids: Iterator[int]) -> bool:
    left = list(pids)
    for _ in range(LOOKS):
        left = [pid for pid in left if not ended(pid)]
        if not left:
            break
        time.sleep(0.02)
    return not left


def test_no_piece_is_taken_twice_however_short_pieces_are() -> None:
    for _ in range(3):
        with Forked(4).crew(pow, 1) as outcomes:
            numbers = [one.number for one in outcomes(range(5_000))]
        assert sorted(numbers) == [*range(5_000)]


def test_pieces_are_done_by_this_process_and_by_copies_that_end_with_the_work() -> None:
    where = gathered(Forked(3), pieces.done_where, None, range(9))
    assert len(set(where)) == 3
    assert os.getpid() in where
    for pid in set(where) - {os.getpid()}:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)


def test_pieces_of_a_copy_that_was_killed_are_done_here() -> None:
    found = gathered(Forked(3), pieces.killing_others, os.getpid(), range(8))
    assert found == [(piece, os.getpid()) for piece in range(8)]


def test_what_cannot_be_sent_is_done_here() -> None:
    assert [one() for one in gathered(Forked(2), pieces.unsendable, None, range(4))] == [0, 1, 2, 3]


def test_what_a_copy_was_given_comes_back_as_itself() -> None:
    shared = {"known": (1.0, 2.0)}
    own = [(float(i),) for i in range(6)]
    found = gathered(Forked(2), pieces.given_back, shared, own)
    assert len({pid for *_, pid in found}) == 2
    for (known, (piece, new), _), its in zip(found, own, strict=True):
        assert known is shared["known"]
        assert piece is its
        assert new == 0.5


def test_warnings_of_copies_are_told() -> None:
    with pytest.warns(RuntimeWarning) as told:
        gathered(Forked(2), pieces.warning, None, range(4))
    assert {str(one.message) for one in told} == {f"piece {i}" for i in range(4)}


def test_no_copy_makes_copies(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LOOPCAL_THREADS", "2")
    found = gathered(Forked(2), pieces.workers_within, None, range(6))
    assert {(words, helps) for words, helps, pid in found if pid == os.getpid()} == {
        ("InProcess()", False)
    }
    assert {(words, helps) for words, helps, pid in found if pid != os.getpid()} == {
        ("InProcess()", True)
    }


def test_a_process_with_threads_that_may_hold_a_lock_is_not_forked(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    main, other = threading.main_thread(), threading.Thread()
    own_threads_are(monkeypatch, [main])
    assert process_cores() == Forked(2)
    own_threads_are(monkeypatch, [main, other])
    assert process_cores() == Threads(2)
    with waits_only(other):
        assert process_cores() == Forked(2)
    assert process_cores() == Threads(2)
    monkeypatch.setenv("LOOPCAL_THREADS", "1")
    assert process_cores() == InProcess()


@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGKILL])
def test_no_copy_outlives_a_process_that_is_interrupted_or_killed(sent: signal.Signals) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", HEARS + SLEEPS],
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as process:
        assert process.stdout is not None
        pids = {int(process.stdout.readline()) for _ in range(3)}
        assert len(pids) == 3
        process.send_signal(sent)
        process.wait(HEARD)
        assert process.returncode == -sent
        assert waited(iter(pids - {process.pid}))


def test_the_choice_is_the_same_whatever_number_of_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    arm = planar_arm(30)
    sds = {"xP": 1e-4, "yP": 1e-4, "phi2": 1e-3, "phi3": 1e-3}
    data = arm.read(sds, seed=3)
    found = []
    for count in ("1", "3"):
        own_threads_are(monkeypatch, [threading.main_thread()])
        monkeypatch.setenv("LOOPCAL_THREADS", count)
        told: list[int] = []
        result = lc.calibrate(
            arm.truth,
            data,
            noise=lc.Noise(sds),
            method="auto",
            progress=lambda iteration, *_, told=told: told.append(iteration),
        )
        assert told
        assert result.verdict is not None
        found.append(result)
    one, other = found
    assert one.document.chosen == other.document.chosen
    assert one.document.validation == other.document.validation
    assert one.verdict == other.verdict
    np.testing.assert_array_equal(one.covariance, other.covariance)
    assert dict(one.value) == dict(other.value)
