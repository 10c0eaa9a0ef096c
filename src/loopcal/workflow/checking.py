"""The commands check, predict and verify."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from loopcal.errors import InputError
from loopcal.estimation.plausible import refuse_other_units
from loopcal.files.atomic import Data, write_all, write_files
from loopcal.files.project.project_file import Project
from loopcal.files.project.stream import load_sample
from loopcal.files.result.deployed import VERIFICATION, note_deployed, project_beside
from loopcal.files.tables.writer import check_ending, table_bytes
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise
from loopcal.statistics.check import Check, check
from loopcal.statistics.prediction import Prediction, predict
from loopcal.statistics.replacing import freed, mounted
from loopcal.statistics.verification import verify
from loopcal.statistics.verified import Verification
from loopcal.workflow.keeping import Keeper, Writer
from loopcal.workflow.projects import named_project, project_files, refuse_tolerance
from loopcal.workflow.readings import Files, first_of, later_readings, new_readings
from loopcal.workflow.saved_result import read_result


@dataclass(frozen=True, eq=False)
class Checked:
    """A project that was looked at before any fit; warnings: about its readings.

    data, noise: the readings of it that were looked at, and their sds, None where they are not
    needed.
    """

    check: Check
    project: Project
    data: Dataset
    noise: Noise | None
    warnings: tuple[str, ...]


def run_check(project: str | Path, *, function: str | None = None) -> Checked:
    """What a project's readings can determine; nothing is fitted and nothing written.

    Of a stream some are looked at, as a warning says.
    Raises InputError for what cannot be used.
    """
    read = named_project(project, function)
    loaded = load_sample(read)
    noise: Noise | None = loaded.noise
    # A method without noise needs no sds; stated ones are used where they are there.
    if read.fit.settings.method.exact and not loaded.noise.entries:
        noise = None
    try:
        refuse_other_units(read.mechanism, loaded.dataset, noise)
        done = check(read.mechanism, loaded.dataset, noise=noise, start=read.fit.settings.start)
    except InputError as error:
        raise error.at(read.name) from None
    done = replace(done, files=project_files(read, function))
    warnings = tuple(str(warning) for warning in loaded.warnings)
    return Checked(done, read, loaded.dataset, noise, warnings)


def run_prediction(
    result: str | Path, readings: Files, *, out: str | Path | None, function: str | None = None
) -> Prediction:
    """Predict outputs from a result on the disk and readings in the columns of its project.

    out: a table to write (.csv, .tsv or .parquet). Raises InputError for what cannot be used.
    """
    if out is not None:
        # Refused ahead of the work, not after it.
        check_ending(out)
    read = read_result(result, mechanism=function)
    done = predict(read.predictor, new_readings(readings, read.inputs, read.mechanism))
    if out is not None:
        path = Path(out)
        write_files(path.parent, {path.name: table_bytes(done.columns(), path.suffix)})
    return done


def prediction_table(prediction: Prediction) -> str:
    """The table that `run_prediction` writes, as CSV text."""
    return table_bytes(prediction.columns()).decode("utf-8")


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
