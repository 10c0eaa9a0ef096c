"""Work for executors to do, in a module that workers can import."""

from __future__ import annotations

import os
import signal
import time
import warnings
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_info

from loopcal.errors import InputError
from loopcal.estimation.solve.scratch import one_blas_thread
from loopcal.execution.executor import Crew, Done, Executor, done
from loopcal.execution.forked import helping, process_cores
from loopcal.expressions.choice import use_threads


@dataclass(frozen=True)
class Backwards(Executor):
    """Does the last piece first."""

    @contextmanager
    def crew(self, work: Callable[[Any, Any], Any], shared: Any) -> Generator[Crew, None, None]:
        def backwards(pieces: Sequence[Any]) -> Generator[Done[Any], None, None]:
            for number in reversed(range(len(pieces))):
                yield done(work, shared, pieces[number], number)

        yield backwards


def scaled(shared: float, piece: float) -> float:
    return shared * piece


def total(shared: np.ndarray[Any, Any], piece: int) -> float:
    return float(shared.sum()) + piece


def odd_refused(shared: str, piece: int) -> int:
    """Later pieces fail sooner."""
    if piece % 2:
        raise InputError(f"{piece} is odd", place=shared)
    return piece


def faulty(shared: None, piece: int) -> int:
    raise ZeroDivisionError(str(piece))


def killing(first: int, piece: int) -> int:
    """Pieces from the first of them on kill their worker."""
    if piece >= first:
        os.kill(os.getpid(), signal.SIGKILL)
    return piece


def killing_once(folder: str, piece: int) -> int:
    """Begun pieces leave a mark; the third kills its worker the first time."""
    mark = Path(folder) / f"{piece} begun"
    if piece == 3 and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    mark.touch()
    return 10 * piece


def blas_threads(shared: None, piece: int) -> int:
    with one_blas_thread():
        return max(pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas")


def engine_threads(shared: None, piece: int) -> int:
    return use_threads()


def noted(begun: list[int], piece: int) -> int:
    begun.append(piece)
    return piece


def killing_others(own: int, piece: int) -> tuple[int, int]:
    """Pieces kill every worker but one; where each was done."""
    time.sleep(0.05)  # so that nobody takes all pieces
    if os.getpid() != own:
        os.kill(os.getpid(), signal.SIGKILL)
    return piece, os.getpid()


def done_where(shared: object, piece: int) -> int:
    time.sleep(0.05)
    return os.getpid()


def given_back(shared: Any, piece: Any) -> Any:
    time.sleep(0.05)
    return shared["known"], [piece, 0.5], os.getpid()


def warning(shared: object, piece: int) -> int:
    time.sleep(0.05)
    warnings.warn(f"piece {piece}", RuntimeWarning, stacklevel=1)
    return piece


def unsendable(shared: object, piece: int) -> Any:
    time.sleep(0.05)
    return lambda: piece


def workers_within(shared: object, piece: int) -> tuple[str, bool, int]:
    time.sleep(0.05)
    return str(process_cores()), helping(), os.getpid()


def sleeping(seconds: float, piece: int) -> int:
    os.write(1, f"{os.getpid()}\n".encode())  # whole lines, whoever writes beside
    time.sleep(seconds)
    return piece
