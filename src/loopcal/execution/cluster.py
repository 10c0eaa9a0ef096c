"""Work on a cluster, by dask.distributed: the user brings the scheduler, we bring the pieces.

What all pieces share is a task of its own, not scattered data: it is sent once, the workers pass
it on among themselves, and if all that held it are lost the scheduler has it still. Tasks are
made of functions of the standard library and of bytes, which no worker unpacks before its own
piece: what has no loopcal, or another one, can pass it on, and says so when its turn comes.
"""

from __future__ import annotations

import logging
import operator
import pickle
import warnings
from collections.abc import Generator, Mapping, Sequence
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
from loopcal.execution.executor import (
    Crew,
    Done,
    Executor,
    Window,
    Work,
    counted,
    done,
)
from loopcal.expressions.choice import chosen_engine, engine_threads

PACKAGES = ("loopcal", "numpy", "scipy")
"""What the numbers depend on, beside Python and the engine."""


@dataclass(frozen=True)
class Cluster(Executor):
    """Workers of a Dask cluster.

    address: of its scheduler, such as "tcp://host:8786", or a cluster object of Dask's. A worker
    that is lost costs the pieces it was doing, which others do again.
    """

    address: Any

    @contextmanager
    def crew(self, work: Work, shared: Any) -> Generator[Crew, None, None]:
        """The workers of the cluster, also those that come later.

        Raises UsageError without the extra `cluster`, InputError where no scheduler answers; runs
        raise it where that is lost, a worker has not our versions, or a piece ended several.
        """
        sealed = pickle.dumps((work, shared))
        with self._client() as client:
            job = _Job.sent(client, sealed)
            yield job.outcomes

    def ready(self) -> str:
        """How many workers there are, all of them having our versions."""
        with self._client() as client:
            report = client.get_versions(packages=[*PACKAGES])
            for address, worker in report["workers"].items():
                packages = dict(worker["packages"])
                packages["python"] = _minor(packages["python"])
                _check(packages, _installed(), f"the worker {address}")
            for address, worker_versions in client.run(versions).items():
                _check(worker_versions, versions(), f"the worker {address}")
            threads = sum(client.nthreads().values())
            return (
                f"{counted(len(report['workers']), 'worker')} with {counted(threads, 'thread')} "
                f"at {self.name}"
                if threads
                else f"waiting for the first worker at {self.name}"
            )

    @property
    def name(self) -> str:
        """The scheduler's address."""
        return str(getattr(self.address, "scheduler_address", self.address))

    @contextmanager
    def _client(self) -> Generator[Any, None, None]:
        log = logging.getLogger("distributed.client")
        level = log.level
        client = _connected(self.address, self.name)
        log.setLevel(logging.CRITICAL)  # that the scheduler was lost is for us to say
        try:
            yield client
        finally:
            _close(client)
            log.setLevel(level)


def _close(client: Any) -> None:
    """Close a client, also one that was about to connect to a scheduler that is gone.

    Dask ends such a connection in two places; where both do, its close raises, and a second close
    meets no connection any more.
    """
    try:
        client.close()
    except RuntimeError:
        client.close()


def versions() -> dict[str, str]:
    """Versions of Python and of all that the numbers depend on, and the engine, here."""
    return {**_installed(), "engine": chosen_engine()}


@lru_cache(maxsize=1)
def _installed() -> Mapping[str, str]:
    return {"python": _minor(python_version()), **{name: version(name) for name in PACKAGES}}


def _minor(python: str) -> str:
    return ".".join(python.split(".")[:2])


def _check(remote: Mapping[str, str | None], local: Mapping[str, str], who: str) -> None:
    """The same versions give the same numbers; others may not even understand each other."""
    missing = [name for name in local if remote.get(name) is None]
    if missing:
        raise InputError(
            f"{who} has no {', '.join(missing)}", code="version-mismatch", remedy=_REMEDY
        )
    other = [name for name in local if remote[name] != local[name]]
    if other:
        raise InputError(
            f"{who} has "
            + ", ".join(f"{name} {remote[name]}" for name in other)
            + ", and here is "
            + ", ".join(f"{name} {local[name]}" for name in other),
            code="version-mismatch",
            remedy=_ENGINE if other == ["engine"] else _REMEDY,
        )


_REMEDY = "give workers and this process the same environment (versions of " + ", ".join(PACKAGES)
_REMEDY += " and Python)"
_ENGINE = "engines agree to about twelve digits only: set LOOPCAL_ENGINE=numpy here and for all "
_ENGINE += "workers, or install loopcal with a compiler on all of them"


@dataclass(frozen=True)
class _Opening:
    """Opens a sealed job at a worker of the same versions, and does a piece of it."""

    made_by: Mapping[str, str]

    def __call__(self, sealed: bytes, piece: bytes, number: int) -> Done[Any]:
        try:
            _check(versions(), self.made_by, "a worker")
        except InputError as error:
            return Done(number, error)
        work, shared = _opened(sealed)
        with engine_threads(1):  # a worker has as many pieces at a time as it has threads
            return done(work, shared, pickle.loads(piece), number)


@lru_cache(maxsize=1)
def _opened(sealed: bytes) -> Any:
    """What was sealed, unpacked once for all pieces that a worker does of a job."""
    return pickle.loads(sealed)


def _distributed() -> ModuleType:
    try:
        import distributed
    except ImportError:
        raise UsageError(
            "--cluster needs dask.distributed, which is not installed",
            code="missing-dependency",
            remedy="pip install 'loopcal[cluster]'",
        ).then("pip install 'loopcal[cluster]'") from None
    logging.getLogger("tornado.application").addFilter(_worth_logging)
    module: ModuleType = distributed
    return module


