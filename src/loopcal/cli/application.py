"""The application that commands join, and the options that several of them take."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Annotated, Any

import typer

from loopcal.cli.output import print_out
from loopcal.errors import UsageError, nearest
from loopcal.files.outputs import force_outputs
from loopcal.measurements.days import Days

app = typer.Typer(
    name="loopcal",
    help="Calibrate mechanisms from closed kinematic loops, with every sensor uncertain.",
    epilog="Exit codes: 0 done, 1 a fault of loopcal, 2 usage, 3 bad input, 4 no trustworthy "
    "result, 5 files are written but not the rest. Data go to stdout, everything else to stderr.",
    no_args_is_help=True,
    # Brackets in help texts are text.
    rich_markup_mode=None,
    # `cli.run` shows exceptions, and ends each with its exit code.
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def argument(metavar: str, words: str) -> Any:
    """An argument of a command."""
    return typer.Argument(metavar=metavar, help=words)


def option(metavar: str, words: str, *names: str, **more: Any) -> Any:
    """An option with a value; names: where that of the parameter does not serve; more: of typer."""
    return typer.Option(*names, metavar=metavar, help=words, **more)


def choice(words: str, *values: str, metavar: str = "") -> Any:
    """An option that takes one of these values; another one is an error of usage."""

    def one_of(option: typer.CallbackParam, value: str | None) -> str | None:
        if value is not None and value not in values:
            raise UsageError(
                f"{option.opts[0]} cannot be {value!r}",
                code="unknown-name",
                remedy=nearest(value, values),
            )
        return value

    return option(metavar or "|".join(values), words, callback=one_of)


def flag(name: str, words: str, **more: Any) -> Any:
    """An option without a value."""
    return typer.Option(name, help=words, **more)


ProjectArgument = Annotated[
    str, argument("PROJECT", "Project file (TOML); - reads standard input.")
]
ResultArgument = Annotated[str, argument("RESULT", "Folder of a calibration, or its result.json.")]
FullOption = Annotated[bool, flag("--full", "Print everything, where it is more than one screen.")]
JsonOption = Annotated[bool, flag("--json", "Print one JSON document instead of text.")]
FunctionOption = Annotated[
    str | None,
    option(
        "FILE.py:NAME",
        "Use these loops f(x, p), or this Mechanism, for a project of type 'function'.",
        "--mechanism",
    ),
]


def _named(option: typer.CallbackParam, value: str | None) -> str | None:
    if value is not None and not value.strip():
        raise UsageError(
            f"{option.opts[0]} is empty",
            code="invalid-value",
            remedy="name a file or folder, or remove the option",
        )
    return value


ReadingsArgument = Annotated[
    list[str],
    argument(
        "FILE...",
        "Readings of another day in the columns of the project or the layout of its first files, "
        "or another result.",
    ),
]
RemountedOption = Annotated[
    bool,
    flag("--remounted", "Estimate everything that is mounted on the machine anew."),
]
AnewOption = Annotated[
    list[str] | None,
    option(
        "NAME",
        "Estimate this instrument's target, target or parameter anew; repeatable [default: none].",
    ),
]
HistoryOption = Annotated[
    str | None,
    option(
        "FOLDER",
        "Add what was found to this history of the machine [default: none].",
        "--history",
        callback=_named,
    ),
]
DateOption = Annotated[
    str | None,
    option(
        "DATE",
        "Day of the measurement, as 2026-03-01 [default: a column of dates in the readings, else "
        "[record] date of the project].",
        "--date",
    ),
]
NoReportOption = Annotated[
    bool, flag("--no-report", "Skip report.html and delete an existing one.")
]
WorkersOption = Annotated[
    int | None,
    option("N", "Compute folds, models, profiles or chunks on N threads [default: 1].", min=1),
]
ClusterOption = Annotated[
    str | None,
    option(
        "ADDRESS",
        "Compute on a Dask cluster: tcp://HOST:PORT, or the scheduler's file [default: here].",
    ),
]
LimbOption = Annotated[
    str | None,
    option("BODY", "Of a robot of several limbs, the body at the end of the one that is meant."),
]
PulsesOption = Annotated[
    str | None,
    option(
        "N,N,...",
        "Pulses per degree of each joint (of a slide per mm), for programs in pulses.",
        "--pulses-per-degree",
    ),
]


def out_option(metavar: str, words: str) -> Any:
    """The option --out of a command; metavar: FILE or DIR."""
    return typer.Option("--out", metavar=metavar, help=words, callback=_named)


def _forced(asked: bool) -> bool:
    if asked:
        force_outputs()
    return asked


ForceOption = Annotated[
    bool,
    flag(
        "--force",
        "Replace files that loopcal did not write; each is kept as NAME.bak.",
        callback=_forced,
    ),
]


def numbers_of(text: str | None, option: str) -> list[float]:
    """Numbers with commas between; none of None. Raises UsageError where one is no number."""
    try:
        return [] if text is None else [float(part) for part in text.split(",")]
    except ValueError:
        raise UsageError(
            f"{option} is {text!r}, which is not a list of numbers with commas between them",
            remedy=f"give {option}=1,2.5,-3",
        ) from None


# Possessive: no text makes the match back out (docs/decisions/0137).
_AMOUNT = re.compile(r"([^=]++)=\s*+([-+.\deE]++)\s*+(\S.*)?")


def amounts_of(
    stated: Sequence[str] | None, option: str, example: str, *, sds: bool = False
) -> dict[str, float]:
    """Name -> SI value of each NAME=VALUE UNIT; sds: whether these are sds, which need their unit.

    Raises UsageError for a text that is none.
    """
    from loopcal.units import difference_to_si, to_si

    amounts = {}
    for one in stated or ():
        match = _AMOUNT.fullmatch(one.strip())
        try:
            if match is None or (sds and not match[3]):
                raise ValueError
            value, unit = float(match[2]), match[3] or "1"
        except ValueError:
            raise UsageError(
                f"{option} is {one!r}, which is not NAME=VALUE with a unit",
                code="invalid-value",
                remedy=f"give a number and its unit: {option} {example}",
            ) from None
        amounts[match[1].strip()] = float((difference_to_si if sds else to_si)(value, unit))
    return amounts


def days_of(text: str | None) -> Days | None:
    """The days of --date; None of None. Raises UsageError for a text that is no day."""
    days = None if text is None else Days.of_text(text)
    if text is not None and days is None:
        raise UsageError(
            f"--date is {text!r}, which is no day",
            code="invalid-value",
            remedy='write it as 2026-03-01, or as "2026-03-01 to 2026-03-02"',
        )
    return days


def days_of_history(folder: str | None, text: str | None) -> Days | None:
    """The days of --date beside --history. Raises UsageError where no history is named."""
    if text is not None and folder is None:
        raise UsageError(
            "--date dates an entry of a history, and none is named",
            remedy="add --history FOLDER, or leave --date out",
        )
    return days_of(text)


def _version(asked: bool) -> None:
    if asked:
        from loopcal.files.versions import version_and_engine

        print_out(version_and_engine())
        raise typer.Exit


@app.callback()
def _common(
    version: Annotated[
        bool,
        # Eager: --version needs no command.
        typer.Option("--version", callback=_version, is_eager=True, help="Print the version."),
    ] = False,
) -> None:
    """Options before any command."""
