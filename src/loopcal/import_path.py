"""Where Python looks for modules: never in the working directory.

A folder of readings may hold a `numpy.py` that its user did not write. Python itself would run it
for `python -m`, and for every process that is started by a line of code.
"""

import os
import sys
from collections.abc import Generator, Iterable
from contextlib import contextmanager

SAFE = "PYTHONSAFEPATH"
"""Environment variable by which Python leaves the working directory out."""


def leave_folder() -> None:
    """Let neither this process nor any that it starts import from the working directory."""
    os.environ[SAFE] = "1"
    if "PYTHONPATH" in os.environ:
        stated = os.environ["PYTHONPATH"].split(os.pathsep)
        os.environ["PYTHONPATH"] = os.pathsep.join(without_folder(stated))
    sys.path[:] = without_folder(sys.path)


def without_folder(path: Iterable[str]) -> list[str]:
    """Entries of a path but the working directory, unless loopcal or Python lie there."""
    folder = os.path.realpath(os.curdir)
    # A checkout of loopcal is where its user works; that folder must stay importable.
    installed = {os.path.dirname(os.path.dirname(os.path.realpath(__file__)))}
    installed.add(os.path.dirname(os.path.realpath(os.__file__)))
    return [entry for entry in path if folder in installed or os.path.realpath(entry) != folder]


@contextmanager
def elsewhere() -> Generator[None, None, None]:
    """Processes started inside do not begin with the working directory."""
    before = os.environ.get(SAFE)
    os.environ[SAFE] = "1"
    try:
        yield
    finally:
        if before is None:
            os.environ.pop(SAFE, None)
        else:
            os.environ[SAFE] = before


def _begins() -> bool:
    """Whether `python -m loopcal` begins to load."""
    words = sys.orig_argv
    return sys.argv[:1] == ["-m"] and words[words.index("-m") + 1 :][:1] == ["loopcal"]


if "-m" in sys.orig_argv and _begins():
    leave_folder()
