"""The command that verifies a calibration on another day."""

from __future__ import annotations

from typing import Annotated

from loopcal.cli.application import (
    AnewOption,
    DateOption,
    ForceOption,
    FullOption,
    FunctionOption,
    HistoryOption,
    JsonOption,
    ReadingsArgument,
    RemountedOption,
    ResultArgument,
    app,
    option,
    out_option,
)
from loopcal.cli.output import log, print_done
from loopcal.cli.registry import keeper
from loopcal.errors import NoTrustworthyResult


@app.command()
def verify(
    result: ResultArgument,
    file: ReadingsArgument,
    remounted: RemountedOption = False,
    anew: AnewOption = None,
    tolerance: Annotated[
        float | None,
        option("MM", "Require that 95 % of poses lie within this distance [default: none]."),
    ] = None,
    out: Annotated[
        str | None, out_option("FILE", "Write a page with figures to this file [default: none].")
    ] = None,
    force: ForceOption = False,
    machine_history: HistoryOption = None,
    date: DateOption = None,
    as_json: JsonOption = False,
    full: FullOption = False,
    mechanism: FunctionOption = None,
) -> None:
    """Verify a calibration with readings of another day, the instrument placed anew."""
    from loopcal.workflow.verifying import run_verification

    done = run_verification(
        result,
        file,
        remounted=remounted,
        anew=anew or (),
        tolerance=None if tolerance is None else 1e-3 * tolerance,
        out=out,
        keeper=keeper(machine_history, date),
        function=mechanism,
    )
    print_done(done, as_json, full=full)
    if out is not None:
        log(f"written to {out}")
    if done.failed:
        reasons = " ".join(answer.words for answer in done.failed)
        raise NoTrustworthyResult(
            reasons, code="not-verified", remedy=" ".join(a.next for a in done.failed if a.next)
        )
