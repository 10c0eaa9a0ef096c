"""Work on the cores of this process by copies of it, which have what they work with already.

A forked copy begins at once, with every tape and engine that is made. Only what became of a piece
is sent, and of it only what is new: what the copy was given comes back as itself. Whoever is free
takes the next piece, this process as well. A piece whose copy is lost is done here.
"""

from __future__ import annotations

import gc
import io
import os
import pickle
import signal
import sys
import threading
import warnings
from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from types import FunctionType, ModuleType
from typing import Any, Never

from loopcal.execution.executor import (
    Crew,
    Done,
    Executor,
    InProcess,
    Work,
    counted,
    done,
)
from loopcal.execution.local import Threads
from loopcal.expressions.choice import engine_threads, use_threads

_LEAVES = (str, bytes, int, float, complex, type, FunctionType, ModuleType, type(None))
_LONGEST = 1_000
"""Longer sequences are sent whole: they are data, not objects that others refer to."""
_SIZE = 8
"""Bytes ahead of each outcome that state its size."""
_SIGNALS = {signal.SIGINT, signal.SIGTERM}
_role = threading.local()


def process_cores() -> Executor:
    """Who shares work among the cores of this process; this process where only one is its own.

    Forked copies where that is safe: on Linux, where no other Python thread may hold a lock that
    the copy would wait for. Elsewhere threads, which run Python one at a time.
    """
    count = use_threads()
    if count == 1 or getattr(_role, "works", False):
        return InProcess()
    return Forked(count) if _safe() else Threads(count)


def helping() -> bool:
    """Whether this is a forked copy: whatever else it changes or tells than its value is lost."""
    return getattr(_role, "helps", False)


@contextmanager
def waits_only(thread: threading.Thread) -> Generator[None, None, None]:
    """Fork although this thread lives: it waits for an event, and holds nothing meanwhile."""
    _WAITING.add(thread)
    try:
        yield
    finally:
        _WAITING.discard(thread)


_WAITING = set[threading.Thread]()


def _safe() -> bool:
    busy = [one for one in threading.enumerate() if one not in _WAITING]
    return sys.platform == "linux" and busy == [threading.main_thread()]


@dataclass(frozen=True)
class Forked(Executor):
    """This process and forked copies of it, so many in all.

    >>> from loopcal.execution.executor import gathered
    >>> gathered(Forked(2), pow, 2, range(5))
    [1, 2, 4, 8, 16]
    """

    workers: int

    @contextmanager
    def crew(self, work: Work, shared: Any) -> Generator[Crew, None, None]:
        """Copies that are made for each run, and end with it."""

        def outcomes(pieces: Sequence[Any]) -> Generator[Done[Any], None, None]:
            return _outcomes(work, shared, pieces, self.workers)

        yield outcomes

    def ready(self) -> str:
        """Where pieces will be done."""
        return counted(self.workers, "forked process")


@dataclass
class _Copy:
    """A forked copy of this process; results: the file that it writes to, read: bytes so far."""

    pid: int
    results: int
    read: int = 0

    def written(self, common: Mapping[int, object]) -> Generator[Done[Any], None, None]:
        """What it has written whole since."""
        end = os.fstat(self.results).st_size
        while self.read + _SIZE < end:
            # The copy shares the place in this file and writes on there; read() would move it.
            begin = self.read + _SIZE
            size = int.from_bytes(os.pread(self.results, _SIZE, self.read), "little")
            if begin + size > end:
                return
            self.read = begin + size
            content = io.BytesIO(os.pread(self.results, size, begin))
            outcome, messages = _Reader(content, common).load()
            for message, category, name, line in messages:
                warnings.warn_explicit(message, category, name, line)
            yield outcome

    def end(self) -> None:
        """End it, whatever it does."""
        with suppress(ProcessLookupError):
            os.kill(self.pid, signal.SIGKILL)
        with suppress(ChildProcessError):
            os.waitpid(self.pid, 0)
        os.close(self.results)


