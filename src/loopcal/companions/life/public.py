"""Updates in Python: paths wherever they take values."""

from __future__ import annotations

from collections.abc import Callable

from loopcal.companions.life import updating
from loopcal.workflow.public import on_result
from loopcal.workflow.result import Result

update: Callable[..., Result] = on_result(updating.update, "calibrated", whole=True)
