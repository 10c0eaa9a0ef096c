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
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from typing import Any, TextIO

from loopcal.errors import LONGEST_TEXT, Unfinished, short

_STEERING = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\xad\u061c\u180e\u200b\u200e\u200f\u2028-\u202e\u2060-\u206f"
    "\ufeff\ufff9-\ufffb\U000e0000-\U000e007f\ud800-\udfff]"
)


def escaped(text: str) -> str:
    """The text with what steers a terminal shown as escapes; line breaks and tabs stay.

    >>> print(escaped("arm\\x1b[2J\\u202e.toml"))
    arm\\x1b[2J\\u202e.toml
    """
    return _STEERING.sub(lambda match: match[0].encode("unicode_escape").decode(), text)


def shown(text: str) -> str:
    """Text for people: escaped, and lines of bounded length, whatever names they hold."""
    return escaped("\n".join(short(line, LONGEST_TEXT) for line in text.split("\n")))


def print_out(text: str) -> None:
    """Print text for people to stdout."""
    _print(shown(text))


SCREEN = 40
"""Lines that a terminal shows at once."""
_ABOVE = ContextVar("above", default=0)
"""Lines that stand on the same screen already."""
_JUDGED = 2
"""Parts of a result that are always shown: what it is, and its verdict."""
_NEEDED = ("accuracy", "board's place")
"""Parts that come right after these, fit or not, ahead of causes and warnings."""

# Chosen, not derived.
_ROWS = 10
"""Rows of a long table that are shown at least."""


@contextmanager
def below(text: str) -> Iterator[None]:
    """Print text; what is printed within this shares its screen."""
    print_out(f"{text}\n")
    token = _ABOVE.set(text.count("\n") + 2)
    try:
        yield
    finally:
        _ABOVE.reset(token)


def screen(text: str, following: int = 0) -> str:
    """What fits on one screen of a text whose parts are apart by an empty line.

    The verdict comes first, then the accuracy, then the other parts in their order. One that does
    not fit any more is left out, and named by its first words in the last line; of a table that
    is as long as a screen the first rows are kept. following: lines printed below it.
    """
    room = SCREEN - _ABOVE.get() - following
    if text.count("\n") < room:
        return text
    kept, left, room = list[str](), list[str](), room - 2
    parts = text.split("\n\n")
    parts[_JUDGED:] = sorted(parts[_JUDGED:], key=lambda part: _name(part) not in _NEEDED)
    for part in parts:
        lines = part.split("\n")
        if len(lines) + 1 > room and _name(part) in _NEEDED:  # those of instruments are indented
            of_all = [line for line in lines if not line.startswith("  ")]
            left += [f"{_name(part)} of each instrument"] if len(of_all) < len(lines) else []
            lines = of_all
        elif len(lines) + 1 > room and len(kept) >= _JUDGED:
            left.append(_name(part))
            continue
        elif len(lines) + 1 > room and kept and "  " in lines[0]:  # a verdict is whole
            rows = max(room - 1, _ROWS)
            left.append(f"{len(lines) - rows} more rows of {_name(part)}")
            lines = lines[:rows]
        kept.append("\n".join(lines))
        room -= len(lines) + 1
    if not left:
        return text
    return "\n\n".join([*kept, f"(not shown: {', '.join(dict.fromkeys(left))}; all: --full)"])


def _name(part: str) -> str:
    """The first words of a part."""
    head = part.partition("\n")[0]
    name = head.split("  ")[0] if "  " in head else head.split(" ")[0].rstrip(":")
    return "warnings" if name == "WARNING" else name


def print_data(text: str) -> None:
    """Print a table to stdout: as it is, for programs to read, but escaped on a terminal."""
    _print(escaped(text) if sys.stdout.isatty() else text)


def _print(text: str) -> None:
    """Print to stdout, now; quietly to nobody where its reader has gone.

    Raises Unfinished where it cannot be written (a full disk): files are written by then.
    """
    if isinstance(sys.stdout, io.TextIOWrapper):
        # a terminal that knows no µ shall not stop a result
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        print(text)
        # Now: as the process ends, a full disk would show too late for an exit code.
        sys.stdout.flush()
    except OSError as error:
        unprinted(error)


def unprinted(error: OSError) -> None:
    """Go on in silence where stdout has no reader; Unfinished where it cannot be written."""
    silence(sys.stdout)
    if not isinstance(error, BrokenPipeError):
        raise Unfinished(
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

    # JSON's escapes are ASCII, which every stream can hold.
    utf8 = (getattr(sys.stdout, "encoding", None) or "").lower().startswith("utf")
    text = json.dumps(plain(document), indent=1, ensure_ascii=not utf8, allow_nan=False)
    _print(_STEERING.sub(lambda match: json.dumps(match[0])[1:-1], text))


def print_done(
    done: Any, as_json: bool, *, text: str = "", where: str = "", full: bool = True
) -> None:
    """Print what a command made: its document as JSON, or a text, by default its own, for people.

    where: the files that were written, on stderr beside JSON and below a text; full: all of the
    text, else what fits on one screen.
    """
    if as_json:
        document = getattr(done, "document", done)
        print_json(document() if callable(document) else document)
        if where:
            log(where)
    else:
        text = text or str(done)
        text = text if full else screen(text, 2 if where else 0)
        print_out(f"{text}\n\n{where}" if where else text)


def log(line: str) -> None:
    """Print a line to stderr, under the command's name."""
    print_error(f"loopcal: {line}")


def print_error(text: str) -> None:
    """Print text to stderr; drop it where that cannot be written."""
    try:
        print(shown(text), file=sys.stderr, flush=True)
    except OSError:
        silence(sys.stderr)


def silence(stream: TextIO) -> None:
    """Nothing more shall be written to a stream, not even when the process ends."""
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def open_streams() -> None:
    """Give this process the standard streams that its caller closed: they lead nowhere.

    The next file that is opened would get their numbers, and whatever a library prints.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            # The system gives the lowest free number, mostly that of the closed stream.
            handle = os.open(os.devnull, os.O_RDWR)
            if handle != number:
                os.dup2(handle, number)
                os.close(handle)
            mode = "r" if number == 0 else "w"
            setattr(sys, name, open(number, mode, encoding="utf-8", closefd=False))  # noqa: SIM115