def _worth_logging(record: logging.LogRecord) -> bool:
    """Not the NameError of `distributed.utils.sync`, where Ctrl-C comes before its first step."""
    error = record.exc_info[1] if record.exc_info else None
    return not isinstance(error, NameError)


def _connected(address: Any, name: str) -> Any:
    """A client of the scheduler; a wrong address is found first, where a client would wait."""
    distributed = _distributed()
    try:
        if isinstance(address, str):
            address = distributed.comm.resolve_address(address)
            how = distributed.Security().get_connection_args("client")
            if address.startswith(("tls:", "wss:")) and how["ssl_context"] is None:
                raise ValueError("Dask's configuration names no certificate for the client")
            distributed.utils.LoopRunner().run_sync(_meet, address, how)
        with warnings.catch_warnings():
            # versions are compared in `_check`, those that matter
            warnings.simplefilter("ignore", distributed.versions.VersionMismatchWarning)
            return distributed.Client(address, set_as_default=False)
    except OSError as error:
        raise InputError(
            f"no scheduler answers ({error})",
            code="no-scheduler",
            place=name,
            remedy="start one (dask scheduler), or give the address it prints",
        ) from None
    except (ValueError, ImportError) as error:
        raise UsageError(
            f"this scheduler cannot be reached: {error}",
            code="no-scheduler",
            place=name,
            remedy="give the address it prints, such as tcp://host:8786",
        ) from None


async def _meet(address: str, how: Mapping[str, Any]) -> None:
    """Whether who answers is a scheduler; Dask itself waits for a greeting for ever.

    Raises OSError where nobody answers, InputError where it is no scheduler.
    """
    import asyncio

    from dask import config, utils

    distributed = _distributed()

    async def identity() -> Mapping[str, Any]:
        comm = await distributed.comm.connect(address, **how)
        try:
            reply: Mapping[str, Any] = await distributed.core.send_recv(
                comm, op="identity", n_workers=0
            )
        finally:
            comm.abort()
        return reply

    patience = utils.parse_timedelta(config.get("distributed.comm.timeouts.connect"))
    try:
        # Dask tries for so long to reach anybody, and says in its own words that nobody is there
        scheduler = "workers" in await asyncio.wait_for(identity(), patience + 1.0)
    except Exception as error:  # words of another protocol can mean anything, and be any error
        if isinstance(error, OSError) and not isinstance(error, TimeoutError):
            raise
        scheduler = False
    if not scheduler:
        raise InputError(
            "the program at this address is not a Dask scheduler",
            code="no-scheduler",
            place=address,
            remedy="give the scheduler's address; its port is usually 8786 (8787 is the dashboard)",
        )


@dataclass(frozen=True)
class _Job:
    """A job that is with the cluster, as long as this is kept."""

    client: Any
    name: str
    sealed: Any

    @classmethod
    def sent(cls, client: Any, sealed: bytes) -> _Job:
        name = f"loopcal-{uuid4().hex}"
        (future,) = _begun(client, {f"{name}-job": (bytes, bytearray(sealed))})  # slow over bytes
        return cls(client, name, future)

    def outcomes(self, pieces: Sequence[Any]) -> Generator[Done[Any], None, None]:
        """What became of every piece, in the order of completion."""
        window = Window(len(pieces))
        waiting = _distributed().as_completed(loop=self.client.loop)
        run = uuid4().hex
        try:
            while True:
                if self.client.status != "running":  # the next line would wait for it
                    raise ConnectionError
                workers = sum(self.client.nthreads().values())
                waiting.update(self._begun(run, pieces, window.next(max(workers, 1))))
                if waiting.is_empty():
                    return
                for future in waiting.next_batch():
                    outcome: Done[Any] = future.result()
                    future.release()
                    window.take(outcome.number)
                    yield outcome
        except Exception as error:
            raise _failure(error) from None

    def _begun(self, run: str, pieces: Sequence[Any], numbers: Sequence[int]) -> list[Any]:
        # keys of one group are spread over all workers, not kept where the job is
        opening = (pickle.loads, pickle.dumps(_Opening(versions())))
        return _begun(
            self.client,
            {
                (f"{self.name}-{run}", n): (
                    operator.call,
                    opening,
                    self.sealed,
                    (bytes, bytearray(pickle.dumps(pieces[n]))),
                    n,
                )
                for n in numbers
            },
        )


def _begun(client: Any, graph: dict[Any, Any]) -> list[Any]:
    """The futures of all tasks of a graph."""
    if not graph:
        return []
    with warnings.catch_warnings():
        # it is sent once, and kept where no lost worker can take it along
        warnings.filterwarnings("ignore", "Sending large graph", UserWarning)
        futures: list[Any] = client.get(graph, [*graph], sync=False)
    return futures


def _failure(error: BaseException) -> BaseException:
    """What it means that a piece has no outcome."""
    distributed = _distributed()
    if isinstance(error, distributed.KilledWorker):
        return InputError(
            f"a task ended all {error.allowed_failures + 1} workers that tried it: killed or "
            f"out of memory",
            code="worker-lost",
            remedy="give the workers more memory or fewer threads; a study or stream resumes",
        )
    if isinstance(error, ModuleNotFoundError) and str(error.name).startswith("loopcal"):
        return InputError(
            "a worker has another version of loopcal, or none",
            code="version-mismatch",
            remedy=_REMEDY,
        )
    if isinstance(error, CancelledError | OSError):
        return InputError(
            "the connection to the scheduler was lost",
            code="no-scheduler",
            remedy="check that the scheduler runs, then repeat the command; a study or stream "
            "resumes",
        )
    return error
