"""Whatever a name or an argument holds, the terminal shows text, and messages stay short."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from loopcal.cli.output import escaped, print_json
from tests.command_line import run, run_here

STEERING = [
    "\x1b[2J",
    "\x07",
    "\x9b",
    "\x7f",
    "\r",
    "\u202e",
    "\u2066",
    "\u200f",
    "\ufeff",
    "\ud800",
]


@pytest.mark.parametrize("mark", STEERING)
def test_what_steers_a_terminal_is_shown_escaped(mark: str) -> None:
    shown = escaped(f"arm{mark}.toml")
    assert shown.isprintable()
    assert shown.encode("ascii")
    assert shown.startswith("arm\\")
    assert shown.endswith(".toml")


def test_text_of_any_language_line_breaks_and_tabs_stay() -> None:
    text = "µm, ±1°, Größe\tמדידה\n測定"
    assert escaped(text) == text


@pytest.mark.parametrize("mark", STEERING)
def test_json_stays_valid_and_holds_no_mark(mark: str, capsys: pytest.CaptureFixture[str]) -> None:
    print_json({mark: f"é{mark}"})
    printed = capsys.readouterr().out
    assert mark not in printed
    assert "é" in printed
    assert json.loads(printed) == {mark: f"é{mark}"}


@pytest.mark.parametrize(
    "arguments", [("calibrate",), ("report",), ("calibrate", "x.toml", "--out")]
)
def test_an_argument_reaches_the_terminal_escaped(arguments: tuple[str, ...]) -> None:
    done = run_here(*arguments, "a\x1b[31m\u202eb\nloopcal: done")
    assert done.returncode == 3
    assert "\x1b" not in done.stderr
    assert "\u202e" not in done.stderr
    assert "\nloopcal: done" not in done.stderr


def test_an_unknown_option_is_shown_escaped() -> None:
    done = run_here("calibrate", "--\x1b[31m\u202e")
    assert done.returncode == 2
    assert "\x1b" not in done.stderr
    assert "\u202e" not in done.stderr


@pytest.mark.parametrize(
    "project",
    [
        f'schema = 1\n"{"k" * 100_000}" = 1\n',
        f'schema = 1\n[mechanism]\ntype = "{"t" * 100_000}"\n',
        f'schema = 1\n[mechanism]\ntype = "planar-two-link"\n[noise]\n"{"q" * 100_000}" = 1\n',
        f'schema = 1\n[mechanism]\nfile = "{"f" * 100_000}"\n',
    ],
)
def test_a_message_does_not_grow_with_the_name_it_quotes(project: str, tmp_path: Path) -> None:
    (tmp_path / "p.toml").write_text(project, "utf-8")
    done = run_here("check", tmp_path / "p.toml")
    assert done.returncode == 3
    assert len(done.stderr) < 5_000


def test_a_message_does_not_grow_with_a_header(tmp_path: Path) -> None:
    names = ["c" * 400, *(f"c{i}" for i in range(5_000))]
    (tmp_path / "p.csv").write_text(",".join(names) + "\n" + ",".join(["1"] * len(names)), "utf-8")
    done = run_here("noise", tmp_path / "p.csv", "--columns", "zz")
    assert done.returncode == 3
    assert len(done.stderr) < 5_000
    assert "more" in done.stderr


def test_a_process_ends_without_a_word_of_what_it_leaves(tmp_path: Path) -> None:
    new = ["new", "arm", "--mechanism", "planar-two-link"]
    made = ["simulate", "arm/project.toml", "--out", "arm/poses.csv", "--seed", "1"]
    for arguments in (new, made):
        assert run_here(*arguments, cwd=tmp_path).returncode == 0
    done = run("calibrate", "arm/project.toml", "--no-report", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "leaked" not in done.stderr
