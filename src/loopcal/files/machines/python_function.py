"""A user's own Python, named on the command line as FILE.py:NAME: loops f(x, p), or a mechanism."""

from __future__ import annotations

import inspect
import sys
import traceback
from collections.abc import Callable, Iterable
from functools import wraps
from pathlib import Path
from typing import Any

from loopcal.errors import InputError, LoopcalError, nearest
from loopcal.files.tables.raw import existing_file
from loopcal.mechanisms.mechanism import Mechanism

Loops = Callable[..., Iterable[Any]]
"""A function f(x, p) of loop equations."""


def load_function(named: str) -> Loops | Mechanism:
    """What FILE.py:NAME stands for: loops f(x, p), a Mechanism, or what a NAME() without
    arguments returns.

    The file is run, as naming it asks for, with its folder importable as `python FILE.py` has
    it. Raises InputError, with file and line, where it cannot be run or has no such name; the
    function returned does so when it fails.
    """
    file, colon, name = named.rpartition(":")
    if not colon or not file or not name.isidentifier():
        raise InputError(
            f"{named!r} does not name a function",
            code="unknown-name",
            remedy="write FILE.py:FUNCTION, as arm.py:loops",
        )
    path = existing_file(file)
    namespace = _run(path)
    if name not in namespace:
        own = [key for key, value in namespace.items() if callable(value) and key[0] != "_"]
        raise InputError(
            f"the file defines no {name!r}",
            code="unknown-name",
            place=str(path),
            remedy=nearest(name, own),
        )
    found = namespace[name]
    if callable(found):
        found = _explained(found, path)
        if not inspect.signature(found).parameters:
            found = found()
    if not callable(found) and not isinstance(found, Mechanism):
        raise InputError(
            f"{name!r} is {type(found).__name__}, neither loops f(x, p) nor a Mechanism",
            code="wrong-file-type",
            place=str(path),
            remedy="name a function of x and p that returns the values of the loop equations",
        )
    result: Loops | Mechanism = found
    return result


def _run(path: Path) -> dict[str, Any]:
    namespace: dict[str, Any] = {"__name__": path.stem, "__file__": str(path)}
    sys.path.insert(0, str(path.resolve().parent))
    try:
        exec(compile(path.read_bytes(), str(path), "exec"), namespace)
    except LoopcalError as error:
        raise error.at(str(path)) from None
    except Exception as error:
        raise _failure(error, path) from None
    finally:
        sys.path.pop(0)
    return namespace


def _explained(function: Loops, path: Path) -> Loops:
    """The same function; what it raises is told as a mistake in the user's file."""

    @wraps(function)
    def explained(*arguments: Any) -> Any:
        try:
            return function(*arguments)
        except LoopcalError:
            raise
        except Exception as error:
            raise _failure(error, path) from None

    return explained


def _failure(error: Exception, path: Path) -> InputError:
    """What went wrong in a user's file, at which of its lines."""
    line = error.lineno if isinstance(error, SyntaxError) else None
    for frame in traceback.extract_tb(error.__traceback__):
        if frame.filename == str(path):
            line = frame.lineno
    what = error.msg if isinstance(error, SyntaxError) else str(error)
    return InputError(
        f"{type(error).__name__}: {what}",
        code="failing-function",
        place=f"{path}, line {line}" if line else str(path),
        remedy="correct the file",
    )
