"""The reference of mechanism files lists every type, and each table is made of its declaration.

After a change that is meant, make the tables again: see `tests/key_tables.py`.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import pytest

from loopcal.files.machines.chains import Exponentials, Urdf
from loopcal.files.machines.declared_function import Function
from loopcal.files.machines.machine_type import ChainTable, MechanismTable
from loopcal.files.machines.registry import kinds, table_of
from loopcal.files.machines.serial import Serial
from loopcal.files.machines.trees import BodyTable, StandingRobot, Tree
from loopcal.mechanisms.effects.gravity import Load
from loopcal.mechanisms.effects.registry import EFFECTS
from loopcal.mechanisms.exponentials import ScrewJoint
from loopcal.mechanisms.instruments.registry import INSTRUMENTS
from loopcal.mechanisms.machine import Between
from loopcal.mechanisms.origins import LinkJoint, Mimic
from loopcal.mechanisms.parallel.registry import PARALLEL
from loopcal.mechanisms.serial import Joint
from loopcal.mechanisms.structure.structured import structured
from tests.key_tables import REFERENCE, assert_stated, named

PAGE = "mechanism-file.md"
PARTS = {"load": Load, "joint": Joint, "link-joint": LinkJoint, "mimic": Mimic}
CHAINS = {"serial": Serial, "urdf": Urdf, "exponentials": Exponentials, "tree": Tree}
MAKERS: dict[str, Callable[..., Any]] = {
    **INSTRUMENTS,
    **EFFECTS,
    **PARALLEL,
    **PARTS,
    **CHAINS,
    "between": Between,
    "body": BodyTable,
    "standing-robot": StandingRobot,
    "chain": ChainTable,
    "function": Function,
    "screw-joint": ScrewJoint,
    "structured": structured,
}


@pytest.mark.parametrize("kind", MAKERS)
def test_the_keys_of_each_type_are_those_of_its_row(kind: str) -> None:
    chains = dict.fromkeys(CHAINS, ChainTable)
    # Cameras and inclinometers say in their own words what carries them.
    looking = dict.fromkeys({*INSTRUMENTS} - {"camera", "inclinometer"}, Between)
    common = {**chains, **looking, "function": MechanismTable}.get(kind)
    assert_stated(PAGE, kind, MAKERS[kind], common)


def test_every_table_of_the_page_is_of_a_type() -> None:
    assert sorted(named(PAGE)) == sorted(MAKERS), "each type has a section with its own marks"


@pytest.mark.parametrize("kind", kinds())
def test_every_key_of_a_machine_is_named(kind: str) -> None:
    text = (REFERENCE / PAGE).read_text("utf-8")
    assert re.search(rf"`{kind}`|\"{kind}\"", text)
    missing = [key for key in table_of(kind).model_fields if not re.search(rf"\b{key}\b", text)]
    assert missing == []
