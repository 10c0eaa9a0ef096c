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
    "Tutorials": [
        "tutorials/first-session",
        "tutorials/in-the-browser",
        "tutorials/from-two-links-to-a-robot",
    ],
    "How to": "how-to",
    "Explanation": "explanation",
    "Reference": "reference",
    "Decisions": "decisions",
}
FIRST = [
    *("how-to/first-robot", "how-to/read-the-report", "explanation/verdict"),
    *("explanation/how-a-calibration-flows", "reference/api"),
]
_LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)#\s]*)(#[^)\s]*)?\)")
_CODE_ROW = re.compile(r"^\| `([a-z]+(?:-[a-z]+)*)` \|", re.M)
_RELATIVE = re.compile(r"\]\((?!\w+:|#|\.\./\.\./)")
CODED = {"reference/messages": "error", "explanation/verdict": "verdict"}
"""Pages whose tables have a row per code, and what these are codes of."""


def main(build: Path = BUILD) -> int:
    """Write the pages, then have Sphinx make the site of them."""
    from sphinx.cmd.build import build_main

    source = build / "source"
    shutil.rmtree(source, ignore_errors=True)
    write_source(source)
    settings = ["-q", "-W", "--keep-going", "-c", os.fspath(DOCS / "site"), "-b", "html"]
    failed = int(build_main([*settings, os.fspath(source), os.fspath(build / "html")]))
    script = f'window.LOOPCAL_VERSIONS = ["{lc.__version__}"];\n'
    (build / "html" / "_static" / "versions.js").write_text(script, "utf-8")
    return failed


def write_source(source: Path) -> None:
    """The pages as Sphinx reads them: links that leave docs/ are texts, and codes have anchors."""
    for page in sorted(DOCS.rglob("*")):
        name = page.relative_to(DOCS)
        # the index of the site takes the place of the map for those who read the folder
        if page.is_dir() or name.parts[0] == "site" or name == Path("README.md"):
            continue
        (source / name).parent.mkdir(parents=True, exist_ok=True)
        if page.suffix == ".md":
            (source / name).write_text(_inside(page), "utf-8")
        else:
            shutil.copyfile(page, source / name)
    write_codes(source)
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


def write_codes(source: Path) -> None:
    """A page for each code of an error or of the verdict, and links to it from the tables."""
    sections: dict[str, list[str]] = {}
    for name, kind in CODED.items():
        page = source / f"{name}.md"
        text = page.read_text("utf-8")
        up = f"](../../{Path(name).parent}/"
        for row in rows_of_codes(text):
            title = "As an error"
            if kind == "verdict":
                title = f"In the verdict: {row['question']}, answered {row['answer']}"
            here = f"{up}{Path(name).name}.md#"
            cells = [row[key].replace("](#", here) for key in ("means", "what to do")]
            means, remedy = (_RELATIVE.sub(up, cell) for cell in cells)
            sections.setdefault(row["code"], [f"# {row['code']}", ""]).extend(
                [
                    *(f"## {title}", "", f"**What it means:** {means}.", ""),
                    *(f"**What to do:** {remedy or 'nothing'}.", ""),
                    *(f"[All codes of this kind]{up[1:]}{Path(name).name}.md)", ""),
                ]
            )
        link = os.path.relpath(source / "reference" / "codes", page.parent)
        text = _CODE_ROW.sub(rf'| <a id="\1"></a>[`\1`]({link}/\1.md) |', text)
        page.write_text(text, "utf-8")
    folder = source / "reference" / "codes"
    folder.mkdir()
    for code, lines in sections.items():
        (folder / f"{code}.md").write_text("\n".join(lines), "utf-8")
    names = [f"codes/{code}" for code in sorted(sections)]
    lines = ["# Codes", "", "Each code of an error or of the verdict: cause and remedy.", ""]
    lines += ["```{toctree}", ":maxdepth: 1", "", *names, "```", ""]
    (source / "reference" / "codes.md").write_text("\n".join(lines), "utf-8")


def rows_of_codes(text: str) -> list[dict[str, str]]:
    """The rows of the tables whose first column is a code, by the headers of their columns."""
    found, header = [], list[str]()
    for line in text.splitlines():
        cells = [cell.strip() for cell in line.strip().strip("|").split(" | ")]
        if line.startswith("| code |"):
            header = ["means" if cell == "meaning" else cell for cell in cells]
        elif header and (row := _CODE_ROW.match(line)):
            found.append({**dict(zip(header, cells, strict=True)), "code": row[1]})
        elif not line.startswith("|"):
            header = []
    return found


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
    """The first page: the first part of README, the map of the pages, and the contents."""
    readme = (DOCS.parent / "README.md").read_text("utf-8").split("\n## What it can do")[0]
    table = [line for line in (DOCS / "README.md").read_text("utf-8").splitlines() if "|" in line]
    lines = [_LINK.sub(_from_above, readme), "", "## Find a page", "", *table, ""]
    for title, pages in PARTS.items():
        if isinstance(pages, str):
            found = sorted(p for p in (source / pages).rglob("*.md") if p.parent.name != "codes")
            names = [p.relative_to(source).with_suffix("").as_posix() for p in found]
            names.sort(key=lambda n: (n not in FIRST, FIRST.index(n) if n in FIRST else 0))
        else:
            names = list(pages)
        names += ["conventions"] if title == "Reference" else []
        options = [f":caption: {title}", ":maxdepth: 1", ":hidden:"]
        lines += ["```{toctree}", *options, "", *names, "```", ""]
    return "\n".join(lines)


def _from_above(link: re.Match[str]) -> str:
    """A link of README as the first page has it; one that leaves docs/ is a text."""
    picture, words, target, anchor = link.groups()
    if re.match(r"\w+:", target):
        return link[0]
    inside = target.removeprefix("docs/")
    return f"{picture}[{words}]({inside}{anchor or ''})" if inside != target else words


if __name__ == "__main__":
    sys.exit(main(*map(Path, sys.argv[1:])))
