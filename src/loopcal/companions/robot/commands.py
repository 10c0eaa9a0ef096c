"""The commands `loopcal correct` and `loopcal export`: programs and files for a controller."""

from __future__ import annotations

from typing import Annotated

import typer

from loopcal.cli.application import (
    ForceOption,
    FunctionOption,
    JsonOption,
    LimbOption,
    PulsesOption,
    ResultArgument,
    amounts_of,
    app,
    argument,
    choice,
    numbers_of,
    option,
    out_option,
)
from loopcal.cli.output import print_done
from loopcal.companions.robot.export_files import OFFSETS
from loopcal.companions.robot.exports.registry import EXPORTS
from loopcal.companions.robot.exports.tables import ORIENTATIONS
from loopcal.errors import InputError, UsageError


@app.command()
def correct(
    result: ResultArgument,
    targets: Annotated[str, argument("TARGETS", "Table of targets or robot program.")],
    out: Annotated[
        str | None, out_option("FILE", "Corrected file [default: NAME-corrected].")
    ] = None,
    force: ForceOption = False,
    tool: Annotated[
        str,
        option(
            "TOOL",
            "Tool of the program: 'calibrated', 'nominal', or x,y,z[,rz,ry,rx] on the last "
            "link in mm and degrees.",
        ),
    ] = "calibrated",
    controller: Annotated[
        str | None,
        option(
            "FILE", "Model of the controller: mechanism file or DH table [default: the drawing]."
        ),
    ] = None,
    frame: Annotated[
        str | None,
        option(
            "X,Y,Z,RZ,RY,RX",
            "Frame of Cartesian targets in the base, in mm and degrees [default: the base].",
        ),
    ] = None,
    most_turn: Annotated[
        float,
        option("DEG", "Largest change of a turning joint in degrees.", min=0.0),
    ] = 5.0,
    most_slide: Annotated[float, option("MM", "Largest change of a slide in mm.", min=0.0)] = 50.0,
    least_gain: Annotated[
        float,
        option(
            "VALUE",
            "Smallest singular value of the Jacobian (m and rad) that is not singular.",
            min=0.0,
        ),
    ] = 0.005,
    line: Annotated[
        float | None,
        option(
            "MM",
            "Insert targets until straight moves are off by less [default: none inserted].",
            min=0.0,
        ),
    ] = None,
    pulses_per_degree: PulsesOption = None,
    at: Annotated[
        list[str] | None,
        option("NAME=VALUE", "Constant of the result, such as a temperature."),
    ] = None,
    limb: LimbOption = None,
    as_json: JsonOption = False,
) -> None:
    """Correct the targets of a program so that the real machine reaches its poses."""
    import math

    from loopcal.companions.robot.correct_files import run_correct
    from loopcal.companions.robot.corrected import CorrectionBounds

    done = run_correct(
        result,
        targets,
        out=out,
        tool=tool if tool in ("calibrated", "nominal") else _numbers(tool, "--tool"),
        controller=controller,
        frame=None if frame is None else _numbers(frame, "--frame"),
        bounds=CorrectionBounds(
            math.radians(most_turn),
            1e-3 * most_slide,
            least_gain,
            None if line is None else 1e-3 * line,
        ),
        at=amounts_of(at, "--at", "'temperature=24 degC'"),
        pulses=numbers_of(pulses_per_degree, "--pulses-per-degree"),
        limb=limb,
    )
    where = f"written to {done.written}" if done.written else "nothing is written"
    print_done(done, as_json, text=done.words(), where=where)
    if not done.corrected.done.all():
        # The file is written, so the exit code alone shows that targets were refused.
        raise typer.Exit(4)


def _numbers(text: str, option: str) -> list[float]:
    """Three or six numbers with commas between."""
    numbers = numbers_of(text, option)
    if len(numbers) not in (3, 6):
        raise UsageError(
            f"{option} is {text!r}, which is not three or six numbers with commas between them",
            remedy=f"give {option}=X,Y,Z or {option}=X,Y,Z,RZ,RY,RX in mm and degrees",
        )
    return numbers


# `loopcal export`: a calibrated machine in the format of its controller or simulator.


@app.command()
def export(
    result: ResultArgument,
    to: Annotated[
        str,
        choice(f"Write this format: {', '.join(EXPORTS)}.", *EXPORTS, metavar="FORMAT"),
    ],
    out: Annotated[
        str | None, out_option("FOLDER", "Folder for the files [default: RESULT/export].")
    ] = None,
    force: ForceOption = False,
    source: Annotated[
        str | None,
        option(
            "FILE",
            "Your own file: the URDF to patch (urdf), or the controller's calibration.conf "
            "(ur) [default: none].",
        ),
    ] = None,
    offsets: Annotated[
        str,
        choice(
            "Put zero offsets of joints into the origins (origin) or into offsets.csv (file).",
            *OFFSETS,
            metavar="PLACE",
        ),
    ] = "origin",
    vendor: Annotated[
        str | None,
        choice(
            f"Write orientations in the convention of {', '.join(filter(None, ORIENTATIONS))} "
            f"[default: {ORIENTATIONS[''].label}].",
            *filter(None, ORIENTATIONS),
            metavar="NAME",
        ),
    ] = None,
    counts: Annotated[
        list[str] | None,
        option(
            "JOINT=N",
            "Encoder counts per degree (of a slide per mm) of a joint; repeatable [default: none].",
        ),
    ] = None,
    limb: LimbOption = None,
    as_json: JsonOption = False,
    mechanism: FunctionOption = None,
) -> None:
    """Export a calibrated machine to its controller, robot description or simulator."""
    from loopcal.companions.robot.export_files import run_export

    done = run_export(
        result,
        to,
        out=out,
        function=mechanism,
        source=source,
        offsets=offsets,
        vendor=vendor,
        counts=dict(map(_counts, counts or ())),
        limb=limb,
    )
    print_done(done, as_json)


def _counts(text: str) -> tuple[str, float]:
    """A joint and its counts per unit, of JOINT=N."""
    # The last one: the name of a joint may hold an equals sign.
    joint, _, number = text.rpartition("=")
    try:
        value = float(number)
    except ValueError:
        value = 0.0
    if not joint or not 0.0 < abs(value) < float("inf"):
        raise InputError(
            f"--counts {text!r} is not JOINT=N with a number N",
            code="invalid-value",
            remedy="write, for example, --counts joint_1=1234.5",
        )
    return joint, value
