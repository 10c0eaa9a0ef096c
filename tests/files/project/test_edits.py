"""Changes of a project keep everything else of its text."""

from __future__ import annotations

import tomllib

import pytest

from loopcal.companions.app.edits import with_changes, with_shift, with_value, without_poses
from loopcal.errors import InputError

pytest.importorskip("tomlkit", reason="tomlkit is absent; `pip install .[app]` installs it")

TEXT = """# my notes
schema = 1

[mechanism]
type = "motoman-ma1400"   # the old one

[data]
file = "a.csv"
exclude = ["4"]
"""


def test_all_but_the_value_stays() -> None:
    changed = with_value(TEXT, ["data", "file"], "b.csv")
    assert changed == TEXT.replace('"a.csv"', '"b.csv"')
    assert with_value(changed, ["data", "file"], "a.csv") == TEXT


def test_poses_are_added_to_those_left_out() -> None:
    changed = without_poses(TEXT, ["7", "4"])
    assert tomllib.loads(changed)["data"]["exclude"] == ["4", "7"]
    assert changed.startswith("# my notes\n")
    assert "# the old one" in changed


def test_a_shift_is_added_once_and_gets_further_steps() -> None:
    once = with_shift(TEXT, ["x", "y"], [14.0], "pose")
    twice = with_shift(once, ["x", "y"], [3.0, 14.0], "pose")
    effects = tomllib.loads(twice)["mechanism"]["effect"]
    assert len(effects) == 1
    assert effects[0]["at"] == [3.0, 14.0]
    other = tomllib.loads(with_shift(twice, ["z"], [5.0], "pose"))["mechanism"]["effect"]
    assert [e["changing"] for e in other] == [["x", "y"], ["z"]]


def test_a_text_that_is_no_toml_is_refused() -> None:
    with pytest.raises(InputError):
        with_value("[data\n", ["a"], 1)


def test_changes_that_a_result_states_join_the_effects_that_are_there() -> None:
    lines = (
        '[[mechanism.effect]]\ntype = "shift"\nname = "s"\nchanging = ["x"]\ncolumn = "pose"\n'
        'at = [9]\n\n[[mechanism.effect]]\ntype = "drift"\nname = "d"\nchanging = ["y"]\n'
        'column = "pose"\nsince = 1\nover = 5\n'
    )
    begun = with_shift("[mechanism]  # mine\n", ["x"], [4.0], "pose")
    starts: dict[tuple[str, ...], tuple[float, ...]] = {("x",): (9.0,), ("y",): ()}
    once = with_changes(begun, lines, starts)
    assert once == with_changes(once, lines, starts)
    assert with_changes(begun, lines, {("x",): (), ("z",): (9.0,)}) == begun
    assert once.startswith("[mechanism]  # mine\n")
    effects = tomllib.loads(once)["mechanism"]["effect"]
    assert [effect["type"] for effect in effects] == ["shift", "drift"]
    assert effects[0]["at"] == [4.0, 9.0]
    assert effects[1]["over"] == 5
