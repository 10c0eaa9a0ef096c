"""Work on a real Dask cluster: the same to the bit, also where a worker is killed in the middle."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

import loopcal as lc
from loopcal.cli.progress import executor_of, try_cluster
from loopcal.companions.studies import run as study_run
from loopcal.companions.studies.run import run_study
from loopcal.errors import Code
from loopcal.execution.cluster import Cluster, _Opening, versions
from loopcal.execution.executor import InProcess, gathered
from loopcal.execution.local import Processes, Threads
from loopcal.expressions import choice
from tests.command_line import environment, run
from tests.dask_cluster import DaskCluster, dask_cluster
from tests.execution import pieces
from tests.reference.simulated import planar_arm
from tests.refusals import refused

SDS = {"xP": 1e-4, "yP": 1e-4, "phi2": 1e-3, "phi3": 1e-3}
STUDY = """schema = 1
draws = 80
seed = 5
[mechanism]
type = "planar-two-link"
[noise]
xPyP = 1e-4
"phi*" = 1e-3
[simulation.ranges]
phi2 = { from = 0, to = 90, step = 30, unit = "deg" }
phi3 = { from = 0, to = 90, step = 30, unit = "deg" }
[[scenarios]]
name = "base"
[[methods]]
method = "implicit-loop"
"""


@pytest.fixture
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DaskCluster]:
    with dask_cluster(tmp_path_factory.mktemp("dask")) as started:
        yield started


@pytest.fixture
def study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(study_run, "CHUNK", 10)
    path = tmp_path / "s.toml"
    path.write_text(STUDY, "utf-8")
    return path


def was_killed(worker: subprocess.Popen[bytes]) -> bool:
    return worker.wait(300) == -signal.SIGKILL


def test_a_killed_worker_costs_nothing_but_its_piece(cluster: DaskCluster, tmp_path: Path) -> None:
    cluster.start_workers("", "")
    executor = Cluster(cluster.address)
    assert executor.ready() == f"2 workers with 2 threads at {cluster.address}"
    told: list[int] = []
    values = gathered(
        executor, pieces.killing_once, str(tmp_path), range(12), lambda n, of: told.append(n)
    )
    assert values == [10 * piece for piece in range(12)]
    assert told == [*range(1, 13)]  # each piece once
    ended = [worker for worker in cluster.workers if worker.poll() is not None]
    assert [was_killed(worker) for worker in ended] == [True]

    # What all pieces share was with the worker that is gone, and is not lost.
    large = np.arange(2e6)
    assert gathered(executor, pieces.total, large, [0, 1]) == [large.sum(), large.sum() + 1]
    with refused("invalid-value", "here: 3"):
        gathered(executor, pieces.odd_refused, "here", [0, 2, 3, 4, 5])
    with pytest.raises(ZeroDivisionError):
        gathered(executor, pieces.faulty, None, [1])


def test_a_study_is_the_same_though_a_worker_is_killed(
    cluster: DaskCluster, study: Path, tmp_path: Path
) -> None:
    cluster.start_workers("", "dying")
    here = run_study(study, executor=InProcess(), out=tmp_path / "here")
    told: list[int] = []
    found = run_study(
        study,
        executor=Cluster(cluster.address),
        out=tmp_path / "there",
        progress=lambda done, of: told.append(done),
    )
    assert was_killed(cluster.workers[1])
    assert found.document == here.document
    assert told == [10 * (i + 1) for i in range(8)]
    assert len(list((tmp_path / "there" / "parts").iterdir())) == 8
    rows = [pl.read_parquet(tmp_path / name / "draws.parquet") for name in ("here", "there")]
    assert rows[0].equals(rows[1])
    assert set(Counter(rows[1]["draw"]).values()) == {1}


def test_validation_and_profiles_are_the_same_though_a_worker_is_killed(
    cluster: DaskCluster,
) -> None:
    arm = planar_arm(30)
    data, noise = arm.read(SDS, seed=3), lc.Noise(SDS)
    cluster.start_workers("", "dying")
    executor = Cluster(cluster.address)
    told: list[int] = []
    how: dict[str, Any] = {"noise": noise, "folds": 10, "method": "implicit-loop"}
    here = lc.validate(arm.truth, data, **how)
    found = lc.validate(
        arm.truth, data, **how, executor=executor, progress=lambda done, of: told.append(done)
    )
    assert was_killed(cluster.workers[1])
    assert told == [*range(1, 11)]
    assert (found.accuracy, found.log_likelihood) == (here.accuracy, here.log_likelihood)
    np.testing.assert_array_equal(found.distances, here.distances)
    np.testing.assert_array_equal(found.by_pose, here.by_pose)
    assert found.poses == here.poses == data.poses

    cluster.start_workers("dying")
    result = lc.calibrate(arm.truth, data, noise=noise, method="implicit-loop")
    assert lc.intervals(result, executor=executor) == lc.intervals(result)
    assert was_killed(cluster.workers[2])


def test_a_piece_that_ends_every_worker_is_a_message(tmp_path: Path) -> None:
    with dask_cluster(tmp_path, DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES="0") as cluster:
        cluster.start_workers("", "")
        with refused("worker-lost", "1 worker"):
            gathered(Cluster(cluster.address), pieces.killing, 0, [1])


def test_an_interrupted_study_keeps_what_was_done(
    cluster: DaskCluster, study: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cluster.start_workers("")
    out = tmp_path / "out"
    study.write_text(STUDY.replace("80", "4000"), "utf-8")
    monkeypatch.undo()  # the command cuts its own parts
    command = [sys.executable, "-m", "loopcal", "study", str(study), "--out", str(out)]
    with subprocess.Popen(
        [*command, "--cluster", str(cluster.file)],
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as interrupted:
        while interrupted.poll() is None and len(list(out.glob("parts/*.parquet"))) < 2:
            time.sleep(0.01)
        interrupted.send_signal(signal.SIGINT)
        _, error = interrupted.communicate()
    assert interrupted.returncode == 130
    connecting, found_there, *_, last = error.decode().splitlines()
    assert connecting == f"loopcal: connecting to {cluster.address}"
    assert found_there == f"loopcal: 1 worker with 1 thread at {cluster.address}"
    assert last == "loopcal: interrupted"
    assert b"Traceback" not in error
    kept = {part: part.stat().st_mtime_ns for part in out.glob("parts/*.parquet")}
    assert 1 <= len(kept) < 80  # another may have been a part of a file
    found = run_study(study, draws=150, executor=Cluster(cluster.address), out=out)
    here = run_study(study, draws=150, executor=InProcess(), out=tmp_path / "here")
    assert found.document == here.document
    assert {part: part.stat().st_mtime_ns for part in kept} == kept  # nothing was done twice


def test_a_lost_scheduler_is_a_message(cluster: DaskCluster, study: Path, tmp_path: Path) -> None:
    cluster.start_workers("")

    def lose(done: int, of: int) -> None:
        cluster.scheduler.kill()

    with refused("no-scheduler", "connection"):
        run_study(study, executor=Cluster(cluster.address), out=tmp_path / "out", progress=lose)


def test_a_scheduler_that_is_gone_is_not_asked(
    cluster: DaskCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Dask would try for half a minute to reach it."""
    from distributed import Client

    cluster.start_workers("")

    def lose(done: int, of: int) -> None:
        cluster.scheduler.kill()
        while any(client.status == "running" for client in Client._instances):
            time.sleep(0.01)
        monkeypatch.delattr(Client, "nthreads")

    with refused("no-scheduler", "connection"):
        gathered(Cluster(cluster.address), pieces.scaled, 1.0, [1.0, 2.0], lose)


