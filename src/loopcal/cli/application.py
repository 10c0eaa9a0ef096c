"""The application that commands join, and the options that several of them take."""

from __future__ import annotations

from typing import Annotated

import typer

from loopcal.cli.output import print_out
from loopcal.errors import UsageError

app = typer.Typer(
    name="loopcal",
    help="Calibrate mechanisms from closed kinematic loops, with every sensor uncertain.",
    epilog="Exit codes: 0 done, 1 a fault of loopcal, 2 usage, 3 bad input, 4 no trustworthy "
    "result. Data go to stdout, everything else to stderr.",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

ProjectArgument = Annotated[
    str, typer.Argument(metavar="PROJECT", help="Project file (TOML); - reads standard input.")
]
JsonOption = Annotated[
    bool, typer.Option("--json", help="Print one JSON document instead of text.")
]
FunctionOption = Annotated[
    str | None,
    typer.Option(
        "--mechanism",
        metavar="FILE.py:NAME",
        help="Use these loops f(x, p), or this Mechanism, for a project of type 'function'.",
    ),
]
HistoryOption = Annotated[
    str | None,
    typer.Option(
        "--history",
        metavar="FOLDER",
        help="Add what was found to this history of the machine [default: none].",
    ),
]
WorkersOption = Annotated[
    int | None,
    typer.Option(
        metavar="N",
        min=1,
        help="Compute folds, models, profiles or chunks on N threads [default: 1].",
    ),
]
ClusterOption = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS",
        help="Compute on a Dask cluster: tcp://HOST:PORT, or the scheduler's file [default: here].",
    ),
]
PulsesOption = Annotated[
    str | None,
    typer.Option(
        "--pulses-per-degree",
        metavar="N,N,...",
        help="Pulses per degree of each joint (of a slide per mm), for programs in pulses.",
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


def _version(asked: bool) -> None:
    if asked:
        from loopcal.files.versions import version_and_engine

        print_out(version_and_engine())
        raise typer.Exit


@app.callback()
def _common(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_version, is_eager=True, help="Print the version."),
    ] = False,
) -> None:
    """Options before any command."""
