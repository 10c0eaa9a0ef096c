"""A real Dask scheduler and workers, each a process of its own, that tests may kill."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.command_line import environment

ROOT = Path(__file__).resolve().parents[1]
PRELOADS = ROOT / "tests" / "execution" / "preloads"


class DaskCluster:
    """The scheduler's address, and the workers that were started."""

    def __init__(self, folder: Path) -> None:
        self.file = folder / "scheduler.json"
        self.folder = folder
        where = ["--port", "0", "--host", "127.0.0.1", "--scheduler-file", str(self.file)]
        self.scheduler = self._start("dask_scheduler", *where)
        self.workers: list[subprocess.Popen[bytes]] = []
        for line in self.scheduler.stderr or ():
            if b"Scheduler at:" in line:
                self.address = line.split()[-1].decode()
                break
        else:
            pytest.fail("the scheduler did not start")

    def start_workers(self, *preloads: str, **variables: str) -> None:
        """Start one worker for each preload (a file of tests/execution/preloads, or "")."""
        for name in preloads:
            preload = ["--preload", str(PRELOADS / f"{name}.py")] if name else []
            plain = ["--no-nanny", "--nthreads", "1", "--memory-limit", "0"]
            folder = ["--local-directory", str(self.folder)]
            arguments = [self.address, *plain, *folder, *preload]
            self.workers.append(self._start("dask_worker", *arguments, **variables))
        for worker in self.workers[-len(preloads) :]:
            for line in worker.stderr or ():
                if b"Starting established connection" in line:
                    break
            else:
                pytest.fail("a worker did not start")

    def _start(self, program: str, *arguments: str, **variables: str) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            [sys.executable, "-m", f"distributed.cli.{program}", *arguments, "--no-dashboard"],
            env=environment(PYTHONPATH=str(ROOT), OPENBLAS_NUM_THREADS="1", **variables),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
        )

    def end(self) -> None:
        for process in (*self.workers, self.scheduler):
            process.kill()
            process.communicate()


@contextmanager
def dask_cluster(folder: Path, **variables: str) -> Iterator[DaskCluster]:
    """A scheduler without workers; skips where dask.distributed is absent."""
    pytest.importorskip("distributed", reason="distributed is absent; `make partners` installs it")
    # A scheduler calls a worker that has died for so long before it believes it, by default 30 s.
    settings = {"DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT": "3s"}
    # A worker that is to die at its second piece does begin it, however slow it is.
    settings["DASK_DISTRIBUTED__SCHEDULER__WORK_STEALING"] = "False"
    with pytest.MonkeyPatch.context() as patch:
        for name, value in (settings | variables).items():
            patch.setenv(name, value)
        started = DaskCluster(folder)
        try:
            yield started
        finally:
            started.end()
