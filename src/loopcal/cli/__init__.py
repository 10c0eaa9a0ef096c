"""The command `loopcal`: arguments in, printed text and an exit code out."""

from __future__ import annotations

import atexit
import gc
import os
import sys
from collections.abc import Sequence

from loopcal.import_path import leave_folder

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `loopcal ARGUMENTS` (`loopcal.cli.run`), which may be interrupted while it is loaded."""
    if arguments is None:
        leave_folder()
    # Looking for plugins of pydantic reads a file of every installed package; loopcal uses none.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    # What is loaded stays, and a calibration leaves no reference cycles: collecting garbage as
    # often as usual takes a tenth of a short run and finds none.
    gc.set_threshold(300_000)
    # As the process ends, Python looks for cycles among all that was loaded, several times: a tenth
    # of a short run as well. What is frozen is left to the system.
    atexit.register(gc.freeze)
    try:
        from loopcal.cli import run

        return run.main(arguments)
    except KeyboardInterrupt:
        print("loopcal: interrupted", file=sys.stderr)
        return 130
