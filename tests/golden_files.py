"""Texts kept in tests/golden/: what is printed may change on purpose only.

Decimals are kept to three significant digits, and what is only rounding (below 1e-9) as "tiny", so
that another processor or library does not matter. To make the files again after a change that is
meant, look at `git diff` of:

    LOOPCAL_REMAKE_GOLDEN=1 python -m pytest tests/test_golden.py
"""

from __future__ import annotations

import os
import re
from html.parser import HTMLParser
from pathlib import Path

from loopcal.presentation.shown import significant

FOLDER = Path(__file__).parent / "golden"
_NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+(?:e[-+]?\d+)?|e[-+]?\d+)(?![\w.])")
_HASH = re.compile(r"\b[0-9a-f]{64}\b")
_SILENT = {"script", "style", "button"}
_BLOCKS = {"p", "li", "tr", "h1", "h2", "h3", "caption", "div", "figcaption", "pre", "summary"}


def check(name: str, text: str) -> None:
    """Compare a text with the golden file of this name, or make the file where asked to."""
    path = FOLDER / name
    found = normalised(text)
    if os.environ.get("LOOPCAL_REMAKE_GOLDEN"):
        path.write_text(found, "utf-8")
    assert found == path.read_text("utf-8")


def normalised(text: str) -> str:
    """Without versions, hashes, widths of columns, and digits beyond the third."""
    text = _HASH.sub("HASH", text)
    text = re.sub(r"(loopcal|python|numpy) \d[\w.]*", r"\1 VERSION", text)
    text = re.sub(r"written \d{4}-\d\d-\d\d", "written DAY", text)
    lines = (" ".join(line.split()) for line in text.splitlines())
    return "\n".join(_NUMBER.sub(_rounded, line) for line in lines) + "\n"


def _rounded(match: re.Match[str]) -> str:
    value = float(match[0])
    if value and abs(value) < 1e-9:
        return "tiny"
    return ("+" if match[0][0] == "+" else "") + significant(value, 3)


def page_text(html: str) -> str:
    """What a page says: headings, paragraphs, cells, captions, and the words of its figures."""
    reader = _Reader()
    reader.feed(html)
    lines = (" ".join(line.split()) for line in "".join(reader.said).splitlines())
    return "\n".join(line for line in lines if line)


class _Reader(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.said: list[str] = []
        self.silent = 0

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.silent += tag in _SILENT
        if tag in _BLOCKS:
            self.said.append("\n")
        label = dict(attrs).get("aria-label")
        if label:
            self.said.append(f"\nFIGURE {label}\n")

    def handle_endtag(self, tag: str) -> None:
        self.silent -= tag in _SILENT
        self.said.append("\n" if tag in _BLOCKS else " | " if tag in ("td", "th") else "")

    def handle_data(self, data: str) -> None:
        if not self.silent:
            self.said.append(data)
