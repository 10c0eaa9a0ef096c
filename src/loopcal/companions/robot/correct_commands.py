"""The command that corrects the targets of a robot program."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import typer

from loopcal.cli.application import (
    ForceOption,
    JsonOption,
    LimbOption,
    PulsesOption,
    ResultArgument,
    app,
    argument,
    numbers_of,
    option,
    out_option,
)
from loopcal.cli.output import print_done
from loopcal.errors import UsageError


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
        at=_constants(at or []),
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


def _constants(stated: Sequence[str]) -> dict[str, float]:
    """NAME=VALUE or NAME=VALUE UNIT as SI."""
    from loopcal.units import to_si

    constants = {}
    for one in stated:
        name, _, value = one.partition("=")
        number, _, unit = value.strip().partition(" ")
        try:
            constants[name.strip()] = float(to_si(float(number), unit.strip() or "1"))
        except ValueError:
            raise UsageError(
                f"--at is {one!r}, which is not NAME=VALUE",
                remedy="give a number, with its unit if it is not SI: --at 'temperature=24 degC'",
            ) from None
    return constants
