"""Tables of the documentation that are made of the rows of a registry.

A table stands between `<!-- MARK -->` and `<!-- end -->`. After a change that is meant, make it
again and read `git diff`:

    LOOPCAL_REMAKE_GOLDEN=1 python -m pytest tests/test_registries.py
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

DOCS = Path(__file__).resolve().parents[1] / "docs"


def markdown(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table as Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def block_of(mark: str) -> re.Pattern[str]:
    """The block of a mark; one that is still empty ends at its own end, not at the next one's."""
    return re.compile(rf"<!-- {mark} -->\n(?:(.*?)\n)??<!-- end -->", re.S)


def check_block(page: str, mark: str, text: str) -> None:
    """Compare the block of a page with a text, or write it where asked to."""
    path = DOCS / page
    content, block = path.read_text("utf-8"), block_of(mark)
    marks = f"<!-- {mark} --> and <!-- end -->"
    assert len(block.findall(content)) == 1, f"docs/{page}: add the lines {marks} where it belongs"
    if os.environ.get("LOOPCAL_REMAKE_GOLDEN"):
        content = block.sub(lambda _: f"<!-- {mark} -->\n{text}\n<!-- end -->", content)
        path.write_text(content, "utf-8")
    remake = f"LOOPCAL_REMAKE_GOLDEN=1 writes the table between {marks} of docs/{page}"
    assert block.findall(content) == [text], remake
