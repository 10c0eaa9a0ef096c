"""The command that chooses poses to measure."""

from __future__ import annotations

from typing import Annotated

from loopcal.cli.application import (
    ForceOption,
    FullOption,
    FunctionOption,
    JsonOption,
    ProjectArgument,
    PulsesOption,
    app,
    choice,
    flag,
    numbers_of,
    option,
    out_option,
)
from loopcal.cli.output import print_done
from loopcal.companions.planning.planned import CRITERIA
from loopcal.companions.robot.programs.registry import WRITTEN


@app.command()
def plan(
    project: ProjectArgument,
    poses: Annotated[int, option("N", "Choose so many poses [default: 30].", min=1)] = 30,
    candidates: Annotated[
        str | None,
        option(
            "FILE",
            "Choose among these poses, in the columns of the project [default: random poses "
            "within the joints' limits, else over the ranges of the project's readings].",
        ),
    ] = None,
    criterion: Annotated[
        str | None,
        choice(
            "Minimise the mean (I) or largest (G) variance of the end point, the determinant "
            "(D) or trace (A) of the covariance of the parameters [default: I, without an end "
            "point D].",
            *CRITERIA,
        ),
    ] = None,
    existing: Annotated[
        str | None,
        option(
            "RESULT|FILE",
            "Add to these poses: a result of a calibration, or readings [default: none].",
        ),
    ] = None,
    out: Annotated[
        str | None,
        out_option("DIR", "Write the plan to this folder [default: NAME-plan beside NAME.toml]."),
    ] = None,
    force: ForceOption = False,
    program: Annotated[
        str | None,
        option(
            "FILE",
            "Write the poses as a program too: "
            + ", ".join(f"{ending} ({one.kind})" for ending, one in WRITTEN.items())
            + " [default: none].",
        ),
    ] = None,
    pulses_per_degree: PulsesOption = None,
    as_json: JsonOption = False,
    full: FullOption = False,
    mechanism: FunctionOption = None,
    no_report: Annotated[
        bool, flag("--no-report", "Skip plan.html and delete an existing one.")
    ] = False,
) -> None:
    """Choose the poses to measure; write plan.csv, plan.json and plan.html."""
    from loopcal.cli.progress import Progress
    from loopcal.companions.planning.plan_files import PlanRequest, run_plan

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
            ),
            out=out,
            function=mechanism,
            progress=lambda tried, total: progress.pieces("poses chosen or tried", tried, total),
        )
    where = f"written to {done.folder}: {', '.join(done.files)}"
    where += "" if done.program is None else f"\nprogram: {done.program}"
    print_done(done, as_json, text=f"{done.title}\n{done.plan}", where=where, full=full)
