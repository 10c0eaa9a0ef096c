"""The command of Monte Carlo studies."""

from __future__ import annotations

from typing import Annotated

from loopcal.cli.application import (
    ClusterOption,
    ForceOption,
    FunctionOption,
    JsonOption,
    app,
    argument,
    option,
    out_option,
)
from loopcal.cli.output import print_done


@app.command()
def study(
    study: Annotated[str, argument("STUDY", "Study file (TOML); - reads standard input.")],
    draws: Annotated[
        int | None,
        option("N", "Draws per scenario [default: the study's].", min=1),
    ] = None,
    workers: Annotated[
        int | None,
        option("N", "Compute on N processes [default: one per core].", min=1),
    ] = None,
    cluster: ClusterOption = None,
    out: Annotated[
        str | None,
        out_option(
            "DIR",
            "Write the draws to this folder, and resume from those in it [default: "
            "NAME-study beside NAME.toml].",
        ),
    ] = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
    mechanism: FunctionOption = None,
) -> None:
    """Run a Monte Carlo study: errors of one or more methods over many draws per scenario."""
    from loopcal.cli.progress import Counted, executor_of, try_cluster
    from loopcal.report.study_page import PAGE, write_study_page
    from loopcal.studies.run import run_study

    executor = executor_of(workers, cluster)
    with Counted() as progress:
        done = run_study(
            study,
            draws=draws,
            executor=executor,
            sharing=try_cluster,
            out=out,
            function=mechanism,
            progress=progress,
        )
    write_study_page(done)
    where = f"written to {done.folder}: draws.parquet, summary.json, summary.txt, {PAGE}"
    print_done(done, as_json, text=done.text, where=where)