def test_a_connection_that_ends_twice_hides_no_error(
    cluster: DaskCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Dask's close raises where a connection is ended that is ending already."""
    from distributed.core import ConnectionPool

    cluster.start_workers("")
    closed = ConnectionPool.close
    calls: list[ConnectionPool] = []

    async def close(pool: ConnectionPool) -> None:
        calls.append(pool)
        if len(calls) == 1:
            raise RuntimeError("Cannot change state of expiring Timeout")
        await closed(pool)

    def lose(done: int, of: int) -> None:
        cluster.scheduler.kill()

    monkeypatch.setattr(ConnectionPool, "close", close)
    with refused("no-scheduler", "connection"):
        gathered(Cluster(cluster.address), pieces.scaled, 1.0, [1.0, 2.0, 3.0], lose)
    assert len(calls) > 1


def test_workers_must_be_as_we_are(cluster: DaskCluster) -> None:
    executor = Cluster(cluster.address)
    assert executor.ready().startswith("waiting for the first worker")
    cluster.start_workers("without_loopcal")
    with refused("version-mismatch", "tcp://", "loopcal"):
        executor.ready()
    with refused("version-mismatch", "loopcal"):
        gathered(executor, pieces.scaled, 1.0, [1.0, 2.0])
    cluster.workers[0].kill()
    cluster.start_workers("other_numpy")
    with refused("version-mismatch", "numpy 1.0.0", f"numpy {np.__version__}"):
        executor.ready()


@pytest.mark.skipif(not choice.AVAILABLE, reason="installed without a compiler")
def test_workers_must_have_our_engine(
    cluster: DaskCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("LOOPCAL_ENGINE", "compiled")
    cluster.start_workers("", LOOPCAL_ENGINE="numpy")
    executor = Cluster(cluster.address)
    with refused("version-mismatch", "engine numpy", "engine compiled") as told:
        executor.ready()
    assert "LOOPCAL_ENGINE=numpy" in str(told.value.remedy)
    with refused("version-mismatch", "engine numpy"):
        gathered(executor, pieces.scaled, 1.0, [1.0])
    monkeypatch.setenv("LOOPCAL_ENGINE", "numpy")
    assert executor.ready().startswith("1 worker ")
    assert gathered(executor, pieces.scaled, 1.0, [1.0]) == [1.0]


@pytest.mark.skipif(not choice.AVAILABLE, reason="installed without a compiler")
def test_a_worker_holds_the_engine_to_one_thread_for_each_piece(
    cluster: DaskCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("LOOPCAL_THREADS", raising=False)
    cluster.start_workers("")
    assert gathered(Cluster(cluster.address), pieces.engine_threads, None, [0, 1]) == [1, 1]


def test_a_worker_that_came_later_is_looked_at_too() -> None:
    opening = _Opening({**versions(), "scipy": "0.1"})
    with refused("version-mismatch", "scipy 0.1"):
        _ = opening(b"no pickle", b"none", 0).value


@pytest.mark.parametrize(
    ("address", "code", "stated"),
    [
        ("foo://host:1", "no-scheduler", "foo://host:1"),
        ("somewhere", "no-scheduler", "somewhere"),
        ("tls://127.0.0.1:1", "no-scheduler", "certificate"),
        (" ", "no-scheduler", "--cluster"),
        ("nowhere.json", "wrong-file-type", "No such file or directory"),
    ],
)
def test_where_no_scheduler_can_be(address: str, code: Code, stated: str) -> None:
    pytest.importorskip("distributed", reason="make partners")

    def tried() -> None:
        executor = executor_of(None, address)
        assert executor is not None
        try_cluster(executor)

    with refused(code, stated) as told:
        tried()
    assert told.value.remedy


@pytest.mark.parametrize("greeting", [b"", b"SSH-2.0-OpenSSH_9.2", b"\x05" + bytes(7) + b"hello"])
def test_who_answers_may_be_no_scheduler(
    greeting: bytes, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("distributed", reason="make partners")
    import dask

    with closing(socket.create_server(("127.0.0.1", 0))) as server:
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"

        def answer() -> None:
            with suppress(OSError):
                client, _ = server.accept()
                with client:
                    client.sendall(greeting)
                    while client.recv(1 << 20):  # until it gives up
                        pass

        answering = threading.Thread(target=answer)
        answering.start()
        with (
            dask.config.set({"distributed.comm.timeouts.connect": "100ms"}),
            refused("no-scheduler", address) as told,
        ):
            try_cluster(Cluster(address))
        answering.join()
    assert "8786" in str(told.value.remedy)
    assert capsys.readouterr().err == f"loopcal: connecting to {address}\n"


def test_a_worker_is_no_scheduler(cluster: DaskCluster) -> None:
    from distributed import Client

    cluster.start_workers("")
    with Client(cluster.address, set_as_default=False) as client:
        (worker,) = client.nthreads()
    with refused("no-scheduler", worker):
        Cluster(worker).ready()


def test_where_no_scheduler_is(study: Path) -> None:
    pytest.importorskip("distributed", reason="make partners")
    impatient = {"DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT": "500ms"}
    done = run("study", study, "--cluster", "127.0.0.1:1", env=impatient)
    assert done.returncode == 3
    connecting, first, remedy, *_ = done.stderr.splitlines()
    assert connecting == "loopcal: connecting to 127.0.0.1:1"
    assert first.startswith("loopcal: 127.0.0.1:1: no scheduler answers")
    assert remedy.startswith("  What to do: start one")
    assert not (study.parent / "s-study").exists()


def test_options_that_do_not_go_together() -> None:
    with refused("invalid-usage", "--workers", "--cluster"):
        executor_of(2, "tcp://127.0.0.1:1")
    assert executor_of(None, None) is None
    assert executor_of(2, None) == Processes(2)
    assert executor_of(2, None, waiting=print) == Threads(2)


def test_without_the_extra_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with refused("missing-dependency", "pip install 'loopcal[cluster]'"):
        Cluster("tcp://127.0.0.1:1").ready()
