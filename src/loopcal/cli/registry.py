"""All commands, and the module that each is in: a command is loaded when it is asked for."""

from __future__ import annotations

from collections.abc import Iterable
from importlib import import_module
from typing import TYPE_CHECKING, get_type_hints

from typer.models import CommandInfo

from loopcal.cli.application import FunctionOption, app

if TYPE_CHECKING:
    from loopcal.planning.cure import Cure
    from loopcal.workflow.checking import Checked
    from loopcal.workflow.keeping import Keeper

COMMANDS = {
    **dict.fromkeys(("calibrate", "check", "predict", "compare", "report", "noise"), "commands"),
    "simulate": "commands",
    "study": "studying",
    **dict.fromkeys(("new", "init", "schema"), "commands"),
    "correct": "correct",
    "export": "export",
    "verify": "verification",
    **dict.fromkeys(("update", "history", "fleet"), "life"),
    "performance": "performance",
    "plan": "planning",
    "record": "record",
    "app": "app",
}
"""Command -> module of this folder, in the order of the help."""


def keeper(folder: str | None) -> Keeper | None:
    """What keeps a result in the history of this folder."""
    if folder is None:
        return None
    from loopcal.workflow.history import HistoryKeeper

    return HistoryKeeper(folder)


def cure_of(checked: Checked) -> Cure | None:
    """The poses that would raise a verdict that is not good; None where nothing is known."""
    from loopcal.workflow import curing

    return curing.cure_of(checked)


def loaded(names: Iterable[str]) -> list[CommandInfo]:
    """Of these names the commands, all where none is one."""
    asked = [name for name in names if name in COMMANDS] or [*COMMANDS]
    for module in dict.fromkeys(COMMANDS[name] for name in asked):
        import_module(f"loopcal.cli.{module}")  # its commands join as it is imported
    joined = {name_of(command): command for command in app.registered_commands}
    return [joined[name] for name in asked]


def name_of(command: CommandInfo) -> str:
    """As it is typed."""
    return command.name or str(getattr(command.callback, "__name__", ""))


def with_loops() -> frozenset[str]:
    """The commands that take loops written in Python."""
    hints = {name_of(c): get_type_hints(c.callback, include_extras=True) for c in loaded(())}
    return frozenset(name for name in hints if hints[name].get("mechanism") == FunctionOption)
