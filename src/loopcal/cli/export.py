"""`loopcal export`: a calibrated machine in the format of its controller or simulator."""

from __future__ import annotations

from typing import Annotated

import typer

from loopcal.cli.application import FunctionOption, JsonOption, app
from loopcal.cli.output import print_json, print_out
from loopcal.errors import InputError


@app.command()
def export(
    result: Annotated[
        str, typer.Argument(metavar="RESULT", help="Folder of a calibration, or its result.json.")
    ],
    to: Annotated[
        str,
        typer.Option(
            metavar="FORMAT",
            help="Write this format: urdf, xacro, ur, dh, mdh, mjcf, sdf, zeros, frames or json.",
        ),
    ],
    out: Annotated[
        str | None,
        typer.Option(metavar="FOLDER", help="Folder for the files [default: RESULT/export]."),
    ] = None,
    source: Annotated[
        str | None,
        typer.Option(
            metavar="FILE",
            help="Your own file: the URDF to patch (urdf), or the controller's calibration.conf "
            "(ur) [default: none].",
        ),
    ] = None,
    offsets: Annotated[
        str,
        typer.Option(
            metavar="PLACE",
            help="Put zero offsets of joints into the origins (origin) or into offsets.csv (file).",
        ),
    ] = "origin",
    vendor: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Write orientations in the convention of kuka, fanuc, yaskawa or abb [default: "
            "roll, pitch, yaw].",
        ),
    ] = None,
    counts: Annotated[
        list[str] | None,
        typer.Option(
            metavar="JOINT=N",
            help="Encoder counts per degree (of a slide per mm) of a joint; repeatable [default: "
            "none].",
        ),
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Replace files that exist; backups are kept.")
    ] = False,
    as_json: JsonOption = False,
    mechanism: FunctionOption = None,
) -> None:
    """Export a calibrated machine to its controller, robot description or simulator."""
    from loopcal.workflow.exporting import run_export

    done = run_export(
        result,
        to,
        out=out,
        function=mechanism,
        source=source,
        offsets=offsets,
        vendor=vendor,
        counts=dict(map(_counts, counts or ())),
        force=force,
    )
    if as_json:
        print_json(done.document())
    else:
        print_out(str(done))


def _counts(text: str) -> tuple[str, float]:
    """A joint and its counts per unit, of JOINT=N."""
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
