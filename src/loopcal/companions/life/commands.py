"""The commands of a machine's life: update, history, fleet."""

from __future__ import annotations

from typing import Annotated

from loopcal.cli.application import (
    AnewOption,
    DateOption,
    ForceOption,
    FunctionOption,
    HistoryOption,
    JsonOption,
    NoReportOption,
    ReadingsArgument,
    RemountedOption,
    ResultArgument,
    amounts_of,
    app,
    argument,
    days_of,
    days_of_history,
    flag,
    option,
    out_option,
)
from loopcal.cli.output import log, print_done
from loopcal.errors import NoTrustworthyResult


@app.command()
def update(
    result: ResultArgument,
    file: ReadingsArgument,
    out: Annotated[
        str | None, out_option("FOLDER", "Folder for the new result [default: RESULT-updated].")
    ] = None,
    force: ForceOption = False,
    drift: Annotated[
        list[str] | None,
        option(
            "ROLE=SD",
            "Allow this drift since: length=0.01mm, zero=20urad, mounting, scale, effect, "
            "a joint (its zero) or a parameter; repeatable [default: the rates of --history, "
            "else none].",
        ),
    ] = None,
    same_place: Annotated[
        bool,
        flag("--same-place", "Keep the placement: the instrument was not moved."),
    ] = False,
    remounted: RemountedOption = False,
    anew: AnewOption = None,
    no_report: NoReportOption = False,
    machine_history: HistoryOption = None,
    date: DateOption = None,
    as_json: JsonOption = False,
    mechanism: FunctionOption = None,
) -> None:
    """Update a calibration with readings of another day, beginning from what it knows."""
    from loopcal.companions.life.history_files import HistoryKeeper
    from loopcal.companions.life.update_files import Mounted, run_update

    days = days_of_history(machine_history, date)
    done = run_update(
        result,
        file,
        out=out,
        mounting=Mounted(not same_place, remounted, anew or ()),
        drift=amounts_of(drift, "--drift", "length=0.01mm", sds=True),
        history=None if machine_history is None else HistoryKeeper(machine_history, days),
        report=not no_report,
        function=mechanism,
    )
    where = f"written to {done.written.folder}: {', '.join(done.written.files)}"
    if done.drift and not drift:
        log(f"drift since the last calibration, from {machine_history}: {len(done.drift)} rates")
    print_done(done.written.document, as_json, where=where)
    if done.objection is not None:
        raise NoTrustworthyResult(f"no trustworthy result: {done.objection}")


@app.command()
def history(
    folder: Annotated[str, argument("FOLDER", "Folder of the history.")] = "machine.history",
    add: Annotated[
        list[str] | None,
        option("RESULT", "Add this calibration; repeatable [default: none]."),
    ] = None,
    event: Annotated[
        list[str] | None,
        option("TEXT", "Add this event; repeatable [default: none]."),
    ] = None,
    date: Annotated[
        str | None,
        option(
            "DATE",
            "Day of what is added, as 2026-03-01 [default: of a calibration a column of dates in "
            "its readings, else [record] date; of an event today].",
        ),
    ] = None,
    out: Annotated[
        str | None, out_option("FILE", "Write the page to this file [default: FOLDER.html].")
    ] = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Print and draw a machine's history, or add a calibration or an event to it."""
    from loopcal.companions.life.history_files import run_history

    done = run_history(folder, add=add or (), events=event or (), stated=days_of(date), out=out)
    print_done(done.history, as_json, where=f"written to {done.page}")


@app.command()
def fleet(
    results: Annotated[
        list[str],
        argument("RESULT...", "Folders of calibrations, one of each machine, at least 3."),
    ],
    out: Annotated[
        str,
        out_option(
            "FILE", "Write where the next machine begins to this file [default: fleet.toml]."
        ),
    ] = "fleet.toml",
    force: ForceOption = False,
    no_report: Annotated[bool, flag("--no-report", "Skip the page beside it, fleet.html.")] = False,
    as_json: JsonOption = False,
    mechanism: FunctionOption = None,
) -> None:
    """Compare machines of one type: mean and spread, unusual machines, poses for the next one."""
    from loopcal.companions.life.fleet_files import run_fleet

    done = run_fleet(results, out=out, report=not no_report, function=mechanism)
    where = f"written to {' and '.join(str(path) for path in done.written)}"
    print_done(done.fleet, as_json, where=where)