@dataclass
class _Copies:
    """Forked copies at work, which have the work, what it is done with, and the pieces.

    common: what comes back as itself; queue: a file whose place, which all copies share, is the
    number of the next piece; alive: a pipe that is closed where this process ends.
    """

    work: Work
    shared: Any
    pieces: Sequence[Any]
    common: Mapping[int, object]
    queue: int = field(default_factory=lambda: os.memfd_create("loopcal"))
    alive: tuple[int, int] = field(default_factory=os.pipe)
    begun: list[_Copy] = field(default_factory=list)

    def next(self) -> int | None:
        """The number of the next piece; None where all are taken."""
        import fcntl  # not on every system

        # Of two that move the place of such a file at once, both may read the same.
        fcntl.lockf(self.queue, fcntl.LOCK_EX)
        try:
            number = os.lseek(self.queue, 1, os.SEEK_CUR) - 1
        finally:
            fcntl.lockf(self.queue, fcntl.LOCK_UN)
        return number if number < len(self.pieces) else None

    def done(self, number: int) -> Done[Any]:
        """Do one piece on one core."""
        _role.works = True
        try:
            with engine_threads(1):
                return done(self.work, self.shared, self.pieces[number], number)
        finally:
            _role.works = False

    def begin(self, count: int) -> None:
        """Fork so many copies, or fewer where the system gives no more."""
        for _ in range(count):
            heard = signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)  # until the copy is known
            try:
                results = os.memfd_create("loopcal")
                try:
                    pid = _fork()
                except OSError:
                    os.close(results)
                    break
                if pid == 0:
                    self._work(results, heard)
                self.begun.append(_Copy(pid, results))
            finally:
                signal.pthread_sigmask(signal.SIG_SETMASK, heard)

    def _work(self, results: int, signals: set[int]) -> Never:
        """In a copy: do pieces until there are none, and end without a word to anybody else."""
        try:
            signal.signal(signal.SIGINT, signal.SIG_IGN)  # this is its parent's business
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
            signal.pthread_sigmask(signal.SIG_SETMASK, signals)
            os.close(self.alive[1])
            threading.Thread(target=_end_with, args=(self.alive[0],), daemon=True).start()
            gc.freeze()  # to look through what was there before would copy it page by page
            _role.helps = True
            with warnings.catch_warnings(record=True) as heard:
                while (number := self.next()) is not None:
                    heard.clear()
                    outcome = self.done(number)
                    messages = [
                        (one.message, one.category, one.filename, one.lineno) for one in heard
                    ]
                    sent = _pickled((outcome, messages), self.common)
                    _write(results, len(sent).to_bytes(_SIZE, "little") + sent)
            # exit() would flush buffers and run handlers that belong to the parent.
            os._exit(0)
        finally:
            os._exit(1)  # what it was doing is done by its parent, who tells what is wrong with it

    def finished(self, *, wait: bool) -> Generator[Done[Any], None, None]:
        """What they have done since; wait: until all of them have ended."""
        for one in self.begun:
            if wait:  # and leave its number to it, so that `end` kills no other process
                os.waitid(os.P_PID, one.pid, os.WEXITED | os.WNOWAIT)
            yield from one.written(self.common)

    def end(self) -> None:
        """End all of them."""
        for one in self.begun:
            one.end()
        for file in (*self.alive, self.queue):
            os.close(file)


def _outcomes(
    work: Work, shared: Any, pieces: Sequence[Any], workers: int
) -> Generator[Done[Any], None, None]:
    """What became of every piece, in the order of completion."""
    count = len(pieces)
    missing = dict.fromkeys(range(count))
    helpers = min(workers, count) - 1
    common = _within(shared, pieces) if helpers > 0 else {}
    copies = _Copies(work, shared, pieces, common)
    try:
        number = copies.next()  # the first piece is done here
        copies.begin(helpers)
        while number is not None:
            outcome = copies.done(number)
            del missing[number]
            yield outcome
            number = copies.next()
            for outcome in copies.finished(wait=False):
                del missing[outcome.number]
                yield outcome
        for outcome in copies.finished(wait=True):
            del missing[outcome.number]
            yield outcome
    finally:
        copies.end()
    for number in missing:
        yield copies.done(number)


def _fork() -> int:
    with warnings.catch_warnings():
        # From 3.12 on Python warns of threads that it does not know, such as those of engines:
        # a copy has none of them, and uses none.
        warnings.simplefilter("ignore", DeprecationWarning)
        return os.fork()


def _end_with(parent: int) -> None:
    """The parent's end of the pipe is closed when the parent has ended."""
    os.read(parent, 1)
    os._exit(1)


def _write(file: int, content: bytes) -> None:
    rest = memoryview(content)
    while rest:
        rest = rest[os.write(file, rest) :]


def _within(*roots: object) -> dict[int, object]:
    """All objects that others are made of, by identity, but for lists and dictionaries, which a
    copy may have filled."""
    objects: dict[int, object] = {}
    waiting = list(roots)
    while waiting:
        one = waiting.pop()
        if id(one) in objects or isinstance(one, _LEAVES):
            continue
        objects[id(one)] = one
        if isinstance(one, tuple | list | frozenset | set | Mapping):
            if len(one) <= _LONGEST:
                waiting += one.values() if isinstance(one, Mapping) else one
        else:
            waiting += getattr(one, "__dict__", {}).values()
    return {number: one for number, one in objects.items() if not isinstance(one, list | dict)}


def _pickled(value: object, common: Mapping[int, object]) -> bytes:
    class Writer(pickle.Pickler):
        def persistent_id(self, one: object) -> int | None:
            return id(one) if id(one) in common else None

    written = io.BytesIO()
    Writer(written, pickle.HIGHEST_PROTOCOL).dump(value)
    return written.getvalue()


class _Reader(pickle.Unpickler):
    """Reads what a copy has written; what both knew before is that again."""

    def __init__(self, file: io.BytesIO, common: Mapping[int, object]) -> None:
        super().__init__(file)
        self._common = common

    def persistent_load(self, identity: int) -> object:
        """The object that the copy meant."""
        return self._common[identity]
