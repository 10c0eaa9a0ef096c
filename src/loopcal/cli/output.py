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
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, TextIO

from loopcal.errors import LONGEST_TEXT, InputError, Unfinished, UsageError, short
from loopcal.files.atomic import write_atomic
from loopcal.files.result.deployed import result_path
from loopcal.report.page import report_html
from loopcal.report.source import read_source
from loopcal.workflow.report_sections import sections

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


def print_done(done: Any, as_json: bool, *, text: str = "", where: str = "") -> None:
    """Print what a command made: its document as JSON, or a text, by default its own, for people.

    where: the files that were written, on stderr beside JSON and below a text.
    """
    if as_json:
        document = getattr(done, "document", done)
        print_json(document() if callable(document) else document)
        if where:
            log(where)
    else:
        text = text or str(done)
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


# Questions on a terminal, and the page at the end; neither where no person looks.


def _watched() -> bool:
    # Questions go to stderr, since stdout may lead into a file.
    return sys.stdin.isatty() and sys.stderr.isatty()


def ask_on_terminal() -> Callable[[str, Sequence[str]], int] | None:
    """A function that asks which answer is right; None without a terminal."""
    return _ask if _watched() else None


def _ask(question: str, answers: Sequence[str]) -> int:
    print_error(question)
    for number, answer in enumerate(answers, 1):
        print_error(f"  {number}  {answer}")
    while True:
        print_error(f"Number from 1 to {len(answers)}:")
        line = sys.stdin.readline().strip()
        # A terminal that was closed gives empty lines without end.
        if not line:
            raise InputError(
                "no answer was given", code="unknown-unit", remedy="state the units in the headers"
            )
        if line.isdecimal() and 1 <= int(line) <= len(answers):
            return int(line) - 1


def open_page(path: Path) -> None:
    """Open a page in the browser where a person looks."""
    if _watched() and path.exists():
        import webbrowser

        webbrowser.open(path.resolve().as_uri())


# Reports of results on the disk.


def run_report(results: Sequence[str | Path], out: str | Path | None) -> Path:
    """Write the report of results that `loopcal calibrate` wrote, several side by side.

    out: the file, by default report.html in the folder of the only result. Raises InputError for
    what cannot be read or written, UsageError for several results and no `out`.
    """
    if out is None and len(results) > 1:
        raise UsageError(
            "several results are given, but no file for their report",
            remedy="name it: --out report.html",
        )
    page = report_html([read_source(path) for path in results], sections)
    path = Path(out) if out is not None else result_path(results[0]).with_name("report.html")
    write_atomic(path, page)
    return path
