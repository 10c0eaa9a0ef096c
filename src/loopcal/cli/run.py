"""Runs the command and ends it: every outcome has its exit code and at most one message.

0 done; 1 a fault of ours, with its traceback; 2 usage; 3 bad input; 4 no trustworthy result;
5 files are written, but not the rest; 130 interrupted.
"""

from __future__ import annotations

import copy
import errno
import gc
import io
import sys
import warnings
from collections.abc import Sequence

import typer

from loopcal.cli.application import app
from loopcal.cli.next_command import after_usage, fill_in
from loopcal.cli.output import log, open_streams, print_error, unprinted
from loopcal.cli.registry import loaded
from loopcal.errors import (
    LONGEST_TEXT,
    NEXT_COMMAND,
    InputError,
    LoopcalError,
    UsageError,
    short,
)
from loopcal.files.outputs import command

try:
    from typer.exceptions import Abort, TyperException
except ModuleNotFoundError:  # typer before 0.26 raises the exceptions of click
    from click.exceptions import Abort  # type: ignore[assignment]
    from click.exceptions import ClickException as TyperException  # type: ignore[assignment]

INTERRUPTED = 130
_SYSTEM = (errno.ENOSPC, errno.EDQUOT, errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.EIO)
"""What no file is to blame for."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `loopcal ARGUMENTS` (by default those of this process) and return its exit code."""
    gc.set_threshold(50_000, 20, 20)  # what a command makes mostly lives until it ends
    open_streams()
    with warnings.catch_warnings():
        warnings.showwarning = lambda message, *_, **__: log(f"warning: {message}")
        with command():
            return _run(arguments)


def _run(arguments: Sequence[str] | None) -> int:
    asked = sys.argv[1:] if arguments is None else list(arguments)
    try:
        if names := [one for one in asked if _is_bytes(one)]:
            raise _no_text(names[0])
        application = _with_command(asked)
        # In standalone mode click would print errors and end the process by itself.
        code = application(asked, prog_name="loopcal", standalone_mode=False, obj=main) or 0
        _flush()
    except LoopcalError as error:
        fill_in(error, asked)
        return _refused(error)
    except TyperException as error:  # arguments that do not parse
        shown = io.StringIO()
        error.show(file=shown)  # type: ignore[attr-defined]
        print_error(shown.getvalue().rstrip("\n"))
        print_error(f"  {NEXT_COMMAND}    {after_usage(error, asked)}")
        return error.exit_code
    except (KeyboardInterrupt, Abort):
        code = INTERRUPTED
    except MemoryError:
        log("out of memory\n  What to do: use fewer poses (data.every thins them)")
        return 3
    except OSError as error:
        return _by_system(error)
    except UnicodeEncodeError as error:
        return _refused(_no_text(error.object)) if _is_bytes(error.object) else _fault(error)
    except BaseException as error:
        if isinstance(error.__context__, BrokenPipeError):  # as typer ends without a reader
            return 0
        return _fault(error)
    if code == INTERRUPTED:
        log("interrupted")
    return int(code)


def _refused(error: LoopcalError) -> int:
    # By itself the root of all errors means a fault of ours; its kinds are refusals.
    if type(error) is LoopcalError:
        return _fault(error)
    log(error.text)
    return error.exit_code


def _flush() -> None:
    """Raise Unfinished where what was printed cannot be written."""
    try:
        sys.stdout.flush()
    except OSError as error:
        unprinted(error)


def _by_system(error: OSError) -> int:
    """How a command ends that the system refused something: an input error if that has a name."""
    try:
        _flush()
    except InputError as refused:
        return _refused(refused)
    if error.filename is None and error.errno not in _SYSTEM:
        return _fault(error)
    why = error.strerror or type(error).__name__
    place = None if error.filename is None else str(error.filename)
    return _refused(
        InputError(
            f"the system refuses this: {why}",
            code="unreadable-file",
            place=place,
            remedy="name another file or folder" if place else "free space or memory",
        )
    )


def _is_bytes(text: str) -> bool:
    """Whether it holds bytes that are no text, as the names of files may."""
    return any("\ud800" <= letter <= "\udfff" for letter in text)


def _no_text(name: str) -> UsageError:
    begin = next(i for i, letter in enumerate(name) if "\ud800" <= letter <= "\udfff")
    return UsageError(
        f"the name {name[max(begin - 40, 0) : begin + 40]!r} is not UTF-8",
        remedy="rename the file or folder",
    )


def _with_command(arguments: Sequence[str]) -> typer.Typer:
    """The application with the command that is asked for, or with all where none is.

    To prepare the options of every command takes longer than a short calibration.
    """
    application = copy.copy(app)
    # the version needs the options of no command
    version = list(arguments[:1]) == ["--version"]
    application.registered_commands = loaded(["calibrate"] if version else arguments[:1])
    return application


def _fault(error: BaseException) -> int:
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
