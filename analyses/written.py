"""Results written into the documentation, so that no number of theirs is typed by hand."""

from __future__ import annotations

import re
from pathlib import Path


def pattern(name: str) -> re.Pattern[str]:
    """What stands between the marks of a block: <!-- analyses/NAME.py --> to <!-- end -->."""
    begin = re.escape(f"<!-- analyses/{name}.py -->\n\n```text\n")
    return re.compile(f"({begin})(.*?)(```\n\n<!-- end -->)", re.DOTALL)


def read_block(path: Path, name: str) -> str:
    """The text of a block; ValueError where the file has none of this name."""
    found = pattern(name).search(path.read_text("utf-8"))
    if found is None:
        raise ValueError(f"{path} has no block of analyses/{name}.py")
    return found[2]


def write_block(path: Path, name: str, text: str) -> None:
    """Put a text in place of what a block holds."""
    read_block(path, name)
    document = path.read_text("utf-8")
    path.write_text(
        pattern(name).sub(lambda m: f"{m[1]}{text.rstrip()}\n{m[3]}", document), "utf-8"
    )
