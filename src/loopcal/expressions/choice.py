"""Which engine runs the tapes, and on how many threads: without loading NumPy.

The compiled engine runs where it was built, else NumPy does. LOOPCAL_ENGINE=numpy or
LOOPCAL_ENGINE=compiled in the environment decides otherwise; LOOPCAL_THREADS is the number of
threads.
"""

from __future__ import annotations

import os
import sys
import threading
import warnings
from collections.abc import Generator
from contextlib import contextmanager
from functools import lru_cache

from loopcal.errors import UsageError, nearest

INTERFACE = 3
"""Which calls the compiled engine understands; engine/module.cpp states the same number.

Raise both with every change of a signature or of what it means."""
try:
    from loopcal.expressions import _compiled
except ImportError:  # installed without a compiler
    AVAILABLE = OUTDATED = False
else:
    OUTDATED = getattr(_compiled, "INTERFACE", None) != INTERFACE
    AVAILABLE = not OUTDATED
REBUILD = "run `make install` in loopcal's folder, or reinstall loopcal"
ENGINES = ("numpy", "compiled")
MOST = 1024
"""Threads of an engine: more than any machine has cores that share a block with gain."""

_held = threading.local()


def chosen_engine() -> str:
    """ "numpy" or "compiled". Warns once if the compiled engine is outdated and NumPy replaces it.

    Raises UsageError where LOOPCAL_ENGINE is neither, or asks for what was not built.
    """
    name = os.environ.get("LOOPCAL_ENGINE")
    if not name:
        if OUTDATED:
            _warn_outdated()
        return "compiled" if AVAILABLE else "numpy"
    if name not in ENGINES:
        raise UsageError(
            f"LOOPCAL_ENGINE is {name!r}", code="unknown-name", remedy=nearest(name, ENGINES)
        )
    if name == "compiled" and OUTDATED:
        raise UsageError(
            "LOOPCAL_ENGINE is 'compiled', but the compiled engine was built from another version "
            "of loopcal's sources",
            code="missing-dependency",
            remedy=f"{REBUILD}, or unset the variable",
        )
    if name == "compiled" and not AVAILABLE:
        raise UsageError(
            "LOOPCAL_ENGINE is 'compiled', but loopcal was installed without the compiled engine",
            code="missing-dependency",
            remedy="install CMake, make and a C++ compiler and reinstall loopcal, or unset the "
            "variable",
        )
    return name


@lru_cache(maxsize=1)
def _warn_outdated() -> None:
    warnings.warn(
        "the compiled engine was built from another version of loopcal's sources; NumPy runs "
        f"instead, which is slower\n  What to do: {REBUILD}",
        RuntimeWarning,
        stacklevel=3,
    )


def in_words() -> str:
    """The engine that runs, with what it makes use of."""
    name, count = chosen_engine(), use_threads()
    if name == "numpy":
        return name
    return f"{name}, {_compiled.width()}, {count} thread{'s' if count > 1 else ''}"


def use_threads() -> int:
    """Let as many threads share a block as LOOPCAL_THREADS says; else all cores that are ours.

    Inside `engine_threads` it is those; a process that shares the cores with its siblings uses one.

    Raises UsageError where LOOPCAL_THREADS is no whole number from 1 to MOST.
    """
    text = os.environ.get("LOOPCAL_THREADS")
    if not text:
        count = getattr(_held, "count", None) or (1 if _among_siblings() else cores())
    elif text.isdecimal() and len(text) < 10 and 0 < int(text) <= MOST:
        count = int(text)
    else:
        raise UsageError(
            f"LOOPCAL_THREADS is {text!r}",
            remedy=f"give a whole number of threads from 1 to {MOST}, or unset the variable",
        )
    if AVAILABLE:
        _compiled.use_threads(count)
    return count


@contextmanager
def engine_threads(count: int) -> Generator[None, None, None]:
    """Engines that this thread makes use so many threads: its share, where others work beside it.

    How many the engine uses is one number for a whole process; it changes no result.
    """
    before = getattr(_held, "count", None)
    _held.count = count
    try:
        yield
    finally:
        _held.count = before


def _among_siblings() -> bool:
    processes = sys.modules.get("multiprocessing.process")
    # Siblings share the cores: threads of each would wait for the others' (see `execution`).
    return processes is not None and processes.parent_process() is not None


@lru_cache(maxsize=1)
def cores() -> int:
    """How many cores this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)  # not everywhere
    return len(affinity(0)) if affinity else os.cpu_count() or 1
