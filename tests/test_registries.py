"""What comes in kinds is a row of a registry, and the documentation shows the rows."""

from __future__ import annotations

import re

import pytest

from loopcal.cli.registry import COMMANDS, loaded, name_of, with_loops
from loopcal.companions.robot.exports.registry import EXPORTS
from loopcal.companions.robot.programs.registry import DIALECTS
from loopcal.files.project.data_table import DataTable
from loopcal.files.tables.reader import Layout
from loopcal.files.tables.registry import READERS
from loopcal.keys import arguments
from tests.command_line import run_here
from tests.documented_rows import DOCS, block_of, check_block, markdown


def test_the_formats_of_exports_are_those_of_the_rows() -> None:
    rows = [(one.user, f"`{one.name}`", one.label, one.then) for one in EXPORTS.values()]
    table = markdown(("you have", "export", "which is", "then"), rows)
    check_block("how-to/enter-into-the-controller.md", "exports", table)


def test_the_files_of_readings_are_those_of_the_rows() -> None:
    rows = [
        (
            one.kind,
            ", ".join(f"`{ending}`" for ending in one.endings),
            one.words,
            ", ".join(f"`{option}`" for option in one.options),
        )
        for one in READERS
    ]
    table = markdown(("file", "ends in", "read is", "options"), rows)
    check_block("reference/project-file.md", "readers", table)


def test_each_option_of_a_reader_is_a_keyword_and_a_key_of_the_project() -> None:
    layout = [argument.name for argument in arguments(Layout)]
    assert set(layout) == {option for reader in READERS for option in reader.options}
    assert {argument.name for argument in arguments(DataTable)} >= set(layout)


def test_the_dialects_of_programs_are_those_of_the_rows() -> None:
    rows = [
        (
            one.kind,
            ", ".join(f"`{ending}`" for ending in one.endings),
            one.targets,
            one.configuration,
            f"`{one.endings[0]}`" if one.drive else "",
        )
        for one in DIALECTS.values()
    ]
    head = ("dialect", "endings", "targets", "configuration", "`plan` writes")
    check_block("how-to/correct-a-program.md", "dialects", markdown(head, rows))


def test_an_empty_block_ends_at_its_own_end() -> None:
    text = "<!-- a -->\n<!-- end -->\nwords\n<!-- b -->\n| c |\n<!-- end -->\n"
    assert [block_of(mark).findall(text) for mark in "ab"] == [[""], ["| c |"]]


def options_of(command: str) -> set[str]:
    """The options that the help of a command lists, those of every command aside."""
    text = run_here(command, "--help").stdout
    return set(re.findall(r"^ +(?:-\w, )?(--[a-z-]+)", text, re.M)) - {"--help"}


@pytest.mark.parametrize("command", COMMANDS)
def test_the_reference_names_each_option_of_a_command(command: str) -> None:
    text = (DOCS / "reference/command-line.md").read_text("utf-8")
    sections = dict(re.findall(r"^## loopcal ([a-z]+).*?\n(.*?)(?=^## |\Z)", text, re.M | re.S))
    assert command in sections, f"docs/reference/command-line.md: add '## loopcal {command}'"
    missing = [option for option in options_of(command) if option not in sections[command]]
    assert missing == []


def test_a_command_is_in_the_module_of_its_row() -> None:
    for name, module in COMMANDS.items():
        (command,) = loaded([name])
        assert name_of(command) == name
        assert command.callback is not None
        beside = module.startswith("companions.")
        assert command.callback.__module__ == f"loopcal.{module if beside else f'cli.{module}'}"
    assert [name_of(command) for command in loaded(["--help"])] == [*COMMANDS]


def test_the_app_hands_its_loops_to_the_commands_that_take_them() -> None:
    taking = {name for name in COMMANDS if "--mechanism FILE" in run_here(name, "--help").stdout}
    assert with_loops() == taking
    assert {"calibrate", "verify"} <= taking
    assert not taking & {"new", "init"}
