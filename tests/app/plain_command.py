"""A command that prints, waits, dies or fails: what a worker runs in tests."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Sequence
from pathlib import Path


def command(words: Sequence[str]) -> int:
    """The first word says what happens."""
    match words[0]:
        case "print":
            print(*words[1:])
            print("where", os.getcwd(), file=sys.stderr)
        case "wait":
            print("waiting", flush=True)
            try:
                threading.Event().wait(600)
            finally:
                Path("undone").write_text("yes")
        case "die":
            os.kill(os.getpid(), signal.SIGKILL)
        case "fail":
            return 3
    return 0
