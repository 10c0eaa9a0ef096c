"""What blocks share: arrays that live from one to the next, and one thread for linear algebra.

Fresh arrays cost more in page faults than a block costs in arithmetic.
"""

from __future__ import annotations

import math
import threading
from contextlib import AbstractContextManager
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

_pool = threading.local()


def scratch(name: str, *shape: int) -> NDArray[np.float64]:
    """An uninitialised array, this thread's own; the next call by the same `name` reuses it."""
    buffers: dict[str, NDArray[np.float64]] = _pool.__dict__
    size = math.prod(shape)
    buffer = buffers.get(name)
    if buffer is None or buffer.size < size:
        buffer = buffers[name] = np.empty(size)
    return buffer[:size].reshape(shape)


@lru_cache(maxsize=1)
def _blas() -> ThreadpoolController:
    return ThreadpoolController()


def one_blas_thread() -> AbstractContextManager[object]:
    """Linear algebra on one thread: two double the processor time of small blocks for no gain."""
    limit: AbstractContextManager[object] = _blas().limit(limits=1, user_api="blas")
    return limit
