"""Running the installed command as a user would: in a process of its own, without colours."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

FORCING_COLOUR = ("FORCE_COLOR", "CLICOLOR_FORCE", "PY_COLORS", "GITHUB_ACTIONS", "TTY_COMPATIBLE")


def environment(**extra: str) -> dict[str, str]:
    """This process's environment, with plain text 100 columns wide and our own `loopcal` first."""
    kept = {name: value for name, value in os.environ.items() if name not in FORCING_COLOUR}
    path = os.pathsep.join([str(Path(sys.executable).parent), kept.get("PATH", "")])
    plain = {"NO_COLOR": "1", "COLUMNS": "100", "PYTHONIOENCODING": "utf-8", "PATH": path}
    return kept | plain | extra


def run(
    *arguments: str | Path,
    cwd: Path | None = None,
    stdin: str = "",
    env: Mapping[str, str] | None = None,
    timeout: float = 300,
) -> subprocess.CompletedProcess[str]:
    """Exit code, stdout and stderr of `loopcal ARGUMENTS`; `env` adds to the environment."""
    return subprocess.run(
        [sys.executable, "-m", "loopcal", *map(str, arguments)],
        cwd=cwd,
        input=stdin,
        env=environment(**(env or {})),
        capture_output=True,
        encoding="utf-8",
        timeout=timeout,
        check=False,
    )
