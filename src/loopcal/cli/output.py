"""What the command prints: data on stdout, all else on stderr, whoever reads them."""

from __future__ import annotations

import io
import json
import os
import sys
from contextlib import suppress
from typing import Any

from loopcal.errors import InputError


def print_out(text: str) -> None:
    """Print to stdout, now; quietly to nobody where its reader has gone.

    Raises InputError where it cannot be written (a full disk).
    """
    if isinstance(sys.stdout, io.TextIOWrapper):
        # a terminal that knows no µ shall not stop a result
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        print(text)
        sys.stdout.flush()
    except BrokenPipeError:
        silence_stdout()
    except OSError as error:
        silence_stdout()
        raise InputError(
            f"cannot be written: {error.strerror or error}",
            place="standard output",
            remedy="send it somewhere else",
        ) from None


def print_json(document: Any) -> None:
    """Print exactly one JSON document."""
    utf8 = (getattr(sys.stdout, "encoding", None) or "").lower().startswith("utf")
    print_out(json.dumps(document, indent=1, ensure_ascii=not utf8, allow_nan=False))


def log(line: str) -> None:
    """Print a line to stderr, under the command's name."""
    print(f"loopcal: {line}", file=sys.stderr)


def silence_stdout() -> None:
    """Nothing more shall be written to stdout, not even when the process ends."""
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
