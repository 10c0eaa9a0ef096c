"""Runs the command and ends it: every outcome has its exit code and at most one message.

0 done; 1 a fault of ours, with its traceback; 2 usage; 3 bad input; 4 no trustworthy result;
130 interrupted.
"""

from __future__ import annotations

import copy
import gc
import io
import sys
import warnings
from collections.abc import Sequence

import typer
from typer.models import CommandInfo

from loopcal.cli.app import serve_app
from loopcal.cli.application import app
from loopcal.cli.commands import calibrate
from loopcal.cli.correct import correct
from loopcal.cli.export import export
from loopcal.cli.life import update
from loopcal.cli.output import log, print_error
from loopcal.cli.performance import performance
from loopcal.cli.planning import plan
from loopcal.cli.record import record
from loopcal.errors import LONGEST_TEXT, LoopcalError, short

try:
    from typer.exceptions import Abort, TyperException
except ModuleNotFoundError:  # typer before 0.26 raises the exceptions of click
    from click.exceptions import Abort  # type: ignore[assignment]
    from click.exceptions import ClickException as TyperException  # type: ignore[assignment]

LOADED = (calibrate, correct, export, performance, plan, record, serve_app, update)
"""A command of each module: all commands of a module join as it is imported."""
INTERRUPTED = 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `loopcal ARGUMENTS` (by default those of this process) and return its exit code."""
    gc.set_threshold(50_000, 20, 20)  # what a command makes mostly lives until it ends
    with warnings.catch_warnings():
        warnings.showwarning = lambda message, *_, **__: log(f"warning: {message}")
        return _run(arguments)


def _run(arguments: Sequence[str] | None) -> int:
    try:
        asked = sys.argv[1:] if arguments is None else list(arguments)
        own = _with_command(asked)
        code = own(asked, prog_name="loopcal", standalone_mode=False, obj=main) or 0
    except LoopcalError as error:
        if type(error) is LoopcalError:
            return _fault(error)
        log(str(error))
        return error.exit_code
    except TyperException as error:  # arguments that do not parse
        shown = io.StringIO()
        error.show(file=shown)  # type: ignore[attr-defined]
        print_error(short(shown.getvalue().rstrip("\n"), LONGEST_TEXT))
        return error.exit_code
    except (KeyboardInterrupt, Abort):
        code = INTERRUPTED
    except MemoryError:
        log("out of memory\n  What to do: use fewer poses (data.every thins them)")
        return 3
    except Exception as error:
        return _fault(error)
    if code == INTERRUPTED:
        log("interrupted")
    return int(code)


def _with_command(arguments: Sequence[str]) -> typer.Typer:
    """The application with the command that is asked for, or with all where none is.

    To prepare the options of every command takes longer than a short calibration.
    """
    own = copy.copy(app)
    named = [one for one in app.registered_commands if _name(one) in arguments[:1]]
    own.registered_commands = named or app.registered_commands
    return own


def _name(command: CommandInfo) -> str:
    return command.name or str(getattr(command.callback, "__name__", ""))


def _fault(error: Exception) -> int:
    import platform
    import traceback

    from loopcal.files.versions import versions

    print_error("".join(traceback.format_exception(error)).rstrip("\n"))
    about = ", ".join(f"{name} {number}" for name, number in versions().items())
    log(
        f"this is a fault of loopcal, not of your input: {type(error).__name__}: "
        f"{short(str(error), LONGEST_TEXT)}\n"
        f"  What to do: please report it, with the lines above and: {about}, {platform.platform()}"
    )
    return 1
