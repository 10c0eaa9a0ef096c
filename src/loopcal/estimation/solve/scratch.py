"""What blocks share: arrays that live from one to the next, and one thread for linear algebra.

Fresh arrays cost more in page faults than a block costs in arithmetic.
"""

from __future__ import annotations

import ctypes
import math
import sys
import threading
from collections.abc import Generator
from contextlib import ExitStack, contextmanager
from functools import cache, lru_cache

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import OpenBLASController, ThreadpoolController

_pool = threading.local()


def scratch(name: str, *shape: int) -> NDArray[np.float64]:
    """An uninitialised array, this thread's own; the next call by the same `name` reuses it."""
    buffers: dict[str, NDArray[np.float64]] = _pool.__dict__
    size = math.prod(shape)
    buffer = buffers.get(name)
    if buffer is None or buffer.size < size:
        buffer = buffers[name] = np.empty(size)
    return buffer[:size].reshape(shape)


@cache
def reuse_memory(megabytes: int) -> None:
    """Let arrays of up to that size take memory that others have left, instead of fresh pages.

    glibc gives an array memory of its own, and takes it back, from a size on that grows to that
    of the largest such array of up to 32 MiB that was freed (mallopt(3), M_MMAP_THRESHOLD); the
    array made here is never touched. The heap keeps up to twice as much. Elsewhere it changes
    nothing.
    """
    np.empty(megabytes * 1_000_000, dtype=np.uint8)


def release_memory() -> None:
    """Give back what is free in the heap, between what is in use too (malloc_trim(3) of glibc).
    Elsewhere it changes nothing."""
    if sys.platform == "linux" and (trim := getattr(ctypes.CDLL(None), "malloc_trim", None)):
        trim(0)


class _Blas:
    """The limit on the threads of linear algebra, which is one for all threads of a process."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.holders = 0
        self.scipy = False
        self.limited = False
        self.limit = ExitStack()

    def hold(self) -> None:
        with self.lock:
            scipy = "scipy.special" in sys.modules or "scipy.linalg" in sys.modules
            if not self.holders or scipy != self.scipy:  # SciPy may come while it is held
                self.scipy = scipy
                blas = _controller(scipy)
                if _threaded(blas):  # to set the limit takes as long as a small block
                    _disown()
                    self.limit.enter_context(blas.limit(limits=1, user_api="blas"))
                    self.limited = True
            self.holders += 1

    def release(self) -> None:
        with self.lock:
            self.holders -= 1
            if self.limited and not self.holders:
                _disown()
                self.limit.close()
                _disown()
                self.limited = False


def _threaded(blas: ThreadpoolController) -> bool:
    """Whether any linear algebra runs on several threads."""
    return any(lib.user_api == "blas" and lib.num_threads != 1 for lib in blas.lib_controllers)


def _disown() -> None:
    """Let this thread lift the limit, whichever set it: threadpoolctl from 3.8 on minds that."""
    clear = getattr(OpenBLASController, "clear_controlling_thread", None)
    if clear is not None:
        clear(force=True)


@lru_cache
def _controller(scipy: bool) -> ThreadpoolController:
    """It knows the libraries loaded when it is made; SciPy brings a BLAS of its own."""
    return ThreadpoolController()


_blas = _Blas()


@contextmanager
def one_blas_thread() -> Generator[None, None, None]:
    """Linear algebra on one thread: two double the processor time of small blocks for no gain.

    Several threads may hold it at once; the last to leave lifts the limit.
    """
    _blas.hold()
    try:
        yield
    finally:
        _blas.release()
