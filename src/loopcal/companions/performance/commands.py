"""Pose performance on the command line."""

from __future__ import annotations

from typing import Annotated

from loopcal.cli.application import (
    ForceOption,
    JsonOption,
    app,
    argument,
    choice,
    option,
    out_option,
)
from loopcal.cli.output import print_done


@app.command()
def performance(
    file: Annotated[str, argument("FILE", "Table with a row per measured pose.")],
    commanded: Annotated[
        str | None,
        option("FILE", "Take the commanded poses from this table [default: columns of FILE]."),
    ] = None,
    units: Annotated[
        str | None,
        option(
            "UNITS",
            "Units of columns whose header states none, say mm,deg [default: ask on a "
            "terminal, refuse elsewhere].",
        ),
    ] = None,
    angles: Annotated[
        str | None,
        choice(
            "Meaning of columns a, b, c or rx, ry, rz [default: ask on a terminal, refuse "
            "elsewhere].",
            "rpy",
            "zyx",
            "rotvec",
        ),
    ] = None,
    instrument_sd: Annotated[
        str | None,
        option("SD", 'Sd of one reading, "5 um" or "5 um, 20 urad" [default: not stated].'),
    ] = None,
    frame_sd: Annotated[
        str | None,
        option(
            "SD", 'Sd of the base frame, shift and turn, "20 um, 30 urad" [default: not stated].'
        ),
    ] = None,
    tracker: Annotated[
        str | None,
        option(
            "NAME|FIGURES",
            'Tracker by name, or its maker\'s figures "10 um + 0.3 um/m, 15 um + 6 um/m" '
            "[default: not stated].",
        ),
    ] = None,
    station: Annotated[
        str | None,
        option("X,Y,Z", 'Where the tracker stands, "-2 m, 0.5 m, 1 m" [default: the origin].'),
    ] = None,
    distance: Annotated[
        list[str] | None,
        option(
            "POSE,POSE",
            "Compute AD and RD of this pair; repeatable [default: all pairs up to 5 poses].",
        ),
    ] = None,
    out: Annotated[
        str | None, out_option("FILE", "Write a page with figures here [default: none].")
    ] = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Compute pose accuracy, repeatability and drift of a robot after ISO 9283, with intervals."""
    from loopcal.cli.asking import ask_on_terminal
    from loopcal.companions.performance.instrument import Figures, MeasuringErrors, tracker_of
    from loopcal.companions.performance.performance import run_performance
    from loopcal.files.tables.attained import read_attained

    errors = MeasuringErrors(
        Figures.of(instrument_sd), tracker_of(tracker, station), Figures.of(frame_sd)
    )
    attained = read_attained(
        file, commanded=commanded, units=units, angles=angles, ask=ask_on_terminal()
    )
    done = run_performance(attained, errors, distances=distance or (), out=out)
    print_done(done, as_json, where="" if out is None else f"written to {out}")
