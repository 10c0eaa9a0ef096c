"""The reference of mechanism files lists every type, and each table is made of the registry's row.

After a change that is meant, make the tables again and read `git diff`:

    LOOPCAL_REMAKE_GOLDEN=1 python -m pytest tests/files/machines/test_reference.py
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from loopcal.files.machines.registry import kinds, table_of
from loopcal.mechanisms.effects.gravity import Load
from loopcal.mechanisms.effects.registry import EFFECTS
from loopcal.mechanisms.exponentials import ScrewJoint
from loopcal.mechanisms.instruments.registry import INSTRUMENTS
from loopcal.mechanisms.keys import REQUIRED, arguments, plain
from loopcal.mechanisms.origins import LinkJoint, Mimic
from loopcal.mechanisms.parallel.registry import PARALLEL
from loopcal.mechanisms.serial import Joint
from loopcal.mechanisms.structure.structured import structured

PAGE = Path(__file__).resolve().parents[3] / "docs" / "reference" / "mechanism-file.md"
PARTS = {"load": Load, "joint": Joint, "link-joint": LinkJoint, "mimic": Mimic}
MAKERS: dict[str, Callable[..., Any]] = {
    **INSTRUMENTS,
    **EFFECTS,
    **PARALLEL,
    **PARTS,
    "screw-joint": ScrewJoint,
    "structured": structured,
}


def shown(default: Any) -> str:
    """A default as a file states it; None is told by the key's own words."""
    if default is REQUIRED:
        return "required"
    value = plain(default)
    if value is None or value == {}:
        return ""
    text = str(value).lower() if isinstance(value, bool) else repr(value)
    return f"`{text}`".replace("'", '"')


def table(make: Callable[..., Any]) -> str:
    rows = [
        f"| `{a.name}` | {shown(a.default)} | {a.key.says.replace('|', '/')} |"
        for a in arguments(make)
    ]
    return "\n".join(["| key | default | says |", "| --- | --- | --- |", *rows])


@pytest.mark.parametrize("kind", MAKERS)
def test_the_keys_of_each_type_are_those_of_its_row(kind: str) -> None:
    text = PAGE.read_text("utf-8")
    block = re.compile(rf"<!-- keys: {kind} -->\n(.*?)\n<!-- end -->", re.S)
    assert len(block.findall(text)) == 1, f"add the lines <!-- keys: {kind} --> and <!-- end -->"
    made = table(MAKERS[kind])
    if os.environ.get("LOOPCAL_REMAKE_GOLDEN"):
        text = block.sub(lambda _: f"<!-- keys: {kind} -->\n{made}\n<!-- end -->", text)
        PAGE.write_text(text, "utf-8")
    assert block.findall(text) == [made]


def test_every_table_of_the_page_is_of_a_type() -> None:
    named = re.findall(r"<!-- keys: (\S+) -->", PAGE.read_text("utf-8"))
    assert sorted(named) == sorted(MAKERS)


@pytest.mark.parametrize("kind", kinds())
def test_every_key_of_a_machine_is_named(kind: str) -> None:
    text = PAGE.read_text("utf-8")
    assert re.search(rf"`{kind}`|\"{kind}\"", text)
    missing = [key for key in table_of(kind).model_fields if not re.search(rf"\b{key}\b", text)]
    assert missing == []
