"""Calibration records on the command line."""

from __future__ import annotations

from typing import Annotated

from loopcal.cli.application import ForceOption, JsonOption, app, argument, flag, option, out_option
from loopcal.cli.output import print_done
from loopcal.errors import NoTrustworthyResult, UsageError


@app.command()
def record(
    result: Annotated[
        str,
        argument(
            "RESULT", "Folder of a calibration; with --verify also a record.html or record.xml."
        ),
    ],
    project: Annotated[
        str | None,
        option(
            "FILE", "Take [record] from this project file as it is now [default: that of RESULT]."
        ),
    ] = None,
    out: Annotated[
        str | None,
        out_option("FILE", "Write the page here [default: record.html in the result folder]."),
    ] = None,
    force: ForceOption = False,
    dcc: Annotated[
        bool,
        flag("--dcc", "Write also a digital calibration certificate, XML beside it."),
    ] = False,
    schema: Annotated[
        str | None,
        option("FILE", "Write only what validates against this dcc.xsd; implies --dcc."),
    ] = None,
    verify: Annotated[
        bool,
        flag("--verify", "Check whether a record and its files are unaltered."),
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Write the calibration record of a result for print, or check one."""
    from loopcal.companions.record.record import record as write_record
    from loopcal.companions.record.record import verify_record

    if not verify:
        dcc = dcc or schema is not None
        done = write_record(result, project=project, out=out, dcc=dcc, schema=schema)
        print_done(done, as_json)
        return
    if project is not None or out is not None or dcc or schema is not None:
        raise UsageError(
            "--verify checks a record and writes none",
            remedy="leave --project, --out, --dcc and --schema out",
        )
    check = verify_record(result)
    print_done(check, as_json)
    if not check.unaltered:
        raise NoTrustworthyResult(
            "the record or a file behind it is not as it was",
            code="not-verified",
            remedy="restore the files, or write a new record",
        )
