"""Functions that read files by others' code, run in a child process with limits.

A reader in a compiled library that meets a damaged file may abort its process, take all memory or
never end. Here that ends the child, and the caller gets `Stopped`. The child starts with the
first call, stays warm for the next ones and ends with this process. Arguments go in as JSON and
results come back as bytes, so that nothing of a file is executed on the way.
"""

from __future__ import annotations

import atexit
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Generator, Mapping
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path
from typing import Any, BinaryIO

from loopcal import errors
from loopcal.import_path import without_folder

# Why a child, and why these limits: docs/decisions/0137.
MEMORY, MEMORY_PER_BYTE = 1 << 30, 64
"""Bytes that any call may allocate, or else those per byte of its file."""
SECONDS, BYTES_PER_SECOND, PATIENCE = 20, 1_000_000, 10
"""Seconds of computing that any call may take, or else bytes of its file per second; and times as
long until it ends on a busy machine."""


_OVERTIME = getattr(signal, "SIGXCPU", 0)
"""What ends a process that computes for longer than its limit."""


class Stopped(Exception):
    """The function did not come to an end; the text says why."""


def guarded(function: str, arguments: Mapping[str, Any], size: int) -> bytes:
    """What a function "module:name" returns (bytes) for arguments that JSON can hold.

    size: [bytes] of the file it reads; memory and time of large ones are limited in proportion.
    The limit of memory needs Linux, that of computing time a system like it. Raises the function's
    own LoopcalError, and Stopped where it raised another error, its process ended, or a limit was
    reached.
    """
    memory = max(MEMORY, MEMORY_PER_BYTE * size)
    seconds = max(SECONDS, size // BYTES_PER_SECOND)
    request = {"function": function, "arguments": dict(arguments), "memory": memory}
    answer = _CHILDREN.ask(json.dumps({**request, "seconds": seconds}).encode(), seconds)
    if answer[:1] == b"v":
        return answer[1:]
    error_fields = json.loads(answer[1:])
    kind = getattr(errors, error_fields.pop("kind"), None)
    if kind is None:
        raise Stopped(error_fields["message"])
    stated = {key: error_fields.pop(key) for key in ("message", "code", "place", "remedy")}
    error = kind(stated.pop("message"), **stated)
    for name, value in error_fields.items():  # what follows from it, where something does
        setattr(error, name, tuple(value) if isinstance(value, list) else value)
    raise error


class _Children:
    """The child of this process; another one after it has ended."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.child: subprocess.Popen[bytes] | None = None
        self.parent = 0

    def ask(self, request: bytes, seconds: float) -> bytes:
        """The child's answer. Raises Stopped where it gives none in that time of computing."""
        # One request at a time: an answer does not state which request it belongs to.
        with self.lock:
            child = self._running()
            late = threading.Event()

            def stop() -> None:
                late.set()
                child.kill()

            timer = threading.Timer(PATIENCE * seconds, stop)
            timer.daemon = True
            timer.start()
            try:
                _send(child.stdin, request)
                answer = _received(child.stdout)
            except (OSError, EOFError):
                code = self._end(kill=True)
                raise Stopped(
                    f"reading it takes longer than {seconds:g} s"
                    if late.is_set() or code == -_OVERTIME
                    else "the program that reads it crashes"
                ) from None
            except BaseException:
                self._end(kill=True)
                raise
            finally:
                timer.cancel()
            return answer

    def _running(self) -> subprocess.Popen[bytes]:
        if self.parent != os.getpid():  # a fork has its parent's child, which is not its own
            self.child, self.parent = None, os.getpid()
        if self.child is None or self.child.poll() is not None:
            path = without_folder(sys.path)
            start = f"import sys; sys.path[:] = {path!r}; from {__name__} import serve; serve()"
            # -P: no module of the user's folder shadows an installed one.
            self.child = subprocess.Popen(
                [sys.executable, "-P", "-c", start],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
            )
        return self.child

    def end(self) -> None:
        """Let the child end, if there is one."""
        if self.parent == os.getpid():
            self._end(kill=False)

    def _end(self, *, kill: bool) -> int | None:
        """How the child ended, by itself or by this."""
        child, self.child = self.child, None
        if child is not None:
            if kill:
                with suppress(subprocess.TimeoutExpired):
                    child.wait(0.2)  # it may be about to end by itself, which says why
                child.kill()
            for pipe in (child.stdin, child.stdout):
                with suppress(OSError):
                    assert pipe is not None
                    pipe.close()
            return child.wait()
        return None


_CHILDREN = _Children()
atexit.register(_CHILDREN.end)


def serve() -> None:
    """Answer requests on standard input until it ends; this is what the child does."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # an interrupt is the parent's business
    requests, answers = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints is no answer
    _leave_no_core()
    while True:
        try:
            request = json.loads(_received(requests))
        except EOFError:
            return
        _send(answers, _answer(**request))


def _answer(function: str, arguments: dict[str, Any], memory: int, seconds: float) -> bytes:
    module, name = function.split(":")
    called = getattr(import_module(module), name)
    try:
        _at_most_seconds(seconds)
        with _at_most(memory):
            return b"v" + bytes(called(**arguments))
    except errors.LoopcalError as error:
        error_fields = vars(error)
        return b"e" + json.dumps({"kind": type(error).__name__, **error_fields}).encode()
    except MemoryError:
        message = f"reading it takes more than {memory / 1e9:.1f} GB of memory"
    except BaseException as error:  # a panic of a library in Rust is no Exception
        message = (str(error).strip().splitlines() or [type(error).__name__])[0]
    return b"e" + json.dumps({"kind": "", "message": errors.short(message, 300)}).encode()


def _at_most_seconds(seconds: float) -> None:
    """From now on at most so many seconds of computing, or the process ends."""
    with suppress(ImportError, ValueError, OSError):
        import resource

        _, most = resource.getrlimit(resource.RLIMIT_CPU)
        # RLIMIT_CPU counts from the start of the process, which has answered other requests before.
        until = int(time.process_time() + seconds) + 1
        if most != resource.RLIM_INFINITY:
            until = min(until, most)
        resource.setrlimit(resource.RLIMIT_CPU, (until, most))


@contextmanager
def _at_most(memory: int) -> Generator[None, None, None]:
    """At most so many bytes are allocated inside; where the system cannot tell, any number."""
    statm = Path("/proc/self/statm")
    if not statm.exists():
        yield
        return
    import resource

    # RLIMIT_DATA counts memory in use too: field six of statm, data and stack in pages.
    used = int(statm.read_text().split()[5]) * resource.getpagesize()
    before = resource.getrlimit(resource.RLIMIT_DATA)
    most = used + memory
    if before[1] != resource.RLIM_INFINITY:
        most = min(most, before[1])
    resource.setrlimit(resource.RLIMIT_DATA, (most, before[1]))
    # A library may unfold a compressed file beside it; what it writes has the same bound.
    written = resource.getrlimit(resource.RLIMIT_FSIZE)
    if written[1] == resource.RLIM_INFINITY:
        resource.setrlimit(resource.RLIMIT_FSIZE, (memory, written[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, before)
        resource.setrlimit(resource.RLIMIT_FSIZE, written)


def _leave_no_core() -> None:
    with suppress(ImportError, ValueError, OSError):
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _send(stream: BinaryIO | Any, content: bytes) -> None:
    stream.write(len(content).to_bytes(8, "little"))
    stream.write(content)
    stream.flush()


def _received(stream: BinaryIO | Any) -> bytes:
    """A message; EOFError where the stream ends before it does."""
    head = stream.read(8)
    content: bytes = stream.read(int.from_bytes(head, "little")) if len(head) == 8 else b""
    if len(head) < 8 or len(content) < int.from_bytes(head, "little"):
        raise EOFError
    return content
