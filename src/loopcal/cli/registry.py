"""All commands, and the module that each is in: a command is loaded when it is asked for."""

from __future__ import annotations

from collections.abc import Iterable
from importlib import import_module
from typing import TYPE_CHECKING, get_type_hints

from typer.models import CommandInfo

from loopcal.cli.application import FunctionOption, app, days_of_history
from loopcal.companions import called, load

if TYPE_CHECKING:
    from loopcal.workflow.keeping import Keeper

COMMANDS = {
    **dict.fromkeys(("demo", "init", "calibrate", "check", "predict", "compare"), "commands"),
    **dict.fromkeys(("report", "noise", "new", "simulate", "schema"), "commands"),
    "study": "companions.studies.commands",
    "correct": "companions.robot.commands",
    "export": "companions.robot.commands",
    "verify": "commands",
    **dict.fromkeys(("update", "history", "fleet"), "companions.life.commands"),
    "performance": "companions.performance.commands",
    "plan": "companions.planning.commands",
    "record": "companions.record.commands",
    "app": "companions.app.commands",
}
"""Command -> its module, of this folder or of a companion, in the order of the help."""


def keeper(folder: str | None, date: str | None) -> Keeper | None:
    """What keeps a result in the history of this folder, dated by --date."""
    days = days_of_history(folder, date)
    return None if folder is None else called("HistoryKeeper")(folder, days)


def loaded(names: Iterable[str]) -> list[CommandInfo]:
    """Of these names the commands, all where none is one."""
    asked = [name for name in names if name in COMMANDS] or [*COMMANDS]
    for module in dict.fromkeys(COMMANDS[name] for name in asked):
        beside = module.removeprefix("companions.")  # its commands join as it is imported
        _ = import_module(f"loopcal.cli.{module}") if beside == module else load(beside)
    joined = {name_of(command): command for command in app.registered_commands}
    return [joined[name] for name in asked]


def name_of(command: CommandInfo) -> str:
    """As it is typed."""
    return command.name or str(getattr(command.callback, "__name__", ""))


def with_loops() -> frozenset[str]:
    """The commands that take loops written in Python."""
    hints = {name_of(c): get_type_hints(c.callback, include_extras=True) for c in loaded(())}
    return frozenset(name for name in hints if hints[name].get("mechanism") == FunctionOption)
