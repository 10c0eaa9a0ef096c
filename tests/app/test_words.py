"""All texts that a user reads stand in one module."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import loopcal.companions.app

APP = Path(loopcal.companions.app.__file__).parent
PAGES = [*sorted((APP / "views").glob("*.py")), APP / "frame.py"]


def literals(source: str) -> Iterator[str]:
    """Strings of a module that are no docstrings; of a formatted one its first part."""
    tree = ast.parse(source)
    docs = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docs:
            yield node.value


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_page_holds_no_label(page: Path) -> None:
    """A label begins with a capital; keys, classes and options of a command line do not."""
    kinds = {"Reflector", "Instrument"}  # of parameters
    labels = {text for text in literals(page.read_text("utf-8")) if re.match("[A-Z][a-z]", text)}
    assert labels <= kinds


def test_every_word_is_used() -> None:
    words = ast.parse((APP / "words.py").read_text("utf-8"))
    named = {
        target.id
        for node in words.body
        if isinstance(node, ast.Assign)
        for target in node.targets
        if isinstance(target, ast.Name)
    }
    text = "".join(path.read_text("utf-8") for path in APP.rglob("*.py"))
    own = (APP / "words.py").read_text("utf-8")
    unused = [
        n for n in named if f"words.{n}" not in text and len(re.findall(rf"\b{n}\b", own)) < 2
    ]
    assert unused == []


def test_a_class_of_a_page_is_of_the_app_or_of_quasar() -> None:
    """Another one would do nothing: docs/decisions/0150."""
    nicegui = pytest.importorskip("nicegui", reason="NiceGUI is absent")
    static = Path(nicegui.__file__).parent / "static"
    sheets = [*static.glob("quasar.*.prod.css"), *(APP / "scripts").glob("*.*")]
    styled = set(re.findall(r"[\w-]+", "".join(path.read_text("utf-8") for path in sheets)))
    given = re.compile(r'\.classes\("([^"]*)"')
    text = "".join(path.read_text("utf-8") for path in APP.rglob("*.py"))
    assert {name for names in given.findall(text) for name in names.split()} <= styled
