"""Who does the work of a command: the options --workers and --cluster."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from loopcal.cli.output import log
from loopcal.errors import InputError, UsageError

if TYPE_CHECKING:
    from loopcal.execution.executor import Executor


def executor_of(
    workers: int | None, cluster: str | None, *, waiting: Callable[[], None] | None = None
) -> Executor | None:
    """The executor that the options ask for, None where they ask for none.

    waiting: workers of this machine are threads, which tell by it that they are waited for;
    without it processes.

    Raises UsageError for both options or an empty one, InputError for a file that states no
    scheduler.
    """
    if workers is None and cluster is None:
        return None
    from loopcal.execution.cluster import Cluster
    from loopcal.execution.local import Processes, Threads

    if cluster is None:
        assert workers is not None
        return Processes(workers) if waiting is None else Threads(workers, waiting)
    if workers is not None:
        raise UsageError(
            "--workers and --cluster exclude each other: --workers is for this machine only",
            remedy="give only one of them",
        )
    if not cluster.strip():
        raise UsageError(
            "--cluster names no scheduler",
            code="no-scheduler",
            remedy="give its address, such as tcp://host:8786, or the file it writes",
        )
    return Cluster(_stated(cluster) if cluster.endswith(".json") else cluster)


def try_cluster(executor: Executor) -> None:
    """See whether a cluster is there, and say what is waited for and what was found.

    Raises UsageError where it cannot be used at all, InputError where it is not there.
    """
    from loopcal.execution.cluster import Cluster

    if isinstance(executor, Cluster):
        log(f"connecting to {executor.name}")
        log(executor.ready())


def _stated(path: str) -> str:
    """The address in the file that a scheduler writes for its clients."""
    try:
        return str(json.loads(Path(path).read_text("utf-8"))["address"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        reason = getattr(error, "strerror", None) or "it states no address"
        raise InputError(
            f"this is not a scheduler file ({reason})",
            code="wrong-file-type",
            place=path,
            remedy="give the file written by dask scheduler --scheduler-file FILE, or "
            "tcp://HOST:PORT",
        ) from None
