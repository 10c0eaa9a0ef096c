"""Who does the work of a command: the options --workers and --cluster."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

from loopcal.cli.output import log
from loopcal.errors import InputError, UsageError
from loopcal.execution.cluster import Cluster
from loopcal.execution.executor import Executor


def executor_of(
    workers: int | None, cluster: str | None, local: Callable[[int], Executor]
) -> Executor | None:
    """The executor that the options ask for, None where they ask for none; a cluster is tried.

    local: what kind the workers of this machine are.

    Raises UsageError for both options, or where a cluster cannot be used at all, InputError where
    it is not there.
    """
    if cluster is None:
        return None if workers is None else local(workers)
    if workers is not None:
        raise UsageError(
            "--workers counts those of this machine, and with --cluster the work is elsewhere",
            remedy="give one of the two",
        )
    executor = Cluster(_stated(cluster) if cluster.endswith(".json") else cluster)
    log(executor.ready())
    return executor


def _stated(path: str) -> str:
    """The address in the file that a scheduler writes for its clients."""
    try:
        return str(json.loads(Path(path).read_text("utf-8"))["address"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        reason = getattr(error, "strerror", None) or "it states no address"
        raise InputError(
            f"this is no file of a scheduler ({reason})",
            place=path,
            remedy="give the one of dask scheduler --scheduler-file FILE, or tcp://HOST:PORT",
        ) from None
