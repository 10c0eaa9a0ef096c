"""Work on a cluster, by dask.distributed: the user brings the scheduler, we bring the pieces.

What all pieces share is a task of the graph, not scattered data: it is sent once, the workers pass
it on among themselves, and if all that held it are lost the scheduler has it still. The graph is
made of functions of the standard library and of bytes, which no worker unpacks before its own
piece: what has no loopcal, or another one, can pass it on, and says so when its turn comes.
"""

from __future__ import annotations

import logging
import operator
import pickle
import warnings
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import version
from platform import python_version
from types import ModuleType
from typing import Any
from uuid import uuid4

from loopcal.errors import InputError, UsageError
from loopcal.execution.executor import Done, Executor, Piece, Shared, Value, done

PACKAGES = ("loopcal", "numpy", "scipy")
"""What the numbers depend on."""


@dataclass(frozen=True)
class Cluster(Executor):
    """Workers of a Dask cluster.

    address: of its scheduler, such as "tcp://host:8786", or a cluster object of Dask's. A worker
    that is lost costs the pieces it was doing, which others do again.
    """

    address: Any

    def run(
        self, work: Callable[[Shared, Piece], Value], shared: Shared, pieces: Sequence[Piece]
    ) -> Generator[Done[Value], None, None]:
        """What became of every piece, in the order of completion.

        Raises UsageError without the extra `cluster`, InputError where no scheduler answers, it is
        lost, a worker has not our versions, or one piece ended several workers.
        """
        sealed = pickle.dumps((work, shared, pieces))
        with self._client() as client:
            yield from _outcomes(client, sealed, len(pieces))

    def ready(self) -> str:
        """How many workers there are, all of them having our versions."""
        with self._client() as client:
            found = client.get_versions(packages=[*PACKAGES])
            for address, worker in found["workers"].items():
                packages = dict(worker["packages"])
                packages["python"] = _minor(packages["python"])
                _check(packages, versions(), f"the worker {address}")
            threads = sum(client.nthreads().values())
            return (
                f"{len(found['workers'])} workers with {threads} threads at {self._name}"
                if threads
                else f"no worker yet at {self._name}: the work waits for the first"
            )

    @property
    def _name(self) -> str:
        return str(getattr(self.address, "scheduler_address", self.address))

    @contextmanager
    def _client(self) -> Generator[Any, None, None]:
        log = logging.getLogger("distributed.client")
        level = log.level
        client = _connected(self.address, self._name)
        log.setLevel(logging.CRITICAL)  # that the scheduler was lost is for us to say
        try:
            yield client
        finally:
            client.close()
            log.setLevel(level)


def versions() -> dict[str, str]:
    """Versions of Python and of all that the numbers depend on, here."""
    return {"python": _minor(python_version()), **_installed()}


@lru_cache(maxsize=1)
def _installed() -> Mapping[str, str]:
    return {name: version(name) for name in PACKAGES}


def _minor(python: str) -> str:
    return ".".join(python.split(".")[:2])


def _check(there: Mapping[str, str | None], here: Mapping[str, str], who: str) -> None:
    """The same versions give the same numbers; others may not even understand each other."""
    missing = [name for name in here if there.get(name) is None]
    if missing:
        raise InputError(f"{who} has no {', '.join(missing)}", remedy=_REMEDY)
    other = [name for name in here if there[name] != here[name]]
    if other:
        raise InputError(
            f"{who} has "
            + ", ".join(f"{name} {there[name]}" for name in other)
            + ", and here is "
            + ", ".join(f"{name} {here[name]}" for name in other),
            remedy=_REMEDY,
        )


_REMEDY = "give workers and this process the same environment (versions of " + ", ".join(PACKAGES)
_REMEDY += " and Python)"


@dataclass(frozen=True)
class _Opening:
    """Opens a sealed job at a worker of the same versions, and does a piece of it."""

    made_by: Mapping[str, str]

    def __call__(self, sealed: bytes, number: int) -> Done[Any]:
        try:
            _check(versions(), self.made_by, "a worker")
        except InputError as error:
            return Done(number, error)
        work, shared, pieces = pickle.loads(sealed)
        return done(work, shared, pieces[number], number)


def _distributed() -> ModuleType:
    try:
        import distributed
    except ImportError:
        raise UsageError(
            "work on a cluster needs dask.distributed, which is not installed",
            remedy="pip install 'loopcal[cluster]'",
        ) from None
    module: ModuleType = distributed
    return module


def _connected(address: Any, name: str) -> Any:
    """A client of the scheduler; a wrong address is found first, for a client waits long for it."""
    distributed = _distributed()
    try:
        if isinstance(address, str):
            address = distributed.comm.resolve_address(address)
            secret = distributed.Security().get_connection_args("client")["ssl_context"]
            if address.startswith(("tls:", "wss:")) and secret is None:
                raise ValueError("Dask's configuration names no certificate for the client")
        with warnings.catch_warnings():
            # versions are compared in `_check`, those that matter
            warnings.simplefilter("ignore", distributed.versions.VersionMismatchWarning)
            return distributed.Client(address, set_as_default=False)
    except OSError as error:
        raise InputError(
            f"no scheduler answers ({error})",
            place=name,
            remedy="start one (dask scheduler), or give the address that it states",
        ) from None
    except (ValueError, ImportError) as error:
        raise UsageError(
            f"there is no way to this scheduler: {error}",
            place=name,
            remedy="give the address that it states, such as tcp://host:8786",
        ) from None


def _outcomes(client: Any, sealed: bytes, count: int) -> Generator[Done[Any], None, None]:
    distributed = _distributed()
    name = f"loopcal-{uuid4().hex}"
    job = f"{name}-job"
    opening = (pickle.loads, pickle.dumps(_Opening(versions())))
    # keys of one group are spread over all workers, not kept where the job is
    graph: dict[Any, Any] = {(name, n): (operator.call, opening, job, n) for n in range(count)}
    graph[job] = (bytes, bytearray(sealed))  # Dask takes long over bytes
    with warnings.catch_warnings():
        # it is sent once, and kept where no lost worker can take it along
        warnings.filterwarnings("ignore", "Sending large graph", UserWarning)
        futures = client.get(graph, [*graph][:count], sync=False)
    for future in distributed.as_completed(futures, loop=client.loop):
        try:
            outcome: Done[Any] = future.result()
        except Exception as error:
            raise _failure(error) from None
        future.release()
        yield outcome


def _failure(error: BaseException) -> BaseException:
    """What it means that a piece has no outcome."""
    distributed = _distributed()
    if isinstance(error, distributed.KilledWorker):
        return InputError(
            f"a piece of the work ended all of the {error.allowed_failures + 1} workers that "
            "tried it, killed or out of memory",
            remedy="give the workers more memory, or fewer threads each; a study goes on where "
            "it was",
        )
    if isinstance(error, ModuleNotFoundError) and str(error.name).startswith("loopcal"):
        return InputError("a worker has no loopcal of this version", remedy=_REMEDY)
    if isinstance(error, CancelledError | OSError):
        return InputError(
            "the connection to the scheduler was lost",
            remedy="see whether it still runs, and begin again; a study goes on where it was",
        )
    return error
