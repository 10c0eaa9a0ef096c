"""The command `loopcal`: arguments in, printed text and an exit code out."""

from __future__ import annotations

import sys
from collections.abc import Sequence

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `loopcal ARGUMENTS` (`loopcal.cli.run`), which may be interrupted while it is loaded."""
    try:
        from loopcal.cli import run

        return run.main(arguments)
    except KeyboardInterrupt:
        print("loopcal: interrupted", file=sys.stderr)
        return 130
