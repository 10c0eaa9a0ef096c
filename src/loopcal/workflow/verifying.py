"""A calibration on the disk checked against readings of another day."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from loopcal.errors import InputError
from loopcal.files.atomic import Data, write_all
from loopcal.files.result.deployed import VERIFICATION, note_deployed, project_beside
from loopcal.statistics.replacing import freed, mounted
from loopcal.statistics.verification import verify
from loopcal.statistics.verified import Verification
from loopcal.workflow.keeping import Keeper, Writer
from loopcal.workflow.projects import refuse_tolerance
from loopcal.workflow.readings import Files, first_of, later_readings
from loopcal.workflow.saved_result import read_result


def run_verification(
    result: str | Path,
    readings: Files,
    *,
    remounted: bool = False,
    anew: Sequence[str] = (),
    tolerance: float | None = None,
    out: str | Path | None = None,
    keeper: Keeper | None = None,
    function: str | None = None,
) -> Verification:
    """Check a result against readings in the columns of its project, or those of another result.

    readings: one file, or several in the layout of the project's first ones;
    remounted: everything that instruments look at; anew: further instruments, targets or
    parameters; tolerance: [m]; out: file of a page with figures; keeper: keeps this too.
    Raises InputError for what cannot be used.
    """
    if keeper is not None:
        keeper.refuse()
    read = read_result(result, mechanism=function)
    refuse_tolerance(read.mechanism, tolerance)
    changed = (*mounted(read.mechanism, remounted), *anew)
    freed(read.mechanism, changed)  # raises for a name that is not there
    data, first = later_readings(read, readings, None, whole=True), first_of(readings)
    try:
        verification = verify(read.calibrated, data, remounted=changed, tolerance=tolerance)
    except InputError as error:
        raise error.at(str(first)) from None
    typed = {"result": str(result), "readings": str(first), **project_beside(read.path.parent)}
    verification = replace(verification, files=typed)
    files: dict[Path, Data] = {}
    if out is not None:
        from loopcal.report.verification_page import verification_html

        names = f"{read.path.parent.name}, {Path(first).name}"
        files[Path(out)] = verification_html(verification, read.mechanism.name, names)
    write: Writer = write_all
    if keeper is not None:
        write = keeper.of_verification(verification, result, first, data.source.measured)
    write(files)
    if keeper is not None:
        keeper.note(result)
    name = Path(first)
    document = {"readings": name.name, **verification.document()}
    note_deployed(read.path, VERIFICATION, name.stem, document)
    return verification
