"""The published JSON Schema accepts what is read, and refuses what is refused."""

from __future__ import annotations

import json
import tomllib
from functools import cache
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from loopcal.errors import InputError
from loopcal.files.project.project_file import read_project
from loopcal.files.project.project_schema import project_schema
from loopcal.files.project.templates import TEMPLATES, template_files

ROOT = Path(__file__).resolve().parents[3]
EXAMPLES = [
    *sorted((ROOT / "examples").glob("*/project.toml")),
    *(
        ROOT / "examples" / "motoman" / f"{n}.toml"
        for n in ("left_arm_grid", "right_arm_workspace")
    ),
]


@cache
def schema() -> dict[str, Any]:
    """Made once, and only where these tests run: it takes a second."""
    return project_schema()


@cache
def validator() -> jsonschema.Draft202012Validator:
    return jsonschema.Draft202012Validator(schema())


def complaints(text: str) -> list[str]:
    return [error.message for error in validator().iter_errors(tomllib.loads(text))]


def test_it_is_a_schema_and_plain_json():
    jsonschema.Draft202012Validator.check_schema(schema())
    assert json.loads(json.dumps(schema(), allow_nan=False)) == schema()


def test_toml_has_no_null_and_neither_has_the_schema():
    assert '{"type": "null"}' not in json.dumps(schema())


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda p: f"{p.parent.name}/{p.name}")
def test_the_examples_are_valid(path):
    assert complaints(path.read_text("utf-8")) == []


@pytest.mark.parametrize("kind", TEMPLATES)
def test_the_projects_to_start_from_are_valid(kind):
    assert complaints(template_files(kind, "new")["project.toml"]) == []


PLANAR = 'schema = 1\nmechanism = { type = "planar-two-link" }\n'
COLUMNS = '[data]\nfile = "p.csv"\n[data.columns]\nphi2 = "a"\nphi3 = 2\n'


@pytest.mark.parametrize(
    "text",
    [
        PLANAR,
        PLANAR + "[noise]\nphi2 = 1\nxPyP = { covariance = [[1, 0], [0, 1]] }",
        PLANAR + "[prior]\n'*' = inf",
        PLANAR + "[parameters]\nl2 = 1\nl3 = { fixed = true }",
        PLANAR + COLUMNS + 'xP = { column = "x" }\nyP = { column = 4, sd_column = 5 }',
        'schema = 1\n[mechanism]\ntype = "serial"\nbase = false\njoint = [{ name = "q" }]',
        'schema = 1\n[mechanism]\ntype = "serial"\nbase = { x = 1 }\njoint = [{ name = "q" }]',
    ],
)
def test_what_is_read_is_valid(text):
    assert complaints(text) == []
    read_project("-", text=text)


@pytest.mark.parametrize(
    "text",
    [
        "",
        PLANAR.replace("1", "2"),
        PLANAR + "[datas]",
        PLANAR + "[data]",
        PLANAR + "[fit]\nmethod = 'x'",
        PLANAR + "[fit]\nloss = 'hubert'",
        PLANAR + "[noise]\nphi2 = -1",
        PLANAR + "[noise]\nphi2 = 'small'",
        PLANAR + "[prior]\nl2 = { sd = 1, value = 3 }",
        'schema = 1\nmechanism = { type = "seril" }',
        'schema = 1\n[mechanism]\ntype = "serial"\njoint = []',
        'schema = 1\n[mechanism]\ntype = "serial"\njoint = [{ name = "q", form = "x" }]',
    ],
)
def test_what_is_refused_is_not_valid(text):
    assert complaints(text)
    with pytest.raises(InputError):
        read_project("-", text=text)


def test_every_table_and_every_choice_is_described():
    for name, definition in schema()["$defs"].items():
        assert definition.get("description"), name
