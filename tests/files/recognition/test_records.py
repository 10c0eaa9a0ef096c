"""Texts that repeat one form: which numbers become which columns, and when there is no form."""

from __future__ import annotations

import re

import numpy as np
import pytest

from loopcal.files.recognition import records
from loopcal.files.recognition.records import are_records, records_table
from loopcal.files.tables.raw import Text
from loopcal.files.tables.table import Table
from tests.files.hostile.steps import steps


def table(content: str) -> Table | None:
    made = records_table(Text("points.txt", content.encode(), "0" * 64))
    return made and made[0]


def numbers(made: Table, position: int) -> np.ndarray:
    return made.numbers(position, np.arange(len(made.rows)))


VALUES = [(10.5, -2.0, 30.25), (1e-3, 5.0, 6.0), (-7.0, 8.5, 9.0), (0.0, 1.0, 2.0)]


@pytest.mark.parametrize(
    ("form", "names"),
    [
        ("DECL E6AXIS XP{i}={{A1 {0},A2 {1},A3 {2}}}\n", ("A1", "A2", "A3")),
        ("P[{i}]{{\n GP1:\n J1= {0} deg, J2= {1} deg,\n J3= {2} deg\n}};\n", ("J1", "J2", "J3")),
        ("CONST jointtarget p{i}:=[[{0},{1},{2}],[9E9]];\n", ("p x", "p y", "p z")),
        ("C0000{i}={0},{1},{2}\n", ("C x", "C y", "C z")),
        ('<Value j1="{0}" j2="{1}" j3="{2}" />\n', ("j1", "j2", "j3")),
        (
            '<R><A x="{0}" y="{1}"/><B x="{2}" y="7"/></R>\n',
            ("A_x", "A_y", "B_x"),
        ),
        ('{{"t": {i}, "q": [{0}, {1}, {2}]}}, ', ("q x", "q y", "q z")),
        ("name: [a, b, c]\nposition: [{0}, {1}, {2}]\n---\n", ("a.position", "b.position")),
        ("name:\n- a\n- b\nposition:\n- {0}\n- {1}\n---\n", ("a.position", "b.position")),
    ],
)
def test_a_number_belongs_to_the_word_before_it(form: str, names: tuple[str, ...]) -> None:
    made = table("HEAD 7 8\n" + "".join(form.format(*v, i=i) for i, v in enumerate(VALUES)))
    assert made is not None
    for name, values in zip(names, zip(*VALUES, strict=True), strict=False):
        assert np.array_equal(numbers(made, made.names.index(name)), values)


def test_lists_of_all_rows_are_columns() -> None:
    made = table('{"q": [[1, 2, 3], [4, 5, 6], [7, 8, 9], [1, 1, 1]], "t": [0, 1, 2, 3]}')
    assert made is not None
    assert made.names == ("q x", "q y", "q z", "t")
    assert np.array_equal(numbers(made, 1), [2, 5, 8, 1])


@pytest.mark.parametrize("head", ["", "samples:\n"])
@pytest.mark.parametrize(
    "form",
    [
        "- q: [{0}, {1}]\n  p: [{2}]\n",
        "  - {{a: {0}, alpha: {1}, d: {2}}}\n",
        "- a: {0}\n  b: {1}\n  c: {2}\n",
    ],
)
def test_the_first_item_of_a_list_of_yaml_is_a_row_too(head: str, form: str) -> None:
    made = table(head + "".join(form.format(*v) for v in VALUES))
    assert made is not None
    assert len(made.rows) == len(VALUES)
    for i, values in enumerate(zip(*VALUES, strict=True)):
        assert np.array_equal(numbers(made, i), values)


def test_what_is_missing_is_no_shift_of_rows() -> None:
    whole = [f'{{"q": {i}, "x": {i}.5, "y": {i}.25}}\n' for i in range(6)]
    lacking = [*whole[:3], '{"q": 3, "y": 3.25}\n', *whole[4:]]
    made = table("".join(lacking))
    assert made is not None
    assert made.names == ("q", "y")
    made = table("".join([*whole[:3], '{"q": 3, "x": null, "y": 3.25}\n', *whole[4:]]))
    assert made is not None
    assert np.array_equal(numbers(made, 1), [0.5, 1.5, 2.5, np.nan, 4.5, 5.5], equal_nan=True)


def test_numbers_after_all_others_belong_to_no_row() -> None:
    points = "".join(f"C0000{i}={i},{2 * i}\n" for i in range(5))
    made = table(points + "".join(f"MOVJ C0000{i} VJ=10.00\n" for i in range(5)))
    assert made is not None
    assert made.names == ("C 1", "C 2", "pose")


@pytest.mark.parametrize("content", ["", "no number", "a 1\nb 2\n", "one 1 two 2"])
def test_without_a_form_there_is_no_table(content: str) -> None:
    assert table(content) is None


def test_rows_of_a_table_are_no_records() -> None:
    assert not are_records(["J1 [deg],J2 [deg]", "1.5,2.5", "3.5,4.5"])
    assert are_records(["A, B", "P1={A1 1.0, A2 2.0}", "P2={A1 1.5, A2 2.5}"])


@pytest.mark.parametrize(
    "pattern", [p for p in vars(records).values() if isinstance(p, re.Pattern)]
)
@pytest.mark.parametrize(
    "part", ["a 1\n", "[[1, 2], ", "[a, ", "1 ", "1e", "= ", ":\n- a", "\n", " ", "a", "["]
)
def test_steps_grow_as_the_text_does(pattern: re.Pattern[str], part: str) -> None:
    short, long = (steps(pattern, part * n).count for n in (200, 400))
    assert long <= 2.6 * short


def test_a_bracket_begins_a_list_of_its_own() -> None:
    made = table("".join(f"{i}; [{a}, {b}]; {c}\n" for i, (a, b, c) in enumerate(VALUES)))
    assert made is not None
    assert np.allclose(numbers(made, 0), range(len(VALUES)))
    assert np.allclose(numbers(made, 1), [a for a, _, _ in VALUES])
    assert made.names[1].startswith("_b")
    assert made.names[3] == "_c"


def test_what_an_item_is_called_is_no_number() -> None:
    names = [f"rgb/{9 - i:03}.png" for i in range(4)]
    rows = (f'{{"image": "{name}", "q": [{i}.5, 2, 3]}}' for i, name in enumerate(names))
    made = table(f"[{', '.join(rows)}]")
    assert made is not None
    assert made.names == ("q x", "q y", "q z", "pose")
    assert made.ids(3) == tuple(names)


def test_the_number_of_a_position_is_none_of_its_turns() -> None:
    rows = (f"P[{i}]{{ X = {i}.5 mm, W = 1{i}.0, P = 2{i}.0, R = 3.0 }};\n" for i in range(4))
    made = table("".join(rows))
    assert made is not None
    assert made.names == ("X", "W", "P", "R", "pose")
    np.testing.assert_array_equal(made.numbers(2, np.arange(4)), (20.0, 21.0, 22.0, 23.0))
    assert made.ids(4) == ("0", "1", "2", "3")
