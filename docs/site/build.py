"""Build the site: the pages of docs/ with navigation, search and signatures, in build/site/html.

    python docs/site/build.py [FOLDER]

Needs the optional dependencies `site`. Nothing is fetched, here or by a reader. A warning is an
error.
"""

from __future__ import annotations

import os
import re
import shutil
import sys
from pathlib import Path

import loopcal as lc

DOCS = Path(__file__).resolve().parents[1]
BUILD = DOCS.parent / "build" / "site"
PARTS = {
    "Tutorials": ["tutorials/first-session", "tutorials/from-two-links-to-a-robot"],
    "How to": "how-to",
    "Explanation": "explanation",
    "Reference": "reference",
    "Decisions": "decisions",
}
FIRST = ["how-to/first-robot", "how-to/read-the-report", "explanation/verdict", "reference/api"]
_LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)#\s]*)(#[^)\s]*)?\)")
_CODE_ROW = re.compile(r"^\| `([a-z]+(?:-[a-z]+)*)` \|", re.M)


def main(build: Path = BUILD) -> int:
    """Write the pages, then have Sphinx make the site of them."""
    from sphinx.cmd.build import build_main

    source = build / "source"
    shutil.rmtree(source, ignore_errors=True)
    write_source(source)
    settings = ["-q", "-W", "--keep-going", "-c", os.fspath(DOCS / "site"), "-b", "html"]
    return int(build_main([*settings, os.fspath(source), os.fspath(build / "html")]))


def write_source(source: Path) -> None:
    """The pages as Sphinx reads them: links that leave docs/ are texts, and codes have anchors."""
    for page in sorted(DOCS.rglob("*")):
        name = page.relative_to(DOCS)
        if page.is_dir() or name.parts[0] == "site":
            continue
        (source / name).parent.mkdir(parents=True, exist_ok=True)
        if page.suffix == ".md":
            (source / name).write_text(_inside(page), "utf-8")
        else:
            shutil.copyfile(page, source / name)
    messages = source / "reference" / "messages.md"
    text = messages.read_text("utf-8")
    messages.write_text(_CODE_ROW.sub(r'| <a id="\1"></a>`\1` |', text), "utf-8")
    (source / "reference" / "python.md").write_text(signatures(), "utf-8")
    (source / "index.md").write_text(index(source), "utf-8")


def _inside(page: Path) -> str:
    """A page whose links all lead to pages of the site."""

    def kept(link: re.Match[str]) -> str:
        picture, words, target, _ = link.groups()
        if not target or re.match(r"\w+:", target):
            return link[0]
        there = (page.parent / target).resolve()
        if there.is_file() and there.is_relative_to(DOCS) and not picture:
            return link[0]
        return link[0] if picture else words

    return _LINK.sub(kept, page.read_text("utf-8"))


def signatures() -> str:
    """A page with the signature and docstring of every public name."""
    lines = ["# Signatures", "", "Every public name of `loopcal`, from its docstring.", ""]
    for name in lc.__all__:
        if name.startswith("__"):
            continue
        thing = getattr(lc, name)
        kind = "class" if isinstance(thing, type) else "function"
        if not callable(thing):
            continue
        lines += [
            "```{eval-rst}",
            f".. auto{kind}:: loopcal.{name}",
            "```",
            "",
        ]
    return "\n".join(lines)


def index(source: Path) -> str:
    """The first page: where to begin, and the contents."""
    lines = [
        "# loopcal",
        "",
        "loopcal calibrates the geometry of machines from readings in which every",
    ]
    lines += ["sensor is uncertain, and states how far you can trust the result.", ""]
    lines += ["![An arm in space, its joints named](pictures/arm.png)", ""]
    lines += ["- Robot engineer: [calibrate your first robot](how-to/first-robot.md)"]
    lines += ["- Metrologist: [what the verdict means](explanation/verdict.md)"]
    lines += ["- Researcher with loops of your own: [write a mechanism](how-to/own-loop.md)", ""]
    for title, pages in PARTS.items():
        if isinstance(pages, str):
            found = sorted((source / pages).rglob("*.md"))
            names = [p.relative_to(source).with_suffix("").as_posix() for p in found]
            names.sort(key=lambda n: (n not in FIRST, FIRST.index(n) if n in FIRST else 0))
        else:
            names = list(pages)
        names += ["conventions"] if title == "Reference" else []
        lines += ["```{toctree}", f":caption: {title}", ":maxdepth: 1", "", *names, "```", ""]
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main(*map(Path, sys.argv[1:])))
