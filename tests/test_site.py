"""The site: the pages of docs/, complete, every code an anchor, nothing asked of a network."""

from __future__ import annotations

import inspect
import io
import json
import os
import re
import runpy
import subprocess
import sys
from pathlib import Path
from typing import Any, get_args

import pytest

import loopcal as lc
from loopcal.document.catalogue import CATALOGUE
from loopcal.errors import Code
from tests.browser import chromium

ROOT = Path(__file__).resolve().parents[1]
PAGES = (
    "index",
    "explanation/verdict",
    "reference/python",
    "reference/messages",
    "reference/codes/outliers",
)


@pytest.fixture(scope="module")
def site() -> dict[str, Any]:
    return runpy.run_path(os.fspath(ROOT / "docs" / "site" / "build.py"))


@pytest.fixture(scope="module")
def source(site: dict[str, Any], tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("site") / "source"
    site["write_source"](made)
    return made


@pytest.fixture(scope="module")
def html(tmp_path_factory: pytest.TempPathFactory) -> Path:
    for name in ("sphinx", "myst_parser", "furo"):
        pytest.importorskip(name, reason=f"{name} is absent; `make site` installs it")
    out = tmp_path_factory.mktemp("site")
    command = [sys.executable, os.fspath(ROOT / "docs" / "site" / "build.py"), os.fspath(out)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return out / "html"


def test_every_page_is_in_the_navigation(source: Path) -> None:
    listed = set((source / "index.md").read_text("utf-8").split())
    codes = (source / "reference" / "codes.md").read_text("utf-8")
    listed |= {f"reference/{name}" for name in codes.split() if name.startswith("codes/")}
    pages = {p.relative_to(source).with_suffix("").as_posix() for p in source.rglob("*.md")}
    assert pages - {"index"} <= listed


def test_every_link_leads_to_a_page_of_the_site(source: Path) -> None:
    for page in source.rglob("*.md"):
        for target in re.findall(r"\]\((?!\w+:|#)([^)#\s]+)", page.read_text("utf-8")):
            assert (page.parent / target).exists(), (page.name, target)


def test_every_code_of_a_message_has_an_anchor(source: Path) -> None:
    text = (source / "reference" / "messages.md").read_text("utf-8")
    assert set(re.findall(r'<a id="([a-z-]+)">', text)) >= {*get_args(Code)}


def test_every_code_has_a_page_with_its_cause_and_remedy(source: Path) -> None:
    of_verdict = {row.code for row in CATALOGUE.values()}
    for code in {*get_args(Code)} | of_verdict:
        text = (source / "reference" / "codes" / f"{code}.md").read_text("utf-8")
        assert text.startswith(f"# {code}\n")
        assert len(re.findall(r"\*\*What it means:\*\* \S", text)) >= 1
        assert len(re.findall(r"\*\*What to do:\*\* \S", text)) >= 1
        assert ("## As an error" in text) == (code in get_args(Code))
        assert ("## In the verdict" in text) or code not in of_verdict


def test_published_versions_link_to_each_other_the_newest_first(tmp_path: Path) -> None:
    publish = runpy.run_path(os.fspath(ROOT / "docs" / "site" / "versions.py"))["main"]
    for version in ("0.9.1", "0.10.0", "0.2.0"):
        (tmp_path / version / "_static").mkdir(parents=True)
        (tmp_path / version / "_static" / "versions.js").touch()
    (tmp_path / "notes").mkdir()
    assert publish(tmp_path) == 0
    for version in ("0.9.1", "0.10.0", "0.2.0"):
        text = (tmp_path / version / "_static" / "versions.js").read_text("utf-8")
        assert json.loads(text.partition("= ")[2].rstrip(";\n")) == ["0.10.0", "0.9.1", "0.2.0"]
    assert "0.10.0/index.html" in (tmp_path / "index.html").read_text("utf-8")
    assert publish(tmp_path / "notes") == 1


def test_every_public_function_and_class_has_its_signature(source: Path) -> None:
    text = (source / "reference" / "python.md").read_text("utf-8")
    for name in lc.__all__:
        if callable(getattr(lc, name)):
            assert f":: loopcal.{name}\n" in text


def test_every_docstring_of_a_public_name_is_sound_markup() -> None:
    core = pytest.importorskip("docutils.core", reason="docutils is absent; `make site` brings it")
    for name in lc.__all__:
        text = inspect.getdoc(getattr(lc, name)) or ""
        told = io.StringIO()
        core.publish_doctree(text, settings_overrides={"warning_stream": told, "report_level": 2})
        assert told.getvalue() == "", name


def test_it_opens_from_the_disk_without_a_request(html: Path) -> None:
    """Built without a warning, or the fixture has failed."""
    asked = []
    with chromium() as browser:
        page = browser.new_page()
        page.on("request", lambda request: asked.append(request.url))
        for name in PAGES:
            page.goto((html / f"{name}.html").as_uri())
            assert page.locator("h1").count() == 1
            assert page.locator("#versions option").all_inner_texts() == [lc.__version__]
    assert [url for url in asked if not url.startswith(("file:", "data:"))] == []
    assert 'id="loopcal.calibrate"' in (html / "reference/python.html").read_text("utf-8")
