"""What stands beside the core: each folder imports the core, and the core imports none of them.

Where a command of the core goes on beside it, it calls a companion by its name, as it calls the
commands that companions bring (`loopcal.cli.registry`).
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

CALLED = {
    "HistoryKeeper": "life.history_files",
    "correct": "robot.correct_files",
    "cure_of": "planning.cure",
    "export": "robot.export_files",
    "new_performance": "performance.performance",
    "sections": "life.report_sections",
    "tool_poses": "robot.correct_files",
}
"""What the core calls -> its module."""


def load(module: str) -> Any:
    """A module of a companion."""
    return import_module(f"loopcal.companions.{module}")


def called(name: str) -> Any:
    """What the core calls by this name."""
    return getattr(load(CALLED[name]), name)
