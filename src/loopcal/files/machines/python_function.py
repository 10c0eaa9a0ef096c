"""A user's own Python, named on the command line as FILE.py:NAME: loops f(x, p), or a mechanism."""

from __future__ import annotations

import inspect
import sys
import traceback
from collections.abc import Callable, Iterable, Iterator
from functools import wraps
from pathlib import Path
from typing import Any

from loopcal.errors import InputError, LoopcalError, unknown_name
from loopcal.files.tables.raw import existing_file
from loopcal.mechanisms.mechanism import Mechanism

Loops = Callable[..., Iterable[Any]]
"""A function f(x, p) of loop equations."""


def load_function(named: str) -> Loops | Mechanism:
    """What FILE.py:NAME stands for: loops f(x, p), a Mechanism, or what a NAME() without
    arguments returns.

    The file is run, as naming it asks for, and may import others of its folder, but none by the
    name of an installed module. Raises InputError, with file and line, where it cannot be run or
    has no such name; the function returned does so when it fails.
    """
    file, colon, name = named.rpartition(":")
    if not colon or not file or not name.isidentifier():
        raise InputError(
            f"{named!r} does not name a function",
            code="unknown-name",
            remedy="write FILE.py:FUNCTION, as arm.py:loops",
        )
    path = existing_file(file, anywhere=True)  # the user named it
    namespace = _run(path)
    if name not in namespace:
        callables = [str(key) for key, value in namespace.items() if callable(value)]
        raise unknown_name(
            f"the file defines no {name!r}",
            name,
            [key for key in callables if key[:1] != "_"],
            str(path),
        )
    definition = namespace[name]
    if callable(definition):
        definition = _explained(definition, path)
        if not _parameters(definition):
            definition = definition()
    if not callable(definition) and not isinstance(definition, Mechanism):
        raise InputError(
            f"{name!r} is {type(definition).__name__}, neither loops f(x, p) nor a Mechanism",
            code="wrong-file-type",
            place=str(path),
            remedy="name a function of x and p that returns the values of the loop equations",
        )
    result: Loops | Mechanism = definition
    return result


def _run(path: Path) -> dict[str, Any]:
    namespace: dict[str, Any] = {"__name__": path.stem, "__file__": str(path)}
    folder = str(path.resolve().parent)
    sys.path.append(folder)  # last: what lies there stands for no installed module
    try:
        exec(compile(path.read_bytes(), str(path), "exec"), namespace)
    except LoopcalError as error:
        raise error.at(str(path)) from None
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # sys.exit() too
        raise _failure(error, path) from None
    finally:
        # By identity: an equal entry of the caller stays.
        sys.path[:] = [entry for entry in sys.path if entry is not folder]
    return namespace


def _explained(function: Loops, path: Path) -> Loops:
    """The same function; what it raises is told as a mistake in the user's file."""

    @wraps(function)
    def explained(*arguments: Any) -> Any:
        try:
            made = function(*arguments)
            # A generator runs as it is read: its errors have to be raised within this try.
            return tuple(made) if isinstance(made, Iterator) else made
        except (LoopcalError, KeyboardInterrupt):
            raise
        except BaseException as error:  # sys.exit() too
            raise _failure(error, path) from None

    return explained


def _parameters(function: Loops) -> int:
    """How many arguments it takes; some where that is not known."""
    try:
        return len(inspect.signature(function).parameters)
    except (TypeError, ValueError):
        return 1


def _failure(error: BaseException, path: Path) -> InputError:
    """What went wrong in a user's file, at which of its lines."""
    line = error.lineno if isinstance(error, SyntaxError) else None
    for frame in traceback.extract_tb(error.__traceback__):
        if frame.filename == str(path):
            line = frame.lineno
    what = error.msg if isinstance(error, SyntaxError) else _said(error)
    return InputError(
        f"{type(error).__name__}: {what}",
        code="failing-function",
        place=f"{path}, line {line}" if line else str(path),
        remedy="correct the file",
    )


def _said(error: BaseException) -> str:
    """The text of an error, whose own code may fail too."""
    try:
        return str(error)
    except KeyboardInterrupt:
        raise
    except BaseException as other:
        return f"its text cannot be made ({type(other).__name__})"
