"""Running the command as a user would, without colours: in a process of its own, or in this one."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from collections.abc import Mapping
from contextlib import chdir, redirect_stderr, redirect_stdout
from pathlib import Path
from unittest.mock import patch

from loopcal.cli import main

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


def run_here(
    *arguments: str | Path, cwd: Path | None = None, together: bool = False
) -> subprocess.CompletedProcess[str]:
    """As `run`, in this process, which has loaded already what the command needs.

    together: stderr follows in stdout as it would in a terminal.
    """
    out = io.StringIO()
    err = out if together else io.StringIO()
    words = [str(argument) for argument in arguments]
    with (
        chdir(cwd or "."),
        patch.dict(os.environ, environment()),
        redirect_stdout(out),
        redirect_stderr(err),
    ):
        code = main(words)
    return subprocess.CompletedProcess(words, code, out.getvalue(), err.getvalue())
