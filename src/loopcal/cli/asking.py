"""Questions on a terminal, and the page at the end; neither where no person looks."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from loopcal.cli.output import print_error
from loopcal.errors import InputError


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
