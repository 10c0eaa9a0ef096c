"""`loopcal export`: a calibrated machine in the format of its controller or simulator."""

from __future__ import annotations

from typing import Annotated

from loopcal.cli.application import (
    ForceOption,
    FunctionOption,
    JsonOption,
    LimbOption,
    ResultArgument,
    app,
    choice,
    option,
    out_option,
)
from loopcal.cli.output import print_done
from loopcal.companions.robot.export_files import OFFSETS
from loopcal.companions.robot.exports.registry import EXPORTS
from loopcal.companions.robot.exports.tables import ORIENTATIONS
from loopcal.errors import InputError


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
