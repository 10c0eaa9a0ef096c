"""An action of the app: a command line of loopcal in the project's folder."""

from __future__ import annotations

import shlex
from dataclasses import dataclass


@dataclass(frozen=True)
class Action:
    """words: what follows `loopcal` on the command line; what: a few words for the user.

    Whoever types `command` in the folder gets the same files.
    """

    what: str
    words: tuple[str, ...]

    @property
    def command(self) -> str:
        """As it is typed."""
        return f"loopcal {shlex.join(self.words)}"
