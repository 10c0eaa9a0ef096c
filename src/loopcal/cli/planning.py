"""The command that chooses poses to measure."""

from __future__ import annotations

from typing import Annotated

import typer

from loopcal.cli.application import (
    FunctionOption,
    JsonOption,
    ProjectArgument,
    PulsesOption,
    app,
    numbers_of,
)
from loopcal.cli.output import log, print_json, print_out


@app.command()
def plan(
    project: ProjectArgument,
    poses: Annotated[
        int, typer.Option(metavar="N", min=1, help="Choose so many poses [default: 30].")
    ] = 30,
    candidates: Annotated[
        str | None,
        typer.Option(
            metavar="FILE",
            help="Choose among these poses, in the columns of the project [default: random poses "
            "within the joints' limits].",
        ),
    ] = None,
    criterion: Annotated[
        str | None,
        typer.Option(
            metavar="I|G|D|A",
            help="Minimise the mean (I) or largest (G) variance of the end point, the determinant "
            "(D) or trace (A) of the covariance of the parameters [default: I, without an end "
            "point D].",
        ),
    ] = None,
    existing: Annotated[
        str | None,
        typer.Option(
            metavar="RESULT|FILE",
            help="Add to these poses: a result of a calibration, or readings [default: none].",
        ),
    ] = None,
    out: Annotated[
        str | None,
        typer.Option(
            metavar="DIR",
            help="Write the plan to this folder [default: NAME-plan beside NAME.toml].",
        ),
    ] = None,
    program: Annotated[
        str | None,
        typer.Option(
            metavar="FILE",
            help="Write the poses as a program too: .mod (RAPID), .src (KRL), .ls (Fanuc), .jbi "
            "(Yaskawa) or .script (URScript) [default: none].",
        ),
    ] = None,
    pulses_per_degree: PulsesOption = None,
    force: Annotated[
        bool, typer.Option("--force", help="Replace the program where it exists.")
    ] = False,
    as_json: JsonOption = False,
    mechanism: FunctionOption = None,
    no_report: Annotated[
        bool, typer.Option("--no-report", help="Skip plan.html and delete an existing one.")
    ] = False,
) -> None:
    """Choose the poses to measure; write plan.csv, plan.json and plan.html."""
    from loopcal.cli.progress import Progress
    from loopcal.workflow.planning import PlanRequest, run_plan

    with Progress() as progress:
        done = run_plan(
            project,
            PlanRequest(
                poses,
                criterion,
                candidates,
                existing,
                not no_report,
                program,
                numbers_of(pulses_per_degree, "--pulses-per-degree"),
                force,
            ),
            out=out,
            function=mechanism,
            progress=lambda tried, total: progress.pieces("poses chosen or tried", tried, total),
        )
    where = f"written to {done.folder}: {', '.join(done.files)}"
    where += "" if done.program is None else f"\nprogram: {done.program}"
    if as_json:
        print_json({"title": done.title, **done.plan.document()})
        log(where)
    else:
        print_out(f"{done.title}\n{done.plan}\n\n{where}")
