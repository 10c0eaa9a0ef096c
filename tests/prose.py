"""The prose that a user reads: pages, messages, help texts, the report's words and docstrings."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from html.parser import HTMLParser
from pathlib import Path

import loopcal as lc

ROOT = Path(__file__).resolve().parents[1]
SOURCES = ROOT / "src" / "loopcal"
# what a changelog says of past versions stays as it was written
PAGES = [
    *(p for p in sorted(ROOT.glob("*.md")) if p.name != "CHANGELOG.md"),
    *sorted((ROOT / "docs").rglob("*.md")),
]
_FENCE = re.compile(r"^ *(`{3,}|~{3,})")
_CODE = re.compile(r"`[^`\n]*`")
_LINK = re.compile(r"!?\[([^\]]*)\]\([^)]*\)")
_NAMES = "loopcal|odrpack|x"
"""Words in small letters that begin a sentence."""
_END = re.compile(
    rf"(?<=[.!?])[)*_\"'\]]*\s+(?=[^a-z\s]|(?:{_NAMES})\b)|(?<=[:;])\s+",
)
_WORD = re.compile(r"[^\W\d_][\w'’-]*")


@dataclass(frozen=True)
class Sentence:
    """A sentence, the file that holds it, and the line its paragraph begins at."""

    text: str
    file: str
    line: int

    @property
    def words(self) -> int:
        """How many words it has; names, numbers and formulas in it are none."""
        return len(_WORD.findall(self.text))

    def __str__(self) -> str:
        return f"{self.file}:{self.line}: {self.text}"


def sentences() -> Iterator[Sentence]:
    """Every sentence that a user may read."""
    for page in PAGES:
        yield from _split(_paragraphs(page.read_text("utf-8")), page)
    for source in sorted(SOURCES.rglob("*.py")):
        yield from _split(_strings(ast.parse(source.read_text("utf-8"))), source)
    for template in sorted((SOURCES / "report" / "template").glob("*.html")):
        yield from _split(_template(template.read_text("utf-8")), template)


def _split(paragraphs: Iterator[tuple[int, str]], file: Path) -> Iterator[Sentence]:
    name = str(file.relative_to(ROOT))
    for line, text in paragraphs:
        for part in _END.split(" ".join(text.split())):
            yield Sentence(part, name, line)


def _paragraphs(markdown: str) -> Iterator[tuple[int, str]]:
    """Paragraphs, list entries and headings without code, tables and addresses."""
    fence, begun, lines = "", 0, list[str]()
    for number, line in enumerate([*markdown.splitlines(), ""], 1):
        mark = _FENCE.match(line)
        if fence:
            fence = "" if mark and line.strip() == fence else fence
            continue
        table = line.lstrip().startswith(("|", "<!--"))
        entry = re.match(r"\s*(?:[-*]|\d+\.|#+)\s+", line)
        if lines and (mark or table or entry or not line.strip()):
            yield begun, " ".join(lines)
            lines = []
        if mark:
            fence = mark[1]
        elif line.strip() and not table and (lines or not line.startswith("    ")):
            begun = begun if lines else number
            plain = _LINK.sub(r"\1", line[entry.end() :] if entry else line)
            lines.append(_CODE.sub("``", plain))


def _strings(module: ast.Module) -> Iterator[tuple[int, str]]:
    """Docstrings of public names and their members, and all other strings of several words."""
    docstrings = dict(_docstrings(module, public=False))
    parts = {id(v) for n in ast.walk(module) if isinstance(n, ast.JoinedStr) for v in n.values}
    for node in ast.walk(module):
        if isinstance(node, ast.JoinedStr):
            text = "".join(
                str(v.value) if isinstance(v, ast.Constant) else "``" for v in node.values
            )
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            if id(node) in parts or not docstrings.get(id(node), True):
                continue
            text = node.value
        else:
            continue
        if len(_WORD.findall(text)) < 4:
            continue
        for paragraph in re.split(r"\n\s*\n", text):
            lines = paragraph.splitlines()[1:] if id(node) in docstrings else []
            formula = bool(lines) and all(line.startswith("        ") for line in lines)
            if not formula and ">>>" not in paragraph:
                yield node.lineno, _CODE.sub("``", paragraph)


def _docstrings(node: ast.AST, public: bool) -> Iterator[tuple[int, bool]]:
    """Each docstring, also those below the fields of a class, and whether a user sees it."""
    body = getattr(node, "body", [])
    for child in body if isinstance(body, list) else []:
        if isinstance(child, ast.Expr) and isinstance(child.value, ast.Constant):
            yield id(child.value), public
        name = getattr(child, "name", "")
        named = name in lc.__all__ or public
        yield from _docstrings(child, named and not name.startswith("_"))


class _Words(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.found: list[tuple[int, str]] = []
        self.text = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in ("code", "em", "strong", "a", "sub", "abbr"):
            self.flush()

    def handle_endtag(self, tag: str) -> None:
        self.handle_starttag(tag, [])

    def handle_data(self, data: str) -> None:
        self.text += data

    def flush(self) -> None:
        if self.text.strip():
            self.found.append((self.getpos()[0], self.text))
        self.text = ""


def _template(text: str) -> Iterator[tuple[int, str]]:
    reader = _Words()
    reader.feed(re.sub(r"\{\{.*?\}\}", "``", re.sub(r"\{%.*?%\}", " ", text)))
    reader.flush()
    yield from reader.found
