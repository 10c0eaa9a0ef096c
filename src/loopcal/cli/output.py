"""The one place that prints: data on stdout, all else on stderr.

Names and arguments come from files of others. Characters that steer a terminal or reorder text
(control characters, marks of writing direction) are shown escaped, as \\x1b or \\u202e.
"""

from __future__ import annotations

import io
import json
import os
import re
import sys
from contextlib import suppress
from typing import Any

from loopcal.errors import InputError

_STEERING = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\xad\u061c\u180e\u200b\u200e\u200f\u2028-\u202e\u2060-\u206f"
    "\ufeff\ufff9-\ufffb\U000e0000-\U000e007f\ud800-\udfff]"
)


def escaped(text: str) -> str:
    """The text with what steers a terminal shown as escapes; line breaks and tabs stay.

    >>> print(escaped("arm\\x1b[2J\\u202e.toml"))
    arm\\x1b[2J\\u202e.toml
    """
    return _STEERING.sub(lambda found: found[0].encode("unicode_escape").decode(), text)


def print_out(text: str) -> None:
    """Print text for people to stdout."""
    _print(escaped(text))


def print_data(text: str) -> None:
    """Print a table to stdout: as it is, for programs to read, but escaped on a terminal."""
    _print(escaped(text) if sys.stdout.isatty() else text)


def _print(text: str) -> None:
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
            code="unwritable-file",
            place="standard output",
            remedy="redirect the output to another place",
        ) from None


def print_json(document: Any) -> None:
    """Print typed values or plain data as exactly one JSON document.

    What steers a terminal is in JSON's own escapes.
    """
    from loopcal.document.plain import plain

    utf8 = (getattr(sys.stdout, "encoding", None) or "").lower().startswith("utf")
    text = json.dumps(plain(document), indent=1, ensure_ascii=not utf8, allow_nan=False)
    _print(_STEERING.sub(lambda found: json.dumps(found[0])[1:-1], text))


def log(line: str) -> None:
    """Print a line to stderr, under the command's name."""
    print_error(f"loopcal: {line}")


def print_error(text: str) -> None:
    """Print text to stderr."""
    print(escaped(text), file=sys.stderr)


def silence_stdout() -> None:
    """Nothing more shall be written to stdout, not even when the process ends."""
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
