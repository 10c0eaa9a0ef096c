"""When it pays to share work out: here, by threads, by processes, on a local Dask cluster.

Two workers each, for validations of ten folds over the number of poses (six-axis arm), and for a
study over the number of draws. Whoever does the work, the values must be equal to the bit, and are
compared before a time is told.

    python benchmarks/sharing.py [--poses N ...] [--draws N ...] [--rounds N] [--document]

`--document` writes the tables into docs/how-to/clusters.md.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from resource import RUSAGE_CHILDREN, RUSAGE_SELF, getrusage
from statistics import median
from typing import Any

import numpy as np
from machine import this_machine
from problems import six_axis
from tables import write_into

from loopcal import Cluster, Processes, Threads, calibrate, validate
from loopcal.companions.studies.run import run_study
from loopcal.execution.executor import Executor, InProcess

WORKERS = 2
DOCUMENT = Path(__file__).parent.parent / "docs" / "how-to" / "clusters.md"
STUDY = Path(__file__).parent.parent / "examples" / "seed" / "study.toml"


def main() -> None:
    """Measure, print, and write where asked."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--poses", type=int, nargs="+", default=[100, 1_000, 10_000])
    parser.add_argument("--draws", type=int, nargs="+", default=[10, 100])
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--document", action="store_true")
    asked = parser.parse_args()
    texts = [f"Measured {this_machine()}."]
    with local_cluster() as cluster:
        who = {
            "in process": InProcess(),
            f"{WORKERS} threads": Threads(WORKERS),
            f"{WORKERS} processes": Processes(WORKERS),
            f"cluster of {WORKERS}": Cluster(cluster.address),
        }

        def measured(work: Callable[[Executor], Any]) -> list[str]:
            return in_turns(who, work, asked.rounds, cluster)

        rows = [
            [f"validation, 10 folds of {poses:,} poses", *measured(folds(poses))]
            for poses in asked.poses
        ]
        rows += [
            [f"study, {draws:,} draws of each scenario", *measured(study(draws))]
            for draws in asked.draws
        ]
    lines = [["work", *who], ["---", *["---:"] * len(who)], *rows]
    texts.append("\n".join(f"| {' | '.join(line)} |" for line in lines))
    print("\n\n".join(texts))
    if asked.document:
        write_into(DOCUMENT, "measured", "\n\n".join(texts))


def in_turns(
    who: dict[str, Executor], work: Callable[[Executor], Any], rounds: int, cluster: LocalCluster
) -> list[str]:
    """Of each executor the median seconds, and in brackets those of all its processors together."""
    times: dict[str, list[float]] = {name: [] for name in who}
    processors: dict[str, list[float]] = {name: [] for name in who}
    values: list[Any] = []
    for _ in range(rounds):
        for name, executor in who.items():
            begun, used = time.perf_counter(), cluster.processor_time()
            values.append(work(executor))
            times[name].append(time.perf_counter() - begun)
            processors[name].append(cluster.processor_time() - used)
    assert all(np.array_equal(value, values[0]) for value in values), "the values differ"
    return [f"{median(times[name]):.2f} ({median(processors[name]):.2f})" for name in who]


def folds(poses: int) -> Callable[[Executor], Any]:
    """A validation of so many poses; the fit of all is not part of it."""
    problem = six_axis(poses)
    data, noise = problem.dataset, problem.noise
    full = calibrate(problem.mechanism, data, noise=noise, method="implicit-loop")

    def work(executor: Executor) -> Any:
        found = validate(
            problem.mechanism,
            data,
            noise=noise,
            full=full,
            executor=executor,
            method="implicit-loop",
        )
        return found.distances

    return work


def study(draws: int) -> Callable[[Executor], Any]:
    """The seed's scenarios, so many draws of each."""

    def work(executor: Executor) -> Any:
        with tempfile.TemporaryDirectory() as folder:
            done = run_study(STUDY, draws=draws, executor=executor, out=Path(folder) / "out")
        return done.text

    return work


class LocalCluster:
    """A scheduler and so many workers of one thread, processes of their own."""

    def __init__(self, folder: str) -> None:
        from distributed import Client

        file = Path(folder) / "scheduler.json"
        plain = ["--no-dashboard", "--scheduler-file", str(file)]
        alone = ["--no-nanny", "--nthreads", "1", "--local-directory", folder]
        self.processes = [_dask("dask_scheduler", "--host", "127.0.0.1", "--port", "0", *plain)]
        self.processes += [_dask("dask_worker", *alone, *plain) for _ in range(WORKERS)]
        while not file.exists():
            time.sleep(0.05)
        with Client(scheduler_file=str(file), set_as_default=False) as client:
            client.wait_for_workers(WORKERS)
            self.address: str = client.scheduler.address

    def processor_time(self) -> float:
        """Seconds used so far by this process, those it started and waited for, and the cluster."""
        from psutil import Process

        ours, ended = (getrusage(who) for who in (RUSAGE_SELF, RUSAGE_CHILDREN))
        theirs = [Process(process.pid).cpu_times() for process in self.processes]
        return float(
            sum(used.ru_utime + used.ru_stime for used in (ours, ended))
            + sum(used.user + used.system for used in theirs)
        )


@contextmanager
def local_cluster() -> Iterator[LocalCluster]:
    """A local cluster, ended at the end."""
    with tempfile.TemporaryDirectory() as folder:
        started = LocalCluster(folder)
        try:
            yield started
        finally:
            for process in started.processes:
                process.kill()
                process.wait()


def _dask(program: str, *arguments: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-m", f"distributed.cli.{program}", *arguments],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


if __name__ == "__main__":
    main()
