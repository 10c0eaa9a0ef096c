"""An error says what is wrong, where, and what to do; its kind decides the exit code."""

from __future__ import annotations

import ast
import pickle
import re
from typing import get_args

import pytest

from loopcal.errors import (
    Code,
    DomainError,
    InputError,
    LoopcalError,
    NoTrustworthyResult,
    UsageError,
    listed,
    nearest,
)
from tests.conftest import ROOT

KINDS = (LoopcalError, UsageError, InputError, DomainError, NoTrustworthyResult)


@pytest.mark.parametrize(
    ("kind", "code"),
    [
        (LoopcalError, 1),
        (UsageError, 2),
        (InputError, 3),
        (DomainError, 3),
        (NoTrustworthyResult, 4),
    ],
)
def test_the_kind_decides_the_exit_code(kind: type[LoopcalError], code: int) -> None:
    assert kind("text").exit_code == code
    assert issubclass(kind, LoopcalError)


def test_the_text_is_place_message_and_remedy_on_its_own_line() -> None:
    error = InputError("sd is -1 mm", place="arm.toml: noise.x", remedy="give 0 or more")
    assert str(error) == "arm.toml: noise.x: sd is -1 mm\n  What to do: give 0 or more"


def test_what_is_not_known_is_not_printed() -> None:
    assert str(InputError("sd is -1 mm")) == "sd is -1 mm"
    assert str(InputError("sd is -1 mm", place="arm.toml")) == "arm.toml: sd is -1 mm"
    assert str(InputError("no file", remedy="name one")) == "no file\n  What to do: name one"


@pytest.mark.parametrize("kind", KINDS)
def test_a_place_found_later_stands_before_the_one_known(kind: type[LoopcalError]) -> None:
    error = kind("text", place="row 3", remedy="mend it")
    placed = error.at("poses.csv")
    assert type(placed) is kind
    assert str(placed) == "poses.csv: row 3: text\n  What to do: mend it"
    assert error.place == "row 3", "the first error stays as it was"


def test_a_place_found_later_is_the_place_where_there_was_none() -> None:
    assert str(InputError("text").at("poses.csv")) == "poses.csv: text"


@pytest.mark.parametrize(
    ("typed", "meant"), [("collumns", "columns"), ("fil", "file"), ("quantites", "quantities")]
)
def test_a_misspelled_name_is_told_the_nearest(typed: str, meant: str) -> None:
    assert nearest(typed, ["columns", "file", "quantities"]) == f"did you mean {meant!r}?"


def test_a_name_like_no_other_is_told_all_there_are() -> None:
    assert nearest("zzz", iter(["columns", "file"])) == "known are 'columns', 'file'"
    assert nearest("zzz", []) == "none is known here"


def test_a_long_name_is_cut_in_its_middle_wherever_it_is_quoted() -> None:
    name = "start" + "x" * 100_000 + "end"
    error = InputError(f"there is no {name!r}, it's said", place=name, remedy=f'try "{name}"')
    assert len(str(error)) < 3_000
    assert "'startx" in error.message
    assert "xend', it's said" in error.message


def test_a_text_of_usual_length_stays_whole() -> None:
    text = "the sensors' sds and the machine's " + "own length " * 20 + "are 'x' and \"y ...\""
    assert InputError(text, place=text, remedy=text).remedy == text


def test_a_long_list_says_how_many_more_there_are() -> None:
    names = [f"n{i}" for i in range(1_000)]
    assert nearest("zzz", names).endswith("and 960 more")
    assert listed(names).endswith("'n9' and 990 more")
    assert listed(names[:10]).endswith("'n9'")


def test_a_place_is_one_line() -> None:
    assert "\n" not in str(InputError("text", place="a\nloopcal: done"))


def codes_used() -> set[str]:
    """Texts in src that state a code: arguments named `code`, and annotated as such."""
    found = set()
    for path in (ROOT / "src").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            match node:
                case ast.keyword(arg="code", value=value):
                    pass
                case ast.AnnAssign(annotation=kind, value=ast.expr() as value):
                    if "Code" not in ast.unparse(kind):
                        continue
                case _:
                    continue
            texts = {str(t.value) for t in ast.walk(value) if isinstance(t, ast.Constant)}
            found |= texts & {*get_args(Code)}
    return found


def test_every_refusal_of_input_states_its_code() -> None:
    """`InputError` is too wide a class for its usual code to be meant without a word."""
    silent = [
        f"{path.relative_to(ROOT)}:{node.lineno}"
        for path in (ROOT / "src").rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.Call)
        and ast.unparse(node.func).endswith("InputError")
        and not any(keyword.arg == "code" for keyword in node.keywords)
    ]
    assert silent == []


def test_every_code_is_used() -> None:
    assert codes_used() == {*get_args(Code)}


def test_every_code_is_documented_and_every_documented_code_exists() -> None:
    page = (ROOT / "docs" / "reference" / "messages.md").read_text("utf-8")
    assert re.findall(r"^\| `([a-z-]+)` \|", page, re.MULTILINE) == sorted(get_args(Code))


def test_a_code_survives_a_later_place_and_a_way_between_processes() -> None:
    error = InputError("no column 'x'", code="missing-column", place="row 3").at("poses.csv")
    again = pickle.loads(pickle.dumps(error))
    assert (again.code, again.place) == ("missing-column", "poses.csv: row 3")
    assert InputError("sd is -1 mm").code == "invalid-value"


def test_a_refusal_types_the_command_again_with_what_it_decides() -> None:
    words = ["init", "a b.csv", "--dh", "arm.csv", "--joints=J1,J2"]
    error = InputError("several").offering("--joints", "-J1,J2")
    error.next_command(words)
    assert error.text.endswith(
        "Next command:\n    loopcal init 'a b.csv' --dh arm.csv --joints -J1,J2"
    )
    error = InputError("no file").meaning("arm.csv", "arms.csv")
    error.next_command(words)
    assert error.command == "loopcal init 'a b.csv' --dh arms.csv --joints=J1,J2"


def test_the_same_command_follows_what_is_mended() -> None:
    for words in (["init", "a.csv"], ["calibrate", "a.toml"]):
        again = InputError("a gap", remedy="fill it")
        again.next_command(words)
        assert again.text.endswith(f"Then run:\n    loopcal {' '.join(words)}")
