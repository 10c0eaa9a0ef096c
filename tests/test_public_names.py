"""What is public is public on purpose: listed, documented, shown in an example."""

from __future__ import annotations

import inspect
import re
from importlib import import_module
from operator import attrgetter
from pathlib import Path
from typing import Any

import pytest

import loopcal
from loopcal.files.machines.registry import kinds
from loopcal.keys import type_name
from loopcal.mechanisms.effects.registry import EFFECTS
from loopcal.mechanisms.instruments.registry import INSTRUMENTS
from tests.documentation import blocks

ROOT = Path(__file__).resolve().parents[1]
EXTRAS = {"collada", "cv2", "distributed", "nicegui", "rosbags", "starlette", "tomlkit"}
REFERENCE = "\n".join(p.read_text("utf-8") for p in sorted((ROOT / "docs/reference").glob("*.md")))
NAMESPACES = {"": loopcal} | {
    n: getattr(loopcal, n) for n in ("effects", "instruments", "machines")
}
LISTED = {key: list(getattr(place, "__all__", [])) for key, place in NAMESPACES.items()}
NAMES = [f"{key}.{name}".lstrip(".") for key, names in LISTED.items() for name in names]
DOCUMENTED = [name for name in NAMES if not name.startswith("__")]


def public(name: str) -> Any:
    """What is written `loopcal.NAME`; in a namespace NAME has a dot."""
    return attrgetter(name)(loopcal)


def documentation_code() -> str:
    pages = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    return "\n".join(b.text for page in pages for b in blocks(page) if b.language == "python")


def returns_bare_tuple(function: Any) -> bool:
    """A tuple of fixed parts, whose meaning hangs on positions; `tuple[str, ...]` is a sequence."""
    annotation = str(inspect.signature(function).return_annotation)
    return bool(re.match(r"(typing\.)?[Tt]uple\b", annotation)) and "..." not in annotation


@pytest.mark.parametrize("key", NAMESPACES)
def test_the_list_is_sorted_and_has_no_name_twice(key: str) -> None:
    assert LISTED[key]
    assert sorted(set(LISTED[key])) == LISTED[key]


@pytest.mark.parametrize("key", NAMESPACES)
def test_nothing_public_is_missing_from_the_list(key: str) -> None:
    # Our own names bound in the package, apart from its submodules, are meant to be used.
    own = {
        name
        for name, value in vars(NAMESPACES[key]).items()
        if not name.startswith("_")
        and (getattr(value, "__module__", "") or "").startswith("loopcal")
    }
    assert own <= set(LISTED[key])


@pytest.mark.parametrize("name", NAMES)
def test_it_exists_and_is_listed_by_dir(name: str) -> None:
    assert public(name) is not None
    key, _, own = name.rpartition(".")
    assert own in dir(NAMESPACES[key])


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no_such_name"):
        public("no_such_name")


@pytest.mark.parametrize("name", DOCUMENTED)
def test_its_docstring_says_something(name: str) -> None:
    text = inspect.getdoc(public(name)) or ""
    # A dataclass without a docstring gets its signature for one.
    assert not text.startswith(f"{name.rpartition('.')[2]}("), f"{name} has no docstring of its own"
    assert len(text.split()) >= 5


@pytest.mark.parametrize("name", DOCUMENTED)
def test_it_is_in_the_reference(name: str) -> None:
    listed = re.search(rf"\b{re.escape(name)}\b", REFERENCE) is not None
    assert listed, f"write {name} in a page of docs/reference"


@pytest.mark.parametrize("name", DOCUMENTED)
def test_an_example_that_runs_shows_it(name: str) -> None:
    shown = ">>>" in (inspect.getdoc(public(name)) or "")
    shown = shown or re.search(rf"\b{re.escape(name)}\b", documentation_code()) is not None
    assert shown, f"use {name} in a Python block of a page, or behind >>> in its docstring"


def test_every_module_can_be_imported() -> None:
    """Without a warning; one that only an extra has may be absent."""
    package, absent = Path(loopcal.__file__).parent, set()
    for path in sorted(package.rglob("*.py")):
        name = ".".join(path.relative_to(package.parent).with_suffix("").parts)
        if path.name != "__main__.py":
            try:
                import_module(name.removesuffix(".__init__"))
            except ModuleNotFoundError as error:
                absent.add(error.name)
    assert absent <= EXTRAS


@pytest.mark.parametrize("name", DOCUMENTED)
def test_it_returns_no_bare_tuple(name: str) -> None:
    members = [public(name)] if inspect.isfunction(public(name)) else []
    if inspect.isclass(public(name)):
        members += [
            member
            for key, member in inspect.getmembers(public(name), inspect.isroutine)
            if not key.startswith("_") and inspect.isfunction(inspect.unwrap(member))
        ]
    assert [member.__qualname__ for member in members if returns_bare_tuple(member)] == []


def test_the_namespaces_hold_what_mechanism_files_do() -> None:
    """Machines and instruments by the types that files call them, apart from what shows a point."""
    instruments = {kind.replace("-", "_") for kind in INSTRUMENTS}
    machines = {kind.replace("-", "_") for kind in kinds()} - {"motoman_ma1400", "function"}
    found = {
        name for name in LISTED["instruments"] if inspect.isfunction(public(f"instruments.{name}"))
    }
    assert found == instruments
    found = {name for name in LISTED["machines"] if inspect.isfunction(public(f"machines.{name}"))}
    assert found == machines
    effects = {type_name(public(f"effects.{name}")) for name in LISTED["effects"]} - {"load"}
    assert effects == set(EFFECTS)
