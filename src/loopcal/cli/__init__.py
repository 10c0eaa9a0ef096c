"""The command `loopcal`: arguments in, printed text and an exit code out."""

from loopcal.cli.run import main

__all__ = ["main"]
